"""Strips of stored samples, and numpy's way between them and linear RGBA. No blending, no files."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import Window
from ..records import record
from . import spaces
from .encodings import LINEAR_REC709, ColorEncoding
from .primaries import REC709, Primaries, converted, to_xyz
from .quantization import Losses, to_half_range, to_straight_srgb
from .spaces import DEFAULT_SPACE
from .transfer import LINEAR, decode_table

Rgba = NDArray[np.float32]
Samples = NDArray[Any]

#: The types of an output's samples.
OUTPUT_TYPES: dict[str, type[np.generic]] = {
    "uint8": np.uint8,
    "uint16": np.uint16,
    "half": np.float16,
    "float": np.float32,
}


@record
class Decoding:
    """What stored samples mean: curve and primaries, and how alpha relates to colour.

    `working`: the primaries that they are wanted in.
    `alpha_mode` is one of `encodings.ALPHA_MODES`; `stored_straight` says whether `luminance` finds
    straight colours in the file; `zero_nonfinite` makes pixels with NaN or Inf transparent.
    `tint`: straight linear Rec. 709 colour of a mask, Y or YA, whose stored values are its alpha.
    """

    encoding: ColorEncoding
    alpha_mode: str
    stored_straight: bool
    zero_nonfinite: bool = False
    tint: tuple[float, float, float] | None = None
    working: Primaries = REC709

    @property
    def loses_light_without_alpha(self) -> bool:
        """Whether colours are divided by their alpha, so that none is left where it is 0."""
        return self.tint is None and (
            self.alpha_mode == "premultiplied-encoded"
            or (self.alpha_mode == "luminance" and not self.stored_straight)
        )

    def is_plain(self, samples: Samples) -> bool:
        """Whether one table or nothing is between these samples and linear light, times alpha."""
        return (
            self.tint is None
            and self.alpha_mode in ("straight", "premultiplied")
            and (
                self.encoding.transfer is LINEAR
                if samples.dtype.kind != "u"
                else not self.encoding.transfer.channels
            )
        )


#: Linear, premultiplied, and in the working primaries, whichever they are: what `decode` gives and
#: arrays in the API are.
PLAIN = Decoding(LINEAR_REC709, "premultiplied", stored_straight=False)


@record
class Strip:
    """Rows of a layer where they lie in a strip of the canvas, transparent around them.

    `samples`: (rows, columns, channels), channels being Y, YA, RGB or RGBA; uint8, uint16, float16
    or float32. `left`, `top`: of its first sample, in pixels of the canvas strip; may be negative.
    """

    samples: Samples
    decoding: Decoding = PLAIN
    left: int = 0
    top: int = 0


#: A layer without pixels in a strip: transparent all over.
NOTHING = Strip(np.zeros((0, 0, 4), np.float32))


def decode(samples: Samples, decoding: Decoding) -> Rgba:
    """Stored samples (rows, columns, channels) as linear, premultiplied RGBA, alpha in [0, 1].

    NaN comes through, and infinite colours.
    """
    if decoding.tint is not None:
        return _tinted(samples, decoding, decoding.tint)
    channels = samples.shape[2]
    stored_color = samples[..., : 1 if channels <= 2 else 3]
    rgba = np.empty((*samples.shape[:2], 4), np.float32)
    rgb, alpha = rgba[..., :3], rgba[..., 3]
    with np.errstate(invalid="ignore", over="ignore"):
        alpha[:] = 1
        if channels % 2 == 0:
            np.clip(_as_float(samples[..., -1]), 0, 1, out=alpha)
        if decoding.alpha_mode == "premultiplied-encoded" and channels % 2 == 0:
            rgb[:] = _linear(_divided(_as_float(stored_color), alpha), decoding)
            rgb *= alpha[..., None]
        else:
            rgb[:] = _linear(stored_color, decoding)
        if decoding.alpha_mode == "straight" and channels % 2 == 0:
            rgb *= alpha[..., None]
        elif decoding.alpha_mode == "luminance":
            _alpha_from_luminance(rgb, alpha, decoding)
    return rgba


def _tinted(samples: Samples, decoding: Decoding, tint: tuple[float, float, float]) -> Rgba:
    """A mask, Y or YA, in one colour: the alpha is its value as stored, or its light, times alpha.

    Stored values are coverage: 128 of 255 covers half, whatever curve the file names.
    """
    by_light = decoding.alpha_mode == "luminance"
    straight = decoding.stored_straight if by_light else decoding.alpha_mode == "straight"
    value = samples[..., :1]
    rgba = np.empty((*samples.shape[:2], 4), np.float32)
    alpha = rgba[..., 3]
    with np.errstate(invalid="ignore", over="ignore"):
        coverage = _linear(value, decoding) if by_light else _as_float(value)
        np.clip(coverage[..., 0], 0, 1, out=alpha)
        if samples.shape[2] == 2 and straight:
            alpha *= np.clip(_as_float(samples[..., 1]), 0, 1)
        color = converted(np.array(tint), REC709, decoding.working)
        rgba[..., :3] = alpha[..., None] * color.astype(np.float32)
    return rgba


def linear_rgba(strip: Strip) -> tuple[Rgba, int]:
    """`decode` of a strip, and how many of its pixels are stored with NaN or Inf.

    Those become transparent black where its decoding says so; every alpha but NaN is in [0, 1].
    """
    broken = nonfinite_pixels(strip.samples)
    if strip.samples.dtype == np.float64:  # arrays of the API, never files
        rgba = strip.samples.copy()
        np.clip(rgba[..., 3], 0, 1, out=rgba[..., 3])
    else:
        rgba = decode(strip.samples, strip.decoding)
    if broken is not None and strip.decoding.zero_nonfinite:
        rgba[broken] = 0
    return rgba, 0 if broken is None else int(broken.sum())


def nonfinite_pixels(samples: Samples) -> NDArray[np.bool_] | None:
    """Which pixels (rows, columns) are stored with NaN or Inf; None where none is."""
    if samples.dtype.kind != "f":
        return None
    finite = np.isfinite(samples)
    return None if finite.all() else np.asarray(~finite.all(axis=-1))


def cropped(strip: Strip, width: int, height: int) -> Strip:
    """What of `strip` lies on its canvas strip; the samples are a view."""
    rows, columns = strip.samples.shape[:2]
    top, left = max(strip.top, 0), max(strip.left, 0)
    bottom, right = min(strip.top + rows, height), min(strip.left + columns, width)
    if top >= bottom or left >= right:
        return replace(strip, samples=strip.samples[:0, :0], left=0, top=0)
    inside = strip.samples[
        top - strip.top : bottom - strip.top, left - strip.left : right - strip.left
    ]
    return replace(strip, samples=inside, left=left, top=top)


def part_of(strip: Strip, part: Window) -> Strip:
    """What of `strip` lies on that part of its canvas strip, and where on it; as `cropped`."""
    moved = replace(strip, left=strip.left - part.x, top=strip.top - part.y)
    return cropped(moved, part.width, part.height)


def spread(rgba: Rgba, left: int, top: int, width: int, height: int) -> Rgba:
    """(height · width, 4): pixels at their place on a canvas strip, transparent elsewhere."""
    rows, columns = rgba.shape[:2]
    if (columns, rows) == (width, height):
        return rgba.reshape(-1, 4)
    whole = np.zeros((height, width, 4), rgba.dtype)
    whole[top : top + rows, left : left + columns] = rgba
    return whole.reshape(-1, 4)


def encode(
    rgba: Rgba,
    kind: str,
    losses: Losses,
    working: Primaries = REC709,
    gamut: Primaries = REC709,
    space_name: str = DEFAULT_SPACE,
) -> Samples:
    """RGBA (…, 4) as samples of an output: straight codes, or linear premultiplied floats.

    `kind` is one of `OUTPUT_TYPES`; anything else leaves the RGBA as it is. `working`: primaries of
    the RGBA, and `gamut` those of codes, which have the curve of sRGB; floats stay in `working`.
    Codes keep the hues that the space of that name has.
    """
    if kind in ("uint8", "uint16"):
        if working != gamut:
            rgb = converted(rgba[..., :3], working, gamut)
            rgba = np.concatenate([rgb, rgba[..., 3:]], axis=-1)
        codes_space = spaces.space(space_name, to_xyz(gamut))
        code_type = np.uint8 if kind == "uint8" else np.uint16
        return to_straight_srgb(rgba, code_type, losses, codes_space)
    if kind == "half":
        return to_half_range(rgba, losses).astype(np.float16)
    return rgba


def _linear(stored: Samples, decoding: Decoding) -> Rgba:
    """Stored colour (…, 1 or 3) as linear RGB (…, 3, or 1 to be spread over 3)."""
    transfer = decoding.encoding.transfer
    if stored.dtype.kind == "u":
        largest = int(np.iinfo(stored.dtype).max)
        if transfer.channels:
            linear = np.empty_like(stored, np.float32)
            for channel, curve in enumerate(transfer.channels):
                linear[..., channel] = decode_table(curve, largest)[stored[..., channel]]
        else:
            linear = decode_table(transfer, largest)[stored]
    elif transfer is LINEAR:
        linear = stored.astype(np.float32, copy=False)
    else:
        linear = transfer.decode(stored.astype(np.float64)).astype(np.float32)
    if linear.shape[-1] == 1:
        return linear  # a grey is the same grey in all primaries
    return converted(linear, decoding.encoding.primaries, decoding.working)


def _alpha_from_luminance(rgb: Rgba, alpha: Rgba, decoding: Decoding) -> None:
    """Makes the alpha of the straight colours their luminance times the file's alpha."""
    if not decoding.stored_straight:
        rgb[:] = _divided(rgb, alpha)
    w_red, w_green, w_blue = to_xyz(decoding.working)[1]
    luminance = w_red * rgb[..., 0] + w_green * rgb[..., 1] + w_blue * rgb[..., 2]
    alpha *= np.clip(luminance, 0, 1)
    rgb *= alpha[..., None]


def _as_float(stored: Samples) -> Rgba:
    """Stored values with 1.0 as white: integers by their largest, floats as they are."""
    if stored.dtype.kind != "u":
        return stored.astype(np.float32, copy=False)
    return (stored / np.float32(np.iinfo(stored.dtype).max)).astype(np.float32)


def _divided(rgb: Rgba, alpha: Rgba) -> Rgba:
    """rgb / alpha; where alpha is 0, 0 for what is finite and NaN for what is not."""
    quotient = rgb * np.float32(0)
    return np.divide(rgb, alpha[..., None], out=quotient, where=alpha[..., None] > 0)
