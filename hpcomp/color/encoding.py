"""What stored numbers mean as light: transfer curves, primaries, gamut. The only door to colour.

Decoding goes from stored values to linear light in the working primaries; encoding goes from
composited colour to the straight code values of a PNG. No files here.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SettingError, unknown_name
from .spaces import REC709_TO_XYZ, Matrix

Array = NDArray[np.floating[Any]]
Float64 = NDArray[np.float64]
Chromaticity = tuple[float, float]


# --- transfer curves ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Transfer:
    """A transfer curve: stored value (1.0 is white) to linear light.

    `decode`: float64, any shape; negative values mirror the curve, values above 1 extend it, but
    not beyond the end of a table. `channels`: the curves of red, green and blue where they differ;
    `decode` then takes (…, 3).
    """

    name: str
    decode: Callable[[Float64], Float64]
    channels: tuple[Transfer, ...] = ()


def _decode_srgb(value: Float64) -> Float64:
    # IEC 61966-2-1:1999, mirrored below 0.
    size = np.abs(value)
    linear = np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    return np.copysign(linear, value)


def _decode_rec709_camera(value: Float64) -> Float64:
    # ITU-R BT.709-6, item 1.2, inverted.
    size = np.abs(value)
    linear = np.where(size < 0.081, size / 4.5, ((size + 0.099) / 1.099) ** (1 / 0.45))
    return np.copysign(linear, value)


LINEAR = Transfer("linear", lambda value: value)
SRGB = Transfer("sRGB", _decode_srgb)
REC709_CAMERA = Transfer("BT.709", _decode_rec709_camera)


@cache
def gamma(exponent: float) -> Transfer:
    """A pure power: stored ** exponent is linear light."""
    if exponent == 1:
        return LINEAR
    return Transfer(
        f"gamma {exponent:.4g}", lambda value: np.copysign(np.abs(value) ** exponent, value)
    )


def mirrored(name: str, curve: Callable[[Float64], Float64]) -> Transfer:
    """A curve that is given for values from 0 up."""
    return Transfer(name, lambda value: np.copysign(curve(np.abs(value)), value))


def of_channels(red: Transfer, green: Transfer, blue: Transfer) -> Transfer:
    """A curve of its own for each channel."""
    curves = (red, green, blue)
    name = " / ".join(dict.fromkeys(curve.name for curve in curves))

    def decode(value: Float64) -> Float64:
        planes = [curve.decode(value[..., channel]) for channel, curve in enumerate(curves)]
        return np.stack(planes, axis=-1)

    return Transfer(name, decode, curves)


def narrow_range(transfer: Transfer, depth: int) -> Transfer:
    """The curve of values whose black is at 16 and whose white at 235, in 8 of `depth` bits.

    Rec. ITU-R BT.709-6, item 3.4.
    """
    step = 2.0 ** (depth - 8) / (2**depth - 1)
    return Transfer(
        f"{transfer.name}, narrow range",
        lambda value: transfer.decode((value - 16 * step) / (219 * step)),
    )


def _undecodable(value: Float64) -> Float64:
    raise SettingError("HDR curves are not decoded")


#: ITU-T H.273 code points of the curves of HDR (Rec. ITU-R BT.2100), whose light is relative to a
#: display: they are known by name, to be refused.
HDR_TRANSFERS = {16: Transfer("PQ", _undecodable), 18: Transfer("HLG", _undecodable)}


def encode_srgb(linear: Float64) -> Float64:
    """Linear light to the sRGB curve, float64, any shape. IEC 61966-2-1:1999, mirrored below 0."""
    size = np.abs(linear)
    value = np.where(size <= 0.0031308, size * 12.92, 1.055 * size ** (1 / 2.4) - 0.055)
    return np.copysign(value, linear)


@lru_cache(maxsize=32)
def decode_table(transfer: Transfer, largest: int) -> NDArray[np.float32]:
    """Linear light of each code value 0 … `largest`, float32; of one curve for all channels."""
    return transfer.decode(np.arange(largest + 1) / largest).astype(np.float32)


# --- primaries ------------------------------------------------------------------------------------

#: CIE 1931 xy of the white points. ITU-R BT.709-6; SMPTE ST 2065-1 for the ACES white.
D65: Chromaticity = (0.3127, 0.3290)
ACES_WHITE: Chromaticity = (0.32168, 0.33767)

#: Files store chromaticities in 5 digits, and D65 in several roundings of its own: closer than this
#: changes no colour by half an 8-bit step.
SAME_CHROMATICITY = 2e-4


@dataclass(frozen=True)
class Primaries:
    """The CIE 1931 xy chromaticities of red, green, blue and white."""

    name: str
    red: Chromaticity
    green: Chromaticity
    blue: Chromaticity
    white: Chromaticity

    @property
    def xy(self) -> Float64:
        """(4, 2): red, green, blue, white."""
        return np.array([self.red, self.green, self.blue, self.white])


PRIMARIES: dict[str, Primaries] = {
    row.name: row
    for row in (
        # ITU-R BT.709-6; SMPTE EG 432-1 with D65; ITU-R BT.2020-2; AMPAS S-2014-004;
        # SMPTE ST 2065-1; Adobe RGB (1998), 2005-05.
        Primaries("rec709", (0.64, 0.33), (0.30, 0.60), (0.15, 0.06), D65),
        Primaries("display-p3", (0.680, 0.320), (0.265, 0.690), (0.150, 0.060), D65),
        Primaries("rec2020", (0.708, 0.292), (0.170, 0.797), (0.131, 0.046), D65),
        Primaries("acescg", (0.713, 0.293), (0.165, 0.830), (0.128, 0.044), ACES_WHITE),
        Primaries("aces2065-1", (0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.0770), ACES_WHITE),
        Primaries("adobe-rgb", (0.64, 0.33), (0.21, 0.71), (0.15, 0.06), D65),
    )
}
REC709 = PRIMARIES["rec709"]
#: Those that a stack may be asked to be composited in; a file may have others.
WORKING_PRIMARIES = ("rec709", "display-p3", "rec2020", "acescg")
#: Those that a PNG can be written in.
OUT_PRIMARIES = ("rec709", "display-p3", "rec2020")
#: Asks for those of the bottom layer.
BOTTOM = "bottom"


def working_primaries(name: str) -> Primaries:
    """The working primaries of that name; `SettingError` lists the valid ones."""
    if name not in WORKING_PRIMARIES:
        raise unknown_name("primaries", name, WORKING_PRIMARIES)
    return PRIMARIES[name]


def primaries_from_xy(xy: Any) -> Primaries:
    """The primaries with these 8 chromaticities: the known ones by name, others as `custom`.

    `xy`: red, green, blue, white, x before y. Errors: `ValueError` where they span no gamut.
    """
    found = np.asarray(xy, float).reshape(4, 2)
    for known in PRIMARIES.values():
        if np.abs(found - known.xy).max() <= SAME_CHROMATICITY:
            return known
    corners = np.concatenate([found[:3], np.ones((3, 1))], axis=1)
    if not np.isfinite(found).all() or abs(np.linalg.det(corners)) < 1e-6 or found[3, 1] <= 0:
        raise ValueError("chromaticities that span no gamut")
    red, green, blue, white = ((float(x), float(y)) for x, y in found)
    return Primaries("custom", red, green, blue, white)


@contextlib.contextmanager
def _colour() -> Iterator[Any]:
    """The library, imported when it is needed."""
    # It warns of optional packages that nothing here needs, and changes how numpy prints.
    with warnings.catch_warnings(), np.printoptions():
        warnings.simplefilter("ignore")
        import colour

        yield colour


def _xyz(xy: Chromaticity) -> Float64:
    """XYZ of a chromaticity at Y = 1."""
    x, y = xy
    return np.array([x / y, 1.0, (1 - x - y) / y])


@cache
def conversion(source: Primaries, target: Primaries) -> Float64 | None:
    """(3, 3): linear RGB of some primaries to others, Bradford-adapted; None if they are the same.

    White becomes white, and grey grey, whatever the white points.
    """
    if source == target:
        return None
    with _colour() as colour:
        spaces = (colour.RGB_Colourspace(p.name, p.xy[:3], p.xy[3]) for p in (source, target))
        matrix = colour.matrix_RGB_to_RGB(*spaces, "Bradford")
    return np.asarray(matrix, float)


@cache
def to_xyz(primaries: Primaries) -> Matrix:
    """Linear RGB to CIE XYZ by rows, adapted to D65 by Bradford: white is D65 at Y = 1.

    The second row has the luminance weights.
    """
    if primaries == REC709:
        return REC709_TO_XYZ
    with _colour() as colour:
        space = colour.RGB_Colourspace(primaries.name, primaries.xy[:3], primaries.xy[3])
        matrix = np.asarray(space.matrix_RGB_to_XYZ, float)
    if primaries.white != D65:
        matrix = adaptation(_xyz(primaries.white), _xyz(D65)) @ matrix
    return tuple(tuple(map(float, row)) for row in matrix)


def converted(rgb: Array, source: Primaries, target: Primaries) -> Array:
    """Linear RGB (…, 3) of some primaries in others, in its own precision."""
    matrix = conversion(source, target)
    if matrix is None:
        return rgb
    # The operations and their order are part of the contract: the kernel has the same ones.
    red, green, blue = np.moveaxis(rgb, -1, 0)
    return np.stack(
        [float(r) * red + float(g) * green + float(b) * blue for r, g, b in matrix], axis=-1
    )


def adaptation(white: Array, to_white: Array) -> Float64:
    """(3, 3): XYZ under one white to XYZ under another, by Bradford; the whites as XYZ."""
    with _colour() as colour:
        matrix = colour.adaptation.matrix_chromatic_adaptation_VonKries(
            white, to_white, transform="Bradford"
        )
    return np.asarray(matrix, float)


# --- encodings ------------------------------------------------------------------------------------


@dataclass(frozen=True)
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
    found = COLOR_SPACES.get(name) or COLOR_INTEROP_IDS.get(name)
    if found is None:
        raise unknown_name("colorspace", name, COLOR_SPACES)
    return found


def parse_hex_color(text: str) -> tuple[float, float, float]:
    """Straight linear RGB in [0, 1] of a CSS hex colour: `#rgb` or `#rrggbb`, in sRGB."""
    digits = text.removeprefix("#")
    if len(digits) == 3:
        digits = "".join(2 * digit for digit in digits)
    try:
        codes = bytes.fromhex(digits) if digits.isalnum() else b""
    except ValueError:
        codes = b""
    if len(codes) != 3:
        raise SettingError(f"'{text}' is not a colour: write a CSS hex colour such as #ff8800")
    red, green, blue = (float(v) for v in SRGB.decode(np.frombuffer(codes, np.uint8) / 255))
    return red, green, blue


#: What a file's alpha says of its colours: they are straight, or premultiplied in linear light, or
#: premultiplied as encoded; `luminance` makes the alpha from them.
ALPHA_MODES = ("straight", "premultiplied", "premultiplied-encoded", "luminance")


# --- light to code values -------------------------------------------------------------------------

#: The largest finite half-float.
LARGEST_HALF = 65504.0


@dataclass
class Losses:
    """Pixels of a result that its file cannot hold as they are, counted while it is encoded."""

    out_of_gamut: int = 0
    light_without_alpha: int = 0
    not_a_number: int = 0
    beyond_half: int = 0

    def add(self, other: Losses) -> None:
        """Counts those of `other` too."""
        for name, count in vars(other).items():
            setattr(self, name, getattr(self, name) + count)


def to_straight_srgb(
    rgba: Array,
    code_type: type[np.unsignedinteger[Any]],
    losses: Losses,
    primaries: Primaries = REC709,
) -> NDArray[np.unsignedinteger[Any]]:
    """Rounded code values on the sRGB curve, straight, as many as `code_type` has.

    `rgba`: (…, 4), linear, premultiplied, alpha in [0, 1], in `primaries`, whose gamut is that of
    the codes. Losses are counted.
    Colours outside the gamut by more than half a code value move towards the grey of their own
    luminance, so hue and luminance stay; above white they become white, below black black.
    """
    flat = rgba.reshape(-1, 4)
    codes = np.empty(flat.shape, code_type)
    for begin in range(0, len(flat), _ENCODED_PIXELS):
        block = slice(begin, begin + _ENCODED_PIXELS)
        codes[block] = _straight_srgb_codes(
            flat[block], int(np.iinfo(code_type).max), losses, primaries
        )
    return codes.reshape(rgba.shape)


#: Pixels that are encoded at a time: in doubles, so that ties round as they should, and in cache.
_ENCODED_PIXELS = 1 << 14


def _straight_srgb_codes(
    rgba: Array, largest: int, losses: Losses, primaries: Primaries
) -> Float64:
    """(n, 4) → rounded code values 0 … `largest`, as floats."""
    half_code = 0.5 / largest
    unknown = np.any(np.isnan(rgba), axis=1)
    if unknown.any():
        losses.not_a_number += int(unknown.sum())
        rgba = np.where(unknown[:, None], 0, rgba)
    alpha = rgba[:, 3].astype(np.float64)
    codes = np.zeros(rgba.shape)
    np.rint(alpha * largest, out=codes[:, 3])
    visible = codes[:, 3] > 0
    straight = np.zeros((len(rgba), 3))
    np.divide(rgba[:, :3], alpha[:, None], out=straight, where=visible[:, None])

    lowest, darkest, highest = SRGB.decode(np.array([-half_code, half_code, 1 + half_code]))
    # A valid premultiplied colour is no brighter than its alpha: rounding that away loses nothing.
    glow = np.abs(rgba[:, :3]) - alpha[:, None] > darkest
    lost: NDArray[np.bool_] = ~visible & glow.any(axis=1)
    losses.light_without_alpha += int(lost.sum())
    outside: NDArray[np.bool_] = ((straight < lowest) | (straight > highest)).any(axis=1)
    if outside.any():
        losses.out_of_gamut += int(outside.sum())
        straight[outside] = into_gamut(straight[outside], primaries)
    np.rint(encode_srgb(np.clip(straight, 0, 1)) * largest, out=codes[:, :3])
    return codes


def into_gamut(straight: Float64, primaries: Primaries = REC709) -> Float64:
    """(n, 3), linear, straight → the same luminance and hue with every channel in [0, 1].

    Chroma is scaled by the largest factor that fits; luminance above 1 gives white, below 0 black.
    """
    red, green, blue = straight.T
    w_red, w_green, w_blue = to_xyz(primaries)[1]
    luminance = np.clip(w_red * red + w_green * green + w_blue * blue, 0, 1)[:, None]
    infinite = ~np.isfinite(straight).all(axis=1, keepdims=True)
    luminance[np.isnan(luminance)] = 1
    difference = np.where(infinite, 0, straight - luminance)
    room = np.where(difference > 0, 1 - luminance, luminance)
    fits = np.ones_like(difference)
    np.divide(room, np.abs(difference), out=fits, where=np.abs(difference) > room)
    return luminance + fits.min(axis=1, keepdims=True) * difference


def to_half_range(rgba: Array, losses: Losses) -> Array:
    """`rgba` with finite values clamped to what a half-float holds; clamped pixels are counted."""
    beyond = (np.abs(rgba) > LARGEST_HALF) & np.isfinite(rgba)
    if not beyond.any():
        return rgba
    losses.beyond_half += int(beyond.any(axis=-1).sum())
    return np.where(beyond, np.copysign(LARGEST_HALF, rgba), rgba).astype(rgba.dtype)
