"""The report of a stack as data, text and figures; its page is in `test_page`."""

import csv
import io
import json
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from pngfile import size_of
from stackreports import HOSTILE, LABELS, LAYERS, hostile_report, report_of, three_results

from hpcomp import MismatchError, SettingError
from hpcomp.report import huedata, measures, stackdata
from hpcomp.report.hueformats import REPORT_FORMATS
from hpcomp.report.look import percent
from hpcomp.report.stackreport import (
    PREVIEW_SIDE,
    needs_preview,
    preview_scale,
    render_stack_report,
)

REPORT = report_of()
NAMES = [*LABELS, "result", "traditional"]


@cache
def usual(name):
    """The report in that format, rendered once: a figure takes seconds."""
    return render_stack_report(REPORT, name)


def test_every_format_of_reports_renders_a_stack():
    for name in REPORT_FORMATS:
        content = render_stack_report(replace(REPORT, preview=None), name)
        assert len(content) > 1000
        assert (content == usual(name)) == (not needs_preview(name))


def test_a_page_alone_shows_pictures():
    assert [name for name in REPORT_FORMATS if needs_preview(name)] == ["html"]
    for ask in (needs_preview, lambda name: render_stack_report(REPORT, name)):
        with pytest.raises(SettingError, match="unknown format 'gif': choose one of text, json"):
            ask("gif")


def test_labels_are_of_the_layers():
    with pytest.raises(MismatchError, match="3 labels for the findings of 4 layers"):
        replace(REPORT, labels=LABELS[:3])


@pytest.mark.parametrize("size", [(1, 1), (PREVIEW_SIDE, 1), (PREVIEW_SIDE + 1, 7), (100, 100_000)])
def test_scale_of_a_preview_is_the_smallest_that_fits(size):
    scale = preview_scale(*size)
    assert -(-max(size) // scale) <= PREVIEW_SIDE
    assert scale == 1 or -(-max(size) // (scale - 1)) > PREVIEW_SIDE


@pytest.mark.slow
@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_same_bytes_in_another_process(name):
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parents[1] / 'support')!r}); "
        "from stackreports import report_of; "
        "from hpcomp.report.stackreport import render_stack_report; "
        "sys.stdout.buffer.write(render_stack_report(report_of(), sys.argv[1]))"
    )
    env = {"PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo", "LC_ALL": "C"}
    done = subprocess.run([sys.executable, "-P", "-c", code, name], capture_output=True, env=env, check=True)
    assert done.stderr == b""
    assert done.stdout == usual(name)


@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_hostile_names_are_shown_harmlessly(name):
    content = render_stack_report(hostile_report(), name)
    if name not in ("png", "pdf"):
        assert b"\x1b" not in content
        assert "\u202e".encode() not in content
    if name == "svg":
        ElementTree.fromstring(content)
    if name == "json":
        assert [layer["label"] for layer in json.loads(content)["layers"]] == list(HOSTILE)


# ---- JSON and CSV ----------------------------------------------------------------------------


def test_json_document():
    document = json.loads(render_stack_report(REPORT, "json"))
    assert (document["schema"], document["version"]) == ("hpcomp.stack-report", 1)
    assert (document["output"], document["command"]) == (REPORT.output, REPORT.command)
    assert (document["hpcomp"], document["engine"]) == ("1.2.3", "kernel")
    assert document["settings"] == {"blending": "hue-preserving", "order": "bottom-up"}
    found = REPORT.summary
    assert document["measures"] == measures.as_data(found.measures, LABELS)
    assert document["measures"]["result"]["foreign_share"] == 0
    assert document["measures"]["traditional"]["foreign_share"] > 0.1
    assert (document["space"], document["bins"], document["achromatic"]) == ("linear-rgb", 360, 0.02)
    assert [(layer.pop("number"), layer.pop("label")) for layer in document["layers"]] == list(
        enumerate(LABELS)
    )
    for data, histogram in zip(
        [*document["layers"], document["result"], document["traditional"]],
        [*found.layers, found.result, found.traditional],
        strict=True,
    ):
        assert data == json.loads(json.dumps(huedata.histogram_data(histogram)))
    assert [round(peak["hue"]) for peak in document["layers"][1]["peaks"]] == [0]


def test_every_key_of_json_is_documented_and_no_other():
    assert list(stackdata.as_data(REPORT)) == [k for k in stackdata.JSON_KEYS if k != "hue_preserving"]
    document = stackdata.as_data(three_results())
    assert list(document) == list(stackdata.JSON_KEYS)
    words = stackdata.JSON_KEYS["measures"]

    def keys(data):
        for key, value in data.items():
            yield key
            for inner in value if isinstance(value, list) else [value]:
                if isinstance(inner, dict):
                    yield from keys(inner)

    for key in keys(document["measures"]):
        assert f"`{key}`" in words, key
    of_layer = stackdata.JSON_KEYS["layers"]
    assert all(f"`{key}`" in of_layer for key in document["layers"][0])
    assert set(document["result"]) == set(document["layers"][0]) - {"number", "label"}


