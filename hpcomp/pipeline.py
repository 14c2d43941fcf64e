"""One stack, strip by strip, from files to a file: who holds which rows when."""

from __future__ import annotations

import contextlib
import logging
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from threading import Lock
from typing import Any

import numpy as np

from . import engine
from .addition import DEFAULT_HUE_TOLERANCE
from .canvas import LayerWindows, lay_out, output_window, parse_canvas
from .compositing import Reduction, StackRules, stack_rules
from .encoding import Losses, parse_hex_color
from .errors import MismatchError, SettingError, unknown_name
from .geometry import Window, parse_window
from .imagefile import (
    NONFINITE_POLICIES,
    STDIN,
    STRIP_ROWS,
    ImageFile,
    ImageWriter,
    LayerImage,
    LayerReader,
    OutputForm,
    codec_threads,
    describe,
    format_of_output,
    open_writer,
    seekable,
)
from .layerfile import opened_layer
from .notices import Notices, warn_of_layers, warn_of_losses, warn_of_problems, warn_of_zeroed
from .outputfile import whole_output
from .samples import Samples, Strip, encode
from .stackfile import LayerSpec, layer_spec
from .workers import Workers, reads_ahead, thread_count, writes_behind

log = logging.getLogger("hpcomp")

Layer = LayerSpec | str | os.PathLike[str]

DEFAULT_MAX_MEMORY = "1G"

#: Layers that are added in one pass over a strip, where they fold.
LAYERS_AT_ONCE = 8
#: A thread's stack and arena.
THREAD_BYTES = 2 << 20
#: Of the budget: the rest is for what the allocator keeps back.
USED_SHARE = 0.85
#: What the reference engine takes for a block of pixels and the pairs of their terms.
NUMPY_BYTES = 10 << 20
#: A pixel of float32 RGBA, of an accumulator's planes, and of numpy's decoding, partly in doubles.
RGBA_BYTES, PLANES_BYTES, DECODING_BYTES = 16, 20, 180
#: Files that are open beside the layers: libraries, the output, the standard streams.
OTHER_OPEN_FILES = 64


@dataclass(frozen=True)
class StackResult:
    """What `stack` wrote: the file, its windows, and what the file could not hold."""

    output: str
    canvas: Window
    data_window: Window
    losses: Losses


def stack(
    layers: Sequence[Layer],
    output: str | os.PathLike[str],
    *,
    format: str | None = None,
    op: str = "over",
    blending: str = "hue-preserving",
    order: str | Sequence[int] = "bottom-up",
    space: str = "linear-rgb",
    hue_tolerance: float = DEFAULT_HUE_TOLERANCE,
    depth: str | int | None = None,
    compression: str | int | None = None,
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
) -> StackResult:
    """Composites layer files, bottom first, into one file.

    `layers`: LAYER strings, paths or `LayerSpec`. `output`: a path ending in .png or .exr, or `-`
    for stdout with `format`. The options are those of `hpcomp stack` and mean the same;
    `background` is a CSS hex colour or straight linear RGB, `max_memory` bytes or `512M`, `1G`.
    Returns: what was written. Nothing but a complete picture appears at `output`.
    Errors: `SettingError`, `InputError`, `MismatchError`, `OutputError`.
    Warnings: `HpcompWarning`; errors with `strict`.
    Source: Chuang et al. 2009; Porter and Duff 1984.
    """
    specs = [_numbered(number, layer) for number, layer in enumerate(layers)]
    output = os.fspath(output)
    rules = _rules(specs, op, blending, order, space, hue_tolerance, background, exposure)
    form = OutputForm.checked(format_of_output(output, format), depth, compression)
    if overscan and form.format == "png":
        raise SettingError("a PNG ends at its canvas: --overscan needs an EXR output")
    wanted_canvas = parse_canvas(canvas)
    wanted_region = parse_window(region) if isinstance(region, str) else region
    if nonfinite not in NONFINITE_POLICIES:
        raise unknown_name("nonfinite policy", nonfinite, NONFINITE_POLICIES)
    n_threads = thread_count(threads)
    budget = parse_bytes(max_memory)
    if [spec.path for spec in specs].count(STDIN) > 1:
        raise SettingError("stdin can be only one of the layers")

    notices = Notices(strict)
    shown = "stdout" if output == STDIN else output
    with contextlib.ExitStack() as opened:
        target = opened.enter_context(whole_output(output, clobber=clobber))
        _allow_open_files(len(specs))
        readers = [
            opened.enter_context(opened_layer(spec, spec.label(number), nonfinite))
            for number, spec in enumerate(specs)
        ]
        warn_of_layers(rules, readers, notices)
        placed_on, placed = _placed(specs, readers, wanted_canvas)
        window = output_window(
            placed_on, [layer.window for layer in placed], overscan, wanted_region
        )
        block = max(reader.rows_at_once for reader in readers)
        # More threads take more memory: no more of them than the budget has room for.
        estimate = Budget.of(placed, window.width, rules, form, n_threads)
        while n_threads > 1 and estimate.least(min(block, window.height)) > budget:
            n_threads -= 1
            estimate = Budget.of(placed, window.width, rules, form, n_threads)
        strip_rows = estimate.rows(block, window.height, budget)
        opened.enter_context(codec_threads([*readers, form], reading=1, writing=n_threads))
        log.info(
            "%d layers on canvas %s, %s, order %s",
            len(specs),
            placed_on,
            blending,
            rules.order.name,
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
            pixel_aspect=bottom.pixel_aspect,
            pixels_per_metre=bottom.pixels_per_metre,
            label=shown,
        )
        try:
            losses = _run(placed, rules, window, strip_rows, form, writer, n_threads)
            writer.finish()
        finally:
            writer.abandon()
        warn_of_zeroed(readers, notices)
        warn_of_losses(shown, losses, notices)
    return StackResult(output, placed_on, window, losses)


