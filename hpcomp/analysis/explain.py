"""One pixel of a stack, step by step: what went in, who met whom, what came out. Prints nothing."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from ..blending.addition import chroma, competing, shoulder, strongest_rivals
from ..blending.blendings import BLENDINGS
from ..blending.rules import Chroma, StackRules, stacked
from ..blending.terms import background_term, weighted
from ..blending.weaving import Threads, one_hue
from ..color.planes import cross_and_dot
from ..color.quantization import Losses
from ..color.samples import OUTPUT_TYPES, Rgba, Strip, linear_rgba, spread
from ..engine import choice as engine
from ..errors import MismatchError, SettingError
from ..geometry import FARTHEST, Window, integers
from ..imagefile.source import codec_threads
from ..layers.budget import THREAD_BYTES, Budget, share_out
from ..layers.canvas import output_window
from ..layers.layerspec import LayerSpec
from ..layers.notices import Notices, warn_of_outside, warn_of_samples
from ..layers.placing import Layer, PlacedLayer, layer_specs, opened_stack, rules_of
from ..measures.labels import (
    Contributors,
    MeasureSettings,
    Support,
    contributors,
    measure_settings,
    measures_of,
)
from ..options import OPTIONS, ResourceOptions, StackOptions, takes_options
from ..system.threads import ThreadPipeline, thread_count

if TYPE_CHECKING:
    from ..keywords import StackKeywords

log = logging.getLogger("hpcomp")

Array = NDArray[np.floating[Any]]

#: The name of a sample's type, as `--depth` and `info` have it.
_TYPE_NAMES = {np.dtype(kind): name for name, kind in OUTPUT_TYPES.items()}

#: What becomes of the hues of a pixel: `layer` and `background` say whose hue it has, `foreign`
#: that it is nobody's, `grey` that they cancel, `colorless` that there was none, `unmeasured` that
#: there are numbers without a hue, NaN for one.
OUTCOMES = ("layer", "background", "foreign", "grey", "colorless", "unmeasured")


#: What rounding may take of a chroma, in parts of it and of the luminance together.
ROUNDING = 1e-5


@dataclass(frozen=True)
class LayerStep:
    """What one layer brings to the pixel.

    `stored`: the samples of the file, of type `stored_type`; None where the layer has no pixel.
    `rgba`: linear, premultiplied, before its opacity. `weight`: what the operators leave of it.
    `hue`: degrees on the axis of the space, None for a grey. `chroma`: |p| of `rgba`;
    `weighted_chroma`: that times opacity and weight, which is what takes part in the blending.
    `weighted_strength`: m, weighted likewise, which is what competes; None where it is |p|.
    """

    number: int
    label: str
    stored: tuple[float, ...] | None
    stored_type: str
    rgba: tuple[float, ...]
    opacity: float
    operator: str | None
    weight: float
    hue: float | None
    chroma: float
    weighted_chroma: float
    weighted_strength: float | None = None


@dataclass(frozen=True)
class BackgroundStep:
    """What the background brings: straight linear `rgb`, the rest as of a layer."""

    rgb: tuple[float, ...]
    weight: float
    hue: float | None
    chroma: float
    weighted_chroma: float
    weighted_strength: float | None = None


@dataclass(frozen=True)
class Meeting:
    """Two colours that were added: those of the layers `first`, and of `second`, numbers each.

    The background is None among them. `chroma_first`, `chroma_second`: |p| before. `angle`:
    degrees between them, None where one has no hue. `equality`: e of the shoulder, 1 for equal
    hues and 0 for different ones, None where hues are not looked at. `dominant`: 1 or 2, None
    where neither is or their hues are equal; with `foremost` the one in front. `chroma`, `hue`: of
    what comes of it. `strength_first`, `strength_second`, `strength`: m of the same, None where
    that is |p|.
    """

    first: tuple[int | None, ...]
    second: tuple[int | None, ...]
    chroma_first: float
    chroma_second: float
    angle: float | None
    equality: float | None
    dominant: int | None
    chroma: float
    hue: float | None
    strength_first: float | None = None
    strength_second: float | None = None
    strength: float | None = None


@dataclass(frozen=True)
class Rivalry:
    """What is left of a layer among all others at once: `share` of it, because of `rival`.

    `angle`: degrees to the strongest rival; None, as `rival`, where the layer meets none.
    """

    number: int
    share: float
    rival: int | None
    angle: float | None


@dataclass(frozen=True)
class Thread:
    """A colour whose hue a woven stack shows: of a layer, or of the background, None.

    `hue`: in degrees. `chroma`: weighted. `share`: of the strength of all, so of the phases, which
    are those from `begin` on.
    """

    number: int | None
    hue: float | None
    chroma: float
    share: float
    begin: float


@dataclass(frozen=True)
class Weaving:
    """How a pattern chose the hue of the pixel.

    `phase`: u, in [0, 1). `threads`: sorted by hue, as phases are. `chosen`: whose thread it is,
    several where their hues are one. `one_hue`: whether no other colour has another hue, which is
    plain +. `bound`: the share of the chroma for which the gamut has no room at this luminance.
    """

    phase: float
    threads: tuple[Thread, ...]
    chosen: tuple[int | None, ...]
    one_hue: bool
    bound: float

    @property
    def share(self) -> float:
        """What the chosen thread has of the strength of all."""
        return math.fsum(thread.share for thread in self.threads if thread.number in self.chosen)


@dataclass(frozen=True)
class Outcome:
    """What came of the pixel, and of the hues that went in.

    `rgba`: linear, premultiplied, with the exposure, as a float file would hold it. `srgb`: the
    codes of an 8-bit PNG, straight, with alpha. `hue`, `chroma`: before the exposure. `kind`: one
    of `OUTCOMES`. `survivor`: the number of the layer whose hue it is. `grey`, `margin`: as in
    `measures.Provenance`.
    """

    rgba: tuple[float, ...]
    srgb: tuple[int, ...]
    hue: float | None
    chroma: float
    kind: str
    survivor: int | None
    grey: float
    margin: float


@dataclass(frozen=True)
class PixelExplanation:
    """How one pixel of a stack comes about.

    `rivalries` are of the order `simultaneous`, `meetings` of the others, and of the background.
    `weaving` is of a woven stack, which has neither; None elsewhere, and where a value has no hue.
    """

    x: int
    y: int
    canvas: Window
    rules: StackRules
    settings: MeasureSettings
    layers: tuple[LayerStep, ...]
    background: BackgroundStep | None
    meetings: tuple[Meeting, ...]
    rivalries: tuple[Rivalry, ...]
    result: Outcome
    traditional: Outcome
    weaving: Weaving | None = None


def parse_pixel(text: str) -> tuple[int, int]:
    """A pixel of the canvas from `X,Y`; `SettingError` otherwise."""
    try:
        x, y = (int(number) for number in text.split(","))
    except ValueError:
        numbers = integers(text) or ()
        example = ",".join(map(str, numbers)) if len(numbers) == 2 else "120,45"
        raise SettingError(f"'{text}' is not a pixel: write X,Y, such as {example}") from None
    if max(abs(x), abs(y)) > FARTHEST:
        raise SettingError(f"pixel '{text}' is beyond {FARTHEST} pixels")
    return x, y


@takes_options(*OPTIONS)
def explain(
    layers: Sequence[Layer],
    at: str | tuple[int, int],
    asked: StackOptions | None = None,
    **options: Unpack[StackKeywords],
) -> PixelExplanation:
    """Says how one pixel of `stack` comes about, reading no more rows than that needs.

    `layers`: as in `stack`, whose options mean the same: those that change no pixel, such as
    `compression`, change nothing here. `threads` and `max_memory` are what the reading may take.
    `at`: the pixel, `X,Y` or two ints, in coordinates of the canvas. `foreign_tolerance`: degrees
    between p vectors within which a hue is a layer's, twice the hue tolerance if not given and the
    space's `gamut_turn` more.
    Returns: the `PixelExplanation`, its colours linear and premultiplied.
    Errors: `SettingError`, `InputError`, `MismatchError` for a pixel outside the canvas.
    Warnings: `HpcompWarning`; errors with `strict`.
    """
    specs = layer_specs(layers)
    checked = StackOptions.of(options, base=asked)
    rules = rules_of(specs, checked.rules)
    settings = measure_settings(
        rules,
        achromatic=checked.reports.achromatic,
        foreign_tolerance=checked.reports.foreign_tolerance,
    )
    x, y = parse_pixel(at) if isinstance(at, str) else at
    notices = Notices(checked.rules.strict)
    with opened_stack(specs, rules, checked, notices) as stack:
        rules = stack.rules
        window = output_window(
            stack.canvas, [layer.window for layer in stack.layers], checked.canvas
        )
        places = [spec.placement for spec in specs]
        warn_of_outside(places, stack.layers, stack.canvas, stack.canvas, notices)
        if not window.contains(Window(x, y, 1, 1)):
            raise MismatchError(
                f"pixel {x},{y} is outside the canvas {window}: choose one within it"
            )
        strips = _stored(stack.layers, x, y, rules, checked.resources)
        pixels = [_linear(strip) for strip in strips]
        warn_of_samples([layer.reader for layer in stack.layers], notices)
    place = Window(x - stack.canvas.x, y - stack.canvas.y, 1, 1)
    trace = _Trace(rules, pixels)
    return PixelExplanation(
        x=x,
        y=y,
        canvas=stack.canvas,
        rules=rules,
        settings=settings,
        layers=_layer_steps(specs, rules, strips, pixels),
        background=_background_step(rules, pixels),
        meetings=tuple(trace.meetings),
        rivalries=tuple(trace.rivalries),
        result=_outcome(rules, settings, strips, pixels, place),
        traditional=_outcome(rules.blended("traditional"), settings, strips, pixels, place),
        weaving=_weaving(rules, pixels, place),
    )


def _stored(
    layers: Sequence[PlacedLayer], x: int, y: int, rules: StackRules, granted: ResourceOptions
) -> list[Strip]:
    """One pixel as the layers' files hold it, read side by side within what is granted.

    Errors: `MismatchError` where that is too little.
    """
    readers = [layer.reader for layer in layers]

    def budget(threads: int) -> Budget:
        return Budget(
            # As many as a file holds together, where its codec unpacks these.
            per_row=threads * max(reader.bytes_per_row for reader in readers),
            fixed=sum(reader.bytes_held for reader in readers)
            + threads * (max(reader.bytes_to_decode for reader in readers) + THREAD_BYTES)
            + engine.reference_engine().bytes_to_reduce(rules, len(readers)),
        )

    block = max(reader.rows_at_once for reader in readers)
    useful = replace(granted, threads=min(thread_count(granted.threads), len(layers)))
    threads, _ = share_out(readers, block, useful, budget, "this pixel")
    log.info("reading a pixel of %d layers, %d threads", len(layers), threads)
    reads = ((number, partial(_pixel_of, layer, x, y)) for number, layer in enumerate(layers))
    with (
        codec_threads(readers, reading=1, writing=1),
        ThreadPipeline[Strip](threads) as pipeline,
    ):
        return list(pipeline.read_ahead(reads))


def _pixel_of(layer: PlacedLayer, x: int, y: int) -> Strip:
    """One pixel as a layer's file holds it; a strip without samples where it has none."""
    strip = layer.read_checked(Window(x, y, 1, 1))
    return replace(strip, samples=strip.samples.copy())  # its row is not kept


