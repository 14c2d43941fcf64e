"""What of a layer's samples does not come into the picture: noted while they are read, not changed.

Alphas that are held to 0 and 1, colours that an alpha of 0 hides, masks that cover next to nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from threading import Lock

import numpy as np

from ..color.primaries import to_xyz
from ..color.samples import Decoding, Samples
from ..geometry import Window

#: How far rounding takes an alpha beyond 0 or 1: one step of half-floats above 1.
_ROUNDING = 2.0**-10
#: The bits of 1 and that much, as unsigned numbers: of all floats that are greater, negative ones
#: and NaN among them, no other is looked at.
_BITS = {2: (np.uint16, 0x3C01), 4: (np.uint32, 0x3F802000)}
#: A filter with negative lobes goes no further beyond 0 and 1.
_OVERSHOOT = 0.25
#: A mask of integers whose largest is less than this share of white is hardly one of coverage.
_FAINT = 0.1
#: Pixels that are looked at together, so that it takes next to no memory.
_PIXELS = 1 << 16


class OutsideAlphas:
    """Alphas outside 0 to 1: how many, and from where to where. Any thread may add some."""

    def __init__(self) -> None:
        self.count, self._least, self._most = 0, 0.0, 1.0
        self._lock = Lock()

    def add(self, alphas: Samples) -> None:
        """Looks at alphas of any shape, float16 or float32; integers cannot lie outside."""
        if alphas.dtype.kind != "f" or not alphas.size:
            return
        kind, largest = _BITS[alphas.dtype.itemsize]
        bits = alphas.view(kind)
        if bits.max() <= largest:
            return
        suspects = alphas[bits > largest].astype(np.float32)
        # What is not finite is the matter of a policy of its own.
        suspects = suspects[np.isfinite(suspects)]
        outside = suspects[(suspects < -_ROUNDING) | (suspects > 1 + _ROUNDING)]
        if not len(outside):
            return
        with self._lock:
            self.count += len(outside)
            self._least = min(self._least, float(outside.min()))
            self._most = max(self._most, float(outside.max()))

    def in_words(self, one: str, value: str = "an alpha") -> str:
        """What to say of them; empty for none. `one`: what has such a value, such as "pixel"."""
        if not self.count:
            return ""
        have = f"1 {one} has" if self.count == 1 else f"{self.count} {one}s have"
        extent = f"{self._least:.6g} to {self._most:.6g}"
        what_next = (
            "filters that sharpen leave such values; box and triangle filters leave none"
            if self._least > -_OVERSHOOT and self._most < 1 + _OVERSHOOT
            else "divide it first if it has another scale"
        )
        return f"{have} {value} outside 0 to 1, from {extent}, held to 0 and 1: {what_next}"


class Unseen:
    """What the samples of one layer show while they are read by rows, each row once.

    `straight_is_meant`: whether its user says that its alpha is straight, so that it may hide
    colours. `alone`: whether nothing else is in the picture, which then has nothing where they are.
    """

    def __init__(self, decoding: Decoding, window: Window, straight_is_meant: bool = False) -> None:
        self._decoding, self._window = decoding, window
        self._may_hide = decoding.alpha_mode == "straight" and not straight_is_meant
        self._next_row = window.y
        self._gaps = False
        self.alone = False
        self.alphas = OutsideAlphas()
        self._visible = False
        self._hidden = _Spread()
        self._hidden_light = 0
        self._largest = 0
        self._white = 0

    def look(self, begin: int, samples: Samples) -> None:
        """At rows from `begin` on; those that were seen before are passed over."""
        seen = max(0, self._next_row - begin)
        self._gaps |= begin > self._next_row
        samples = samples[seen:]
        if not len(samples):
            return
        self._next_row = begin + seen + len(samples)
        at_once = max(1, _PIXELS // samples.shape[1])
        for first in range(0, len(samples), at_once):
            self._look(samples[first : first + at_once])

    def _look(self, samples: Samples) -> None:
        decoding, channels = self._decoding, samples.shape[2]
        alpha = samples[..., -1] if channels % 2 == 0 else None
        color = samples[..., : channels - 1] if alpha is not None else samples
        by_value = decoding.tint is not None or decoding.alpha_mode == "luminance"
        if by_value and samples.dtype.kind == "u":
            self._white = int(np.iinfo(samples.dtype).max)
            self._largest = max(self._largest, int(color.max()))
        if by_value and (decoding.alpha_mode != "luminance" or channels == 1):
            self.alphas.add(samples[..., 0])
        elif by_value and channels == 3 and samples.dtype.kind == "f":
            weights = np.array(to_xyz(decoding.encoding.primaries)[1], np.float32)
            self.alphas.add(samples.astype(np.float32) @ weights)
        elif alpha is not None and not _all_held(samples):
            self.alphas.add(alpha)
        if alpha is None:
            return
        if decoding.loses_light_without_alpha:
            self._hidden_light += int(np.count_nonzero(color[alpha == 0].any(axis=-1)))
        elif self._may_hide and (self.alone or not self._visible):
            self._visible = self._visible or bool(alpha.any())
            if self.alone or not self._visible:
                self._hidden.add(color[alpha == 0])

    def in_words(self) -> Iterator[str]:
        """What to say behind the label of the layer, once its rows are read."""
        by_value = self._decoding.tint is not None or self._decoding.alpha_mode == "luminance"
        alphas = self.alphas.in_words("pixel", "a value" if by_value else "an alpha")
        if alphas:
            yield alphas
        if self._hidden_light:
            yield (
                f"{_pixels(self._hidden_light)} light and an alpha of 0, which "
                f"alpha={self._decoding.alpha_mode} cannot keep: alpha=premultiplied does"
            )
        if self._gaps or self._next_row < self._window.bottom:
            return  # of the rows that were not read nothing is known
        if 0 < self._largest < _FAINT * self._white:
            yield (
                f"its largest value is {self._largest} of {self._white}, so that it covers next "
                f"to nothing: if these are numbers of classes, make a mask of each one first, with "
                f"{self._white} inside"
            )
        if self._hidden.varies:
            what = _pixels(self._hidden.count)
            if not self._visible:
                yield (
                    "its alpha is 0 everywhere, so that none of its colours is seen: write it "
                    "without the alpha, or say alpha=straight"
                )
            elif self.alone:
                yield (
                    f"{what} colours under an alpha of 0, which are lost: write them without the "
                    "alpha, or say alpha=straight"
                )


def _all_held(samples: Samples) -> bool:
    """Whether no alpha of RGBA in half-floats is outside 0 to 1; False if another look is needed.

    A pixel is one number of 64 bits, of which alpha is the top: that takes a third of the time.
    """
    pixels = samples.dtype == np.float16 and samples.shape[2] == 4 and samples.flags.c_contiguous
    if not pixels or sys.byteorder != "little":
        return False
    return int(samples.view(np.uint64).max()) >> 48 <= _BITS[2][1]


class _Spread:
    """Colours that an alpha of 0 hides: one colour all over is filling, several are a picture."""

    def __init__(self) -> None:
        self.count = 0
        self._first: Samples | None = None
        self.varies = False

    def add(self, colors: Samples) -> None:
        """Colours (n, channels)."""
        if not len(colors):
            return
        self.count += len(colors)
        if self._first is None:
            self._first = colors[0].copy()
        self.varies = self.varies or bool((colors != self._first).any())


def _pixels(count: int) -> str:
    return "1 pixel has" if count == 1 else f"{count} pixels have"
