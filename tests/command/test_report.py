"""Hue reports in every format: what they say, that they say it the same way every time."""

import ast
import csv
import io
import itertools
import json
import re
import xml.etree.ElementTree as ElementTree
import zlib
from functools import cache
from pathlib import Path

import numpy as np
import pngfile
import pytest
from command import made_elsewhere
from hypothesis import given
from hypothesis import strategies as st

import hpcomp
from hpcomp import HueHistogram, MismatchError, OutputError, SettingError, hue_histogram
from hpcomp.color.hueaxis import HEXAGON
from hpcomp.measures.histogram import WEIGHTS
from hpcomp.report import huedata
from hpcomp.report.hueformats import REPORT_FORMATS, report_format, write_hue_report
from hpcomp.report.look import (
    AXES,
    SCALES,
    WEIGHT_TITLES,
    Look,
    axis_start,
    hue_colors,
    percent,
    srgb_hex,
    ticks,
)

FIGURES = [name for name, row in REPORT_FORMATS.items() if row.module == ".huefigure"]


def labels(counts, grey=0, transparent=0, **settings):
    """The histogram of so many pixels of each hue, and of so many without one."""
    rows = [
        *((*(0.1 + 0.5 * HEXAGON.color(np.array(float(hue)))), 1.0) for hue, n in counts.items() for _ in range(n)),
        *[(0.5, 0.5, 0.5, 1.0)] * grey,
        *[(0.0, 0.0, 0.0, 0.0)] * transparent,
    ]  # fmt: skip
    return hue_histogram(np.array(rows).reshape(-1, 4), **settings)


THREE = labels({0: 50, 60: 30, 240: 20}, grey=60, transparent=40)
SMEAR = labels(dict.fromkeys(range(360), 1))
NOTHING = labels({}, grey=5)
ENTRIES = [("three", THREE), ("smear", SMEAR)]


def render(name, entries=ENTRIES, **look):
    return REPORT_FORMATS[name].load()(entries, Look(**look))


@cache
def usual(name):
    """The same with all that `render` takes if nothing is said, rendered once."""
    return render(name)


# ---- all formats -----------------------------------------------------------------------------

SEVERAL = [(f"image {n}", THREE if n % 2 else SMEAR) for n in range(12)]


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("entries", [[("none", NOTHING)], ENTRIES, SEVERAL[:4]], ids=len)
@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_same_histograms_same_bytes(name, entries):
    assert render(name, entries) == render(name, entries)


@pytest.mark.slow
@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_same_bytes_in_another_process_at_another_time(name, tmp_path):
    """Whatever the user's matplotlibrc, the time, the hash seed and the locale."""
    code = (
        "import sys; from hpcomp.report.hueformats import REPORT_FORMATS; "
        "from hpcomp.report.look import Look; import hpcomp; "
        "found = hpcomp.hue_histogram([(1, 0, 0, 1), (0, 1, 0.5, 1), (1, 1, 1, 1)] * 9); "
        "render = REPORT_FORMATS[sys.argv[1]].load(); "
        "sys.stdout.buffer.write(render([('one', found)], Look()))"
    )
    made = made_elsewhere(code, name, tmp_path)
    assert len(made) == 1
    assert len(made.pop()) > 100


@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_histograms_of_other_bins_are_not_compared(name):
    with pytest.raises(MismatchError, match="other: its histogram has 36 bins"):
        render(name, [("three", THREE), ("other", labels({0: 1}, bins=36))])


@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_any_name_is_shown_harmlessly(name):
    labels = ["a\x1b[31m\nb", "$x^2$ & <b>", "日本\udcff", "é" * 300]
    content = render(name, [(label, THREE) for label in labels])
    assert b"\x1b" not in content or name in ("png", "pdf")
    if name == "svg":
        ElementTree.fromstring(content)


def test_report_of_a_file_by_its_ending(tmp_path):
    for name, row in REPORT_FORMATS.items():
        path = tmp_path / f"report{row.ending}"
        write_hue_report({"three": THREE, "smear": SMEAR}, path)
        assert path.read_bytes() == usual(name)
    path = tmp_path / "report"
    write_hue_report(dict(ENTRIES), path, format="svg", weight="chroma", scale="log", axes="polar")
    assert path.read_bytes() == render("svg", weight="chroma", scale="log", axes="polar")


