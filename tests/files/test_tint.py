"""`tint=`: a grey or single-channel mask in one colour, its stored values as alpha."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import command
import exrfile
import numpy as np
import pngfile
import pytest
from PIL import Image

import hpcomp
from hpcomp import HpcompWarning, InputError, LayerSpec, MismatchError, SettingError
from hpcomp.engine import choice as engine

FLOAT32 = 2e-7
TINT = "#377eb8"
COLOR = pngfile.srgb_to_linear(np.array([0x37, 0x7E, 0xB8]) / 255)


def put(path, content):
    path.write_bytes(content.encode() if isinstance(content, pngfile.Png) else content)
    return path


def tinted(path, **options):
    """The pixels of a mask in that colour, read without a warning but of values beyond 0 and 1."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*have a value outside 0 to 1, from -1 to 3, held")
        return hpcomp.read_layer(path, tint=TINT, **options).pixels


def assert_covers(pixels, coverage):
    """Premultiplied in linear light: the colour times the coverage, which is the alpha."""
    assert pixels.shape == (*coverage.shape, 4)
    expected = np.concatenate([coverage[..., None] * COLOR, coverage[..., None]], axis=-1)
    assert np.abs(pixels - expected).max() <= FLOAT32


@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
def test_the_stored_value_covers(tmp_path, depth):
    png = pngfile.random_png(pngfile.GREY, depth)
    pixels = tinted(put(tmp_path / "a.png", png))
    assert_covers(pixels, png.samples[..., 0] / (2**depth - 1))


def test_128_of_255_covers_half(tmp_path):
    mask = pngfile.Png(np.array([[[0], [128], [255]]]), pngfile.GREY, 8)
    alpha = tinted(put(tmp_path / "a.png", mask))[0, :, 3]
    assert alpha.tolist() == [0, np.float32(128 / 255), 1]


@pytest.mark.parametrize(
    "chunk",
    [
        pngfile.gama(100000),
        pngfile.srgb(),
        pngfile.cicp(9, 16),
        pngfile.iccp(pngfile.icc_profile("tables", more=[(b"A2B0", bytes(48))])),
    ],
    ids=["linear", "sRGB", "PQ", "a profile of tables"],
)
def test_curves_and_profiles_say_nothing_of_coverage(tmp_path, chunk):
    png = pngfile.random_png(pngfile.GREY, 8).with_chunks(head=[chunk])
    assert_covers(tinted(put(tmp_path / "a.png", png)), png.samples[..., 0] / 255)


def test_luminance_asks_for_the_light(tmp_path):
    png = pngfile.random_png(pngfile.GREY, 8)
    path = put(tmp_path / "a.png", png)
    value = png.samples[..., 0] / 255
    assert_covers(tinted(path, alpha="luminance"), pngfile.srgb_to_linear(value))
    assert_covers(tinted(path, alpha="luminance", colorspace="linear"), value)
    odd = put(tmp_path / "b.png", png.with_chunks(head=[pngfile.cicp(9, 16)]))
    with pytest.raises(InputError, match="PQ"):
        tinted(odd, alpha="luminance")


@pytest.mark.parametrize("depth", [8, 16])
def test_an_alpha_is_taken_times_the_value(tmp_path, depth):
    png = pngfile.random_png(pngfile.GREY_ALPHA, depth)
    path = put(tmp_path / "a.png", png)
    top = 2**depth - 1
    value, alpha = png.samples[..., 0] / top, png.samples[..., 1] / top
    assert_covers(tinted(path), value * alpha)
    assert_covers(tinted(path, alpha="luminance"), pngfile.srgb_to_linear(value) * alpha)
    # A premultiplied value has its alpha in it.
    assert_covers(tinted(path, alpha="premultiplied"), value)


@pytest.mark.parametrize("colour", [pngfile.RGB, pngfile.RGBA])
def test_a_grey_picture_in_three_channels_is_a_mask(tmp_path, colour):
    png = pngfile.random_png(colour, 8)
    png.samples[..., 1:3] = png.samples[..., :1]
    coverage = png.samples[..., 0] / 255
    if colour == pngfile.RGBA:
        coverage = coverage * png.samples[..., 3] / 255
    assert_covers(tinted(put(tmp_path / "a.png", png)), coverage)


def test_a_palette_of_greys_is_a_mask(tmp_path):
    greys = tuple((v, v, v) for v in (0, 60, 128, 255))
    png = pngfile.Png(np.array([[[0], [1], [2], [3]]]), pngfile.PALETTE, 2, greys)
    assert_covers(tinted(put(tmp_path / "a.png", png)), np.array([[0, 60, 128, 255]]) / 255)


