"""`hpcomp.palette` and its command: what labels blend to, what is found, how it is shown."""

import io
import itertools
import json
import math
import re
import xml.etree.ElementTree as ElementTree

import colour
import numpy as np
import oracle
import pngfile
import pytest
from command import OLD, TERMINAL, Desk, hidden_matplotlib, loaded, made_elsewhere, on_terminal
from hypothesis import example, given, settings
from hypothesis import strategies as st
from PIL import Image
from strategies import color_of, valid_colors

import hpcomp
from hpcomp.analysis.palette import FINDING_KINDS, MOST_LABELS, PROFILE_STEPS, patch
from hpcomp.cli.group import cli
from hpcomp.color.css import css_color
from hpcomp.color.difference import contrast, difference, oklab
from hpcomp.engine import choice as engine
from hpcomp.errors import MismatchError, SettingError
from hpcomp.options import ARRAY_RULES
from hpcomp.report import palettedata
from hpcomp.report.paletteformats import FIGURES, PALETTE_FORMATS, PaletteLook, load

DRAWN = [name for name, row in PALETTE_FORMATS.items() if row.module == ".palettefigure"]
SET = ["fault=#e41a1c", "streams=#377eb8", "band=#ffdd00", "#808080"]


def planes_angle(p, q):
    """Degrees between p vectors."""
    return math.degrees(abs(math.atan2(p[0] * q[1] - p[1] * q[0], p[0] * q[0] + p[1] * q[1])))


def p_of(rgb, space="linear-rgb"):
    """p (2, n) of linear colours (n, 3)."""
    return hpcomp.SPACES[space].forward(np.asarray(rgb, np.float64).T)[1]


def render(name, palette, **look):
    return load(PALETTE_FORMATS[name])(palette, PaletteLook(**look))


colors = valid_colors(alpha=1.0).map(lambda rgba: tuple(map(float, rgba[:3])))


def literal_composite(space, layers, hue_tolerance, blending):
    job = {"hue_tolerance": hue_tolerance, "blending": blending}
    if space == "linear-rgb":
        return oracle.composite(layers, **job)
    return oracle.composite_in(space, layers, **job)


# ---- pairs -----------------------------------------------------------------------------------


@pytest.mark.parametrize("hue_tolerance", [0, 2, 10])
@pytest.mark.parametrize("space", ["linear-rgb", "xyz"])
def test_pairs_are_the_sums_of_the_paper(space, hue_tolerance):
    palette = hpcomp.palette(["#e41a1c", "#e43a1c", "#00c0ff"], space=space, hue_tolerance=hue_tolerance)
    assert [(p.back, p.front) for p in palette.pairs] == list(itertools.permutations(range(3), 2))
    for pair in palette.pairs:
        back, front = (palette.labels[n].rgb for n in (pair.back, pair.front))
        for step in range(0, PROFILE_STEPS, 16):
            opacity = step / (PROFILE_STEPS - 1)
            layers = [(*back, 1.0), (*(opacity * c for c in front), opacity)]
            for blending, profile in (("hue-preserving", pair.result), ("traditional", pair.traditional)):
                literal = literal_composite(space, layers, hue_tolerance, blending)
                assert profile.rgb[step] == pytest.approx(literal[:3], abs=1e-12)


@settings(max_examples=40)
@given(st.lists(colors, min_size=2, max_size=4))
@example([(0.0, 0.0, 0.0), (0.3678314542469868, 0.3678314542469869, 0.36783145424698693)])
def test_a_blend_has_the_hue_of_one_of_the_two_and_their_luminance(found):
    # What makes a grey of other than equal channels is rounding, which has no hue to keep.
    palette = hpcomp.palette(found, achromatic=1e-9)
    steps = np.linspace(0, 1, PROFILE_STEPS)[:, None]
    for pair in palette.pairs:
        assert pair.result.foreign == 0
        back, front = (np.array(palette.labels[n].rgb) for n in (pair.back, pair.front))
        mixed = (1 - steps) * back + steps * front
        assert pair.traditional.rgb == pytest.approx(mixed, abs=1e-12)
        weights = np.array(oracle.WEIGHTS)
        assert pair.result.rgb @ weights == pytest.approx(mixed @ weights, abs=1e-12)
        assert palette.mirrored(pair)


@pytest.mark.parametrize(
    ("one", "other"), [("#ff0000", "#00ffff"), ("#ffff00", "#0000ff"), ("#ff0000", "#ff8080")]
)
def test_opposite_and_equal_hues_blend_as_traditionally(one, other):
    """Figure 4 (c) to (e) of the paper."""
    for pair in hpcomp.palette([one, other]).pairs:
        assert pair.result.rgb == pytest.approx(pair.traditional.rgb, abs=1e-12)
        assert pair.traditional.foreign == 0


def test_two_hues_go_through_grey_where_their_chroma_is_in_balance():
    palette = hpcomp.palette(["#e41a1c", "#377eb8"])
    red, blue = palette.labels
    pair = palette.pair(0, 1)
    assert pair.result.turns_grey
    assert pair.result.left == pytest.approx(0, abs=1e-5)
    assert pair.result.least_at == pytest.approx(red.chroma / (red.chroma + blue.chroma), abs=1e-5)
    assert palette.pair(1, 0).result.least_at == pytest.approx(1 - pair.result.least_at, abs=1e-5)
    # Traditionally, the line between them passes the grey axis; its nearest point by brute force.
    opacities = np.linspace(0, 1, 100_001)
    p, q = p_of([red.rgb, blue.rgb]).T
    size = np.hypot(*(np.outer(p, 1 - opacities) + np.outer(q, opacities)))
    left = size / ((1 - opacities) * red.chroma + opacities * blue.chroma)
    assert pair.traditional.left == pytest.approx(left.min(), abs=1e-6)
    assert pair.traditional.least_at == pytest.approx(opacities[left.argmin()], abs=1e-3)
    assert not pair.traditional.turns_grey
    assert pair.angle == pytest.approx(planes_angle(p, q))
    assert 0.7 < pair.traditional.foreign < 0.9