def test_report_that_cannot_be_made(tmp_path):
    with pytest.raises(SettingError, match=r"its ending names no format: end it in .txt, .json"):
        write_hue_report({"a": THREE}, tmp_path / "report.foo")
    with pytest.raises(SettingError, match="unknown format 'gif': choose one of text, json"):
        write_hue_report({"a": THREE}, tmp_path / "report.png", format="gif")
    with pytest.raises(SettingError, match="needs a histogram"):
        write_hue_report({}, tmp_path / "report.txt")
    with pytest.raises(OutputError, match="there is no directory"):
        write_hue_report({"a": THREE}, tmp_path / "nowhere" / "report.txt")
    (tmp_path / "report.txt").write_text("old")
    with pytest.raises(OutputError, match="no-clobber"):
        write_hue_report({"a": THREE}, tmp_path / "report.txt", clobber=False)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("report.txt", "old")]


def test_format_of_an_output():
    assert report_format("-").name == "text"
    assert report_format("-", "png").name == "png"
    assert report_format("a.PDF").name == "pdf"
    assert report_format("a.pdf", "svg").name == "svg"
    assert {report_format(f"x{row.ending}").name for row in REPORT_FORMATS.values()} == set(REPORT_FORMATS)


@pytest.mark.parametrize(
    ("choice", "valid"), [("weight", WEIGHTS), ("scale", SCALES), ("axes", AXES)]
)
def test_unknown_look(choice, valid):
    with pytest.raises(SettingError, match=f"unknown {choice} 'odd': choose one of {', '.join(valid)}"):
        Look(**{choice: "odd"})


# ---- colours, shares, scales -----------------------------------------------------------------


@given(st.tuples(*[st.integers(0, 255)] * 3))
def test_a_colour_of_8_bits_is_itself(codes):
    text = "#{:02x}{:02x}{:02x}".format(*codes)
    assert srgb_hex(hpcomp.color.css.css_color(text, "label")) == text


@pytest.mark.parametrize(
    ("rgb", "text"),
    [((4, 0, 0), "#ff0000"), ((0, 0, 0), "#000000"), ((8, 8, 8), "#ffffff"), ((4, 2, 0), "#ffbc00")],
)
def test_a_bright_colour_keeps_its_hue(rgb, text):
    assert srgb_hex(rgb) == text


def test_a_colour_out_of_gamut_keeps_its_hue():
    rgb = np.array((0.5, -0.1, 0.2))
    codes = np.array(hpcomp.color.css.css_color(srgb_hex(rgb), "label"))
    assert codes.min() == 0
    assert float(HEXAGON.degrees(codes)) == pytest.approx(float(HEXAGON.degrees(rgb)), abs=1)


def test_colours_of_hues():
    assert hue_colors(HEXAGON, np.array([0.0, 60, 120, 180, 240, 300])) == [
        "#ff0000", "#ffff00", "#00ff00", "#00ffff", "#0000ff", "#ff00ff",
    ]  # fmt: skip


def test_axis_begins_far_from_the_named_colours():
    assert axis_start(HEXAGON) == -30


@pytest.mark.parametrize(
    ("share", "text"),
    [(0, "0%"), (1, "100%"), (0.5, "50.0%"), (1e-9, "<0.1%"), (0.0006, "0.1%"), (0.99999, ">99.9%"), (0.999, "99.9%")],
)
def test_shares_for_people(share, text):
    assert percent(share) == text


@pytest.mark.parametrize("name", SCALES)
@given(top=st.floats(1e-6, 1), share=st.floats(0, 1))
def test_scales_grow_from_0_to_1(name, top, share):
    scale = SCALES[name]
    assert (scale.heights(0, top), scale.heights(top, top)) == (0, 1)
    assert 0 <= scale.heights(share * top, top) <= 1
    assert scale.heights(share * top, top) >= share - 1e-9  # nothing looks smaller than it is


@pytest.mark.parametrize("name", SCALES)
@given(top=st.floats(1e-6, 1))
def test_ticks_are_round_and_apart(name, top):
    shares = ticks(top, SCALES[name], apart=0.2)
    assert shares[0] == 0
    assert all(f"{share:e}"[:9] in ("1.000000e", "2.000000e", "5.000000e") for share in shares[1:])
    heights = [float(SCALES[name].heights(share, top)) for share in shares]
    assert all(b - a >= 0.2 - 1e-9 for a, b in itertools.pairwise(heights))
    assert heights[-1] <= 1