def test_energy_weights_are_those_of_the_report():
    chosen = replace(REPORT, energy_weights=(1.0, 0.0, 0.0))
    found = stackdata.as_data(chosen)["measures"]
    assert found["energy_weights"] == [1, 0, 0]
    assert found["result"]["energy"] == REPORT.summary.measures.result.energy((1, 0, 0))


def test_csv_has_the_rows_of_all_histograms():
    rows = list(csv.DictReader(io.StringIO(render_stack_report(REPORT, "csv").decode(), newline="")))
    assert list(dict.fromkeys(row["image"] for row in rows)) == NAMES
    assert len(rows) == len(NAMES) * (360 + 3)
    result = [int(row["count"]) for row in rows if row["image"] == "result" and row["kind"] == "hue"]
    assert result == REPORT.summary.result.count.tolist()
    found = REPORT.summary.measures
    for row in rows:
        assert list(row)[-2:] == ["visible_share", "traditional_visible_share"]
        number = NAMES.index(row["image"])
        for column, of in zip(list(row)[-2:], (found.result, found.traditional), strict=True):
            visible = of.layers[number] if number < len(LABELS) else of
            assert float(row[column]) == visible.visible_share


def test_a_third_result_is_beside_the_others():
    report = three_results()
    found = report.summary.measures
    assert list(found.results) == list(report.summary.results) == ["result", "traditional", "hue_preserving"]
    data = json.loads(render_stack_report(report, "json"))
    assert data["measures"]["hue_preserving"]["visible_share"] == found.hue_preserving.visible_share
    assert data["hue_preserving"] == json.loads(
        json.dumps(huedata.histogram_data(report.summary.hue_preserving))
    )
    text = render_stack_report(report, "text").decode().splitlines()
    assert text[2].split() == ["result", "traditional", "hue-preserving"]
    shares = [f"{of.visible_share:.3%}" for of in found.results.values()]
    assert ["visible", *shares] in [line.split() for line in text]
    of_layer = [f"{of.layers[1].visible_share:.3%}" for of in found.results.values()]
    assert [*LABELS[1].split(), "visible", *of_layer] in [line.replace(": ", " ").split() for line in text]
    assert sum(line.startswith("background: ") for line in text) == 3
    rows = list(csv.DictReader(io.StringIO(render_stack_report(report, "csv").decode(), newline="")))
    assert [row["image"] for row in rows if row["kind"] == "grey"] == [*NAMES, "hue-preserving"]
    assert float(rows[-1]["hue_preserving_visible_share"]) == found.hue_preserving.visible_share
    assert found + found == replace(
        found, **{name: getattr(found, name) + getattr(found, name)
                  for name in ("result", "traditional", "hue_preserving", "pixels", "unmeasured", "order_sensitive")}
    )  # fmt: skip
    with pytest.raises(SettingError, match="woven stack and of another do not add up"):
        found + replace(found, hue_preserving=None)
    assert found.results["hue_preserving"] == REPORT.summary.measures.result


def test_figure_of_three_results():
    svg = render_stack_report(three_results(), "svg").decode()
    assert "hue-preserving" in svg


# ---- text and figures ------------------------------------------------------------------------


def test_text_is_the_measures_and_a_chart_of_each():
    text = render_stack_report(REPORT, "text").decode()
    assert text.startswith("map.png\n\n")
    assert measures.as_text(REPORT.summary.measures, LABELS) in text
    for name in NAMES:
        assert f"\n{name}\n  1,536 pixels: " in text


def test_figure_says_what_became_of_hues(monkeypatch):
    from hpcomp.report import huefigure as figure

    said = []
    original = figure._Sheet._text

    def spy(self, x, y, text, **how):
        said.append(text)
        return original(self, x, y, text, **how)

    monkeypatch.setattr(figure._Sheet, "_text", spy)
    render_stack_report(REPORT, "svg")
    found = REPORT.summary.measures
    for result in (found.result, found.traditional):
        (line,) = [text for text in said if text.startswith(f"foreign hue: {percent(result.foreign_share)} of pixels")]
        assert line.endswith(f"lost to grey: {percent(result.lost)} of chroma; visible: {percent(result.visible_share)}")
    assert "contributes no hue" in said
    layer = found.result.layers[1]
    assert (
        f"visible in {percent(layer.visible_share)} of {layer.pixels} px, hue survived in "
        f"{percent(layer.survived_share)}, lost to grey: {percent(layer.lost)} of chroma"
    ) in said
    assert [text for text in said if text in NAMES] == NAMES


@pytest.mark.slow
def test_figure_of_more_layers_than_it_has_room_for(monkeypatch):
    from hpcomp.report import huefigure as figure

    whole = usual("png")
    monkeypatch.setattr(figure, "MOST_IMAGES", 4)
    captions = []
    original = figure._Sheet._caption
    monkeypatch.setattr(
        figure._Sheet, "_caption", lambda self: captions.append(original(self)) or captions[-1]
    )
    fewer = render_stack_report(REPORT, "png")
    assert captions[0].endswith("; 2 upper layers are left out")
    assert size_of(fewer)[1] < size_of(whole)[1]


def test_layers_of_nothing():
    empty = [np.zeros_like(LAYERS[0])] * 2
    report = report_of(empty, ["a", "b"])
    for name in REPORT_FORMATS:
        assert render_stack_report(report, name)
