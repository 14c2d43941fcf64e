"""Working primaries: what luminance and hue are measured in, and what is converted to them."""

from __future__ import annotations

import itertools
import json
import os
import struct
import subprocess
import sys
import warnings
import zlib

import colour
import command
import exrfile
import numpy as np
import OpenEXR
import oracle
import pngfile
import pytest
from engines import composite_by

import hpcomp
from hpcomp import HpcompWarning, MismatchError, SettingError
from hpcomp.color import spaces
from hpcomp.color.matrices import RGB_TO_XYZ
from hpcomp.color.primaries import (
    D50_XYZ,
    D65,
    PRIMARIES,
    REC709_WEIGHTS,
    WORKING_PRIMARIES,
    Primaries,
    adaptation,
    conversion,
    to_xyz,
    white_xyz,
)
from hpcomp.color.quantization import Losses
from hpcomp.color.samples import Strip, encode
from hpcomp.engine import choice as engine
from hpcomp.options import stack_rules

#: The xy of SMPTE and ITU documents, as the fixtures have them: name here, name there.
NAMES = {"rec709": "rec709", "display-p3": "p3d65", "rec2020": "rec2020", "acescg": "ap1"}
IDS = {
    "rec709": "lin_rec709_scene",
    "display-p3": "lin_p3d65_scene",
    "rec2020": "lin_rec2020_scene",
    "acescg": "lin_ap1_scene",
}
FLOAT32 = 2e-6
ODD = Primaries("custom", (0.66, 0.31), (0.25, 0.64), (0.14, 0.05), (0.30, 0.32))


def xy(name):
    values = exrfile.PRIMARIES[NAMES[name]]
    return tuple(zip(values[::2], values[1::2], strict=True))


def literal_to_xyz(primaries, white):
    """RGB→XYZ, the white adapted to D65 by Bradford."""
    adapt = pngfile.bradford(pngfile.xyz_of(white), pngfile.xyz_of(pngfile.D65_XY))
    return adapt @ pngfile.rgb_to_xyz(primaries, white)


def literal(source, target):
    """From one to the other, by name."""
    (*a, white_a), (*b, white_b) = xy(source), xy(target)
    return np.linalg.inv(literal_to_xyz(b, white_b)) @ literal_to_xyz(a, white_a)


def converted(rgba, source, target):
    rgba = np.array(rgba, float)
    rgba[..., :3] = rgba[..., :3] @ literal(source, target).T
    return rgba


def layers_of(n, shape=(9, 7), seed=3):
    """Premultiplied RGBA inside the gamut of its primaries."""
    rng = np.random.default_rng(seed)
    found = rng.random((n, *shape, 4)).astype(np.float32)
    found[..., :3] *= found[..., 3:]
    return list(found)


def write(path, rgba, **options):
    planes = {name: rgba[..., i].copy() for i, name in enumerate("RGBA")}
    return exrfile.write(path, planes, **options)


def tagged(name):
    return {"chromaticities": exrfile.PRIMARIES[NAMES[name]]}


# ---- matrices -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_rgb_to_xyz(name):
    """Against colour-science and against the literal fixture; white is D65, whatever it was."""
    found = np.array(to_xyz(PRIMARIES[name]))
    *rgb, white = xy(name)
    assert np.abs(found - literal_to_xyz(rgb, white)).max() < 1e-12
    assert np.abs(found.sum(axis=1) - pngfile.xyz_of(pngfile.D65_XY)).max() < 1e-12
    theirs = colour.RGB_COLOURSPACES[
        {
            "rec709": "ITU-R BT.709",
            "display-p3": "Display P3",
            "rec2020": "ITU-R BT.2020",
            "acescg": "ACEScg",
        }[name]
    ]
    expected = colour.normalised_primary_matrix(theirs.primaries, theirs.whitepoint)
    if name == "acescg":
        expected = (
            colour.adaptation.matrix_chromatic_adaptation_VonKries(
                colour.xy_to_XYZ(theirs.whitepoint),
                colour.xy_to_XYZ(pngfile.D65_XY),
                transform="Bradford",
            )
            @ expected
        )
    assert np.abs(found - expected).max() < 1e-12


