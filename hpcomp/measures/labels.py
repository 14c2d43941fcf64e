"""What blending did to the labels of a stack, in numbers: measured pixel by pixel and summed.

A measure looks at the terms `t_i = w_i p_i` that a stack is reduced from, the background being one
more, and at the chroma p that came of them: before it is quantised, and before the exposure.
All tolerances are angles between p vectors. Sums are integers, so that parts of a picture that
begin at borders of cells add up to exactly the whole. No files here; planes first, as in `terms`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import partial, reduce
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..blending.addition import ROUNDING_ANGLE
from ..blending.orders import ORDERS
from ..blending.rules import Chroma, StackRules, stacked
from ..blending.terms import background_term, weighted
from ..color.gamut import colors_within
from ..color.planes import cross_and_dot, is_saturated, length, ratio, spread_and_size
from ..errors import SettingError
from ..geometry import Window
from .cells import Cells, cells_of, pixels_seen
from .defaults import (
    CELL,
    DEFAULT_ACHROMATIC,
    check_achromatic,
    check_energy_weights,
    check_foreign_tolerance,
)
from .histogram import LARGEST_ADDEND, SUM_UNIT

Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

#: Pixels with anything beyond this are left out, as NaN is: the square of it still is a float.
LARGEST_MEASURED = 2.0**60

#: Pixels that are measured at a time, so that their planes stay in cache.
BLOCK_PIXELS = 1 << 14

#: Half a code value of an 8-bit output, and of what counts as exact: 16 bits and floats.
HALF_STEP_8_BIT = 0.5 / 255
HALF_STEP_FINE = 0.5 / 65535

#: Share of each primary in the power of a white pixel of an emissive display: an estimate. Such
#: displays take power in proportion to linear RGB (Dong and Zhong 2012, Power Modeling and
#: Optimization for OLED Displays); the blue emitter needs most and the green one least on the
#: panels that were measured, how much so differs from panel to panel.
ENERGY_WEIGHTS = 0.30, 0.25, 0.45


def half_step(kind: str) -> float:
    """Half a step of an output whose samples are of that kind of `samples.OUTPUT_TYPES`."""
    return HALF_STEP_8_BIT if kind == "uint8" else HALF_STEP_FINE


@dataclass(frozen=True)
class MeasureSettings:
    """What counts in a measure.

    `half_step`: a term contributes, and a result has chroma, above this |p|. `achromatic`: a result
    of less saturation is grey. `foreign_tolerance`: in degrees; a hue that is farther from another
    is foreign to it.
    """

    half_step: float
    achromatic: float
    foreign_tolerance: float


def measure_settings(
    rules: StackRules,
    *,
    half_step: float = HALF_STEP_FINE,
    achromatic: float | None = None,
    foreign_tolerance: float | None = None,
) -> MeasureSettings:
    """The settings, checked; the foreign tolerance is 2τ of the stack if it is not given.

    At τ = 0 that is what rounding turns a hue by, and in some spaces the way back into gamut turns
    it as well. Errors: `SettingError`.
    """
    if achromatic is None:
        achromatic = DEFAULT_ACHROMATIC
    if foreign_tolerance is None:
        turn = max(2 * rules.hue_tolerance, math.degrees(ROUNDING_ANGLE))
        foreign_tolerance = turn + rules.space.gamut_turn
    if not 0 <= half_step <= 1:
        raise SettingError(f"half step {half_step:g} is outside 0 to 1")
    return MeasureSettings(
        float(half_step), check_achromatic(achromatic), check_foreign_tolerance(foreign_tolerance)
    )


# --- sums -----------------------------------------------------------------------------------------


#: The ways to reduce the terms that may be measured: the stack's own, and what it is compared with.
RESULTS = ("result", "traditional", "hue_preserving")


def results_of(found: Any) -> dict[str, Any]:
    """Those of its attributes `RESULTS` that are not None, by name."""
    return {name: of for name in RESULTS if (of := getattr(found, name)) is not None}


def share(part: float, whole: float) -> float:
    """part / whole, and 0 where there is nothing."""
    return part / whole if whole else 0.0


@dataclass(frozen=True)
class Sums:
    """Integers, tuples of them and other sums that add up field by field."""

    def __add__(self, other: Self) -> Self:
        if not isinstance(other, type(self)):
            return NotImplemented
        values = {}
        for field in fields(self):
            a, b = getattr(self, field.name), getattr(other, field.name)
            values[field.name] = _added(a, b)
        return type(self)(**values)


def _added(a: Any, b: Any) -> Any:
    if a is None or b is None:
        if a is not b:
            raise SettingError("measures of a woven stack and of another do not add up")
        return None
    if isinstance(a, tuple):
        return tuple(x + y for x, y in zip(a, b, strict=True))
    if isinstance(a, MeasureSettings):
        if a != b:
            raise SettingError(f"measures of {a} and of {b} do not add up")
        return a
    return a + b


@dataclass(frozen=True)
class ContributorMeasures(Sums):
    """What became of one layer, or of the background.

    `pixels`: where it contributes. `survived`: those of them where the result has its hue.
    `visible`: those in cells where a pixel survived, so that a reader finds it there.
    `chroma`: Σ|t| of all pixels, and `kept` what of it is in the result, in `SUM_UNIT`.
    """

    pixels: int = 0
    survived: int = 0
    visible: int = 0
    chroma: int = 0
    kept: int = 0

    @property
    def survived_share(self) -> float:
        """The share of its pixels in which its hue survived."""
        return share(self.survived, self.pixels)

    @property
    def visible_share(self) -> float:
        """The share of its pixels that lie in cells where it is seen."""
        return share(self.visible, self.pixels)

    @property
    def lost(self) -> float:
        """The share of its chroma that blending cancelled."""
        return share(self.chroma - self.kept, self.chroma)


@dataclass(frozen=True)
class ResultMeasures(Sums):
    """One way to reduce the terms, measured against them.

    `chromatic`: pixels that have a hue, `chroma` their Σ|p| in `SUM_UNIT`; `foreign` and
    `foreign_chroma`: those of them whose hue is nobody's. `layers`: bottom first. `background`:
    all 0 where there is none. `light`: Σ max(c, 0) over black of red, green and blue.
    """

    layers: tuple[ContributorMeasures, ...]
    background: ContributorMeasures = ContributorMeasures()
    chromatic: int = 0
    chroma: int = 0
    foreign: int = 0
    foreign_chroma: int = 0
    light: tuple[int, int, int] = (0, 0, 0)

    @property
    def foreign_share(self) -> float:
        """The share of chromatic pixels whose hue is nobody's."""
        return share(self.foreign, self.chromatic)

    @property
    def foreign_chroma_share(self) -> float:
        """The same, each pixel weighted by its chroma."""
        return share(self.foreign_chroma, self.chroma)

    @property
    def visible_share(self) -> float:
        """Of what all layers contribute to, pixel by pixel, the share in which they are seen."""
        visible, pixels = (
            sum(getattr(layer, name) for layer in self.layers) for name in ("visible", "pixels")
        )
        return share(visible, pixels)

    @property
    def lost(self) -> float:
        """Lost to grey: the share of all chroma that blending cancelled."""
        whole = sum(self.layers, self.background)
        return whole.lost

    def energy(self, weights: Sequence[float] = ENERGY_WEIGHTS) -> float:
        """An estimate of what an emissive display takes for the picture; 1 is a white pixel.

        `weights`: of red, green and blue, three numbers ≥ 0.
        """
        checked = check_energy_weights(weights)
        return SUM_UNIT * sum(w * c for w, c in zip(checked, self.light, strict=True))


