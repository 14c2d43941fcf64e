"""The reference engine: stacks of arrays to one array, in numpy. No files here.

A stack is a reduction with ⊕ of the terms `w_i c_i`: the operators turn alphas into weights, the
blend order reduces the terms. Orders that can be folded while the layers arrive hold one
accumulator; the others hold every layer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import addition, orders, porter_duff, spaces
from .addition import DEFAULT_HUE_TOLERANCE
from .errors import MismatchError, SettingError

Array = NDArray[np.floating[Any]]

#: Pixels that are composited at a time, so that a few planes of them stay in the L2 cache.
BLOCK_PIXELS = 16_384


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
    def arrival(self) -> Sequence[int]:
        """The layers' numbers in the order in which the accumulator takes them."""
        numbers = range(len(self.operators))
        return numbers[::-1] if accumulator_type(self) is FrontToBack else numbers

    @property
    def holds_all_layers(self) -> bool:
        """Whether this order needs the pixels of every layer at once."""
        return accumulator_type(self) is AllLayers


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
    if not np.isfinite(exposure):
        raise SettingError(f"exposure {exposure} is not a finite number of stops")
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
    result = np.empty((flat[0].shape[0], 4), dtype)
    for block in _blocks(len(result)):
        accumulator = start(checked, block.stop - block.start, dtype)
        for number in checked.arrival:
            rgba = flat[number][block].astype(dtype)
            np.clip(rgba[:, 3], 0, 1, out=rgba[:, 3])
            accumulator.add(number, rgba)
        result[block] = accumulator.result()
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


class Accumulator(Protocol):
    """Takes the layers of one strip in `rules.arrival` order, and gives their composite."""

    def __init__(self, rules: StackRules, n_pixels: int, dtype: Any) -> None: ...

    def add(self, number: int, rgba: Array) -> None:
        """Layer `number`: (n_pixels, 4), linear, premultiplied, alpha in [0, 1]."""

    def result(self) -> Array:
        """The composite: (n_pixels, 4), linear, premultiplied."""


def start(rules: StackRules, n_pixels: int, dtype: Any = np.float32) -> Accumulator:
    """An empty accumulator of the leanest kind that can reduce this stack."""
    return accumulator_type(rules)(rules, n_pixels, dtype)


def accumulator_type(rules: StackRules) -> type[Accumulator]:
    """The leanest way to reduce a stack as its layers arrive."""
    if rules.order is orders.ORDERS["bottom-up"] or not rules.blending.depends_on_order:
        return BottomUp
    only_over = all(row is None or row.name == "over" for row in rules.operators)
    if rules.order is orders.ORDERS["top-down"] and only_over:
        return FrontToBack
    return AllLayers


class BottomUp:
    """Folds layers from the bottom: c ← F_A c_i ⊕ F_B c, the operators taken literally."""

    def __init__(self, rules: StackRules, n_pixels: int, dtype: Any) -> None:
        self.rules = rules
        self.luminance, self.alpha = np.zeros((2, n_pixels), dtype)
        self.p = np.zeros((2, n_pixels), dtype)

    def add(self, number: int, rgba: Array) -> None:
        operator = self.rules.operators[number]
        for block in _blocks(len(rgba)):
            luminance, p, alpha = _term(self.rules, number, rgba[block])
            if operator is not None:
                alpha_below = self.alpha[block]
                f_a, f_b = operator.factors(alpha, alpha_below)
                luminance = f_a * luminance + f_b * self.luminance[block]  # [R1]
                p = self.rules.add(f_a * p, f_b * self.p[:, block])  # Eq. 2 with ⊕
                alpha = operator.alpha(alpha, alpha_below)
            self.luminance[block], self.p[:, block], self.alpha[block] = luminance, p, alpha

    def result(self) -> Array:
        return _result(self.rules, self.luminance, self.p, self.alpha)