def test_every_weight_has_words():
    assert set(WEIGHT_TITLES) == set(WEIGHTS)


# ---- JSON and CSV ----------------------------------------------------------------------------


def test_json_document():
    document = json.loads(render("json"))
    assert (document["schema"], document["version"]) == ("hpcomp.hues", 1)
    assert (document["space"], document["bins"]) == ("linear-rgb", 360)
    assert (document["achromatic"], document["peak_radius"]) == (0.02, 2)
    three, smear = document["images"]
    assert (three["name"], smear["name"]) == ("three", "smear")
    assert three["pixels"] == {
        "all": 200, "chromatic": 100, "grey": 60, "transparent": 40, "nonfinite": 0,
    }  # fmt: skip
    assert [(p["hue"], p["count"], p["share"]) for p in three["peaks"]] == [
        (0, 50, 0.5), (60, 30, 0.3), (240, 20, 0.2),
    ]  # fmt: skip
    assert three["peaks"][0]["rgb"] == pytest.approx([0.6, 0.1, 0.1])
    assert three["peaks"][0]["srgb"] == srgb_hex((0.6, 0.1, 0.1))
    assert three["concentration"]["share"] == 1
    assert three["concentration"]["occupied"] == 3
    assert three["concentration"]["entropy"] == pytest.approx(1.4854752972273344)
    assert (smear["peaks"], smear["concentration"]["relative_entropy"]) == ([], 1)
    assert three["histogram"]["hue"] == list(range(360))
    assert three["histogram"]["count"] == THREE.count.tolist()
    assert three["histogram"]["chroma"] == THREE.chroma_sums.tolist()
    assert three["histogram"]["alpha"] == THREE.alpha_sums.tolist()
    colors = [three["histogram"][name] for name in ("red", "green", "blue")]
    assert np.array_equal(np.transpose(colors), THREE.rgb_sums)


def test_sums_of_json_merge_exactly():
    parts = [labels({10: 7, 200: 3}), labels({10: 1, 201: 9})]
    a, b, whole = (
        json.loads(render("json", [("x", found)]))["images"][0]["histogram"]
        for found in (*parts, sum(parts))
    )
    for key in ("count", "chroma", "alpha", "red", "green", "blue"):
        assert np.array_equal(np.add(a[key], b[key]), whole[key])


def test_every_key_of_json_is_documented_and_no_other():
    document = huedata.as_data(ENTRIES)
    assert [*document, *document["images"][0]] == list(huedata.JSON_KEYS)
    for key, value in document["images"][0].items():
        first = value[0] if isinstance(value, list) else value
        if isinstance(first, dict):
            for inner in first:
                assert f"`{inner}`" in huedata.JSON_KEYS[key], (key, inner)


def test_json_is_ascii_and_its_numbers_stand_on_one_line():
    text = render("json", [("日本 [\n 1,\n 2 ]", THREE)]).decode("ascii")
    assert json.loads(text)["images"][0]["name"] == "日本 [\n 1,\n 2 ]"
    (counts,) = [line for line in text.splitlines() if '"count": [' in line]
    assert ast.literal_eval(counts.partition(": ")[2].rstrip(",")) == THREE.count.tolist()


def test_csv_has_a_row_for_each_bin_and_for_what_is_in_none():
    rows = list(csv.DictReader(io.StringIO(render("csv").decode(), newline="")))
    assert len(rows) == 2 * (360 + 3)
    assert list(rows[0]) == list(huedata.CSV_COLUMNS)
    three = [row for row in rows if row["image"] == "three"]
    assert [int(row["count"]) for row in three] == [*THREE.count.tolist(), 60, 40, 0]
    assert [row["kind"] for row in three[360:]] == ["grey", "transparent", "nonfinite"]
    assert {row["kind"] for row in three[:360]} == {"hue"}
    assert [float(row["hue"]) for row in three[:360]] == THREE.hues.tolist()
    for key, sums in (("chroma", THREE.chroma_sums), ("alpha", THREE.alpha_sums), ("green", THREE.rgb_sums[:, 1])):
        assert [float(row[key]) for row in three[:360]] == sums.tolist()
    assert {row["chroma"] for row in three[360:]} == {""}


