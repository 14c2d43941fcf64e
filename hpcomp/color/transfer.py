"""Transfer curves: stored values to linear light and back. No primaries, no alpha, no files."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from ..errors import SettingError
from ..records import record

Float64 = NDArray[np.float64]


@record
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
