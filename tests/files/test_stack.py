"""`stack` from files to a file: where pixels land, what they mean there, what the file says."""

from __future__ import annotations

import itertools
import os
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import exrfile
import numpy as np
import OpenEXR
import OpenImageIO as oiio
import oracle
import pngfile
import pytest
from command import Desk
from strategies import OPERATOR_NAMES
from tolerances import FLOAT32, assert_near

import hpcomp
from hpcomp import HpcompWarning, InputError, LayerSpec, MismatchError, SettingError, Window
from hpcomp.layers import budget

# A code value is exact, or its neighbour where float32 falls on the other side of a rounding point.
CODES = 1
# Half-floats keep 11 bits.
HALF = 2.0**-11
# The chroma of the reds, greens and blues below, whatever is done with their luminance.
HUE_DEG = 0.05

ORDERS = ("bottom-up", "top-down", "balanced", "simultaneous", "2,0,1")


# ---- layers, files, and a second opinion ----------------------------------------------------


@dataclass(frozen=True)
class Layer:
    """A layer as numbers: (h, w, 4) linear premultiplied, and where it lies on the canvas."""

    rgba: np.ndarray
    x: int = 0
    y: int = 0


def colours(width, height, seed=0, opaque=False):
    """(h, w, 4) valid premultiplied colours of clear hues, in float32."""
    rng = np.random.default_rng([seed, width, height])
    rgba = rng.random((height, width, 4)).astype(np.float32)
    if opaque:
        rgba[..., 3] = 1
    rgba[..., :3] *= rgba[..., 3:]
    return rgba


def planes_of(rgba, names="RGBA"):
    return {name: np.ascontiguousarray(rgba[..., i]) for i, name in enumerate(names)}


def exr(path, rgba, **options):
    """Written in float32, so that nothing is lost on the way."""
    return exrfile.write(path, planes_of(rgba), **options)


def window_of(path):
    """(data window, display window) as OpenEXR has them, each (x, y, width, height)."""
    header = OpenEXR.File(str(path), separate_channels=True).header()
    return tuple(
        (int(low[0]), int(low[1]), int(high[0] - low[0] + 1), int(high[1] - low[1] + 1))
        for low, high in (header["dataWindow"], header["displayWindow"])
    )


def exr_pixels(path):
    channels = exrfile.read_back(path)
    assert sorted(channels) == list("ABGR")
    return np.stack([channels[name].astype(float) for name in "RGBA"], axis=-1)


def png_pixels(path):
    """(h, w, 4) stored code values, by OpenImageIO and straight."""
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)
    image = oiio.ImageInput.open(str(path), hint)
    assert image is not None, oiio.geterror()
    spec = image.spec()
    pixels = image.read_image(0, 0, 0, 4, oiio.UINT8 if spec.format == oiio.UINT8 else oiio.UINT16)
    image.close()
    return pixels.astype(int)


def on_canvas(layer: Layer, canvas):
    """(h, w, 4) of the canvas (x, y, width, height), transparent where the layer is not."""
    x, y, width, height = canvas
    out = np.zeros((height, width, 4))
    for row, column in np.ndindex(layer.rgba.shape[:2]):
        to_row, to_column = row + layer.y - y, column + layer.x - x
        if 0 <= to_row < height and 0 <= to_column < width:
            out[to_row, to_column] = layer.rgba[row, column]
    return out


def expected(layers: Sequence[Layer], canvas, **rules):
    """The stack pixel by pixel, by the oracle."""
    placed = [on_canvas(layer, canvas) for layer in layers]
    out = np.zeros(placed[0].shape)
    for place in np.ndindex(out.shape[:2]):
        out[place] = oracle.composite([tuple(layer[place]) for layer in placed], **rules)
    return out


def stacked(folder: Path, layers, **options):
    """The linear pixels of a stack, through a float EXR."""
    out = folder / "out.exr"
    hpcomp.stack(layers, out, depth="float", **options)
    return exr_pixels(out)


@pytest.fixture
def three(tmp_path):
    """Three overlapping layers of one size as EXR files: (paths, layers)."""
    layers = [Layer(colours(7, 5, seed)) for seed in range(3)]
    return [exr(tmp_path / f"{i}.exr", layer.rgba) for i, layer in enumerate(layers)], layers


# ---- light and alpha ------------------------------------------------------------------------


def one_pixel(path, *codes, depth=8):
    path.write_bytes(pngfile.rgba_png(np.array([[codes]]), depth).encode())
    return path


def test_half_transparent_white_over_black_is_half_the_light(tmp_path):
    """sRGB 188, not 128: straight alpha is applied to light, not to code values."""
    black = one_pixel(tmp_path / "black.png", 0, 0, 0, 255)
    white = one_pixel(tmp_path / "white.png", 255, 255, 255, 128)
    hpcomp.stack([black, white], tmp_path / "out.png")
    assert png_pixels(tmp_path / "out.png").tolist() == [[[188, 188, 188, 255]]]
    light = stacked(tmp_path, [black, white])
    assert_near(light, [[[128 / 255, 128 / 255, 128 / 255, 1]]], FLOAT32)


@pytest.mark.parametrize("alpha", [1, 3, 64, 127, 128, 200, 254])
@pytest.mark.parametrize("depth", [8, 16])
def test_straight_alpha_of_any_strength(tmp_path, alpha, depth):
    top = 2**depth - 1
    alpha = alpha * top // 255
    black = one_pixel(tmp_path / "black.png", 0, 0, 0, top, depth=depth)
    white = one_pixel(tmp_path / "white.png", top, top, top, alpha, depth=depth)
    hpcomp.stack([black, white], tmp_path / "out.png", depth=depth)
    code = round(float(pngfile.linear_to_srgb(alpha / top)) * top)
    assert png_pixels(tmp_path / "out.png").tolist() == [[[code, code, code, top]]]