# ---- text ------------------------------------------------------------------------------------

ESCAPES = re.compile(r"\x1b\[[0-9;]*m")


def bars(text):
    """The height in eighths of each column of the first chart of a text, plain."""
    rows = []
    for line in text.splitlines():
        found = re.match(r"[ \d.%]{6}[│┤](.*)$", line)
        if found:
            rows.append(found[1])
        elif rows:
            break
    width = max(map(len, rows))
    return [sum(" ▁▂▃▄▅▆▇█".index(c) for c in column) for column in zip(*(r.ljust(width) for r in rows), strict=True)]


def test_text_says_what_there_is():
    text = render("text").decode()
    three = text.partition("\n\n")[0]
    assert three.startswith("three\n  200 pixels: 50.0% with a hue, 30.0% grey, 20.0% transparent\n")
    assert "  ■   0.0°   50.0% of pixels," in three
    assert "100% of pixels within 2° of the peaks; 3 of 360 bins; entropy 1.49 of 8.49 bits" in three
    assert "no hue stands out; 360 of 360 bins" in text
    assert text.endswith("Bars: share of the pixels with a hue, 5° to a bar, on a square-root scale.\n")
    assert "\x1b" not in text


def test_bars_stand_at_their_hues_with_their_heights():
    heights = bars(render("text", [("three", THREE)]).decode())
    # 5° to a column, from -30°: sqrt(0.3/0.5) and sqrt(0.2/0.5) of 64 eighths.
    assert {k: h for k, h in enumerate(heights) if h} == {6: 64, 18: 50, 54: 40}
    linear = bars(render("text", [("three", THREE)], scale="linear").decode())
    assert {k: h for k, h in enumerate(linear) if h} == {6: 64, 18: 38, 54: 26}


def test_charts_share_one_scale():
    one, other = labels({0: 10}), labels({120: 5, 240: 5})
    text = render("text", [("one", one), ("other", other)], scale="linear").decode()
    assert max(bars(text)) == 64
    assert max(bars(text.partition("\n\n")[2])) == 32


def test_the_least_share_is_seen():
    found = labels({0: 5000, 120: 1})
    heights = bars(render("text", [("x", found)], scale="linear").decode())
    assert sum(h > 0 for h in heights) == 2
    assert min(h for h in heights if h) == 1


