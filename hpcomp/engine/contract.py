"""What an engine is: the contract that the fused kernel and the numpy reference both keep.

`choice` says which of them composites, and is where mypy holds both against the contract.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..blending.rules import StackRules
from ..color.primaries import REC709, Primaries
from ..color.quantization import Losses
from ..color.samples import Samples, Strip

if TYPE_CHECKING:  # only reports need them
    from ..measures.histogram import HueHistogram
    from ..measures.labels import Provenance
    from ..measures.summary import StackSummary, StripToMeasure


class Accumulator(Protocol):
    """Takes the layers of one strip in `rules.arrival` order, and gives their composite.

    `nonfinite`: how many pixels of each layer, by its number, are stored with NaN or Inf.
    """

    nonfinite: list[int]

    def add(self, numbers: Sequence[int], strips: Sequence[Strip]) -> None:
        """Layers by number; `nonfinite` counts their pixels with NaN or Inf.

        `NOTHING` takes no time, but of layers that are `StackRules.needed_everywhere`.
        """

    def result(self, kind: str, losses: Losses, gamut: Primaries = REC709) -> Samples:
        """The composite (height, width, 4), as samples of a kind of `OUTPUT_TYPES`.

        Codes are of that gamut, floats in the working primaries. To be asked for once.
        """

    def result_and_summary(
        self, kind: str, losses: Losses, gamut: Primaries, strip: StripToMeasure
    ) -> tuple[Samples, StackSummary, Provenance | None]:
        """`result`, and `Engine.summary` of the same strip, in one pass where the engine can.

        `strip`: its layers are those that were added, all at once.
        """


class Engine(Protocol):
    """Composites stacks strip by strip, and measures what that did to their hues.

    `name`: what the environment and reports call it. `decodes_in_numpy`: whether strips are widened
    to float RGBA on the way. `pairs_at_once`: pairs of terms of the order `simultaneous` that are
    to be asked of it at a time, as it cannot be interrupted: they take a small part of a second.
    """

    name: str
    decodes_in_numpy: bool
    pairs_at_once: int

    def start(
        self,
        rules: StackRules,
        width: int,
        height: int,
        dtype: Any = np.float32,
        origin: tuple[int, int] = (0, 0),
        phases: NDArray[np.float32] | None = None,
    ) -> Accumulator:
        """An empty accumulator for a strip of that size in pixels.

        `origin`: column and row of its first pixel, counted from the corner of the canvas.
        `phases` (pixels): of the weave, where pixels do not lie side by side there.
        """

    def bytes_to_reduce(self, rules: StackRules, layers: int) -> int:
        """Memory that a strip of so many layers takes beside its samples, whatever its size."""

    def keep_runs(
        self,
        rules: StackRules,
        counts: NDArray[np.int64],
        p: NDArray[np.float64],
        strengths: NDArray[np.float64] | None,
    ) -> NDArray[np.float64]:
        """What is kept of each of runs of chroma vectors, added at once: p (2, n) → (n) in [0, 1].

        `counts`: (runs), n in all. `strengths`: m (n), None where it is |p|. `rules`: of a blending
        and a tolerance; no order, nobody in front, and no place.
        """

    def bytes_to_keep(self, terms: int) -> int:
        """Memory that `keep_runs` takes beside p for a run of so many."""

    def measures(self, rules: StackRules) -> bool:
        """Whether it measures stacks of such rules; the reference measures all."""

    def hues(self, strip: Strip, like: HueHistogram) -> HueHistogram | None:
        """The histogram of one strip, like an empty one; None where numpy is to count.

        Where an engine counts, it is the histogram of `hue_histogram`, to the bit.
        """

    def summary(self, strip: StripToMeasure) -> tuple[StackSummary, Provenance | None]:
        """The summary of a strip, and its provenance planes (height, width) where wanted."""