def test_shares_are_counted_over_the_profile():
    palette = hpcomp.palette(["#ff0000", "#ffff00"])
    found = palette.pair(0, 1).traditional
    own = p_of([label.rgb for label in palette.labels]).T
    away = [min(planes_angle(p, q) for q in own) > 4 for p in p_of(found.rgb).T]
    assert found.foreign == pytest.approx(np.mean(away))
    assert found.grey == 0
    result = palette.pair(0, 1).result
    largest, smallest = result.rgb.max(axis=1), result.rgb.min(axis=1)
    assert result.grey == pytest.approx(np.mean(largest - smallest < 0.02 * largest))
    assert set(np.round(result.hues[~np.isnan(result.hues)], 6)) == {0.0, 60.0}


def test_equal_hues_lose_nothing_and_greys_have_none():
    palette = hpcomp.palette(["#ff0000", "#ff4040", "#808080"])
    shades, with_grey = palette.pair(0, 1), palette.pair(0, 2)
    assert (shades.equality, shades.angle) == (1.0, pytest.approx(0, abs=1e-6))
    assert (shades.result.left, shades.result.least_at) == (pytest.approx(1), None)
    assert (with_grey.angle, with_grey.result.least_at, with_grey.result.turns_grey) == (None, None, False)
    greys = hpcomp.palette(["#808080", "#ffffff"]).pair(0, 1)
    assert (greys.result.left, greys.result.grey, greys.result.foreign) == (None, 1.0, 0.0)


def test_a_hue_at_half_the_shoulder_is_halfway_equal():
    directions = [color_of(hue, 0.3, 0.4) for hue in (0.0, 3.0)]
    pair = hpcomp.palette(directions).pair(0, 1)
    assert pair.angle == pytest.approx(3)
    assert pair.equality == pytest.approx(0.5)


def test_the_pair_that_goes_grey_soonest_is_first():
    palette = hpcomp.palette(["#e41a1c", "#401010", "#377eb8", "#808080"])
    found = [p.result.least_at for p in palette.soonest if p.result.turns_grey]
    assert len(palette.soonest) == 6
    assert found == sorted(found)
    assert all(at <= 0.5 for at in found)
    assert (palette.soonest[0].back, palette.soonest[0].front) == (1, 2)
    assert palette.distinct == palette.soonest  # each is its own reverse backwards


# ---- strengths and presets -------------------------------------------------------------------


@pytest.mark.parametrize("strength", ["perceived", "coverage"])
def test_pairs_are_the_sums_by_strength(strength):
    palette = hpcomp.palette(SET[:3], strength=strength, gray_bias=0.5)
    for pair in palette.pairs:
        back, front = (palette.labels[n].rgb for n in (pair.back, pair.front))
        for step in range(0, PROFILE_STEPS, 16):
            opacity = step / (PROFILE_STEPS - 1)
            layers = [(*back, 1.0), (*(opacity * c for c in front), opacity)]
            literal = oracle.composite_in("linear-rgb", layers, gray_bias=0.5, strength=strength)
            assert pair.result.rgb[step] == pytest.approx(literal[:3], abs=1e-12)
    plain = hpcomp.palette(SET[:3], gray_bias=0.5)
    assert palette.pair(0, 2).result.least_at != pytest.approx(plain.pair(0, 2).result.least_at, abs=1e-3)


def test_labels_on_the_background_are_as_strong_as_they_cover():
    """A pale label over a vivid background: by chroma it loses its hue, by coverage it has it."""
    labels, rules = ["#c08080", "#ffffff"], {"background": "#00f", "opacity": 0.75}
    lost = hpcomp.palette(labels, **rules).on_background[0]["hue-preserving"]
    kept = hpcomp.palette(labels, strength="coverage", **rules).on_background[0]["hue-preserving"]
    assert (lost.keeps_hue, kept.keeps_hue) == (False, True)
    layer = tuple(0.75 * np.array([*css_color("#c08080", "label"), 1.0]))
    literal = oracle.composite_in("linear-rgb", [layer], background=(0, 0, 1), strength="coverage")
    assert kept.rgb == pytest.approx(literal[:3], abs=1e-12)


def test_a_preset_is_its_choices(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    choices = {"space": "oklab", "order": "simultaneous", "strength": "coverage", "gray_bias": 1.0}
    assert render("json", hpcomp.palette(SET, preset="labels")) == render("json", hpcomp.palette(SET, **choices))
    pixels = np.zeros((8, 8, 4), np.float32)
    pixels[:4], pixels[4:] = (0.8, 0.1, 0.1, 1), (0.1, 0.2, 0.9, 1)
    hpcomp.write_image("two.png", pixels)
    # Labels of a file are named after hues of the preset's space.
    by_preset = hpcomp.palette(layers=["two.png"], preset="labels")
    assert [row.name for row in by_preset.labels] == [
        row.name for row in hpcomp.palette(layers=["two.png"], space="oklab").labels
    ]
    assert by_preset.labels[0].name != hpcomp.palette(layers=["two.png"]).labels[0].name


# ---- woven -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("space", "strength", "weave", "size"),
    [
        ("linear-rgb", "chroma", "stripes", 8),
        ("linear-rgb", "coverage", "stripes", 5),
        ("xyz", "perceived", "noise", 2),
        ("oklab", "coverage", "noise", 3),
        ("cielab", "chroma", "stripes", 3),
    ],
)
def test_a_woven_blend_is_what_a_picture_of_it_shows(space, strength, weave, size):
    """Pixel by pixel: the threads with their shares are all that there is to say."""
    rules = {"blending": "woven", "space": space, "strength": strength, "weave": weave, "weave_size": size}
    palette = hpcomp.palette(SET, **rules)
    for pair in palette.pairs:
        opacities = np.broadcast_to(np.linspace(0, 1, PROFILE_STEPS), (20, PROFILE_STEPS))
        opaque = [np.array([*palette.labels[n].rgb, 1.0]) for n in (pair.back, pair.front)]
        layers = [np.broadcast_to(opaque[0], (*opacities.shape, 4)), opacities[..., None] * opaque[1]]
        picture = hpcomp.composite(layers, **rules)
        shown, _ = patch(pair.result, palette.stack.weave, *opacities.shape[::-1])
        assert shown == pytest.approx(picture[..., :3], abs=1e-9)