def test_half_transparent_white_alone_stays_as_it_is(tmp_path):
    white = one_pixel(tmp_path / "white.png", 255, 255, 255, 128)
    hpcomp.stack([white], tmp_path / "out.png")
    assert png_pixels(tmp_path / "out.png").tolist() == [[[255, 255, 255, 128]]]


def test_one_png_comes_back_as_it_was(tmp_path):
    samples = np.random.default_rng(1).integers(0, 256, (9, 11, 4))
    samples[samples[..., 3] == 0] = 0
    (tmp_path / "in.png").write_bytes(pngfile.rgba_png(samples).encode())
    hpcomp.stack([tmp_path / "in.png"], tmp_path / "out.png")
    assert np.array_equal(png_pixels(tmp_path / "out.png"), samples)


def test_glow_adds_light_and_hides_nothing(tmp_path):
    base = exr(tmp_path / "base.exr", np.full((2, 3, 4), [0.1, 0.2, 0.3, 1.0], np.float32))
    glow = exr(tmp_path / "glow.exr", np.full((2, 3, 4), [0.5, 0.5, 0.5, 0.0], np.float32))
    assert_near(stacked(tmp_path, [base, glow]), np.full((2, 3, 4), [0.6, 0.7, 0.8, 1.0]), FLOAT32)
    coloured = np.full((2, 3, 4), [0.5, 0.25, 0.0, 0.0], np.float32)
    exr(tmp_path / "glow.exr", coloured)
    light = stacked(tmp_path, [base, glow])
    before = np.array([0.1, 0.2, 0.3])
    weights = np.array(oracle.WEIGHTS)
    assert_near(
        light[..., :3] @ weights, np.full((2, 3), (before + coloured[0, 0, :3]) @ weights), FLOAT32
    )
    assert np.all(light[..., 3] == 1)


def test_mask_by_luminance(tmp_path):
    """A grey picture without alpha cuts the stack below to its brightness."""
    rgba = colours(5, 3)
    base = exr(tmp_path / "base.exr", rgba)
    codes = np.random.default_rng(2).integers(0, 256, (3, 5, 1))
    mask = tmp_path / "mask.png"
    mask.write_bytes(pngfile.Png(codes, pngfile.GREY, 8).encode())
    light = stacked(tmp_path, [base, f"{mask}::op=dst-in,alpha=luminance"])
    assert_near(light, rgba * pngfile.srgb_to_linear(codes / 255), FLOAT32)


def test_mask_of_colours_is_their_luminance_times_their_alpha(tmp_path):
    rgba, mask = colours(5, 3), colours(5, 3, seed=9)
    base = exr(tmp_path / "base.exr", rgba)
    light = stacked(
        tmp_path, [base, f"{exr(tmp_path / 'mask.exr', mask)}::op=dst-in,alpha=luminance"]
    )
    assert_near(light, rgba * (mask[..., :3] @ np.array(oracle.WEIGHTS))[..., None], FLOAT32)


# ---- the keys of a layer --------------------------------------------------------------------


@pytest.mark.parametrize("op", OPERATOR_NAMES)
def test_operator_of_a_layer(tmp_path, three, op):
    paths, layers = three
    light = stacked(tmp_path, [paths[0], f"{paths[1]}::op={op}", paths[2]])
    assert_near(light, expected(layers, (0, 0, 7, 5), ops=[None, op, "over"]), FLOAT32)


@pytest.mark.parametrize("op", ["plus", "mask", "under"])
def test_operator_of_the_layers_that_name_none(tmp_path, three, op):
    paths, layers = three
    light = stacked(tmp_path, [paths[0], paths[1], f"{paths[2]}::op=atop"], op=op)
    assert_near(light, expected(layers, (0, 0, 7, 5), ops=[None, op, "atop"]), FLOAT32)


def test_opacity_of_a_layer(tmp_path, three):
    paths, layers = three
    light = stacked(
        tmp_path,
        [f"{paths[0]}::opacity=0.75", f"{paths[1]}::opacity=0.25", f"{paths[2]}::opacity=0"],
    )
    opacities = [0.75, 0.25, 0]
    assert_near(light, expected(layers, (0, 0, 7, 5), opacities=opacities), FLOAT32)


def test_alpha_of_a_layer(tmp_path):
    """Each mode names what the stored numbers are; the same light is stored in three ways."""
    straight = np.random.default_rng(3).random((3, 4, 4)).astype(np.float32)
    straight[..., 3] = 0.25 + 0.75 * straight[..., 3]
    meant = straight * [1, 1, 1, 0]
    meant = np.concatenate([straight[..., :3] * straight[..., 3:], straight[..., 3:]], axis=2)
    encoded = np.concatenate(
        [pngfile.linear_to_srgb(straight[..., :3]) * straight[..., 3:], straight[..., 3:]], axis=2
    )
    for mode, stored in (
        ("straight", straight),
        ("premultiplied", meant),
        ("premultiplied-encoded,colorspace=srgb", encoded),
    ):
        path = exr(tmp_path / "a.exr", stored.astype(np.float32))
        assert_near(stacked(tmp_path, [f"{path}::alpha={mode}"]), meant, FLOAT32)


