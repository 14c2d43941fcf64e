"""How one pixel of a stack comes about, as text for people and data for JSON. Blends nothing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from ..analysis.explain import Meeting, Outcome, PixelExplanation, Rivalry
from ..errors import printable

#: Version of the data that `as_data` gives; it grows when a key changes its meaning or goes.
SCHEMA_VERSION = 1


def as_data(pixel: PixelExplanation) -> dict[str, Any]:
    """One pixel as dictionaries, lists, strings and numbers; null for what is not finite.

    Colours are linear and premultiplied unless their key says otherwise; angles are in degrees.
    """
    rules = pixel.rules
    return {
        "schema": "hpcomp.explain",
        "version": SCHEMA_VERSION,
        "pixel": {"x": pixel.x, "y": pixel.y},
        "canvas": {
            "x": pixel.canvas.x,
            "y": pixel.canvas.y,
            "width": pixel.canvas.width,
            "height": pixel.canvas.height,
        },
        "blending": rules.blending.name,
        "order": rules.order.name,
        "space": rules.space.name,
        "primaries": rules.primaries.name,
        "hue_tolerance": rules.hue_tolerance,
        "gray_bias": rules.gray_bias,
        "foreign_tolerance": pixel.settings.foreign_tolerance,
        "exposure": rules.exposure,
        "layers": [
            {
                "number": layer.number,
                "label": layer.label,
                "stored": None if layer.stored is None else _numbers(layer.stored),
                "stored_type": layer.stored_type or None,
                "rgba": _numbers(layer.rgba),
                "opacity": layer.opacity,
                "operator": layer.operator,
                "weight": _number(layer.weight),
                "hue": layer.hue,
                "chroma": _number(layer.chroma),
                "weighted_chroma": _number(layer.weighted_chroma),
            }
            for layer in pixel.layers
        ],
        "background": pixel.background
        and {
            "rgb_straight": _numbers(pixel.background.rgb),
            "weight": _number(pixel.background.weight),
            "hue": pixel.background.hue,
            "chroma": _number(pixel.background.chroma),
            "weighted_chroma": _number(pixel.background.weighted_chroma),
        },
        "steps": [
            {
                "first": [_name(number) for number in step.first],
                "second": [_name(number) for number in step.second],
                "chroma_first": step.chroma_first,
                "chroma_second": step.chroma_second,
                "angle": step.angle,
                "equality": step.equality,
                "dominant": step.dominant and ("first", "second")[step.dominant - 1],
                "chroma": step.chroma,
                "hue": step.hue,
            }
            for step in pixel.meetings
        ],
        "rivalries": [
            {"layer": r.number, "share_left": r.share, "rival": r.rival, "angle": r.angle}
            for r in pixel.rivalries
        ],
        "result": _outcome_data(pixel.result),
        "traditional": _outcome_data(pixel.traditional),
        "meaning": meaning(pixel, pixel.result),
        "meaning_traditional": meaning(pixel, pixel.traditional),
    }


def _outcome_data(outcome: Outcome) -> dict[str, Any]:
    return {
        "rgba": _numbers(outcome.rgba),
        "srgb8_straight": _hex(outcome),
        "hue": outcome.hue,
        "chroma": _number(outcome.chroma),
        "outcome": outcome.kind,
        "layer": outcome.survivor,
        "grey": outcome.grey,
        "margin": outcome.margin,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _numbers(values: Iterable[float]) -> list[float | None]:
    return [_number(value) for value in values]


def _name(number: int | None) -> int | str:
    return "background" if number is None else number


def _hex(outcome: Outcome) -> str:
    return "#" + "".join(f"{code:02x}" for code in outcome.srgb)


def meaning(pixel: PixelExplanation, outcome: Outcome) -> str:
    """What came of the hues, as a sentence without its full stop."""
    cancelled = f"{outcome.grey:.0%} of the chroma is cancelled"
    if outcome.kind == "layer":
        assert outcome.survivor is not None
        return f"{pixel.layers[outcome.survivor].label} keeps its hue; {cancelled}"
    by_depth = pixel.rules.blending.depends_on_depth and outcome is pixel.result
    return {
        "background": f"the background keeps its hue; {cancelled}",
        "foreign": f"the hue{_hue(outcome.hue, ' ')} is nobody's; {cancelled}",
        "grey": "the foremost colour is next to grey" if by_depth else "the hues cancel to grey",
        "colorless": "no layer brings any chroma here",
        "unmeasured": "values without a hue, such as NaN, were let through",
    }[outcome.kind]


# --- text -----------------------------------------------------------------------------------------


def as_text(pixel: PixelExplanation) -> str:
    """One pixel as aligned lines: what went in, who met whom, what came out."""
    rules = pixel.rules
    lines = [
        f"pixel {pixel.x},{pixel.y} of canvas {pixel.canvas}",
        f"{rules.blending.name}, order {rules.order.name}, space {rules.space.name}, "
        f"primaries {rules.primaries.name}, "
        f"hues equal up to {rules.hue_tolerance:g}°, foreign beyond "
        f"{pixel.settings.foreign_tolerance:.3g}°"
        + (f", gray bias {rules.gray_bias:g}" if rules.gray_bias else "")
        + (f", exposure {rules.exposure:+g} stops" if rules.exposure else ""),
        "",
        *_layer_lines(pixel),
        "",
        "steps",
        *(f"  {line}" for line in _step_lines(pixel)),
        "",
        *_outcome_lines(pixel),
        "",
        meaning(pixel, pixel.result),
        f"traditional: {meaning(pixel, pixel.traditional)}",
    ]
    return "\n".join(map(printable, lines))


def _layer_lines(pixel: PixelExplanation) -> list[str]:
    head = ("layer", "stored", "linear, premultiplied", "opacity", "operator", "weight", "hue",
            "chroma", "weighted")  # fmt: skip
    rows = [
        (
            layer.label,
            _stored(layer.stored, layer.stored_type),
            _color(layer.rgba),
            f"{layer.opacity:g}",
            layer.operator or "-",
            _short(layer.weight),
            _hue(layer.hue) or "-",
            _short(layer.chroma),
            _short(layer.weighted_chroma),
        )
        for layer in pixel.layers
    ]
    under = pixel.background
    if under is not None:
        rows.append(("background", "-", _color((*under.rgb, 1.0)), "1", "dst-over",
                     _short(under.weight), _hue(under.hue) or "-", _short(under.chroma),
                     _short(under.weighted_chroma)))  # fmt: skip
    return _aligned([head, *rows])


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return [
        "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _stored(stored: tuple[float, ...] | None, kind: str) -> str:
    if stored is None:
        return "nothing"
    return f"{' '.join(f'{value:g}' for value in stored)} ({kind})"


def _color(values: Iterable[float]) -> str:
    return " ".join(_short(value) for value in values)


def _short(value: float) -> str:
    """Four digits: fixed where that shows them, else with an exponent."""
    return f"{value:.4f}" if value == 0 or 0.001 <= abs(value) < 1e4 else f"{value:.3g}"


def _hue(hue: float | None, before: str = "") -> str:
    return "" if hue is None else f"{before}{hue:.1f}°"


def _step_lines(pixel: PixelExplanation) -> list[str]:
    lines = [_rivalry_line(row) for row in pixel.rivalries]
    lines += [_meeting_line(step) for step in pixel.meetings]
    if pixel.result.kind == "unmeasured":
        return ["none that could be followed"]
    return lines or ["none: there is one layer"]


def _rivalry_line(row: Rivalry) -> str:
    if row.rival is None:
        return f"{row.number} has no rival of another hue: all of it is left"
    return (
        f"{row.number} has its strongest rival in {row.rival}, {row.angle:.1f}° away: "
        f"{row.share:.1%} of it is left"
    )


def _meeting_line(step: Meeting) -> str:
    first, second = _group(step.first), _group(step.second)
    before = f"{_short(step.chroma_first)} and {_short(step.chroma_second)}"
    after = f"chroma {before} become {_short(step.chroma)}{_hue(step.hue, ', hue ')}"
    if step.angle is None:
        if not step.chroma_first and not step.chroma_second:
            return f"{first} meets {second}: neither brings any chroma"
        grey, other = (first, second) if not step.chroma_first else (second, first)
        return f"{first} meets {second}: {grey} brings no chroma, {other} keeps its own; {after}"
    said = f"{first} meets {second}, {step.angle:.1f}° apart: "
    if step.equality is None and step.dominant is None:
        return said + f"added as they are; {after}"
    if step.equality is None:
        return said + f"{first} is in front, and its hue is all that counts; {after}"
    if step.equality == 1:
        return said + f"equal hues, which add up; {after}"
    if step.dominant is None:
        return said + f"as strong as each other, they cancel; {after}"
    winner = (first, second)[step.dominant - 1]
    if step.equality == 0:
        return said + f"{winner} dominates; {after}"
    return said + f"nearly equal hues (e = {step.equality:.2f}), {winner} dominates; {after}"


def _group(numbers: Sequence[int | None]) -> str:
    return "+".join(str(_name(number)) for number in numbers)


def _outcome_lines(pixel: PixelExplanation) -> list[str]:
    head = ("", "linear, premultiplied", "sRGB, 8 bits", "hue", "chroma", "grey", "margin")
    rows = [
        (
            name,
            _color(outcome.rgba),
            _hex(outcome),
            _hue(outcome.hue) or "-",
            _short(outcome.chroma),
            f"{outcome.grey:.1%}",
            f"{outcome.margin:.3f}",
        )
        for name, outcome in (("result", pixel.result), ("traditional", pixel.traditional))
    ]
    return _aligned([head, *rows])
