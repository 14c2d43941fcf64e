"""A picture against the layers that it was made from, or against a list of hues. Prints nothing.

It measures what a file holds, in strips side by side, and allows for how samples are quantised:
where a hue fits nothing, the tolerance widens by what half a code value of each channel turns it.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import PurePath
from typing import TYPE_CHECKING, Unpack

import numpy as np
from numpy.typing import NDArray

from ..blending.rules import StackRules
from ..color.planes import is_saturated, length, spread_and_size
from ..color.primaries import working_primaries
from ..color.samples import Decoding, Rgba, Samples, Strip, decode, linear_rgba, part_of, spread
from ..color.spaces import Space
from ..errors import MismatchError, SettingError, nearest
from ..geometry import Window
from ..imagefile.reading import STRIP_ROWS, LayerReader
from ..imagefile.source import codec_threads
from ..layers.budget import Budget, share_out
from ..layers.layerspec import LayerSpec, check_stdin, layer_spec
from ..layers.notices import Notices, warn_of_problems, warn_of_ramps, warn_of_samples
from ..layers.opening import opened_layer
from ..layers.placing import Layer, PlacedLayer, layer_specs, opened_stack, rules_of
from ..measures.cells import Cells, cells_of, pixels_seen
from ..measures.defaults import CELL
from ..measures.labels import (
    BLOCK_PIXELS,
    HALF_STEP_8_BIT,
    HALF_STEP_FINE,
    LARGEST_MEASURED,
    Angle,
    Contributors,
    MeasureSettings,
    Sums,
    Support,
    contributors,
    count,
    in_units,
    measure_settings,
    share,
    summed,
)
from ..measures.ramps import Meetings, Ramp, meetings, ramps
from ..options import (
    DEFAULTS,
    OPTIONS,
    ResourceOptions,
    StackOptions,
    older_spelling,
    takes_options,
)
from ..system.streams import STDIN
from ..system.threads import ThreadPipeline, thread_count

if TYPE_CHECKING:
    from ..keywords import StackKeywords

log = logging.getLogger("hpcomp")

Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

#: A label is visible that is seen in this share of where it could be: not one stray pixel.
DEFAULT_VISIBLE = 0.001

#: A pixel that its file leaves uncertain by more degrees than this shows no label: half of what
#: lies between two neighbours of the six pure hues.
UNCERTAIN_HUE = 30.0

#: Pixels of a strip where memory allows: beside shorter ones the allocator gives every array of a
#: block back to the system, which fills the pages of the next one with zeros.
STRIP_PIXELS = 1 << 20
#: Terms of pixels that are measured at a time, so that their planes stay in cache; and the fewest
#: pixels, below which numpy spends its time on calls.
BLOCK_TERMS, FEWEST_PIXELS = 1 << 17, 1 << 8
#: Memory of a pixel while it is decoded and measured, and of each term that it is made of.
PIXEL_BYTES, TERM_BYTES = 420, 100


@dataclass(frozen=True)
class ExpectedHue:
    """A hue that may be asked for: that of layer `number`, or `hue` in degrees; `text` names it."""

    text: str
    number: int | None
    hue: float | None


@dataclass(frozen=True)
class LabelSums(Sums):
    """`pixels` in which a label could be seen, and `shown`: those in which its hue is.

    A layer could be seen where it contributes, a hue in every chromatic pixel. `visible`: those of
    `pixels` in cells of the canvas where a pixel is shown, so that a reader finds it there.
    """

    pixels: int = 0
    shown: int = 0
    visible: int = 0

    @property
    def share(self) -> float:
        return share(self.shown, self.pixels)

    @property
    def visible_share(self) -> float:
        return share(self.visible, self.pixels)


@dataclass(frozen=True)
class CheckSums(Sums):
    """What was counted; chroma in `measures.SUM_UNIT`.

    `pixels`: all of the picture; `unmeasured`: with NaN or the like, left out of the rest;
    `visible`: with alpha or light; `chromatic` and `foreign` of these. `chroma_in`: Σ|t| of the
    layers, and `chroma_out` what of it the picture has. `labels`: one for each. `meetings`: how far
    apart the hues of the two strongest contributors are, where the stack adds them with ⊕.
    """

    labels: tuple[LabelSums, ...]
    pixels: int = 0
    unmeasured: int = 0
    visible: int = 0
    chromatic: int = 0
    chroma: int = 0
    foreign: int = 0
    foreign_chroma: int = 0
    chroma_in: int = 0
    chroma_out: int = 0
    meetings: Meetings = field(default_factory=Meetings)


@dataclass(frozen=True)
class Verdict:
    """How one rule ended: what it asks, what was `measured`, its `limit`, and whether it holds."""

    rule: str
    label: str | None
    measured: float
    limit: float
    passed: bool


@dataclass(frozen=True)
class CheckResult:
    """What `check` found: the measures of a picture, and how each rule ended.

    `against`: `layers` or `hues`. `labels`: the layers, or the hues, and those that were required.
    `ramps`: the pairs of contributors of which one has a ramp of hues that crosses the other's, so
    that ⊕ makes a vivid ring there with grey beside it.
    """

    image: str
    against: str
    settings: MeasureSettings
    labels: tuple[ExpectedHue, ...]
    sums: CheckSums
    verdicts: tuple[Verdict, ...] = ()
    ramps: tuple[Ramp, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every rule holds."""
        return all(verdict.passed for verdict in self.verdicts)

    @property
    def foreign_share(self) -> float:
        """The share of chromatic pixels whose hue is nobody's."""
        return share(self.sums.foreign, self.sums.chromatic)

    @property
    def foreign_chroma_share(self) -> float:
        """The same, each pixel weighted by its chroma."""
        return share(self.sums.foreign_chroma, self.sums.chroma)

    @property
    def visible_share(self) -> float:
        """Of what all layers contribute to, pixel by pixel, the share in cells where they show."""
        of_layers = [
            seen
            for label, seen in zip(self.labels, self.sums.labels, strict=True)
            if label.number is not None
        ]
        return share(
            sum(seen.visible for seen in of_layers), sum(seen.pixels for seen in of_layers)
        )

    @property
    def grey_share(self) -> float:
        """Against layers, the share of their chroma that the picture lacks; else of grey pixels.

        Grey pixels are those with alpha or light and too little saturation for a hue.
        """
        if self.against == "layers":
            return share(self.sums.chroma_in - self.sums.chroma_out, self.sums.chroma_in)
        return share(self.sums.visible - self.sums.chromatic, self.sums.visible)