def test_colorspace_of_a_layer(tmp_path):
    codes = np.random.default_rng(4).integers(0, 256, (3, 4, 4))
    codes[..., 3] = 255
    path = tmp_path / "a.png"
    path.write_bytes(pngfile.rgba_png(codes).encode())
    light = stacked(tmp_path, [f"{path}::colorspace=linear"])
    assert_near(light, codes / 255, FLOAT32)
    wide = exr(tmp_path / "wide.exr", colours(3, 4))
    light = stacked(tmp_path, [f"{wide}::colorspace=linear-rec2020"])
    primaries = np.reshape(exrfile.PRIMARIES["rec2020"], (4, 2))
    matrix = pngfile.to_rec709(primaries[:3], primaries[3])
    assert_near(light[..., :3], colours(3, 4)[..., :3].astype(float) @ matrix.T, FLOAT32)


def test_part_and_layer_of_a_layer(tmp_path):
    base = colours(4, 3)
    left, right, glow = (colours(4, 3, seed) for seed in (1, 2, 3))
    both = {**planes_of(right), **planes_of(glow, ["glow.R", "glow.G", "glow.B", "glow.A"])}
    parts = exrfile.write_parts(
        tmp_path / "parts.exr", [("left", planes_of(left), {}), ("right", both, {})]
    )
    below = exr(tmp_path / "base.exr", base)
    for setting, above in (
        ("part=left", left),
        ("part=0", left),
        ("part=right", right),
        ("part=1,layer=glow", glow),
        ("layer=glow", glow),
    ):
        light = stacked(tmp_path, [below, f"{parts}::{setting}"])
        assert_near(light, expected([Layer(base), Layer(above)], (0, 0, 4, 3)), FLOAT32)


def test_settings_as_text_or_as_a_specification(tmp_path, three):
    paths, _ = three
    text = stacked(tmp_path, [paths[0], f"{paths[1]}::op=atop,opacity=0.5,at=+2+1,name=roads"])
    spec = stacked(
        tmp_path,
        [
            LayerSpec(str(paths[0])),
            LayerSpec(str(paths[1]), op="atop", opacity=0.5, at="+2+1", name="roads"),
        ],
    )
    assert np.array_equal(text, spec)


# ---- the canvas -----------------------------------------------------------------------------


def two_windows(folder):
    """Two EXR layers with windows of every kind, and what they are: (paths, layers).

    The lower one's data window reaches beyond its display window to the left and above and leaves
    some of it empty; the upper one lies lower, and its data begin outside its display window.
    """
    low = Layer(colours(12, 6, 1), -3, -2)
    high = Layer(colours(6, 7, 2), 4, 1)
    return [
        exr(folder / "low.exr", low.rgba, origin=(-3, -2), display=(0, 0, 10, 8)),
        exr(folder / "high.exr", high.rgba, origin=(4, 1), display=(6, -4, 9, 9)),
    ], [low, high]


@pytest.mark.filterwarnings("ignore:.*outside the canvas")
@pytest.mark.parametrize(
    ("canvas", "window"),
    [
        ("union", (0, -4, 15, 12)),
        ("intersection", (6, 0, 4, 5)),
        ("5x4+2+1", (2, 1, 5, 4)),
        ("20x20-5-6", (-5, -6, 20, 20)),
        ("3x3+100+100", (100, 100, 3, 3)),
    ],
)
def test_canvas(tmp_path, canvas, window):
    paths, layers = two_windows(tmp_path)
    light = stacked(tmp_path, paths, canvas=canvas)
    assert window_of(tmp_path / "out.exr") == (window, window)
    assert_near(light, expected(layers, window), FLOAT32)


def test_canvas_of_the_bottom_layer(tmp_path):
    """Its display window, not its data; what lies beyond is cut, what is missing is empty."""
    paths, layers = two_windows(tmp_path)
    light = stacked(tmp_path, paths[:1])
    assert window_of(tmp_path / "out.exr") == ((0, 0, 10, 8), (0, 0, 10, 8))
    assert_near(light, expected(layers[:1], (0, 0, 10, 8)), FLOAT32)
    with pytest.raises(MismatchError, match=r"layer 1 .*high\.exr.* is 9x9\+6-4 .*10x8"):
        hpcomp.stack(paths, tmp_path / "out.exr")


def test_canvas_as_a_window_object(tmp_path):
    paths, layers = two_windows(tmp_path)
    result = hpcomp.stack(paths, tmp_path / "out.exr", canvas=Window(2, 1, 5, 4), depth="float")
    assert result.canvas == result.data_window == Window(2, 1, 5, 4)
    assert result.output == str(tmp_path / "out.exr")
    assert_near(exr_pixels(tmp_path / "out.exr"), expected(layers, (2, 1, 5, 4)), FLOAT32)


@pytest.mark.filterwarnings("ignore:.*outside the canvas")
@pytest.mark.parametrize(
    "origin",
    [(0, 0), (-4, -3), (3, 2), (2, 1), (9, 7), (-6, 0), (0, -5), (10, 8), (-30, 0), (0, 400)],
)
@pytest.mark.parametrize("size", [(7, 6), (3, 2), (20, 15)])
def test_data_window_anywhere(tmp_path, origin, size):
    """Inside the display window, around it, across its edges, beside it."""
    canvas = 0, 0, 10, 8
    base = Layer(colours(10, 8, 1))
    high = Layer(colours(*size, 2), *origin)
    light = stacked(
        tmp_path,
        [
            exr(tmp_path / "base.exr", base.rgba),
            exr(tmp_path / "high.exr", high.rgba, origin=origin, display=canvas),
        ],
    )
    assert_near(light, expected([base, high], canvas), FLOAT32)