def _linear(strip: Strip) -> Rgba:
    """(1, 4): linear, premultiplied RGBA of that pixel."""
    rgba, _ = linear_rgba(strip)
    return spread(rgba, 0, 0, 1, 1)


def _layer_steps(
    specs: Sequence[LayerSpec],
    rules: StackRules,
    strips: Sequence[Strip],
    pixels: Sequence[Rgba],
) -> tuple[LayerStep, ...]:
    with np.errstate(all="ignore"):  # a pixel that is let through as it is may be NaN
        stack = weighted(rules, pixels, rules.space)
        steps = []
        for number, (spec, strip, rgba) in enumerate(zip(specs, strips, pixels, strict=True)):
            luminance, p = rules.space.forward(rgba.T[:3])
            there = strip.samples.size > 0
            operator = rules.operators[number]
            steps.append(
                LayerStep(
                    number=number,
                    label=spec.label(number),
                    stored=tuple(strip.samples[0, 0].tolist()) if there else None,
                    stored_type=_TYPE_NAMES[strip.samples.dtype] if there else "",
                    rgba=tuple(rgba[0].tolist()),
                    opacity=rules.opacities[number],
                    operator=None if operator is None else operator.name,
                    weight=float(stack.weights[number, 0]),
                    hue=_hue(rules, luminance, p),
                    chroma=_size(p),
                    weighted_chroma=_size(stack.terms[number].p),
                    weighted_strength=_strength(stack.terms[number].strength),
                )
            )
    return tuple(steps)