# --- settings -------------------------------------------------------------------------------------


def parse_share(text: str | float) -> float:
    """A share in [0, 1] from `0.01`, `1%` or a number; `SettingError` otherwise."""
    try:
        number = str(text).strip()
        value = float(number[:-1]) / 100 if number.endswith("%") else float(number)
    except ValueError:
        value = math.nan
    if not 0 <= value <= 1:
        raise SettingError(f"'{text}' is not a share: write 0.01 or 1%, from 0 to 100%")
    return value


@dataclass(frozen=True)
class LeastVisible:
    """The least share of its pixels in which a layer must be visible, None where none is asked.

    `of_any`: of every layer that contributes anywhere. `of_layer`: by number, which goes first.
    """

    of_any: float | None
    of_layer: dict[int, float]

    @staticmethod
    def parsed(
        wanted: str | float | Sequence[str | float], specs: Sequence[LayerSpec]
    ) -> LeastVisible:
        """From `95%`, `0.95`, `layer:1=90%` or `layer:NAME=90%`, or several of these.

        Errors: `SettingError`, also where two are of the same.
        """
        several = [wanted] if isinstance(wanted, (str, float, int)) else wanted
        of_any: list[float] = []
        of_layer: dict[int, float] = {}
        for text in map(str, several):
            label, equals, limit = text.rpartition("=")
            if not label.startswith("layer:") and (equals or text.startswith("layer:")):
                raise SettingError(
                    f"min-visible '{text}' is no share and no layer's: write 95%, layer:1=90% or "
                    "layer:NAME=90%"
                )
            least = parse_share(limit)
            number = _layer_label(label.removeprefix("layer:"), specs).number if equals else None
            if number in of_layer or (number is None and of_any):
                raise SettingError(f"min-visible '{text}' comes after another: give one of each")
            if number is None:
                of_any.append(least)
            else:
                of_layer[number] = least
        return LeastVisible(of_any[0] if of_any else None, of_layer)

    @property
    def is_asked(self) -> bool:
        return self.of_any is not None or bool(self.of_layer)

    def of(self, number: int, seen: LabelSums) -> float | None:
        """What is asked of layer `number`."""
        return self.of_layer.get(number, self.of_any if seen.pixels else None)