@dataclass(frozen=True)
class StackMeasures(Sums):
    """The measures of a stack, of one picture or a part of it: `a + b` are those of both parts.

    Parts of one picture begin at borders of cells: a cell in two parts counts as two.
    `pixels`: all of them; `unmeasured`: with NaN, infinite or beyond `LARGEST_MEASURED`, left out
    of the rest. `result`: by the blending and order of the stack; `traditional`: by plain +.
    `order_sensitive`: chromatic pixels of which another layer survives top-down than bottom-up.
    `hue_preserving`: by ⊕, where the stack is woven; None elsewhere.
    """

    settings: MeasureSettings
    result: ResultMeasures
    traditional: ResultMeasures
    pixels: int = 0
    unmeasured: int = 0
    order_sensitive: int = 0
    hue_preserving: ResultMeasures | None = None

    @staticmethod
    def none(rules: StackRules, settings: MeasureSettings) -> StackMeasures:
        """The measures of no pixel, to add others to."""
        nothing = ResultMeasures((ContributorMeasures(),) * len(rules.operators))
        unwoven = None if unwoven_of(rules) is None else nothing
        return StackMeasures(settings, nothing, nothing, hue_preserving=unwoven)

    @property
    def results(self) -> dict[str, ResultMeasures]:
        """What there is of `RESULTS`, in their order."""
        return results_of(self)

    @property
    def order_sensitivity(self) -> float:
        """The share of chromatic pixels whose surviving layer depends on the order."""
        return share(self.order_sensitive, self.result.chromatic)


