"""What an ICC profile says of RGB or grey: a curve and primaries, where it is no table. ICC.1:2022.

Of a profile of matrix and curves the colorants are taken back from the D50 of the connection space
to the profile's own white. No files here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..color.encodings import ColorEncoding
from ..color.primaries import (
    D50_XYZ,
    D65,
    REC709,
    XYZ,
    Primaries,
    adaptation,
    primaries_from_xy,
    to_xyz,
    white_xyz,
)
from ..color.transfer import HDR_TRANSFERS, LINEAR, SRGB, Transfer, gamma, mirrored, of_channels

Array = NDArray[np.floating[Any]]

#: Colorants of sRGB adapted to the D50 connection space; IEC 61966-2-1 through Bradford.
_SRGB_COLORANTS = np.array(
    [[0.4361, 0.2225, 0.0139], [0.3851, 0.7169, 0.0971], [0.1431, 0.0606, 0.7141]]
)
#: Published sRGB profiles differ by up to this much in a colorant, and in their tabulated curve.
_COLORANT_TOLERANCE = 2e-3
_CURVE_TOLERANCE = 3e-3
_CURVE_SAMPLES = np.linspace(0, 1, 65)
_D65_XYZ = white_xyz(D65)
#: A white this near to D50 says nothing of the device.
_WHITE_TOLERANCE = 5e-3
#: The classes of profiles that take a device's values to the connection space: of inputs, displays
#: and outputs, and conversions between spaces.
_CLASSES = (b"scnr", b"mntr", b"prtr", b"spac")


@lru_cache(maxsize=16)
def encoding(profile: bytes, grey: bool) -> ColorEncoding:
    """The curves and primaries of a matrix/TRC profile, or the curve of a grey one.

    `grey`: whether the picture is. Errors: `ValueError` that says what kind of profile it is.
    """
    try:
        return _encoding(profile, grey)
    except (KeyError, struct.error, ArithmeticError, np.linalg.LinAlgError):
        raise ValueError("damaged") from None


def description(profile: bytes) -> str:
    """The profile's own name for itself, or an empty string."""
    try:
        tag = _tags(profile)[b"desc"]
        if tag[:4] == b"mluc":
            length, offset = struct.unpack(">II", tag[20:28])
            return tag[offset : offset + length].decode("utf-16-be")
        (length,) = struct.unpack(">I", tag[8:12])
        return tag[12 : 12 + length].rstrip(b"\0").decode("latin-1")
    except (KeyError, struct.error, ValueError):
        return ""


def profile(name: str, primaries: Primaries) -> bytes:
    """A display profile of these primaries and the curve of sRGB. ICC.1:2022, 8.4.3: version 4.3.

    Without a date, so that it is the same whenever it is made.
    """
    chad = adaptation(white_xyz(primaries.white), D50_XYZ)
    # Its RGB→XYZ is adapted to D65 already: from there to D50.
    colorants = adaptation(_D65_XYZ, D50_XYZ) @ np.array(to_xyz(primaries))
    curve = b"para" + bytes(4) + struct.pack(">HH", 3, 0) + _fixed(_SRGB_PARAMETERS)
    tags = {
        b"desc": _text(name),
        b"cprt": _text("CC0"),
        b"wtpt": b"XYZ " + bytes(4) + _fixed(D50_XYZ),
        b"chad": b"sf32" + bytes(4) + _fixed(chad.ravel()),
        **{
            bytes([letter]) + b"XYZ": b"XYZ " + bytes(4) + _fixed(colorants[:, i])
            for i, letter in enumerate(b"rgb")
        },
        **{bytes([letter]) + b"TRC": curve for letter in b"rgb"},
    }
    directory, data = struct.pack(">I", len(tags)), b""
    places: dict[bytes, int] = {}
    for tag, content in tags.items():
        if content not in places:
            places[content] = 128 + 4 + 12 * len(tags) + len(data)
            data += content + bytes(-len(content) % 4)
        directory += tag + struct.pack(">II", places[content], len(content))
    size = 128 + len(directory) + len(data)
    header = struct.pack(">I4xI", size, 0x04300000) + b"mntrRGB XYZ " + bytes(12) + b"acsp"
    return (header + bytes(28) + _fixed(D50_XYZ)).ljust(128, b"\0") + directory + data


#: g, a, b, c and d of the curve of sRGB; IEC 61966-2-1:1999.
_SRGB_PARAMETERS = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


def _fixed(numbers: Iterable[float]) -> bytes:
    """As s15Fixed16Numbers."""
    stored = [round(float(number) * 65536) for number in numbers]
    return struct.pack(f">{len(stored)}i", *stored)


def _text(text: str) -> bytes:
    data = text.encode("utf-16-be")
    return b"mluc" + struct.pack(">4xII4sII", 1, 12, b"enUS", len(data), 28) + data


def _encoding(profile: bytes, grey: bool) -> ColorEncoding:
    tags = _tags(profile)
    space = profile[16:20]
    if space != b"RGB " and not (space == b"GRAY" and grey):
        name = space.decode("latin-1").strip().replace("GRAY", "grey")
        raise ValueError(f"of {name}, in {'a grey' if grey else 'an RGB'} picture")
    if profile[12:16] not in _CLASSES:
        raise ValueError("not of a device")
    # Where there are tables they go first (ICC.1:2022, 8.3), and a Lab space needs them.
    if tags.keys() & {b"A2B0", b"A2B1", b"D2B0"} or profile[20:24] != b"XYZ ":
        raise ValueError("made of tables")
    hdr = _hdr_transfer(tags)
    if hdr is not None:
        return ColorEncoding(hdr, REC709)
    if space == b"GRAY":
        return ColorEncoding(_curve(tags[b"kTRC"]), REC709)
    transfer = _transfer([tags[name] for name in (b"rTRC", b"gTRC", b"bTRC")])
    if grey and transfer.channels:
        raise ValueError("of RGB, in a grey picture")
    return ColorEncoding(transfer, _primaries(tags))