def parse_hues(hues: str | Sequence[float]) -> tuple[float, ...]:
    """Hues in degrees from `0,120,240` or numbers; `SettingError` otherwise."""
    try:
        degrees = tuple(float(h) for h in (hues.split(",") if isinstance(hues, str) else hues))
    except ValueError:
        degrees = ()
    if not degrees or not all(map(math.isfinite, degrees)):
        raise SettingError(f"hues '{hues}' are not numbers: write degrees such as 0,120,240")
    return degrees


def _label(wanted: str | float, specs: Sequence[LayerSpec]) -> ExpectedHue:
    """A label from degrees, or from `layer:` and a number or a name."""
    text = str(wanted)
    if text.startswith("layer:"):
        return _layer_label(text.removeprefix("layer:"), specs)
    try:
        hue = float(text)
    except ValueError:
        hue = math.nan
    if not math.isfinite(hue):
        raise SettingError(
            f"'{text}' is no label: write a hue in degrees such as 120, or layer:1 or layer:NAME"
        )
    return ExpectedHue(f"hue {hue:g}", None, hue)


def _layer_label(wanted: str, specs: Sequence[LayerSpec]) -> ExpectedHue:
    named = [n for n, spec in enumerate(specs) if wanted == spec.name]
    named = named or [n for n, spec in enumerate(specs) if wanted == str(n)]
    named = named or [n for n, spec in enumerate(specs) if wanted == PurePath(spec.path).stem]
    if len(named) != 1:
        there_is = ", ".join(spec.label(n) for n, spec in enumerate(specs)) or "none: name LAYERs"
        problem = "is not one of the layers" if not named else "fits several layers"
        names = [spec.name or PurePath(spec.path).stem for spec in specs]
        near = "" if named else nearest(wanted, names).replace(":", ";")
        raise SettingError(f"label 'layer:{wanted}' {problem}: there is {there_is}{near}")
    return ExpectedHue(specs[named[0]].label(named[0]), named[0], None)


#: The options that place and weigh layers, which a list of hues has none of.
_OF_LAYERS = ("op", "exposure", "canvas", "background")