@pytest.mark.pairwise
@pytest.mark.parametrize("columns", [1, 30, 60, 80, 120, 500])
@pytest.mark.parametrize("bins", [6, 36, 100, 360, 3600])
@pytest.mark.parametrize("color", [False, True])
def test_charts_fit_the_terminal(columns, bins, color):
    found = labels({0: 50, 120: 30, 300: 20}, bins=bins)
    text = ESCAPES.sub("", render("text", [("x", found)], columns=columns, color=color).decode())
    chart = [line for line in text.splitlines() if re.match(r"[ \d.%]{6}[│┤└]", line)]
    assert len(chart) == 9
    assert max(map(len, chart)) <= max(columns, 32)
    heights = bars(text)
    # Wide bins are as wide as their hues, so that a bar is of one bin at least.
    assert sum(h > 0 for h in heights) == 3 * max(1, len(chart[-1][7:]) // bins)
    places = chart[-1] if not color else None
    assert places is None or places.count("┴") == 6


def test_colours_are_those_of_the_hues():
    text = render("text", [("three", THREE)], color=True).decode()
    plain = render("text", [("three", THREE)]).decode()
    assert ESCAPES.sub("", text).replace("▀", "─") == plain.replace("┴", "─")
    assert "\x1b[38;2;255;0;0m█\x1b[0m" in text.splitlines()[2]
    assert f"\x1b[38;2;{';'.join(str(v) for v in bytes.fromhex(srgb_hex((0.6, 0.1, 0.1))[1:]))}m■" in text
    for line in text.splitlines():
        assert "\x1b" not in line or line.endswith("\x1b[0m") or "■\x1b[0m" in line


def test_text_in_an_encoding_without_blocks():
    text = render("text", encoding="ascii").decode("ascii")
    assert "#" in text
    assert "\\u" not in text
    assert "deg" in text
    assert render("text", encoding="latin-1").decode("latin-1")


def test_text_of_what_has_no_hue():
    assert render("text", [("grey", NOTHING)]).decode() == (
        "grey\n  5 pixels: 0% with a hue, 100% grey, 0% transparent\n"
    )
    one = hue_histogram([(np.nan, 0, 0, 0)])
    assert "1 pixel: 0% with a hue, 0% grey, 0% transparent, 100% NaN or infinite" in render(
        "text", [("nan", one)]
    ).decode()
    assert b"0 pixels" in render("text", [("none", HueHistogram.empty())])


@pytest.mark.parametrize("weight", WEIGHTS)
@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_glow_too_dark_to_sum(name, weight):
    """No alpha and no chroma that the sums can tell: every share of theirs is 0."""
    glow = hue_histogram([(1e-20, 0, 0, 0)])
    assert render(name, [("glow", glow)], weight=weight)


# ---- figures ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("count", [1, 2, 5, 12])
def test_figure_grows_with_its_images(axes, count):
    width, height = pngfile.size_of(render("png", SEVERAL[:count], axes=axes))
    assert 300 < height < 700 * count
    assert 400 < width < 3700


@pytest.mark.slow
def test_figures_carry_no_time_and_no_version():
    import matplotlib

    for name in FIGURES:
        content = usual(name)
        assert matplotlib.__version__.encode() not in content
        assert b"Date" not in content
    kinds = {kind for kind, _ in pngfile.split(usual("png"))}
    assert kinds <= {b"IHDR", b"pHYs", b"IDAT", b"IEND"}


def test_svg_stands_alone():
    text = usual("svg").decode()
    ElementTree.fromstring(text)
    assert "<text" not in text  # letters are outlines
    assert "<image" not in text
    assert not re.findall(r'href="(?!#)', text)


def test_pdf_embeds_its_font():
    content = usual("pdf")
    assert content.startswith(b"%PDF")
    assert b"/FontFile2" in content
    assert b"/Type3" not in content


def marked_columns(png, color):
    """The columns of a PNG that have a pixel of that colour."""
    found = pngfile.decode(png)[..., :3]
    return np.flatnonzero((np.abs(found / 255 - np.array(color)) < 0.1).all(axis=2).any(axis=0))


def test_hue_colours_stand_under_their_axis():
    content = render("png", [("x", labels({120: 5}))], axes="linear")
    hues = {"red": (1, 0, 0), "green": (0, 1, 0), "blue": (0, 0, 1)}
    places = {name: marked_columns(content, rgb).mean() for name, rgb in hues.items()}
    assert places["red"] < places["green"] < places["blue"]
    assert places["blue"] - places["green"] == pytest.approx(places["green"] - places["red"], abs=4)


def test_weight_and_scale_change_what_is_drawn():
    found = labels({0: 50, 240: 10}) + hue_histogram([(0.01, 0.1, 0.01, 0.5)] * 20)
    seen = {render("svg", [("x", found)], weight=w, scale=s) for w in WEIGHTS for s in SCALES}
    assert len(seen) == len(WEIGHTS) * len(SCALES)


def test_a_figure_has_a_limit():
    with pytest.raises(SettingError, match="120 images at most, not 121"):
        render("png", [("x", THREE)] * 121)


def test_figures_leave_matplotlib_as_it_was():
    import matplotlib

    before = dict(matplotlib.rcParams)
    matplotlib.rcParams["axes.facecolor"] = "pink"
    try:
        changed = render("svg")
        assert matplotlib.rcParams["axes.facecolor"] == "pink"
    finally:
        matplotlib.rcParams["axes.facecolor"] = before["axes.facecolor"]
    assert changed == usual("svg")


def test_matplotlib_has_one_door():
    package = Path(hpcomp.__file__).parent
    importers = {
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        if re.search(r"^\s*(?:import|from) matplotlib", path.read_text(), re.MULTILINE)
    }
    assert importers == {"report/drawing.py"}


def test_pixels_of_png_decode():
    data = b"".join(body for kind, body in pngfile.split(usual("png")) if kind == b"IDAT")
    assert zlib.decompress(data)
