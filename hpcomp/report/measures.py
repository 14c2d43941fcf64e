"""The measures of a stack, as text for people and as plain data for JSON. Measures nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..errors import printable
from ..measures.labels import ENERGY_WEIGHTS, ContributorMeasures, ResultMeasures, StackMeasures

#: Version of the data that `as_data` gives; it grows when a key changes its meaning or goes.
SCHEMA_VERSION = 1


def as_data(
    measures: StackMeasures,
    labels: Sequence[str],
    energy_weights: Sequence[float] = ENERGY_WEIGHTS,
) -> dict[str, Any]:
    """The measures as dictionaries, lists, strings and numbers; shares are from 0 to 1.

    `labels`: what the layers are called, bottom first.
    """
    return {
        "pixels": measures.pixels,
        "unmeasured_pixels": measures.unmeasured,
        "half_step": measures.settings.half_step,
        "achromatic": measures.settings.achromatic,
        "foreign_tolerance": measures.settings.foreign_tolerance,
        "energy_weights": list(energy_weights),
        "order_sensitive_pixels": measures.order_sensitive,
        "order_sensitivity": measures.order_sensitivity,
        "result": _result_data(measures.result, labels, energy_weights),
        "traditional": _result_data(measures.traditional, labels, energy_weights),
    }


def _result_data(
    result: ResultMeasures, labels: Sequence[str], energy_weights: Sequence[float]
) -> dict[str, Any]:
    return {
        "chromatic_pixels": result.chromatic,
        "foreign_pixels": result.foreign,
        "foreign_share": result.foreign_share,
        "foreign_chroma_share": result.foreign_chroma_share,
        "lost_to_grey": result.lost,
        "energy": result.energy(energy_weights),
        "layers": [
            {"number": number, "label": label, **_contributor_data(layer)}
            for number, (label, layer) in enumerate(zip(labels, result.layers, strict=True))
        ],
        "background": _contributor_data(result.background) if result.background.chroma else None,
    }


def _contributor_data(contributor: ContributorMeasures) -> dict[str, Any]:
    return {
        "pixels": contributor.pixels,
        "survived_pixels": contributor.survived,
        "survived_share": contributor.survived_share,
        "lost_to_grey": contributor.lost,
    }


def as_text(
    measures: StackMeasures,
    labels: Sequence[str],
    energy_weights: Sequence[float] = ENERGY_WEIGHTS,
) -> str:
    """The measures in aligned lines: the result's beside those of traditional blending."""
    both = (measures.result, measures.traditional)
    rows = [
        ("", "result", "traditional"),
        ("foreign hue, of pixels", *(f"{r.foreign_share:.3%}" for r in both)),
        ("foreign hue, of chroma", *(f"{r.foreign_chroma_share:.3%}" for r in both)),
        ("lost to grey", *(f"{r.lost:.3%}" for r in both)),
        ("energy, in white pixels", *(f"{r.energy(energy_weights):.1f}" for r in both)),
        ("order sensitivity", f"{measures.order_sensitivity:.3%}", ""),
    ]
    contributors = [
        (label, measures.result.layers[number], measures.traditional.layers[number])
        for number, label in enumerate(labels)
    ]
    if measures.result.background.chroma:
        contributors.append(
            ("background", measures.result.background, measures.traditional.background)
        )
    for label, ours, plain in contributors:
        rows += [
            (f"{label}: hue survived", f"{ours.survived_share:.3%}", f"{plain.survived_share:.3%}"),
            (f"{label}: lost to grey", f"{ours.lost:.3%}", f"{plain.lost:.3%}"),
        ]
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return "\n".join(
        printable(f"{row[0]:<{widths[0]}}  {row[1]:>{widths[1]}}  {row[2]:>{widths[2]}}".rstrip())
        for row in rows
    )