@takes_options(*OPTIONS)
def check(
    image: Layer,
    layers: Sequence[Layer] = (),
    asked: StackOptions | None = None,
    *,
    hues: str | Sequence[float] | None = None,
    max_foreign: str | float | None = None,
    max_gray: str | float | None = None,
    require_hue: Sequence[str | float] = (),
    min_visible: str | float | Sequence[str | float] = (),
    visible: str | float = DEFAULT_VISIBLE,
    **options: Unpack[StackKeywords],
) -> CheckResult:
    """Measures the hues of a picture against the layers that it was made from, or against hues.

    `image`: a file, or a LAYER string without `op` and `opacity`. `layers`: as in `stack`, whose
    options mean the same: those that change no hue, such as `order`, change nothing here.
    `threads` and `max_memory` are what the check may take; they change no result. Instead of
    layers, `hues`: degrees on the axis of `space`, in most spaces that of HSL of the linear colour.
    At least one rule:
    `max_foreign`, `max_gray`: shares in [0, 1] or as `1%` that may not be exceeded;
    `require_hue`: labels that must be seen, degrees or `layer:1` or `layer:NAME`, each in the share
    `visible` of where it could be;
    `min_visible`: the share of its pixels that must lie in cells of 16×16 pixels, counted from the
    canvas' corner, in which a pixel of its shows its hue: of each layer that contributes anywhere,
    or of one as `layer:1=90%` or `layer:NAME=90%`, which goes first.
    `foreign_tolerance`: degrees between p vectors, twice the hue tolerance if not given, and
    the space's `gamut_turn` more. `achromatic`: the saturation below which colours are grey, 0.02
    if not given.
    Returns: a `CheckResult`, whose `passed` tells how it ended.
    Errors: `SettingError`, also where no rule is given; `InputError`, `MismatchError`.
    Warnings: `HpcompWarning`, also of `ramps`; errors with `strict`.
    """
    max_gray = older_spelling(options, "max_grey", max_gray)
    checked = StackOptions.of(options, base=asked)
    specs = layer_specs(layers)
    picture = _picture_spec(image)
    limits = {
        name: None if limit is None else parse_share(limit)
        for name, limit in (("max-foreign", max_foreign), ("max-gray", max_gray))
    }
    least = parse_share(visible)
    required = [_label(label, specs) for label in require_hue]
    asked_visible = LeastVisible.parsed(min_visible, specs)
    given = [*required, *(limit for limit in limits.values() if limit is not None)]
    if not given and not asked_visible.is_asked:
        raise SettingError(
            "a check without a rule would pass anything: give --max-foreign, --max-gray, "
            "--require-hue or --min-visible"
        )
    if bool(specs) == (hues is not None):
        raise SettingError("give either the LAYERs that the picture was made from, or --hues")
    check_stdin([picture, *specs], "files")
    notices = Notices(checked.rules.strict)
    if hues is None:
        rules = rules_of(specs, checked.rules)
        labels = [ExpectedHue(spec.label(n), n, None) for n, spec in enumerate(specs)]
        listed: list[Array] = []
    else:
        for name in _OF_LAYERS:
            if checked[name] != DEFAULTS[name]:
                raise SettingError(f"--{name} is about layers: a check against --hues has none")
        if asked_visible.is_asked:
            raise SettingError("--min-visible is about layers: a check against --hues has none")
        working_primaries(checked.rules.primaries)  # there is no bottom to take them from
        rules = checked.rules.of_layers([None], [1.0])
        degrees = parse_hues(hues)
        labels = [ExpectedHue(f"hue {hue:g}", None, hue) for hue in degrees]
        listed = [vector_of(hue, rules.space) for hue in degrees]
    labels += [label for label in required if label not in labels]
    settings = measure_settings(
        rules,
        achromatic=checked.reports.achromatic,
        foreign_tolerance=checked.reports.foreign_tolerance,
    )
    with contextlib.ExitStack() as opened:
        # The layers first: where they do not fit together, the picture does not matter.
        stack = None
        if specs:
            stack = opened.enter_context(opened_stack(specs, rules, checked, notices))
            rules = stack.rules
        name = f"picture ({'stdin' if picture.path == STDIN else picture.path})"
        reader = opened.enter_context(
            opened_layer(picture, name, checked.rules.nonfinite, checked.resources.max_pixels)
        )
        reader.work_in(rules.primaries)
        warn_of_problems(reader, notices)
        placed = _placed_picture(reader, picture, None if stack is None else stack.canvas)
        below = () if stack is None else stack.layers
        gauge = _Gauge(rules, settings, labels, listed)
        canvas = reader.part.display_window if stack is None else stack.canvas
        sums = _measured(placed, below, canvas, gauge, checked.resources)
        warn_of_samples([placed.reader, *(layer.reader for layer in below)], notices)
    crossing = tuple(ramps(sums.meetings, rules.hue_tolerance))
    warn_of_ramps(crossing, specs, rules.hue_tolerance, notices)
    result = CheckResult(
        os.fspath(picture.path),
        "hues" if stack is None else "layers",
        settings,
        tuple(labels),
        sums,
        ramps=crossing,
    )
    verdicts = [*_verdicts(result, limits, required, least), *_visible(result, asked_visible)]
    return replace(result, verdicts=tuple(verdicts))


def _picture_spec(image: Layer) -> LayerSpec:
    spec = layer_spec(image)
    if spec.op is not None or spec.opacity != 1:
        raise SettingError(f"'{spec.path}' is the picture to check: op and opacity are of layers")
    return spec


def _verdicts(
    result: CheckResult,
    limits: dict[str, float | None],
    required: Sequence[ExpectedHue],
    least: float,
) -> Iterator[Verdict]:
    measured = {"max-foreign": result.foreign_share, "max-gray": result.grey_share}
    for rule, limit in limits.items():
        if limit is not None:
            yield Verdict(rule, None, measured[rule], limit, measured[rule] <= limit)
    for label in required:
        seen = result.sums.labels[result.labels.index(label)]
        passed = seen.shown > 0 and seen.share >= least
        yield Verdict("require-hue", label.text, seen.share, least, passed)


def _visible(result: CheckResult, asked: LeastVisible) -> Iterator[Verdict]:
    for label, seen in zip(result.labels, result.sums.labels, strict=True):
        limit = None if label.number is None else asked.of(label.number, seen)
        if limit is not None:
            passed = seen.visible_share >= limit
            yield Verdict("min-visible", label.text, seen.visible_share, limit, passed)


# --- pixels ---------------------------------------------------------------------------------------