def colour_space(primaries):
    return colour.RGB_Colourspace(primaries.name, primaries.xy[:3], primaries.xy[3])


def colour_bradford(white, to_white):
    return colour.adaptation.matrix_chromatic_adaptation_VonKries(
        white, to_white, transform="Bradford"
    )


@pytest.mark.parametrize("name", RGB_TO_XYZ)
def test_a_constant_is_what_colour_science_computes(name):
    primaries = PRIMARIES[name]
    bradford = colour_bradford(white_xyz(primaries.white), white_xyz(D65))
    expected = bradford @ colour_space(primaries).matrix_RGB_to_XYZ
    assert np.abs(np.array(to_xyz(primaries)) - expected).max() < 1e-12


@pytest.mark.parametrize(("source", "target"), list(itertools.permutations(PRIMARIES, 2)))
def test_a_conversion_is_that_of_colour_science(source, target):
    source, target = PRIMARIES[source], PRIMARIES[target]
    expected = colour.matrix_RGB_to_RGB(colour_space(source), colour_space(target), "Bradford")
    assert np.abs(conversion(source, target) - expected).max() < 1e-12


@pytest.mark.parametrize("named", PRIMARIES)
def test_a_conversion_of_new_primaries_is_that_of_colour_science(named):
    known, new = (colour_space(primaries) for primaries in (PRIMARIES[named], ODD))
    found = conversion(PRIMARIES[named], ODD)
    assert np.abs(found - colour.matrix_RGB_to_RGB(known, new, "Bradford")).max() < 1e-12
    found = conversion(ODD, PRIMARIES[named])
    assert np.abs(found - colour.matrix_RGB_to_RGB(new, known, "Bradford")).max() < 1e-12


@pytest.mark.parametrize(
    ("white", "to_white"),
    list(itertools.product([D50_XYZ, white_xyz(D65), (0.98, 1, 1.18)], repeat=2)),
)
def test_an_adaptation_is_that_of_colour_science(white, to_white):
    expected = colour_bradford(white, to_white)
    assert np.abs(adaptation(white, to_white) - expected).max() < 1e-12


@pytest.mark.parametrize(("source", "target"), list(itertools.permutations(NAMES, 2)))
def test_conversions(source, target):
    found = conversion(PRIMARIES[source], PRIMARIES[target])
    assert np.abs(found - literal(source, target)).max() < 1e-9
    # Grey is neutral: white to white.
    assert np.abs(found.sum(axis=1) - 1).max() < 1e-12
    back = conversion(PRIMARIES[target], PRIMARIES[source])
    assert np.abs(found @ back - np.eye(3)).max() < 1e-9


def test_aces_to_rec709_is_the_published_matrix():
    """As in the ACES documents, by Bradford from their white to D65."""
    published = [
        [1.7050510, -0.6217921, -0.0832589],
        [-0.1302564, 1.1408047, -0.0105483],
        [-0.0240034, -0.1289690, 1.1529724],
    ]
    assert np.abs(conversion(PRIMARIES["acescg"], PRIMARIES["rec709"]) - published).max() < 2e-5


def test_the_same_primaries_are_no_conversion():
    same = Primaries("other name", *(tuple(row) for row in ODD.xy.tolist()))
    assert conversion(PRIMARIES["acescg"], PRIMARIES["acescg"]) is None
    assert np.abs(conversion(ODD, same) - np.eye(3)).max() < 1e-12


