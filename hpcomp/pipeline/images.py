"""Whole pictures for the API: one layer read, one picture written, one file described."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np

from ..color.primaries import working_primaries
from ..color.quantization import Losses
from ..color.samples import encode
from ..errors import MismatchError
from ..geometry import Window
from ..imagefile.description import describe
from ..imagefile.header import PictureHeader
from ..imagefile.parts import ImageFile
from ..imagefile.reading import STRIP_ROWS, LayerImage
from ..imagefile.seekable import seekable
from ..imagefile.writing import OutputForm, format_of_output, open_writer
from ..layers.layerspec import layer_spec
from ..layers.notices import Notices, warn_of_losses, warn_of_problems, warn_of_samples
from ..layers.opening import opened_layer
from ..options import OutputOptions, ResourceOptions, RuleOptions
from ..system.outputs import whole_output
from ..system.streams import STDIN


def read_layer(
    path: str | os.PathLike[str],
    *,
    part: str | int | None = None,
    layer: str | None = None,
    alpha: str | None = None,
    colorspace: str | None = None,
    tint: str | None = None,
    primaries: str = RuleOptions.primaries,
    nonfinite: str = RuleOptions.nonfinite,
    strict: bool = RuleOptions.strict,
    max_pixels: str | int = ResourceOptions.max_pixels,
) -> LayerImage:
    """Reads one layer whole, as `stack` would.

    `path`: a file or a LAYER string; the keywords override its settings and mean the same.
    `primaries`: what the colours are converted to, a name of `stack` other than `bottom`.
    `nonfinite`: `error`, `zero` or `keep`, for NaN and Inf. `strict`: warnings become errors.
    `max_pixels`: a file that claims more is refused; a number, or `4G`.
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
    with opened_layer(spec, spec.path, nonfinite, max_pixels) as reader:
        reader.work_in(working)
        window = reader.window
        pixels = np.empty((window.height, window.width, 4), np.float32)
        for rows in window.strips(STRIP_ROWS):
            top, bottom = rows.y - window.y, rows.bottom - window.y
            pixels[top:bottom] = reader.read_rows(rows.y, rows.bottom)
        warn_of_problems(reader, notices)
        warn_of_samples([reader], notices)
        return LayerImage(pixels, window, reader.part.display_window)


def write_image(
    path: str | os.PathLike[str],
    pixels: Any,
    *,
    format: str | None = None,
    depth: str | int | None = None,
    compression: str | int | None = None,
    primaries: str = RuleOptions.primaries,
    out_primaries: str | None = None,
    data_window: Window | None = None,
    display_window: Window | None = None,
    clobber: bool = OutputOptions.clobber,
    strict: bool = RuleOptions.strict,
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
        header = PictureHeader(window, display_window or window, working)
        writer = open_writer(target, form, header, path)
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