def _background_step(rules: StackRules, pixels: Sequence[Rgba]) -> BackgroundStep | None:
    if rules.background is None:
        return None
    with np.errstate(all="ignore"):
        alpha = weighted(rules, pixels, rules.space).alpha
        term = background_term(rules, alpha, rules.space)
    weight = float(1 - alpha[0])
    luminance, p = rules.space.forward(np.array(rules.background, np.float32)[:, None])
    return BackgroundStep(
        rgb=rules.background,
        weight=weight,
        hue=_hue(rules, luminance, p),
        chroma=_size(p),
        weighted_chroma=weight * _size(p),
        weighted_strength=_strength(term.strength),
    )


def _size(p: Array) -> float:
    """|p| of the one pixel of p (2, 1)."""
    return float(chroma(p)[0])


def _strength(m: Array | None) -> float | None:
    """The strength of the one pixel of m (1)."""
    return None if m is None else float(m[0])


def _hue(rules: StackRules, luminance: Array, p: Array) -> float | None:
    """The hue in degrees of one pixel, Y (1) and p (2, 1); None for a grey."""
    if not 0 < _size(p) < math.inf:
        return None
    rgb = rules.space.inverse(luminance, p)
    if not np.isfinite(rgb).all() or rgb.max() == rgb.min():
        return None
    return float(rules.space.hue_axis.degrees(rgb.astype(np.float64))[0])


