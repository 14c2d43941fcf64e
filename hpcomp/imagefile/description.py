"""What a file holds, from its headers alone. No pixels."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

from ..errors import InputError, why
from ..geometry import Window
from . import exrheader, exrscanlines, pngheader, pngscanlines
from .exrscanlines import ExrLayout
from .header import METRES_PER_INCH
from .omissions import omissions_of_png
from .parts import Channel, ImageFile, Part, color_groups
from .pngscanlines import PngLayout
from .rawfile import identity_of

#: What tells the formats of pictures apart.
_HEAD_BYTES = 1024


def describe(path: str, label: str | None = None) -> ImageFile:
    """What the file at `path` holds, from its headers; a PNG's checksums are verified on the way.

    `label` names the file in errors. Errors: `InputError`.
    """
    label = label or path
    kind = _format_of(path, label)
    parts_of = _png_parts if kind == "png" else _exr_parts
    try:
        identity = identity_of(path)  # before all else that is found out
        return ImageFile(path, kind, tuple(parts_of(path, label)), identity)
    except OSError as reason:
        raise InputError(f"{label}: cannot be read: {why(reason)}") from None


def _png_parts(path: str, label: str) -> Iterator[Part]:
    try:
        header = pngheader.read_header(path)
    except InputError as problem:
        raise InputError(f"{label}: {problem}") from None
    layout = pngscanlines.layout_of(header)
    if layout is None:
        (spec,) = _specs(path, label)
        yield _png_part(header, None, _channels(spec), _window(spec))
    else:
        names = "YA" if layout.channels < 3 else "RGBA"
        channels = tuple(
            Channel(name, f"uint{header.depth}", number)
            for number, name in enumerate(names[: layout.channels])
        )
        yield _png_part(header, layout, channels, Window(0, 0, header.width, header.height))


def _exr_parts(path: str, label: str) -> Iterator[Part]:
    layout = exrscanlines.layout_of(path)
    try:
        specs = list(_specs(path, label))
    except InputError:
        parts = exrheader.unread_parts(path)
        if not any(part.is_subsampled for part in parts):
            raise
        yield from parts
        return
    unread = exrheader.unread_parts(path) if None in specs else []
    for number, spec in enumerate(specs):
        if spec is not None:
            yield _exr_part(spec, number, layout)
        elif number < len(unread):
            yield unread[number]


def _specs(path: str, label: str) -> Iterator[Any]:
    """OpenImageIO's description of each picture in the file; None for one that it cannot read."""
    from .openimageio import error_text, open_input

    reader = open_input(path, label)
    try:
        for number in range(max(1, reader.spec().get_int_attribute("oiio:subimages", 1))):
            yield reader.spec() if reader.seek_subimage(number, 0) else None
        error_text(reader)  # what cannot be read is spoken of elsewhere
    finally:
        reader.close()


def _format_of(path: str, label: str) -> str:
    try:
        if os.path.isdir(path):
            raise InputError(f"{label} is a directory: name a PNG or EXR file in it")
        with open(path, "rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as reason:
        raise InputError(f"{label}: cannot be read: {why(reason)}") from None
    if not head:
        raise InputError(f"{label} is empty")
    # A damaged signature still shows which format was meant.
    if head[1:4] == b"PNG" or head[4:8] == pngheader.SIGNATURE[4:]:
        return "png"
    if head[:4] == exrscanlines.MAGIC:
        return "exr"
    from . import otherformats  # few files are of these

    what = otherformats.what_it_is(head, path, shown=path in label)
    raise InputError(f"{label} {what or 'is neither a PNG nor an EXR file: convert it first'}")


def _window(spec: Any, full: bool = False) -> Window:
    if full:
        return Window(spec.full_x, spec.full_y, spec.full_width, spec.full_height)
    return Window(spec.x, spec.y, spec.width, spec.height)


def _channels(spec: Any) -> tuple[Channel, ...]:
    types = spec.channelformats or [spec.format] * spec.nchannels
    return tuple(
        Channel(name, str(kind), number)
        for number, (name, kind) in enumerate(zip(spec.channelnames, types, strict=True))
    )


def _png_part(
    header: pngheader.PngHeader,
    layout: PngLayout | None,
    channels: tuple[Channel, ...],
    window: Window,
) -> Part:
    color = header.color()
    return Part(
        index=0,
        name="",
        channels=channels,
        groups=color_groups(channels),
        data_window=window,
        display_window=window,
        tile=None,
        rows_per_block=header.height if header.interlaced else 1,
        compression="",
        deep=False,
        interlaced=header.interlaced,
        pixel_aspect=header.pixel_aspect,
        pixels_per_metre=header.pixels_per_metre,
        color=color,
        icc_profile=header.icc_profile,
        omissions=omissions_of_png(header),
        layout=layout,
    )


def _exr_part(spec: Any, index: int, layout: ExrLayout | None) -> Part:
    density = spec.get_float_attribute("XResolution"), spec.get_float_attribute("YResolution")
    rows = spec.tile_height or spec.get_int_attribute("oiio:RowsPerChunk", 1)
    channels, window = _channels(spec), _window(spec)
    return Part(
        index=index,
        name=spec.get_string_attribute("oiio:subimagename") or spec.get_string_attribute("name"),
        channels=channels,
        groups=color_groups(channels),
        data_window=window,
        display_window=_window(spec, full=True),
        tile=(spec.tile_width, spec.tile_height) if spec.tile_width else None,
        rows_per_block=max(1, rows),
        compression=spec.get_string_attribute("compression"),
        deep=bool(spec.deep),
        interlaced=False,
        pixel_aspect=spec.get_float_attribute("PixelAspectRatio", 1.0),
        pixels_per_metre=(density[0] / METRES_PER_INCH, density[1] / METRES_PER_INCH)
        if min(density) > 0
        else None,
        color=exrheader.color_of(
            spec.get_string_attribute("colorInteropID"), spec.getattribute("chromaticities")
        ),
        icc_profile="",
        omissions=(),
        layout=layout if layout and layout.window == window else None,
    )
