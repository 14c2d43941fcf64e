"""How much memory flattening takes, and which strips of rows fit into what it is granted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..blending import deepsamples
from ..engine import choice as engine
from ..errors import MismatchError
from ..geometry import Window
from ..imagefile.deepreading import DeepReader
from ..imagefile.reading import STRIP_ROWS
from ..imagefile.writing import OutputForm
from ..layers.budget import THREAD_BYTES, USED_SHARE
from ..records import record
from ..system.threads import reads_ahead, writes_behind
from .budget import NUMPY_BYTES

Counts = NDArray[np.int64]

#: Samples of a strip where memory allows more: all their arrays stay near the processor.
STRIP_SAMPLES = 1 << 18
#: Rows of a strip are a multiple of this where they can be: what a block of ZIP holds.
ROWS_TOGETHER = 16
#: Memory of a sample and of a pixel of a strip while it is flattened, of all arrays together.
#: Volumes are split: of n in one place come up to 2n - 1.
POINT_BYTES, VOLUME_BYTES, PIXEL_BYTES = 150, 380, 120
#: Memory of the pieces of split samples, and of what is done to them.
PIECES_BYTES = 250 * deepsamples.PIECES_AT_ONCE


@record
class Need:
    """What flattening takes of memory, and which strips fit into what it is granted; in bytes.

    `block`: rows that are stored together, counted from row `block_begin` of the window.
    `per_row`: of a row without samples; `per_sample`; `held`: of a row that waits to be written.
    `counts`: of how many samples each pixel of what is stored together has, while it is read;
    `chunk`: the largest of what is stored together, unpacked; `reducing`: what a pixel of `deepest`
    samples takes beside these, no pixel having more.
    """

    window: Window
    block: int
    block_begin: int
    per_row: int
    per_sample: int
    held: int
    fixed: int
    granted: int
    counts: int
    chunk: int = 0
    reducing: int = 0
    deepest: int = 0

    @staticmethod
    def of(
        readers: Sequence[DeepReader],
        windows: Sequence[Window],
        window: Window,
        form: OutputForm,
        granted: int,
    ) -> Need:
        """An estimate from above, before samples were counted.

        `windows`: the readers' on the canvas. Errors: `MismatchError` where even a row without
        samples takes more than what is granted, so that nothing is counted in vain.
        """
        tallest = max(range(len(readers)), key=lambda number: readers[number].rows_at_once)
        block = readers[tallest].rows_at_once
        need = Need(
            window,
            block,
            (windows[tallest].y - window.y) % block,
            max(window.width, *(placed.width for placed in windows)) * PIXEL_BYTES,
            VOLUME_BYTES if any(reader.has_volumes for reader in readers) else POINT_BYTES,
            window.width * form.bytes_per_pixel,
            form.bytes_to_encode(window.width, 1) + sum(reader.bytes_held for reader in readers),
            granted,
            max(reader.bytes_to_count for reader in readers),
        )
        need.check(0, 0)
        return need

    def whole(self, threads: int, rows: int, samples: int) -> int:
        """Of all threads, with strips of up to so many rows and samples."""
        of_strip = rows * self.per_row + samples * self.per_sample + PIECES_BYTES
        of_strip += self.counts + 5 * self.chunk + self.reducing
        waiting = (reads_ahead(threads) + writes_behind(threads)) * rows * self.held
        numpy = NUMPY_BYTES if engine.active().decodes_in_numpy else 0
        whole = self.fixed + waiting + threads * (THREAD_BYTES + numpy + of_strip)
        return int(whole / USED_SHARE) + 1

    def check(self, samples: int, row: int) -> None:
        """`MismatchError` that names the least memory, where one thread cannot make that row."""
        least = self.whole(1, 1, samples)
        if least > self.granted:
            because = ""
            if samples:
                because = (
                    f", as row {row} has {samples} samples, and one pixel up to {self.deepest}"
                )
            raise MismatchError(
                f"this needs at least {-(-least // 2**20)}M{because}: raise --max-memory, which is "
                f"{self.granted / 2**20:.0f}M"
            )

    def strips(self, row_samples: Counts, threads: int) -> tuple[int, list[Window]]:
        """How many threads to use, and the strips, from the top: no larger than memory allows.

        `row_samples`: how many samples each row of the window has. Errors: `MismatchError`.
        """
        worst = int(row_samples.argmax())
        self.check(int(row_samples[worst]), self.window.y + worst)
        while threads > 1 and self.whole(threads, 1, int(row_samples[worst])) > self.granted:
            threads -= 1
        before = np.concatenate([[0], np.cumsum(row_samples)]).tolist()
        windows, at = [], 0
        while at < self.window.height:
            end = self._end(before, at, threads)
            window = self.window
            windows.append(Window(window.x, window.y + at, window.width, end - at))
            at = end
        return threads, windows

    def _end(self, before: Sequence[int], at: int, threads: int) -> int:
        """Where the strip that begins at row `at` of the window ends.

        Behind a whole block where it can be: what is stored together is unpacked once then. Else
        where a block of the output ends, so that this is packed in the thread that made it.
        """
        height = self.window.height
        block_end = at + self.block - (at - self.block_begin) % self.block
        end = at + 1
        while (
            end < height
            and end - at < max(STRIP_ROWS, self.block)
            and (end < block_end or before[end + 1] - before[at] <= STRIP_SAMPLES)
            and self.whole(threads, end + 1 - at, before[end + 1] - before[at]) <= self.granted
        ):
            end += 1
        if end == height:
            return end
        step, begin = (self.block, self.block_begin) if self.block > 1 else (ROWS_TOGETHER, 0)
        rounded = end - (end - begin) % step
        return rounded if rounded > at else end