def _degrees_between(p1: Array, p2: Array) -> float | None:
    """The angle of two p (2, 1), in degrees; None where one has no hue."""
    if not (p1.any() and p2.any()):
        return None
    cross, dot = cross_and_dot(p1[:, 0].astype(np.float64), p2[:, 0].astype(np.float64))
    return math.degrees(math.atan2(cross, dot))  # not numpy's, which rounds as the processor does


# --- who met whom ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Party:
    """Colours that were added so far: whose, their Y (1), p (2, 1) with its strength, and where p
    is not linear in it RGB (3, 1).
    """

    numbers: tuple[int | None, ...]
    luminance: Array
    chroma: Chroma
    rgb: Array | None

    @property
    def p(self) -> Array:
        return self.chroma.p

    @property
    def strength(self) -> float | None:
        return _strength(self.chroma.strength)


@dataclass
class _Trace:
    """Reduces the terms as the stack does, and writes down each step."""

    rules: StackRules
    pixels: Sequence[Rgba]
    meetings: list[Meeting] = field(default_factory=list)
    rivalries: list[Rivalry] = field(default_factory=list)

    def __post_init__(self) -> None:
        with np.errstate(all="ignore"):
            contributing = contributors(self.rules, self.pixels)
        if self.rules.blending.depends_on_place or not contributing.known.all():
            return
        parties = [
            _Party(
                (number,),
                luminance,
                contributing.chroma(number),
                None if contributing.rgb is None else contributing.rgb[number],
            )
            for number, luminance in enumerate(contributing.luminance)
        ]
        # The orders reduce whatever can be added: here, parties instead of arrays.
        terms: Any = parties[: contributing.n_layers]
        add: Any = self._meet
        add_all: Any = self._meet_all
        stack: Any = self.rules.adding_order.reduce(terms, add, add_all)
        if contributing.n_layers < len(parties):
            self._meet(stack, replace(parties[-1], numbers=(None,)))

    @property
    def _keeps_hues(self) -> bool:
        return self.rules.blending is BLENDINGS["hue-preserving"]

    def _meet(self, a: _Party, b: _Party) -> _Party:
        rules = self.rules
        added, rgb = rules.add(a.chroma, b.chroma), None
        if a.rgb is not None and b.rgb is not None and rules.blending_space is not rules.space:
            # Plain + of colours, whose p do not add in this space.
            rgb = a.rgb + b.rgb
            added = added._replace(p=rules.space.forward(rgb)[1])
        both = _Party(a.numbers + b.numbers, a.luminance + b.luminance, added, rgb)
        angle = _degrees_between(a.p, b.p)
        equality = dominant = None
        if self._keeps_hues and angle is not None:
            equality = float(shoulder(a.p, b.p, rules.hue_tolerance)[0])
            first, second = competing(*stacked((a.chroma, b.chroma)))[:, 0]
            if equality < 1 and first != second:
                dominant = 1 if first > second else 2
        elif rules.blending.depends_on_depth and angle is not None:
            dominant = 1
        self.meetings.append(
            Meeting(
                first=a.numbers,
                second=b.numbers,
                chroma_first=_size(a.p),
                chroma_second=_size(b.p),
                angle=angle,
                equality=equality,
                dominant=dominant,
                chroma=_size(both.p),
                hue=_hue(rules, both.luminance, both.p),
                strength_first=a.strength,
                strength_second=b.strength,
                strength=both.strength,
            )
        )
        return both

    def _meet_all(self, parties: Sequence[_Party]) -> _Party:
        rules = self.rules
        terms = [party.chroma for party in parties]
        numbers = tuple(number for party in parties for number in party.numbers)
        luminance = np.sum([party.luminance for party in parties], axis=0)
        if self._keeps_hues:
            self._note_rivals(stacked(terms))
        return _Party(numbers, luminance, rules.add_all(terms), None)

    def _note_rivals(self, terms: Chroma) -> None:
        p, rules = terms.p, self.rules
        with_hue = [number for number in range(len(p)) if _size(p[number]) > 0]
        if not with_hue:
            return
        m = competing(*terms)
        shares, rivals = strongest_rivals(
            p[with_hue, :, 0].T, rules.hue_tolerance, rules.gray_bias, m[with_hue, 0]
        )
        for number, share, strongest in zip(with_hue, shares, rivals, strict=True):
            rival = with_hue[int(strongest)] if share > 0 else None
            self.rivalries.append(
                Rivalry(
                    number=number,
                    share=float(1 - share),
                    rival=rival,
                    angle=None if rival is None else _degrees_between(p[number], p[rival]),
                )
            )