class FrontToBack:
    """Folds layers from the top, all `over`: beside them only the transmittance is kept."""

    def __init__(self, rules: StackRules, n_pixels: int, dtype: Any) -> None:
        self.rules = rules
        self.luminance, self.alpha = np.zeros((2, n_pixels), dtype)
        self.p = np.zeros((2, n_pixels), dtype)
        self.transmittance = np.ones(n_pixels, dtype)

    def add(self, number: int, rgba: Array) -> None:
        for block in _blocks(len(rgba)):
            luminance, p, alpha = _term(self.rules, number, rgba[block])
            weight = self.transmittance[block]
            self.luminance[block] += weight * luminance  # [R1]
            self.p[:, block] = self.rules.add(self.p[:, block], weight * p)
            self.alpha[block] += weight * alpha
            self.transmittance[block] *= 1 - alpha

    def result(self) -> Array:
        return _result(self.rules, self.luminance, self.p, np.minimum(self.alpha, 1))


class AllLayers:
    """Keeps every layer until all have come, then reduces the weighted terms in any order."""

    def __init__(self, rules: StackRules, n_pixels: int, dtype: Any) -> None:
        self.rules = rules
        self.layers: list[Array] = []

    def add(self, number: int, rgba: Array) -> None:
        self.layers.append(rgba)

    def result(self) -> Array:
        rgba = np.empty_like(self.layers[0])
        for block in _blocks(len(rgba)):
            rgba[block] = self._reduced([layer[block] for layer in self.layers])
        return rgba

    def _reduced(self, layers: list[Array]) -> Array:
        rules = self.rules
        terms = [_term(rules, number, rgba) for number, rgba in enumerate(layers)]
        alpha = terms[0][2]
        factors: list[tuple[Any, Any]] = [(1.0, 0.0)]
        for operator, (_, _, alpha_layer) in zip(rules.operators[1:], terms[1:], strict=True):
            assert operator is not None
            factors.append(operator.factors(alpha_layer, alpha))
            alpha = operator.alpha(alpha_layer, alpha)
        # w_i = F_A,i · Π F_B of the layers above: gathered from the top.
        above: Any = np.ones_like(alpha)
        weights = []
        for f_a, f_b in reversed(factors):
            weights.append(f_a * above)
            above = f_b * above
        weights.reverse()
        luminance = np.zeros_like(alpha)
        p = np.empty((len(terms), 2, len(alpha)), alpha.dtype)
        for number, (weight, (luminance_layer, p_layer, _)) in enumerate(
            zip(weights, terms, strict=True)
        ):
            luminance += weight * luminance_layer  # [R1]
            p[number] = weight * p_layer
        return _result(rules, luminance, rules.order.reduce(p, rules.add, rules.add_all), alpha)


def _blocks(n_pixels: int) -> Iterator[slice]:
    for begin in range(0, n_pixels, BLOCK_PIXELS):
        yield slice(begin, min(begin + BLOCK_PIXELS, n_pixels))


def _term(rules: StackRules, number: int, rgba: Array) -> tuple[Array, Array, Array]:
    """(Y, p, α) of layer `number` scaled by its opacity; rgba (n, 4) → (n), (2, n), (n)."""
    planes = np.ascontiguousarray(rgba.T)
    opacity = rules.opacities[number]
    if opacity != 1:
        planes = planes * opacity
    luminance, p = rules.space.forward(planes[:3])
    return luminance, p, planes[3]


def _result(rules: StackRules, luminance: Array, p: Array, alpha: Array) -> Array:
    """The reduced stack over its background and exposed, as RGBA (n, 4)."""
    rgba = np.empty((len(alpha), 4), alpha.dtype)
    for block in _blocks(len(alpha)):
        y_block, p_block, a_block = luminance[block], p[:, block], alpha[block]
        if rules.background is not None:
            colour = np.array(rules.background, alpha.dtype)[:, None]
            y_below, p_below = rules.space.forward(colour)
            uncovered = 1 - a_block
            y_block = y_block + uncovered * y_below
            p_block = rules.add(p_block, uncovered * p_below)
            a_block = np.ones_like(a_block)
        rgb = rules.space.inverse(y_block, p_block)
        if rules.exposure:
            rgb *= 2.0**rules.exposure
        rgba[block, :3] = rgb.T
        rgba[block, 3] = a_block
    return rgba
