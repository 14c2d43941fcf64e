"""How much memory a stack takes, and how many rows at a time fit into what it is granted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..blending.rules import Reduction, StackRules
from ..engine import choice as engine
from ..errors import MismatchError
from ..geometry import Window
from ..imagefile.reading import STRIP_ROWS, LayerReader
from ..imagefile.writing import OutputForm
from ..options import ResourceOptions
from ..system.memory import parse_bytes
from ..system.threads import reads_ahead, thread_count, writes_behind

#: Layers that are added in one pass over a strip, where they fold.
LAYERS_AT_ONCE = 8
#: A thread's stack and arena.
THREAD_BYTES = 2 << 20
#: Of the budget: the rest is for what the allocator keeps back.
USED_SHARE = 0.85
#: What the reference engine takes for a block of pixels and the pairs of their terms.
NUMPY_BYTES = 10 << 20
#: A pixel of float32 RGBA, of an accumulator's planes, and of numpy's decoding, partly in doubles.
RGBA_BYTES, PLANES_BYTES, DECODING_BYTES = 16, 20, 180
#: The two planes more of a space in which the result is to be brought back into gamut.
BOUNDS_BYTES = 8


@dataclass(frozen=True)
class Budget:
    """What a stack takes of memory, in bytes: for each row of a strip, and whatever the strips."""

    per_row: int
    fixed: int

    @staticmethod
    def of(
        readers: Sequence[LayerReader],
        width: int,
        rules: StackRules,
        form: OutputForm,
        threads: int,
        extra: tuple[int, int] = (0, 0),
    ) -> Budget:
        """An estimate from above; the tests hold it against real peaks.

        `extra`: for each pixel of a strip and fixed, where all layers are looked at once more.
        """
        all_at_once = rules.reduction is Reduction.ALL_LAYERS or any(extra)
        if all_at_once or len(readers) <= LAYERS_AT_ONCE:
            # Strips that are being finished still hold their layers.
            held = sum(reader.bytes_per_row for reader in readers) * (1 + writes_behind(threads))
        else:
            widest = sorted((reader.bytes_per_row for reader in readers), reverse=True)
            held = sum(widest[:LAYERS_AT_ONCE])
        decoded = 0
        in_numpy = engine.active().decodes_in_numpy
        if any(extra):
            in_numpy = in_numpy or engine.measuring(rules).decodes_in_numpy
        if in_numpy or not all(reader.is_plain for reader in readers):
            at_once = len(readers) if all_at_once else LAYERS_AT_ONCE
            decoded = min(at_once, len(readers)) * RGBA_BYTES + DECODING_BYTES
        planes = PLANES_BYTES + (0 if rules.blending_space.linear else BOUNDS_BYTES)
        widest_row = max(reader.bytes_per_row for reader in readers)
        return Budget(
            per_row=held
            + reads_ahead(threads) * widest_row
            + width
            * (decoded + writes_behind(threads) * (planes + form.bytes_per_pixel + extra[0])),
            fixed=(NUMPY_BYTES if in_numpy else 0)
            + sum(reader.bytes_held for reader in readers)
            + threads * max(reader.bytes_to_decode for reader in readers)
            + form.bytes_to_encode(width, threads)
            + threads * THREAD_BYTES
            # Strips are reduced where they are prepared to be written.
            + writes_behind(threads) * engine.active().bytes_to_reduce(rules, len(readers))
            + extra[1],
        )

    def rows(self, block: int, height: int, max_memory: int) -> int:
        """How many rows at a time fit: whole compression blocks, and not needlessly many.

        Errors: `MismatchError` that names the least memory this stack can be made in.
        """
        block = min(block, height)
        least = self.least(block)
        if least > max_memory:
            raise MismatchError(
                f"this stack needs at least {-(-least // 2**20)}M"
                + (f", as a file is stored {block} rows at a time" if block > 1 else "")
                + f": raise --max-memory, which is {max_memory / 2**20:.0f}M"
            )
        rows = (int(max_memory * USED_SHARE) - self.fixed) // self.per_row
        wanted = -(-STRIP_ROWS // block) * block
        return max(block, min(wanted, rows - rows % block))

    def least(self, block: int) -> int:
        """The memory for strips of one compression block: any less would decode it many times."""
        return int((self.fixed + block * self.per_row) / USED_SHARE) + 1


def share_out(
    readers: Sequence[LayerReader],
    window: Window,
    rules: StackRules,
    form: OutputForm,
    granted: ResourceOptions,
    extra: tuple[int, int],
) -> tuple[int, int]:
    """How many threads make the stack, and how many rows at a time.

    More threads take more memory: there are no more of them than it has room for. `extra`: as in
    `Budget.of`. Errors: `MismatchError` that names the least memory this stack can be made in.
    """
    memory = parse_bytes(granted.max_memory)
    threads = thread_count(granted.threads)
    block = max(reader.rows_at_once for reader in readers)
    while True:
        budget = Budget.of(readers, window.width, rules, form, threads, extra)
        if threads == 1 or budget.least(min(block, window.height)) <= memory:
            return threads, budget.rows(block, window.height, memory)
        threads -= 1