def test_colour_science_is_imported_for_new_chromaticities_alone(tmp_path):
    write(tmp_path / "a.exr", layers_of(1)[0], **tagged("rec2020"))
    write(tmp_path / "new.exr", layers_of(1)[0], chromaticities=tuple(ODD.xy.ravel().tolist()))
    for name, version in (("rec709", 4), ("display-p3", 4), ("adobe-rgb", 2)):
        png = pngfile.random_png(pngfile.RGBA, 8, width=7, height=9)
        profile = pngfile.icc_profile(name, PRIMARIES[name].rgb, version=version)
        png = png.with_chunks(head=[pngfile.iccp(profile)])
        (tmp_path / f"{name}.png").write_bytes(png.encode())
    code = (
        "import sys, hpcomp\n"
        "layers = ['a.exr', 'rec709.png', 'display-p3.png', 'adobe-rgb.png']\n"
        f"for name in {(*WORKING_PRIMARIES, 'bottom')}:\n"
        "    hpcomp.stack(layers, 'out.exr', primaries=name, report='out.json')\n"
        "    for gamut in ('rec709', 'display-p3', 'rec2020'):\n"
        "        hpcomp.stack(layers, 'out.png', primaries=name, out_primaries=gamut)\n"
        "assert 'colour' not in sys.modules\n"
        "hpcomp.stack([*layers, 'new.exr'], 'out.exr')\n"
        "assert 'colour' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True, cwd=tmp_path)


# ---- luminance and hue follow ---------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_weights_are_those_of_the_primaries(name):
    *rgb, white = xy(name)
    weights = literal_to_xyz(rgb, white)[1]
    rules = stack_rules(2, primaries=name)
    luminance, p = rules.space.forward(np.eye(3))
    assert np.abs(luminance - weights).max() < 1e-12
    _, p = rules.space.forward(np.ones((3, 1)))
    assert not p.any()


@pytest.mark.pairwise
@pytest.mark.parametrize("order", ["bottom-up", "top-down", "balanced", "simultaneous"])
@pytest.mark.parametrize("name", NAMES)
def test_composites_are_those_of_the_oracle(name, order, monkeypatch, composite):
    """Algorithm 1 with other weights, by both engines."""
    *rgb, white = xy(name)
    monkeypatch.setattr(oracle, "WEIGHTS", tuple(literal_to_xyz(rgb, white)[1]))
    layers = layers_of(3, (6, 5))
    found = composite(layers, primaries=name, order=order)
    for place in itertools.product(range(6), range(5)):
        expected = oracle.composite([layer[place].tolist() for layer in layers], order=order)
        assert np.abs(found[place] - expected).max() < 2e-5


@pytest.mark.parametrize("space", spaces.SPACES)
@pytest.mark.parametrize("name", NAMES)
def test_luminance_adds_and_greys_are_neutral(name, space):
    *rgb, white = xy(name)
    weights = literal_to_xyz(rgb, white)[1]
    a, b = (layer[..., :3].astype(float) for layer in layers_of(2))
    found = hpcomp.hue_add(a, b, space=space, primaries=name)
    assert np.abs(found @ weights - (a + b) @ weights).max() < 1e-9
    grey = hpcomp.hue_add([0.25] * 3, [0.5] * 3, space=space, primaries=name)
    assert np.abs(grey - 0.75).max() < 1e-7


def test_the_same_light_in_other_primaries_blends_otherwise():
    """Hue is not that of Rec. 709: else there would be no choice to make."""
    layers = layers_of(2)
    wide = [converted(layer, "rec709", "rec2020") for layer in layers]
    found = converted(hpcomp.composite(wide, primaries="rec2020"), "rec2020", "rec709")
    assert np.abs(found - hpcomp.composite(layers)).max() > 0.01
    plain = hpcomp.composite(wide, primaries="rec2020", blending="traditional")
    expected = hpcomp.composite(layers, blending="traditional")
    assert np.abs(converted(plain, "rec2020", "rec709") - expected).max() < 1e-6


@pytest.mark.parametrize("wrong", ["bottom", "p3", "aces2065-1"])
def test_arrays_have_primaries_with_a_name(wrong):
    with pytest.raises(SettingError, match=r"(?=.*rec709)(?=.*acescg)"):
        hpcomp.composite(layers_of(2), primaries=wrong)


# ---- stacks of files ------------------------------------------------------------------------


@pytest.fixture
def mixed(tmp_path):
    """Layers in three primaries, and what they are in Rec. 709."""
    sources = ["acescg", "display-p3", "rec709"]
    layers = layers_of(3)
    paths = [
        write(tmp_path / f"{source}.exr", layer, **tagged(source))
        for source, layer in zip(sources, layers, strict=True)
    ]
    return paths, layers, sources


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("engine_name", engine.NAMES)
def test_layers_are_converted_to_the_working_primaries(
    tmp_path, mixed, name, engine_name, monkeypatch
):
    monkeypatch.setenv(engine.VARIABLE, engine_name)
    paths, layers, sources = mixed
    inside = [converted(layer, source, name) for layer, source in zip(layers, sources, strict=True)]
    out = tmp_path / "out.exr"
    hpcomp.stack(paths, out, depth="float", primaries=name)
    found = exrfile.layer(exrfile.read_back(out))
    expected = composite_by("reference", inside, primaries=name)
    assert np.abs(found - expected).max() < 1e-4
    # As one that reads the tag sees it.
    read = hpcomp.read_layer(out, primaries=name).pixels
    assert np.array_equal(read, found.astype(np.float32))


@pytest.mark.parametrize("compression", ["zip", "piz"])
@pytest.mark.parametrize("name", NAMES)
def test_an_exr_says_which_they_are(tmp_path, mixed, name, compression):
    out = tmp_path / "out.exr"
    hpcomp.stack(mixed[0], out, primaries=name, compression=compression)
    with OpenEXR.File(str(out), header_only=True) as file:
        header = dict(file.header())
    assert np.abs(np.array(header["chromaticities"]) - np.ravel(xy(name))).max() < 1e-6
    assert header["colorInteropID"] == IDS[name]
    assert hpcomp.info(out).parts[0].encoding.primaries.name == name


@pytest.mark.parametrize("name", NAMES)
def test_what_is_in_the_working_primaries_is_not_touched(tmp_path, name):
    """No matrix there and back: the bits stay."""
    layer = layers_of(1)[0]
    path = write(tmp_path / "a.exr", layer, colorInteropID=IDS[name])
    out = tmp_path / "out.exr"
    hpcomp.stack([path], out, depth="float", primaries=name, blending="traditional")
    once = exrfile.layer(exrfile.read_back(out))
    assert np.abs(once - layer).max() < 1e-6
    hpcomp.stack([path], out, depth="float", primaries="bottom", blending="traditional")
    assert np.array_equal(exrfile.layer(exrfile.read_back(out)), once)


def test_those_of_the_bottom_layer(tmp_path, mixed):
    """Even where they have no name: then the numbers alone are written."""
    paths, layers, sources = mixed
    out, named = tmp_path / "out.exr", tmp_path / "named.exr"
    hpcomp.stack(paths, out, primaries="bottom", background="#4080c0")
    hpcomp.stack(paths, named, primaries=sources[0], background="#4080c0")
    assert out.read_bytes() == named.read_bytes()

    odd = write(tmp_path / "odd.exr", layers[0], chromaticities=tuple(ODD.xy.ravel()))
    hpcomp.stack([odd, *paths[1:]], out, primaries="bottom", depth="float")
    with OpenEXR.File(str(out), header_only=True) as file:
        header = dict(file.header())
    assert np.abs(np.array(header["chromaticities"]) - ODD.xy.ravel()).max() < 1e-6
    assert "colorInteropID" not in header
    # Plain + is the same light in all primaries.
    hpcomp.stack([odd, *paths[1:]], out, primaries="bottom", depth="float", blending="traditional")
    hpcomp.stack([odd, *paths[1:]], named, depth="float", blending="traditional")
    light, same = (hpcomp.read_layer(path).pixels for path in (out, named))
    assert np.abs(light - same).max() < 1e-5


def test_colorspace_decides_what_the_bottom_has(tmp_path, mixed):
    out = tmp_path / "out.exr"
    hpcomp.stack([f"{mixed[0][2]}::colorspace=linear-rec2020"], out, primaries="bottom")
    assert hpcomp.info(out).parts[0].encoding.primaries.name == "rec2020"


def test_primaries_of_negative_luminance_are_refused(tmp_path):
    """The blue of ACES 2065-1 is no colour that there is."""
    path = write(tmp_path / "ap0.exr", layers_of(1)[0], chromaticities=exrfile.PRIMARIES["ap0"])
    with pytest.raises(MismatchError, match=r"aces2065-1.*--primaries"):
        hpcomp.stack([path], tmp_path / "out.exr", primaries="bottom")
    hpcomp.stack([path], tmp_path / "out.exr", primaries="acescg")


@pytest.mark.parametrize("name", NAMES)
def test_hex_colours_are_srgb_in_all_primaries(tmp_path, name):
    clear = write(tmp_path / "clear.exr", np.zeros((2, 2, 4), np.float32))
    out = tmp_path / "out.exr"
    expected = [*pngfile.srgb_to_linear(np.array([0x37, 0x7E, 0xB8]) / 255), 1]
    hpcomp.stack([clear], out, depth="float", primaries=name, background="#377eb8")
    assert np.abs(hpcomp.read_layer(out).pixels - expected).max() < FLOAT32
    mask = tmp_path / "mask.png"
    mask.write_bytes(pngfile.Png(np.full((2, 2, 1), 255), pngfile.GREY, 8).encode())
    hpcomp.stack([f"{mask}::tint=#377eb8"], out, depth="float", primaries=name)
    assert np.abs(hpcomp.read_layer(out).pixels - expected).max() < FLOAT32


@pytest.mark.parametrize("name", NAMES)
def test_alpha_of_luminance_is_that_of_the_primaries(tmp_path, name):
    png = pngfile.random_png(pngfile.RGB, 8)
    path = tmp_path / "a.png"
    path.write_bytes(png.encode())
    found = hpcomp.read_layer(path, alpha="luminance", primaries=name).pixels
    light = converted(png.linear(), "rec709", name)[..., :3]
    *rgb, white = xy(name)
    assert np.abs(found[..., 3] - light @ literal_to_xyz(rgb, white)[1]).max() < FLOAT32


def test_pictures_written_from_arrays(tmp_path):
    layer = layers_of(1)[0]
    out = tmp_path / "out.exr"
    hpcomp.write_image(out, layer, depth="float", primaries="acescg")
    assert np.array_equal(hpcomp.read_layer(out, primaries="acescg").pixels, layer)
    found = hpcomp.read_layer(out).pixels
    assert np.abs(found - converted(layer, "acescg", "rec709")).max() < FLOAT32


# ---- PNG ------------------------------------------------------------------------------------


def coded(rgba, name, kind, engine_name, losses):
    """Codes of Rec. 709 by that engine."""
    rules = stack_rules(1, primaries=name)
    engines = {"kernel": engine._kernel(), "reference": engine.reference_engine()}
    accumulator = engines[engine_name].start(rules, rgba.shape[1], rgba.shape[0])
    accumulator.add([0], [Strip(rgba)])
    return accumulator.result(kind, losses)


@pytest.mark.skipif(engine._kernel() is None, reason="the kernel was not built")
@pytest.mark.parametrize("kind", ["uint8", "uint16"])
@pytest.mark.parametrize("name", NAMES)
def test_engines_agree_on_codes(name, kind):
    rgba = np.concatenate([*layers_of(40), *(4 * layer for layer in layers_of(2, seed=5))])
    rgba[..., 3] = np.clip(rgba[..., 3], 0, 1)
    losses = Losses(), Losses()
    found, expected = (
        coded(rgba, name, kind, engine_name, lost).astype(int)
        for engine_name, lost in zip(engine.NAMES, losses, strict=True)
    )
    assert np.abs(found - expected).max() <= 1
    assert (found != expected).mean() < (1e-3 if kind == "uint8" else 0.05)
    assert abs(losses[0].out_of_gamut - losses[1].out_of_gamut) <= 1
    assert losses[0].out_of_gamut > 0


@pytest.mark.parametrize("name", ["display-p3", "acescg"])
def test_a_png_is_of_srgb(tmp_path, name, mixed):
    """Inside its gamut colours are what an EXR says, to half a code."""
    out, exr = tmp_path / "out.png", tmp_path / "out.exr"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HpcompWarning)
        hpcomp.stack(mixed[0], out, primaries=name)
    hpcomp.stack(mixed[0], exr, primaries=name, depth="float")
    light = hpcomp.read_layer(exr).pixels.astype(float)
    straight = light[..., :3] / light[..., 3:]
    inside = (straight >= 0).all(axis=-1) & (straight <= 1).all(axis=-1)
    codes = pngfile.decode(out.read_bytes())[..., :3]
    expected = pngfile.linear_to_srgb(np.clip(straight, 0, 1)) * 255
    assert inside.sum() > 20
    assert np.abs(codes - expected)[inside].max() < 0.5 + 1e-3