@pytest.mark.filterwarnings("ignore:.*outside the canvas")
@pytest.mark.parametrize("at", ["+0+0", "+3+2", "-2-1", "+9+7", "+50+0", "-50-50"])
def test_place_of_a_layer(tmp_path, at):
    """`at` is where its display window goes; its data window goes with it."""
    x, y = (int(part) for part in at.replace("+", " ").replace("-", " -").split())
    base = Layer(colours(10, 8, 1), 100, 200)
    high = Layer(colours(4, 3, 2), x + 1, y - 1)
    light = stacked(
        tmp_path,
        [
            exr(tmp_path / "base.exr", base.rgba, origin=(100, 200)),
            f"{exr(tmp_path / 'high.exr', high.rgba, origin=(8, 6), display=(7, 7, 5, 4))}::at={at}",
        ],
    )
    assert window_of(tmp_path / "out.exr")[0] == (100, 200, 10, 8)
    assert_near(light, expected([base, high], (100, 200, 10, 8)), FLOAT32)


FREE = {
    "north-west": (0, 0), "north": (1, 0), "north-east": (3, 0),
    "west": (0, 2), "center": (1, 2), "east": (3, 2),
    "south-west": (0, 5), "south": (1, 5), "south-east": (3, 5),
}  # fmt: skip


@pytest.mark.parametrize("gravity", FREE)
@pytest.mark.parametrize("offset", [None, (0, -2), (3, 1)])
def test_gravity(tmp_path, gravity, offset):
    """A 4×3 layer on a 7×8 canvas: of 3 and 5 free pixels the odd ones go right and below."""
    base = Layer(colours(7, 8, 1), -20, 10)
    x, y = FREE[gravity]
    at = gravity
    if offset:
        x, y = x + offset[0], y + offset[1]
        at += "{:+d}{:+d}".format(*offset)
    high = Layer(colours(4, 3, 2), base.x + x, base.y + y)
    light = stacked(
        tmp_path,
        [
            exr(tmp_path / "base.exr", base.rgba, origin=(base.x, base.y)),
            f"{exr(tmp_path / 'high.exr', high.rgba, origin=(5, 5))}::at={at}",
        ],
    )
    assert_near(light, expected([base, high], (base.x, base.y, 7, 8)), FLOAT32)


def test_gravity_of_a_layer_larger_than_the_canvas(tmp_path):
    """A 9×6 layer on a 4×3 canvas lacks 5 and 3 pixels: 3 and 2 of them are cut left and above."""
    base, high = Layer(colours(4, 3, 1)), Layer(colours(9, 6, 2), -3, -2)
    paths = [exr(tmp_path / "base.exr", base.rgba), exr(tmp_path / "high.exr", high.rgba)]
    light = stacked(tmp_path, [paths[0], f"{paths[1]}::at=center"])
    assert_near(light, expected([base, high], (0, 0, 4, 3)), FLOAT32)


def test_gravity_refers_to_a_canvas_that_is_a_window(tmp_path):
    base, high = Layer(colours(4, 3, 1)), Layer(colours(2, 2, 2), 15, 16)
    paths = [exr(tmp_path / "base.exr", base.rgba), exr(tmp_path / "high.exr", high.rgba)]
    canvas = -3, -2, 20, 20
    light = stacked(tmp_path, [paths[0], f"{paths[1]}::at=south-east"], canvas="20x20-3-2")
    assert_near(light, expected([base, high], canvas), FLOAT32)


def test_place_of_the_bottom_layer_moves_the_canvas(tmp_path):
    base, high = Layer(colours(6, 5, 1), 30, -7), Layer(colours(6, 5, 2), 30, -7)
    paths = [
        exr(tmp_path / "base.exr", base.rgba),
        exr(tmp_path / "high.exr", high.rgba, origin=(30, -7)),
    ]
    light = stacked(tmp_path, [f"{paths[0]}::at=+30-7", paths[1]])
    assert window_of(tmp_path / "out.exr") == ((30, -7, 6, 5), (30, -7, 6, 5))
    assert_near(light, expected([base, high], (30, -7, 6, 5)), FLOAT32)


def test_png_layer_on_an_exr(tmp_path):
    """A PNG lies at the origin unless it is placed, and its result has no origin."""
    base = Layer(colours(6, 5, 1), 2, 3)
    path = exr(tmp_path / "base.exr", base.rgba, origin=(2, 3))
    png = pngfile.random_png(pngfile.RGBA, 8, width=3, height=4)
    (tmp_path / "a.png").write_bytes(png.encode())
    light = stacked(tmp_path, [path, f"{tmp_path / 'a.png'}::at=+2+3"])
    result = expected([base, Layer(png.linear(), 2, 3)], (2, 3, 6, 5))
    assert_near(light, result, FLOAT32)
    hpcomp.stack([path, f"{tmp_path / 'a.png'}::at=north-west"], tmp_path / "out.png", depth=16)
    codes = png_pixels(tmp_path / "out.png")
    assert codes.shape == (5, 6, 4)
    straight = result[..., :3] / result[..., 3:]
    error = codes[..., :3] / 65535 - pngfile.linear_to_srgb(np.clip(straight, 0, 1))
    assert np.abs(error).max() <= 2e-3  # where a valid colour is a little out of gamut


@pytest.mark.parametrize("op", OPERATOR_NAMES)
def test_operators_act_on_the_whole_canvas(tmp_path, op):
    """Where the layer has no pixels it is transparent, which in, out, clear and others see."""
    base, high = Layer(colours(8, 6, 1)), Layer(colours(3, 2, 2), 2, 3)
    paths = [exr(tmp_path / "base.exr", base.rgba), exr(tmp_path / "high.exr", high.rgba)]
    light = stacked(tmp_path, [paths[0], f"{paths[1]}::op={op},at=+2+3"])
    assert_near(light, expected([base, high], (0, 0, 8, 6), ops=[None, op]), FLOAT32)
    outside = np.ones((6, 8), bool)
    outside[3:5, 2:5] = False
    erases = op in ("clear", "src", "in", "dst-in", "out", "dst-atop")
    assert np.all(light[outside] == 0) == erases


