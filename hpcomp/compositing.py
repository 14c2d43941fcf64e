"""Stacks of arrays to one array, by either engine: the rules of a stack, and how it is reduced.

A stack is a reduction with ⊕ of the terms `w_i c_i`: the operators turn alphas into weights, the
blend order reduces the terms. No files here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import addition, orders, porter_duff, spaces
from .addition import DEFAULT_HUE_TOLERANCE
from .encoding import Losses
from .errors import MismatchError, SettingError
from .samples import Strip

Array = NDArray[np.floating[Any]]

#: More than there are between the faintest and the brightest float.
MAX_STOPS = 100

#: Pixels that `composite` hands to an engine at a time.
STRIP_PIXELS = 1 << 18


class Reduction(Enum):
    """How an engine reduces a stack: a fold holds one accumulator, else it holds every layer."""

    BOTTOM_UP = "bottom-up"
    FRONT_TO_BACK = "front-to-back"
    ALL_LAYERS = "all-layers"


@dataclass(frozen=True)
class StackRules:
    """Everything that decides how the pixels of a stack become one: no pixels, no files.

    `operators[i]` puts layer i on those below it (None for layer 0); `opacities` are in [0, 1];
    `background` is straight linear RGB; `exposure` is in stops.
    """

    operators: tuple[porter_duff.Operator | None, ...]
    opacities: tuple[float, ...]
    blending: addition.Blending
    order: orders.Order
    space: spaces.Space
    hue_tolerance: float
    background: tuple[float, ...] | None
    exposure: float

    def add(self, p1: Array, p2: Array) -> Array:
        """p1 ⊕ p2, or + where the blending is traditional; (2, …)."""
        return self.blending.add(p1, p2, self.hue_tolerance)

    def add_all(self, terms: Array) -> Array:
        """All of p (n, 2, …) at once → (2, …)."""
        return self.blending.add_all(terms, self.hue_tolerance)

    @property
    def reduction(self) -> Reduction:
        """The leanest way to reduce this stack while its layers arrive."""
        if self.order is orders.ORDERS["bottom-up"] or not self.blending.depends_on_order:
            return Reduction.BOTTOM_UP
        only_over = all(row is None or row.name == "over" for row in self.operators)
        if self.order is orders.ORDERS["top-down"] and only_over:
            return Reduction.FRONT_TO_BACK
        return Reduction.ALL_LAYERS

    @property
    def arrival(self) -> Sequence[int]:
        """The layers' numbers in the order in which an engine takes them."""
        numbers = range(len(self.operators))
        return numbers[::-1] if self.reduction is Reduction.FRONT_TO_BACK else numbers


def stack_rules(
    n_layers: int,
    *,
    op: str | Sequence[str | None] = "over",
    opacity: float | Sequence[float] = 1.0,
    blending: str = "hue-preserving",
    order: str | Sequence[int] = "bottom-up",
    space: str = "linear-rgb",
    hue_tolerance: float = DEFAULT_HUE_TOLERANCE,
    background: Sequence[float] | None = None,
    exposure: float = 0.0,
) -> StackRules:
    """The rules of a stack of `n_layers`, looked up and checked; the arguments of `composite`."""
    if n_layers < 1:
        raise SettingError("a stack needs at least one layer")
    ops = [None, *[op] * (n_layers - 1)] if isinstance(op, str) else list(op)
    opacities = np.full(n_layers, opacity) if np.ndim(opacity) == 0 else np.asarray(opacity)
    for what, given in (("operators", len(ops)), ("opacities", len(opacities))):
        if given != n_layers:
            raise SettingError(f"{given} {what} for {n_layers} layers: give one for each")
    if None in ops[1:]:
        raise SettingError(f"layer {ops.index(None, 1)} has no operator: name one such as 'over'")
    if ops[0] is not None:
        raise SettingError(
            f"layer 0 is the bottom, with nothing below it for '{ops[0]}' to act on: "
            "leave its operator out"
        )
    for number, value in enumerate(opacities):
        if not 0 <= value <= 1:
            raise SettingError(f"layer {number}: opacity {value:g} is outside 0 to 1")
    if background is not None and (len(background) != 3 or not np.isfinite(background).all()):
        raise SettingError(f"background {background} is not three finite components, linear RGB")
    if not abs(exposure) <= MAX_STOPS:
        raise SettingError(f"exposure {exposure:g} is outside -{MAX_STOPS} to {MAX_STOPS} stops")
    return StackRules(
        operators=tuple(None if name is None else porter_duff.operator(name) for name in ops),
        opacities=tuple(float(value) for value in opacities),
        blending=addition.blending(blending),
        order=orders.order(order, n_layers),
        space=spaces.space(space),
        hue_tolerance=addition.check_hue_tolerance(hue_tolerance),
        background=None if background is None else tuple(float(v) for v in background),
        exposure=float(exposure),
    )


