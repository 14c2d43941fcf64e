"""One layer of a file, decoded to linear light strip by strip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from ..encoding import LINEAR, color_space, decode_table, to_rec709
from ..errors import InputError, MismatchError, unknown_name
from ..geometry import Window
from ..spaces import REC709_WEIGHTS
from .description import Channel, ColorGroup, ImageFile, Part
from .library import error_text, open_input

Rgba = NDArray[np.float32]

NONFINITE_POLICIES = ("error", "zero", "keep")

#: Rows that are read at a time where the caller does not say: whole compression blocks, few calls.
STRIP_ROWS = 64

#: Of the sample types that files store.
_SAMPLE_BYTES = {"uint8": 1, "uint16": 2, "half": 2, "float": 4, "uint": 4}
#: A pixel while it is decoded: four stored floats, RGBA, linear colours, and a mask.
_DECODED_BYTES = 16 + 16 + 12 + 4
#: Headers, offset tables and buffers of an open file.
_OPEN_FILE_BYTES = 1 << 17


class LayerReader:
    """One layer of a file, read in strips as linear Rec. 709, premultiplied float32 RGBA.

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
        self.encoding = color_space(colorspace) if colorspace else part.encoding
        self.problems = () if colorspace else part.problems
        self.alpha_mode = alpha or file.alpha_mode
        self.nonfinite = nonfinite
        self.zeroed_pixels = 0
        self._matrix = to_rec709(self.encoding.primaries)
        self._reader: Any = None

    @property
    def window(self) -> Window:
        """The pixels that there are, in the file's own coordinates."""
        return self.part.data_window

    @property
    def has_alpha(self) -> bool:
        return self.group.alpha is not None or self.alpha_mode == "luminance"

    @property
    def bytes_per_row(self) -> int:
        """Memory to decode one row into RGBA: as stored, as floats, and as the result."""
        return self.window.width * _DECODED_BYTES

    @property
    def bytes_to_decode(self) -> int:
        """Memory of the codec while it decodes: one block of every channel, packed and unpacked."""
        block = self.part.rows_per_block * self._bytes_per_stored_row
        if self.part.interlaced:
            return 0
        return 3 * block if self.part.tile is None else 3 * block + 4 * block

    @property
    def bytes_held(self) -> int:
        """Memory of the codec as long as the file is open: all of an interlaced PNG."""
        rows = self.part.rows_per_block if self.part.interlaced else 1
        return _OPEN_FILE_BYTES + rows * self._bytes_per_stored_row

    @property
    def _bytes_per_stored_row(self) -> int:
        return self.window.width * sum(_SAMPLE_BYTES.get(c.type, 4) for c in self.part.channels)

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def read_rows(self, begin: int, end: int) -> Rgba:
        """Rows `begin` to `end` of the data window, in the file's coordinates.

        Returns (rows, width, 4). Errors: `InputError` where they do not decode, `MismatchError`
        for a value that is not finite, where the policy says so.
        """
        rgba = self._decoded(begin, end)
        if self.nonfinite != "keep" and not np.isfinite(rgba).all():
            broken = np.any(~np.isfinite(rgba), axis=2)
            if self.nonfinite == "error":
                raise self._nonfinite_error(begin, broken)
            rgba[broken] = 0
            self.zeroed_pixels += int(broken.sum())
        elif self.nonfinite == "keep":
            np.clip(rgba[..., 3], 0, 1, out=rgba[..., 3])
        return rgba

    def _nonfinite_error(self, begin: int, broken: NDArray[np.bool_]) -> MismatchError:
        y, x = np.argwhere(broken)[0]
        count = int(broken.sum())
        for row in range(begin + len(broken), self.window.bottom, STRIP_ROWS):
            rest = self._decoded(row, min(row + STRIP_ROWS, self.window.bottom))
            count += int((~np.isfinite(rest).all(axis=2)).sum())
        pixels = "1 pixel is" if count == 1 else f"{count} pixels are"
        return MismatchError(
            f"{self.label}: {pixels} NaN or infinite, the first at "
            f"{self.window.x + x},{begin + y}: --nonfinite zero or keep lets them pass"
        )

    def _decoded(self, begin: int, end: int) -> Rgba:
        """Linear, premultiplied, alpha clamped; NaN and Inf as they come."""
        rgba = np.empty((end - begin, self.window.width, 4), np.float32)
        rgb, alpha = rgba[..., :3], rgba[..., 3]
        stored_alpha = self.group.alpha
        with np.errstate(invalid="ignore", over="ignore"):
            color = self._stored(self.group.color, begin, end)
            if stored_alpha is None:
                alpha[:] = 1
            else:
                stored = _as_float(self._stored([stored_alpha], begin, end)[..., 0])
                # Infinities stay as they are until the policy on them has been asked.
                alpha[:] = np.where(np.isinf(stored), stored, np.clip(stored, 0, 1))
            if self.alpha_mode == "premultiplied-encoded" and stored_alpha is not None:
                rgb[:] = self._linear(_divided(_as_float(color), alpha))
                rgb *= alpha[..., None]
            else:
                rgb[:] = self._linear(color)
            if self.alpha_mode == "straight" and stored_alpha is not None:
                rgb *= alpha[..., None]
            elif self.alpha_mode == "luminance":
                self._alpha_from_luminance(rgb, alpha)
        return rgba

    def _alpha_from_luminance(self, rgb: Rgba, alpha: Rgba) -> None:
        """Makes the alpha of the straight colours their luminance times the file's alpha."""
        if self.file.alpha_mode == "premultiplied":
            rgb[:] = _divided(rgb, alpha)
        w_red, w_green, w_blue = REC709_WEIGHTS
        luminance = w_red * rgb[..., 0] + w_green * rgb[..., 1] + w_blue * rgb[..., 2]
        alpha *= np.clip(luminance, 0, 1)
        rgb *= alpha[..., None]

    def _linear(self, stored: NDArray[Any]) -> Rgba:
        """Stored colour values (…, 1 or 3) as linear Rec. 709 (…, 3 or 1 to be spread over 3)."""
        transfer = self.encoding.transfer
        if stored.dtype.kind == "u" and stored.dtype.itemsize <= 2:
            linear = decode_table(transfer, int(np.iinfo(stored.dtype).max))[stored]
        elif transfer is LINEAR:
            linear = stored
        else:
            linear = transfer.decode(stored.astype(np.float64)).astype(np.float32)
        if self._matrix is None or linear.shape[-1] == 1:
            return linear  # a grey is the same grey in all primaries
        planes = np.moveaxis(linear, -1, 0)
        return np.stack(
            [
                sum(float(m) * plane for m, plane in zip(row, planes, strict=True))
                for row in self._matrix
            ],
            axis=-1,
        )

    def _stored(self, channels: Sequence[Channel], begin: int, end: int) -> NDArray[Any]:
        """Channels as stored, (rows, width, channels): uint8 or uint16 of PNG, float32 of EXR."""
        first, last = channels[0], channels[-1]
        together = [c.index for c in channels] == list(range(first.index, last.index + 1))
        if together and len({c.type for c in channels}) == 1:
            return self._native(first, last.index + 1, begin, end)
        planes = [self._native(c, c.index + 1, begin, end) for c in channels]
        return np.concatenate(planes, axis=2)

    def _native(self, first: Channel, stop: int, begin: int, end: int) -> NDArray[Any]:
        if self._reader is None:
            self._reader = open_input(self.file.path, self.label)
        reader, index = self._reader, self.part.index
        # uint32 is read as it is and never normalised; halves are widened while they decode.
        wanted = first.type if first.type in ("uint8", "uint16", "uint") else "float"
        if self.part.tile is None:
            pixels = reader.read_scanlines(
                index, 0, begin, end, 0, first.index, stop, oiio.TypeDesc(wanted)
            )
        else:
            pixels = self._tile_rows(first.index, stop, begin, end, wanted)
        if pixels is None:
            raise InputError(
                f"{self.label}: cannot be read, rows {begin} to {end - 1}: {error_text(reader)}"
            )
        pixels = pixels.reshape(end - begin, self.window.width, stop - first.index)
        return pixels.astype(np.float32) if wanted == "uint" else pixels

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


def _as_float(stored: NDArray[Any]) -> Rgba:
    """Stored values with 1.0 as white: integers of a PNG by their largest, floats as they are."""
    if stored.dtype.kind != "u":
        return stored
    return (stored / np.float32(np.iinfo(stored.dtype).max)).astype(np.float32)


def _divided(rgb: Rgba, alpha: Rgba) -> Rgba:
    """rgb / alpha; where alpha is 0, 0 for what is finite and NaN for what is not."""
    quotient = rgb * np.float32(0)
    return np.divide(rgb, alpha[..., None], out=quotient, where=alpha[..., None] > 0)


@dataclass(frozen=True)
class LayerImage:
    """The pixels of a layer: (height, width, 4) float32, linear Rec. 709, premultiplied."""

    pixels: Rgba
    data_window: Window
    display_window: Window
