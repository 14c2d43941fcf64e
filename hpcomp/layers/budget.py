"""Memory that is granted to work on layers, shared out: how many threads, how many rows at a time.

Whoever reads layers in strips says what that takes, as a `Budget` for a number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate

from ..errors import MismatchError
from ..geometry import Window
from ..imagefile.reading import STRIP_ROWS, LayerReader
from ..options import ResourceOptions
from ..records import record
from ..system.memory import parse_bytes
from ..system.threads import thread_count

#: A thread's stack and arena.
THREAD_BYTES = 2 << 20
#: Of the budget: the rest is for what the allocator keeps back.
USED_SHARE = 0.85
#: A pixel of float32 RGBA, and of numpy's decoding, partly in doubles.
RGBA_BYTES, DECODING_BYTES = 16, 180


@record
class Budget:
    """What some work takes of memory, in bytes: for each row of a strip, and whatever the strips.

    An estimate from above; the tests hold it against real peaks.
    """

    per_row: int
    fixed: int

    @staticmethod
    def of_measuring(readers: Sequence[LayerReader], threads: int, measuring: int) -> Budget:
        """What it takes where each thread has a strip of all readers, and measures it.

        `measuring`: bytes that this takes beside the strip, in each thread.
        """
        # One thread reads at a time, and looks for NaN, and for colours of a mask.
        looking = max(reader.bytes_per_row for reader in readers)
        decoding = max(reader.bytes_to_decode for reader in readers)
        return Budget(
            per_row=threads * sum(reader.bytes_per_row for reader in readers) + looking,
            fixed=sum(reader.bytes_held for reader in readers)
            + threads * (decoding + measuring + THREAD_BYTES),
        )

    def rows(self, block: int, height: int, max_memory: int, what: str, wanted: int) -> int:
        """How many rows at a time fit: whole compression blocks, and not needlessly many.

        `wanted`: rows that are enough. Errors: `MismatchError` that names the least memory, and
        `what` needs it.
        """
        block = min(block, height)
        least = self.least(block)
        if least > max_memory:
            raise MismatchError(
                f"{what} needs at least {-(-least // 2**20)}M"
                + (f", in strips of {block} rows, the fewest there can be" if block > 1 else "")
                + f": raise --max-memory, which is {max_memory / 2**20:.0f}M"
            )
        rows = (int(max_memory * USED_SHARE) - self.fixed) // self.per_row
        enough = -(-wanted // block) * block
        return max(block, min(enough, rows - rows % block))

    def least(self, block: int) -> int:
        """The memory for strips of one compression block: any less would decode it many times."""
        return int((self.fixed + block * self.per_row) / USED_SHARE) + 1


def most_at_once(windows: Sequence[Window], values: Sequence[int], rows: int) -> int:
    """The largest sum of the values of windows that one strip of so many rows can meet."""
    changes = sorted(
        change
        for window, value in zip(windows, values, strict=True)
        for change in ((window.y - rows, value), (window.bottom, -value))
    )
    return max(accumulate(change for _, change in changes), default=0)


def share_out(
    readers: Sequence[LayerReader],
    height: int,
    granted: ResourceOptions,
    budget_of: Callable[[int], Budget],
    what: str,
    wanted: int | None = None,
    *,
    cell: int = 1,
) -> tuple[int, int]:
    """How many threads do the work, and how many of `height` rows are in memory at a time.

    More threads take more memory: there are no more of them than it has room for. `budget_of`: what
    so many threads take. `wanted`: rows that are enough, `STRIP_ROWS` if None. `cell`: of what the
    rows are a multiple. Errors: `MismatchError` that names the least memory in which it can be
    done, and `what` it is.
    """
    memory = parse_bytes(granted.max_memory)
    threads = thread_count(granted.threads)
    block = _up(max(reader.rows_at_once for reader in readers), cell)
    while True:
        budget = budget_of(threads)
        if threads == 1 or budget.least(min(block, height)) <= memory:
            rows = budget.rows(block, height, memory, what, wanted or STRIP_ROWS)
            return threads, _up(rows, cell)
        threads -= 1


def _up(rows: int, multiple: int) -> int:
    return -(-rows // multiple) * multiple