def _hdr_transfer(tags: dict[bytes, bytes]) -> Transfer | None:
    """PQ or HLG, of which the curves of a profile are an approximation. ICC.1:2022, 9.2.17."""
    tag = tags.get(b"cicp", b"")
    return HDR_TRANSFERS.get(tag[9]) if len(tag) >= 12 else None


def _tags(profile: bytes) -> dict[bytes, bytes]:
    if profile[36:40] != b"acsp":
        raise ValueError("damaged")
    (count,) = struct.unpack(">I", profile[128:132])
    entries = (
        struct.unpack(">4sII", profile[at : at + 12])
        for at in range(132, 132 + 12 * min(count, 100), 12)
    )
    return {name: profile[offset : offset + size] for name, offset, size in entries}


def _numbers(tag: bytes, count: int, at: int) -> Array:
    """So many s15Fixed16Numbers."""
    return np.array(struct.unpack_from(f">{count}i", tag, at)) / 65536


# --- primaries ------------------------------------------------------------------------------------


def _primaries(tags: dict[bytes, bytes]) -> Primaries:
    """Those of the colorants, in the white that the profile was made for."""
    colorants = np.array([_numbers(tags[name], 3, 8) for name in (b"rXYZ", b"gXYZ", b"bXYZ")])
    if np.abs(colorants - _SRGB_COLORANTS).max() <= _COLORANT_TOLERANCE:
        return REC709
    if b"chad" in tags:
        from_d50 = np.linalg.inv(_numbers(tags[b"chad"], 9, 8).reshape(3, 3))
        return _primaries_of(colorants, from_d50)
    # Without it Bradford's is usual, and the white may be told (version 2) or be D65 all the same.
    # Which it is changes the name of the primaries, not what becomes of colours.
    white = _white(tags)
    known = _primaries_under(colorants, _D65_XYZ)
    return known if known.name != "custom" else _primaries_under(colorants, white)


def _white(tags: dict[bytes, bytes]) -> XYZ:
    """The white that the profile tells, or D50."""
    x, y, z = _numbers(tags[b"wtpt"], 3, 8).tolist() if b"wtpt" in tags else D50_XYZ
    told = np.abs(np.subtract((x, y, z), D50_XYZ)).max() > _WHITE_TOLERANCE
    return (x, y, z) if told else D50_XYZ


def _primaries_under(colorants: Array, white: XYZ) -> Primaries:
    return _primaries_of(colorants, adaptation(D50_XYZ, white))


def _primaries_of(colorants: Array, from_d50: Array) -> Primaries:
    xyz = np.concatenate([colorants, [D50_XYZ]]) @ from_d50.T
    with np.errstate(all="ignore"):
        return primaries_from_xy(xyz[:, :2] / xyz.sum(axis=1, keepdims=True))


# --- curves ---------------------------------------------------------------------------------------


def _transfer(tags: list[bytes]) -> Transfer:
    """The curve of all channels, or one of each."""
    curves = {tag: _curve(tag) for tag in tags}
    red, green, blue = (curves[tag] for tag in tags)
    return red if red == green == blue else of_channels(red, green, blue)


def _curve(tag: bytes) -> Transfer:
    """One curve; `ValueError` where it is none of light. ICC.1:2022, 10.6 and 10.18."""
    curve = _stored_curve(tag)
    with np.errstate(all="ignore"):
        samples = curve.decode(_CURVE_SAMPLES)
    steps = np.diff(samples)
    if not (np.isfinite(samples).all() and steps.sum() > 0 and steps.min() >= -_CURVE_TOLERANCE):
        raise ValueError("not of rising curves")
    near_srgb = np.abs(samples - SRGB.decode(_CURVE_SAMPLES)).max() <= _CURVE_TOLERANCE
    return SRGB if near_srgb else curve


def _stored_curve(tag: bytes) -> Transfer:
    kind, count = tag[:4], struct.unpack(">I", tag[8:12])[0]
    if kind == b"curv":
        table = np.frombuffer(tag[12 : 12 + 2 * count], ">u2").astype(float)
        if len(table) != count:
            raise ValueError("damaged")
        if count == 0:
            return LINEAR
        if count == 1:
            return gamma(float(table[0]) / 256)
        places = np.linspace(0, 1, count)
        return mirrored(f"table of {count}", lambda value: np.interp(value, places, table / 65535))
    if kind == b"para" and count >> 16 < len(_PARAMETERS):
        function = count >> 16
        given = _numbers(tag, _PARAMETERS[function], 12).tolist()
        if function == 0:
            return gamma(given[0])
        defaults = [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        g, a, b, c, d, e, f = given + defaults[len(given) :]
        if function in (1, 2):  # its break is where the power begins: x = −b/a
            c, d, e, f = 0.0, -b / a, c, c
        return mirrored(
            f"parametric, gamma {g:.4g}",
            lambda x: np.where(x >= d, np.maximum(a * x + b, 0) ** g + e, c * x + f).clip(0),
        )
    raise ValueError("of unknown curves")


#: How many parameters each function of a parametric curve has.
_PARAMETERS = (1, 3, 4, 5, 7)