def read_layer(
    path: str | os.PathLike[str],
    *,
    part: str | int | None = None,
    layer: str | None = None,
    alpha: str | None = None,
    colorspace: str | None = None,
    nonfinite: str = "error",
    strict: bool = False,
) -> LayerImage:
    """Reads one layer whole, as `stack` would.

    `path`: a file or a LAYER string; the keywords override its settings and mean the same.
    `nonfinite`: `error`, `zero` or `keep`, for NaN and Inf. `strict`: warnings become errors.
    Returns: pixels (height, width, 4) float32, linear Rec. 709, premultiplied, over `data_window`.
    Errors: `SettingError`, `InputError`, `MismatchError`. Warnings: `HpcompWarning`.
    """
    spec = layer_spec(path)
    spec = replace(
        spec,
        part=spec.part if part is None else str(part),
        layer=spec.layer if layer is None else layer,
        alpha=alpha or spec.alpha,
        colorspace=colorspace or spec.colorspace,
    )
    notices = Notices(strict)
    with opened_layer(spec, spec.path, nonfinite) as reader:
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
    data_window: Window | None = None,
    display_window: Window | None = None,
    clobber: bool = True,
    strict: bool = False,
) -> Losses:
    """Writes one picture, as `stack` would: PNG straight sRGB, EXR linear and premultiplied.

    `pixels`: (height, width, 4), linear Rec. 709, premultiplied, alpha in [0, 1].
    `data_window`: where the pixels lie, +0+0 if not given; `display_window`: as `data_window`.
    `format`, `depth`, `compression`, `clobber`, `strict`: as in `stack`.
    Returns: the counts of pixels that the file could not hold as they are.
    Errors: `SettingError`, `MismatchError`, `OutputError`. Warnings: `HpcompWarning`.
    """
    path = os.fspath(path)
    rgba = np.ascontiguousarray(pixels, np.float32)
    if rgba.ndim != 3 or rgba.shape[2] != 4 or 0 in rgba.shape:
        raise MismatchError(f"pixels have shape {rgba.shape}: height, width and 4 are needed")
    form = OutputForm.checked(format_of_output(path, format), depth, compression)
    window = data_window or Window(0, 0, rgba.shape[1], rgba.shape[0])
    if (window.height, window.width) != rgba.shape[:2]:
        raise MismatchError(f"data window {window} does not fit pixels of shape {rgba.shape}")
    rgba = np.concatenate([rgba[..., :3], np.clip(rgba[..., 3:], 0, 1)], axis=2)
    notices = Notices(strict)
    losses = Losses()
    with whole_output(path, clobber=clobber) as target:
        writer = open_writer(target, form, window, display_window or window, label=path)
        try:
            for begin in range(0, window.height, STRIP_ROWS):
                samples = encode(rgba[begin : begin + STRIP_ROWS], form.kind, losses)
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


