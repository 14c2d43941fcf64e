"""The pass over the strips of a stack: layers are read ahead, and results written behind."""

from __future__ import annotations

import logging
from collections.abc import Container, Iterator, Sequence
from functools import partial
from threading import Lock
from typing import Any

from ..blending.rules import Reduction
from ..color.quantization import Losses
from ..color.samples import NOTHING, Strip
from ..engine import choice as engine
from ..engine.contract import Accumulator
from ..geometry import Window
from ..imagefile.writing import ImageWriter
from ..layers.placing import PlacedLayer
from ..records import record
from ..system.threads import ThreadPipeline
from .budget import LAYERS_AT_ONCE
from .observer import Observer
from .picture import PicturePlan

log = logging.getLogger("hpcomp")


@record
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
    arrival = rules.arrival
    reads = (
        (number, partial(layers[number].read, rows))
        for rows, there in _with_layers(plan)
        for number in arrival
        if number in there
    )
    finishing = _Finishing(plan, writer, observer)
    with ThreadPipeline[Strip](plan.threads) as pipeline:
        arriving = pipeline.read_ahead(reads)
        for rows, there in _with_layers(plan):
            origin = rows.x - plan.canvas.x, rows.y - plan.canvas.y
            accumulator = engine.start(rules, rows.width, rows.height, origin=origin)
            for group in _grouped(arrival, there, at_once):
                arrived = [next(arriving) if number in there else NOTHING for number in group]
                pipeline.composite(partial(accumulator.add, group, arrived))
                if not observer.sees_layers:
                    arrived = []  # not to be held while the next ones arrive
            strips_up = arrived if arrival[0] == 0 else arrived[::-1]
            prepare = partial(finishing.prepare, accumulator, strips_up, rows)
            pipeline.write_behind(prepare, finishing.write)
            del accumulator, arrived, strips_up, prepare
        pipeline.flush()
    for what, seconds in pipeline.seconds.items():
        log.info("%s: %.3f s of all threads together", what, seconds)
    return finishing.losses


def _with_layers(plan: StackPlan) -> Iterator[tuple[Window, Container[int]]]:
    """The windows of the strips, from the top, each with the numbers of layers that it meets."""
    coming: list[tuple[int, int, int]] = []  # (row of the top, row below the last one, number)
    for number, layer in enumerate(plan.layers):
        common = layer.window.intersection(plan.window)
        if common is not None:
            coming.append((common.y, common.bottom, number))
    coming.sort(reverse=True)
    there: dict[int, int] = {}  # the row below the last one of each layer
    for rows in plan.strips():
        there = {number: bottom for number, bottom in there.items() if bottom > rows.y}
        while coming and coming[-1][0] < rows.bottom:
            _, bottom, number = coming.pop()
            there[number] = bottom
        yield rows, there


def _grouped(numbers: Sequence[int], there: Container[int], size: int) -> Iterator[Sequence[int]]:
    """Runs of the numbers, each with `size` of those that are there, and others between them."""
    begin, count = 0, 0
    for end, number in enumerate(numbers):
        if number in there:
            if count == size:
                yield numbers[begin:end]
                begin, count = end, 0
            count += 1
    yield numbers[begin:]


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
