"""What a file holds, from its headers alone, and which picture of it is meant. No pixels."""

from __future__ import annotations

import contextlib
import os
import select
import stat
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import IO, Any

from .. import pngheader
from ..encoding import (
    COLOR_INTEROP_IDS,
    LINEAR,
    LINEAR_REC709,
    ColorEncoding,
    primaries_from_xy,
)
from ..errors import InputError, why
from ..geometry import Window
from . import exrscanlines, pngscanlines
from .exrscanlines import ExrLayout
from .pngscanlines import PngLayout
from .rawfile import Identity, identity_of

STDIN = "-"
METRES_PER_INCH = 0.0254


@dataclass(frozen=True)
class Channel:
    """One channel of a part: its full name, its stored type, its index."""

    name: str
    type: str
    index: int


@dataclass(frozen=True)
class ColorGroup:
    """The channels of one layer name (empty for the default layer) that make up a colour.

    `color` is R, G, B or a single Y; `alpha` is None where the group has none.
    """

    layer: str
    color: tuple[Channel, ...]
    alpha: Channel | None


@dataclass(frozen=True)
class Part:
    """One picture of a file, and how it will be read; with a `layout`, without OpenImageIO."""

    index: int
    name: str
    channels: tuple[Channel, ...]
    groups: tuple[ColorGroup, ...]
    data_window: Window
    display_window: Window
    tile: tuple[int, int] | None
    rows_per_block: int
    compression: str
    deep: bool
    interlaced: bool
    pixel_aspect: float
    pixels_per_metre: tuple[float, float] | None
    encoding: ColorEncoding
    encoding_source: str
    problems: tuple[str, ...]
    layout: ExrLayout | PngLayout | None = field(repr=False)


@dataclass(frozen=True)
class ImageFile:
    """What a file is, from its headers alone. `format` is `png` or `exr`."""

    path: str
    format: str
    parts: tuple[Part, ...]
    identity: Identity = field(repr=False)

    @property
    def alpha_mode(self) -> str:
        """How alpha relates to colour in this format where nothing else is said."""
        return "straight" if self.format == "png" else "premultiplied"


@contextlib.contextmanager
def seekable(path: str, label: str) -> Iterator[str]:
    """A path that can be read more than once: stdin and pipes are copied to a temporary file."""
    try:
        special = path == STDIN or not _is_plain(path)
    except OSError as reason:
        raise InputError(f"{label}: cannot be read: {why(reason)}") from None
    if not special:
        yield path
        return
    if path == STDIN and sys.stdin is None:
        raise InputError(f"{label}: stdin is closed")
    with _unnamed_copy() as copy:
        try:
            if path == STDIN:
                _copy_pipe(sys.stdin.fileno(), copy)
            else:
                with open(path, "rb", buffering=0) as pipe:
                    _copy_pipe(pipe.fileno(), copy)
            copy.flush()
        except OSError as reason:
            raise InputError(f"{label}: cannot be read: {why(reason)}") from None
        yield copy.name if isinstance(copy.name, str) else f"/dev/fd/{copy.name}"


def _unnamed_copy() -> IO[bytes]:
    """A temporary file that goes with the process, however that ends, where the system has such."""
    import tempfile  # with all that it imports, which plain files have no use for

    if sys.platform == "linux":
        return tempfile.TemporaryFile(prefix="hpcomp.")
    return tempfile.NamedTemporaryFile(prefix="hpcomp.")


#: Seconds after which a signal is noticed that arrived just before a read began to wait.
_PATIENCE = 0.2


def _copy_pipe(source: int, copy: IO[bytes]) -> None:
    while True:
        while not select.select([source], [], [], _PATIENCE)[0]:
            pass
        data = os.read(source, 1 << 20)
        if not data:
            return
        copy.write(data)


def _is_plain(path: str) -> bool:
    """Whether libraries can open it again and again: no pipe, and a name that is UTF-8."""
    mode = os.stat(path).st_mode
    utf8 = path.isascii() or not any("\udc80" <= character <= "\udcff" for character in path)
    return stat.S_ISDIR(mode) or (stat.S_ISREG(mode) and utf8)


def describe(path: str, label: str | None = None) -> ImageFile:
    """What the file at `path` holds, from its headers; a PNG's checksums are verified on the way.

    `label` names the file in errors. Errors: `InputError`.
    """
    label = label or path
    kind = _format_of(path, label)
    identity = identity_of(path)
    parts = _png_parts(path, label) if kind == "png" else _exr_parts(path, label)
    return ImageFile(path, kind, tuple(parts), identity)


def _png_parts(path: str, label: str) -> Iterator[Part]:
    try:
        header = pngheader.read_header(path)
    except InputError as problem:
        raise InputError(f"{label}: {problem}") from None
    layout = pngscanlines.layout_of(header)
    if layout is None:
        for spec in _specs(path, label):
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
    for number, spec in enumerate(_specs(path, label)):
        yield _exr_part(spec, number, layout)


def _specs(path: str, label: str) -> Iterator[Any]:
    """OpenImageIO's description of each picture in the file."""
    from .openimageio import error_text, open_input

    reader = open_input(path, label)
    number = 0
    try:
        while reader.seek_subimage(number, 0):
            yield reader.spec()
            number += 1
        error_text(reader)  # the seek beyond the last part is no error
    finally:
        reader.close()


