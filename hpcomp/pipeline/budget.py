"""How much memory a stack takes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from ..blending.rules import Reduction, StackRules
from ..engine import choice as engine
from ..geometry import Window
from ..imagefile.reading import STRIP_ROWS
from ..imagefile.writing import OutputForm
from ..layers import budget
from ..layers.budget import DECODING_BYTES, RGBA_BYTES, THREAD_BYTES, Budget, most_at_once
from ..layers.placing import PlacedLayer
from ..options import ResourceOptions
from ..system.threads import reads_ahead, writes_behind
from .observer import Observer

#: Layers that are added in one pass over a strip, where they fold.
LAYERS_AT_ONCE = 8
#: What the reference engine takes for a block of pixels and the pairs of their terms.
NUMPY_BYTES = 10 << 20
#: What is known of a layer, whose file may be closed.
READER_BYTES = 8 << 10
#: A pixel of an accumulator's planes.
PLANES_BYTES = 32
#: The two planes more of a space in which the result is to be brought back into gamut.
BOUNDS_BYTES = 8
#: The plane more of strengths that are not the chroma.
STRENGTH_BYTES = 4


def stack_budget(
    layers: Sequence[PlacedLayer],
    window: Window,
    rules: StackRules,
    form: OutputForm,
    observer: Observer,
    threads: int,
) -> Budget:
    """What a stack takes."""
    readers = [layer.reader for layer in layers]
    windows = [layer.window for layer in layers]
    # No strip has more rows: whole blocks of the codecs, and of the observer's cells.
    strip = 2 * max(STRIP_ROWS, *(reader.rows_at_once for reader in readers))
    all_at_once = rules.reduction is Reduction.ALL_LAYERS or observer.sees_layers
    met = most_at_once(windows, [1] * len(layers), strip) + len(rules.needed_everywhere)
    met = min(met, len(layers))
    row_bytes = [reader.bytes_per_row for reader in readers]
    if all_at_once or len(readers) <= LAYERS_AT_ONCE:
        # Strips that are being finished still hold their layers.
        held = most_at_once(windows, row_bytes, strip) * (1 + writes_behind(threads))
    else:
        held = sum(sorted(row_bytes, reverse=True)[:LAYERS_AT_ONCE])
    decoded = 0
    in_numpy = engine.active().decodes_in_numpy
    if observer.sees_layers:
        in_numpy = in_numpy or engine.measuring(rules).decodes_in_numpy
    if in_numpy or not all(reader.is_plain for reader in readers):
        decoded = (met if all_at_once else min(met, LAYERS_AT_ONCE)) * RGBA_BYTES + DECODING_BYTES
    planes = PLANES_BYTES + (BOUNDS_BYTES if rules.bounded else 0)
    planes += STRENGTH_BYTES if rules.strength.of_chroma else 0
    watching, watching_fixed = observer.memory(rules, met, window)
    widest_row = max(row_bytes)
    # Files are open from their first row to their last, and some for the strip that is read ahead.
    open_bytes = most_at_once(windows, [reader.bytes_held for reader in readers], 2 * strip)
    return Budget(
        per_row=held
        + reads_ahead(threads) * widest_row
        + window.width
        * (decoded + writes_behind(threads) * (planes + form.bytes_per_pixel + watching)),
        fixed=(NUMPY_BYTES if in_numpy else 0)
        + len(readers) * READER_BYTES
        + open_bytes
        + threads * max(reader.bytes_to_decode for reader in readers)
        + form.bytes_to_encode(window.width, threads)
        + threads * THREAD_BYTES
        # Strips are reduced where they are prepared to be written.
        + writes_behind(threads) * engine.active().bytes_to_reduce(rules, met)
        + watching_fixed,
    )


def share_out(
    layers: Sequence[PlacedLayer],
    window: Window,
    rules: StackRules,
    form: OutputForm,
    granted: ResourceOptions,
    observer: Observer,
) -> tuple[int, int]:
    """How many threads make the stack, and how many rows at a time, a multiple of a cell.

    Errors: `MismatchError` that names the least memory this stack can be made in.
    """
    budget_of = partial(stack_budget, layers, window, rules, form, observer)
    readers = [layer.reader for layer in layers]
    return budget.share_out(
        readers, window.height, granted, budget_of, "this stack", cell=observer.cell
    )
