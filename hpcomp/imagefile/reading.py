"""One layer of a file: its samples as stored, strip by strip, and what they mean. No canvas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..color.primaries import Primaries
from ..color.samples import Rgba, Samples, Strip, linear_rgba
from ..errors import MismatchError
from ..geometry import Window
from ..records import record
from .interpretation import AS_STORED, Interpretation
from .omissions import omissions
from .parts import ColorGroup, ImageFile, Part
from .source import source_of
from .unseen import Unseen

#: Rows that are read at a time where the caller does not say: whole compression blocks, few calls.
STRIP_ROWS = 64


class LayerReader:
    """One layer of a file, read in strips of rows.

    `label` names it in errors; the path of the file if not given.
    Errors: `SettingError`, `InputError` for colours that cannot be read.
    """

    def __init__(
        self,
        file: ImageFile,
        part: Part,
        group: ColorGroup,
        interpretation: Interpretation = AS_STORED,
        label: str | None = None,
    ) -> None:
        self.file, self.part, self.group = file, part, group
        self.label = label or file.path
        self.problems = interpretation.problems_of(part, self.label)
        self.omissions = interpretation.unanswered(omissions(file, part, group))
        self.nonfinite = interpretation.nonfinite
        self.zeroed_pixels = 0
        self.decoding = interpretation.decoding_of(file, part)
        channels = (*group.color, *([group.alpha] if group.alpha else []))
        self.unseen = Unseen(self.decoding, self.window, "alpha" in interpretation.given)
        self._source = source_of(file, part, channels, self.label)

    @property
    def window(self) -> Window:
        """The pixels that there are, in the file's own coordinates."""
        return self.part.data_window

    @property
    def has_alpha(self) -> bool:
        return (
            self.group.alpha is not None
            or self.decoding.alpha_mode == "luminance"
            or self.decoding.tint is not None
        )

    @property
    def by_openimageio(self) -> bool:
        """Whether OpenImageIO reads it."""
        return self._source.by_openimageio

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
        """Memory of one row as it is read."""
        return self._source.bytes_per_row

    @property
    def bytes_to_decode(self) -> int:
        """Memory of the codec while it decodes."""
        return self._source.bytes_to_decode

    @property
    def bytes_held(self) -> int:
        """Memory of the codec as long as the file is open."""
        return self._source.bytes_held

    def work_in(self, primaries: Primaries) -> None:
        """Decodes into these primaries from now on, instead of into Rec. 709."""
        self.decoding = replace(self.decoding, working=primaries)

    def close(self) -> None:
        """Gives back what is open; it is opened again where it is read again."""
        self._source.close()

    def read_samples(self, begin: int, end: int) -> Samples:
        """Rows `begin` to `end` of the data window as stored, in the file's coordinates.

        Returns (rows, width, channels): Y, YA, RGB or RGBA; uint8 and uint16 of PNG, float16 and
        float32 of EXR, its uint channels as floats of the same value; of a mask Y or YA.
        Errors: `InputError`; `MismatchError` for a mask that is not grey.
        """
        samples = self._source.read(begin, end)
        if self.decoding.tint is not None and samples.shape[2] >= 3:
            samples = self._grey(samples, begin)
        self.unseen.look(begin, samples)
        return samples

    def _grey(self, samples: Samples, begin: int) -> Samples:
        """Y or YA of RGB or RGBA whose colours are grey: any channel, and NaN if one is."""
        red, green, blue = np.moveaxis(samples[..., :3], -1, 0)
        colored = (red != green) | (red != blue)
        if samples.dtype.kind == "f":
            with np.errstate(invalid="ignore"):
                red = red + 0 * green + 0 * blue
            colored &= np.isfinite(red)
        if colored.any():
            row, column = np.argwhere(colored)[0]
            raise MismatchError(
                f"{self.label}: tint= is for grey masks, and pixel "
                f"{self.window.x + column},{begin + row} has a colour of its own: leave tint= out, "
                "or make a grey mask of the file first"
            )
        return np.concatenate([red[..., None], samples[..., 3:]], axis=2)

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


@record
class LayerImage:
    """The pixels of a layer: (height, width, 4) float32, linear, premultiplied, Rec. 709 unless
    other primaries were asked for.
    """

    pixels: Rgba
    data_window: Window
    display_window: Window