def test_outside_it_luminance_and_hue_stay():
    """Those of the output: its grey axis, its weights."""
    green = np.array([[[0.0, 1.0, 0.0, 1.0]]], np.float32)
    losses = Losses()
    codes = encode(green, "uint16", losses, PRIMARIES["rec2020"], PRIMARIES["rec709"])[0, 0, :3]
    assert losses.out_of_gamut == 1
    light = np.linalg.inv(literal("rec709", "rec2020")) @ [0, 1, 0]
    weights = np.array(REC709_WEIGHTS)
    found = pngfile.srgb_to_linear(codes / 65535)
    assert abs(found @ weights - light @ weights) < 1e-4
    d1, d2 = found - found @ weights, light - light @ weights
    assert abs(d1 @ d2 / np.linalg.norm(d1) / np.linalg.norm(d2) - 1) < 1e-6


# ---- what tells of a stack ------------------------------------------------------------------


def test_explain_is_of_the_working_primaries(mixed):
    paths, layers, sources = mixed
    found = hpcomp.explain([os.fspath(p) for p in paths], (3, 4), primaries="rec2020")
    inside = [converted(a[4, 3], s, "rec2020") for a, s in zip(layers, sources, strict=True)]
    for step, rgba in zip(found.layers, inside, strict=True):
        assert np.abs(np.array(step.rgba) - rgba).max() < 1e-5
    expected = composite_by("reference", [c[None] for c in inside], primaries="rec2020")[0]
    assert np.abs(np.array(found.result.rgba) - expected).max() < 1e-4
    assert found.rules.primaries.name == "rec2020"
    bottom = hpcomp.explain([os.fspath(p) for p in paths], (3, 4), primaries="bottom")
    assert bottom.rules.primaries.name == "acescg"