@dataclass(frozen=True)
class Provenance:
    """Where each pixel's hue comes from, planes of one shape.

    `layer`: uint32, the number plus 1 of the layer whose hue survived, 0 for none: that of the
    largest |t| among those within the foreign tolerance of the result. `grey`: 1 − |p| / Σ|t|, the
    share of chroma that is cancelled. `margin`: 1 − runner-up / winner, the runner-up being the
    largest |t| of another hue than the winner's, 0 where there is none: so 1 is unrivalled, and
    below 0 a stronger term was cancelled by others before it met the winner, or lay behind it. 0
    without a winner.
    """

    layer: NDArray[np.uint32]
    grey: Array
    margin: Array

    @staticmethod
    def none(shape: tuple[int, ...]) -> Provenance:
        """That of pixels in which nothing is."""
        return Provenance(
            np.zeros(shape, np.uint32), np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        )


def unwoven_of(rules: StackRules) -> StackRules | None:
    """The hue-preserving rules that a woven stack is compared with; None of any other stack."""
    return rules.blended("hue-preserving") if rules.blending.depends_on_place else None


# --- pixels ---------------------------------------------------------------------------------------


def measures_of(
    rules: StackRules,
    settings: MeasureSettings,
    layers: Sequence[Array] | Array,
    origin: tuple[int, int] = (0, 0),
) -> tuple[StackMeasures, Provenance]:
    """The measures of some rows of a picture, and their provenance (height, width).

    `layers`: (layers, height, width, 4) float32, linear, premultiplied, placed, alpha in [0, 1].
    `origin`: x and y of their first pixel, counted from the canvas' corner.
    """
    height, width = layers[0].shape[:2]
    provenance = Provenance.none((height, width))
    total = StackMeasures.none(rules, settings)
    for place, block in blocks_of(layers, origin):
        with np.errstate(all="ignore"):  # what is not finite is left out below
            pixels = contributors(rules, block, place)
        cells = cells_of(place)[pixels.known]
        measures, winners = _block_measures(rules, settings, pixels, cells)
        total += measures
        within = place.moved(-origin[0], -origin[1]).slices
        known = pixels.known.reshape(place.height, place.width)
        for name, values in vars(winners).items():
            getattr(provenance, name)[within][known] = values
    return total, provenance


