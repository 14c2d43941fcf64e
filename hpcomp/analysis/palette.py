"""What labels blend to: every pair over opacity, all their mixtures, what may go wrong.

All colours come from compositing arrays by the rules of a stack. No text, no pictures.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..blending.addition import chroma, shoulder
from ..blending.blendings import BLENDINGS
from ..blending.rules import StackRules
from ..blending.weaving import Threads, Weave
from ..color.css import css_color, css_title
from ..color.difference import contrast, difference
from ..color.planes import cross_and_dot, is_saturated, saturation, spread_and_size
from ..engine.arrays import composite
from ..errors import MismatchError, SettingError
from ..geometry import Window
from ..layers.layerspec import LayerSpec
from ..layers.placing import Layer
from ..measures.defaults import DEFAULT_ACHROMATIC
from ..measures.labels import contributors, measure_settings, summed
from ..options import ResourceOptions, RuleOptions, older_spelling, stack_rules
from ..system.streams import STDIN, STDOUT
from .hues import images_to_measure, read_hues

Floats = NDArray[np.floating[Any]]
Color = str | Sequence[float]

TRADITIONAL = "traditional"

#: Fewer make no pair, and of more nobody could tell the hues.
FEWEST_LABELS, MOST_LABELS = 2, 24

#: Opacities at which a pair is blended: a power of two and one, so that every eighth is among them.
PROFILE_STEPS = 257
#: How the opacity of least chroma is narrowed down: so often, each time by so many steps.
_ROUNDS, _ROUND_STEPS = 4, 33

#: Above what rounding leaves of a share of chroma that is all there.
_ALL = 1 - 1e-6

#: Hues nearer than this, in degrees, are hard to tell apart once blending has made them pale.
DEFAULT_CLOSE_HUES = 15.0
#: How opaque labels are when it is asked whether they vanish.
DEFAULT_OPACITY = 0.5
#: Labels that differ less than this from their background vanish: in Oklab, where 0.02 is what is
#: just noticeable of two plain colours side by side, and labels are thin, small and apart.
DEFAULT_LEAST_DIFFERENCE = 0.1
#: A front label that turns the one behind it grey at less opacity than this drowns it.
DEFAULT_GREY_OPACITY = 0.25

#: Weights of three colours at a time are multiples of one over this, for few labels and for many.
_MIXTURE_STEPS, _FEWER_MIXTURE_STEPS, _MANY_TRIPLES = 240, 120, 60

#: What may be wrong with labels, in the order in which it is said.
FINDING_KINDS = ("no-hue", "close-hues", "vanishes", "hue-lost", "goes-grey")


@dataclass(frozen=True)
class Label:
    """One label of a palette: its `name`, and its colour `rgb`, straight and linear.

    `hue`: degrees on the axis of the space, None for a grey. `chroma`: |p|. `luminance`: Y.
    """

    name: str
    rgb: tuple[float, float, float]
    hue: float | None
    chroma: float
    luminance: float


@dataclass(frozen=True, eq=False)
class Thread:
    """What a woven blend shows of one of two labels, over the opacities of a `Profile`.

    `label`: its number. `rgb` (steps, 3): linear. `hues` (steps,): degrees, NaN where grey.
    `share` (steps,): of the pixels.
    """

    label: int
    rgb: Floats
    hues: Floats
    share: Floats


@dataclass(frozen=True, eq=False)
class Profile:
    """One label over another, both opaque, while the front one's opacity goes from 0 to 1.

    `rgb` (steps, 3): linear. `hues` (steps,): degrees, NaN where grey. `foreign`, `grey`: the
    shares of opacities at which the hue is neither label's, and at which there is none. `left`:
    the chroma at its least, as a share of what the two bring there; None where they bring none.
    `least_at`: the opacity of that, None where nothing is lost; `turns_grey`: whether it is a grey.
    `threads`: of a woven blend, in the order of their phases. Then `rgb` and `hues` are of the mean
    of the pixels, as it is seen from afar, and all else is of the threads: chroma is the mean of
    theirs, a foreign hue is that of any, and a grey one that of both.
    """

    rgb: Floats
    hues: Floats
    foreign: float
    grey: float
    left: float | None
    least_at: float | None
    turns_grey: bool
    threads: tuple[Thread, ...] = ()


@dataclass(frozen=True, eq=False)
class Pair:
    """The label `front` over the label `back`, numbers both, in both ways of blending.

    `angle`: degrees between their p vectors, None where one is grey. `equality`: how far blending
    takes their hues for one, 0 to 1; woven, it tells all hues apart that are not equal.
    """

    back: int
    front: int
    angle: float | None
    equality: float
    result: Profile
    traditional: Profile


@dataclass(frozen=True)
class OnBackground:
    """A label at the opacity of the settings over the background, blended in one way.

    `rgb`: linear. `difference`: from the background, in Oklab. `contrast`: of luminances, 1 to 21.
    `keeps_hue`: whether the hue is the label's; None where the label has none. `share`: of the
    pixels that look so, where the blend is woven with a background that has a hue; else 1.
    """

    rgb: tuple[float, float, float]
    difference: float
    contrast: float
    keeps_hue: bool | None
    share: float = 1.0


@dataclass(frozen=True)
class Finding:
    """Something that may be wrong: one of `FINDING_KINDS`, of these labels, by number.

    `blendings`: the ways of blending in which it is so. `measured`: what is beyond the `limit`.
    Of `goes-grey` the first label is the back one.
    """

    kind: str
    labels: tuple[int, ...]
    blendings: tuple[str, ...]
    measured: float
    limit: float


@dataclass(frozen=True)
class PaletteSettings:
    """What findings are measured by; see `palette`."""

    background: tuple[float, float, float]
    opacity: float
    close_hues: float
    least_difference: float
    grey_opacity: float
    achromatic: float
    foreign_tolerance: float


@dataclass(frozen=True, eq=False)
class Palette:
    """What labels blend to, as `palette` found.

    `background`: as a label of that name. `rules`: those that were given, by name. `stack`: the
    same and the others, looked up. `pairs`: every label over every other. `on_background`: of each
    label, by the name of the blending.
    """

    labels: tuple[Label, ...]
    background: Label
    rules: Mapping[str, Any]
    stack: StackRules
    settings: PaletteSettings
    pairs: tuple[Pair, ...]
    on_background: tuple[Mapping[str, OnBackground], ...]
    findings: tuple[Finding, ...]

    @property
    def blending(self) -> str:
        """The blending that is compared with the traditional one."""
        return self.stack.blending.name

    def pair(self, back: int, front: int) -> Pair:
        """The pair of these labels, by number."""
        return next(p for p in self.pairs if (p.back, p.front) == (back, front))

    @property
    def soonest(self) -> tuple[Pair, ...]:
        """Each two labels once, with that one in front that turns the other grey sooner.

        Those that go grey come first, at the least opacity of the front one before all others;
        then those that lose most of their chroma.
        """

        def soon(pair: Pair) -> tuple[bool, float, float]:
            profile = pair.result
            if profile.turns_grey and profile.least_at is not None:
                return False, profile.least_at, 0.0
            return True, 1.0 if profile.left is None else profile.left, profile.least_at or 0.0

        both = [
            min((self.pair(a, b), self.pair(b, a)), key=soon)
            for a, b in combinations(range(len(self.labels)), 2)
        ]
        return tuple(sorted(both, key=soon))

    def mirrored(self, pair: Pair) -> bool:
        """Whether the same two in the other order give the same colours, backwards."""
        other = self.pair(pair.front, pair.back)
        return all(
            np.allclose(one.rgb, two.rgb[::-1], rtol=0, atol=1e-9)
            for one, two in (
                (pair.result, other.result),
                (pair.traditional, other.traditional),
            )
        )

    @property
    def distinct(self) -> tuple[Pair, ...]:
        """Those of `soonest`, each before the other order of the two unless that mirrors it."""
        pairs = []
        for pair in self.soonest:
            pairs.append(pair)
            if not self.mirrored(pair):
                pairs.append(self.pair(pair.front, pair.back))
        return tuple(pairs)

    def mixtures(self, blending: str) -> Iterator[tuple[Floats, Floats]]:
        """What any stack of the labels can give on the background: p (2, n), linear rgb (3, n).

        In parts, each of all weights of three colours, the background among them: of all mixtures
        of one p, three colours are enough for the brightest. The labels are stacked as listed.
        """
        n = len(self.labels)
        triples = list(combinations(range(n + 1), 3))
        steps = _MIXTURE_STEPS if len(triples) <= _MANY_TRIPLES else _FEWER_MIXTURE_STEPS
        weights = _lattice(steps)
        for triple in triples:
            if BLENDINGS[blending].depends_on_place:
                yield from self._threads_of_mixtures(triple, weights)
                continue
            layers = np.zeros((n, len(weights), 4), np.float32)
            for weight, member in zip(weights.T, triple, strict=True):
                if member < n:
                    layers[member] = weight[:, None] * np.array([*self.labels[member].rgb, 1.0])
            rgba = composite(
                list(layers),
                op="plus",
                background=self.settings.background,
                **{**self.rules, "blending": blending},
            )
            rgb = np.ascontiguousarray(rgba[:, :3].T)
            yield self.stack.space.forward(rgb)[1], rgb

    def _threads_of_mixtures(
        self, triple: Sequence[int], weights: Floats
    ) -> Iterator[tuple[Floats, Floats]]:
        """What each of three colours, the background among them, shows of their mixtures."""
        n = len(self.labels)
        members = [self.labels[k].rgb if k < n else self.settings.background for k in triple]
        layers = [
            weight[:, None] * np.array([*color, 1.0])
            for weight, color in zip(weights.T, members, strict=True)
        ]
        rules = {name: value for name, value in self.rules.items() if name != "order"}
        stack = stack_rules(len(layers), op="plus", **rules)
        rgb, share = thread_colors(stack, layers)
        for colors, part in zip(rgb, share, strict=True):
            shown = np.ascontiguousarray(colors[part > 0].T)
            yield self.stack.space.forward(shown)[1], shown


def patch(profile: Profile, weave: Weave, width: int, height: int) -> tuple[Floats, Floats]:
    """A blend as pixels: rgb (height, width, 3), linear, and hues (height, width), NaN where grey.

    The front label's opacity goes from 0 at the left to 1 at the right. What is woven has its
    pattern, one pixel for one of the picture.
    """
    steps = len(profile.rgb) - 1
    at = np.rint((np.arange(width) + 0.5) / width * steps).astype(np.intp)
    rgb = np.broadcast_to(profile.rgb[at], (height, width, 3))
    hues = np.broadcast_to(profile.hues[at], (height, width))
    if profile.threads:
        first, second = profile.threads
        u = weave.phases_in(Window(0, 0, width, height)).reshape(height, width)
        of_first = first.share[at] > u
        rgb = np.where(of_first[..., None], first.rgb[at], second.rgb[at])
        hues = np.where(of_first, first.hues[at], second.hues[at])
    return rgb, hues


def _lattice(steps: int) -> Floats:
    """(n, 3): all weights of three that are multiples of 1 / steps and sum to 1."""
    first, second = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1), indexing="ij")
    inside = first + second <= steps
    first, second = first[inside], second[inside]
    return np.stack([first, second, steps - first - second], axis=1) / steps


def palette(
    colors: Sequence[Color] = (),
    *,
    layers: Sequence[Layer] = (),
    background: Color = "#ffffff",
    opacity: float = DEFAULT_OPACITY,
    close_hues: float = DEFAULT_CLOSE_HUES,
    least_difference: float = DEFAULT_LEAST_DIFFERENCE,
    gray_opacity: float = DEFAULT_GREY_OPACITY,
    achromatic: float = DEFAULT_ACHROMATIC,
    strict: bool = RuleOptions.strict,
    max_pixels: str | int = ResourceOptions.max_pixels,
    **rules: Any,
) -> Palette:
    """Blends every pair of labels in every order, as ⊕ and as traditional + do, and judges them.

    `colors`: 2 to 24 labels, with those of `layers`: CSS colours such as `#e41a1c`, with a name
    `fault=#e41a1c`; or three numbers, straight linear RGB. `layers`: files or LAYER strings, each
    of which gives a label for each peak of its hues, of the mean colour there.
    `background`: likewise a colour; labels are judged on it. `rules`: `blending`, `order`, `space`
    and what else is no matter of single layers, as in `composite`.
    Findings: `close_hues`, hues are less than so many degrees apart, 0 to 180 between p vectors;
    `least_difference`, a label at `opacity`, 0 to 1, is nearer to the background than that, 0 to 1
    in Oklab; `gray_opacity`, one label turns another grey at less opacity than that, 0 to 1;
    `achromatic`, colours of less saturation have no hue, 0 to 1. `strict`: warnings of files become
    errors. `max_pixels`: a file that claims more is refused.
    Returns: a `Palette`.
    Errors: `SettingError`; of layers, `InputError`, and `MismatchError` where no hue stands out.
    Source: Chuang et al. 2009, Figures 4 and 6.
    """
    gray_opacity = older_spelling(rules, "grey_opacity", gray_opacity)
    for name in ("op", "exposure", "primaries"):
        if name in rules:
            raise SettingError(f"'{name}' says nothing of a palette: leave it out")
    named = [_named(color) for color in colors]
    of_one = {name: value for name, value in rules.items() if name != "order"}
    reading: dict[str, Any] = {
        "space": stack_rules(1, **of_one).space.name,
        "achromatic": achromatic,
        "strict": strict,
        "max_pixels": max_pixels,
    }
    for spec in images_to_measure(layers, STDOUT):
        named += _labels_of(spec, reading)
    if not FEWEST_LABELS <= len(named) <= MOST_LABELS:
        raise SettingError(
            f"{len(named)} labels: a palette has {FEWEST_LABELS} to {MOST_LABELS} of them"
        )
    checked = stack_rules(len(named), **rules)
    if checked.blending.name == TRADITIONAL:
        raise SettingError("traditional blending is what others are compared with: choose another")
    for what, value, most in (
        ("close hues", close_hues, 180),
        ("opacity", opacity, 1),
        ("least difference", least_difference, 1),
        ("gray opacity", gray_opacity, 1),
    ):
        if not 0 <= value <= most:
            raise SettingError(f"{what} {value:g} is outside 0 to {most}")
    measuring = measure_settings(checked, achromatic=achromatic)
    settings = PaletteSettings(
        background=_rgb(background, "background"),
        opacity=float(opacity),
        close_hues=float(close_hues),
        least_difference=float(least_difference),
        grey_opacity=float(gray_opacity),
        achromatic=measuring.achromatic,
        foreign_tolerance=measuring.foreign_tolerance,
    )
    work = _Work(named, rules, checked, settings)
    labels = work.labels()
    pairs = tuple(work.pairs())
    shown = tuple(work.on_background(number) for number in range(len(named)))
    findings = tuple(_findings(labels, settings, pairs, shown, checked.blending.name))
    (below,) = replace(work, named=[("background", settings.background)]).labels()
    return Palette(labels, below, rules, checked, settings, pairs, shown, findings)


# --- labels ---------------------------------------------------------------------------------------

_Named = tuple[str, tuple[float, float, float]]


def _rgb(color: Color, use: str) -> tuple[float, float, float]:
    """A colour as straight linear RGB. Errors: `SettingError`."""
    if isinstance(color, str):
        return css_color(color, use)
    rgb = tuple(float(value) for value in color)
    if len(rgb) != 3 or not all(0 <= value < math.inf for value in rgb):
        raise SettingError(
            f"{color} is not a colour: give three numbers from 0 up, linear RGB, or a CSS colour"
        )
    return rgb


def _named(color: Color) -> _Named:
    """The name and the colour of `NAME=COLOR`, of a CSS colour or of three numbers."""
    if not isinstance(color, str):
        rgb = _rgb(color, "label")
        return "rgb(" + ", ".join(f"{value:.3g}" for value in rgb) + ")", rgb
    name, _, written = color.rpartition("=")
    rgb = css_color(written, "label")
    return name or css_title(written), rgb


def _labels_of(spec: LayerSpec, reading: dict[str, Any]) -> list[_Named]:
    """A label for each peak of a layer's hues, the most frequent first. Errors: `MismatchError`.

    `reading`: the arguments of `read_hues`.
    """
    peaks = read_hues(spec, **reading).peaks
    name = spec.name or ("stdin" if spec.path == STDIN else PurePath(spec.path).stem)
    if not peaks:
        raise MismatchError(f"{spec.title}: no hue stands out in it: name its colours instead")
    if len(peaks) == 1:
        return [(name, peaks[0].rgb)]
    return [(f"{name} {peak.hue:.0f}°", peak.rgb) for peak in peaks]


# --- blending -------------------------------------------------------------------------------------


def thread_colors(rules: StackRules, layers: Sequence[Floats]) -> tuple[Floats, Floats]:
    """What a woven stack shows in pixels (n, 4) of its layers, and of its background, the last.

    rgb (terms, n, 3), linear, of each term's thread; and its share (terms, n) of the phases, 0
    where it has none. Where none has any, as of greys, the first stands for all.
    """
    terms = contributors(rules, layers)
    threads = Threads.of(terms.p, terms.strength)
    luminance = summed(terms.luminance)
    rgb = [
        rules.space.inverse(luminance, replace(terms, phase=phase).reduced(rules)).T
        for phase in threads.middles()
    ]
    shares = threads.shares
    shares[0] += threads.whole == 0
    return np.stack(rgb), shares


@dataclass(frozen=True)
class _Blends:
    """Pairs at opacities: the colours `rgb` (parts, pairs, n, 3) that are side by side, linear.

    `share` (parts, pairs, n): of the pixels. There is one part, of share 1, but for what is woven.
    """

    rgb: Floats
    share: Floats

    @property
    def mean(self) -> Floats:
        """(pairs, n, 3)."""
        mean: Floats = (self.share[..., None] * self.rgb).sum(axis=0)
        return mean


@dataclass(frozen=True)
class _Work:
    """Blends labels by the rules, all in doubles."""

    named: Sequence[_Named]
    rules: Mapping[str, Any]
    stack: StackRules
    settings: PaletteSettings

    @property
    def blendings(self) -> tuple[str, str]:
        return TRADITIONAL, self.stack.blending.name

    def labels(self) -> tuple[Label, ...]:
        luminance, p = self.stack.space.forward(self._colors().T)
        hues = self._hues(self._colors())
        return tuple(
            Label(
                name=name,
                rgb=rgb,
                hue=None if math.isnan(hue) else float(hue),
                chroma=float(size),
                luminance=float(y),
            )
            for (name, rgb), hue, size, y in zip(
                self.named, hues, chroma(p), luminance, strict=True
            )
        )

    def pairs(self) -> Iterator[Pair]:
        both = np.array(list(permutations(range(len(self.named)), 2)))
        p = self._p(self._colors())
        backs, fronts = p[:, both[:, 0]], p[:, both[:, 1]]
        woven = self.stack.blending.depends_on_place
        equality = shoulder(backs, fronts, 0.0 if woven else self.stack.hue_tolerance)
        traditional, result = (self._profiles(both, blending) for blending in self.blendings)
        has_hue = ~np.isnan(self._hues(self._colors()))
        for k, (back, front) in enumerate(both.tolist()):
            known = bool(has_hue[back] and has_hue[front])
            yield Pair(
                back=back,
                front=front,
                angle=float(_angle(backs[:, k], fronts[:, k])) if known else None,
                equality=float(equality[k]) if known else 0.0,
                result=result[k],
                traditional=traditional[k],
            )

    def on_background(self, number: int) -> dict[str, OnBackground]:
        """A label at the opacity of the settings, in each way of blending."""
        below = np.array(self.settings.background)
        y_below, _ = self.stack.space.forward(below[:, None])
        color = self._colors()[number]
        has_hue = not np.isnan(self._hues(color[None])).any()
        blends = {}
        for blending in self.blendings:
            layer = self.settings.opacity * np.append(color, 1.0)
            rgb, share = self._over_background(layer, blending)
            luminance, p = self.stack.space.forward(rgb[:, None])
            keeps = None
            if has_hue:
                near = _angle(p, self._p(color[None])) <= self.settings.foreign_tolerance
                keeps = bool(near[0] and not np.isnan(self._hues(rgb[None])).any())
            blends[blending] = OnBackground(
                rgb=tuple(rgb.tolist()),
                difference=float(difference(rgb, below)),
                contrast=float(contrast(luminance[0], y_below[0])),
                keeps_hue=keeps,
                share=share,
            )
        return blends

    def _over_background(self, layer: Floats, blending: str) -> tuple[Floats, float]:
        """A layer (4) over the background: its colour (3), of that share of the pixels."""
        rules = {"background": tuple(self.settings.background), **self._rules(blending)}
        if BLENDINGS[blending].depends_on_place:
            colors, shares = thread_colors(stack_rules(1, **rules), [layer[None]])
            if shares[0, 0] > 0:  # else the background gives the hue of all
                return colors[0, 0], float(shares[0, 0])
        rgb: Floats = composite([layer], **rules)[:3]
        return rgb, 1.0

    def _colors(self) -> Floats:
        return np.array([rgb for _, rgb in self.named])

    def _p(self, rgb: Floats) -> Floats:
        """p (2, …) of rgb (…, 3)."""
        return self.stack.space.forward(np.moveaxis(rgb, -1, 0))[1]

    def _hues(self, rgb: Floats) -> Floats:
        """Degrees (…) of rgb (…, 3), NaN where it is a grey by the settings."""
        spread, size = spread_and_size(np.moveaxis(rgb, -1, 0))
        chromatic = (spread > 0) & is_saturated(spread, size, self.settings.achromatic)
        hues = np.full(rgb.shape[:-1], np.nan)
        hues[chromatic] = self.stack.space.hue_axis.degrees(rgb[chromatic].T)
        return hues

    def _rules(self, blending: str) -> dict[str, Any]:
        """The rules of one or two layers, in which a blend order has no effect."""
        kept = {name: value for name, value in self.rules.items() if name != "order"}
        return {**kept, "blending": blending}

    def _blended(self, both: NDArray[np.intp], opacities: Floats, blending: str) -> _Blends:
        """Opaque fronts over opaque backs: (pairs, 2), opacities (pairs, n)."""
        opaque = np.concatenate([self._colors(), np.ones((len(self.named), 1))], axis=1)
        backs = np.broadcast_to(opaque[both[:, 0], None], (*opacities.shape, 4))
        fronts = opaque[both[:, 1], None] * opacities[..., None]
        if not BLENDINGS[blending].depends_on_place:
            rgb = composite([backs, fronts], **self._rules(blending))[..., :3]
            return _Blends(rgb[None], np.ones((1, *opacities.shape)))
        rules = stack_rules(2, **self._rules(blending))
        colors, share = thread_colors(rules, [backs.reshape(-1, 4), fronts.reshape(-1, 4)])
        return _Blends(colors.reshape(2, *opacities.shape, 3), share.reshape(2, *opacities.shape))

    def _left(self, both: NDArray[np.intp], opacities: Floats, blends: _Blends) -> Floats:
        """(pairs, n): what of the chroma that two labels bring their blend has; 1 of nothing."""
        m = chroma(self._p(self._colors()))
        brought = (1 - opacities) * m[both[:, :1]] + opacities * m[both[:, 1:]]
        left = np.ones_like(brought)
        there = (blends.share * chroma(self._p(blends.rgb))).sum(axis=0)
        return np.divide(there, brought, out=left, where=brought > 1e-12)

    def _profiles(self, both: NDArray[np.intp], blending: str) -> list[Profile]:
        steps = np.linspace(0, 1, PROFILE_STEPS)
        opacities = np.broadcast_to(steps, (len(both), len(steps)))
        blends = self._blended(both, opacities, blending)
        rgb, hues, there = blends.mean, self._hues(blends.rgb), blends.share > 0
        p, own = self._p(blends.rgb), self._p(self._colors())
        near = np.zeros(hues.shape, bool)
        for side in (0, 1):
            labels = own[:, both[:, side], None]
            near |= _angle(p, labels) <= self.settings.foreign_tolerance
        grey = np.logical_and.reduce(np.isnan(hues) | ~there, axis=0)
        foreign = np.logical_or.reduce(there & ~np.isnan(hues) & ~near, axis=0)

        left = self._left(both, opacities, blends)
        width = 1 / (PROFILE_STEPS - 1)
        rows = np.arange(len(both))
        for _ in range(_ROUNDS):
            best = opacities[rows, left.argmin(axis=1)]
            opacities = np.clip(best[:, None] + np.linspace(-width, width, _ROUND_STEPS), 0, 1)
            left = self._left(both, opacities, self._blended(both, opacities, blending))
            width *= 2 / (_ROUND_STEPS - 1)
        at = left.argmin(axis=1)
        best, least = opacities[rows, at], left[rows, at]
        leasts = self._blended(both, best[:, None], blending)
        gone = np.isnan(self._hues(leasts.rgb)) | (leasts.share == 0)
        turns = np.logical_and.reduce(gone, axis=0)[:, 0]
        seen = self._hues(rgb)
        has_hue = ~np.isnan(self._hues(self._colors()))
        profiles = []
        for k, (back, front) in enumerate(both.tolist()):
            lost = least[k] < _ALL
            brings = bool(has_hue[back] or has_hue[front])
            profiles.append(
                Profile(
                    rgb=rgb[k],
                    hues=seen[k],
                    foreign=float(foreign[k].mean()),
                    grey=float(grey[k].mean()),
                    left=float(min(least[k], 1.0)) if brings else None,
                    least_at=float(best[k]) if brings and lost else None,
                    turns_grey=bool(has_hue[back] and has_hue[front] and lost and turns[k]),
                    threads=self._threads(both[k], blends, hues, k),
                )
            )
        return profiles

    def _threads(
        self, pair: NDArray[np.intp], blends: _Blends, hues: Floats, k: int
    ) -> tuple[Thread, ...]:
        """Those of pair `k`, sorted by hue; none where the blends have one part."""
        if len(blends.rgb) == 1:
            return ()
        p = self._p(self._colors())
        sides = sorted((0, 1), key=lambda side: math.atan2(p[1, pair[side]] + 0, p[0, pair[side]]))
        return tuple(
            Thread(int(pair[side]), blends.rgb[side, k], hues[side, k], blends.share[side, k])
            for side in sides
        )


def _angle(p1: Floats, p2: Floats) -> Floats:
    """Degrees (…) between p (2, …)."""
    return np.degrees(np.arctan2(*cross_and_dot(p1, p2)))


# --- findings -------------------------------------------------------------------------------------


def _findings(
    labels: Sequence[Label],
    settings: PaletteSettings,
    pairs: Sequence[Pair],
    shown: Sequence[Mapping[str, OnBackground]],
    blending: str,
) -> Iterator[Finding]:
    """What may be wrong, kind by kind in the order of `FINDING_KINDS`."""
    both = (TRADITIONAL, blending)
    for number, label in enumerate(labels):
        if label.hue is None:
            measured = float(saturation(np.array(label.rgb)))
            yield Finding("no-hue", (number,), both, measured, settings.achromatic)
    for pair in pairs:
        if pair.back < pair.front and pair.angle is not None and pair.angle < settings.close_hues:
            close = (pair.back, pair.front)
            yield Finding("close-hues", close, both, pair.angle, settings.close_hues)
    for number, on in enumerate(shown):
        least = settings.least_difference
        faint = tuple(name for name in both if on[name].difference < least)
        if faint:
            measured = min(on[name].difference for name in faint)
            yield Finding("vanishes", (number,), faint, measured, least)
    for number, on in enumerate(shown):
        lost = tuple(name for name in both if on[name].keeps_hue is False)
        if lost:
            yield Finding("hue-lost", (number,), lost, settings.opacity, settings.opacity)
    for pair in pairs:
        profiles = dict(zip(both, (pair.traditional, pair.result), strict=True))
        soon = {
            name: profile.least_at
            for name, profile in profiles.items()
            if profile.turns_grey
            and profile.least_at is not None
            and profile.least_at < settings.grey_opacity
        }
        if soon:
            yield Finding(
                "goes-grey",
                (pair.back, pair.front),
                tuple(soon),
                min(soon.values()),
                settings.grey_opacity,
            )
