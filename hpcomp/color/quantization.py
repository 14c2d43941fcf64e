"""Composited light to the numbers that a file holds, and what is lost on the way. No files here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .gamut import into_gamut
from .spaces import DEFAULT_SPACE, Space, space
from .transfer import SRGB, encode_srgb

Array = NDArray[np.floating[Any]]
Float64 = NDArray[np.float64]

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
    codes_space: Space | None = None,
) -> NDArray[np.unsignedinteger[Any]]:
    """Rounded code values on the sRGB curve, straight, as many as `code_type` has.

    `rgba`: (…, 4), linear, premultiplied, alpha in [0, 1]. Losses are counted.
    Colours outside the gamut by more than half a code value move towards the grey of their own
    luminance, so luminance stays, and hue in `codes_space`, which is of the gamut's primaries and
    by default the paper's; above white they become white, below black black.
    """
    codes_space = codes_space or space(DEFAULT_SPACE)
    flat = rgba.reshape(-1, 4)
    codes = np.empty(flat.shape, code_type)
    for begin in range(0, len(flat), _ENCODED_PIXELS):
        block = slice(begin, begin + _ENCODED_PIXELS)
        codes[block] = _straight_srgb_codes(
            flat[block], int(np.iinfo(code_type).max), losses, codes_space
        )
    return codes.reshape(rgba.shape)


#: Pixels that are encoded at a time: in doubles, so that ties round as they should, and in cache.
_ENCODED_PIXELS = 1 << 14


def _straight_srgb_codes(rgba: Array, largest: int, losses: Losses, codes_space: Space) -> Float64:
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
        straight[outside] = into_gamut(straight[outside], codes_space)
    np.rint(encode_srgb(np.clip(straight, 0, 1)) * largest, out=codes[:, :3])
    return codes


def to_half_range(rgba: Array, losses: Losses) -> Array:
    """`rgba` (…, 4) with colours beyond what a half-float holds made darker, and counted.

    All three channels are scaled alike, so that hue and saturation stay in every space. What is
    not finite stays as it is.
    """
    rgb = rgba[..., :3]
    size = np.abs(np.where(np.isfinite(rgb), rgb, 0)).max(axis=-1)
    beyond = size > LARGEST_HALF
    if not beyond.any():
        return rgba
    losses.beyond_half += int(beyond.sum())
    scaled = rgba.copy()
    factor = (LARGEST_HALF / size[beyond]).astype(rgba.dtype)[:, None]
    scaled[beyond, :3] *= factor
    return scaled