def blocks_of(
    layers: Sequence[Array] | Array, origin: tuple[int, int]
) -> Iterator[tuple[Window, list[Array]]]:
    """Where each block lies, counted as `origin` is, and its (pixels, 4) of every layer.

    `layers`, `origin`: as in `measures_of`. A block has up to `BLOCK_PIXELS`,
    and begins at borders of cells.
    """
    height, width = layers[0].shape[:2]
    for place in Window(*origin, width, height).blocks(BLOCK_PIXELS, CELL):
        rows, columns = place.moved(-origin[0], -origin[1]).slices
        yield place, [layer[rows, columns].reshape(-1, 4) for layer in layers]


@dataclass(frozen=True)
class Contributors:
    """What the colours of some pixels are made of: the terms of the layers, then the background.

    `luminance` (terms, pixels) and `p` (terms, 2, pixels) hold the pixels that can be measured,
    `known` (all pixels) says which those are; `size` is |t|, (terms, pixels). The background is
    among them where the stack has one: `n_layers` counts those before it. `alpha` (all pixels): of
    the stack over its background. In a space that is not linear also their colours, `rgb`
    (terms, 3, pixels). `bounds`: the sum of their `gamut.bounds_of`, where results are bounded.
    `strength`: m (terms, pixels), None where it is |p|. `phase` (pixels): of the weave, where the
    blending depends on it.
    """

    n_layers: int
    luminance: Array
    p: Array
    size: Array
    known: Mask
    alpha: Array
    rgb: Array | None = None
    bounds: Array | None = None
    strength: Array | None = None
    phase: Array | None = None

    def chroma(self, number: int) -> Chroma:
        """That of one of the terms."""
        return Chroma(self.p[number], None if self.strength is None else self.strength[number])

    def total(self) -> Array:
        """Σ|t|, (pixels)."""
        return summed(self.size)

    def reduced(self, rules: StackRules, order: str | None = None) -> Array:
        """The chroma p (2, pixels) of the stack, in its own or another order."""
        if rules.blending_space is not rules.space:
            return self.plain(rules)
        row = rules.adding_order if order is None else ORDERS[order]
        at_once = rules.blending.depends_on_place  # then the background is among them
        terms = [self.chroma(number) for number in range(len(self.p))]
        first = len(terms) if at_once else self.n_layers
        sum_all = partial(rules.add_all, phase=self.phase)
        stack: Chroma = row.reduce(terms[:first], rules.add, sum_all)
        for below in terms[first:]:
            stack = rules.add(stack, below)
        if self.bounds is None or not len(self.bounds):
            return stack.p
        # What came of it, back in gamut.
        luminance = summed(self.luminance)
        plain = rules.space.inverse(luminance, stack.p) if self.rgb is None else summed(self.rgb)
        rgb = colors_within(rules.space, luminance, stack.p, plain, self.bounds)
        return rules.space.forward(rgb)[1]

    def plain(self, rules: StackRules) -> Array:
        """The chroma p (2, pixels) of plain +."""
        if self.rgb is None:
            return summed(self.p)
        return rules.space.forward(summed(self.rgb))[1]


def contributors(
    rules: StackRules, layers: Sequence[Array], window: Window | None = None
) -> Contributors:
    """The contributors to pixels of a stack; `layers`: (layers, pixels, 4) as in `measures_of`.

    `window`: those pixels on the canvas, where the blending depends on their place.
    """
    stack = weighted(rules, layers, rules.space)
    terms, alpha = list(stack.terms), stack.alpha
    if rules.background is not None:
        terms.append(background_term(rules, alpha, rules.space))
        alpha = np.ones_like(alpha)
    luminance, p = (np.stack([vars(term)[name] for term in terms]) for name in ("luminance", "p"))
    rgb = None if rules.space.linear else np.stack([term.rgb for term in terms])
    limits = summed(np.stack([term.bounds for term in terms]))
    strength = stacked([term.chroma for term in terms]).strength
    phase = None
    if rules.blending.depends_on_place and window is not None:
        phase = rules.weave.phases_in(window)
    known = np.logical_and(
        (np.abs(luminance) < LARGEST_MEASURED).all(axis=0),
        (np.abs(p) < LARGEST_MEASURED).all(axis=(0, 1)),
    )
    if not known.all():
        luminance, p, limits = luminance[:, known], p[:, :, known], limits[:, known]
        rgb = None if rgb is None else rgb[:, :, known]
        strength = None if strength is None else strength[:, known]
        phase = None if phase is None else phase[known]
    size = length(p.swapaxes(0, 1))
    return Contributors(
        len(stack.terms), luminance, p, size, known, alpha, rgb, limits, strength, phase
    )