def _placed_picture(reader: LayerReader, spec: LayerSpec, canvas: Window | None) -> PlacedLayer:
    """The picture where it lies on the canvas of its layers. Errors: `MismatchError`."""
    display = reader.part.display_window
    if canvas is None:
        return PlacedLayer(reader, 0, 0)
    if spec.placement is not None:
        place = spec.placement.place(display, canvas)
    elif display == canvas:
        place = display
    elif reader.file.format == "png" and (display.width, display.height) == (
        canvas.width,
        canvas.height,
    ):
        place = canvas  # a PNG does not say where it lies
    else:
        raise MismatchError(
            f"{reader.label} is {display} but the canvas of its layers is {canvas}: place it with "
            "at=+X+Y, or choose --canvas"
        )
    return PlacedLayer(reader, place.x - display.x, place.y - display.y)


def _measured(
    picture: PlacedLayer,
    layers: Sequence[PlacedLayer],
    canvas: Window,
    gauge: _Gauge,
    granted: ResourceOptions,
) -> CheckSums:
    """The sums of the whole picture, whose strips are read and measured side by side.

    `canvas`: from whose corner cells are counted. Errors: `InputError`, `MismatchError`, also where
    too little memory is granted.
    """
    files = [picture, *layers]
    readers = [file.reader for file in files]
    window = picture.window
    measuring = gauge.block_pixels * gauge.bytes_per_pixel
    for_each_thread = -(-window.height // thread_count(granted.threads))
    threads, rows = share_out(
        readers,
        window.height,
        granted,
        lambda threads: Budget.of_measuring(readers, threads, measuring),
        "this check",
        cell=CELL,
        wanted=max(STRIP_ROWS, min(STRIP_PIXELS // window.width, for_each_thread)),
    )
    log.info("checking %s in strips of %d rows, %d threads", window, rows, threads)

    def read(strip: Window) -> tuple[Window, list[Strip]]:
        place = strip.moved(-canvas.x, -canvas.y)
        return place, [file.read_checked(strip) for file in files]

    sums = gauge.none
    with (
        codec_threads(readers, reading=1, writing=1),
        ThreadPipeline[CheckSums](threads) as pipeline,
    ):
        # One source: PNGs are read from the top.
        strips = window.strips(rows, (window.y - canvas.y) % CELL)
        reads = ((0, partial(read, strip)) for strip in strips)
        for part in pipeline.read_ahead(reads, partial(gauge.of_strip, go_on=pipeline.go_on)):
            sums += part
    return sums


def _colors(strip: Strip, block: Window) -> Rgba:
    """(pixels, 4): a layer's pixels in a block of the strip, transparent where it has none."""
    part = part_of(strip, block)
    rgba, _ = linear_rgba(part)
    return spread(rgba, part.left, part.top, block.width, block.height)


def quantization(samples: Samples, decoding: Decoding, space: Space) -> Array:
    """How far half a code value of each colour channel can move p: the most of the 8 corners.

    `samples`: (n, channels) as stored: code values, half-floats (half a unit in the last place),
    floats. Returns (n), in the units of p.
    """
    n, channels = samples.shape
    colors = 1 if channels <= 2 else 3
    if samples.dtype.kind == "u":
        stored = samples / np.iinfo(samples.dtype).max
        half = np.full((n, colors), 0.5 / np.iinfo(samples.dtype).max)
    else:
        stored = samples.astype(np.float64)
        half = np.zeros((n, colors))
        if samples.dtype == np.float16:
            half = np.spacing(np.abs(samples[:, :colors])).astype(np.float64) / 2

    def p_of(values: NDArray[np.float64]) -> tuple[Array, Array]:
        rgb = decode(values[None], decoding)[0].T[:3]
        return space.forward(rgb)[1], rgb

    center, rgb = p_of(stored)
    # What float32 itself leaves uncertain, where the corners are that near.
    farthest = 4 * np.finfo(np.float32).eps * np.abs(rgb).max(axis=0)
    reach = farthest.copy()
    if half.any():
        for corner in product((-1, 1), repeat=colors):
            moved = stored.copy()
            moved[:, :colors] += half * corner
            away = p_of(moved)[0] - center
            reach = np.maximum(reach, farthest + length(away))
    return reach


@dataclass(frozen=True)
class _Picture:
    """Some pixels of the picture: as stored, and their straight alpha, p, |p| and what they are.

    `stored`: (n, channels). `alpha`, `size`: (n). `p`: (2, n). `visible`: with alpha or light.
    """

    stored: Samples
    alpha: Array
    p: Array
    size: Array
    visible: Mask
    chromatic: Mask

    def chosen(self, pixels: Mask | NDArray[np.intp]) -> _Picture:
        """Only those pixels."""
        return _Picture(
            self.stored[pixels],
            self.alpha[pixels],
            self.p[:, pixels],
            self.size[pixels],
            self.visible[pixels],
            self.chromatic[pixels],
        )


@dataclass(frozen=True)
class _Gauge:
    """Measures blocks of pixels; `none` is the measure of no pixel.

    `hues`: the listed ones, (2, 1) each, where there are no layers.
    """

    rules: StackRules
    settings: MeasureSettings
    labels: Sequence[ExpectedHue]
    hues: Sequence[Array]

    @property
    def none(self) -> CheckSums:
        return CheckSums((LabelSums(),) * len(self.labels))

    @property
    def _terms(self) -> int:
        background = self.rules.background is not None
        return len(self.hues) or len(self.rules.operators) + background

    @property
    def bytes_per_pixel(self) -> int:
        """Memory that measuring takes for each pixel of a block."""
        return PIXEL_BYTES + self._terms * TERM_BYTES

    @property
    def block_pixels(self) -> int:
        """Pixels that are measured at a time, of fewer the more terms each has."""
        return min(BLOCK_PIXELS, max(FEWEST_PIXELS, BLOCK_TERMS // self._terms))

    def of_strip(
        self, strip: tuple[Window, Sequence[Strip]], go_on: Callable[[], None]
    ) -> CheckSums:
        """The sums of a strip: of the picture, which fills it, and of each layer, or none.

        `strip`: where it lies, counted from the canvas' corner, and the strips of these.
        """
        window, (picture, *layers) = strip
        sums = self.none
        for place in window.blocks(self.block_pixels, CELL):
            go_on()
            block = place.moved(-window.x, -window.y)
            samples = part_of(picture, block).samples.reshape(-1, picture.samples.shape[2])
            colors = [_colors(layer, block) for layer in layers]
            sums += self.measured(samples, picture.decoding, colors, cells_of(place))
        return sums

    def measured(
        self, samples: Samples, decoding: Decoding, layers: Sequence[Rgba], cells: Cells
    ) -> CheckSums:
        """`samples`: (n, channels) of the picture, as stored. `layers`: (n, 4) each, or none.

        `cells` (n): which cell each pixel lies in.
        """
        step = HALF_STEP_8_BIT if samples.dtype == np.uint8 else HALF_STEP_FINE
        settings = replace(self.settings, half_step=step)
        with np.errstate(all="ignore"):  # what is not finite is left out
            rgba = linear_rgba(Strip(samples[None], decoding))[0][0]
            known = (np.abs(rgba) < LARGEST_MEASURED).all(axis=1)
            if self.hues:
                terms = self._hue_terms(known)
            else:
                # Where the picture is not finite, the layers do not count either.
                terms = self._exposed(
                    contributors(
                        self.rules, [np.where(known[:, None], layer, np.nan) for layer in layers]
                    )
                )
            picture = self._picture(samples, rgba, settings).chosen(terms.known)
        return replace(
            self._sums(picture, decoding, terms, settings, cells[terms.known]),
            pixels=len(samples),
            unmeasured=count(~terms.known),
        )

    def _picture(self, samples: Samples, rgba: Rgba, settings: MeasureSettings) -> _Picture:
        rgb = np.ascontiguousarray(rgba.T[:3])
        _, p = self.rules.space.forward(rgb)
        size = length(p)
        chromatic = (size > settings.half_step) & is_saturated(
            *spread_and_size(rgb), settings.achromatic
        )
        visible = np.asarray(rgba.any(axis=1))
        return _Picture(samples, rgba[:, 3], p, size, visible, chromatic)

    def _hue_terms(self, known: Mask) -> Contributors:
        """The listed hues as if each were a layer of full chroma, everywhere."""
        n_pixels = count(known)
        p = np.array([np.broadcast_to(hue, (2, n_pixels)) for hue in self.hues])
        ones = np.ones((len(self.hues), n_pixels), np.float32)
        return Contributors(len(self.hues), ones, p, ones, known, np.ones_like(known, np.float32))

    def _exposed(self, terms: Contributors) -> Contributors:
        """The terms as bright as the exposure made them in the picture."""
        gain = np.float32(2.0**self.rules.exposure)
        return replace(terms, p=terms.p * gain, size=terms.size * gain)

    def _sums(
        self,
        picture: _Picture,
        decoding: Decoding,
        terms: Contributors,
        settings: MeasureSettings,
        cells: Cells,
    ) -> CheckSums:
        support = Support.of(picture.p, terms, settings)
        unmatched = np.flatnonzero(picture.chromatic & ~support.has_hue)
        fit = _Fit.of(picture.chosen(unmatched), unmatched, decoding, self.rules, settings)
        foreign = np.zeros(len(picture.size), np.bool_)
        near = np.array([fit.widened.holds(fit.p, term[:, unmatched]) for term in terms.p])
        backing = summed(np.where(near, terms.size[:, unmatched], np.float32(0)))
        foreign[unmatched] = fit.certain & ~(backing > settings.half_step)
        total = terms.total()
        of_layers = not self.hues
        return CheckSums(
            tuple(self._label_sums(label, picture, terms, fit, cells) for label in self.labels),
            visible=count(picture.visible),
            chromatic=count(picture.chromatic),
            chroma=in_units(picture.size[picture.chromatic]),
            foreign=count(foreign),
            foreign_chroma=in_units(picture.size[foreign]),
            chroma_in=in_units(total) if of_layers else 0,
            chroma_out=in_units(np.minimum(picture.size, total)) if of_layers else 0,
            meetings=meetings(terms, self.rules) if of_layers else Meetings(),
        )

    def _label_sums(
        self, label: ExpectedHue, picture: _Picture, terms: Contributors, fit: _Fit, cells: Cells
    ) -> LabelSums:
        if label.number is None:
            assert label.hue is not None
            p = np.broadcast_to(vector_of(label.hue, self.rules.space), picture.p.shape)
            could = picture.chromatic
        else:
            p = terms.p[label.number]
            could = terms.size[label.number] > fit.half_step
        shown = could & picture.chromatic & fit.shows(picture, p)
        return LabelSums(count(could), count(shown), pixels_seen(could, shown, cells))


@dataclass(frozen=True)
class _Fit:
    """How near a hue has to be: within `base`, and of pixels that match no hue within `widened`.

    `unmatched`: the indices of these. `p` (2, unmatched): theirs. `certain`: whether they have
    chroma whatever was rounded. `sharp`: whether their hue is certain enough to show a label.
    """

    half_step: float
    base: Angle
    unmatched: NDArray[np.intp]
    p: Array
    widened: Angle
    certain: Mask
    sharp: Mask

    @staticmethod
    def of(
        pixels: _Picture,
        unmatched: NDArray[np.intp],
        decoding: Decoding,
        rules: StackRules,
        settings: MeasureSettings,
    ) -> _Fit:
        """`pixels`: the unmatched ones alone."""
        reach = quantization(pixels.stored, decoding, rules.space)
        turn = np.degrees(np.arcsin(np.minimum(1, reach / pixels.size)))
        tolerance = settings.foreign_tolerance
        # The alpha that a straight colour is multiplied by is rounded as well: that scales p.
        least = np.ones_like(pixels.alpha)
        if pixels.stored.dtype.kind == "u" and pixels.stored.shape[1] % 2 == 0:
            half_code = 0.5 / np.iinfo(pixels.stored.dtype).max
            least = np.maximum(0, 1 - half_code / np.maximum(pixels.alpha, half_code))
        return _Fit(
            settings.half_step,
            Angle.of(tolerance),
            unmatched,
            pixels.p,
            Angle.of(np.minimum(180, tolerance + turn)),
            (pixels.size - reach) * least > settings.half_step,
            turn <= UNCERTAIN_HUE,
        )

    def shows(self, picture: _Picture, p: Array) -> Mask:
        """Where the picture's hue is that of p (2, n)."""
        shown = self.base.holds(picture.p, p)
        shown[self.unmatched] = self.widened.holds(self.p, p[:, self.unmatched]) & self.sharp
        return shown


def vector_of(hue: float, space: Space) -> Array:
    """(2, 1): a p of that hue, in degrees on the space's axis."""
    rgb = space.hue_axis.color(np.array([hue])).astype(np.float32)
    return space.forward(rgb)[1]
