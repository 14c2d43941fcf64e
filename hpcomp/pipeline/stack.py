"""One stack, strip by strip, from files to a file: who holds which rows when."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ..blending.addition import DEFAULT_HUE_TOLERANCE
from ..blending.rules import Reduction, StackRules
from ..color.encoding import REC709, Losses, working_primaries
from ..color.samples import Samples, Strip, encode
from ..engine import choice as engine
from ..errors import MismatchError, SettingError
from ..geometry import Window, parse_window
from ..imagefile.description import describe
from ..imagefile.parts import ImageFile
from ..imagefile.reading import STRIP_ROWS, LayerImage
from ..imagefile.seekable import STDIN, seekable
from ..imagefile.source import codec_threads
from ..imagefile.writing import ImageWriter, OutputForm, format_of_output, open_writer
from ..layers.canvas import output_window
from ..layers.layerspec import layer_spec
from ..layers.notices import Notices, warn_of_losses, warn_of_problems, warn_of_zeroed
from ..layers.opening import opened_layer
from ..layers.placing import Layer, PlacedLayer, layer_specs, opened_stack, rules_of
from ..system.depfile import Depfile
from ..system.outputs import check_places, whole_output
from ..system.threads import Workers, thread_count
from .budget import DEFAULT_MAX_MEMORY, LAYERS_AT_ONCE, Budget, parse_bytes

if TYPE_CHECKING:  # only reports need them
    from ..measures.findings import StackFindings
    from ..report.recorder import Evidence

T = TypeVar("T")

log = logging.getLogger("hpcomp")


@dataclass(frozen=True)
class StackResult:
    """What `stack` or `flatten` wrote: the file, its windows, what it cannot hold, findings."""

    output: str
    canvas: Window
    data_window: Window
    losses: Losses
    findings: StackFindings | None = None


def stack(
    layers: Sequence[Layer],
    output: str | os.PathLike[str],
    *,
    format: str | None = None,
    op: str = "over",
    blending: str = "hue-preserving",
    order: str | Sequence[int] = "bottom-up",
    space: str = "linear-rgb",
    primaries: str = "rec709",
    hue_tolerance: float = DEFAULT_HUE_TOLERANCE,
    gray_bias: float = 0.0,
    depth: str | int | None = None,
    compression: str | int | None = None,
    out_primaries: str | None = None,
    exposure: float = 0.0,
    region: str | Window | None = None,
    clobber: bool = True,
    canvas: str | Window = "bottom",
    overscan: bool = False,
    background: str | Sequence[float] | None = None,
    nonfinite: str = "error",
    strict: bool = False,
    threads: int | None = None,
    max_memory: str | int = DEFAULT_MAX_MEMORY,
    report: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    provenance: str | os.PathLike[str] | None = None,
    foreign_tolerance: float | None = None,
    achromatic: float | None = None,
    energy_weights: str | Sequence[float] | None = None,
    bins: int | None = None,
    depfile: str | os.PathLike[str] | None = None,
    depfile_target: str | Sequence[str] = (),
    write_if_changed: bool = False,
    command: str = "",
) -> StackResult:
    """Composites layer files, bottom first, into one file.

    `layers`: LAYER strings, paths or `LayerSpec`. `output`: a path ending in .png or .exr, or `-`
    for stdout with `format`. The options are those of `hpcomp stack` and mean the same;
    `primaries` are those that colours are blended in and an EXR is written in, `bottom` those of
    the bottom layer; `out_primaries` those of a PNG, Rec. 709 if None. `background` is a CSS hex
    colour, or straight linear RGB in these primaries, in Rec. 709 with `bottom`; `max_memory` is in
    bytes, or `512M`, `1G`.
    `report`: one path or several, each ending in .txt, .json, .csv, .svg, .png, .pdf or .html, for
    what blending did to the hues; `foreign_tolerance` in degrees (twice `hue_tolerance` if None,
    more in oklab and cielab), `achromatic` in [0, 1], `energy_weights` of red, green and blue, and
    `bins` decide what it counts (0.02, an estimate and 360 if None); `command` is what it says made
    it.
    `provenance`: a path ending in .exr, for the layer whose hue survived in each pixel.
    `depfile`: a path for a rule of make that says what was read; `depfile_target`: of what, the
    output if empty. `write_if_changed`: outputs that have the new bytes already are left as they
    are. SOURCE_DATE_EPOCH in the environment is the only date that is written.
    Returns: what was written, and the findings of a report. Nothing but complete files appear.
    Errors: `SettingError`, `InputError`, `MismatchError`, `OutputError`.
    Warnings: `HpcompWarning`; errors with `strict`.
    Source: Chuang et al. 2009; Porter and Duff 1984.
    """
    specs = layer_specs(layers)
    output = os.fspath(output)
    rules = rules_of(
        specs,
        op,
        blending,
        order,
        space,
        hue_tolerance,
        background,
        exposure,
        primaries,
        gray_bias=gray_bias,
    )
    form = OutputForm.checked(format_of_output(output, format), depth, compression, out_primaries)
    if overscan and form.format == "png":
        raise SettingError("a PNG ends at its canvas: --overscan needs an EXR output")
    wanted_region = parse_window(region) if isinstance(region, str) else region
    reports = [report] if isinstance(report, (str, os.PathLike)) else report
    counted = {
        "foreign tolerance": foreign_tolerance,
        "achromatic": achromatic,
        "energy weights": energy_weights,
        "bins": bins,
    }
    inquiry = None
    if not reports and provenance is None:
        for what, value in counted.items():
            if value is not None:
                raise SettingError(f"{what} {value} changes reports alone: name one with --report")
    else:
        from ..report.recorder import Inquiry

        inquiry = Inquiry.checked(
            reports,
            provenance,
            rules=rules,
            kind=form.kind,
            foreign_tolerance=foreign_tolerance,
            achromatic=achromatic,
            energy_weights=energy_weights,
            bins=bins,
        )
    deps = Depfile.asked(depfile, depfile_target, [output])
    check_places([output, *(inquiry.outputs if inquiry else ()), *([deps.path] if deps else ())])
    n_threads = thread_count(threads)
    budget = parse_bytes(max_memory)

    notices = Notices(strict)
    shown = "stdout" if output == STDIN else output
    with contextlib.ExitStack() as opened:
        target = opened.enter_context(
            whole_output(output, clobber=clobber, if_changed=write_if_changed)
        )
        if inquiry is not None:
            inquiry = inquiry.opened(opened, clobber, write_if_changed)
        if deps is not None:
            opened.enter_context(deps.written([spec.path for spec in specs], write_if_changed))
        stacked = opened.enter_context(
            opened_stack(
                specs,
                rules,
                primaries=primaries,
                canvas=canvas,
                nonfinite=nonfinite,
                notices=notices,
            )
        )
        rules, placed_on, placed = stacked.rules, stacked.canvas, stacked.layers
        readers = [layer.reader for layer in placed]
        window = output_window(
            placed_on, [layer.window for layer in placed], overscan, wanted_region
        )
        block = max(reader.rows_at_once for reader in readers)
        # More threads take more memory: no more of them than the budget has room for.
        extra = (0, 0) if inquiry is None else inquiry.memory(len(readers), window)
        estimate = Budget.of(readers, window.width, rules, form, n_threads, extra)
        while n_threads > 1 and estimate.least(min(block, window.height)) > budget:
            n_threads -= 1
            estimate = Budget.of(readers, window.width, rules, form, n_threads, extra)
        strip_rows = estimate.rows(block, window.height, budget)
        opened.enter_context(codec_threads([*readers, form], reading=1, writing=n_threads))
        log.info(
            "%d layers on canvas %s, %s, order %s, space %s, primaries %s",
            len(specs),
            placed_on,
            blending,
            rules.order.name,
            rules.space.name,
            rules.primaries.name,
        )
        log.info(
            "writing %s in strips of %d rows, %d threads, engine %s",
            window,
            strip_rows,
            n_threads,
            engine.active().NAME,
        )
        bottom = readers[0].part
        writer = open_writer(
            target,
            form,
            window,
            placed_on,
            primaries=rules.primaries,
            pixel_aspect=bottom.pixel_aspect,
            pixels_per_metre=bottom.pixels_per_metre,
            label=shown,
        )
        evidence = None
        if inquiry is not None:
            evidence = opened.enter_context(
                inquiry.evidence(rules, window, placed_on, bottom.pixel_aspect)
            )
        try:
            losses = _run(placed, rules, window, strip_rows, form, writer, n_threads, evidence)
            writer.finish()
        finally:
            writer.abandon()
        if inquiry is not None and evidence is not None:
            inquiry.publish(
                evidence,
                output=shown,
                command=command,
                settings=_settings_in_words(rules, form, placed_on, background),
                labels=[spec.title for spec in specs],
            )
        warn_of_zeroed(readers, notices)
        warn_of_losses(shown, losses, notices)
    return StackResult(
        output, placed_on, window, losses, None if evidence is None else evidence.findings
    )


def _settings_in_words(
    rules: StackRules,
    form: OutputForm,
    canvas: Window,
    background: str | Sequence[float] | None,
) -> dict[str, str]:
    """What was chosen, as a report shows it."""
    return {
        "blending": rules.blending.name,
        "order": rules.order.name,
        "space": rules.space.name,
        "primaries": rules.primaries.name,
        "hue tolerance": f"{rules.hue_tolerance:g}°",
        "gray bias": f"{rules.gray_bias:g}",
        "background": "none" if background is None else str(background),
        "exposure": f"{rules.exposure:g} stops, left out of all measures",
        "canvas": str(canvas),
        "output": f"{form.format.upper()}, {form.depth}, {form.compression}"
        + ("" if form.gamut == REC709 else f", {form.gamut.name}"),
    }


def read_layer(
    path: str | os.PathLike[str],
    *,
    part: str | int | None = None,
    layer: str | None = None,
    alpha: str | None = None,
    colorspace: str | None = None,
    tint: str | None = None,
    primaries: str = "rec709",
    nonfinite: str = "error",
    strict: bool = False,
) -> LayerImage:
    """Reads one layer whole, as `stack` would.

    `path`: a file or a LAYER string; the keywords override its settings and mean the same.
    `primaries`: what the colours are converted to, a name of `stack` other than `bottom`.
    `nonfinite`: `error`, `zero` or `keep`, for NaN and Inf. `strict`: warnings become errors.
    Returns: pixels (height, width, 4) float32, linear Rec. 709 or of `primaries`, premultiplied,
    over `data_window`.
    Errors: `SettingError`, `InputError`, `MismatchError`. Warnings: `HpcompWarning`.
    """
    working = working_primaries(primaries)
    spec = layer_spec(path)
    spec = replace(
        spec,
        part=spec.part if part is None else str(part),
        layer=spec.layer if layer is None else layer,
        alpha=alpha or spec.alpha,
        colorspace=colorspace or spec.colorspace,
        tint=tint or spec.tint,
    )
    notices = Notices(strict)
    with opened_layer(spec, spec.path, nonfinite) as reader:
        reader.work_in(working)
        window = reader.window
        pixels = np.empty((window.height, window.width, 4), np.float32)
        for begin, end in _strips(window, STRIP_ROWS):
            pixels[begin - window.y : end - window.y] = reader.read_rows(begin, end)
        warn_of_problems(reader, notices)
        warn_of_zeroed([reader], notices)
        return LayerImage(pixels, window, reader.part.display_window)


def write_image(
    path: str | os.PathLike[str],
    pixels: Any,
    *,
    format: str | None = None,
    depth: str | int | None = None,
    compression: str | int | None = None,
    primaries: str = "rec709",
    out_primaries: str | None = None,
    data_window: Window | None = None,
    display_window: Window | None = None,
    clobber: bool = True,
    strict: bool = False,
) -> Losses:
    """Writes one picture, as `stack` would: PNG straight sRGB, EXR linear and premultiplied.

    `pixels`: (height, width, 4), linear Rec. 709 or of `primaries`, which an EXR keeps;
    premultiplied, alpha in [0, 1].
    `data_window`: where the pixels lie, +0+0 if not given; `display_window`: as `data_window`.
    `format`, `depth`, `compression`, `out_primaries`, `clobber`, `strict`: as in `stack`.
    Returns: the counts of pixels that the file could not hold as they are.
    Errors: `SettingError`, `MismatchError`, `OutputError`. Warnings: `HpcompWarning`.
    """
    path, working = os.fspath(path), working_primaries(primaries)
    rgba = np.ascontiguousarray(pixels, np.float32)
    if rgba.ndim != 3 or rgba.shape[2] != 4 or 0 in rgba.shape:
        raise MismatchError(f"pixels have shape {rgba.shape}: height, width and 4 are needed")
    form = OutputForm.checked(format_of_output(path, format), depth, compression, out_primaries)
    window = data_window or Window(0, 0, rgba.shape[1], rgba.shape[0])
    if (window.height, window.width) != rgba.shape[:2]:
        raise MismatchError(f"data window {window} does not fit pixels of shape {rgba.shape}")
    rgba = np.concatenate([rgba[..., :3], np.clip(rgba[..., 3:], 0, 1)], axis=2)
    notices = Notices(strict)
    losses = Losses()
    with whole_output(path, clobber=clobber) as target:
        writer = open_writer(
            target, form, window, display_window or window, primaries=working, label=path
        )
        try:
            for begin in range(0, window.height, STRIP_ROWS):
                part = rgba[begin : begin + STRIP_ROWS]
                samples = encode(part, form.kind, losses, working, form.gamut)
                writer.write(writer.prepare(begin, samples))
            writer.finish()
        finally:
            writer.abandon()
        warn_of_losses(path, losses, notices)
    return losses


def info(path: str | os.PathLike[str]) -> ImageFile:
    """What a file holds and how it will be read, from its headers.

    `path`: a PNG or EXR file, or `-` for stdin. Errors: `InputError`.
    """
    path = os.fspath(path)
    label = "stdin" if path == STDIN else path
    with seekable(path, label) as readable:
        return replace(describe(readable, label), path=label)


# --- strips ---------------------------------------------------------------------------------------


def _strips(window: Window, rows: int) -> Iterator[tuple[int, int]]:
    for begin in range(window.y, window.bottom, rows):
        yield begin, min(begin + rows, window.bottom)


def _run(
    layers: Sequence[PlacedLayer],
    rules: StackRules,
    window: Window,
    strip_rows: int,
    form: OutputForm,
    writer: ImageWriter,
    threads: int,
    evidence: Evidence | None,
) -> Losses:
    """Makes the picture: layers are read ahead, and results written behind.

    Returns what the file could not hold. `evidence` is given all layers of a strip at once.
    """

    def strips() -> Iterator[Window]:
        for begin, end in _strips(window, strip_rows):
            yield Window(window.x, begin, window.width, end - begin)

    at_once = LAYERS_AT_ONCE
    if rules.reduction is Reduction.ALL_LAYERS or evidence is not None:
        at_once = len(layers)
    groups = list(_grouped(rules.arrival, at_once))
    reads = (
        (number, partial(layers[number].read, rows))
        for rows in strips()
        for number in rules.arrival
    )
    losses, lock = Losses(), Lock()
    with Workers[Strip](threads) as workers:
        arriving = workers.read_ahead(reads)
        for rows in strips():
            accumulator = engine.start(rules, rows.width, rows.height)
            for group in groups:
                arrived = [next(arriving) for _ in group]
                workers.composite(partial(accumulator.add, group, arrived))
                if evidence is None:
                    arrived = []  # not to be held while the next ones arrive
            begin = rows.y - window.y
            finished = partial(_finished, accumulator, layers, rows, losses, lock)
            if evidence is None:
                plain = partial(accumulator.result, form.kind, gamut=form.gamut)
                workers.write_behind(
                    partial(_prepared, partial(finished, plain), writer, begin), writer.write
                )
                del plain
            else:
                strips_up = list(arrived if group[0] == 0 else reversed(arrived))
                observed = partial(evidence.result, accumulator, strips_up, rows, form)
                tell = partial(evidence.prepare, strips_up, rows)
                workers.write_behind(
                    partial(_prepared_both, partial(finished, observed), writer, begin, tell),
                    partial(_write_both, writer, evidence),
                )
                del strips_up, observed, tell
            del accumulator, arrived, finished
        workers.flush()
    for what, seconds in workers.seconds.items():
        log.info("%s: %.3f s of all threads together", what, seconds)
    return losses


def _grouped(numbers: Sequence[int], size: int) -> Iterator[Sequence[int]]:
    for begin in range(0, len(numbers), size):
        yield numbers[begin : begin + size]


def _finished(
    accumulator: engine.Accumulator,
    layers: Sequence[PlacedLayer],
    rows: Window,
    losses: Losses,
    lock: Lock,
    result: Callable[[Losses], T],
) -> T:
    """What `result` makes of the accumulated strip `rows`; a pixel of its layers may be refused."""
    lost = Losses()
    made = result(lost)
    with lock:
        losses.add(lost)
        for layer, count in zip(layers, accumulator.nonfinite, strict=True):
            if count:
                top = max(rows.y - layer.dy, layer.reader.window.y)
                layer.reader.note_nonfinite(top, count)
    return made


def _prepared(finish: Callable[[], Samples], writer: ImageWriter, begin: int) -> Any:
    return writer.prepare(begin, finish())


def _prepared_both(
    finish: Callable[[], tuple[Samples, Any]],
    writer: ImageWriter,
    begin: int,
    tell: Callable[[Any], Any],
) -> tuple[Any, Any]:
    samples, found = finish()
    return writer.prepare(begin, samples), tell(found)


def _write_both(writer: ImageWriter, evidence: Evidence, prepared: tuple[Any, Any]) -> None:
    writer.write(prepared[0])
    evidence.write(prepared[1])