def summed(values: Array) -> Array:
    """(terms, pixels) → (pixels), added from the bottom in the type of the values."""
    return reduce(np.add, values)


@dataclass(frozen=True)
class Angle:
    """A tolerance between two hues, compared by products: no arc is taken of any pixel."""

    sine: Any
    cosine: Any

    @staticmethod
    def of(degrees: float | NDArray[Any]) -> Angle:
        """The tolerance in degrees, 0 to 180: one number, or one for each pixel."""
        radians = np.radians(degrees)
        # At a half turn the sine is 0 by no rounding: every hue is within.
        sine = np.where(radians < math.pi, np.sin(radians), 0.0)
        return Angle(np.float32(sine), np.float32(np.cos(radians)))

    def holds(self, p1: Array, p2: Array) -> Mask:
        """Whether the hues of p1 and p2 (2, …) are no farther apart; true where one has none."""
        cross, dot = cross_and_dot(p1, p2)
        # sin(angle − tolerance) ≤ 0
        return cross * self.cosine <= dot * self.sine


@dataclass(frozen=True)
class Support:
    """How the contributors stand to a result p (2, pixels), pixel by pixel.

    `size`: |p|. `near` (terms, pixels): whose hue is that of p, within the tolerance. `backing`:
    Σ|t| of those. `has_hue`: whether p and its backing are above half a step, so that the hue is
    somebody's; layers of one hue count together.
    """

    size: Array
    near: Mask
    backing: Array
    has_hue: Mask

    @staticmethod
    def of(p: Array, pixels: Contributors, settings: MeasureSettings) -> Support:
        tolerance = Angle.of(settings.foreign_tolerance)
        size = length(p)
        near = np.array([tolerance.holds(p, term) for term in pixels.p])
        backing = summed(np.where(near, pixels.size, np.float32(0)))
        has_hue = (size > settings.half_step) & (backing > settings.half_step)
        return Support(size, near, backing, has_hue)

    def winner(self, pixels: Contributors, half_step: float) -> NDArray[np.int64]:
        """The number of the layer whose hue survived, −1 for none; the lower of two equal ones.

        None survived where the hue is the background's alone.
        """
        n = pixels.n_layers
        theirs = np.where(self.near[:n], pixels.size[:n], np.float32(0))
        survived = self.has_hue & (summed(theirs) > half_step)
        return np.where(survived, theirs.argmax(axis=0), -1)


def _block_measures(
    rules: StackRules, settings: MeasureSettings, pixels: Contributors, cells: Cells
) -> tuple[StackMeasures, Provenance]:
    def measured(p: Array) -> tuple[Support, ResultMeasures, Mask]:
        support = Support.of(p, pixels, settings)
        return support, *_result_measures(rules, settings, pixels, cells, p, support)

    support, result, chromatic = measured(pixels.reduced(rules))
    _, traditional, _ = measured(pixels.plain(rules))
    hue_preserving = None
    if (unwoven := unwoven_of(rules)) is not None:
        _, hue_preserving, _ = measured(pixels.reduced(unwoven))
    sensitive = 0
    if rules.blending.depends_on_order:
        upward, downward = (
            (
                support
                if rules.order is ORDERS[order]
                else Support.of(pixels.reduced(rules, order), pixels, settings)
            ).winner(pixels, settings.half_step)
            for order in ("bottom-up", "top-down")
        )
        sensitive = count(chromatic & (upward != downward))
    measures = StackMeasures(
        settings,
        result,
        traditional,
        pixels=pixels.known.size,
        unmeasured=count(~pixels.known),
        order_sensitive=sensitive,
        hue_preserving=hue_preserving,
    )
    return measures, _provenance(settings, pixels, support)


