"""How stored RGB means light: curve and primaries together, by the names that users and files give.

What a curve or a matrix computes lives in `transfer` and `primaries`; no files here.
"""

from __future__ import annotations

from ..errors import unknown_name
from ..records import record
from .primaries import PRIMARIES, REC709, Primaries
from .transfer import LINEAR, SRGB, Transfer, gamma

#: What a file's alpha says of its colours: they are straight, or premultiplied in linear light, or
#: premultiplied as encoded; `luminance` makes the alpha from them.
ALPHA_MODES = ("straight", "premultiplied", "premultiplied-encoded", "luminance")


@record
class ColorEncoding:
    """How stored RGB means light: a transfer curve and primaries."""

    transfer: Transfer
    primaries: Primaries

    def __str__(self) -> str:
        return f"{self.transfer.name}, {self.primaries.name}"


SRGB_ENCODING = ColorEncoding(SRGB, REC709)
LINEAR_REC709 = ColorEncoding(LINEAR, REC709)
_GAMMA_22 = gamma(2.2)

#: The names of `colorspace=`, and the colorInteropIDs of the ASWF Color Interop Forum, which files
#: carry. Their scene and display forms differ in viewing, not in what a stored number means.
COLOR_SPACES: dict[str, ColorEncoding] = {
    "srgb": SRGB_ENCODING,
    "linear": LINEAR_REC709,
    "display-p3": ColorEncoding(SRGB, PRIMARIES["display-p3"]),
    "adobe-rgb": ColorEncoding(gamma(563 / 256), PRIMARIES["adobe-rgb"]),
    "linear-display-p3": ColorEncoding(LINEAR, PRIMARIES["display-p3"]),
    "linear-rec2020": ColorEncoding(LINEAR, PRIMARIES["rec2020"]),
    "acescg": ColorEncoding(LINEAR, PRIMARIES["acescg"]),
    "aces2065-1": ColorEncoding(LINEAR, PRIMARIES["aces2065-1"]),
}
COLOR_INTEROP_IDS: dict[str, ColorEncoding] = {
    "lin_rec709_scene": LINEAR_REC709,
    "lin_p3d65_scene": COLOR_SPACES["linear-display-p3"],
    "lin_rec2020_scene": COLOR_SPACES["linear-rec2020"],
    "lin_ap1_scene": COLOR_SPACES["acescg"],
    "lin_ap0_scene": COLOR_SPACES["aces2065-1"],
    "lin_adobergb_scene": ColorEncoding(LINEAR, PRIMARIES["adobe-rgb"]),
    "srgb_rec709_scene": SRGB_ENCODING,
    "srgb_rec709_display": SRGB_ENCODING,
    "srgb_p3d65_scene": COLOR_SPACES["display-p3"],
    "srgb_p3d65_display": COLOR_SPACES["display-p3"],
    "srgb_ap1_scene": ColorEncoding(SRGB, PRIMARIES["acescg"]),
    "g22_rec709_scene": ColorEncoding(_GAMMA_22, REC709),
    "g22_rec709_display": ColorEncoding(_GAMMA_22, REC709),
    "g18_rec709_scene": ColorEncoding(gamma(1.8), REC709),
    "g22_ap1_scene": ColorEncoding(_GAMMA_22, PRIMARIES["acescg"]),
    "g22_adobergb_scene": ColorEncoding(_GAMMA_22, PRIMARIES["adobe-rgb"]),
    "g22_adobergb_display": ColorEncoding(_GAMMA_22, PRIMARIES["adobe-rgb"]),
    "g24_rec709_display": ColorEncoding(gamma(2.4), REC709),
}


def interop_id(primaries: Primaries) -> str | None:
    """The colorInteropID of linear light in these primaries, where there is one."""
    wanted = ColorEncoding(LINEAR, primaries)
    return next((name for name, row in COLOR_INTEROP_IDS.items() if row == wanted), None)


def color_space(name: str) -> ColorEncoding:
    """The encoding of that name; `SettingError` lists the valid ones."""
    encoding = COLOR_SPACES.get(name) or COLOR_INTEROP_IDS.get(name)
    if encoding is None:
        raise unknown_name("colorspace", name, (*COLOR_SPACES, *COLOR_INTEROP_IDS))
    return encoding