@pytest.mark.parametrize("strength", ["chroma", "perceived", "coverage"])
def test_threads_keep_their_hue_and_share_the_pixels_by_strength(strength):
    palette = hpcomp.palette(SET[:3], blending="woven", strength=strength)
    steps = np.linspace(0, 1, PROFILE_STEPS)
    for pair in palette.pairs:
        threads = {thread.label: thread for thread in pair.result.threads}
        assert set(threads) == {pair.back, pair.front}
        colors = {n: np.array(palette.labels[n].rgb) for n in threads}
        m = {n: oracle.strength_of(strength, tuple(color), 1.0) if strength != "chroma"
             else palette.labels[n].chroma for n, color in colors.items()}  # fmt: skip
        front = steps * m[pair.front] / (steps * m[pair.front] + (1 - steps) * m[pair.back])
        assert threads[pair.front].share == pytest.approx(front, abs=1e-9)
        assert threads[pair.back].share == pytest.approx(1 - front, abs=1e-9)
        mixed = np.outer(1 - steps, colors[pair.back]) + np.outer(steps, colors[pair.front])
        for number, thread in threads.items():
            there = thread.share > 0
            assert thread.rgb[there] @ oracle.WEIGHTS == pytest.approx(mixed[there] @ oracle.WEIGHTS, abs=1e-9)
            assert thread.rgb.min() >= -1e-9
            assert thread.rgb.max() <= 1 + 1e-9
            own = p_of([palette.labels[number].rgb])[:, 0]
            away = [planes_angle(p, own) for p in p_of(thread.rgb[there]).T]
            assert max(away) < 1e-3
        mean = sum(thread.share[:, None] * thread.rgb for thread in threads.values())
        assert pair.result.rgb == pytest.approx(mean)
        assert (pair.result.foreign, pair.result.grey, pair.result.turns_grey) == (0, 0, False)
        size = sum(thread.share * np.hypot(*p_of(thread.rgb)) for thread in threads.values())
        brought = (1 - steps) * palette.labels[pair.back].chroma + steps * palette.labels[pair.front].chroma
        assert pair.result.left <= (size / brought).min() + 1e-9
        assert pair.result.left == pytest.approx((size / brought).min(), abs=1e-3)


def test_from_afar_a_woven_blend_is_the_ordinary_one():
    """Where there is room for both threads."""
    palette = hpcomp.palette([color_of(hue, 0.1, 0.4) for hue in (10, 130, 250)], preset="woven")
    for pair in palette.pairs:
        assert pair.result.rgb == pytest.approx(pair.traditional.rgb, abs=1e-9)
        assert pair.result.left == pytest.approx(1)
        assert palette.mirrored(pair)


def test_a_woven_pair_does_not_go_grey():
    labels = ["#300", "#00f"]
    assert only("goes-grey", labels).blendings == ("hue-preserving",)
    assert kinds(*labels, preset="woven") == []
    # Opposite hues do in ordinary blending.
    assert only("goes-grey", ["#300", "#0ff"], preset="woven").blendings == ("traditional",)


def test_close_hues_are_woven_one_by_one():
    close = hpcomp.palette(["#f00", "fire=#f20"], preset="woven")
    assert close.pair(0, 1).equality == 0
    (found,) = close.findings
    assert "once pale, they are hard to tell apart" in palettedata.sentence(close, found)
    assert hpcomp.palette(["#f00", "#800000"], preset="woven").pair(0, 1).equality == 1


def test_a_label_on_the_background_is_judged_by_its_thread():
    rules = {"background": "#00f", "opacity": 0.3}
    by_chroma, woven = (hpcomp.palette(["#800000", "#ffffff"], **rules, **more) for more in ({}, {"preset": "woven"}))
    assert by_chroma.findings[-1].kind == "hue-lost"
    assert by_chroma.findings[-1].blendings == ("traditional", "hue-preserving")
    on = woven.on_background[0]["woven"]
    assert on.keeps_hue
    (lost,) = (f for f in woven.findings if f.kind == "hue-lost")
    assert lost.blendings == ("traditional",)
    m = [oracle.strength_of("coverage", c, 1.0) for c in (woven.labels[0].rgb, (0.0, 0.0, 1.0))]
    assert on.share == pytest.approx(0.3 * m[0] / (0.3 * m[0] + 0.7 * m[1]))
    assert on.difference == pytest.approx(float(difference(on.rgb, [0, 0, 1])))
    white = hpcomp.palette(SET, preset="woven").on_background
    assert {row["woven"].share for row in white} == {1.0}
    for row in white:
        assert row["woven"].rgb == pytest.approx(row["traditional"].rgb, abs=1e-9)


def test_woven_mixtures_keep_to_spokes_and_reach_the_labels():
    palette = hpcomp.palette(["#f00", "#0f0", "#00f"], preset="woven", order="1,2,0")
    own = p_of([label.rgb for label in palette.labels])
    p, rgb = mixed(palette, "woven")
    assert rgb.min() > -1e-6
    assert rgb.max() < 1 + 1e-6
    colored = np.hypot(*p) > 1e-4
    nearest = np.array([[planes_angle(q, v) for v in own.T] for q in p.T[colored][::997]])
    assert nearest.min(axis=1).max() < 0.1
    assert np.abs(rgb - 1).max(axis=0).min() < 1e-6  # the background
    for label in palette.labels:
        assert np.abs(rgb.T - label.rgb).max(axis=1).min() < 1e-6