def test_a_picture_with_colours_is_refused(tmp_path):
    codes = np.full((70, 5, 3), 90)
    codes[66, 3, 2] = 91
    path = put(tmp_path / "a.png", pngfile.Png(codes, pngfile.RGB, 8))
    with pytest.raises(MismatchError, match=r"a\.png: tint= is for grey masks, and pixel 3,66 has"):
        tinted(path)


# ---- EXR ------------------------------------------------------------------------------------


def exr(tmp_path, **channels):
    planes = {name: np.array(values, np.float32) for name, values in channels.items()}
    return exrfile.write(tmp_path / "a.exr", planes)


VALUES = np.array([[0.0, 0.25, 0.5, 1.0], [-1.0, 3.0, 0.125, 0.75]])
ALPHAS = np.array([[1.0, 0.5, 0.5, 1.0], [1.0, 1.0, 0.25, 0.75]])


@pytest.mark.parametrize(
    ("names", "options"),
    [
        (["Y"], {}),
        (["A"], {}),
        (["Z"], {}),
        (["mask"], {}),
        (["A", "Z"], {}),
        (["Z", "mask"], {"layer": "mask"}),
        (["R", "G", "B", "A", "mask"], {"layer": "mask"}),
        (["R", "G", "B", "roads.A"], {"layer": "roads"}),
        (["R", "G", "B", "roads.A"], {"layer": "roads.A"}),
        (["R", "G", "B", "roads.Y"], {"layer": "roads"}),
    ],
    ids=lambda value: "+".join(value) if isinstance(value, list) else "",
)
def test_channels_that_are_masks(tmp_path, names, options):
    """Y, an alpha, the only channel there is, or the one that layer= names."""
    wanted = {"A": "A", "roads": "roads.A" if "roads.A" in names else "roads.Y"}
    mask = wanted.get(options.get("layer", "A"), options.get("layer"))
    mask = mask if mask in names else names[0]
    planes = {name: np.full(VALUES.shape, 0.375) for name in names} | {mask: VALUES}
    path = exr(tmp_path, **planes)
    assert_covers(tinted(path, **options), np.clip(VALUES, 0, 1))


def test_a_premultiplied_value_has_its_alpha_in_it(tmp_path):
    path = exr(tmp_path, Y=VALUES * ALPHAS, A=ALPHAS)
    assert_covers(tinted(path), np.clip(VALUES * ALPHAS, 0, 1))
    assert_covers(tinted(path, alpha="straight"), np.clip(VALUES * ALPHAS, 0, 1) * ALPHAS)


def test_several_channels_and_no_word_which(tmp_path):
    path = exr(tmp_path, Z=VALUES, mask=VALUES)
    with pytest.raises(InputError, match="only Z, mask: choose the mask with layer="):
        tinted(path)
    with pytest.raises(InputError, match="no colour layer 'N': there is none, only Z, mask"):
        tinted(path, layer="N")


def test_without_a_tint_they_are_no_colour(tmp_path):
    with pytest.raises(InputError, match=r"has no colour, only A: .* or tint= to colour a mask"):
        hpcomp.read_layer(exr(tmp_path, A=VALUES))


@pytest.mark.filterwarnings("ignore:.*have a value outside 0 to 1, from -1 to 3")
@pytest.mark.parametrize("broken", ["R", "G", "B"])
def test_nan_in_any_channel_is_not_let_through(tmp_path, broken):
    planes = {name: VALUES.copy() for name in "RGB"}
    planes[broken][0, 1] = np.nan
    path = exr(tmp_path, **planes)
    with pytest.raises(MismatchError, match="NaN or infinite, the first at 1,0"):
        tinted(path)
    with pytest.warns(HpcompWarning, match="became transparent"):
        pixels = hpcomp.read_layer(path, tint=TINT, nonfinite="zero").pixels
    assert not pixels[0, 1].any()
    assert pixels[0, 2, 3] == 0.5


# ---- in a stack -----------------------------------------------------------------------------


def test_a_stack_of_tinted_masks(tmp_path):
    """By both engines the same as of layers that have the colour already."""
    rng = np.random.default_rng(5)
    masks = [pngfile.Png(rng.integers(0, 256, (9, 7, 1)), pngfile.GREY, 8) for _ in range(2)]
    layers = []
    for number, (mask, tint) in enumerate(zip(masks, ("#e41a1c", "#fd0"), strict=True)):
        path = put(tmp_path / f"{number}.png", mask)
        layers.append(hpcomp.read_layer(path, tint=tint).pixels)
    expected = hpcomp.composite(layers, opacity=[1, 0.5])
    out = tmp_path / "out.exr"
    texts = [f"{tmp_path}/0.png::tint=#e41a1c", f"{tmp_path}/1.png::tint=#fd0,opacity=0.5"]
    hpcomp.stack(texts, out, depth="float")
    assert np.abs(hpcomp.read_layer(out).pixels - expected).max() <= 1e-6