# --- settings -------------------------------------------------------------------------------------


def _numbered(number: int, layer: Layer) -> LayerSpec:
    try:
        return layer_spec(layer)
    except SettingError as problem:
        raise SettingError(f"layer {number} ({layer}): {problem}") from None


def _rules(
    specs: Sequence[LayerSpec],
    op: str,
    blending: str,
    order: str | Sequence[int],
    space: str,
    hue_tolerance: float,
    background: str | Sequence[float] | None,
    exposure: float,
) -> StackRules:
    return stack_rules(
        len(specs),
        op=[spec.op or (op if number else None) for number, spec in enumerate(specs)],
        opacity=[spec.opacity for spec in specs],
        blending=blending,
        order=order,
        space=space,
        hue_tolerance=hue_tolerance,
        background=parse_hex_color(background) if isinstance(background, str) else background,
        exposure=exposure,
    )


_BYTES = re.compile(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", re.IGNORECASE | re.ASCII)


def parse_bytes(text: str | int) -> int:
    """A number of bytes from `64M`, `1.5G` or a plain number; powers of 1024."""
    match = _BYTES.fullmatch(str(text))
    if not match:
        raise SettingError(f"'{text}' is not an amount of memory: write 512M or 2G")
    number, unit = match.groups()
    return int(float(number) * 1024 ** " KMGT".index(unit.upper() or " "))


# --- layers ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PlacedLayer:
    """An open layer and how far its file's coordinates move to the canvas."""

    reader: LayerReader
    dx: int
    dy: int

    @property
    def window(self) -> Window:
        """Its pixels, in canvas coordinates."""
        return self.reader.window.moved(self.dx, self.dy)

    def read(self, rows: Window) -> Strip | None:
        """What the layer has of `rows` of the canvas, None where it has nothing there."""
        common = self.window.intersection(rows)
        if common is None:
            return None
        begin = common.y - self.dy
        samples = self.reader.read_samples(begin, begin + common.height)
        return Strip(samples, self.reader.decoding, self.window.x - rows.x, common.y - rows.y)


def _allow_open_files(layers: int) -> None:
    """Raises the limit on open files to what a stack of so many layers needs, where it may be."""
    try:
        import resource
    except ImportError:
        return  # not a Unix: no such limit
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = layers + OTHER_OPEN_FILES
    if soft != resource.RLIM_INFINITY and soft < wanted:
        allowed = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, allowed), hard))


def _placed(
    specs: Sequence[LayerSpec], readers: Sequence[LayerReader], canvas: str | Window
) -> tuple[Window, list[PlacedLayer]]:
    """The canvas, and the layers on it."""
    found = lay_out(
        [
            LayerWindows(r.label, r.part.display_window, r.window, spec.placement)
            for spec, r in zip(specs, readers, strict=True)
        ],
        canvas,
    )
    layers = [PlacedLayer(r, *offset) for r, offset in zip(readers, found.offsets, strict=True)]
    return found.window, layers


# --- strips ---------------------------------------------------------------------------------------


def _strips(window: Window, rows: int) -> Iterator[tuple[int, int]]:
    for begin in range(window.y, window.bottom, rows):
        yield begin, min(begin + rows, window.bottom)


