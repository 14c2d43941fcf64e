"""A palette as data for scripts: JSON, whose keys are in `JSON_KEYS`; and its findings in words."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from ..analysis.palette import TRADITIONAL, Finding, Floats, Pair, Palette, Profile
from ..errors import printable
from .look import Look, srgb_hex

SCHEMA = "hpcomp.palette"
#: Version of the data; it grows when a key changes its meaning or goes.
SCHEMA_VERSION = 1

#: Opacities that the document lists colours of: so many equal steps from 0 to 1.
LISTED_STEPS = 16

#: Above this share, all chroma is left as far as people are told.
ALL = 0.995

#: Digits of what was computed: more than there are steps in 16 bits, and above rounding.
_DIGITS = 7

#: The keys of the JSON document. The man page prints this.
JSON_KEYS: dict[str, str] = {
    "schema": '"hpcomp.palette".',
    "version": "Of the schema, 1: it grows when a key changes its meaning or goes.",
    "rules": "What decides how colours are added, such as `blending`, `order` and `space`; "
    "`weave` and `weave_size` where they are woven, and then no `order` and no `gray_bias`.",
    "settings": "What findings are measured by: the options of the command, and the "
    "`foreign_tolerance` in degrees.",
    "labels": "A list, in the order given: `name`; the colour as `rgb`, linear, and as `srgb`, "
    "`#rrggbb`; `hue` in degrees, null for a grey; `chroma`, |p| in the blending space; "
    "`luminance`; and `on_background`, for each way of blending `srgb`, `difference` from the "
    "background in Oklab, `contrast` of the luminances, `keeps_hue`, and `share`, of the pixels "
    "that look so: below 1 where the label is woven with a background that has a hue.",
    "pairs": "A list of every label over every other, both opaque: `back` and `front`, numbers in "
    "`labels` from 0; `angle`, degrees between p vectors; `equality`, 1 where the hues count as "
    "equal and 0 where they differ; and for both ways of blending, `traditional` and `result`, "
    "the shares of opacities with a `foreign` hue and with none, `grey`; `left`, the least chroma "
    "as a share of what the two bring; `least_at`, the opacity of the front label there; "
    "`turns_grey`, whether it is a grey there; `srgb`, the colours at 17 opacities, 0 to 1; and "
    "`threads`, of woven blends alone: a list of two, each the `label`, by number, its `share` of "
    "the pixels at those opacities, and its `srgb` there. Then `srgb` of the whole is the mean of "
    "the pixels in linear light, and the other values are of the threads.",
    "findings": "A list: the `kind`, `no-hue`, `close-hues`, `vanishes`, `hue-lost` or "
    "`goes-grey`; the `labels`, by number; the `blendings` in which it is so; what was `measured`, "
    "beyond which `limit`; and a `message`. Of `goes-grey` the first label is the back one.",
}


def shown(palette: Palette, rgb: Any) -> Floats:
    """Linear colours as they are shown: made darker together where a label is beyond white."""
    brightest = max(max(label.rgb) for label in palette.labels)
    within_white: Floats = np.asarray(rgb, np.float64) / max(1.0, brightest)
    return within_white


def hex_colors(palette: Palette, rgb: Any) -> list[str]:
    """Linear colours (n, 3) as #rrggbb, as they are shown."""
    return [srgb_hex(color) for color in shown(palette, rgb)]


def as_json(palette: Palette, look: Look) -> bytes:
    """The document, in ASCII."""
    return (json.dumps(as_data(palette), indent=2) + "\n").encode("ascii")


def as_data(palette: Palette) -> dict[str, Any]:
    """A palette as dictionaries, lists, strings and numbers."""
    settings = palette.settings
    return {
        "schema": SCHEMA,
        "version": SCHEMA_VERSION,
        "rules": rules_data(palette),
        "settings": {
            field.name: getattr(settings, field.name)
            for field in fields(settings)
            if field.name != "background"
        }
        | {"background": srgb_hex(settings.background)},
        "labels": [
            {
                "name": label.name,
                "rgb": _rounded(label.rgb),
                "srgb": srgb_hex(label.rgb),
                "hue": _rounded(label.hue),
                "chroma": _rounded(label.chroma),
                "luminance": _rounded(label.luminance),
                "on_background": {
                    name: {
                        "srgb": srgb_hex(on.rgb),
                        "difference": _rounded(on.difference),
                        "contrast": _rounded(on.contrast),
                        "keeps_hue": on.keeps_hue,
                        "share": _rounded(on.share),
                    }
                    for name, on in palette.on_background[number].items()
                },
            }
            for number, label in enumerate(palette.labels)
        ],
        "pairs": [_pair_data(palette, pair) for pair in palette.pairs],
        "findings": [
            {
                "kind": finding.kind,
                "labels": list(finding.labels),
                "blendings": list(finding.blendings),
                "measured": _rounded(finding.measured),
                "limit": finding.limit,
                "message": sentence(palette, finding),
            }
            for finding in palette.findings
        ],
    }