def test_check_measures_in_the_working_primaries(tmp_path, mixed):
    """A hue is foreign in none of them, since grey is the same grey; chroma is another."""
    paths, layers, sources = mixed
    out = tmp_path / "out.exr"
    hpcomp.stack(paths, out, depth="float", primaries="acescg")
    shares = {}
    for name in ("acescg", "bottom", "rec709"):
        found = hpcomp.check(out, paths, max_foreign=0, primaries=name)
        assert found.passed
        shares[name] = found.grey_share
    assert shares["acescg"] == shares["bottom"]
    inside = [converted(a, s, "acescg") for a, s in zip(layers, sources, strict=True)]
    lost = hpcomp.stack_measures(inside, primaries="acescg").result.lost
    assert abs(shares["acescg"] - lost) < 1e-3
    assert abs(shares["rec709"] - lost) > 5e-3


def test_a_palette_is_of_srgb():
    with pytest.raises(SettingError, match="'primaries' says nothing of a palette"):
        hpcomp.palette(["#f00", "#00f"], primaries="acescg")


def test_a_list_of_hues_has_no_bottom(tmp_path, mixed):
    with pytest.raises(SettingError, match="primaries 'bottom'"):
        hpcomp.check(mixed[0][0], hues="0", max_foreign=0, primaries="bottom")


