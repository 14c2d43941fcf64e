"""Which engine composites: the fused kernel where it was built, else the reference."""

from __future__ import annotations

import os
import warnings
from functools import cache
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..blending.rules import StackRules
from ..color.primaries import Primaries
from ..color.quantization import Losses
from ..color.samples import Samples
from ..errors import HpcompWarning, SettingError, unknown_name
from .contract import Accumulator, Engine

if TYPE_CHECKING:  # only reports need them
    from ..measures.labels import Provenance
    from ..measures.summary import StackSummary, StripToMeasure

#: The environment variable that chooses.
VARIABLE = "HPCOMP_ENGINE"
NAMES = ("kernel", "reference")

_looking = Lock()


def reference_engine() -> Engine:
    """The reference, imported when it is needed: where the kernel is, most runs do without it."""
    from . import reference

    return reference.ENGINE


def _kernel() -> Engine | None:
    # One thread looks for it, once: others that tried beside it could be given what is left of an
    # import that failed.
    with _looking:
        return _found_kernel()


@cache
def _found_kernel() -> Engine | None:
    try:
        from ..kernel import fused
    except ImportError:
        return None
    return fused.ENGINE


def chosen() -> Engine:
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
    return kernel or reference_engine()


def active() -> Engine:
    """The engine that is chosen, for work to be done with it.

    Warns, once in a process, where it is the reference because the kernel is missing. That is no
    error in a strict run, as the pictures are the same. Errors: as `chosen`.
    """
    engine = chosen()
    if engine.name == "reference" and not os.environ.get(VARIABLE):
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


def start(
    rules: StackRules,
    width: int,
    height: int,
    dtype: Any = np.float32,
    origin: tuple[int, int] = (0, 0),
    phases: NDArray[np.float32] | None = None,
) -> Accumulator:
    """An empty accumulator of the active engine; float64 is composited by the reference."""
    engine = reference_engine() if dtype == np.float64 else active()
    return engine.start(rules, width, height, dtype, origin, phases)


def measuring(rules: StackRules) -> Engine:
    """The engine that measures a stack: the active one where it can, else the reference."""
    engine = active()
    return engine if engine.measures(rules) else reference_engine()


def result_and_summary(
    accumulator: Accumulator, kind: str, losses: Losses, gamut: Primaries, strip: StripToMeasure
) -> tuple[Samples, StackSummary, Provenance | None]:
    """What an accumulator of the active engine made, and the summary by the one that measures.

    `strip`: its layers are those that were added, all at once.
    """
    if active().measures(strip.rules):
        return accumulator.result_and_summary(kind, losses, gamut, strip)
    return accumulator.result(kind, losses, gamut), *reference_engine().summary(strip)