def _result_measures(
    rules: StackRules,
    settings: MeasureSettings,
    pixels: Contributors,
    cells: Cells,
    p: Array,
    support: Support,
) -> tuple[ResultMeasures, Mask]:
    """The measures of the result p (2, pixels), and which pixels are chromatic."""
    rgb = rules.space.inverse(summed(pixels.luminance), p)
    chromatic = (support.size > settings.half_step) & is_saturated(
        *spread_and_size(rgb), settings.achromatic
    )
    foreign = chromatic & ~support.has_hue
    # Those of the surviving hue share what is left of it; what goes beyond them, as + makes it, is
    # the others'. So the losses of all add up to Σ|t| − |p|, and none is below 0.
    of_near = _part(support.size, support.backing)
    of_others = _part(support.size - support.backing, pixels.total() - support.backing)
    rows = []
    for size, near in zip(pixels.size, support.near, strict=True):
        contributes = size > settings.half_step
        survives = contributes & chromatic & near
        rows.append(
            ContributorMeasures(
                pixels=count(contributes),
                survived=count(survives),
                visible=pixels_seen(contributes, survives, cells),
                chroma=in_units(size),
                kept=in_units(size * np.where(near, of_near, of_others)),
            )
        )
    red, green, blue = (in_units(np.maximum(channel, 0)) for channel in rgb)
    measures = ResultMeasures(
        tuple(rows[: pixels.n_layers]),
        rows[-1] if len(rows) > pixels.n_layers else ContributorMeasures(),
        chromatic=count(chromatic),
        chroma=in_units(support.size[chromatic]),
        foreign=count(foreign),
        foreign_chroma=in_units(support.size[foreign]),
        light=(red, green, blue),
    )
    return measures, chromatic


def _provenance(settings: MeasureSettings, pixels: Contributors, support: Support) -> Provenance:
    winner = support.winner(pixels, settings.half_step)
    there = winner >= 0
    columns = np.arange(len(winner))
    of_winner = pixels.size[winner, columns]
    p_winner = pixels.p[winner, :, columns].T
    tolerance = Angle.of(settings.foreign_tolerance)
    rivals = np.array([~tolerance.holds(p_winner, term) for term in pixels.p])
    runner_up = np.where(rivals, pixels.size, np.float32(0)).max(axis=0)
    margin = np.zeros_like(of_winner)
    np.divide(runner_up, of_winner, out=margin, where=there)
    total = pixels.total()
    return Provenance(
        layer=(winner + 1).astype(np.uint32),
        grey=np.where(total > 0, 1 - _part(support.size, total), np.float32(0)),
        margin=np.where(there, 1 - margin, np.float32(0)),
    )


def _part(numerator: Array, denominator: Array) -> Array:
    """numerator / denominator within [0, 1], and 0 where the denominator is 0."""
    quotient = ratio(numerator, denominator)
    return np.clip(quotient, 0, 1, out=quotient)


def count(mask: Mask) -> int:
    return int(np.count_nonzero(mask))


def in_units(values: Array) -> int:
    """The sum of values ≥ 0 in `SUM_UNIT`, each rounded and no more than `LARGEST_ADDEND`."""
    units = np.rint(np.minimum(values, np.float32(LARGEST_ADDEND)) * np.float32(1 / SUM_UNIT))
    return int(units.astype(np.int64).sum())