@pytest.mark.parametrize("space", spaces.SPACES)
def test_reports_of_both_engines(mixed, space, monkeypatch, tmp_path):
    found = []
    for name in engine.NAMES:
        monkeypatch.setenv(engine.VARIABLE, name)
        out, report = tmp_path / "out.exr", tmp_path / "out.json"
        measures = hpcomp.stack(
            mixed[0], out, primaries="display-p3", space=space, report=report
        ).findings.measures
        assert json.loads(report.read_text())["settings"]["primaries"] == "display-p3"
        found.append([measures.result.lost, measures.traditional.lost, measures.result.chroma])
    assert np.allclose(*found, rtol=1e-4)


# ---- the command ----------------------------------------------------------------------------


def test_the_command(tmp_path, mixed):
    desk = command.Desk.made(tmp_path)
    for path in mixed[0]:
        desk.put(path.name, path.read_bytes())
    names = [path.name for path in mixed[0]]
    desk.makes("stack", *names, "-o", "out.exr", "--primaries", "bottom")
    text = desk.makes("info", "out.exr").stdout.decode()
    assert "acescg" in text
    assert "colorInteropID" in text
    text = desk.makes("explain", *names, "--at", "1,1", "--primaries", "rec2020").stdout.decode()
    assert "primaries rec2020" in text
    run = desk.run("stack", *names, "-o", "out.exr", "--primaries", "p3")
    assert run.code == 2
    for name in (*WORKING_PRIMARIES, "bottom"):
        assert name in run.stderr


