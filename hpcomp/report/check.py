"""How a check ended, as text for people, data for JSON, a line a failed rule. Measures nothing."""

from __future__ import annotations

from typing import Any

from ..analysis.check import CheckResult, Verdict
from ..errors import printable

#: Version of the data that `as_data` gives; it grows when a key changes its meaning or goes.
SCHEMA_VERSION = 1

#: What each rule measures, as part of a sentence, against layers and against hues.
_MEASURED = {
    "max-foreign": ("of the chromatic pixels have a hue that no layer gave them",
                    "of the chromatic pixels have none of the hues"),
    "max-gray": ("of the layers' chroma is lost to grey",
                 "of the visible pixels are grey"),
}  # fmt: skip

#: The same of a rule for one label.
_OF_LABEL = {
    "require-hue": "seen in {} of where it could be",
    "min-visible": "visible in {} of its pixels",
}


def as_data(result: CheckResult) -> dict[str, Any]:
    """A check as dictionaries, lists, strings and numbers; shares are from 0 to 1."""
    sums = result.sums
    of_layers = result.against == "layers"
    grey = "lost_to_grey" if of_layers else "grey_share"
    return {
        "schema": "hpcomp.check",
        "version": SCHEMA_VERSION,
        "image": result.image,
        "against": result.against,
        "passed": result.passed,
        "foreign_tolerance": result.settings.foreign_tolerance,
        "achromatic": result.settings.achromatic,
        "pixels": sums.pixels,
        "unmeasured_pixels": sums.unmeasured,
        "visible_pixels": sums.visible,
        "chromatic_pixels": sums.chromatic,
        "foreign_pixels": sums.foreign,
        "foreign_share": result.foreign_share,
        "foreign_chroma_share": result.foreign_chroma_share,
        grey: result.grey_share,
        **({"layers_visible_share": result.visible_share} if of_layers else {}),
        "ramps": [
            {
                "lower": ramp.lower,
                "upper": ramp.upper,
                "pixels": ramp.pixels,
                "vivid_share": ramp.vivid_share,
            }
            for ramp in result.ramps
        ],
        "labels": [
            {
                "label": label.text,
                "layer": label.number,
                "hue": label.hue,
                "pixels": seen.pixels,
                "shown": seen.shown,
                "share": seen.share,
                "visible": None if label.number is None else seen.visible,
                "visible_share": None if label.number is None else seen.visible_share,
            }
            for label, seen in zip(result.labels, sums.labels, strict=True)
        ],
        "rules": [
            {
                "rule": verdict.rule,
                "label": verdict.label,
                "measured": verdict.measured,
                "limit": verdict.limit,
                "passed": verdict.passed,
            }
            for verdict in result.verdicts
        ],
    }


def as_text(result: CheckResult) -> str:
    """A check in a few aligned lines."""
    sums = result.sums
    of_layers = result.against == "layers"
    rows = [
        ("pixels", f"{sums.pixels}, {sums.visible} visible, {sums.chromatic} chromatic"
                   + (f", {sums.unmeasured} not finite" if sums.unmeasured else "")),
        ("foreign hue", f"{result.foreign_share:.3%} of the chromatic pixels, "
                        f"{result.foreign_chroma_share:.3%} of their chroma"),
        ("lost to grey" if of_layers else "grey",
         f"{result.grey_share:.3%} {'of the chroma' if of_layers else 'of the visible pixels'}"),
    ]  # fmt: skip
    if of_layers:
        anything = any(seen.pixels for seen in sums.labels)
        together = f"in {result.visible_share:.3%} of their pixels"
        rows.append(("layers visible", together if anything else "none contributes a hue"))
    for label, seen in zip(result.labels, sums.labels, strict=True):
        found = f"seen in {seen.share:.3%} of {seen.pixels} pixels"
        if label.number is not None:
            found += f", visible in {seen.visible_share:.3%} of them"
        nothing = label.number is not None and not seen.pixels
        rows.append((label.text, "contributes no hue" if nothing else found))
    rows += [
        ("passed" if verdict.passed else "FAILED", _sentence(result, verdict))
        for verdict in result.verdicts
    ]
    width = max(len(name) for name, _ in rows)
    lines = [f"{result.image} against its {result.against}:" if of_layers
             else f"{result.image} against {result.against}:"]  # fmt: skip
    lines += [f"  {name:<{width}}  {value}" for name, value in rows]
    return "\n".join(map(printable, lines))


def failures(result: CheckResult) -> list[str]:
    """One line for each rule that does not hold."""
    return [
        f"check failed: {result.image}: {_sentence(result, verdict)}"
        for verdict in result.verdicts
        if not verdict.passed
    ]


def _sentence(result: CheckResult, verdict: Verdict) -> str:
    if verdict.label is not None:
        how_much = _OF_LABEL[verdict.rule].format(f"{verdict.measured:.3%}")
        return (
            f"--{verdict.rule}: {verdict.label} is {how_much}, at least {_limit(verdict)} must be"
        )
    measured = _MEASURED[verdict.rule][result.against == "hues"]
    return f"--{verdict.rule}: {verdict.measured:.3%} {measured}, at most {_limit(verdict)} may"


def _limit(verdict: Verdict) -> str:
    return f"{100 * verdict.limit:g}%"