def _format_of(path: str, label: str) -> str:
    try:
        if os.path.isdir(path):
            raise InputError(f"{label} is a directory: name a PNG or EXR file in it")
        with open(path, "rb") as file:
            head = file.read(8)
    except OSError as reason:
        raise InputError(f"{label}: cannot be read: {why(reason)}") from None
    if not head:
        raise InputError(f"{label} is empty")
    # A damaged signature still shows which format was meant.
    if head == pngheader.SIGNATURE or head[1:4] == b"PNG" or head[4:] == pngheader.SIGNATURE[4:]:
        return "png"
    if head[:4] == b"v/1\x01":
        return "exr"
    raise InputError(f"{label} is neither a PNG nor an EXR file: convert it first")


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
    encoding, source, problems = header.color()
    return Part(
        index=0,
        name="",
        channels=channels,
        groups=_color_groups(channels),
        data_window=window,
        display_window=window,
        tile=None,
        rows_per_block=header.height if header.interlaced else 1,
        compression="",
        deep=False,
        interlaced=header.interlaced,
        pixel_aspect=header.pixel_aspect,
        pixels_per_metre=header.pixels_per_metre,
        encoding=encoding,
        encoding_source=source,
        problems=tuple(f"{problem} is not honoured" for problem in problems),
        layout=layout,
    )


def _exr_part(spec: Any, index: int, layout: ExrLayout | None) -> Part:
    encoding, source, problems = _exr_encoding(spec)
    density = spec.get_float_attribute("XResolution"), spec.get_float_attribute("YResolution")
    rows = spec.tile_height or spec.get_int_attribute("oiio:RowsPerChunk", 1)
    channels, window = _channels(spec), _window(spec)
    return Part(
        index=index,
        name=spec.get_string_attribute("oiio:subimagename") or spec.get_string_attribute("name"),
        channels=channels,
        groups=_color_groups(channels),
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
        encoding=encoding,
        encoding_source=source,
        problems=tuple(problems),
        layout=layout if layout and layout.window == window else None,
    )


def _exr_encoding(spec: Any) -> tuple[ColorEncoding, str, list[str]]:
    """(encoding, what it was read from, what cannot be honoured)."""
    problems: list[str] = []
    interop_id = spec.get_string_attribute("colorInteropID")
    if interop_id in COLOR_INTEROP_IDS:
        return COLOR_INTEROP_IDS[interop_id], "colorInteropID", problems
    if interop_id and interop_id not in ("data", "unknown"):
        problems.append(f"colorInteropID '{interop_id}' is not honoured")
    chromaticities = spec.getattribute("chromaticities")
    if chromaticities is not None:
        try:
            return (
                ColorEncoding(LINEAR, primaries_from_xy(chromaticities)),
                "chromaticities",
                problems,
            )
        except ValueError:
            problems.append("chromaticities that span no gamut are not honoured")
    return LINEAR_REC709, "default", problems


_COMPONENTS = {"r": "R", "red": "R", "g": "G", "green": "G", "b": "B", "blue": "B",
               "x": "X", "y": "Y", "ry": "RY", "by": "BY", "a": "A", "alpha": "A"}  # fmt: skip


def _color_groups(channels: Sequence[Channel]) -> tuple[ColorGroup, ...]:
    """The layers that have a colour: R, G and B, or Y; in the order of their first channel.

    A Y beside an X is a coordinate, and one beside RY and BY is only a part of a colour.
    """
    layers: dict[str, dict[str, Channel]] = {}
    for channel in channels:
        layer, _, component = channel.name.rpartition(".")
        known = _COMPONENTS.get(component.lower())
        if known:
            layers.setdefault(layer, {}).setdefault(known, channel)
    groups = []
    for layer, found in layers.items():
        if all(name in found for name in "RGB"):
            color = tuple(found[name] for name in "RGB")
        elif "Y" in found and not found.keys() & {"X", "RY", "BY"}:
            color = (found["Y"],)
        else:
            continue
        groups.append(ColorGroup(layer, color, found.get("A")))
    return tuple(groups)


def choose(
    file: ImageFile, *, part: str | None = None, layer: str | None = None, label: str | None = None
) -> tuple[Part, ColorGroup]:
    """The one colour that `part` (name or index) and `layer` name, or the only one there is.

    Without `layer` the default RGBA goes before named layers. Errors: `InputError` that lists what
    there is, for an unknown part or layer, for none, and for more than one.
    """
    label = label or file.path
    parts = list(file.parts)
    if part is not None:
        parts = [p for p in parts if p.name == part] or [p for p in parts if str(p.index) == part]
        if not parts:
            there_is = ", ".join(_part_name(p) for p in file.parts)
            raise InputError(f"{label}: there is no part '{part}': choose part= one of {there_is}")
    flat = [p for p in parts if not p.deep]
    if not flat:
        raise InputError(
            f"{label} is a deep EXR: flatten it first, with oiiotool --flatten for example"
        )
    colors = [(p, group) for p in flat for group in p.groups]
    if layer is not None:
        named = [(p, g) for p, g in colors if g.layer == layer]
        if not named:
            there_is = ", ".join(dict.fromkeys(g.layer or "(default)" for _, g in colors)) or "none"
            raise InputError(f"{label}: there is no colour layer '{layer}': there is {there_is}")
    else:
        named = [(p, g) for p, g in colors if not g.layer] or colors
    if not named:
        channels = ", ".join(c.name for p in flat for c in p.channels)
        raise InputError(f"{label} has no colour, only {channels}: R, G, B or Y is needed")
    if len(named) > 1:
        several_parts = len({p.index for p, _ in named}) > 1
        key, names = (
            ("part", [_part_name(p) for p, _ in named])
            if several_parts
            else ("layer", [g.layer for _, g in named])
        )
        raise InputError(
            f"{label}: {len(named)} {key}s fit: choose {key}= one of "
            + ", ".join(dict.fromkeys(names))
        )
    return named[0]


def _part_name(part: Part) -> str:
    return part.name or str(part.index)
