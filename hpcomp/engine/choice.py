"""Which engine composites: the fused kernel where it was built, else the reference.

Both have the same face: `NAME`, and `start(rules, width, height, dtype)` for a strip, whose `add`
takes layers, whose `result` gives samples, and whose `nonfinite` counts pixels with NaN or Inf;
`bytes_to_reduce(rules, layers)`, memory that a strip takes beside its samples; `PAIRS_AT_ONCE`, the
most that is to be asked of it at a time where it cannot be interrupted; and the module named in
`MEASURING`, whose `findings` say what blending did to the hues of a strip, and
`result_and_findings` that beside the result.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from threading import Lock
from types import ModuleType
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..blending.rules import StackRules
from ..color.primaries import REC709, Primaries
from ..color.quantization import Losses
from ..color.samples import Samples, Strip
from ..errors import HpcompWarning, SettingError, unknown_name
from . import reference

if TYPE_CHECKING:  # only reports need them
    from ..measures.findings import MeasuredStrip, StackFindings
    from ..measures.labels import Provenance

#: The environment variable that chooses.
VARIABLE = "HPCOMP_ENGINE"
NAMES = ("kernel", "reference")

_looking = Lock()


class Accumulator(Protocol):
    """Takes the layers of one strip in `rules.arrival` order, and gives their composite."""

    nonfinite: Sequence[int]

    def add(self, numbers: Sequence[int], strips: Sequence[Strip]) -> None:
        """Layers by number."""

    def result(self, kind: str, losses: Losses, gamut: Primaries = REC709) -> Samples:
        """The composite (height, width, 4), as samples of that kind; codes are of that gamut."""


def _kernel() -> ModuleType | None:
    # One thread looks for it, once: others that tried beside it could be given what is left of an
    # import that failed.
    with _looking:
        return _found_kernel()


@cache
def _found_kernel() -> ModuleType | None:
    try:
        from ..kernel import fused as kernel
    except ImportError:
        return None
    return kernel


def chosen() -> ModuleType:
    """The engine that composites now. Errors: `SettingError` for one that there is not."""
    wanted = os.environ.get(VARIABLE) or None
    if wanted not in (None, *NAMES):
        raise unknown_name(f"engine in {VARIABLE}", str(wanted), NAMES)
    kernel = None if wanted == "reference" else _kernel()
    if wanted == "kernel" and kernel is None:
        raise SettingError(
            f"{VARIABLE} asks for the kernel, which was not built: install hpcomp again with a "
            "C++ compiler at hand"
        )
    return kernel or reference


def active() -> ModuleType:
    """The engine that is chosen, for work to be done with it.

    Warns, once in a process, where it is the reference because the kernel is missing. That is no
    error in a strict run, as the pictures are the same. Errors: as `chosen`.
    """
    engine = chosen()
    if engine is reference and not os.environ.get(VARIABLE):
        with _looking:
            _warn_of_the_missing_kernel()
    return engine


@cache
def _warn_of_the_missing_kernel() -> None:
    warnings.warn(
        "the kernel was not built, and the reference engine takes some ten times as long: install "
        f"hpcomp again with a C++ compiler at hand, or choose it with {VARIABLE}=reference",
        HpcompWarning,
        stacklevel=3,
    )


def start(rules: StackRules, width: int, height: int, dtype: Any = np.float32) -> Accumulator:
    """An empty accumulator of the active engine; float64 is composited by the reference."""
    engine = reference if dtype == np.float64 else active()
    accumulator: Accumulator = engine.start(rules, width, height, dtype)
    return accumulator


def measuring(rules: StackRules) -> ModuleType:
    """The engine that measures a stack: the active one, but the kernel in linear spaces alone."""
    return active() if rules.space.linear else reference


def findings(strip: MeasuredStrip) -> tuple[StackFindings, Provenance | None]:
    """What the engine that measures finds of a strip."""
    module = import_module(measuring(strip.rules).MEASURING)
    found: tuple[StackFindings, Provenance | None] = module.findings(strip)
    return found


def result_and_findings(
    accumulator: Accumulator, kind: str, losses: Losses, gamut: Primaries, strip: MeasuredStrip
) -> tuple[Samples, StackFindings, Provenance | None]:
    """`accumulator.result` and `findings`, in one pass where the engine can.

    `strip`: its layers are those that were added, all at once.
    """
    module = import_module(measuring(strip.rules).MEASURING)
    found: tuple[Samples, StackFindings, Provenance | None] = module.result_and_findings(
        accumulator, kind, losses, gamut, strip
    )
    return found
