"""`hpcomp check`: pictures against their layers or against hues, and what rounding excuses."""

import dataclasses
import itertools
import json
import logging
import re
import warnings
from pathlib import Path

import exrfile
import numpy as np
import pytest
from command import Desk
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from strategies import color_of

import hpcomp
from hpcomp.analysis import check as analysis
from hpcomp.color.encodings import SRGB_ENCODING
from hpcomp.color.samples import PLAIN, Decoding
from hpcomp.color.spaces import SPACES
from hpcomp.color.transfer import SRGB
from hpcomp.errors import MismatchError, SettingError
from hpcomp.report import check as report

SPACE = SPACES["linear-rgb"]
SIZE = 64, 48
STRAIGHT = Decoding(SRGB_ENCODING, "straight", stored_straight=True)

#: Every way in which hpcomp writes a picture.
FORMS = [("png", 8), ("png", 16), ("exr", "half"), ("exr", "float")]


def translucent(color, random, size=SIZE):
    alpha = random.random((*size[::-1], 1)) * (random.random((*size[::-1], 1)) > 0.2)
    return np.concatenate([alpha * np.array(color), alpha], axis=2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three labels at random opacities, over grey and over nothing."""
    path = tmp_path_factory.mktemp("layers")
    random = np.random.default_rng(4)
    grey = np.repeat(random.random((*SIZE[::-1], 1)), 3, axis=2)
    hpcomp.write_image(path / "base.png", np.concatenate([grey, np.ones((*SIZE[::-1], 1))], axis=2))
    for name, color in (("red", (0.9, 0.1, 0.1)), ("green", (0.1, 0.8, 0.1)), ("blue", (0.1, 0.2, 0.9))):
        hpcomp.write_image(path / f"{name}.exr", translucent(color, random), depth="float")
    return path


@pytest.fixture
def layers(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return ["red.exr", "green.exr", "blue.exr"]


# ---- its own layers ------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["bottom-up", "top-down", "simultaneous"])
@pytest.mark.parametrize("form", FORMS, ids=str)
def test_what_hpcomp_writes_has_no_foreign_hue(layers, form, order):
    ending, depth = form
    for stack, more in ((layers, {}), (["base.png", *layers], {}), (layers, {"background": "#3355aa"})):
        hpcomp.stack(stack, f"out.{ending}", depth=depth, order=order, **more)
        found = hpcomp.check(f"out.{ending}", stack, max_foreign=0, **more)
        assert found.passed
        assert found.sums.foreign == 0
        assert found.sums.chromatic > 0.5 * found.sums.pixels
        assert found.sums.pixels == SIZE[0] * SIZE[1]


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_traditional_blending_fails(layers, form):
    ending, depth = form
    hpcomp.stack(layers, f"plain.{ending}", depth=depth, blending="traditional")
    found = hpcomp.check(f"plain.{ending}", layers, max_foreign="50%")
    assert not found.passed
    # The share is that of the measures, which know nothing of files.
    measured = hpcomp.stack_measures([hpcomp.read_layer(name).pixels for name in layers])
    assert found.foreign_share == pytest.approx(measured.traditional.foreign_share, abs=0.05)
    assert found.foreign_chroma_share == pytest.approx(
        measured.traditional.foreign_chroma_share, abs=0.05
    )


def test_what_is_lost_to_grey_is_what_the_measures_say(layers):
    hpcomp.stack(layers, "float.exr", depth="float")
    found = hpcomp.check("float.exr", layers, max_gray=1)
    measured = hpcomp.stack_measures([hpcomp.read_layer(name).pixels for name in layers])
    assert found.grey_share == pytest.approx(measured.result.lost, abs=1e-6)
    assert found.sums.chromatic == measured.result.chromatic
    for seen, layer in zip(found.sums.labels, measured.result.layers, strict=True):
        assert seen.pixels == layer.pixels
        assert seen.shown == layer.survived
        assert seen.visible == layer.visible
    assert found.visible_share == measured.result.visible_share
    assert not hpcomp.check("float.exr", layers, max_gray=measured.result.lost - 1e-3).passed
    assert hpcomp.check("float.exr", layers, max_gray=measured.result.lost + 1e-3).passed


@given(st.integers(0, 2**31), st.sampled_from(FORMS), st.sampled_from((2.0, 0.0)), st.booleans())
@settings(max_examples=30)
def test_any_correct_picture_passes(tmp_path_factory, seed, form, hue_tolerance, faint):
    """Dark, pale and nearly transparent labels: rounding turns their hues the most."""
    folder = tmp_path_factory.mktemp("any")
    random = np.random.default_rng(seed)
    stack = []
    for number, place in enumerate(random.permutation(9)[:3]):
        hue = 40 * place + random.uniform(-8, 8)
        gain = 0.02 if faint else 1.0
        color = np.clip(color_of(hue, gain * random.uniform(0.05, 0.3), gain * random.uniform(0.05, 0.6)), 0, 1)
        stack.append(str(folder / f"{number}.exr"))
        hpcomp.write_image(stack[-1], translucent(color, random, (31, 17)), depth="float")
    ending, depth = form
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", hpcomp.HpcompWarning)
        hpcomp.stack(stack, folder / f"out.{ending}", depth=depth, hue_tolerance=hue_tolerance)
    # Clipped at black or white a label is of another hue: its own, as it is stored, is what counts.
    found = hpcomp.check(str(folder / f"out.{ending}"), stack, max_foreign=0, hue_tolerance=hue_tolerance)
    assert found.sums.foreign == 0


def test_exposure_is_part_of_the_picture(layers):
    hpcomp.stack(layers, "dark.exr", depth="float", exposure=-3)
    same = hpcomp.check("dark.exr", layers, max_gray=1, exposure=-3)
    hpcomp.stack(layers, "float.exr", depth="float")
    assert same.grey_share == pytest.approx(hpcomp.check("float.exr", layers, max_gray=1).grey_share, abs=1e-4)
    assert hpcomp.check("dark.exr", layers, max_gray=1).grey_share > same.grey_share


def test_strips_and_threads_do_not_show(layers, monkeypatch, caplog):
    """Blocks are of whole rows, or of parts of one."""
    caplog.set_level(logging.INFO, "hpcomp")
    asked = {"max_foreign": 1, "require_hue": ["20"], "min_visible": 0.9, "canvas": "70x48-3-5"}
    hpcomp.stack(layers, "out.png", blending="traditional", canvas=asked["canvas"])
    whole = hpcomp.check("out.png", layers, **asked)
    assert "checking 70x48-3-5 in strips of 64 rows" in caplog.text
    monkeypatch.setattr(analysis, "STRIP_ROWS", 1)
    for rows, block, threads in itertools.product((16, 32), (30, 300), (1, 2)):
        monkeypatch.setattr(analysis, "STRIP_PIXELS", rows * 70)
        monkeypatch.setattr(analysis, "BLOCK_PIXELS", block)
        caplog.clear()
        assert hpcomp.check("out.png", layers, threads=threads, **asked) == whole
        assert f"in strips of {rows} rows, {threads} threads" in caplog.text


def test_memory_does_not_show(layers, monkeypatch, caplog):
    """The least there must be leaves one thread, and one compression block at a time."""
    caplog.set_level(logging.INFO, "hpcomp")
    hpcomp.stack(layers, "out.png", blending="traditional")
    for against in ({"layers": layers}, {"hues": "0,120,240"}):
        whole = hpcomp.check("out.png", **against, max_foreign=1)
        with pytest.raises(MismatchError, match=r"this check needs at least \d+M.*--max-memory") as refusal:
            hpcomp.check("out.png", **against, max_foreign=1, threads=3, max_memory="64K")
        least = re.search(r"at least (\d+M)", str(refusal.value))[1]
        caplog.clear()
        assert hpcomp.check("out.png", **against, max_foreign=1, threads=3, max_memory=least) == whole
        assert "rows, 1 threads" in caplog.text


def test_many_layers_are_measured_in_small_blocks(layers):
    """Their number decides how much is read, and not how much is measured at a time."""
    hpcomp.stack(layers * 70, "out.png", order="top-down")
    found = hpcomp.check("out.png", layers * 70, max_foreign=0, threads=1, max_memory="48M")
    assert found.passed


def test_operators_and_opacities_weigh_the_layers(layers):
    weighed = ["red.exr", "green.exr::op=atop,opacity=0.5", "blue.exr::op=xor"]
    hpcomp.stack(weighed, "out.exr", depth="float", op="plus")
    assert hpcomp.check("out.exr", weighed, max_foreign=0, op="plus").passed
    hpcomp.stack(["red.exr::opacity=0"], "none.exr")
    assert not hpcomp.check("blue.exr", ["red.exr::opacity=0", "green.exr"], max_foreign="1%").passed


# ---- where the picture lies ----------------------------------------------------------------------


def test_a_region_is_checked_where_it_was_cut(layers):
    region = hpcomp.Window(10, 5, 20, 30)
    hpcomp.stack(layers, "part.png", region=region)
    hpcomp.stack(layers, "part.exr", region=region)
    assert hpcomp.check("part.exr", layers, max_foreign=0).sums.pixels == 600
    assert hpcomp.check("part.png::at=+10+5", layers, max_foreign=0).sums.pixels == 600
    with pytest.raises(MismatchError, match=r"picture \(part.png\) is 20x30.*64x48.*at="):
        hpcomp.check("part.png", layers, max_foreign=0)


def test_a_png_lies_where_its_canvas_was(layers):
    canvas = "40x30+8+4"
    hpcomp.stack(layers, "canvas.png", canvas=canvas)
    assert hpcomp.check("canvas.png", layers, max_foreign=0, canvas=canvas).sums.pixels == 1200


def test_overscan_is_checked_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data, display = hpcomp.Window(-3, -2, 12, 9), hpcomp.Window(0, 0, 5, 5)
    for name, color in (("one.exr", (0.8, 0.1, 0.1)), ("two.exr", (0.1, 0.7, 0.1))):
        pixels = np.empty((9, 12, 4))
        pixels[:] = (*(0.5 * np.array(color)), 0.5)
        hpcomp.write_image(name, pixels, data_window=data, display_window=display)
    hpcomp.stack(["one.exr", "two.exr"], "out.exr", overscan=True)
    found = hpcomp.check("out.exr", ["one.exr", "two.exr"], max_foreign=0)
    assert (found.passed, found.sums.pixels, found.sums.chromatic) == (True, 108, 108)


# ---- what rounding can turn ----------------------------------------------------------------------


def p_of_codes(codes, largest, alpha=1.0):
    return SPACE.forward(alpha * SRGB.decode(np.asarray(codes, float).T / largest))[1]


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_quantisation_is_the_farthest_corner_of_half_a_code(kind):
    random = np.random.default_rng(8)
    largest = np.iinfo(kind).max
    samples = random.integers(0, largest + 1, (200, 4)).astype(kind)
    reach = analysis.quantization(samples, STRAIGHT, SPACE)
    alpha = samples[:, 3] / largest
    center = p_of_codes(samples[:, :3], largest, alpha)
    expected = np.zeros(200)
    for corner in itertools.product((-0.5, 0.5), repeat=3):
        away = p_of_codes(samples[:, :3] + np.array(corner), largest, alpha) - center
        expected = np.maximum(expected, np.hypot(*away))
    assert np.all(reach >= expected)
    assert np.all(reach <= expected + 1e-6 + 1e-4 * expected)


def test_quantisation_of_floats():
    half = np.array([[1.0, 0.5, 0.25, 1.0], [0.0, 0.0, 0.0, 1.0]], np.float16)
    reach = analysis.quantization(half, PLAIN, SPACE)
    color = np.array([[1.0], [0.5], [0.25]])
    steps = np.array([[2.0**-10], [2.0**-11], [2.0**-12]]) / 2
    expected = max(
        np.hypot(*(SPACE.forward(color + steps * np.array([corner]).T)[1] - SPACE.forward(color)[1]))
        for corner in itertools.product((-1, 1), repeat=3)
    )[0]
    assert reach[0] == pytest.approx(expected, rel=0.01)
    assert reach[1] < 1e-7
    single = analysis.quantization(half.astype(np.float32), PLAIN, SPACE)
    assert 0 < single[0] < 1e-6


def test_quantisation_of_grey_turns_no_hue():
    for samples in (np.array([[3], [200]], np.uint8), np.array([[3, 9], [200, 255]], np.uint8)):
        assert np.all(analysis.quantization(samples, STRAIGHT, SPACE) < 1e-6)


def write_codes(name, codes):
    Image.fromarray(np.array(codes, np.uint8)).save(name)


def test_the_tolerance_widens_only_where_samples_leave_it_open(tmp_path, monkeypatch):
    """A dark pixel a code away from red may be red; a bright one of that hue is not."""
    monkeypatch.chdir(tmp_path)
    red = np.zeros((1, 1, 4))
    red[..., 0], red[..., 3] = 0.9, 1
    hpcomp.write_image("red.exr", red)
    write_codes("dark.png", [[[12, 1, 0, 255]]])
    write_codes("bright.png", [[[230, 110, 0, 255]]])
    dark = hpcomp.check("dark.png", ["red.exr"], max_foreign=0)
    bright = hpcomp.check("bright.png", ["red.exr"], max_foreign=0)
    assert (dark.sums.chromatic, dark.sums.foreign) == (1, 0)
    assert (bright.sums.chromatic, bright.sums.foreign) == (1, 1)
    # The same light in floats is certain.
    pixels = hpcomp.read_layer("dark.png").pixels
    pixels[..., 1] *= 3
    hpcomp.write_image("dark.exr", pixels, depth="float")
    assert not hpcomp.check("dark.exr", ["red.exr"], max_foreign=0).passed


def test_an_alpha_that_was_rounded_up_lights_no_foreign_hue(tmp_path, monkeypatch):
    """Blue of half an 8-bit alpha is below half a step, and stored it is twice as much."""
    monkeypatch.chdir(tmp_path)
    alpha = 0.51 / 255
    hpcomp.write_image("faint.exr", np.array([[[0, 0, alpha, alpha]]]), depth="float")
    hpcomp.stack(["faint.exr"], "out.png")
    found = hpcomp.check("out.png", ["faint.exr"], max_foreign=0)
    assert (found.sums.chromatic, found.sums.foreign) == (1, 0)
    assert found.sums.labels[0].pixels == 0


def test_a_picture_of_more_chroma_than_its_layers_has_lost_none(layers):
    found = hpcomp.check("red.exr", ["red.exr::opacity=0.5"], max_gray=0)
    assert found.passed
    assert found.sums.chroma_out == found.sums.chroma_in > 0


# ---- labels --------------------------------------------------------------------------------------


def test_labels_are_seen_where_their_hue_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    red, green = np.zeros((4, 10, 4)), np.zeros((4, 10, 4))
    red[:] = (0.8, 0, 0, 1)
    green[:, :3] = (0, 0.7, 0, 1)  # covers 30% of red
    hpcomp.write_image("red.exr", red)
    hpcomp.write_image("green.exr", green)
    stack = ["red.exr", "green.exr"]
    hpcomp.stack(stack, "out.png")
    found = hpcomp.check("out.png", stack, require_hue=["layer:red", "layer:1", "120", "240"])
    by_text = dict(zip((label.text for label in found.labels), found.sums.labels, strict=True))
    # Under an opaque layer nothing of red contributes.
    assert by_text["layer 0 (red.exr)"] == analysis.LabelSums(28, 28, 28)
    assert by_text["layer 1 (green.exr)"] == analysis.LabelSums(12, 12, 12)
    assert by_text["hue 120"] == analysis.LabelSums(40, 12, 40)
    assert by_text["hue 240"] == analysis.LabelSums(40, 0, 0)
    assert [verdict.passed for verdict in found.verdicts] == [True, True, True, False]
    assert hpcomp.check("out.png", stack, require_hue=[120], visible="30%").passed
    assert not hpcomp.check("out.png", stack, require_hue=[120], visible="31%").passed
    assert not hpcomp.check("out.png", stack, require_hue=[240], visible=0).passed


def test_a_label_that_contributes_nowhere_is_not_visible(layers):
    hidden = ["red.exr", "green.exr", "base.png::alpha=luminance,op=src"]
    hpcomp.stack(hidden, "out.png")
    assert not hpcomp.check("out.png", hidden, require_hue=["layer:red"]).passed


def test_a_label_is_named_by_its_name_number_or_file(layers):
    named = ["red.exr::name=1", "green.exr", "blue.exr::name=sea"]
    hpcomp.stack(named, "out.png")
    found = hpcomp.check(
        "out.png", named, require_hue=["layer:1", "layer:2", "layer:sea", "layer:green"]
    )
    assert [verdict.label for verdict in found.verdicts] == [
        "layer 0 (1: red.exr)",
        "layer 2 (sea: blue.exr)",
        "layer 2 (sea: blue.exr)",
        "layer 1 (green.exr)",
    ]
    for wrong in ("layer:3", "layer:", "layer:Red"):
        with pytest.raises(SettingError, match="is not one of the layers"):
            hpcomp.check("out.png", named, require_hue=[wrong])
    with pytest.raises(SettingError, match="fits several layers"):
        hpcomp.check("out.png", ["red.exr", "red.exr"], require_hue=["layer:red"])


def test_a_hue_that_is_rounding_shows_no_label(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_codes("speck.png", [[[3, 2, 1, 255], [9, 0, 0, 255]]])
    found = hpcomp.check("speck.png", hues="30,0", require_hue=["30"], achromatic=0)
    assert found.sums.foreign == 0
    assert {label.text: seen.shown for label, seen in zip(found.labels, found.sums.labels, strict=True)}["hue 30"] == 0
    # Two codes off grey: red it may be, or orange, but nobody could tell.
    write_codes("pale.png", [[[200, 198, 198, 255]]])
    pale = hpcomp.check("pale.png", hues="30", require_hue=["30"], achromatic=0)
    assert (pale.sums.chromatic, pale.sums.foreign) == (1, 0)
    assert pale.sums.labels == (analysis.LabelSums(1, 0),)


@pytest.fixture
def covered(tmp_path, monkeypatch):
    """A weak label that one pixel in eight cells shows, under a strong one that covers it."""
    monkeypatch.chdir(tmp_path)
    strong, weak = np.zeros((2, 32, 64, 4), np.float32)
    strong[:] = (0.5, 0, 0, 0.5)
    weak[:] = (0, 0.05, 0, 0.25)
    strong[20, 40] = 0
    hpcomp.write_image("roads.exr", strong)
    hpcomp.write_image("woods.exr", weak)
    hpcomp.write_image("grey.exr", np.full((32, 64, 4), 0.25, np.float32))
    hpcomp.stack(["grey.exr", "woods.exr", "roads.exr"], "out.exr", op="plus")
    return {"layers": ["grey.exr", "woods.exr", "roads.exr"], "op": "plus"}


def test_visible_is_counted_in_cells(covered):
    found = hpcomp.check("out.exr", **covered, min_visible="12%")
    grey, woods, roads = found.sums.labels
    assert grey == analysis.LabelSums(0, 0, 0)
    assert woods == analysis.LabelSums(32 * 64, 1, 256)
    assert (roads.visible, roads.pixels) == (32 * 64 - 1,) * 2
    # Grey contributes nowhere, and no rule for all is about it.
    assert [(verdict.label, verdict.measured, verdict.passed) for verdict in found.verdicts] == [
        ("layer 1 (woods.exr)", 0.125, True),
        ("layer 2 (roads.exr)", 1.0, True),
    ]
    assert found.visible_share == (256 + 2047) / (2048 + 2047)


def test_cells_are_counted_from_the_canvas(covered):
    hpcomp.stack(covered["layers"], "out.exr", op="plus", region="34x20+30+7")
    found = hpcomp.check("out.exr", **covered, min_visible=0)
    # Of the cell of (40, 20) the region has columns 32 to 47 and rows 16 to 26.
    assert found.sums.labels[1] == analysis.LabelSums(34 * 20, 1, 16 * 11)


@pytest.mark.parametrize(
    ("asked", "failed"),
    [
        ("12%", []),
        (0.125, []),
        ("13%", [1]),
        (["13%", "layer:woods=12.5%"], []),
        (["layer:1=12.5%", 1], []),
        (["layer:woods=0.126"], [1]),
        (["layer:roads=100%"], []),
        (["layer:grey=0"], []),
        (["layer:grey=1%", "layer:2=1"], [0]),
    ],
    ids=str,
)
def test_a_rule_for_one_layer_goes_before_that_for_all(covered, asked, failed):
    found = hpcomp.check("out.exr", **covered, min_visible=asked)
    assert found.passed == (not failed)
    assert [v.label for v in found.verdicts if not v.passed] == [
        found.labels[number].text for number in failed
    ]
    assert {v.rule for v in found.verdicts} == {"min-visible"}


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ("lots", "'lots' is not a share"),
        ("101%", "is not a share"),
        ("layer:roads", "no share and no layer's: write 95%, layer:1=90% or layer:NAME=90%"),
        ("roads=90%", "no share and no layer's"),
        ("layer:roads=", "'' is not a share"),
        ("layer:raods=90%", "'layer:raods' is not one of the layers.*did you mean 'roads'"),
        ("layer:3=90%", "is not one of the layers: there is layer 0"),
        (["90%", "95%"], "'95%' comes after another: give one of each"),
        (["layer:roads=90%", "layer:2=95%"], "'layer:2=95%' comes after another"),
    ],
    ids=str,
)
def test_what_least_visible_can_be(covered, asked, message):
    with pytest.raises(SettingError, match=message):
        hpcomp.check("out.exr", **covered, min_visible=asked)


def test_visible_is_about_layers(covered):
    with pytest.raises(SettingError, match="--min-visible is about layers: a check against --hues"):
        hpcomp.check("out.exr", hues="0", min_visible="95%")


# ---- hues ----------------------------------------------------------------------------------------


def hue_of(name):
    """The hue of a layer that has one: of its light in sum."""
    light = hpcomp.read_layer(name).pixels.astype(float).sum(axis=(0, 1))
    return float(SPACE.hue_axis.degrees(light[:3]))


def test_a_picture_against_hues(layers):
    hpcomp.stack(layers, "out.png")
    hues = [hue_of(name) for name in layers]
    allowed = ",".join(f"{hue:.3f}" for hue in hues)
    assert hpcomp.check("out.png", hues=allowed, max_foreign=0).passed
    two = hpcomp.check("out.png", hues=hues[:2], max_foreign=0, require_hue=[hues[0]])
    assert 0 < two.foreign_share < 1
    assert [verdict.passed for verdict in two.verdicts] == [False, True]
    assert [label.number for label in two.labels] == [None, None]
    hpcomp.stack(layers, "plain.png", blending="traditional")
    assert hpcomp.check("plain.png", hues=allowed, max_foreign=1).foreign_share > 0.5


def test_hues_are_those_of_pure_linear_colours(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for hue, rgb in ((0, (1, 0, 0)), (30, (1, 0.5, 0)), (60, (1, 1, 0)), (240, (0, 0, 1)), (300, (1, 0, 1))):
        hpcomp.write_image("one.exr", np.array([[[*(0.1 + 0.5 * np.array(rgb)), 1]]]), depth="float")
        for offset in (0, 360, -720):
            assert hpcomp.check("one.exr", hues=[hue + offset], max_foreign=0, foreign_tolerance=0.1).passed
        assert not hpcomp.check("one.exr", hues=[hue + 20], max_foreign=0).passed


def test_grey_against_hues_is_a_share_of_what_is_visible(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_codes("mixed.png", [[[200, 0, 0, 255], [90, 90, 90, 255], [92, 92, 92, 255], [0, 0, 0, 0]]])
    found = hpcomp.check("mixed.png", hues="0", max_gray="60%")
    assert (found.sums.visible, found.sums.chromatic) == (3, 1)
    assert not found.passed
    assert found.grey_share == 2 / 3
    assert hpcomp.check("mixed.png", hues="0", max_gray="67%").passed


# ---- pixels without a measure --------------------------------------------------------------------


def test_nonfinite_pixels_follow_the_policy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    planes = {name: np.full((3, 3), 0.5, np.float16) for name in "RGBA"}
    planes["R"][2, 1] = np.inf
    exrfile.write(tmp_path / "inf.exr", planes)
    hpcomp.write_image("fine.exr", np.full((3, 3, 4), 0.25))
    for image, stack in (("inf.exr", ["fine.exr"]), ("fine.exr", ["inf.exr"])):
        with pytest.raises(MismatchError, match="1 pixel is NaN or infinite, the first at 1,2"):
            hpcomp.check(image, stack, max_foreign=0)
        kept = hpcomp.check(image, stack, max_foreign=0, nonfinite="keep")
        assert (kept.sums.pixels, kept.sums.unmeasured, kept.sums.visible) == (9, 1, 8)
        with pytest.warns(hpcomp.HpcompWarning, match="1 pixel is NaN"):
            zeroed = hpcomp.check(image, stack, max_foreign=0, nonfinite="zero")
        assert zeroed.sums.unmeasured == 0
    hues = hpcomp.check("inf.exr", hues="0", max_foreign=0, nonfinite="keep")
    assert (hues.sums.unmeasured, hues.sums.visible) == (1, 8)


def test_a_broken_pixel_is_named_in_the_coordinates_of_its_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pixels = np.full((3, 3, 4), 0.25, np.float32)
    pixels[1, 2, 0] = np.nan
    data, display = hpcomp.Window(1, 2, 3, 3), hpcomp.Window(0, 0, 6, 6)
    hpcomp.write_image("nan.exr", pixels, data_window=data, display_window=display, depth="float")
    hpcomp.write_image("fine.exr", np.full((6, 6, 4), 0.25))
    wide = {"canvas": "12x12+0+0", "max_foreign": 0}
    says = "1 pixel is NaN or infinite, the first at 3,3"
    with pytest.raises(MismatchError, match=says):
        hpcomp.check("fine.exr::at=+3+2", ["fine.exr", "nan.exr::at=+1+3"], **wide)
    with pytest.raises(MismatchError, match=says):
        hpcomp.check("nan.exr::at=+5+6", ["fine.exr"], **wide)
    with pytest.raises(MismatchError, match=says):
        hpcomp.explain(["fine.exr", "nan.exr::at=+1+2"], (4, 5))


# ---- settings ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [("0.01", 0.01), ("1%", 0.01), (" 2.5 % ", 0.025), ("0", 0), ("100%", 1), (0.5, 0.5), ("1e-3", 0.001)],
)
def test_shares(text, value):
    assert analysis.parse_share(text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["", "%", "one", "-1%", "1.01", "101%", "nan", "inf", "1%%"])
def test_what_is_no_share(text):
    with pytest.raises(SettingError, match="is not a share"):
        analysis.parse_share(text)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "without a rule would pass anything"),
        ({"visible": "5%"}, "without a rule would pass anything"),
        ({"max_foreign": "lots"}, "is not a share"),
        ({"max_foreign": 0, "hues": "0"}, "either the LAYERs"),
        ({"max_foreign": 0, "layers": []}, "either the LAYERs"),
        ({"max_foreign": 0, "layers": [], "hues": "red"}, "are not numbers"),
        ({"max_foreign": 0, "layers": [], "hues": ""}, "are not numbers"),
        ({"max_foreign": 0, "layers": [], "hues": "0", "background": "#fff"}, "--background is about layers"),
        ({"max_foreign": 0, "layers": [], "hues": "0", "require_hue": ["layer:0"]}, "name LAYERs"),
        ({"require_hue": ["blue"]}, "is no label"),
        ({"require_hue": ["nan"]}, "is no label"),
        ({"max_foreign": 0, "nonfinite": "maybe"}, "unknown nonfinite policy"),
        ({"max_foreign": 0, "achromatic": 2}, "achromatic"),
        ({"max_foreign": 0, "image": "red.exr::opacity=0.5"}, "is the picture to check"),
        ({"max_foreign": 0, "image": "-", "layers": ["-"]}, "stdin can be only one"),
    ],
)
def test_settings_are_checked(layers, settings, message):
    settings = {"image": "red.exr", "layers": ["red.exr"], **settings}
    with pytest.raises(SettingError, match=message):
        hpcomp.check(**settings)


# ---- the command ---------------------------------------------------------------------------------


@pytest.fixture
def desk(tmp_path, layers):
    desk = Desk.made(tmp_path)
    for name in layers:
        desk.put(name, Path(name).read_bytes())
    desk.makes("stack", *layers, "-o", "out.png")
    desk.makes("stack", *layers, "-o", "plain.png", "--blending", "traditional")
    return desk


def test_a_picture_passes_against_its_own_layers(desk, layers):
    run = desk.makes("check", "out.png", *layers, "--max-foreign", "0", "--require-hue", "layer:red")
    lines = run.stdout.decode().splitlines()
    assert lines[0] == "out.png against its layers:"
    assert sum(line.startswith("  passed ") for line in lines) == 2
    assert any("foreign hue" in line and "0.000%" in line for line in lines)


def test_a_failed_check_is_exit_6_and_a_line_for_each_rule(desk, layers):
    run = desk.run("check", "plain.png", *layers, "--max-foreign", "0.01", "--require-hue", "300",
                   "--visible", "90%",
                   "--max-gray", "99%", "-q")  # fmt: skip
    assert run.code == 6
    assert len(run.lines) == 2
    assert run.lines[0].startswith("hpcomp: check failed: plain.png: --max-foreign: 6")
    assert run.lines[0].endswith("at most 1% may")
    assert "hue 300" in run.lines[1]
    assert run.stdout.decode().count("  FAILED ") == 2
    assert run.stdout.decode().count("  passed ") == 1


def test_a_label_that_is_too_little_visible_is_exit_6(desk):
    code = np.zeros((16, 64, 4), int)
    code[:] = (200, 0, 0, 255)
    for name, change in (("red", None), ("blue", (0, 0, 200, 255))):
        samples = code.copy()
        if change:
            samples[:, 32:] = change
        write_codes(str(desk / f"{name}.png"), samples)
    desk.makes("stack", "red.png", "blue.png::opacity=0.5", "-o", "two.png", "--order", "top-down")
    asked = ["check", "two.png", "red.png", "blue.png::opacity=0.5", "--min-visible", "95%"]
    run = desk.run(*asked, "-q")
    data = json.loads(desk.run(*asked, "--format", "json", "-q").stdout)
    shares = [label["visible_share"] for label in data["labels"]]
    assert run.code == 6
    (low,) = [share for share in shares if share < 0.95]
    (line,) = run.lines
    number = shares.index(low)
    assert line.startswith(f"hpcomp: check failed: two.png: --min-visible: layer {number} (")
    assert line.endswith(f" is visible in {low:.3%} of its pixels, at least 95% must be")
    text = run.stdout.decode()
    assert f"visible in {low:.3%} of them" in text
    assert "layers visible" in text
    rules = [(rule["rule"], rule["limit"], rule["passed"]) for rule in data["rules"]]
    assert sorted(rules) == [("min-visible", 0.95, False), ("min-visible", 0.95, True)]
    visible, pixels = (sum(label[key] for label in data["labels"]) for key in ("visible", "pixels"))
    assert data["layers_visible_share"] == visible / pixels
    assert desk.run(*asked, "--min-visible", f"layer:{number}=1%", "-q").code == 0


def test_the_verdict_as_json(desk, layers):
    for name, code in (("out.png", 0), ("plain.png", 6)):
        run = desk.run("check", name, *layers, "--max-foreign", "1%", "--format", "json")
        assert run.code == code
        data = json.loads(run.stdout)
        assert (data["schema"], data["version"], data["passed"]) == ("hpcomp.check", 1, code == 0)
        assert data["rules"][0]["limit"] == 0.01
        assert data["rules"][0]["measured"] == data["foreign_share"]
        assert len(data["labels"]) == 3
        assert "lost_to_grey" in data
    run = desk.run("check", "out.png", "--hues", "0,120", "--max-grey", "1", "--format", "json")
    data = json.loads(run.stdout)
    assert (data["against"], data["grey_share"]) == ("hues", data["rules"][0]["measured"])


def test_the_picture_may_come_through_a_pipe(desk, layers):
    picture = (desk / "out.png").read_bytes()
    run = desk.makes("check", "-", *layers, "--max-foreign", "0", stdin=picture)
    assert run.stdout.startswith(b"- against its layers")


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["out.png", "red.exr"], 2, ["without a rule", "--max-foreign"]),
        (["out.png"], 2, ["without a rule"]),
        (["out.png", "--max-foreign", "1%"], 2, ["--hues"]),
        (["out.png", "red.exr", "--min-visible", "layer:rad=90%"], 2, ["layer:rad", "did you mean 'red'"]),
        (["out.png", "red.exr", "--max-foreign", "x"], 2, ["'x'", "share"]),
        (["out.png", "none.exr", "--max-foreign", "1%"], 3, ["layer 0 (none.exr)"]),
        (["none.png", "red.exr", "--max-foreign", "1%"], 3, ["picture (none.png)"]),
        (["out.png", "red.exr", "--canvas", "5x5+0+0", "--max-foreign", "1%"], 4, ["at=+X+Y"]),
    ],
)
def test_bad_input_has_its_line_and_its_code(desk, arguments, code, says):
    desk.refuses(code, "check", *arguments, says=says)


def test_a_report_names_files_without_what_could_control_a_terminal(layers):
    found = hpcomp.check("red.exr", layers[:1], max_foreign=0)
    assert "a\\x1bb.png against" in report.as_text(dataclasses.replace(found, image="a\x1bb.png"))


def test_the_older_spelling_of_gray_is_accepted(desk, monkeypatch):
    monkeypatch.chdir(desk.folder)
    write_codes("mixed.png", [[[200, 0, 0, 255], [90, 90, 90, 255]]])
    by_name = [hpcomp.check("mixed.png", hues="0", **{name: "67%"}) for name in ("max_gray", "max_grey")]
    assert by_name[0] == by_name[1]
    runs = [desk.run("check", "mixed.png", "--hues", "0", name, "1%") for name in ("--max-gray", "--max-grey")]
    assert runs[0] == runs[1]
    assert runs[0].code == 6
    assert "--max-gray: 50.000% of the visible pixels are grey" in runs[0].lines[0]


def test_a_depfile_is_not_about_what_the_check_reads(desk):
    desk.refuses(
        2, "check", "mixed.png", "--hues", "0", "--max-gray", "99%", "--depfile", "m.d",
        "--depfile-target", "mixed.png", says=["mixed.png is read by the check", "stamp"],
    )  # fmt: skip
