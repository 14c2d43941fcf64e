"""The report of a stack as data for scripts, JSON and CSV, and as text. Measures nothing."""

from __future__ import annotations

import json
from typing import Any

from ..errors import printable
from ..measures.histogram import PEAK_RADIUS_DEG
from . import huedata, measures
from . import huetext as text
from .look import Look, common_axis
from .stackreport import StackReport

SCHEMA = "hpcomp.stack-report"
#: Version of the data; it grows when a key changes its meaning or goes.
SCHEMA_VERSION = 1

#: The keys of the JSON document. The man page prints this.
JSON_KEYS: dict[str, str] = {
    "schema": '"hpcomp.stack-report".',
    "version": "Of the schema, 1: it grows when a key changes its meaning or goes.",
    "output": "The path or name of the picture.",
    "command": "The command that made it; empty where it was made from Python.",
    "hpcomp": "The version of hpcomp.",
    "engine": "The engine that composited, `kernel` or `reference`.",
    "settings": "The options of the stack, each as a text.",
    "measures": "Shares are from 0 to 1. Of all pixels: `pixels`; `unmeasured_pixels`, with NaN or "
    "Inf; `order_sensitive_pixels` and `order_sensitivity`, the share of the chromatic ones in "
    "which another layer's hue survives top-down than bottom-up. What counts: `half_step`, the |p| "
    "above which there is a hue; `achromatic`; `foreign_tolerance` in degrees; `energy_weights` of "
    "red, green and blue. Then for `result`, `traditional` and, if the stack is woven, "
    "`hue_preserving`: `chromatic_pixels`; "
    "`foreign_pixels`, whose hue no layer gave them, `foreign_share` and `foreign_chroma_share`; "
    "`lost_to_grey`, of the chroma that went in; `visible_share`, of the pixels of all layers; "
    "`energy`; `layers` and `background`, each with the `pixels` to which it contributes, "
    "`survived_pixels` and `survived_share`, `visible_pixels`, which lie in squares of 16 by 16 "
    "pixels where its hue is seen, `visible_share`, and `lost_to_grey`; layers have a `number` and "
    "a `label`, and `background` is null where it has no hue.",
    "space": "The blending space whose hue and chroma were measured.",
    "bins": "How many bins each histogram has.",
    "achromatic": "The saturation below which pixels were grey.",
    "peak_radius": "2, the degrees around a peak that belong to it.",
    "layers": "A list, bottom first: `number`, `label`, and the keys `pixels`, `peaks`, "
    "`concentration` and `histogram` as in a document of hpcomp hues.",
    "result": "The same keys for the result, before its exposure and before it is rounded.",
    "traditional": "The same keys for the result of ordinary addition.",
    "hue_preserving": "The same keys for the result of ⊕; only if the stack is woven.",
}


def as_data(report: StackReport) -> dict[str, Any]:
    """The report as dictionaries, lists, strings and numbers."""
    common_axis(report.entries)
    summary = report.summary
    return {
        "schema": SCHEMA,
        "version": SCHEMA_VERSION,
        "output": report.output,
        "command": report.command,
        "hpcomp": report.version,
        "engine": report.engine,
        "settings": dict(report.settings),
        "measures": measures.as_data(summary.measures, report.labels, report.energy_weights),
        "space": summary.result.space,
        "bins": summary.result.bins,
        "achromatic": summary.result.achromatic,
        "peak_radius": PEAK_RADIUS_DEG,
        "layers": [
            {"number": number, "label": label, **huedata.histogram_data(histogram)}
            for number, (label, histogram) in enumerate(
                zip(report.labels, summary.layers, strict=True)
            )
        ],
        **{name: huedata.histogram_data(found) for name, found in summary.results.items()},
    }


def as_json(report: StackReport) -> bytes:
    """The JSON document, ASCII, a list of numbers on one line."""
    return huedata.one_line_lists(json.dumps(as_data(report), indent=2)).encode() + b"\n"


def as_csv(report: StackReport) -> bytes:
    """The rows of all histograms, as `hpcomp hues` writes them: layers, then each result.

    A column more for each result says in every row how visible its layer is there, as a share of
    its pixels: in the rows of results, all layers together.
    """
    visible = {}
    for name, result in report.summary.measures.results.items():
        shares = [layer.visible_share for layer in result.layers]
        together = [result.visible_share] * len(report.summary.results)
        visible[_visible_column(name)] = [*shares, *together]
    return huedata.as_csv(report.entries, Look(), visible)


def _visible_column(name: str) -> str:
    return "visible_share" if name == "result" else f"{name}_visible_share"


def as_text(report: StackReport) -> bytes:
    """The measures as a table, then a chart for each histogram on one scale; UTF-8."""
    table = measures.as_text(report.summary.measures, report.labels, report.energy_weights)
    charts = text.as_text(report.entries, Look())
    return f"{printable(report.output)}\n\n{table}\n\n".encode() + charts