def composite(layers: Sequence[ArrayLike], **rules: Any) -> Array:
    """Composites layers, bottom first, into one array.

    `layers`: arrays (…, 4) of one shape; linear, premultiplied RGBA; colour unbounded, alpha
    clamped to [0, 1]. float64 is composited in float64, anything else in float32.
    `rules`, each with its default:
      `op` "over": one operator for the layers above the bottom, or one for each layer, None first;
      `opacity` 1.0: one for all layers or one for each, in [0, 1];
      `blending` "hue-preserving", or "traditional";
      `order` "bottom-up", "top-down", "balanced", "simultaneous", "2,0,1" or a sequence of ints;
      `space` "linear-rgb"; `hue_tolerance` 2.0, degrees between p vectors;
      `background` None, or straight linear RGB put under the result;
      `exposure` 0.0: stops, applied to the colour of the result.
    Returns: (…, 4), linear, premultiplied RGBA, alpha in [0, 1].
    Errors: `SettingError` for a rule, `MismatchError` for layers of different shapes.
    Source: Chuang et al. 2009, Eq. 1–3 and Algorithm 1; Porter and Duff 1984.
    """
    checked = stack_rules(len(layers), **rules)
    arrays = [np.asarray(layer) for layer in layers]
    from . import engine  # the engines need the rules above

    dtype = np.result_type(np.float32, *(a.dtype for a in arrays if a.dtype == np.float64))
    shape = arrays[0].shape
    for number, array in enumerate(arrays):
        if array.ndim == 0 or array.shape[-1] != 4:
            raise MismatchError(
                f"layer {number} has shape {array.shape}: RGBA needs 4 components on the last axis"
            )
        if array.shape != shape:
            raise MismatchError(
                f"layer {number} has shape {array.shape} but layer 0 has {shape}: "
                "place all layers on one canvas first"
            )
    flat = [array.reshape(-1, 4) for array in arrays]
    result = np.empty((len(flat[0]), 4), dtype)
    for begin in range(0, len(result), STRIP_PIXELS):
        end = min(begin + STRIP_PIXELS, len(result))
        accumulator = engine.start(checked, end - begin, 1, dtype)
        for number in checked.arrival:
            rgba = np.ascontiguousarray(flat[number][begin:end], dtype)
            accumulator.add([number], [Strip(rgba[None])])
        result[begin:end] = accumulator.result("float", Losses())[0]
    return result.reshape(shape)


def hue_add(
    c1: ArrayLike,
    c2: ArrayLike,
    *,
    hue_tolerance: float = DEFAULT_HUE_TOLERANCE,
    space: str = "linear-rgb",
) -> Array:
    """The hue-preserving sum c1 ⊕ c2 of two premultiplied colours.

    `c1`, `c2`: (…, 3), linear RGB, unbounded; broadcast against each other.
    `hue_tolerance`: degrees between p vectors, 0 for the paper's operator.
    `space`: a name of `SPACES`, in which hue and chroma are measured.
    Returns: (…, 3), linear RGB. float64 if either is, else float32.
    Errors: `SettingError` for a rule, `MismatchError` for a shape.
    Source: Chuang et al. 2009, Algorithm 1.
    """
    tolerance, blending_space = addition.check_hue_tolerance(hue_tolerance), spaces.space(space)
    a, b = np.broadcast_arrays(np.asarray(c1), np.asarray(c2))
    if a.ndim == 0 or a.shape[-1] != 3:
        raise MismatchError(f"colours of shape {a.shape}: RGB needs 3 components on the last axis")
    dtype = np.result_type(np.float32, *(c.dtype for c in (a, b) if c.dtype == np.float64))
    y1, p1 = blending_space.forward(a.reshape(-1, 3).T.astype(dtype))
    y2, p2 = blending_space.forward(b.reshape(-1, 3).T.astype(dtype))
    p = addition.add_hue_preserving(p1, p2, tolerance)
    return blending_space.inverse(y1 + y2, p).T.reshape(a.shape)  # Eq. 1
