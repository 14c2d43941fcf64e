"""One deep image of a file: samples, strip by strip, as linear colours and depths. No canvas."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..blending.deepsamples import DeepSamples
from ..color.primaries import Primaries
from ..color.samples import decode
from ..errors import InputError, MismatchError
from ..geometry import Window
from .deepchunks import COMPRESSIONS, DeepChunks, DeepCounts, layout_of
from .description import describe
from .interpretation import AS_STORED, Interpretation
from .omissions import omissions
from .parts import ColorGroup, ImageFile, Part, choose, deep_channel_names
from .rawfile import RawFile
from .seekable import temporary
from .unseen import OutsideAlphas

log = logging.getLogger("hpcomp")


@contextlib.contextmanager
def open_deep(
    path: str,
    *,
    part: str | None,
    layer: str | None,
    interpretation: Interpretation = AS_STORED,
    check: Callable[[Part], None],
    label: str,
) -> Iterator[DeepReader]:
    """The reader of that part and layer, as `choose` and `DeepReader` have it.

    `check` refuses a part before any of its samples is looked at.
    What is packed in another way than is read here is repacked first, into a temporary file.
    """
    with contextlib.ExitStack() as opened:
        file = describe(path, label)
        chosen, group = choose(file, part=part, layer=layer, deep=True, label=label)
        check(chosen)
        left_out = interpretation.unanswered(omissions(file, chosen, group))
        if chosen.compression not in COMPRESSIONS.values():
            from .openimageio import repack_deep

            deep_channel_names(chosen, group, label)  # else it would be repacked in vain
            _, copy = opened.enter_context(temporary(label))
            log.info("%s is packed as %s, and repacked first", label, chosen.compression)
            repack_deep(path, chosen, copy, "zips", label)
            file = describe(copy, label)
            chosen, group = choose(file, layer=layer, deep=True, label=label)
        # What is left out is that of the file that was named, not of a copy of one part.
        reader = DeepReader(file, chosen, group, interpretation, label, left_out)
        yield opened.enter_context(contextlib.closing(reader))


class DeepReader:
    """A deep image of a file, read by rows in any order, by any number of threads at a time.

    `label` names it in errors; the path of the file if not given. `left_out`: what of its file is
    not in it, in words.
    Errors: `SettingError`, `InputError`, also for an image without depth or alpha.
    """

    def __init__(
        self,
        file: ImageFile,
        part: Part,
        group: ColorGroup,
        interpretation: Interpretation = AS_STORED,
        label: str | None = None,
        left_out: tuple[str, ...] = (),
    ) -> None:
        self.part, self.nonfinite = part, interpretation.nonfinite
        self.label = label or file.path
        self.problems = interpretation.problems_of(part, self.label)
        self.omissions = left_out
        self.decoding = interpretation.decoding_of(file, part)
        self.alphas = OutsideAlphas()
        self._color, self._depth = deep_channel_names(part, group, self.label)
        raw = RawFile(file.path, file.identity, self.label)
        with contextlib.ExitStack() as failed:
            failed.callback(raw.close)
            layout = layout_of(raw, part.index, self.label)
            if layout.window != part.data_window:
                raise InputError(f"{self.label}: cannot be read: its headers contradict each other")
            self._chunks = DeepChunks(raw, layout, [*self._color, *self._depth], self.label)
            failed.pop_all()

    @property
    def window(self) -> Window:
        """The pixels that there are, in the file's own coordinates."""
        return self.part.data_window

    @property
    def rows_at_once(self) -> int:
        """Rows that are stored together."""
        return self._chunks.layout.chunk_rows

    @property
    def has_volumes(self) -> bool:
        """Whether samples may have a length."""
        return len(self._depth) > 1

    @property
    def bytes_held(self) -> int:
        """Memory of the table of chunks, and of how many samples each row has."""
        layout = self._chunks.layout
        return layout.offsets.nbytes + 8 * layout.window.height

    @property
    def bytes_to_count(self) -> int:
        """Memory of how many samples each pixel has of what is stored together: packed to sums."""
        width, height = self._chunks.layout.tile or (self.window.width, 1)
        return 32 * width * height

    def work_in(self, primaries: Primaries) -> None:
        """Decodes into these primaries from now on, instead of into Rec. 709."""
        self.decoding = replace(self.decoding, working=primaries)

    def close(self) -> None:
        self._chunks.close()

    def count(self) -> DeepCounts:
        """How many samples there are; see `DeepChunks.count`."""
        return self._chunks.count()

    def read(self, begin: int, end: int) -> tuple[DeepSamples, int]:
        """Rows `begin` to `end` in the file's coordinates, and how many samples were left out.

        Errors: `InputError`; `MismatchError` for NaN and Inf where the policy refuses them.
        """
        counts, front, back, stored = self._stored(begin, end)
        broken = _broken(front, back, stored)
        left_out = 0
        if broken.any():
            if self.nonfinite == "error":
                raise self._nonfinite_error(begin)
            if self.nonfinite == "zero":
                left_out = int(broken.sum())
                pixel = np.repeat(np.arange(counts.size), counts)[broken]
                counts = counts - np.bincount(pixel, minlength=counts.size)
                front, back, stored = front[~broken], back[~broken], stored[~broken]
            else:
                # Kept all the same, and somewhere they have to be: behind all others.
                front = np.where(np.isnan(front), np.float32(np.inf), front)
                back = np.where(np.isnan(back), front, back)
        self.alphas.add(stored[..., -1])
        rgba = decode(stored[None], self.decoding)[0]
        return DeepSamples(counts, front, back, rgba), left_out

    def _stored(self, begin: int, end: int) -> tuple[NDArray[np.int64], Any, Any, Any]:
        """Counts (pixels), front and back (n), and colour and alpha (n, channels) as stored."""
        counts, planes = self._chunks.read(begin, end)
        front = planes[self._depth[0]]
        color = [planes[name] for name in self._color]
        if len(color) == 1:
            color.insert(0, np.zeros_like(color[0]))  # alpha alone: black
        stored = np.stack(color, axis=-1)
        return counts.ravel(), front, planes[self._depth[-1]], stored

    def _nonfinite_error(self, begin: int) -> MismatchError:
        """Says where the first such sample is and how many there are, from row `begin` on."""
        count, first = 0, ""
        for row in range(begin, self.window.bottom):
            counts, *samples = self._stored(row, row + 1)
            broken = np.flatnonzero(_broken(*samples))
            if len(broken) and not count:
                column = np.searchsorted(np.cumsum(counts), broken[0], side="right")
                first = f"{self.window.x + column},{row}"
            count += len(broken)
        samples_are = "1 sample is" if count == 1 else f"{count} samples are"
        return MismatchError(
            f"{self.label}: {samples_are} NaN or infinite, the first in pixel {first}: "
            "--nonfinite zero or keep lets them pass"
        )


def _broken(front: Any, back: Any, stored: Any) -> NDArray[np.bool_]:
    """Samples with NaN, or an infinite colour or alpha; infinitely far is a depth like others."""
    broken: NDArray[np.bool_] = ~np.isfinite(stored).all(axis=-1)
    broken |= np.isnan(front) | np.isnan(back)
    return broken
