"""The measures of a stack, as text for people and as plain data for JSON. Measures nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
        **{
            name: _result_data(result, labels, energy_weights)
            for name, result in measures.results.items()
        },
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
        "visible_share": result.visible_share,
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
        "visible_pixels": contributor.visible,
        "visible_share": contributor.visible_share,
        "lost_to_grey": contributor.lost,
    }


def as_text(
    measures: StackMeasures,
    labels: Sequence[str],
    energy_weights: Sequence[float] = ENERGY_WEIGHTS,
) -> str:
    """The measures in aligned lines, a column for each result, the stack's own first."""
    results = list(measures.results.values())

    def of_all(measure: Callable[[ResultMeasures], float]) -> list[str]:
        return [f"{measure(result):.3%}" for result in results]

    rows = [
        ["", *(title(name) for name in measures.results)],
        ["foreign hue, of pixels", *of_all(lambda result: result.foreign_share)],
        ["foreign hue, of chroma", *of_all(lambda result: result.foreign_chroma_share)],
        ["lost to grey", *of_all(lambda result: result.lost)],
        ["visible", *of_all(lambda result: result.visible_share)],
        [
            "energy, in white pixels",
            *(f"{result.energy(energy_weights):.1f}" for result in results),
        ],
        ["order sensitivity", f"{measures.order_sensitivity:.3%}", *[""] * (len(results) - 1)],
    ]
    contributors = [
        (label, [result.layers[number] for result in results])
        for number, label in enumerate(labels)
    ]
    if measures.result.background.chroma:
        contributors.append(("background", [result.background for result in results]))
    for label, of_results in contributors:
        if not of_results[0].pixels:
            rows.append([f"{label}: contributes no hue", *[""] * len(results)])
            continue
        rows += [
            [f"{label}: visible", *(f"{of.visible_share:.3%}" for of in of_results)],
            [f"{label}: hue survived", *(f"{of.survived_share:.3%}" for of in of_results)],
            [f"{label}: lost to grey", *(f"{of.lost:.3%}" for of in of_results)],
        ]
    first, *widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    lines = [
        [
            f"{name:<{first}}",
            *(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True)),
        ]
        for name, *cells in rows
    ]
    return "\n".join(printable("  ".join(line).rstrip()) for line in lines)


def title(name: str) -> str:
    """What a result, one of `labels.RESULTS`, is called in a text."""
    return name.replace("_", "-")