# ---- PNG in other primaries -----------------------------------------------------------------

#: ITU-T H.273: the code point, and the xy of its primaries.
WIDE = {"display-p3": (12, "display-p3"), "rec2020": (9, "rec2020")}


def chunks_of(path):
    return dict(pngfile.split(path.read_bytes()))


@pytest.mark.parametrize("name", WIDE)
@pytest.mark.parametrize("depth", [8, 16])
def test_a_wide_png_says_so_in_every_way_there_is(tmp_path, mixed, name, depth):
    out = tmp_path / "out.png"
    hpcomp.stack(mixed[0][2:], out, out_primaries=name, depth=depth)
    chunks = chunks_of(out)
    assert chunks[b"cICP"] == bytes([WIDE[name][0], 13, 0, 1])
    assert b"sRGB" not in chunks
    *rgb, white = xy(name)
    assert (b"cHRM", chunks[b"cHRM"]) == pngfile.chrm(white, *rgb)
    kinds = [kind for kind, _ in pngfile.split(out.read_bytes())]
    assert kinds[:6] == [b"IHDR", b"cICP", b"iCCP", b"gAMA", b"cHRM", b"IDAT"]
    part = hpcomp.info(out).parts[0]
    assert (str(part.encoding), part.color.transfer_from) == (f"sRGB, {name}", "cICP")
    assert part.icc_profile == f"{name}, sRGB curve"
    # Without the first, each of the others says the same.
    for gone, curve in ((b"cICP",), "sRGB"), ((b"cICP", b"iCCP"), "gamma 2.2"):
        data = out.read_bytes()
        for kind in gone:
            data = pngfile.replace_chunk(data, kind, None)
        (tmp_path / "less.png").write_bytes(data)
        assert str(hpcomp.info(tmp_path / "less.png").parts[0].encoding) == f"{curve}, {name}"


@pytest.mark.parametrize("name", WIDE)
def test_its_profile_is_that_of_the_fixture(tmp_path, mixed, name):
    """Tag by tag, to the rounding of its numbers, and with nothing of the day it was made."""
    out = tmp_path / "out.png"
    hpcomp.stack(mixed[0][2:], out, out_primaries=name)
    data = zlib.decompress(chunks_of(out)[b"iCCP"].partition(b"\0")[2][1:])
    *rgb, white = xy(name)
    expected = pngfile.icc_profile("any", rgb, white=white)
    assert int.from_bytes(data[:4], "big") == len(data)
    assert len(data) % 4 == 0
    assert data[24:36] == bytes(12)
    for place in (slice(8, 24), slice(36, 40), slice(68, 80)):
        assert data[place] == expected[place]

    def tags(profile):
        count = int.from_bytes(profile[128:132], "big")
        rows = (
            struct.unpack(">4sII", profile[i : i + 12]) for i in range(132, 132 + 12 * count, 12)
        )
        return {name: profile[at : at + size] for name, at, size in rows}

    found, wanted = tags(data), tags(expected)
    assert found.keys() == wanted.keys()
    for tag in found.keys() - {b"desc", b"cprt"}:
        numbers = [np.frombuffer(t[tag][8:], ">i4") for t in (found, wanted)]
        assert found[tag][:8] == wanted[tag][:8]
        assert np.abs(numbers[0] - numbers[1]).max() <= 1