# ---- region and overscan --------------------------------------------------------------------


@pytest.mark.parametrize("region", ["4x3+2+1", "1x1+9+7", "10x8+0+0", "10x1+0+4"])
def test_region(tmp_path, region):
    """An EXR keeps the display window around it; a PNG is cut to it."""
    width, height, x, y = (int(part) for part in region.replace("x", "+").split("+"))
    layers = [Layer(colours(10, 8, 1)), Layer(colours(10, 8, 2))]
    paths = [exr(tmp_path / f"{i}.exr", layer.rgba) for i, layer in enumerate(layers)]
    light = stacked(tmp_path, paths, region=region)
    assert window_of(tmp_path / "out.exr") == ((x, y, width, height), (0, 0, 10, 8))
    assert_near(light, expected(layers, (x, y, width, height)), FLOAT32)
    hpcomp.stack(paths, tmp_path / "whole.png")
    hpcomp.stack(paths, tmp_path / "part.png", region=region)
    whole = png_pixels(tmp_path / "whole.png")[y : y + height, x : x + width]
    assert np.array_equal(png_pixels(tmp_path / "part.png"), whole)


def test_region_is_in_the_coordinates_of_the_canvas(tmp_path):
    layer = Layer(colours(10, 8, 1), 100, -50)
    path = exr(tmp_path / "a.exr", layer.rgba, origin=(100, -50))
    light = stacked(tmp_path, [path], region="2x3+101-45")
    assert window_of(tmp_path / "out.exr") == ((101, -45, 2, 3), (100, -50, 10, 8))
    assert_near(light, expected([layer], (101, -45, 2, 3)), FLOAT32)
    for region in ("2x3+0+0", "11x8+100-50", "2x3+99-45"):
        with pytest.raises(MismatchError, match=r"10x8\+100-50"):
            hpcomp.stack([path], tmp_path / "out.exr", region=region)


def test_overscan(tmp_path):
    """The union of the data windows is kept around the canvas, for EXR only."""
    paths, layers = two_windows(tmp_path)
    window = -3, -2, 13, 10
    light = stacked(tmp_path, [paths[0], f"{paths[1]}::at=+6-4"], overscan=True)
    assert window_of(tmp_path / "out.exr") == (window, (0, 0, 10, 8))
    assert_near(light, expected(layers, window), FLOAT32)
    light = stacked(tmp_path, [paths[0]], overscan=True, region="2x2-3-2")
    assert window_of(tmp_path / "out.exr") == ((-3, -2, 2, 2), (0, 0, 10, 8))
    assert_near(light, expected(layers[:1], (-3, -2, 2, 2)), FLOAT32)
    with pytest.raises(SettingError, match=r"overscan.*EXR"):
        hpcomp.stack([paths[0]], tmp_path / "out.png", overscan=True)


# ---- background, exposure, orders -----------------------------------------------------------


@pytest.mark.parametrize("colour", ["#ff8000", "#f80", "ff8000", (1.0, 0.21586050011389926, 0.0)])
def test_background(tmp_path, three, colour):
    """It is added last, under everything, in linear light."""
    paths, layers = three
    linear = tuple(float(v) for v in pngfile.srgb_to_linear(np.array([255, 128, 0]) / 255))
    if colour in ("#f80",):
        linear = tuple(float(v) for v in pngfile.srgb_to_linear(np.array([255, 136, 0]) / 255))
    light = stacked(tmp_path, paths, background=colour)
    assert_near(light, expected(layers, (0, 0, 7, 5), background=linear), FLOAT32)
    assert np.all(light[..., 3] == 1)


@pytest.mark.parametrize("stops", [-2.5, 0.0, 1.0, 3.0])
def test_exposure(tmp_path, three, stops):
    """It scales the light of the result, and neither its alpha nor its hue."""
    paths, layers = three
    light = stacked(tmp_path, paths, exposure=stops, background="#123456")
    background = tuple(float(v) for v in pngfile.srgb_to_linear(np.array([18, 52, 86]) / 255))
    result = expected(layers, (0, 0, 7, 5), background=background)
    assert_near(light[..., :3], result[..., :3] * 2**stops, FLOAT32, scale=2**stops)
    assert_near(light[..., 3], result[..., 3], FLOAT32)


@pytest.mark.parametrize("order", [*ORDERS, "0,1,2", "1,2,0", (2, 1, 0)], ids=str)
@pytest.mark.parametrize("blending", ["hue-preserving", "traditional", "foremost"])
def test_orders_are_those_of_the_engine(tmp_path, three, order, blending):
    """Bit by bit what `composite` makes of the pixels, which the oracle is held against."""
    paths, layers = three
    operators = [None, "atop", "xor"]
    light = stacked(
        tmp_path,
        [paths[0], f"{paths[1]}::op=atop", f"{paths[2]}::op=xor,opacity=0.5"],
        order=order,
        blending=blending,
    )
    whole = hpcomp.composite(
        [layer.rgba for layer in layers], op=operators, opacity=[1, 1, 0.5],
        order=order, blending=blending,
    )  # fmt: skip
    assert np.array_equal(light, whole)


@pytest.mark.parametrize("tolerance", [0.0, 2.0, 30.0])
def test_hue_tolerance(tmp_path, three, tolerance):
    paths, layers = three
    light = stacked(tmp_path, paths, hue_tolerance=tolerance)
    whole = hpcomp.composite([layer.rgba for layer in layers], hue_tolerance=tolerance)
    assert np.array_equal(light, whole)


# ---- what a PNG cannot hold -----------------------------------------------------------------