def test_a_mask_with_a_tint_has_an_alpha_for_operators(tmp_path):
    """No warning that it has none."""
    base = put(tmp_path / "base.png", pngfile.random_png(pngfile.RGBA, 8))
    mask = put(tmp_path / "mask.png", pngfile.random_png(pngfile.GREY, 8))
    out = tmp_path / "out.exr"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hpcomp.stack([base, f"{mask}::tint=#fff,op=dst-in"], out, depth="float")
    coverage = tinted(mask)[..., 3:]
    expected = hpcomp.read_layer(base).pixels * coverage
    assert np.abs(hpcomp.read_layer(out).pixels - expected).max() <= 1e-6


def test_explain_shows_the_stored_value_and_the_colour(tmp_path):
    mask = pngfile.Png(np.full((2, 2, 1), 51), pngfile.GREY, 8)
    path = put(tmp_path / "mask.png", mask)
    step = hpcomp.explain([LayerSpec(str(path), tint=TINT)], (1, 1)).layers[0]
    assert step.stored == (51,)
    assert np.abs(np.array(step.rgba) - [*(0.2 * COLOR), 0.2]).max() <= FLOAT32


@pytest.mark.parametrize("text", ["redd", "#12345", "#gggggg", ""])
def test_a_tint_is_a_css_colour(text):
    with pytest.raises(SettingError, match=rf"^'{text}' is not a colour: write a CSS colour"):
        LayerSpec("a.png", tint=text)


def test_a_tint_has_no_alpha_of_its_own():
    with pytest.raises(SettingError, match=r"which opacity= lowers: write #377eb8$"):
        LayerSpec("a.png", tint="377eb8cc")


def test_a_colorspace_beside_a_tint_is_refused(tmp_path):
    with pytest.raises(SettingError, match="colorspace=linear changes nothing"):
        LayerSpec("a.png", tint=TINT, colorspace="linear")


def test_the_command_says_what_is_wrong(tmp_path):
    desk = command.Desk.made(tmp_path)
    put(desk / "a.png", pngfile.random_png(pngfile.RGB, 8))
    run = desk.run("stack", "a.png::tint=#fff", "-o", "out.png")
    assert run.code == 4
    assert "layer 0 (a.png): tint= is for grey masks, and pixel 0,0" in run.stderr
    run = desk.run("stack", "a.png::tint=blu", "-o", "out.png")
    assert run.code == 2
    assert "'blu' is not a colour: write a CSS colour such as #ff8800 or blue" in run.stderr


# ---- cutting a stack with a mask -----------------------------------------------------------------


@pytest.fixture
def feathered(tmp_path, monkeypatch):
    """In a folder with picture.png, of random colours, and feathered.png, every grey of 8 bits.

    What Pillow makes of them: the mask as the alpha of the picture.
    """
    monkeypatch.chdir(tmp_path)
    mask = np.tile(np.arange(256, dtype=np.uint8), (16, 1))
    colors = np.random.default_rng(7).integers(0, 256, (*mask.shape, 3), np.uint8)
    picture = Image.fromarray(colors)
    picture.save("picture.png")
    Image.fromarray(mask).save("feathered.png")
    picture.putalpha(Image.fromarray(mask))
    return np.array(picture)


def cut(keys):
    """The picture cut with the mask, RGBA of 8 bits as it is stored."""
    hpcomp.stack(["picture.png", f"feathered.png::{keys}"], "cut.png")
    return np.array(Image.open("cut.png"))


@pytest.mark.parametrize("tint", ["white", "#ffffff", "navy"])
@pytest.mark.parametrize("engine_name", engine.NAMES)
def test_a_tinted_mask_cuts_as_putalpha_does(feathered, monkeypatch, tint, engine_name):
    monkeypatch.setenv(engine.VARIABLE, engine_name)
    found = cut(f"op=dst-in,tint={tint}")
    assert np.array_equal(found[..., 3], feathered[..., 3])
    there = feathered[..., 3] > 0  # a PNG of hpcomp has no colour that is not seen
    assert np.array_equal(found[there], feathered[there])


def test_a_tinted_mask_cuts_out_what_putalpha_would_leave(feathered):
    found = cut("op=dst-out,tint=white")
    assert np.array_equal(found[..., 3], 255 - feathered[..., 3])


def test_a_mask_by_its_light_has_another_alpha(feathered):
    difference = np.abs(cut("op=dst-in,alpha=luminance") - feathered.astype(float))[..., 3]
    page = (Path(__file__).parents[2] / "man" / "hpcomp-files.7.md").read_text(encoding="utf-8")
    (said,) = re.findall(r"alpha differs by up to (\d+)\s+of 255", page)
    assert difference.max() == int(said)