@pytest.mark.pairwise
@pytest.mark.parametrize("engine_name", engine.NAMES)
@pytest.mark.parametrize("working", [*NAMES, "bottom"])
@pytest.mark.parametrize("name", WIDE)
@pytest.mark.parametrize("depth", [8, 16])
def test_a_wide_png_composited_with_nothing(
    tmp_path, name, depth, working, engine_name, monkeypatch
):
    """Comes back equal within one step, whatever it was blended in."""
    monkeypatch.setenv(engine.VARIABLE, engine_name)
    png = pngfile.random_png(pngfile.RGBA, depth).with_chunks(
        head=[pngfile.cicp(WIDE[name][0], 13)]
    )
    png.samples[..., 3] |= 1 << (depth - 1)
    path, out = tmp_path / "a.png", tmp_path / "out.png"
    path.write_bytes(png.encode())
    hpcomp.stack([path], out, out_primaries=name, primaries=working, depth=depth, strict=True)
    found = pngfile.decode(out.read_bytes()).astype(int)
    assert np.abs(found - png.samples).max() <= 1


def test_another_curve_comes_back_as_the_same_light(tmp_path):
    """That of BT.2020 is written on the curve of sRGB: equal within one step of that."""
    png = pngfile.random_png(pngfile.RGB, 16).with_chunks(head=[pngfile.cicp(9, 14)])
    path, out = tmp_path / "a.png", tmp_path / "out.png"
    path.write_bytes(png.encode())
    hpcomp.stack([path], out, out_primaries="rec2020", depth=16, strict=True)
    light = hpcomp.read_layer(path, primaries="rec2020").pixels[..., :3]
    codes = pngfile.decode(out.read_bytes())[..., :3]
    assert np.abs(codes - 65535 * pngfile.linear_to_srgb(light)).max() <= 1


@pytest.mark.skipif(engine._kernel() is None, reason="the kernel was not built")
@pytest.mark.parametrize("gamut", WIDE)
@pytest.mark.parametrize("name", NAMES)
def test_engines_agree_on_codes_of_wide_gamuts(name, gamut):
    rgba = np.concatenate([*layers_of(20), *(3 * layer for layer in layers_of(2, seed=5))])
    rgba[..., 3] = np.clip(rgba[..., 3], 0, 1)
    found = []
    for by in (engine._kernel(), engine.reference_engine()):
        accumulator = by.start(stack_rules(1, primaries=name), rgba.shape[1], rgba.shape[0])
        accumulator.add([0], [Strip(rgba)])
        found.append(accumulator.result("uint8", Losses(), PRIMARIES[gamut]).astype(int))
    assert np.abs(found[0] - found[1]).max() <= 1
    assert (found[0] != found[1]).mean() < 1e-3


def test_pictures_of_arrays_in_wide_png(tmp_path):
    layer = np.full((4, 5, 4), [0.25, 0.5, 0.0625, 1.0], np.float32)
    out = tmp_path / "out.png"
    hpcomp.write_image(out, layer, primaries="display-p3", out_primaries="display-p3")
    codes = pngfile.decode(out.read_bytes())[0, 0, :3]
    assert codes.tolist() == np.rint(255 * pngfile.linear_to_srgb(layer[0, 0, :3])).tolist()
    hpcomp.write_image(out, layer, out_primaries="rec709")
    assert b"sRGB" in chunks_of(out)


def test_an_exr_takes_no_out_primaries(tmp_path, mixed):
    with pytest.raises(SettingError, match="--primaries instead"):
        hpcomp.stack(mixed[0], tmp_path / "out.exr", out_primaries="display-p3")
    with pytest.raises(SettingError, match=r"(?=.*rec709)(?=.*display-p3)(?=.*rec2020)"):
        hpcomp.stack(mixed[0], tmp_path / "out.png", out_primaries="acescg")