def _weaving(rules: StackRules, pixels: Sequence[Rgba], place: Window) -> Weaving | None:
    if not rules.blending.depends_on_place:
        return None
    with np.errstate(all="ignore"):
        terms = contributors(rules, pixels, place)
    if terms.phase is None or not terms.known.all():
        return None
    phase, shown = terms.phase, Threads.of(terms.p, terms.strength)
    order = [number for number in shown.order[:, 0].tolist() if shown.m[number, 0] > 0]
    names = {number: number if number < terms.n_layers else None for number in order}
    begins = dict(zip(shown.order[1:, 0].tolist(), shown.reached[:-1, 0].tolist(), strict=True))
    p_thread = terms.p[int(shown.at(phase)[0])]
    own = one_hue(p_thread, terms.p.swapaxes(0, 1))[:, 0]
    return Weaving(
        phase=float(phase[0]),
        threads=tuple(
            Thread(
                number=names[number],
                hue=_hue(rules, terms.luminance[number], terms.p[number]),
                chroma=_size(terms.p[number]),
                share=float(shown.shares[number, 0]),
                begin=begins.get(number, 0.0) / float(shown.whole[0]),
            )
            for number in order
        ),
        chosen=tuple(names[number] for number in sorted(order) if own[number]),
        one_hue=bool((own | (terms.size[:, 0] == 0)).all()),
        bound=_bound(rules, terms),
    )


def _bound(rules: StackRules, terms: Contributors) -> float:
    """The share of the chroma that is beyond the gamut, but for rounding."""
    everything = [terms.chroma(number) for number in range(len(terms.p))]
    sought = _size(rules.add_all(everything, terms.phase).p)
    beyond = sought - _size(terms.reduced(rules))
    return beyond / sought if beyond > ROUNDING * (sought + abs(terms.luminance.sum())) else 0.0


# --- what came out --------------------------------------------------------------------------------


def _outcome(
    rules: StackRules,
    settings: MeasureSettings,
    strips: Sequence[Strip],
    pixels: Sequence[Rgba],
    place: Window,
) -> Outcome:
    """What came of the pixel; `place`: as it is counted from the corner of the canvas."""
    rgba = tuple(_composite(rules, strips, "float", place).tolist())
    srgb = tuple(_composite(rules, strips, "uint8", place).tolist())
    with np.errstate(all="ignore"):
        contributing = contributors(rules, pixels, place)
    if not contributing.known.all():
        return Outcome(rgba, srgb, None, math.nan, "unmeasured", None, 0.0, 0.0)
    p = contributing.reduced(rules)
    support = Support.of(p, contributing, settings)
    winner = int(support.winner(contributing, settings.half_step)[0])
    _, provenance = measures_of(
        rules,
        settings,
        [np.asarray(pixel).reshape(1, 1, 4) for pixel in pixels],
        (place.x, place.y),
    )
    if not contributing.total()[0] > settings.half_step:
        kind = "colorless"
    elif not support.size[0] > settings.half_step:
        kind = "grey"
    elif not support.has_hue[0]:
        kind = "foreign"
    else:
        kind = "layer" if winner >= 0 else "background"
    return Outcome(
        rgba=rgba,
        srgb=srgb,
        hue=_hue(rules, contributing.luminance.sum(axis=0), p),
        chroma=_size(p),
        kind=kind,
        survivor=winner if winner >= 0 else None,
        grey=float(provenance.grey[0, 0]),
        margin=float(provenance.margin[0, 0]),
    )


def _composite(
    rules: StackRules, strips: Sequence[Strip], kind: str, place: Window
) -> NDArray[Any]:
    """The pixel by the active engine, as an output of that kind holds it: (4)."""
    accumulator = engine.start(rules, 1, 1, origin=(place.x, place.y))
    for number in rules.arrival:
        accumulator.add([number], [strips[number]])
    return accumulator.result(kind, Losses())[0, 0]
