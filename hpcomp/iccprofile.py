"""Reads what hpcomp needs of an ICC profile: its name, and whether it is sRGB."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from .encoding import SRGB

#: Colorants of sRGB adapted to the D50 connection space; IEC 61966-2-1 through Bradford.
_SRGB_COLORANTS = np.array(
    [[0.4361, 0.2225, 0.0139], [0.3851, 0.7169, 0.0971], [0.1431, 0.0606, 0.7141]]
)
#: Published sRGB profiles differ by up to this much in a colorant, and in their tabulated curve.
_COLORANT_TOLERANCE = 2e-3
_CURVE_TOLERANCE = 3e-3
_CURVE_SAMPLES = np.linspace(0, 1, 65)


def is_srgb(profile: bytes) -> bool:
    """Whether a matrix/TRC profile has the primaries and the curve of sRGB."""
    try:
        tags = _tags(profile)
        colorants = np.array([_xyz(tags[name]) for name in (b"rXYZ", b"gXYZ", b"bXYZ")])
        curves = np.array([_curve(tags[name]) for name in (b"rTRC", b"gTRC", b"bTRC")])
    except (KeyError, struct.error, ValueError, ArithmeticError):
        return False
    return bool(
        np.abs(colorants - _SRGB_COLORANTS).max() <= _COLORANT_TOLERANCE
        and np.abs(curves - SRGB.decode(_CURVE_SAMPLES)).max() <= _CURVE_TOLERANCE
    )


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


def _tags(profile: bytes) -> dict[bytes, bytes]:
    if profile[36:40] != b"acsp":
        raise ValueError("not an ICC profile")
    (count,) = struct.unpack(">I", profile[128:132])
    entries = (
        struct.unpack(">4sII", profile[at : at + 12])
        for at in range(132, 132 + 12 * min(count, 100), 12)
    )
    return {name: profile[offset : offset + size] for name, offset, size in entries}


def _xyz(tag: bytes) -> tuple[float, ...]:
    return tuple(value / 65536 for value in struct.unpack(">3i", tag[8:20]))


def _curve(tag: bytes) -> NDArray[np.float64]:
    """The curve at `_CURVE_SAMPLES`. ICC.1:2022, 10.6 and 10.18."""
    x = _CURVE_SAMPLES
    kind, count = tag[:4], struct.unpack(">I", tag[8:12])[0]
    if kind == b"curv":
        table = np.frombuffer(tag[12 : 12 + 2 * count], ">u2").astype(float)
        if len(table) != count:
            raise ValueError("curve table cut short")
        if count == 0:
            return x
        if count == 1:
            return x ** (table[0] / 256)
        return np.interp(x, np.linspace(0, 1, count), table / 65535)
    if kind == b"para":
        function = count >> 16
        n_parameters = (1, 3, 4, 5, 7)[function] if function < 5 else 0
        parameters = [v / 65536 for v in struct.unpack_from(f">{n_parameters}i", tag, 12)]
        defaults = [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        g, a, b, c, d, e, f = parameters + defaults[n_parameters:]
        if function in (1, 2):  # its break is where the power begins: x = −b/a
            c, d, e, f = 0.0, -b / a, c, c
        power = np.maximum(a * x + b, 0) ** g + e
        return np.where(x >= d, power, c * x + f)
    raise ValueError("unknown curve type")
