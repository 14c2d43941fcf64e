"""Reports of small stacks for tests: three labels over grey, and names that mean harm."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import hpcomp
from hpcomp.color.quantization import Losses, to_straight_srgb
from hpcomp.measures.labels import ENERGY_WEIGHTS, measure_settings
from hpcomp.measures.summary import summary_of
from hpcomp.options import stack_rules
from hpcomp.report.stackreport import TRADITIONAL, Preview, StackReport, result_name

SIZE = 48, 32

#: Names that a page must show and not obey.
HOSTILE = (
    "<img src=x onerror=window.harmed=1>.png",
    "\"'><script>window.harmed=1</script>",
    "a\nb\x1b[31m\x00.png",
    "\u202egnp.exe",
    "\udcff\udc80.png",
    "שלום & <b>.png",
    "x" * 300,
    "javascript:window.harmed=1",
)


def disc(x: float, y: float, radius: float, rgb: Sequence[float], alpha: float) -> np.ndarray:
    """(h, w, 4) float32: a disc of one straight colour at that alpha, premultiplied."""
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]]
    pixels = np.zeros((SIZE[1], SIZE[0], 4), np.float32)
    pixels[(columns - x) ** 2 + (rows - y) ** 2 < radius**2] = (*(alpha * np.array(rgb)), alpha)
    return pixels


#: Grey below, three labels that overlap above, and transparent corners.
LAYERS = (
    disc(24, 16, 23, (0.4, 0.4, 0.4), 1.0),
    disc(16, 12, 11, (0.9, 0.1, 0.1), 0.8),
    disc(30, 12, 11, (0.8, 0.7, 0.0), 0.7),
    disc(23, 21, 10, (0.1, 0.2, 0.9), 0.6),
)
LABELS = ("layer 0 (base.png)", "layer 1 (red.png)", "layer 2 (roads: yellow.png)", "layer 3 (blue.exr)")


def report_of(
    layers: Sequence[np.ndarray] = LAYERS,
    labels: Sequence[str] = LABELS,
    *,
    bins: int = 360,
    preview: bool = True,
    **rules: Any,
) -> StackReport:
    """The report of a stack of arrays, as the pipeline makes it of files."""
    checked = stack_rules(len(layers), **rules)
    summary, provenance = summary_of(checked, measure_settings(checked), layers, bins)

    def shown(blending: str) -> np.ndarray:
        composited = hpcomp.composite(layers, **{**rules, "blending": blending})
        return to_straight_srgb(composited, np.uint8, Losses())

    own = result_name(checked.blending.name)
    pictures = Preview(
        {TRADITIONAL: shown(TRADITIONAL), own: shown(checked.blending.name)}, own, provenance.layer, 4
    )
    return StackReport(
        output="map.png",
        command=shlex.join(["hpcomp", "stack", "base.png", "roads.png::opacity=0.6", "-o", "map.png"]),
        version="1.2.3",
        engine="kernel",
        settings={"blending": checked.blending.name, "order": checked.order.name},
        labels=tuple(labels),
        summary=summary,
        energy_weights=ENERGY_WEIGHTS,
        preview=pictures if preview else None,
    )


def three_results() -> StackReport:
    """A report with a third result beside its own and the traditional one, as woven stacks have."""
    report, other = report_of(background=(0.1, 0.3, 0.1), order="simultaneous"), report_of()
    assert report.preview is not None
    assert other.preview is not None
    summary = replace(
        report.summary,
        hue_preserving=other.summary.result,
        measures=replace(report.summary.measures, hue_preserving=other.summary.measures.result),
    )
    own = report.preview.pictures["hue-preserving"][:, ::-1]
    pictures = {**other.preview.pictures, "woven": own}
    return replace(
        report,
        settings={"blending": "woven"},
        summary=summary,
        preview=replace(report.preview, pictures=pictures, of_file="woven"),
    )


def hostile_report() -> StackReport:
    """Everything that a report is given as text is hostile."""
    layers = [LAYERS[k % len(LAYERS)] for k in range(len(HOSTILE))]
    report = report_of(layers, HOSTILE)
    assert report.preview is not None
    pictures = dict(zip(HOSTILE, report.preview.pictures.values(), strict=False))
    return replace(
        report,
        preview=replace(report.preview, pictures=pictures, of_file=HOSTILE[1]),
        output=HOSTILE[0],
        command=shlex.join(["hpcomp", "stack", *HOSTILE, "-o", HOSTILE[1]]),
        settings={HOSTILE[0]: HOSTILE[1], "blending": HOSTILE[1]},
        version=HOSTILE[0],
        engine=HOSTILE[1],
    )
