"""One layer of a file: its samples as stored, strip by strip, and what they mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import OpenImageIO as oiio

from ..encoding import color_space
from ..errors import InputError, MismatchError, unknown_name
from ..geometry import Window
from ..samples import Decoding, Rgba, Samples, Strip, linear_rgba
from .description import Channel, ColorGroup, ImageFile, Part
from .door import error_text, open_input

NONFINITE_POLICIES = ("error", "zero", "keep")

#: Rows that are read at a time where the caller does not say: whole compression blocks, few calls.
STRIP_ROWS = 64

#: Of the sample types that files store.
_SAMPLE_BYTES = {"uint8": 1, "uint16": 2, "half": 2, "float": 4, "uint": 4}
#: Headers, offset tables and buffers of an open file.
_OPEN_FILE_BYTES = 1 << 17


class LayerReader:
    """One layer of a file, read in strips of rows.

    `alpha` is one of `encoding.ALPHA_MODES` or None for the format's own; `colorspace` a name of
    `encoding.COLOR_SPACES` or None for what the file says; `nonfinite` a policy on NaN and Inf:
    `error`, `zero` (such a pixel becomes transparent black), `keep`. `label` names it in errors.
    """

    def __init__(
        self,
        file: ImageFile,
        part: Part,
        group: ColorGroup,
        *,
        alpha: str | None = None,
        colorspace: str | None = None,
        nonfinite: str = "error",
        label: str | None = None,
    ) -> None:
        if nonfinite not in NONFINITE_POLICIES:
            raise unknown_name("nonfinite policy", nonfinite, NONFINITE_POLICIES)
        self.file, self.part, self.group = file, part, group
        self.label = label or file.path
        self.problems = () if colorspace else part.problems
        self.nonfinite = nonfinite
        self.zeroed_pixels = 0
        self.decoding = Decoding(
            color_space(colorspace) if colorspace else part.encoding,
            alpha or file.alpha_mode,
            stored_straight=file.alpha_mode == "straight",
            zero_nonfinite=nonfinite == "zero",
        )
        # Colour and alpha that stand together in one type are read at once, halves as they are.
        self._channels = (*group.color, *([group.alpha] if group.alpha else []))
        types = {channel.type for channel in self._channels}
        self._type = types.pop() if len(types) == 1 else "mixed"
        self._together = self._type not in ("mixed", "uint") and [
            channel.index for channel in self._channels
        ] == list(range(self._channels[0].index, self._channels[-1].index + 1))
        self._reader: Any = None

    @property
    def window(self) -> Window:
        """The pixels that there are, in the file's own coordinates."""
        return self.part.data_window

    @property
    def has_alpha(self) -> bool:
        return self.group.alpha is not None or self.decoding.alpha_mode == "luminance"

    @property
    def is_plain(self) -> bool:
        """Whether the kernel decodes this layer itself; numpy takes memory of its own."""
        integers = self.file.format == "png"
        return self.decoding.is_plain(np.empty(0, np.uint8 if integers else np.float32))

    @property
    def rows_at_once(self) -> int:
        """Rows that the codec decodes together; a picture that it holds whole asks for no more."""
        return 1 if self.part.interlaced else self.part.rows_per_block

    @property
    def bytes_per_row(self) -> int:
        """Memory of one row as it is read: its samples, and a copy where they must be gathered."""
        sample = _SAMPLE_BYTES.get(self._type, 4)
        copies = 1 if self._together and self.part.tile is None else 3
        return self.window.width * len(self._channels) * sample * copies

    @property
    def bytes_to_decode(self) -> int:
        """Memory of the codec while it decodes: one block of every channel, packed and unpacked."""
        block = self.part.rows_per_block * self._bytes_per_stored_row
        if self.part.interlaced:
            return 0
        return 3 * block if self.part.tile is None else 3 * block + 4 * block

    @property
    def bytes_held(self) -> int:
        """Memory of the codec as long as the file is open: a block, or all of an interlaced PNG."""
        block = self.part.rows_per_block * self._bytes_per_stored_row
        return _OPEN_FILE_BYTES + block + block // 16

    @property
    def _bytes_per_stored_row(self) -> int:
        return self.window.width * sum(_SAMPLE_BYTES.get(c.type, 4) for c in self.part.channels)

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def read_samples(self, begin: int, end: int) -> Samples:
        """Rows `begin` to `end` of the data window as stored, in the file's coordinates.

        Returns (rows, width, channels): Y, YA, RGB or RGBA; uint8 and uint16 of PNG, float16 and
        float32 of EXR, its uint channels as floats of the same value. Errors: `InputError`.
        """
        first, last = self._channels[0], self._channels[-1]
        if self._together:
            return self._read(first, last.index + 1, begin, end)
        planes = [self._read(c, c.index + 1, begin, end) for c in self._channels]
        if len({plane.dtype for plane in planes}) > 1:
            planes = [plane.astype(np.float32) for plane in planes]
        return np.concatenate(planes, axis=2)

    def read_rows(self, begin: int, end: int) -> Rgba:
        """The same rows as linear, premultiplied RGBA (rows, width, 4).

        Errors: also `MismatchError`, for NaN and Inf where the policy refuses them.
        """
        rgba, broken = linear_rgba(Strip(self.read_samples(begin, end), self.decoding))
        self.note_nonfinite(begin, broken)
        return rgba

    def note_nonfinite(self, begin: int, count: int) -> None:
        """Applies the policy to `count` pixels with NaN or Inf in rows from `begin` on."""
        if count and self.nonfinite == "error":
            raise self._nonfinite_error(begin)
        if self.nonfinite == "zero":
            self.zeroed_pixels += count

    def _nonfinite_error(self, begin: int) -> MismatchError:
        """Says where the first such pixel is and how many there are, from row `begin` on."""
        count, first = 0, ""
        for row in range(begin, self.window.bottom, STRIP_ROWS):
            samples = self.read_samples(row, min(row + STRIP_ROWS, self.window.bottom))
            broken = np.argwhere(~np.isfinite(samples).all(axis=2))
            if len(broken) and not count:
                first = f"{self.window.x + broken[0][1]},{row + broken[0][0]}"
            count += len(broken)
        pixels = "1 pixel is" if count == 1 else f"{count} pixels are"
        return MismatchError(
            f"{self.label}: {pixels} NaN or infinite, the first at {first}: "
            "--nonfinite zero or keep lets them pass"
        )

    def _read(self, first: Channel, stop: int, begin: int, end: int) -> Samples:
        if self._reader is None:
            self._reader = open_input(self.file.path, self.label)
        reader, index = self._reader, self.part.index
        # A uint32 read as a float would be divided by the largest uint32.
        if self.part.tile is None:
            pixels = reader.read_scanlines(
                index, 0, begin, end, 0, first.index, stop, oiio.TypeDesc(first.type)
            )
        else:
            pixels = self._tile_rows(first.index, stop, begin, end, first.type)
        if pixels is None:
            raise InputError(
                f"{self.label}: cannot be read, rows {begin} to {end - 1}: {error_text(reader)}"
            )
        pixels = pixels.reshape(end - begin, self.window.width, stop - first.index)
        return pixels.astype(np.float32) if first.type == "uint" else pixels

    def _tile_rows(self, first: int, stop: int, begin: int, end: int, wanted: str) -> Any:
        """Whole tiles around the rows, cut down to them; None where they do not decode."""
        assert self.part.tile is not None
        window, height = self.window, self.part.tile[1]
        top = window.y + (begin - window.y) // height * height
        bottom = min(window.bottom, window.y - (window.y - end) // height * height)
        tiles = self._reader.read_tiles(
            self.part.index, 0, window.x, window.right, top, bottom, 0, 1, first, stop,
            oiio.TypeDesc(wanted),
        )  # fmt: skip
        if tiles is None:
            return None
        tiles = tiles.reshape(bottom - top, window.width, stop - first)
        return np.ascontiguousarray(tiles[begin - top : end - top])


@dataclass(frozen=True)
class LayerImage:
    """The pixels of a layer: (height, width, 4) float32, linear Rec. 709, premultiplied."""

    pixels: Rgba
    data_window: Window
    display_window: Window