def hue_and_luminance(linear):
    """(degrees, Y) of linear colours (…, 3), by the oracle's difference vectors."""
    flat = np.asarray(linear, float).reshape(-1, 3)
    hues = [np.degrees(np.arctan2(oracle.difference(c)[1], oracle.difference(c)[0])) for c in flat]
    return np.array(hues), np.array([oracle.luminance(c) for c in flat])


def test_bright_colours_keep_hue_and_luminance_in_a_png(tmp_path):
    """They lose saturation alone, are counted in a warning, and refused with `strict`."""
    hdr = np.array(
        [[[2.0, 0.2, 0.1, 1], [0.1, 1.3, 0.2, 1], [0.3, 0.1, 4.0, 1], [0.5, 0.5, 0.5, 1]]]
    )
    path = exr(tmp_path / "hdr.exr", hdr.astype(np.float32))
    with pytest.warns(HpcompWarning, match=r"out\.png: 3 pixels are outside the gamut") as warned:
        result = hpcomp.stack([path], tmp_path / "out.png", depth=16)
    assert len(warned) == 1
    assert result.losses.out_of_gamut == 3
    codes = png_pixels(tmp_path / "out.png")
    linear = pngfile.srgb_to_linear(codes[..., :3] / 65535)
    hue, luminance = hue_and_luminance(linear[:, :3])
    hue_before, luminance_before = hue_and_luminance(hdr[:, :3, :3])
    assert_near(luminance, luminance_before, 1e-4)
    assert np.all(np.abs((hue - hue_before + 180) % 360 - 180) <= HUE_DEG)
    assert np.all(codes[0, :3, :3].max(axis=1) >= 65534)  # no more was taken than had to be
    assert np.all(codes[..., 3] == 65535)
    (tmp_path / "out.png").write_bytes(b"old")
    with pytest.raises(MismatchError, match=r"3 pixels .*--strict"):
        hpcomp.stack([path], tmp_path / "out.png", strict=True)
    assert (tmp_path / "out.png").read_bytes() == b"old"


def test_exposure_brings_bright_colours_back(tmp_path):
    path = exr(tmp_path / "hdr.exr", np.full((1, 1, 4), [4.0, 2.0, 1.0, 1.0], np.float32))
    result = hpcomp.stack([path], tmp_path / "out.png", exposure=-2, strict=True)
    assert result.losses.out_of_gamut == 0


def test_whiter_than_white_is_white(tmp_path):
    path = exr(tmp_path / "hdr.exr", np.full((1, 2, 4), [9.0, 3.0, 1.0, 1.0], np.float32))
    with pytest.warns(HpcompWarning, match="2 pixels"):
        hpcomp.stack([path], tmp_path / "out.png")
    assert np.all(png_pixels(tmp_path / "out.png") == 255)


def test_glow_is_counted_in_a_png(tmp_path):
    """Light where alpha is 0 has no straight colour; a background under it holds it."""
    glow = np.zeros((2, 3, 4), np.float32)
    glow[0, :, :3] = 0.5, 0.25, 0.0
    path = exr(tmp_path / "glow.exr", glow)
    with pytest.warns(HpcompWarning, match=r"out\.png: 3 pixels are light without alpha"):
        result = hpcomp.stack([path], tmp_path / "out.png")
    assert result.losses.light_without_alpha == 3
    assert np.all(png_pixels(tmp_path / "out.png") == 0)
    with pytest.raises(MismatchError, match=r"3 pixels .*--strict"):
        hpcomp.stack([path], tmp_path / "out.png", strict=True)
    hpcomp.stack([path], tmp_path / "out.png", background="#000", strict=True)
    hpcomp.stack([path], tmp_path / "out.exr", strict=True)
    assert_near(exr_pixels(tmp_path / "out.exr"), glow, HALF)


# ---- what the file says ---------------------------------------------------------------------


def test_exr_depth(tmp_path, three):
    for depth, kind in ((None, np.float16), ("half", np.float16), ("float", np.float32)):
        hpcomp.stack(three[0], tmp_path / "out.exr", depth=depth)
        assert {p.dtype for p in exrfile.read_back(tmp_path / "out.exr").values()} == {
            np.dtype(kind)
        }


@pytest.mark.parametrize(("depth", "stored"), [(None, 8), ("8", 8), (8, 8), ("16", 16), (16, 16)])
def test_png_depth(tmp_path, three, depth, stored):
    hpcomp.stack(three[0], tmp_path / "out.png", depth=depth)
    kind, header = pngfile.split((tmp_path / "out.png").read_bytes())[0]
    assert kind == b"IHDR"
    assert header[8:10] == bytes([stored, pngfile.RGBA])


EXR_COMPRESSIONS = [
    "zip", "none", "rle", "zips", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab", "htj2k256", "htj2k32",
]  # fmt: skip


@pytest.mark.parametrize("compression", [None, *EXR_COMPRESSIONS])
def test_exr_compression(tmp_path, compression):
    """Smooth pixels, so that the lossy ones lose little."""
    y, x = np.mgrid[0:40, 0:30] / 40
    rgba = np.stack([x / 2, y / 2, x * y, np.ones_like(x)], axis=-1).astype(np.float32)
    path = exr(tmp_path / "a.exr", rgba)
    hpcomp.stack([path], tmp_path / "out.exr", compression=compression)
    header = OpenEXR.File(str(tmp_path / "out.exr")).header()
    assert header["compression"] == exrfile.COMPRESSIONS[compression or "zip"]
    lossy = compression in exrfile.LOSSY
    assert_near(exr_pixels(tmp_path / "out.exr"), rgba, 0.02 if lossy else HALF)


