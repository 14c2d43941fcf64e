"""How one pixel of a stack comes about, as text for people and data for JSON. Blends nothing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from ..analysis.explain import Meeting, Outcome, PixelExplanation, Rivalry, Weaving
from ..errors import printable

#: Version of the data that `as_data` gives; it grows when a key changes its meaning or goes.
SCHEMA_VERSION = 1

#: What shares of a strength are shares of.
_STRENGTH_IS = {"chroma": "chroma", "perceived": "strength", "coverage": "coverage"}

#: The keys of the JSON document. The man page prints this.
JSON_KEYS: dict[str, str] = {
    "schema": '"hpcomp.explain".',
    "version": "Of the schema, 1: it grows when a key changes its meaning or goes.",
    "pixel, canvas": "`x` and `y`, in coordinates of the canvas; of the canvas also `width` and "
    "`height`.",
    "blending, order, space, primaries, hue_tolerance, gray_bias, strength, weave, weave_size, "
    "foreign_tolerance, exposure": "What was chosen. `weave` and `weave_size` are null where "
    "nothing is woven.",
    "layers": "A list, bottom first: `number` and `label`; the sample as `stored` in the file, of "
    "the `stored_type`, both null where the layer has no pixel; `rgba`, linear and premultiplied; "
    "`opacity`, `operator` and the `weight` that these leave; `hue` in degrees, null for a grey; "
    "`chroma`, |p| of `rgba`; `weighted_chroma`, with opacity and weight; and "
    "`weighted_strength`, what competes, null where that is the weighted chroma.",
    "background": "The same, with `rgb_straight`; null where there is none.",
    "steps": "A list of who met whom, where colours are added one by one: `first` and `second`, "
    'lists of layers\' numbers, or "background"; `chroma_first` and `chroma_second`; the `angle` '
    "between them; `equality`, 1 for equal hues and 0 for different ones; `dominant`, `first`, "
    "`second` or null; `chroma` and `hue` of the sum; and `strength_first`, `strength_second` and "
    "`strength`, null where that is the chroma.",
    "rivalries": "A list of layers in simultaneous order: `layer`, the `share_left` of its chroma, "
    "its strongest `rival`, and the `angle` between the two.",
    "weaving": "Of woven blending, else null: the `phase` of the pattern, 0 to 1; `threads`, a "
    'list sorted by hue, each with `layer`, a number or "background", `hue`, weighted `chroma`, '
    "its `share` of the strength, and `begin`, the phase from which on it is shown; `chosen`, the "
    "layers whose thread this pixel is; `one_hue`, whether there is no other hue; and `bound`, the "
    "share of the chroma for which the gamut has no room.",
    "result, traditional": "What came of the pixel, and what plain + gives: `rgba`, linear and "
    "premultiplied; `srgb8_straight`, `#rrggbbaa`; `hue` and `chroma`, before the exposure; the "
    "`outcome`, `layer`, `background`, `foreign`, `grey`, `colorless` or `unmeasured`; the `layer` "
    "whose hue survived; `grey`, the share of chroma that is cancelled; and `margin`, how far the "
    "layer was ahead.",
    "meaning, meaning_traditional": "The same in words.",
}


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
        "strength": rules.strength.name,
        "weave": rules.weave.pattern.name if rules.blending.depends_on_place else None,
        "weave_size": rules.weave.size if rules.blending.depends_on_place else None,
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
                "weighted_strength": _or_none(layer.weighted_strength),
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
            "weighted_strength": _or_none(pixel.background.weighted_strength),
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
                "strength_first": step.strength_first,
                "strength_second": step.strength_second,
                "strength": step.strength,
            }
            for step in pixel.meetings
        ],
        "rivalries": [
            {"layer": r.number, "share_left": r.share, "rival": r.rival, "angle": r.angle}
            for r in pixel.rivalries
        ],
        "weaving": pixel.weaving and _weaving_data(pixel.weaving),
        "result": _outcome_data(pixel.result),
        "traditional": _outcome_data(pixel.traditional),
        "meaning": meaning(pixel, pixel.result),
        "meaning_traditional": meaning(pixel, pixel.traditional),
    }


def _weaving_data(weaving: Weaving) -> dict[str, Any]:
    return {
        "phase": weaving.phase,
        "threads": [
            {
                "layer": _name(thread.number),
                "hue": thread.hue,
                "chroma": thread.chroma,
                "share": thread.share,
                "begin": thread.begin,
            }
            for thread in weaving.threads
        ],
        "chosen": [_name(number) for number in weaving.chosen],
        "one_hue": weaving.one_hue,
        "bound": weaving.bound,
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


def _or_none(value: float | None) -> float | None:
    return None if value is None else _number(value)


def _numbers(values: Iterable[float]) -> list[float | None]:
    return [_number(value) for value in values]


def _name(number: int | None) -> int | str:
    return "background" if number is None else number


def _hex(outcome: Outcome) -> str:
    return "#" + "".join(f"{code:02x}" for code in outcome.srgb)


def meaning(pixel: PixelExplanation, outcome: Outcome) -> str:
    """What came of the hues, as a sentence without its full stop."""
    if pixel.weaving is not None and outcome is pixel.result and pixel.weaving.threads:
        return _meaning_woven(pixel, pixel.weaving)
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


def _meaning_woven(pixel: PixelExplanation, weaving: Weaving) -> str:
    """Whose thread the pixel is, and what of it the gamut holds."""
    whose = " and ".join(
        "the background" if number is None else pixel.layers[number].label
        for number in weaving.chosen
    )
    beyond = ""
    if weaving.bound:
        beyond = f"; the gamut has no room for {weaving.bound:.0%} of its chroma at this luminance"
    if weaving.one_hue:
        return f"only one hue here, that of {whose}: plain +{beyond}"
    what = _STRENGTH_IS[pixel.rules.strength.name]
    return (
        f"this pixel is the thread of {whose}: {weaving.share:.0%} of the {what}, "
        f"phase {weaving.phase:.2f}{beyond}"
    )


# --- text -----------------------------------------------------------------------------------------


def as_text(pixel: PixelExplanation) -> str:
    """One pixel as aligned lines: what went in, who met whom, what came out."""
    lines = [
        f"pixel {pixel.x},{pixel.y} of canvas {pixel.canvas}",
        ", ".join(_chosen(pixel)),
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


def _chosen(pixel: PixelExplanation) -> Iterator[str]:
    """What was chosen, as far as it has a part in the result."""
    rules = pixel.rules
    woven = rules.blending.depends_on_place
    yield rules.blending.name
    yield str(rules.weave) if woven else f"order {rules.order.name}"
    yield f"space {rules.space.name}"
    yield f"primaries {rules.primaries.name}"
    if _has_strengths(pixel):
        yield f"strength {rules.strength.name}"
    if not woven:
        yield f"hues equal up to {rules.hue_tolerance:g}°"
    yield f"foreign beyond {pixel.settings.foreign_tolerance:.3g}°"
    if rules.gray_bias and not woven:
        yield f"gray bias {rules.gray_bias:g}"
    if rules.exposure:
        yield f"exposure {rules.exposure:+g} stops"


def _has_strengths(pixel: PixelExplanation) -> bool:
    """Whether what competes is another number than the chroma."""
    return pixel.layers[0].weighted_strength is not None


def _layer_lines(pixel: PixelExplanation) -> list[str]:
    head: tuple[str, ...] = (
        *("layer", "stored", "linear, premultiplied", "opacity", "operator", "weight", "hue"),
        *("chroma", "weighted"),
    )
    if _has_strengths(pixel):
        head = (*head, "strength")
    rows: list[tuple[str, ...]] = [
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
            *_shown(layer.weighted_strength),
        )
        for layer in pixel.layers
    ]
    under = pixel.background
    if under is not None:
        rows.append(("background", "-", _color((*under.rgb, 1.0)), "1", "dst-over",
                     _short(under.weight), _hue(under.hue) or "-", _short(under.chroma),
                     _short(under.weighted_chroma),
                     *_shown(under.weighted_strength)))  # fmt: skip
    return _aligned([head, *rows])


def _shown(strength: float | None) -> list[str]:
    return [] if strength is None else [_short(strength)]


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
    if pixel.result.kind == "unmeasured":
        return ["none that could be followed"]
    if pixel.weaving is not None:
        return _weaving_lines(pixel, pixel.weaving)
    lines = [_rivalry_line(row) for row in pixel.rivalries]
    lines += [_meeting_line(step) for step in pixel.meetings]
    alone = len(pixel.layers) == 1
    return lines or ["none: there is one layer" if alone else "none: no colour here has a hue"]


def _weaving_lines(pixel: PixelExplanation, weaving: Weaving) -> list[str]:
    """The threads by hue, as phases go from 0 to 1, and where the pixel is among them."""
    if not weaving.threads:
        return ["none: no colour here has a hue"]
    ends = [*(thread.begin for thread in weaving.threads[1:]), 1.0]
    rows = [("thread", "hue", "chroma", "share", "phases")]
    for thread, end in zip(weaving.threads, ends, strict=True):
        rows.append(
            (
                str(_name(thread.number)),
                _hue(thread.hue) or "-",
                _short(thread.chroma),
                f"{thread.share:.1%}",
                f"{thread.begin:.3f} to {end:.3f}",
            )
        )
    if weaving.one_hue:
        return [*_aligned(rows), "all of one hue, which add up"]
    chosen = "+".join(str(_name(number)) for number in weaving.chosen)
    return [*_aligned(rows), f"{pixel.rules.weave} have phase {weaving.phase:.3f} here: {chosen}"]


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
    if not (step.strength_first is None or step.strength_second is None or step.strength is None):
        before = f"{_short(step.strength_first)} and {_short(step.strength_second)}"
        after = f"strength {before} become {_short(step.strength)}, {after}"
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
