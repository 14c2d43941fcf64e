"""Who watches a picture being made. The pass over strips knows no more of reports than this."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

from ..blending.rules import StackRules
from ..color.quantization import Losses
from ..color.samples import Samples, Strip
from ..engine.contract import Accumulator
from ..geometry import Window
from ..imagefile.writing import OutputForm

if TYPE_CHECKING:  # only reports need them
    from ..measures.summary import StackSummary


class Observer(Protocol):
    """Watches one picture: is asked for its needs, sees every strip, and tells at the end.

    `sees_layers`: whether it is given all layers of a strip, which then are in memory at once.
    `cell`: strips begin at rows that are multiples of it, counted from the canvas' corner.
    `summary`: what it found of the stack, None before the end.
    """

    sees_layers: bool
    cell: int
    summary: StackSummary | None

    @property
    def outputs(self) -> Sequence[str]:
        """The files that it writes."""

    def place(self, opened: contextlib.ExitStack) -> None:
        """Gives each of its files a place; they appear when `opened` closes without an error."""

    def memory(self, rules: StackRules, met: int, window: Window) -> tuple[int, int]:
        """Bytes that it takes for each pixel of a strip, and whatever the strips.

        `met`: layers that meet in a strip.
        """

    def watch(
        self, rules: StackRules, window: Window, canvas: Window, pixel_aspect: float
    ) -> contextlib.AbstractContextManager[None]:
        """Around the pass: the rules and windows are known, and every strip of `window` follows."""

    def composite(
        self,
        accumulator: Accumulator,
        strips: Sequence[Strip],
        rows: Window,
        form: OutputForm,
        losses: Losses,
    ) -> tuple[Samples, Any]:
        """The accumulated strip `rows` as samples, and what is to be written of it; in any thread.

        `strips`: of all layers, bottom first, where it sees them.
        """

    def write(self, seen: Any) -> None:
        """Takes what `composite` gave, in the order of the strips. Errors: `OutputError`."""

    def publish(self) -> None:
        """Writes its files, once the picture is whole. Errors: `OutputError`."""


class NobodyWatches:
    """The observer that does nothing."""

    outputs: Sequence[str] = ()
    sees_layers = False
    cell = 1
    summary: StackSummary | None = None

    def place(self, opened: contextlib.ExitStack) -> None:
        pass

    def memory(self, rules: StackRules, met: int, window: Window) -> tuple[int, int]:
        return 0, 0

    def watch(
        self, rules: StackRules, window: Window, canvas: Window, pixel_aspect: float
    ) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def composite(
        self,
        accumulator: Accumulator,
        strips: Sequence[Strip],
        rows: Window,
        form: OutputForm,
        losses: Losses,
    ) -> tuple[Samples, Any]:
        return accumulator.result(form.kind, losses, form.gamut), None

    def write(self, seen: Any) -> None:
        pass

    def publish(self) -> None:
        pass