@pytest.mark.parametrize("compression", [None, "fast", "small", *range(10)])
def test_png_compression(tmp_path, three, compression):
    hpcomp.stack(three[0], tmp_path / "plain.png")
    hpcomp.stack(three[0], tmp_path / "out.png", compression=compression)
    assert np.array_equal(png_pixels(tmp_path / "out.png"), png_pixels(tmp_path / "plain.png"))


def test_exr_is_tagged_and_has_no_clock(tmp_path, three):
    hpcomp.stack(three[0], tmp_path / "out.exr")
    header = OpenEXR.File(str(tmp_path / "out.exr")).header()
    assert np.allclose(header["chromaticities"], exrfile.PRIMARIES["rec709"], atol=1e-6)
    assert header["colorInteropID"] == "lin_rec709_scene"
    unwanted = {"capDate", "DateTime", "Software", "Exif:ImageHistory", "HostComputer", "owner"}
    assert not unwanted & set(header)
    data = (tmp_path / "out.exr").read_bytes()
    for word in (str(tmp_path).encode(), b"0.exr", b"hpcomp", os.uname().nodename.encode()):
        assert word not in data


def test_png_is_tagged_and_has_no_clock(tmp_path, three):
    hpcomp.stack(three[0], tmp_path / "out.png")
    data = (tmp_path / "out.png").read_bytes()
    kinds = [kind for kind, _ in pngfile.split(data)]
    assert b"sRGB" in kinds
    assert not set(kinds) - {b"IHDR", b"sRGB", b"gAMA", b"cHRM", b"pHYs", b"IDAT", b"IEND"}
    for word in (str(tmp_path).encode(), b"0.exr", b"hpcomp"):
        assert word not in data


def test_pixel_aspect_and_resolution_are_those_of_the_bottom_layer(tmp_path):
    """And nothing else is carried over."""
    rgba = colours(6, 5)
    bottom = exr(
        tmp_path / "bottom.exr", rgba, pixel_aspect=2.0, xDensity=300.0, owner="somebody",
        comments="something",
    )  # fmt: skip
    png = pngfile.random_png(pngfile.RGBA, 8, width=6, height=5)
    top = tmp_path / "top.png"
    top.write_bytes(png.with_chunks(body=[pngfile.phys(2000, 2000)]).encode())
    with pytest.warns(HpcompWarning, match=r"layer 1 .*top\.png.* aspect 1"):
        hpcomp.stack([bottom, top], tmp_path / "out.exr")
    header = OpenEXR.File(str(tmp_path / "out.exr")).header()
    assert header["pixelAspectRatio"] == 2.0
    assert header["xDensity"] == pytest.approx(300.0, rel=1e-4)
    assert "owner" not in header
    assert "comments" not in header
    hpcomp.stack([bottom], tmp_path / "out.png")
    # 300 per inch across, 600 down: pixels twice as wide as high.
    assert phys_of(tmp_path / "out.png") == (11811, 23622, 1)


def phys_of(path):
    chunks = dict(pngfile.split(path.read_bytes()))
    return struct.unpack(">IIB", chunks[b"pHYs"]) if b"pHYs" in chunks else None


@pytest.mark.parametrize("density", [(3937, 3937), (2835, 2835), (11811, 5906)])
def test_resolution_of_a_png(tmp_path, density):
    png = pngfile.random_png(pngfile.RGBA, 8, width=6, height=5)
    path = tmp_path / "a.png"
    path.write_bytes(png.with_chunks(body=[pngfile.phys(*density)]).encode())
    hpcomp.stack([path], tmp_path / "out.png")
    assert phys_of(tmp_path / "out.png") == (*density, 1)
    hpcomp.stack([path], tmp_path / "out.exr")
    header = OpenEXR.File(str(tmp_path / "out.exr")).header()
    assert header["xDensity"] == pytest.approx(density[0] * 0.0254, rel=1e-4)
    assert header["pixelAspectRatio"] == pytest.approx(density[1] / density[0], rel=1e-4)


@pytest.mark.filterwarnings("ignore:.*colours under an alpha of 0")
def test_no_resolution_where_there_was_none(tmp_path):
    (tmp_path / "a.png").write_bytes(pngfile.random_png(pngfile.RGBA, 8).encode())
    hpcomp.stack([tmp_path / "a.png"], tmp_path / "out.png")
    assert phys_of(tmp_path / "out.png") is None
    hpcomp.stack([tmp_path / "a.png"], tmp_path / "out.exr")
    assert "xDensity" not in OpenEXR.File(str(tmp_path / "out.exr")).header()


# ---- pipes ----------------------------------------------------------------------------------


def test_stdin_and_stdout_in_a_pipe(tmp_path):
    """The same bytes as from files to a file, for both formats on either side."""
    desk = Desk.made(tmp_path)
    exr(desk / "base.exr", colours(7, 5, 1))
    exr(desk / "top.exr", colours(7, 5, 2))
    png = pngfile.random_png(pngfile.RGBA, 16, width=7, height=5)
    desk.put("top.png", png.encode())
    for layer, ending in itertools.product(("top.exr", "top.png"), ("exr", "png")):
        desk.run("stack", "base.exr", layer, "-q", "-o", f"out.{ending}")
        piped = desk.run(
            "stack", "base.exr", "-", "-q", "-o", "-", "--format", ending,
            stdin=(desk / layer).read_bytes(),
        )  # fmt: skip
        assert (piped.code, piped.stderr) == (0, "")
        assert piped.stdout == (desk / f"out.{ending}").read_bytes()
        assert os.listdir(desk.temporary) == []