def rules_data(palette: Palette) -> dict[str, str | float]:
    """What of a stack's rules holds for a palette, by name, as text and numbers."""
    woven = palette.stack.blending.depends_on_place
    elsewhere = {"operators", "opacities", "background", "exposure", "weave"}
    if woven:
        elsewhere |= {"order", "gray_bias"}  # they have no part in it
    rules = {f.name: getattr(palette.stack, f.name) for f in fields(palette.stack)}
    data = {
        name: value if isinstance(value, (str, float)) else str(getattr(value, "name", value))
        for name, value in rules.items()
        if name not in elsewhere
    }
    weave = palette.stack.weave
    return {**data, **({"weave": weave.pattern.name, "weave_size": weave.size} if woven else {})}


def rules_sentence(rules: Mapping[str, str | float]) -> str:
    """Rules as people read them."""
    return ", ".join(
        f"{name.replace('_', ' ')} {value if isinstance(value, str) else format(value, 'g')}"
        for name, value in rules.items()
    )


def _pair_data(palette: Palette, pair: Pair) -> dict[str, Any]:
    return {
        "back": pair.back,
        "front": pair.front,
        "angle": _rounded(pair.angle),
        "equality": _rounded(pair.equality),
        "traditional": _profile_data(palette, pair.traditional),
        "result": _profile_data(palette, pair.result),
    }


def _profile_data(palette: Palette, profile: Profile) -> dict[str, Any]:
    every = (len(profile.rgb) - 1) // LISTED_STEPS
    threads = [
        {
            "label": thread.label,
            "share": _rounded(thread.share[::every].tolist()),
            "srgb": hex_colors(palette, thread.rgb[::every]),
        }
        for thread in profile.threads
    ]
    return {
        "foreign": _rounded(profile.foreign),
        "grey": _rounded(profile.grey),
        "left": _rounded(profile.left),
        "least_at": _rounded(profile.least_at, 4),
        "turns_grey": profile.turns_grey,
        "srgb": hex_colors(palette, profile.rgb[::every]),
        **({"threads": threads} if threads else {}),
    }


def _rounded(value: Any, digits: int = _DIGITS) -> Any:
    """Numbers without what differs by rounding; null stays null."""
    if isinstance(value, Sequence):
        return [_rounded(part, digits) for part in value]
    return None if value is None else round(value, digits) + 0.0


# --- findings in words ----------------------------------------------------------------------------


def sentence(palette: Palette, finding: Finding) -> str:
    """A finding as one line for people."""
    names = [printable(palette.labels[number].name) for number in finding.labels]
    settings = palette.settings
    on = f"at {settings.opacity:.0%} on {srgb_hex(settings.background)}"
    only = "" if len(finding.blendings) > 1 else f" ({finding.blendings[0]} blending)"
    if finding.kind == "no-hue":
        return (
            f"{names[0]} has no hue, its saturation is {finding.measured:.3f}: as a label it can "
            "only be told by its luminance"
        )
    if finding.kind == "close-hues":
        equality = palette.pair(*finding.labels).equality
        taken = (
            "blending takes them for one label" if equality == 1
            else "blending takes them for nearly one label" if equality > 0
            else "once pale, they are hard to tell apart"
        )  # fmt: skip
        return (
            f"{names[0]} and {names[1]} are {finding.measured:.1f}° apart, less than "
            f"{finding.limit:g}°: {taken}"
        )
    if finding.kind == "vanishes":
        shown_on = palette.on_background[finding.labels[0]][finding.blendings[-1]]
        return (
            f"{names[0]} vanishes {on}: it differs by {finding.measured:.3f}, less than "
            f"{finding.limit:g}, with a contrast of {shown_on.contrast:.2f}:1{only}"
        )
    if finding.kind == "hue-lost":
        # Plain + turns the hue of a stronger label as well, in oklab even on white.
        why = (
            "mixing with the background turns it" if set(finding.blendings) == {TRADITIONAL}
            else "its thread is next to grey" if palette.stack.blending.depends_on_place
            else "the background's is stronger"
        )  # fmt: skip
        return f"{names[0]} {on} does not have its own hue: {why}{only}"
    return (
        f"{names[0]} turns grey under {finding.measured:.0%} of {names[1]}, which is less than "
        f"{finding.limit:.0%}: beside such a strong colour it is hardly seen{only}"
    )