def test_threads_in_text_and_data():
    palette = hpcomp.palette(["#e41a1c", "#377eb8"], preset="woven")
    data = json.loads(render("json", palette))
    threads = {row["label"]: row for row in data["pairs"][0]["result"]["threads"]}
    assert "threads" not in data["pairs"][0]["traditional"]
    assert "threads" not in json.loads(render("json", hpcomp.palette(SET)))["pairs"][0]["result"]
    assert [len(row[key]) for row in threads.values() for key in ("share", "srgb")] == [17] * 4
    text = render("text", palette).decode()
    back, front = (f"{threads[n]['srgb'][8]} {threads[n]['share'][8]:.0%}" for n in (0, 1))
    assert f"  {back}, {front}\n" in text
    assert "threads at 50%" in text
    assert "order" not in text.splitlines()[0]
    assert "weave stripes" in " ".join(text.split())
    assert "threads" not in render("text", hpcomp.palette(SET)).decode()
    one = render("text", hpcomp.palette(["#e41a1c", "#808080"], preset="woven")).decode()
    assert re.search(r"  #[0-9a-f]{6} 100%\n", one)


def test_a_figure_shows_the_pattern():
    palette = hpcomp.palette(["#ff0000", "#0060ff"], preset="woven")
    pixels = picture(palette, figure="profiles")
    threads = json.loads(render("json", palette))["pairs"][0]["result"]["threads"]
    right = pixels[:, len(pixels[0]) * 6 // 10 :]
    counts = []
    for thread in threads:
        color = np.array(list(bytes.fromhex(thread["srgb"][8][1:])))
        counts.append(int((np.abs(right - color).max(axis=2) < 6).sum()))
    assert min(counts) > 100  # the colours of both threads in the middle of the bar, at once
    mean = np.array(list(bytes.fromhex(json.loads(render("json", palette))["pairs"][0]["result"]["srgb"][8][1:])))
    assert (np.abs(right - mean).max(axis=2) < 6).sum() < min(counts) / 10


# ---- mixtures --------------------------------------------------------------------------------


@pytest.fixture(params=engine.NAMES)
def each_engine(request, monkeypatch):
    monkeypatch.setenv(engine.VARIABLE, request.param)


def mixed(palette, blending):
    parts = list(palette.mixtures(blending))
    return tuple(np.concatenate([part[k] for part in parts], axis=1) for k in (0, 1))


@pytest.mark.parametrize("order", ["bottom-up", "simultaneous", "1,2,0"])
def test_mixtures_fill_a_polygon_or_keep_to_spokes(each_engine, order):
    """Figure 6 of the paper."""
    palette = hpcomp.palette(["#f00", "#0f0", "#00f"], order=order)
    own = p_of([label.rgb for label in palette.labels])
    p, _ = mixed(palette, "hue-preserving")
    size = np.hypot(*p)
    colored = size > 1e-4
    nearest = np.array([[planes_angle(q, v) for v in own.T] for q in p.T[colored][::97]])
    assert nearest.min(axis=1).max() < 0.1
    for k, label in enumerate(palette.labels):
        reached = size[colored][::97][nearest.argmin(axis=1) == k]
        assert reached.max() == pytest.approx(label.chroma, rel=0.1)
        assert size.max() == pytest.approx(max(label.chroma for label in palette.labels), rel=1e-5)

    p, _ = mixed(palette, "traditional")
    # Barycentric weights in the triangle of the labels: none is negative, all are reached.
    corners = np.concatenate([own, np.ones((1, 3))])
    weights = np.linalg.solve(corners, np.concatenate([p, np.ones((1, p.shape[1]))]))
    assert weights.min() > -1e-5
    cells = {tuple(cell) for cell in np.floor(weights[:2].T * 20 + 1e-6).astype(int).tolist()}
    assert {(i, j) for i in range(20) for j in range(20 - i)} <= cells


def test_mixtures_lie_on_the_background(each_engine):
    white = hpcomp.palette(["#f00", "#00f"])
    black = hpcomp.palette(["#f00", "#00f"], background="#000")
    for blending in ("traditional", "hue-preserving"):
        for palette, corner in ((white, 1.0), (black, 0.0)):
            _, rgb = mixed(palette, blending)
            assert np.abs(rgb - corner).max(axis=0).min() == 0
            for label in palette.labels:
                assert np.abs(rgb.T - label.rgb).max(axis=1).min() < 1e-6
    p, _ = mixed(hpcomp.palette(["#f00", "#00f"], background="#0f0"), "hue-preserving")
    hues = {round(float(h)) for h in np.degrees(np.arctan2(*p[::-1, np.hypot(*p) > 0.01]))}
    assert len(hues) == 3  # the background's is one of them


# ---- how different ---------------------------------------------------------------------------


def test_oklab_is_that_of_colour_science():
    rgb = np.random.default_rng(3).random((50, 3))
    xyz = colour.RGB_to_XYZ(rgb, "sRGB", apply_cctf_decoding=False)
    # Its matrix from XYZ is given in 10 digits, ours is the one for linear sRGB.
    assert oklab(rgb) == pytest.approx(colour.XYZ_to_Oklab(xyz), abs=5e-4)
    assert oklab([1, 1, 1]) == pytest.approx([1, 0, 0], abs=1e-6)
    assert difference([0, 0, 0], [1, 1, 1]) == pytest.approx(1)


def test_contrast_is_that_of_the_web():
    assert contrast(0.0, 1.0) == pytest.approx(21)
    assert contrast(0.4, 0.4) == 1
    grey = css_color("#767676", "label")[0]  # known as the lightest grey of 4.5:1 on white
    assert contrast(1.0, grey) == pytest.approx(4.54, abs=0.005)


# ---- findings --------------------------------------------------------------------------------


def kinds(*labels, **settings):
    return [(f.kind, f.labels) for f in hpcomp.palette(labels, **settings).findings]


def test_findings_and_none():
    assert kinds("#f00", "#0f0", "#00f") == []
    assert kinds("#f00", "#808080") == [("no-hue", (1,))]
    assert kinds("#f00", "#f20") == [("close-hues", (0, 1))]
    assert kinds("#f00", "#ffff66") == [("vanishes", (1,))]
    assert kinds("#300", "#00f") == [("goes-grey", (0, 1))]
    everything = kinds("#f00", "#f20", "#ffff66", "#808080", "#200", background="#5050ff", opacity=0.3)
    order = [FINDING_KINDS.index(kind) for kind, _ in everything]
    assert order == sorted(order)


def only(kind, labels, **settings):
    (found,) = [f for f in hpcomp.palette(labels, **settings).findings if f.kind == kind]
    return found


def test_limits_of_findings():
    angle = only("close-hues", ["#f00", "#f20"]).measured
    assert kinds("#f00", "#f20", close_hues=angle) == []
    assert kinds("#f00", "#f20", close_hues=angle + 1e-6) == [("close-hues", (0, 1))]
    faint = only("vanishes", ["#f00", "#ffff66"])
    mixed_light = 0.5 + 0.5 * np.array(css_color("#ffff66", "label"))
    assert faint.measured == pytest.approx(float(difference(mixed_light, [1, 1, 1])), abs=1e-9)
    assert kinds("#f00", "#ffff66", least_difference=faint.measured) == []
    assert kinds("#f00", "#ffff66", opacity=1.0) == []
    soon = only("goes-grey", ["#300", "#00f"])
    assert 0 < soon.measured < 0.25
    assert kinds("#300", "#00f", grey_opacity=soon.measured) == []
    assert kinds("#f00", "#ff8080", achromatic=0.9, close_hues=0)[0] == ("no-hue", (1,))


def test_a_finding_says_in_which_blending_it_is_so():
    both = only("vanishes", ["#f00", "#ffff66"])
    assert both.blendings == ("traditional", "hue-preserving")
    # Opposite hues go grey in any blending, others only with ⊕.
    assert only("goes-grey", ["#300", "#0ff"]).blendings == both.blendings
    assert only("goes-grey", ["#300", "#00f"]).blendings == ("hue-preserving",)
    # Red half over blue is blue with ⊕, and violet otherwise: red in neither.
    lost = only("hue-lost", ["#800000", "#ffffff"], background="#00f")
    assert (lost.labels, lost.blendings) == ((0,), both.blendings)
    # A red that is stronger keeps its hue with ⊕ alone.
    lost = only("hue-lost", ["#f00", "#ffffff"], background="#00f", opacity=0.8)
    assert lost.blendings == ("traditional",)


def test_a_lost_hue_says_why():
    def why(color, **options):
        palette = hpcomp.palette([color, "#ffffff"], **options)
        (found,) = (finding for finding in palette.findings if finding.kind == "hue-lost")
        return palettedata.sentence(palette, found).partition(": ")[2]

    assert why("#800000", background="#00f") == "the background's is stronger"
    # Only + turns a hue that is stronger; that of red in Oklab by white, which has none.
    turned = "mixing with the background turns it (traditional blending)"
    assert why("#f00", background="#00f", opacity=0.8) == turned
    assert why("#e41a1c", space="oklab") == turned


def test_on_a_grey_background_both_blendings_show_the_same():
    for on in hpcomp.palette(SET, background="#404040").on_background:
        assert on["traditional"].rgb == pytest.approx(on["hue-preserving"].rgb, abs=1e-12)


# ---- labels ----------------------------------------------------------------------------------


def test_names_and_colours():
    palette = hpcomp.palette(["fault=#E41A1C", "0f0", "a=b=#00f", (0.5, 0.25, 2.0), "=#abc", "Tan"])
    assert [label.name for label in palette.labels] == [
        "fault", "#0f0", "a=b", "rgb(0.5, 0.25, 2)", "#abc", "tan",
    ]  # fmt: skip
    assert palette.labels[0].rgb == css_color("#e41a1c", "label")
    assert palette.labels[1].rgb == (0, 1, 0)
    assert palette.labels[1].hue == 120
    assert palette.labels[1].chroma == pytest.approx(oracle.length(oracle.difference((0, 1, 0))))
    assert palette.labels[1].luminance == pytest.approx(oracle.WEIGHTS[1])


@pytest.mark.parametrize(
    ("labels", "settings", "message"),
    [
        (["#f00"], {}, "1 labels: a palette has 2 to 24"),
        (["#f00"] * (MOST_LABELS + 1), {}, "25 labels"),
        (["#f00", "#ggg"], {}, "'#ggg' is not a colour"),
        (["#f00", "#0f08"], {}, "'#0f08' is translucent, but a label is tried at every opacity"),
        (["#f00", "#0f0"], {"background": "#ffffff00"}, "a background is opaque: write #ffffff"),
        (["#f00", (1, 2)], {}, r"\(1, 2\) is not a colour: give three numbers"),
        (["#f00", (1, -1, 0)], {}, "is not a colour"),
        (["#f00", "#0f0"], {"background": "withe"}, "'withe' is not a colour.* or white$"),
        (["#f00", "#0f0"], {"opacity": 1.5}, "opacity 1.5 is outside 0 to 1"),
        (["#f00", "#0f0"], {"close_hues": math.nan}, "close hues nan is outside 0 to 180"),
        (["#f00", "#0f0"], {"least_difference": -1}, "least difference -1 is outside"),
        (["#f00", "#0f0"], {"grey_opacity": 2}, "gray opacity 2 is outside"),
        (["#f00", "#0f0"], {"achromatic": 2}, "achromatic saturation 2 is outside"),
        (["#f00", "#0f0"], {"blending": "traditional"}, "what others are compared with"),
        (["#f00", "#0f0"], {"blending": "none"}, "unknown blending 'none'"),
        (["#f00", "#0f0"], {"op": "over"}, "'op' says nothing of a palette"),
        (["#f00", "#0f0"], {"order": "0,1,2"}, "is not a permutation"),
        (["#f00", "#0f0"], {"space": "hsv"}, "unknown blending space"),
    ],
)
def test_settings_that_make_no_sense(labels, settings, message):
    with pytest.raises(SettingError, match=message):
        hpcomp.palette(labels, **settings)


@pytest.fixture
def desk(tmp_path, monkeypatch):
    for name in TERMINAL:
        monkeypatch.delenv(name, raising=False)
    desk = Desk.made(tmp_path)
    monkeypatch.chdir(desk.folder)
    desk.put("roads.png", pngfile.bands((228, 26, 28), alpha=100))
    desk.put("two.png", pngfile.bands((0, 255, 0), (0, 255, 0), (0, 0, 255)))
    desk.put("grey.png", pngfile.bands((90, 90, 90)))
    return desk


def test_labels_of_layers_are_the_peaks_of_their_hues(desk):
    palette = hpcomp.palette(["#ff0"], layers=["roads.png", "two.png", "two.png::name=map"])
    assert [label.name for label in palette.labels] == [
        "#ff0", "roads", "two 120°", "two 240°", "map 120°", "map 240°",
    ]  # fmt: skip
    assert palette.labels[1].rgb == pytest.approx(css_color("#e41a1c", "label"), abs=1e-6)
    assert palette.labels[3].rgb == pytest.approx((0, 0, 1), abs=1e-6)
    with pytest.raises(MismatchError, match=r"grey.png: no hue stands out in it"):
        hpcomp.palette(["#f00"], layers=["grey.png"])
    with pytest.raises(SettingError, match="'opacity' says nothing of a single picture"):
        hpcomp.palette(["#f00"], layers=["roads.png::opacity=0.5"])
    with pytest.raises(hpcomp.InputError, match="cannot be read"):
        hpcomp.palette(["#f00"], layers=["missing.png"])


# ---- data and text ---------------------------------------------------------------------------


def test_json_says_what_was_found():
    palette = hpcomp.palette(SET, space="xyz", background="#102030")
    data = json.loads(render("json", palette))
    assert set(data) <= set(palettedata.JSON_KEYS)
    assert (data["schema"], data["version"]) == ("hpcomp.palette", 1)
    assert data["rules"]["space"] == "xyz"
    assert data["rules"] | {"blending": "hue-preserving", "hue_tolerance": 2.0} == data["rules"]
    assert data["settings"]["background"] == "#102030"
    assert [label["srgb"] for label in data["labels"]] == ["#e41a1c", "#377eb8", "#ffdd00", "#808080"]
    assert data["labels"][3]["hue"] is None
    assert len(data["pairs"]) == 12
    for pair, found in zip(data["pairs"], palette.pairs, strict=True):
        ends = [data["labels"][pair[side]]["srgb"] for side in ("back", "front")]
        for way in ("traditional", "result"):
            assert len(pair[way]["srgb"]) == 17
            assert [pair[way]["srgb"][0], pair[way]["srgb"][-1]] == ends
        assert pair["result"]["foreign"] == pytest.approx(found.result.foreign)
    for finding, found in zip(data["findings"], palette.findings, strict=True):
        assert finding["kind"] == found.kind
        assert finding["message"] == palettedata.sentence(palette, found)
    assert data["findings"]


def test_every_rule_of_a_stack_is_in_the_data():
    rules = json.loads(render("json", hpcomp.palette(SET)))["rules"]
    elsewhere = {"preset", "background", "exposure"}
    assert set(rules) == set(ARRAY_RULES) - elsewhere - {"weave", "weave_size"}
    woven = json.loads(render("json", hpcomp.palette(SET, preset="woven", weave="noise", weave_size=5)))
    assert set(woven["rules"]) == set(ARRAY_RULES) - elsewhere - {"order", "gray_bias"}
    named = {name: woven["rules"][name] for name in ("blending", "strength", "weave", "weave_size")}
    assert named == {"blending": "woven", "strength": "coverage", "weave": "noise", "weave_size": 5}


def test_text_says_what_was_found():
    text = render("text", hpcomp.palette(SET)).decode()
    assert "\x1b" not in text
    assert re.search(r"^streams → band +172° +\d+% +\d+% at \d+% +0% +grey at 30%$", text, re.MULTILINE)
    assert re.search(r"^■ #808080 +#808080 +- +0\.000", text, re.MULTILINE)
    assert "no-hue" in text
    assert text.endswith("\n")
    clean = render("text", hpcomp.palette(["#f00", "#00f"])).decode()
    assert clean.endswith("\nno findings\n")
    narrow = render("text", hpcomp.palette(SET), columns=40).decode().partition("findings")[2]
    assert max(map(len, narrow.splitlines())) <= 40
    assert render("text", hpcomp.palette(SET), encoding="ascii").decode("ascii").count("->") == 7


def test_bars_on_a_terminal_are_the_blend_and_its_hue():
    palette = hpcomp.palette(["#f00", "#0ff"])
    text = render("text", palette, color=True, columns=60).decode()
    (line,) = [line for line in text.splitlines() if "▀" in line]
    cells = re.findall(r"\x1b\[38;2;(\d+);(\d+);(\d+);48;2;(\d+);(\d+);(\d+)m▀", line)
    codes = np.array(cells, int)
    assert len(codes) == 2 * 27
    left, right = codes[:27], codes[27:]
    assert (left == right).all()  # opposite hues
    assert set(map(tuple, right[:, 3:].tolist())) == {(255, 0, 0), (128, 128, 128), (0, 255, 255)}
    middle = np.array([0.5, 0.5, 0.5]) * 0 + right[13, :3]
    assert np.ptp(middle) <= 2
    assert line.endswith("\x1b[0m")


@pytest.mark.parametrize("format", PALETTE_FORMATS)
def test_any_name_is_shown_harmlessly(format):
    """Of labels that look like others, so that there is a sentence on them."""
    names = ["a\x1b[31m\nb", "$x^2$ & <b>", "日本\udcff", "é" * 300]
    content = render(format, hpcomp.palette([f"{n}=#f{k}0" for k, n in enumerate(names)]))
    assert b"\x1b" not in content or format in ("png", "pdf")
    if format == "svg":
        ElementTree.fromstring(content)


def test_light_beyond_white_is_shown_darker():
    palette = hpcomp.palette([(4.0, 0.0, 0.0), (0.0, 0.0, 2.0)])
    pair = json.loads(render("json", palette))["pairs"][0]
    assert (pair["result"]["srgb"][0], pair["result"]["srgb"][-1]) == ("#ff0000", "#0000bc")


# ---- figures ---------------------------------------------------------------------------------


def picture(palette, **look):
    return np.asarray(Image.open(io.BytesIO(render("png", palette, **look))).convert("RGB")).astype(int)


def test_a_figure_shows_the_blends():
    palette = hpcomp.palette(["#ff0000", "#0000ff"])
    pixels = picture(palette, figure="profiles")
    rows = [y for y in range(len(pixels)) if (pixels[y, -40] == pixels[y, -40]).all()
            and np.abs(pixels[y, -40] - (0, 0, 255)).max() < 30]  # fmt: skip
    bar = pixels[rows[len(rows) // 2]]
    columns = np.flatnonzero(np.ptp(bar, axis=1) > 60)
    start, end = columns[columns > len(bar) * 0.6].min(), columns.max()
    assert np.abs(bar[start] - (255, 0, 0)).max() < 30
    assert np.abs(bar[end] - (0, 0, 255)).max() < 30
    profile = json.loads(render("json", palette))["pairs"][0]["result"]["srgb"]
    for k in (4, 8, 12):
        shown = bar[round(start + (end - start) * k / 16)]
        assert np.abs(shown - list(bytes.fromhex(profile[k][1:]))).max() < 12


def test_a_figure_has_both_discs():
    palette = hpcomp.palette(["#f00", "#0f0", "#00f"])
    pixels = picture(palette, figure="discs")
    halves = pixels[:, :700], pixels[:, 700:]
    inside = [int((np.abs(half - 199).max(axis=2) < 4).sum()) for half in halves]
    # The triangle covers about a third of its disc, the spokes hardly any.
    assert 0.5 < inside[0] / inside[1] < 0.85


@pytest.mark.parametrize("figure", FIGURES)
def test_sizes_of_figures(figure):
    heights = [len(picture(hpcomp.palette(SET[:n]), figure=figure)) for n in (2, 4)]
    assert heights[1] - heights[0] == pytest.approx(0 if figure == "discs" else 5 * 0.345 * 200, abs=2)


def test_a_figure_has_a_limit():
    many = [color_of(30.0 * k, 0.2, 0.3) for k in range(13)]
    with pytest.raises(SettingError, match="12 labels at most, not 13"):
        render("svg", hpcomp.palette(many))
    pairs = 12 * 11 // 2
    from hpcomp.report import palettefigure as figure

    sheet = figure._Sheet(hpcomp.palette(many[:12]), PaletteLook(figure="profiles"))
    assert sheet.left_out == pairs - figure.MOST_PAIRS
    assert any(f"{sheet.left_out} pairs" in text.get_text() for text in sheet.figure.texts)


def test_names_around_a_disc_do_not_touch():
    from hpcomp.report import palettefigure as figure

    for angles in ([0, 1, 2, 3], [358, 0.5, 2, 180], [10], [90, 90, 90, 90, 90], []):
        moved = figure._apart(np.array(angles, float), 11.0)
        gaps = np.diff(np.sort(moved % 360), append=np.sort(moved % 360)[:1] + 360)
        assert len(moved) < 2 or gaps.min() > 10.8
    assert figure._apart(np.array([0.0, 90.0]), 11.0) == pytest.approx([0, 90])


@pytest.mark.slow
@pytest.mark.parametrize("name", PALETTE_FORMATS)
def test_same_bytes_in_another_process_at_another_time(name, tmp_path):
    """Whatever the user's matplotlibrc, the time, the hash seed and the locale."""
    code = (
        "import sys, hpcomp; from hpcomp.report.paletteformats import *; "
        "render = load(PALETTE_FORMATS[sys.argv[1]]); "
        "sys.stdout.buffer.write(render(hpcomp.palette(['#e41a1c', '#377eb8']), PaletteLook()))"
    )
    made = made_elsewhere(code, name, tmp_path)
    assert made == {render(name, hpcomp.palette(["#e41a1c", "#377eb8"]))}


# ---- the command -----------------------------------------------------------------------------

ARGUMENTS = ["#e41a1c", "streams=377eb8"]


@pytest.mark.parametrize("name", PALETTE_FORMATS)
def test_every_format_in_a_file_and_in_a_pipe(desk, name):
    content = render(name, hpcomp.palette(ARGUMENTS))
    ending = PALETTE_FORMATS[name].ending
    assert desk.makes("palette", *ARGUMENTS, "-o", f"p{ending}").stdout == b""
    assert (desk / f"p{ending}").read_bytes() == content
    assert desk.makes("palette", *ARGUMENTS, "--format", name).stdout == content
    hpcomp.write_palette_report(hpcomp.palette(ARGUMENTS), "api", format=name)
    assert (desk / "api").read_bytes() == content


def test_options_reach_the_palette(desk):
    woven = desk.makes("palette", *ARGUMENTS, "--preset", "woven", "--strength", "perceived",
                       "--weave", "noise", "--weave-size", "4", "--format", "json")  # fmt: skip
    assert woven.stdout == render("json", hpcomp.palette(
        ARGUMENTS, blending="woven", strength="perceived", weave="noise", weave_size=4))  # fmt: skip
    run = desk.makes(
        "palette", *ARGUMENTS, "--from", "roads.png::name=r", "--space", "xyz", "--order",
        "simultaneous", "--hue-tolerance", "3", "--background", "#123", "--opacity", "0.4",
        "--least-difference", "0.3", "--close-hues", "20", "--grey-opacity", "0.45",
        "--achromatic", "0.1", "--format", "json",
    )  # fmt: skip
    palette = hpcomp.palette(
        ARGUMENTS, layers=["roads.png::name=r"], space="xyz", order="simultaneous",
        hue_tolerance=3, background="#123", opacity=0.4, least_difference=0.3, close_hues=20,
        grey_opacity=0.45, achromatic=0.1,
    )  # fmt: skip
    assert run.stdout == render("json", palette)
    assert run.stdout != render("json", hpcomp.palette(ARGUMENTS, layers=["roads.png::name=r"]))


def test_every_rule_of_colours_is_an_option():
    command = cli.get_command(None, "palette")
    rules = set(ARRAY_RULES) - {"background", "exposure", "primaries"}
    assert rules >= {"blending", "order", "space", "hue_tolerance"}
    assert rules <= {parameter.name for parameter in command.params}


def test_findings_are_an_exit_code_with_strict(desk):
    close = ["#f00", "fire=#f20"]
    plain = desk.makes("palette", *close)
    run = desk.run("palette", *close, "--strict")
    assert (run.code, run.stdout) == (6, plain.stdout)
    assert run.lines == [
        "hpcomp: palette: close-hues: #f00 and fire are 1.0° apart, less than 15°: blending takes "
        "them for one label"
    ]
    assert desk.run("palette", *close, "--strict", "-o", "p.svg").code == 6
    assert (desk / "p.svg").is_file()
    desk.makes("palette", "#f00", "#00f", "--strict")
    desk.makes("palette", *close, "--strict", "--close-hues", "0.5")


def test_colours_that_the_shell_took_for_a_comment(desk):
    for arguments in ([], ["#f00"]):
        desk.refuses(2, "palette", *arguments, says=["quote '#…'", "comment", "without #"])


def test_what_is_refused(desk):
    desk.refuses(2, "palette", "#f00", "#nothex", says=["'#nothex' is not a colour"])
    desk.refuses(2, "palette", *ARGUMENTS, "--blending", "traditional", says=["compared"])
    desk.refuses(2, "palette", *ARGUMENTS, "--op", "xor", says=["--op"])
    desk.refuses(2, "palette", *ARGUMENTS, "-o", "p.gif", says=["p.gif", ".txt, .json, .svg"])
    desk.refuses(2, "palette", "#f00", "--from", "-", "--from", "-", says=["stdin"])
    desk.refuses(2, "palette", "--from", "two.png", "-o", "two.png", "--format", "svg", says=["replace"])
    desk.refuses(3, "palette", "--from", "missing.png", says=["missing.png"])
    desk.refuses(4, "palette", "--from", "grey.png", says=["no hue stands out", "grey.png"])
    desk.refuses(5, "palette", *ARGUMENTS, "-o", "nowhere/p.txt", says=["there is no directory"])
    desk.put("p.txt", OLD)
    desk.refuses(5, "palette", *ARGUMENTS, "-o", "p.txt", "--no-clobber", says=["--no-clobber"])


def test_labels_from_stdin(desk):
    run = desk.makes("palette", "--from", "-::name=map", stdin=(desk / "two.png").read_bytes())
    assert "map 120°" in run.stdout.decode()


def test_colours_on_a_terminal_and_not_in_a_pipe(desk):
    code, sent, error = on_terminal(desk, "palette", *ARGUMENTS)
    assert (code, error) == (0, "")
    palette = hpcomp.palette(ARGUMENTS)
    assert sent.encode() == render("text", palette, columns=90, color=True)
    assert "▀" in sent
    _, plain, _ = on_terminal(desk, "palette", *ARGUMENTS, NO_COLOR="1")
    assert plain.encode() == render("text", palette, columns=90)
    forced = desk.run("palette", *ARGUMENTS, env={"FORCE_COLOR": "1"})
    assert forced.stdout == render("text", palette, color=True)
    code, sent, error = on_terminal(desk, "palette", *ARGUMENTS, "--format", "png")
    assert (code, sent) == (2, "")
    assert "a terminal shows no png" in error


@pytest.mark.parametrize("name", DRAWN)
def test_figures_without_matplotlib_say_what_to_install(desk, name):
    without = hidden_matplotlib(desk)
    says = ["matplotlib", "pip install 'hpcomp[plot]'"]
    desk.refuses(5, "palette", *ARGUMENTS, "--format", name, says=says, through=without)
    assert desk.makes("palette", *ARGUMENTS, through=without).stdout


def test_what_is_loaded(desk):
    heavy = {"OpenImageIO", "OpenEXR", "colour", "matplotlib", "scipy"}
    assert not loaded(desk, "palette", "--help") & heavy
    assert not loaded(desk, "palette", *ARGUMENTS) & heavy
    assert not loaded(desk, "palette", *ARGUMENTS, "-o", "p.svg") & (heavy - {"matplotlib"})
