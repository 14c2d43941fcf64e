"""CSS colours, `#ff8800` or `orange`, in linear light. Knows no pixels, no layers."""

from __future__ import annotations

import re
from functools import cache, lru_cache

import numpy as np

from ..errors import SettingError, nearest_name
from .transfer import SRGB

#: What has a colour but no alpha of its own, and why.
_WITHOUT_ALPHA = {
    "background": "a background is opaque",
    "label": "a label is tried at every opacity",
    "tint": "a tint has the alpha of its mask, which opacity= lowers",
}
_DIGITS = set("0123456789abcdef")
#: Digits that a colour may have, and how many of them are not its alpha.
_RGB_DIGITS = {3: 3, 4: 3, 6: 6, 8: 6}
#: Codes of red, green and blue, as CSS and others write them, or hexadecimal digits as C does.
_CODES = re.compile(r"(?:rgba?)?[\s([]*(\d{1,3})[\s,;]+(\d{1,3})[\s,;]+(\d{1,3})[\s)\]]*", re.ASCII)
_HEXADECIMAL = re.compile("0x([0-9a-f]{6})")
#: Names of CSS Color Module Level 4 that Level 3 has not, which is as far as webcolors goes.
_NAMES_OF_LEVEL_4 = {"rebeccapurple": "#663399"}


@lru_cache  # jobs by the thousand have the same few
def css_color(text: str, use: str) -> tuple[float, float, float]:
    """Straight linear RGB in [0, 1] of a colour in sRGB.

    `text`: a name, `#rgb` or `#rrggbb`, with or without the `#`; with digits of an alpha only if
    that is opaque. `use`: what the colour is of, a background, a label or a tint.
    Errors: `SettingError`.
    """
    import webcolors

    name, names = text.lower(), _names()
    digits = names.get(name, name).removeprefix("#")
    n_rgb = _RGB_DIGITS.get(len(digits))
    if n_rgb is None or not set(digits) <= _DIGITS:
        meant = _rgb_like(name) or f"a CSS colour such as #ff8800 or {_name_like(name)}"
        raise SettingError(f"'{text}' is not a colour: write {meant}")
    color, alpha = f"#{digits[:n_rgb]}", digits[n_rgb:]
    if alpha.strip("f"):
        raise SettingError(f"'{text}' is translucent, but {_WITHOUT_ALPHA[use]}: write {color}")
    codes = np.array(webcolors.hex_to_rgb(color))
    red, green, blue = (float(v) for v in SRGB.decode(codes / 255))
    return red, green, blue


def _rgb_like(text: str) -> str:
    """The colour that codes in another spelling mean, as `#rrggbb`; empty if they are none."""
    if match := _HEXADECIMAL.fullmatch(text):
        return f"#{match[1]}"
    match = _CODES.fullmatch(text)
    codes = [int(code) for code in match.groups()] if match else [256]
    return "" if max(codes) > 255 else "#" + "".join(f"{code:02x}" for code in codes)


def _name_like(text: str) -> str:
    """The name that was probably meant; any name if that is none."""
    return nearest_name(re.sub(r"[\s_-]", "", text), _names()) or "orange"


def css_names() -> list[str]:
    """The names of colours, sorted."""
    return sorted(_names())


def css_title(text: str) -> str:
    """What a colour is called that has no other name: as it is written, in small letters."""
    name = text.lower()
    return name if name in _names() else f"#{name.removeprefix('#')}"


@cache
def _names() -> dict[str, str]:
    import webcolors

    return {name: webcolors.name_to_hex(name) for name in webcolors.names()} | _NAMES_OF_LEVEL_4
