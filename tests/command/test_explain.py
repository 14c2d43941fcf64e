"""`hpcomp explain`: one pixel, step by step, and that its result is what `stack` writes."""

import itertools
import json
import logging
import math
import re

import exrfile
import numpy as np
import oracle
import pytest
from command import Desk
from PIL import Image
from strategies import color_of

import hpcomp
from hpcomp.blending.weaving import noise_tile
from hpcomp.engine import choice as engine
from hpcomp.errors import HpcompWarning, MismatchError, SettingError
from hpcomp.imagefile.reading import LayerReader
from hpcomp.report import explanation as report

SIZE = 7, 6
ORDERS = ("bottom-up", "top-down", "balanced", "simultaneous", "2,0,3,1")


@pytest.fixture(params=engine.NAMES)
def each_engine(request, monkeypatch):
    monkeypatch.setenv(engine.VARIABLE, request.param)


def random_layer(random, alpha=1.0):
    a = alpha * random.random((*SIZE[::-1], 1))
    return np.concatenate([a * random.random((*SIZE[::-1], 3)), a], axis=2).astype(np.float32)


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Four layers of random pixels: 8 and 16 bits, half and float, one of them smaller."""
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(11)
    hpcomp.write_image("a.png", random_layer(random) + np.float32([0, 0, 0, 1]))
    hpcomp.write_image("b.png", random_layer(random), depth=16)
    hpcomp.write_image("c.exr", random_layer(random))
    hpcomp.write_image("d.exr", random_layer(random)[:3, :4], depth="float")
    return ["a.png", "b.png::opacity=0.7", "c.exr", "d.exr::at=+2+1"]


CASES = [
    {"order": order, **more}
    for order, more in itertools.product(
        ORDERS,
        (
            {},
            {"op": "xor", "background": "#2288dd", "exposure": -1.5},
            {"blending": "traditional", "op": "plus"},
            {"hue_tolerance": 0, "op": "atop"},
            {"gray_bias": 0.6, "op": "plus"},
            {"blending": "foremost", "op": "dst-over", "background": "#2288dd"},
        ),
    )
]


@pytest.mark.filterwarnings("ignore:out.png")  # of colours that a PNG cannot hold
@pytest.mark.parametrize("rules", CASES, ids=str)
def test_the_result_is_what_stack_writes(files, each_engine, rules):
    hpcomp.stack(files, "out.exr", depth="float", **rules)
    hpcomp.stack(files, "out.png", **rules)
    written = hpcomp.read_layer("out.exr").pixels
    codes = np.asarray(Image.open("out.png"))
    hpcomp.stack(files, "plain.exr", depth="float", **{**rules, "blending": "traditional"})
    plain = hpcomp.read_layer("plain.exr").pixels
    for x, y in [(0, 0), (2, 1), (3, 2), (5, 3), (6, 5)]:
        pixel = hpcomp.explain(files, (x, y), **rules)
        assert pixel.result.rgba == tuple(written[y, x].tolist())
        assert pixel.result.srgb == tuple(codes[y, x].tolist())
        assert pixel.traditional.rgba == tuple(plain[y, x].tolist())


def test_a_pixel_of_the_overscan_is_explained_only_with_overscan(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    window, inner = hpcomp.Window(-2, -1, 6, 5), hpcomp.Window(0, 0, 3, 3)
    random = np.random.default_rng(2)
    pixels = np.concatenate([random.random((5, 6, 3)), np.ones((5, 6, 1))], axis=2)
    hpcomp.write_image("over.exr", pixels, data_window=window, display_window=inner)
    hpcomp.stack(["over.exr"], "out.exr", overscan=True, depth="float")
    pixel = hpcomp.explain(["over.exr"], "-2,-1", overscan=True)
    assert pixel.result.rgba == tuple(hpcomp.read_layer("out.exr").pixels[0, 0].tolist())
    with pytest.raises(MismatchError, match="pixel -2,-1 is outside the canvas 3x3"):
        hpcomp.explain(["over.exr"], "-2,-1")


def test_only_the_rows_of_the_pixel_are_read(files, monkeypatch):
    asked = []
    read = LayerReader.read_samples

    def watched(reader, begin, end):
        asked.append((begin, end))
        return read(reader, begin, end)

    monkeypatch.setattr(LayerReader, "read_samples", watched)
    hpcomp.explain(files, (3, 2), threads=1)
    assert asked == [(2, 3), (2, 3), (2, 3), (1, 2)]  # the last one is placed a row lower
    asked.clear()
    hpcomp.explain(files, (0, 0))
    assert asked == [(0, 1)] * 3


def test_neither_threads_nor_memory_show(files, caplog):
    caplog.set_level(logging.INFO, "hpcomp")
    pixel = hpcomp.explain(files, (3, 2), threads=1)
    with pytest.raises(MismatchError, match=r"this pixel needs at least \d+M.*--max-memory") as refusal:
        hpcomp.explain(files, (3, 2), max_memory="64K")
    least = re.search(r"at least (\d+M)", str(refusal.value))[1]
    for threads, memory, used in ((1, "1G", 1), (3, "1G", 3), (99, "1G", 4), (3, least, 1)):
        caplog.clear()
        assert hpcomp.explain(files, (3, 2), threads=threads, max_memory=memory) == pixel
        assert f"reading a pixel of 4 layers, {used} threads" in caplog.text


def test_the_first_failure_is_that_of_the_first_layer(files):
    """On any number of threads."""
    pixels = np.full((*SIZE[::-1], 4), 0.25)
    pixels[2, 3] = np.nan
    for name in ("b.exr", "c.exr"):
        hpcomp.write_image(name, pixels)
    for threads in (1, 3):
        with pytest.raises(MismatchError, match=r"layer 1 \(b.exr\): 1 pixel is NaN"):
            hpcomp.explain([files[0], "b.exr", "c.exr"], (3, 2), threads=threads)


# ---- what it says --------------------------------------------------------------------------------


PATTERNS = [("stripes", 2), ("stripes", 3), ("stripes", 8), ("noise", 2), ("noise", 3)]
OTHER_RULES = [
    {},
    {"strength": "coverage", "background": "#2288dd", "exposure": -1.5, "op": "xor"},
    {"strength": "perceived", "space": "oklab", "canvas": "11x9-3-2"},
    {"strength": "coverage", "overscan": True, "canvas": "3x2+1+1"},
]
#: Each pattern with two of the other rules in turn, so that stripes and noise meet all of these.
WOVEN = [
    {"weave": weave, "weave_size": size, **OTHER_RULES[(number + more) % len(OTHER_RULES)]}
    for number, (weave, size) in enumerate(PATTERNS)
    for more in (0, 2)
]


@pytest.mark.singly
@pytest.mark.filterwarnings("ignore")  # of colours that a PNG cannot hold, layers outside the canvas
@pytest.mark.parametrize("rules", WOVEN, ids=str)
def test_a_woven_pixel_is_what_stack_writes_there(files, each_engine, rules):
    """The pattern is counted from the corner of the canvas, whatever part of it is made."""
    rules = {"blending": "woven", **rules}
    hpcomp.stack(files, "out.exr", depth="float", **rules)
    written = hpcomp.read_layer("out.exr")
    left, top = written.data_window.x, written.data_window.y
    hpcomp.stack(files, "part.exr", depth="float", region="2x1+2+2", **rules)
    part = hpcomp.read_layer("part.exr")
    assert part.data_window == hpcomp.Window(2, 2, 2, 1)
    chosen = set()
    for y, x in itertools.product(*(range(n) for n in written.pixels.shape[:2])):
        at = left + x, top + y
        pixel = hpcomp.explain(files, at, **rules)
        assert pixel.result.rgba == tuple(written.pixels[y, x].tolist())
        chosen.add(pixel.weaving.chosen)
        if part.data_window.contains(hpcomp.Window(*at, 1, 1)):
            there = hpcomp.explain(files, at, region="2x1+2+2", **rules)
            assert there == pixel
            assert there.result.rgba == tuple(part.pixels[y + top - 2, x + left - 2].tolist())
    assert len(chosen) > 1


@pytest.fixture
def labels(tmp_path, monkeypatch):
    """One-pixel float layers of known hue and chroma, half transparent, to be added with plus."""
    monkeypatch.chdir(tmp_path)

    def make(*colors):
        names = []
        for number, (hue, chroma) in enumerate(colors):
            rgba = np.array([[[*color_of(hue, chroma, 0.2), 0.25]]], np.float32)
            hpcomp.write_image(f"l{number}.exr", rgba, depth="float")
            names.append(f"l{number}.exr")
        return names

    return make


def test_a_fold_says_who_met_whom_and_who_dominated(labels):
    files = labels((0, 0.3), (120, 0.1), (1, 0.05))
    pixel = hpcomp.explain(files, (0, 0), op="plus")
    first, second = pixel.meetings
    assert (first.first, first.second) == ((0,), (1,))
    assert first.angle == pytest.approx(120, abs=0.01)
    assert (first.equality, first.dominant) == (0, 1)
    assert first.chroma == pytest.approx(0.2, abs=1e-5)
    assert (second.first, second.second) == ((0, 1), (2,))
    assert (second.equality, second.dominant) == (1, None)
    assert second.chroma == pytest.approx(0.25, abs=1e-4)
    assert pixel.rivalries == ()
    assert [step.weight for step in pixel.layers] == [1, 1, 1]
    assert [step.chroma for step in pixel.layers] == pytest.approx([0.3, 0.1, 0.05], abs=1e-6)
    assert (pixel.result.kind, pixel.result.survivor) == ("layer", 0)
    assert pixel.result.grey == pytest.approx(1 - 0.25 / 0.45, abs=1e-4)
    assert pixel.result.margin == pytest.approx(1 - 0.1 / 0.3, abs=1e-5)
    text = report.as_text(pixel)
    assert "0 meets 1, 120.0° apart: 0 dominates; chroma 0.3000 and 0.1000 become 0.2000" in text
    assert "0+1 meets 2, 1.0° apart: equal hues, which add up" in text
    assert "layer 0 (l0.exr) keeps its hue; 44% of the chroma is cancelled" in text.splitlines()


def test_the_second_may_dominate(labels):
    pixel = hpcomp.explain(labels((0, 0.1), (120, 0.3)), (0, 0), op="plus")
    assert pixel.meetings[0].dominant == 2
    assert "0 meets 1, 120.0° apart: 1 dominates" in report.as_text(pixel)
    assert pixel.result.survivor == 1


def test_orders_are_traced_as_they_reduce(labels):
    files = labels((0, 0.3), (120, 0.1), (200, 0.05), (80, 0.02))

    def met(order):
        pixel = hpcomp.explain(files, (0, 0), op="plus", order=order)
        return [(step.first, step.second) for step in pixel.meetings]

    assert met("top-down") == [((3,), (2,)), ((3, 2), (1,)), ((3, 2, 1), (0,))]
    assert met("balanced") == [((0,), (1,)), ((2,), (3,)), ((0, 1), (2, 3))]
    assert met("1,3,0,2") == [((1,), (3,)), ((1, 3), (0,)), ((1, 3, 0), (2,))]


def test_simultaneous_names_the_strongest_rivals(labels):
    files = labels((0, 0.3), (120, 0.1), (240, 0.2))
    pixel = hpcomp.explain(files, (0, 0), op="plus", order="simultaneous", background="#3366cc")
    assert [(r.number, r.rival) for r in pixel.rivalries] == [(0, 2), (1, 0), (2, 0)]
    assert [r.share for r in pixel.rivalries] == pytest.approx([1 / 3, 0, 0], abs=1e-5)
    assert [r.angle for r in pixel.rivalries] == pytest.approx([120, 120, 120], abs=0.01)
    (last,) = pixel.meetings
    assert (last.first, last.second) == ((0, 1, 2), (None,))
    text = report.as_text(pixel)
    assert "0 has its strongest rival in 2, 120.0° away: 33.3% of it is left" in text
    assert "0+1+2 meets background" in text


def test_the_shoulder_and_the_traditional_sum_are_told_apart(labels):
    files = labels((0, 0.3), (3, 0.1))
    (step,) = hpcomp.explain(files, (0, 0), op="plus").meetings
    assert 0 < step.equality < 1
    assert step.dominant == 1
    assert "nearly equal hues (e = 0.5" in report.as_text(hpcomp.explain(files, (0, 0), op="plus"))
    plain = hpcomp.explain(files, (0, 0), op="plus", blending="traditional")
    (step,) = plain.meetings
    assert (step.equality, step.dominant) == (None, None)
    assert "added as they are" in report.as_text(plain)
    assert plain.result == plain.traditional


def test_the_foremost_is_named_from_the_front(labels):
    files = labels((0, 0.3), (120, 0.1), (240, 0.2))
    for order in ("bottom-up", "top-down", "simultaneous", "1,2,0"):
        rules = {"op": "plus", "blending": "foremost", "order": order}
        pixel = hpcomp.explain(files, (0, 0), background="#3366cc", **rules)
        met = [(step.first, step.second) for step in pixel.meetings]
        assert met == [((2,), (1,)), ((2, 1), (0,)), ((2, 1, 0), (None,))]
        assert [(step.equality, step.dominant) for step in pixel.meetings] == [(None, 1)] * 3
        assert pixel.rivalries == ()
        assert (pixel.result.kind, pixel.result.survivor) == ("layer", 2)
        assert pixel.result.chroma == pytest.approx(0.2, abs=1e-6)
        assert pixel.traditional.kind == "foreign"
    text = report.as_text(pixel)
    assert "2 meets 1, 120.0° apart: 2 is in front, and its hue is all that counts" in text
    files[1] += "::op=dst-over"
    files[2] += "::op=dst-over"
    pixel = hpcomp.explain(files, (0, 0), blending="foremost")
    assert [(step.first, step.second) for step in pixel.meetings] == [((0,), (1,)), ((0, 1), (2,))]
    assert pixel.result.survivor == 0


def test_the_foremost_may_have_next_to_no_hue(labels):
    files = labels((0, 0.3), (120, 1e-7), (0, 0.0))
    pixel = hpcomp.explain(files, (0, 0), op="plus", blending="foremost")
    assert pixel.meetings[0].dominant is None
    assert pixel.meetings[1].dominant == 1
    assert pixel.result.kind == "grey"
    text = report.as_text(pixel)
    assert "2 meets 1: 2 brings no chroma, 1 keeps its own" in text
    assert "the foremost colour is next to grey" in text.splitlines()
    assert "traditional: layer 0 (l0.exr) keeps its hue" in text


def test_a_bias_against_grey_shows_in_steps_and_in_shares(labels):
    files = labels((0, 0.2), (120, 0.1))
    pixel = hpcomp.explain(files, (0, 0), op="plus", gray_bias=1)
    assert pixel.meetings[0].chroma == pytest.approx(0.2 * 15 / 16, abs=1e-6)
    assert ", gray bias 1" in report.as_text(pixel)
    assert report.as_data(pixel)["gray_bias"] == 1
    pixel = hpcomp.explain(files, (0, 0), op="plus", gray_bias=1, order="simultaneous")
    assert [r.share for r in pixel.rivalries] == pytest.approx([15 / 16, 0], abs=1e-6)
    assert pixel.result.chroma == pytest.approx(0.2 * 15 / 16, abs=1e-6)
    assert "gray bias" not in report.as_text(hpcomp.explain(files, (0, 0), op="plus"))


PLAIN = 16, 5
STRENGTHS = ("chroma", "perceived", "coverage")


@pytest.fixture
def plain(tmp_path, monkeypatch):
    """Float layers of one colour each: of these straight colours and alphas, so many of which add."""
    monkeypatch.chdir(tmp_path)

    def make(*colors):
        names = []
        for number, (rgb, alpha) in enumerate(colors):
            rgba = np.tile(np.float32([*(alpha * np.array(rgb)), alpha]), (*PLAIN[::-1], 1))
            hpcomp.write_image(f"p{number}.exr", rgba, depth="float")
            names.append(f"p{number}.exr")
        return names

    return make


#: A vivid one that covers little, and a pale one that covers all: strength decides who wins.
VIVID, PALE = (color_of(0, 0.3, 0.2), 0.25), (color_of(120, 0.05, 0.5), 1.0)


@pytest.mark.parametrize(("strength", "wins"), [("chroma", 0), ("perceived", 0), ("coverage", 1)])
def test_strength_decides_who_dominates(plain, strength, wins):
    files = plain(VIVID, PALE)
    rules = {"op": "plus", "strength": strength}
    pixel = hpcomp.explain(files, (3, 2), **rules)
    (step,) = pixel.meetings
    assert step.dominant == wins + 1
    assert pixel.result.survivor == wins
    text = report.as_text(pixel)
    assert f": {wins} dominates; " in text
    if strength == "chroma":
        assert [layer.weighted_strength for layer in pixel.layers] == [None, None]
        assert "strength" not in text
        return
    m = [oracle.strength_of(strength, (*(alpha * np.array(rgb)),), alpha) for rgb, alpha in (VIVID, PALE)]
    assert [layer.weighted_strength for layer in pixel.layers] == pytest.approx(m, rel=1e-4)
    assert (step.strength_first, step.strength_second) == pytest.approx(m, rel=1e-4)
    assert step.strength == pytest.approx(max(m) - min(m), rel=1e-4)
    kept = 1 - min(m) / max(m)
    assert step.chroma == pytest.approx(kept * pixel.layers[wins].weighted_chroma, rel=1e-4)
    assert f"strength {m[0]:.4f} and {m[1]:.4f} become {step.strength:.4f}, chroma" in text
    assert f", strength {strength}, " in text.splitlines()[1]


def test_strengths_are_weighted_as_they_compete(plain):
    files = plain(VIVID, PALE)
    files[1] += "::opacity=0.5"
    pixel = hpcomp.explain(files, (0, 0), strength="coverage", background="#3366cc")
    alone = hpcomp.explain(files[:1], (0, 0), strength="coverage")
    vivid, pale = pixel.layers
    assert vivid.weighted_strength == pytest.approx(0.5 * alone.layers[0].weighted_strength)
    assert pixel.background.weight == pytest.approx(0.5 * 0.75)
    whole = oracle.strength_of("coverage", pixel.background.rgb, 1.0)
    assert pixel.background.weighted_strength == pytest.approx(0.5 * 0.75 * whole, rel=1e-5)
    last = pixel.meetings[-1]
    assert last.strength_second == pytest.approx(pixel.background.weighted_strength)
    data = report.as_data(pixel)
    assert data["strength"] == "coverage"
    assert data["background"]["weighted_strength"] == pixel.background.weighted_strength
    assert [row["weighted_strength"] for row in data["layers"]] == [vivid.weighted_strength, pale.weighted_strength]


def test_chroma_decides_between_colours_of_no_strength(plain):
    """Light at alpha 0 covers nothing."""
    glow = [np.float32([[[*color_of(hue, m, 0.2), 0.0]]]) for hue, m in ((0, 0.1), (120, 0.3))]
    for number, rgba in enumerate(glow):
        hpcomp.write_image(f"glow{number}.exr", rgba, depth="float")
    plain()
    pixel = hpcomp.explain(["glow0.exr", "glow1.exr"], (0, 0), op="plus", strength="coverage")
    (step,) = pixel.meetings
    assert (step.strength_first, step.strength_second, step.dominant) == (0, 0, 2)
    assert pixel.result.survivor == 1


@pytest.mark.parametrize("strength", STRENGTHS)
def test_rivals_are_those_of_the_strength(plain, strength):
    files = plain(VIVID, PALE, (color_of(230, 0.1, 0.3), 0.6))
    pixel = hpcomp.explain(files, (0, 0), op="plus", order="simultaneous", strength=strength)
    directions = np.radians([0, 120, 230])
    left = [r.share * pixel.layers[r.number].weighted_chroma for r in pixel.rivalries]
    p = [sum(m * turn(angle) for m, angle in zip(left, directions, strict=True)) for turn in (np.cos, np.sin)]
    assert math.hypot(*p) == pytest.approx(pixel.result.chroma, rel=1e-4)
    strongest = max(range(3), key=lambda n: pixel.layers[n].weighted_strength or pixel.layers[n].weighted_chroma)
    assert max(pixel.rivalries, key=lambda r: r.share).number == strongest


# ---- woven ---------------------------------------------------------------------------------------


@pytest.mark.singly
@pytest.mark.parametrize("strength", STRENGTHS)
@pytest.mark.parametrize(("weave", "size"), [("stripes", 8), ("stripes", 5), ("noise", 2)])
def test_the_pattern_says_whose_thread_a_pixel_is(plain, weave, size, strength):
    files = plain(VIVID, PALE)
    tile = noise_tile().astype(int).tolist()
    rules = {"op": "plus", "blending": "woven", "weave": weave, "weave_size": size, "strength": strength}
    seen = set()
    for y, x in itertools.product(range(PLAIN[1]), range(PLAIN[0])):
        pixel = hpcomp.explain(files, (x, y), **rules)
        u = oracle.stripes(x, y, size) if weave == "stripes" else oracle.noise(x, y, size, tile)
        weaving = pixel.weaving
        assert weaving.phase == pytest.approx(u, abs=1e-7)
        m = [layer.weighted_strength or layer.weighted_chroma for layer in pixel.layers]
        shares = {thread.number: thread.share for thread in weaving.threads}
        assert shares == pytest.approx({0: m[0] / sum(m), 1: m[1] / sum(m)}, rel=1e-5)
        first, second = weaving.threads
        assert (first.begin, second.begin) == pytest.approx((0, first.share), abs=1e-6)
        expected = first if u < first.share else second
        assert weaving.chosen == (expected.number,)
        assert pixel.result.survivor == expected.number
        assert pixel.result.hue == pytest.approx(expected.hue, abs=1e-2)
        assert (weaving.share, weaving.one_hue) == (expected.share, False)
        assert pixel.meetings == pixel.rivalries == ()
        seen.add(expected.number)
    assert seen == {0, 1}
    what = {"chroma": "chroma", "perceived": "strength", "coverage": "coverage"}[strength]
    text = report.as_text(pixel)
    label = pixel.layers[expected.number].label
    share, u = weaving.share, weaving.phase
    assert f"this pixel is the thread of {label}: {share:.0%} of the {what}, phase {u:.2f}" in text
    assert f"{weave} of {size} pixels have phase {u:.3f} here: {expected.number}" in text
    assert text.splitlines()[1].startswith(f"woven, {weave} of {size} pixels, space linear-rgb")
    data = report.as_data(pixel)
    assert (data["weave"], data["weave_size"]) == (weave, size)
    assert data["weaving"]["chosen"] == [expected.number]
    assert data["meaning"] in text.splitlines()


def test_one_hue_is_plain_addition(plain):
    files = plain(VIVID, (color_of(0, 0.1, 0.4), 0.5), (color_of(0, 0.0, 0.4), 0.5))
    pixel = hpcomp.explain(files, (3, 2), blending="woven")
    assert pixel.weaving.one_hue
    assert sorted(pixel.weaving.chosen) == [0, 1]
    assert pixel.weaving.share == pytest.approx(1)
    assert pixel.result.rgba == pixel.traditional.rgba
    text = report.as_text(pixel)
    says = "only one hue here, that of layer 0 (p0.exr) and layer 1 (p1.exr): plain +"
    assert says in text.splitlines()
    grey = hpcomp.explain(files[2:], (3, 2), blending="woven")
    assert grey.weaving.threads == ()
    assert "none: no colour here has a hue" in report.as_text(grey)
    assert "no layer brings any chroma here" in report.as_text(grey)


def test_the_background_is_a_thread(plain):
    files = plain(((0.8, 0.1, 0.1), 0.5))
    found = [hpcomp.explain(files, (x, 0), blending="woven", background="#0000ff") for x in range(16)]
    assert {pixel.weaving.chosen for pixel in found} == {(0,), (None,)}
    for pixel in found:
        of_layer = pixel.weaving.chosen == (0,)
        assert pixel.result.kind == ("layer" if of_layer else "background")
        text = report.as_text(pixel)
        assert f"is the thread of {'layer 0 (p0.exr)' if of_layer else 'the background'}: " in text
        assert report.as_data(pixel)["weaving"]["chosen"] == [0 if of_layer else "background"]


def test_what_the_gamut_takes_of_a_thread_is_said(plain):
    """A dark blue beside a bright yellow: blue has no chroma of all at the luminance of both."""
    files = plain(((1.0, 0.9, 0.0), 1.0), ((0.0, 0.0, 1.0), 0.5))
    taken = {}
    for x in range(16):
        pixel = hpcomp.explain(files, (x, 0), blending="woven")
        whole = sum(layer.weighted_chroma for layer in pixel.layers)
        assert pixel.weaving.bound == pytest.approx(1 - pixel.result.chroma / whole, abs=1e-5)
        taken[pixel.weaving.chosen] = pixel.weaving.bound
        says = f"the gamut has no room for {pixel.weaving.bound:.0%} of its chroma"
        assert (says in report.as_text(pixel)) == (pixel.weaving.bound > 0)
    assert taken[(1,)] > 0.2


def test_every_key_of_the_data_is_explained(files):
    documented = ", ".join(report.JSON_KEYS).split(", ")
    for rules in ({}, {"order": "simultaneous"}, {"blending": "woven", "background": "#123"}):
        data = report.as_data(hpcomp.explain(files, (3, 2), **rules))
        assert set(data) == set(documented)
        meanings = {name: meaning for names, meaning in report.JSON_KEYS.items() for name in names.split(", ")}
        for name, value in data.items():
            rows = value if isinstance(value, list) else [value]
            for row in rows:
                for key in row if isinstance(row, dict) else ():
                    assert f"`{key}`" in meanings[name] + (meanings["layers"] if name == "background" else "")


@pytest.mark.parametrize(
    ("colors", "rules", "kind", "plain_kind", "says"),
    [
        (((0, 0.3), (100, 0.2)), {}, "layer", "foreign", "is nobody's"),
        (((0, 0.2), (180, 0.2)), {}, "grey", "grey", "the hues cancel to grey"),
        (((0, 0.0), (0, 0.0)), {}, "colorless", "colorless", "no layer brings any chroma"),
        (((0, 0.1),), {"background": "#0000ff"}, "background", "foreign", "the background keeps"),
    ],
)
def test_what_became_of_the_hues_in_words(labels, colors, rules, kind, plain_kind, says):
    pixel = hpcomp.explain(labels(*colors), (0, 0), op="plus", **rules)
    assert (pixel.result.kind, pixel.traditional.kind) == (kind, plain_kind)
    assert says in report.as_text(pixel)


def test_equal_strength_is_no_dominance(labels):
    pixel = hpcomp.explain(labels((0, 0.2), (0, 0.2)), (0, 0), op="plus")
    assert pixel.meetings[0].equality == 1
    one = hpcomp.explain(labels((0, 0.2)), (0, 0))
    assert one.meetings == ()
    assert "none: there is one layer" in report.as_text(one)
    greys = hpcomp.explain(labels((0, 0.0), (90, 0.0)), (0, 0), order="simultaneous")
    assert "none: no colour here has a hue" in report.as_text(greys)


def test_stored_samples_are_shown_as_they_are(files):
    steps = hpcomp.explain(files, (6, 5)).layers
    assert [step.stored_type for step in steps] == ["uint8", "uint16", "half", ""]
    assert steps[3].stored is None
    codes = np.asarray(Image.open("a.png"))[5, 6]
    assert steps[0].stored == tuple(codes.tolist())
    assert steps[1].opacity == 0.7
    assert [step.operator for step in steps] == [None, "over", "over", "over"]
    assert steps[3].rgba == (0, 0, 0, 0)
    assert "nothing" in report.as_text(hpcomp.explain(files, (6, 5)))


def test_hues_are_hsl_degrees_of_the_linear_colour(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for hue, rgb in ((0, (0.5, 0, 0)), (60, (0.5, 0.5, 0.1)), (120, (0.1, 0.4, 0.1)), (240, (0, 0, 1))):
        hpcomp.write_image("one.exr", np.array([[[*rgb, 1]]]), depth="float")
        pixel = hpcomp.explain(["one.exr"], (0, 0))
        assert (pixel.result.hue + 180) % 360 - 180 == pytest.approx(hue if hue < 180 else hue - 360, abs=1e-3)
        assert pixel.layers[0].hue == pytest.approx(pixel.result.hue)
    hpcomp.write_image("grey.exr", np.array([[[0.3, 0.3, 0.3, 1]]]))
    assert hpcomp.explain(["grey.exr"], (0, 0)).result.hue is None


def test_data_is_plain_json_with_a_schema(files):
    for order in ("bottom-up", "simultaneous"):
        pixel = hpcomp.explain(files, (3, 2), order=order, background="#123")
        data = json.loads(json.dumps(report.as_data(pixel), allow_nan=False))
        assert (data["schema"], data["version"]) == ("hpcomp.explain", 1)
        assert data["pixel"] == {"x": 3, "y": 2}
        assert data["result"]["rgba"] == list(pixel.result.rgba)
        assert bytes.fromhex(data["result"]["srgb8_straight"][1:]) == bytes(pixel.result.srgb)
        assert len(data["layers"]) == 4
        assert len(data["rivalries"]) == (4 if order == "simultaneous" else 0)
        assert data["steps"][-1]["second"] == ["background"]


def test_values_that_are_let_through_do_not_break_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    planes = {name: np.full((2, 2), 0.5, np.float16) for name in "RGBA"}
    planes["R"][1, 1] = np.nan
    exrfile.write(tmp_path / "nan.exr", planes)
    with pytest.raises(MismatchError, match="1 pixel is NaN or infinite, the first at 1,1"):
        hpcomp.explain(["nan.exr"], (1, 1))
    assert hpcomp.explain(["nan.exr"], (0, 1)).result.kind == "colorless"
    kept = hpcomp.explain(["nan.exr"], (1, 1), nonfinite="keep")
    assert kept.result.kind == "unmeasured"
    assert math.isnan(kept.result.rgba[0])
    data = json.loads(json.dumps(report.as_data(kept), allow_nan=False))
    assert data["result"]["rgba"][0] is None
    assert "without a hue" in report.as_text(kept)
    with pytest.warns(HpcompWarning, match="1 pixel is NaN"):
        zeroed = hpcomp.explain(["nan.exr"], (1, 1), nonfinite="zero")
    assert zeroed.result.rgba == (0, 0, 0, 0)


@pytest.mark.parametrize("at", ["", "3", "1,2,3", "a,b", "1.5,2", f"{2**40},0"])
def test_a_pixel_is_two_whole_numbers(files, at):
    with pytest.raises(SettingError, match="pixel"):
        hpcomp.explain(files, at)


# ---- the command ---------------------------------------------------------------------------------


@pytest.fixture
def desk(tmp_path, files):
    desk = Desk.made(tmp_path)
    for name in ("a.png", "b.png", "c.exr"):
        (tmp_path / name).rename(desk / name)
    return desk


def test_the_command_prints_text_or_json(desk):
    text = desk.makes("explain", "a.png", "b.png::opacity=0.5,name=tint", "--at", "2,3").stdout.decode()
    assert text.startswith("pixel 2,3 of canvas 7x6+0+0\n")
    assert "layer 1 (tint: b.png)" in text
    data = json.loads(desk.makes("explain", "a.png", "--at", "2,3", "--format", "json").stdout)
    assert data["schema"] == "hpcomp.explain"
    piped = desk.makes("explain", "-::opacity=0.5", "--at", "0,0", stdin=(desk / "a.png").read_bytes())
    assert b"layer 0 (stdin)" in piped.stdout


@pytest.mark.parametrize("space", hpcomp.SPACES)
def test_the_command_takes_the_options_of_stack(desk, space):
    options = ["--order", "top-down", "--op", "xor", "--background", "#ff0000", "--exposure", "1",
               "--hue-tolerance", "0", "--gray-bias", "0.25", "--canvas", "9x9-1-1",
               "--space", space]  # fmt: skip
    desk.makes("stack", "a.png", "b.png", "-o", "made.exr", "--depth", "float", *options)
    found = json.loads(
        desk.makes("explain", "a.png", "b.png", "--at", "-1,0", "--format", "json", *options).stdout
    )
    layer = hpcomp.read_layer(desk / "made.exr")
    assert found["canvas"] == {"x": -1, "y": -1, "width": 9, "height": 9}
    assert found["result"]["rgba"] == layer.pixels[1, 0].tolist()
    assert found["space"] == space


@pytest.mark.parametrize("space", hpcomp.SPACES)
def test_hue_and_chroma_are_those_of_the_space(desk, space):
    found = json.loads(
        desk.makes("explain", "a.png", "--at", "2,3", "--space", space, "--format", "json").stdout
    )
    (layer,), row = found["layers"], hpcomp.SPACES[space]
    color = np.array(layer["rgba"][:3])
    assert layer["chroma"] == pytest.approx(np.hypot(*row.forward(color[:, None])[1])[0])
    assert layer["hue"] == pytest.approx(row.hue_axis.degrees(color), abs=1e-3)


def test_a_pixel_outside_the_canvas_is_refused(desk):
    for at in ("7,0", "0,6", "-1,0"):
        desk.refuses(4, "explain", "a.png", "b.png", "--at", at,
                     says=["pixel", at, "outside the canvas 7x6+0+0"])  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["a.png"], 2, ["--at"]),
        (["a.png", "--at", "here"], 2, ["'here'", "X,Y"]),
        (["a.png", "--at", "0,0", "--order", "1,0"], 2, ["not a permutation"]),
        (["a.png", "--at", "0,0", "--foreign-tolerance", "200"], 2, ["foreign tolerance"]),
        (["a.png", "--at", "0,0", "--gray-bias", "2"], 2, ["gray bias 2", "0 to 1"]),
        (["a.png", "missing.png", "--at", "0,0"], 3, ["layer 1", "missing.png"]),
        (["a.png", "c.exr", "-", "-", "--at", "0,0"], 2, ["stdin"]),
    ],
)
def test_bad_input_has_its_line_and_its_code(desk, arguments, code, says):
    desk.refuses(code, "explain", *arguments, says=says)


@pytest.mark.parametrize("space", hpcomp.SPACES)
def test_plain_addition_meets_in_the_spaces_own_numbers(desk, space):
    layers = [desk / "a.png", desk / "b.png"]
    found = hpcomp.explain(layers, (2, 3), blending="traditional", space=space, op="plus")
    (meeting,) = found.meetings
    assert meeting.chroma == pytest.approx(found.result.chroma, rel=1e-5)
    assert meeting.hue == pytest.approx(found.result.hue, abs=1e-3)
    colors = [np.array(layer.rgba[:3], np.float64) for layer in found.layers]
    assert found.result.rgba[:3] == pytest.approx(colors[0] + colors[1], rel=1e-5)
    row = hpcomp.SPACES[space]
    _, p = row.forward((colors[0] + colors[1])[:, None])
    assert found.result.chroma == pytest.approx(np.hypot(*p)[0], rel=1e-5)
