"""The pass over the strips of a stack: layers are read ahead, and results written behind."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from threading import Lock
from typing import Any

from ..blending.rules import Reduction
from ..color.quantization import Losses
from ..color.samples import Strip
from ..engine import choice as engine
from ..engine.contract import Accumulator
from ..geometry import Window
from ..imagefile.writing import ImageWriter
from ..layers.placing import PlacedLayer
from ..system.threads import ThreadPipeline
from .budget import LAYERS_AT_ONCE
from .observer import Observer
from .picture import PicturePlan

log = logging.getLogger("hpcomp")


@dataclass(frozen=True)
class StackPlan(PicturePlan):
    """The plan of a stack: its layers, and how many rows are made at a time.

    `missing_rows`: of the first strip, which is so many rows shorter.
    """

    layers: Sequence[PlacedLayer]
    strip_rows: int
    missing_rows: int

    def strips(self) -> Iterator[Window]:
        """The windows of the strips, from the top."""
        return self.window.strips(self.strip_rows, self.missing_rows)


def composite_strips(plan: StackPlan, writer: ImageWriter, observer: Observer) -> Losses:
    """Makes the picture, strip by strip. Returns what the file could not hold."""
    rules, layers = plan.rules, plan.layers
    at_once = LAYERS_AT_ONCE
    if rules.reduction is Reduction.ALL_LAYERS or observer.sees_layers:
        at_once = len(layers)
    groups = list(_grouped(rules.arrival, at_once))
    reads = (
        (number, partial(layers[number].read, rows))
        for rows in plan.strips()
        for number in rules.arrival
    )
    finishing = _Finishing(plan, writer, observer)
    with ThreadPipeline[Strip](plan.threads) as pipeline:
        arriving = pipeline.read_ahead(reads)
        for rows in plan.strips():
            origin = rows.x - plan.canvas.x, rows.y - plan.canvas.y
            accumulator = engine.start(rules, rows.width, rows.height, origin=origin)
            for group in groups:
                arrived = [next(arriving) for _ in group]
                pipeline.composite(partial(accumulator.add, group, arrived))
                if not observer.sees_layers:
                    arrived = []  # not to be held while the next ones arrive
            strips_up = arrived if groups[0][0] == 0 else arrived[::-1]
            prepare = partial(finishing.prepare, accumulator, strips_up, rows)
            pipeline.write_behind(prepare, finishing.write)
            del accumulator, arrived, strips_up, prepare
        pipeline.flush()
    for what, seconds in pipeline.seconds.items():
        log.info("%s: %.3f s of all threads together", what, seconds)
    return finishing.losses


def _grouped(numbers: Sequence[int], size: int) -> Iterator[Sequence[int]]:
    for begin in range(0, len(numbers), size):
        yield numbers[begin : begin + size]


class _Finishing:
    """Turns accumulated strips into rows of the file, and counts what these cannot hold."""

    def __init__(self, plan: StackPlan, writer: ImageWriter, observer: Observer) -> None:
        self._plan, self._writer, self._observer = plan, writer, observer
        self._lock = Lock()
        self.losses = Losses()

    def prepare(
        self, accumulator: Accumulator, strips: Sequence[Strip], rows: Window
    ) -> tuple[Any, Any]:
        """What is to be written of the strip `rows`, in any thread; pixels may be refused."""
        lost = Losses()
        form = self._plan.request.form
        samples, seen = self._observer.composite(accumulator, strips, rows, form, lost)
        with self._lock:
            self.losses.add(lost)
            for layer, count in zip(self._plan.layers, accumulator.nonfinite, strict=True):
                if count:
                    top = max(rows.y - layer.dy, layer.reader.window.y)
                    layer.reader.note_nonfinite(top, count)
        return self._writer.prepare(rows.y - self._plan.window.y, samples), seen

    def write(self, prepared: tuple[Any, Any]) -> None:
        """Writes a strip, after the one above it."""
        picture, seen = prepared
        self._writer.write(picture)
        self._observer.write(seen)