@pytest.mark.parametrize("place", [0, 1])
def test_stdin_with_settings(tmp_path, place):
    desk = Desk.made(tmp_path)
    exr(desk / "a.exr", colours(7, 5, 1))
    exr(desk / "b.exr", colours(7, 5, 2))
    names = ["a.exr::opacity=0.5", "b.exr::opacity=0.5"]
    desk.makes("stack", *names, "-o", "out.exr")
    names[place] = "-::opacity=0.5"
    piped = desk.makes(
        "stack",
        *names,
        "-o",
        "piped.exr",
        stdin=(desk / "ab"[place]).with_suffix(".exr").read_bytes(),
    )
    assert piped.stdout == b""
    assert (desk / "piped.exr").read_bytes() == (desk / "out.exr").read_bytes()


# ---- strips and threads ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def tall(tmp_path_factory):
    """Layers of 61 rows in blocks of 1, 16, 32 rows and in tiles, one placed beyond the edges."""
    folder = tmp_path_factory.mktemp("tall")
    names = ["0.exr", "1.exr", "2.exr"]
    exr(folder / "0.exr", colours(17, 61, 0), compression="piz")
    exr(folder / "1.exr", colours(9, 70, 1), tile=(8, 8), display=(0, 0, 17, 61), origin=(3, -5))
    exr(folder / "2.exr", colours(17, 61, 2), compression="zip")
    png = pngfile.random_png(pngfile.RGBA, 8, width=10, height=50, interlaced=True)
    (folder / "3.png").write_bytes(png.encode())
    return [str(folder / name) for name in names] + [f"{folder / '3.png'}::at=center,op=atop"]


@pytest.mark.parametrize("order", [*ORDERS[:4], "2,3,0,1"])
@pytest.mark.parametrize("ending", ["png", "exr"])
def test_same_bytes_whatever_the_strips_and_threads(tmp_path, tall, monkeypatch, order, ending):
    """Rows are not seen beyond their strip, and threads decide nothing."""
    made = set()
    options = {"order": order, "compression": "piz" if ending == "exr" else None}
    for rows, threads in itertools.product((1, 7, 61), (1, 2)):
        monkeypatch.setattr(budget.Budget, "rows", lambda *given, rows=rows: rows)
        out = tmp_path / f"{rows}-{threads}.{ending}"
        hpcomp.stack(tall, out, threads=threads, **options)
        made.add(out.read_bytes())
    assert len(made) == 1
    monkeypatch.undo()
    hpcomp.stack(tall, tmp_path / f"out.{ending}", **options)
    assert made == {(tmp_path / f"out.{ending}").read_bytes()}


@pytest.mark.parametrize("memory", ["16M", "1G"])
def test_same_bytes_whatever_the_memory(tmp_path, tall, memory):
    hpcomp.stack(tall, tmp_path / "a.exr")
    hpcomp.stack(tall, tmp_path / "b.exr", max_memory=memory)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_many_layers(tmp_path, threads):
    """More than threads, and the same file many times over."""
    path = exr(tmp_path / "a.exr", colours(5, 4, 1))
    layers = [path] * 40
    light = stacked(tmp_path, layers, threads=threads)
    whole = hpcomp.composite([colours(5, 4, 1)] * 40)
    assert np.array_equal(light, whole)


@pytest.mark.parametrize("threads", [1, 2])
def test_failure_in_mid_run_leaves_nothing(tmp_path, threads):
    """A layer that breaks below the first strip: the error is its own, the output what it was."""
    whole = exrfile.write(tmp_path / "a.exr", exrfile.coarse("RGBA", 40, 300))
    data = whole.read_bytes()
    begin, end = exrfile.regions(data)["pixels"][-2]
    bad = tmp_path / "bad.exr"
    bad.write_bytes(pngfile.flip_bit(data, (begin + end) // 2, 4))
    out = tmp_path / "out.exr"
    out.write_bytes(b"old")
    with pytest.raises(InputError, match=r"layer 1 .*bad\.exr.*cannot be read, rows 2\d\d"):
        hpcomp.stack([whole, bad, whole], out, threads=threads)
    assert out.read_bytes() == b"old"
    assert sorted(os.listdir(tmp_path)) == ["a.exr", "bad.exr", "out.exr"]


def test_options_are_taken_whole_or_by_keyword(tmp_path, tall):
    """All options in one value, of which a keyword replaces one."""
    options = hpcomp.StackOptions.of({"order": "simultaneous", "gray_bias": 0.5, "depth": "float"})
    by_keyword = {"order": "simultaneous", "gray_bias": 0.5, "depth": "half"}
    hpcomp.stack(tall, tmp_path / "whole.exr", options, depth="half")
    hpcomp.stack(tall, tmp_path / "each.exr", **by_keyword)
    hpcomp.stack(tall, tmp_path / "plain.exr")
    made = [(tmp_path / name).read_bytes() for name in ("whole.exr", "each.exr", "plain.exr")]
    assert made[0] == made[1] != made[2]
    pixel = hpcomp.explain(tall, (0, 0), options)
    assert (pixel.rules.order.name, pixel.rules.gray_bias) == ("simultaneous", 0.5)


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"gray_bais": 1}, TypeError, "no option 'gray_bais' here: did you mean 'gray_bias'?"),
        ({"gray_bias": 2}, SettingError, "gray bias 2 is outside 0 to 1"),
        ({"threads": 0}, SettingError, "threads 0 is below 1"),
        ({"max_memory": "much"}, SettingError, "'much' is not an amount of memory"),
        ({"region": "here"}, SettingError, "'here' is not a window"),
    ],
)
def test_options_are_checked_before_a_file_is_touched(tmp_path, options, error, says):
    with pytest.raises(error, match=re.escape(says)):
        hpcomp.stack([tmp_path / "missing.png"], tmp_path / "out.png", **options)
    with pytest.raises(error, match=re.escape(says)):
        hpcomp.StackOptions.of(options)