@dataclass(frozen=True)
class Budget:
    """What a stack takes of memory, in bytes: for each row of a strip, and whatever the strips."""

    per_row: int
    fixed: int

    @staticmethod
    def of(
        layers: Sequence[PlacedLayer],
        width: int,
        rules: StackRules,
        form: OutputForm,
        threads: int,
    ) -> Budget:
        """An estimate from above; the tests hold it against real peaks."""
        readers = [layer.reader for layer in layers]
        if rules.reduction is Reduction.ALL_LAYERS or len(readers) <= LAYERS_AT_ONCE:
            # Strips that are being finished still hold their layers.
            held = sum(reader.bytes_per_row for reader in readers) * (1 + writes_behind(threads))
        else:
            widest = sorted((reader.bytes_per_row for reader in readers), reverse=True)
            held = sum(widest[:LAYERS_AT_ONCE])
        decoded = 0
        in_numpy = engine.active().DECODES_IN_NUMPY
        if in_numpy or not all(reader.is_plain for reader in readers):
            at_once = len(readers) if rules.reduction is Reduction.ALL_LAYERS else LAYERS_AT_ONCE
            decoded = min(at_once, len(readers)) * RGBA_BYTES + DECODING_BYTES
        widest_row = max(reader.bytes_per_row for reader in readers)
        return Budget(
            per_row=held
            + reads_ahead(threads) * widest_row
            + width * (decoded + writes_behind(threads) * (PLANES_BYTES + form.bytes_per_pixel)),
            fixed=(NUMPY_BYTES if in_numpy else 0)
            + sum(reader.bytes_held for reader in readers)
            + threads * max(reader.bytes_to_decode for reader in readers)
            + form.bytes_to_encode(width, threads)
            + threads * THREAD_BYTES,
        )

    def rows(self, block: int, height: int, max_memory: int) -> int:
        """How many rows at a time fit: whole compression blocks, and not needlessly many.

        Errors: `MismatchError` that names the least memory this stack can be made in.
        """
        block = min(block, height)
        least = self.least(block)
        if least > max_memory:
            raise MismatchError(
                f"this stack needs at least {-(-least // 2**20)}M"
                + (f", as a file is stored {block} rows at a time" if block > 1 else "")
                + f": raise --max-memory, which is {max_memory / 2**20:.0f}M"
            )
        rows = (int(max_memory * USED_SHARE) - self.fixed) // self.per_row
        wanted = -(-STRIP_ROWS // block) * block
        return max(block, min(wanted, rows - rows % block))

    def least(self, block: int) -> int:
        """The memory for strips of one compression block: any less would decode it many times."""
        return int((self.fixed + block * self.per_row) / USED_SHARE) + 1


def _run(
    layers: Sequence[PlacedLayer],
    rules: StackRules,
    window: Window,
    strip_rows: int,
    form: OutputForm,
    writer: ImageWriter,
    threads: int,
) -> Losses:
    """Makes the picture: layers are read ahead, and results written behind.

    Returns what the file could not hold.
    """

    def strips() -> Iterator[Window]:
        for begin, end in _strips(window, strip_rows):
            yield Window(window.x, begin, window.width, end - begin)

    at_once = LAYERS_AT_ONCE
    if rules.reduction is Reduction.ALL_LAYERS:
        at_once = len(layers)
    groups = list(_grouped(rules.arrival, at_once))
    reads = (
        (number, partial(layers[number].read, rows))
        for rows in strips()
        for number in rules.arrival
    )
    losses, lock = Losses(), Lock()
    with Workers[Strip | None](threads) as workers:
        arriving = workers.read_ahead(reads)
        for rows in strips():
            accumulator = engine.start(rules, rows.width, rows.height)
            for group in groups:
                arrived = [next(arriving) or _NOTHING for _ in group]
                workers.composite(partial(accumulator.add, group, arrived))
                del arrived
            finish = partial(_finished, accumulator, layers, rows, window, form, losses, lock)
            workers.write_behind(
                partial(_prepared, finish, writer, rows.y - window.y), writer.write
            )
            del accumulator
        workers.flush()
    for what, seconds in workers.seconds.items():
        log.info("%s: %.3f s of all threads together", what, seconds)
    return losses


#: A layer without pixels in a strip: transparent all over.
_NOTHING = Strip(np.zeros((0, 0, 4), np.float32))


def _grouped(numbers: Sequence[int], size: int) -> Iterator[Sequence[int]]:
    for begin in range(0, len(numbers), size):
        yield numbers[begin : begin + size]


def _finished(
    accumulator: engine.Accumulator,
    layers: Sequence[PlacedLayer],
    rows: Window,
    window: Window,
    form: OutputForm,
    losses: Losses,
    lock: Lock,
) -> Samples:
    """The strip `rows` as samples of the output."""
    lost = Losses()
    samples = accumulator.result(form.kind, lost)
    with lock:
        losses.add(lost)
        for layer, count in zip(layers, accumulator.nonfinite, strict=True):
            if count:
                top = max(rows.y - layer.dy, layer.reader.window.y)
                layer.reader.note_nonfinite(top, count)
    return samples


def _prepared(finish: Callable[[], Samples], writer: ImageWriter, begin: int) -> Any:
    return writer.prepare(begin, finish())
