"""Image files in and out, strip by strip. The only importer of OpenImageIO.

Reading gives linear Rec. 709, premultiplied float32 RGBA whatever the file holds; writing takes it.
Where a layer lies on the canvas, and what is done with it, is not known here.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from . import exrheader, pngheader
from .encoding import (
    COLOR_INTEROP_IDS,
    LINEAR,
    LINEAR_REC709,
    REC709,
    ColorEncoding,
    Losses,
    color_space,
    decode_table,
    primaries_from_xy,
    to_half_range,
    to_rec709,
    to_straight_srgb,
)
from .errors import InputError, MismatchError, OutputError, SettingError, unknown_name
from .geometry import Window
from .spaces import REC709_WEIGHTS

Rgba = NDArray[np.float32]

# Errors that nobody fetched would otherwise be printed on stdout when the process ends.
oiio.attribute("oiio:print_uncaught_errors", 0)

NONFINITE_POLICIES = ("error", "zero", "keep")

#: Rows that are read at a time where the caller does not say: whole compression blocks, few calls.
STRIP_ROWS = 64

STDIN = "-"


# --- what a file holds ----------------------------------------------------------------------------


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
    """One picture of a file, and how it will be read."""

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


@dataclass(frozen=True)
class ImageFile:
    """What a file is, from its headers alone. `format` is `png` or `exr`."""

    path: str
    format: str
    parts: tuple[Part, ...]

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
        raise InputError(f"{label}: cannot be read: {_why(reason)}") from None
    if not special:
        yield path
        return
    if path == STDIN and sys.stdin is None:
        raise InputError(f"{label}: stdin is closed")
    with tempfile.NamedTemporaryFile(prefix="hpcomp.") as copy:
        try:
            if path == STDIN:
                shutil.copyfileobj(sys.stdin.buffer, copy, 1 << 20)
            else:
                with open(path, "rb") as pipe:
                    shutil.copyfileobj(pipe, copy, 1 << 20)
            copy.flush()
        except OSError as reason:
            raise InputError(f"{label}: cannot be read: {_why(reason)}") from None
        yield copy.name


def _is_plain(path: str) -> bool:
    mode = os.stat(path).st_mode
    return stat.S_ISREG(mode) or stat.S_ISDIR(mode)


def describe(path: str, label: str | None = None) -> ImageFile:
    """What the file at `path` holds, from its headers; a PNG's checksums are verified on the way.

    `label` names the file in errors. Errors: `InputError`.
    """
    label = label or path
    kind = _format_of(path, label)
    header = None
    if kind == "png":
        try:
            header = pngheader.read_header(path)
        except InputError as problem:
            raise InputError(f"{label}: {problem}") from None
    reader = _open(path, label)
    try:
        parts: list[Part] = []
        while reader.seek_subimage(len(parts), 0):
            spec = reader.spec()
            parts.append(_png_part(spec, header) if header else _exr_part(spec, len(parts)))
        reader.geterror()  # the seek beyond the last part is no error
    finally:
        reader.close()
    return ImageFile(path, kind, tuple(parts))


def _format_of(path: str, label: str) -> str:
    try:
        if os.path.isdir(path):
            raise InputError(f"{label} is a directory: name a PNG or EXR file in it")
        with open(path, "rb") as file:
            head = file.read(8)
    except OSError as reason:
        raise InputError(f"{label}: cannot be read: {_why(reason)}") from None
    if not head:
        raise InputError(f"{label} is empty")
    # A damaged signature still shows which format was meant.
    if head == pngheader.SIGNATURE or head[1:4] == b"PNG" or head[4:] == pngheader.SIGNATURE[4:]:
        return "png"
    if head[:4] == b"v/1\x01":
        return "exr"
    raise InputError(f"{label} is neither a PNG nor an EXR file: convert it first")


def _why(reason: OSError) -> str:
    return (reason.strerror or str(reason)).lower()


def _error_text(source: Any) -> str:
    """The first line of OpenImageIO's error, which may quote bytes of a damaged file."""
    try:
        lines = source.geterror().strip().splitlines()
    except UnicodeDecodeError:
        lines = []
    return str(lines[0]) if lines else "the file is damaged"


def _open(path: str, label: str) -> Any:
    config = oiio.ImageSpec()
    # Without this OpenImageIO premultiplies PNG in encoded 8-bit values.
    config.attribute("oiio:UnassociatedAlpha", 1)
    reader = oiio.ImageInput.open(path, config)
    if reader is None:
        reason = _error_text(oiio)
        raise InputError(f"{label}: cannot be read: {exrheader.explain(path) or reason}")
    # Headers with an attribute that cannot be parsed open all the same, and leave an error behind.
    _error_text(reader)
    return reader


def _window(spec: Any, full: bool = False) -> Window:
    if full:
        return Window(spec.full_x, spec.full_y, spec.full_width, spec.full_height)
    return Window(spec.x, spec.y, spec.width, spec.height)


def _part(spec: Any, index: int, **found: Any) -> Part:
    types = spec.channelformats or [spec.format] * spec.nchannels
    channels = tuple(
        Channel(name, str(kind), number)
        for number, (name, kind) in enumerate(zip(spec.channelnames, types, strict=True))
    )
    return Part(
        index=index,
        name=spec.get_string_attribute("oiio:subimagename") or spec.get_string_attribute("name"),
        channels=channels,
        groups=_color_groups(channels),
        data_window=_window(spec),
        display_window=_window(spec, full=True),
        tile=(spec.tile_width, spec.tile_height) if spec.tile_width else None,
        compression=spec.get_string_attribute("compression"),
        deep=bool(spec.deep),
        **found,
    )


def _png_part(spec: Any, header: pngheader.PngHeader) -> Part:
    encoding, source, problems = header.color()
    return _part(
        spec,
        0,
        rows_per_block=header.height if header.interlaced else 1,
        interlaced=header.interlaced,
        pixel_aspect=header.pixel_aspect,
        pixels_per_metre=header.pixels_per_metre,
        encoding=encoding,
        encoding_source=source,
        problems=tuple(f"{problem} is not honoured" for problem in problems),
    )


def _exr_part(spec: Any, index: int) -> Part:
    encoding, source, problems = _exr_encoding(spec)
    density = spec.get_float_attribute("XResolution"), spec.get_float_attribute("YResolution")
    rows = spec.tile_height or spec.get_int_attribute("oiio:RowsPerChunk", 1)
    return _part(
        spec,
        index,
        rows_per_block=max(1, rows),
        interlaced=False,
        pixel_aspect=spec.get_float_attribute("PixelAspectRatio", 1.0),
        pixels_per_metre=(density[0] / _METRES_PER_INCH, density[1] / _METRES_PER_INCH)
        if min(density) > 0
        else None,
        encoding=encoding,
        encoding_source=source,
        problems=tuple(problems),
    )


_METRES_PER_INCH = 0.0254


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


# --- which picture of a file ----------------------------------------------------------------------


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


# --- reading --------------------------------------------------------------------------------------


class LayerReader:
    """One layer of a file, read in strips as linear Rec. 709, premultiplied float32 RGBA.

    `alpha` is one of `encoding.ALPHA_MODES` or None for the format's own; `colorspace` a name of
    `encoding.COLOR_SPACES` or None for what the file says; `nonfinite` a policy on NaN and Inf:
    `error`, `zero` (such a pixel becomes transparent black), `keep`. `label` names it in errors.
    """

    def __init__(
        self,
        file: ImageFile,
        part: Part,
        group: ColorGroup,
        *,
        alpha: str | None = None,
        colorspace: str | None = None,
        nonfinite: str = "error",
        label: str | None = None,
    ) -> None:
        if nonfinite not in NONFINITE_POLICIES:
            raise unknown_name("nonfinite policy", nonfinite, NONFINITE_POLICIES)
        self.file, self.part, self.group = file, part, group
        self.label = label or file.path
        self.encoding = color_space(colorspace) if colorspace else part.encoding
        self.problems = () if colorspace else part.problems
        self.alpha_mode = alpha or file.alpha_mode
        self.nonfinite = nonfinite
        self.zeroed_pixels = 0
        self._matrix = to_rec709(self.encoding.primaries)
        self._reader: Any = None

    @property
    def window(self) -> Window:
        """The pixels that there are, in the file's own coordinates."""
        return self.part.data_window

    @property
    def has_alpha(self) -> bool:
        return self.group.alpha is not None or self.alpha_mode == "luminance"

    @property
    def bytes_per_row(self) -> int:
        """Memory to decode one row into RGBA: as stored, as floats, and as the result."""
        return self.window.width * _DECODED_BYTES

    @property
    def bytes_to_decode(self) -> int:
        """Memory of the codec while it decodes: one block of every channel, packed and unpacked."""
        block = self.part.rows_per_block * self._bytes_per_stored_row
        if self.part.interlaced:
            return 0
        return 3 * block if self.part.tile is None else 3 * block + 4 * block

    @property
    def bytes_held(self) -> int:
        """Memory of the codec as long as the file is open: all of an interlaced PNG."""
        rows = self.part.rows_per_block if self.part.interlaced else 1
        return _OPEN_FILE_BYTES + rows * self._bytes_per_stored_row

    @property
    def _bytes_per_stored_row(self) -> int:
        return self.window.width * sum(_SAMPLE_BYTES.get(c.type, 4) for c in self.part.channels)

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def read_rows(self, begin: int, end: int) -> Rgba:
        """Rows `begin` to `end` of the data window, in the file's coordinates.

        Returns (rows, width, 4). Errors: `InputError` where they do not decode, `MismatchError`
        for a value that is not finite, where the policy says so.
        """
        rgba = self._decoded(begin, end)
        if self.nonfinite != "keep" and not np.isfinite(rgba).all():
            broken = np.any(~np.isfinite(rgba), axis=2)
            if self.nonfinite == "error":
                raise self._nonfinite_error(begin, broken)
            rgba[broken] = 0
            self.zeroed_pixels += int(broken.sum())
        elif self.nonfinite == "keep":
            np.clip(rgba[..., 3], 0, 1, out=rgba[..., 3])
        return rgba

    def _nonfinite_error(self, begin: int, broken: NDArray[np.bool_]) -> MismatchError:
        y, x = np.argwhere(broken)[0]
        count = int(broken.sum())
        for row in range(begin + len(broken), self.window.bottom, STRIP_ROWS):
            rest = self._decoded(row, min(row + STRIP_ROWS, self.window.bottom))
            count += int((~np.isfinite(rest).all(axis=2)).sum())
        pixels = "1 pixel is" if count == 1 else f"{count} pixels are"
        return MismatchError(
            f"{self.label}: {pixels} NaN or infinite, the first at "
            f"{self.window.x + x},{begin + y}: --nonfinite zero or keep lets them pass"
        )

    def _decoded(self, begin: int, end: int) -> Rgba:
        """Linear, premultiplied, alpha clamped; NaN and Inf as they come."""
        rgba = np.empty((end - begin, self.window.width, 4), np.float32)
        rgb, alpha = rgba[..., :3], rgba[..., 3]
        stored_alpha = self.group.alpha
        with np.errstate(invalid="ignore", over="ignore"):
            color = self._stored(self.group.color, begin, end)
            if stored_alpha is None:
                alpha[:] = 1
            else:
                stored = _as_float(self._stored([stored_alpha], begin, end)[..., 0])
                # Infinities stay as they are until the policy on them has been asked.
                alpha[:] = np.where(np.isinf(stored), stored, np.clip(stored, 0, 1))
            if self.alpha_mode == "premultiplied-encoded" and stored_alpha is not None:
                rgb[:] = self._linear(_divided(_as_float(color), alpha))
                rgb *= alpha[..., None]
            else:
                rgb[:] = self._linear(color)
            if self.alpha_mode == "straight" and stored_alpha is not None:
                rgb *= alpha[..., None]
            elif self.alpha_mode == "luminance":
                self._alpha_from_luminance(rgb, alpha)
        return rgba

    def _alpha_from_luminance(self, rgb: Rgba, alpha: Rgba) -> None:
        """Makes the alpha of the straight colours their luminance times the file's alpha."""
        if self.file.alpha_mode == "premultiplied":
            rgb[:] = _divided(rgb, alpha)
        w_red, w_green, w_blue = REC709_WEIGHTS
        luminance = w_red * rgb[..., 0] + w_green * rgb[..., 1] + w_blue * rgb[..., 2]
        alpha *= np.clip(luminance, 0, 1)
        rgb *= alpha[..., None]

    def _linear(self, stored: NDArray[Any]) -> Rgba:
        """Stored colour values (…, 1 or 3) as linear Rec. 709 (…, 3 or 1 to be spread over 3)."""
        transfer = self.encoding.transfer
        if stored.dtype.kind == "u" and stored.dtype.itemsize <= 2:
            linear = decode_table(transfer, int(np.iinfo(stored.dtype).max))[stored]
        elif transfer is LINEAR:
            linear = stored
        else:
            linear = transfer.decode(stored.astype(np.float64)).astype(np.float32)
        if self._matrix is None or linear.shape[-1] == 1:
            return linear  # a grey is the same grey in all primaries
        planes = np.moveaxis(linear, -1, 0)
        return np.stack(
            [
                sum(float(m) * plane for m, plane in zip(row, planes, strict=True))
                for row in self._matrix
            ],
            axis=-1,
        )

    def _stored(self, channels: Sequence[Channel], begin: int, end: int) -> NDArray[Any]:
        """Channels as stored, (rows, width, channels): uint8 or uint16 of PNG, float32 of EXR."""
        first, last = channels[0], channels[-1]
        together = [c.index for c in channels] == list(range(first.index, last.index + 1))
        if together and len({c.type for c in channels}) == 1:
            return self._native(first, last.index + 1, begin, end)
        planes = [self._native(c, c.index + 1, begin, end) for c in channels]
        return np.concatenate(planes, axis=2)

    def _native(self, first: Channel, stop: int, begin: int, end: int) -> NDArray[Any]:
        if self._reader is None:
            self._reader = _open(self.file.path, self.label)
        reader, index = self._reader, self.part.index
        # uint32 is read as it is and never normalised; halves are widened while they decode.
        wanted = first.type if first.type in ("uint8", "uint16", "uint") else "float"
        if self.part.tile is None:
            pixels = reader.read_scanlines(
                index, 0, begin, end, 0, first.index, stop, oiio.TypeDesc(wanted)
            )
        else:
            pixels = self._tile_rows(first.index, stop, begin, end, wanted)
        if pixels is None:
            raise InputError(
                f"{self.label}: cannot be read, rows {begin} to {end - 1}: {_error_text(reader)}"
            )
        pixels = pixels.reshape(end - begin, self.window.width, stop - first.index)
        return pixels.astype(np.float32) if wanted == "uint" else pixels

    def _tile_rows(self, first: int, stop: int, begin: int, end: int, wanted: str) -> Any:
        """Whole tiles around the rows, cut down to them; None where they do not decode."""
        assert self.part.tile is not None
        window, height = self.window, self.part.tile[1]
        top = window.y + (begin - window.y) // height * height
        bottom = min(window.bottom, window.y - (window.y - end) // height * height)
        tiles = self._reader.read_tiles(
            self.part.index, 0, window.x, window.right, top, bottom, 0, 1, first, stop,
            oiio.TypeDesc(wanted),
        )  # fmt: skip
        if tiles is None:
            return None
        tiles = tiles.reshape(bottom - top, window.width, stop - first)
        return np.ascontiguousarray(tiles[begin - top : end - top])


def _as_float(stored: NDArray[Any]) -> Rgba:
    """Stored values with 1.0 as white: integers of a PNG by their largest, floats as they are."""
    if stored.dtype.kind != "u":
        return stored
    return (stored / np.float32(np.iinfo(stored.dtype).max)).astype(np.float32)


def _divided(rgb: Rgba, alpha: Rgba) -> Rgba:
    """rgb / alpha; where alpha is 0, 0 for what is finite and NaN for what is not."""
    quotient = rgb * np.float32(0)
    return np.divide(rgb, alpha[..., None], out=quotient, where=alpha[..., None] > 0)


#: Of the sample types that files store.
_SAMPLE_BYTES = {"uint8": 1, "uint16": 2, "half": 2, "float": 4, "uint": 4}
#: A pixel while it is decoded: four stored floats, RGBA, linear colours, and a mask.
_DECODED_BYTES = 16 + 16 + 12 + 4
#: Headers, offset tables and buffers of an open file.
_OPEN_FILE_BYTES = 1 << 17


@dataclass(frozen=True)
class LayerImage:
    """The pixels of a layer: (height, width, 4) float32, linear Rec. 709, premultiplied."""

    pixels: Rgba
    data_window: Window
    display_window: Window


# --- writing --------------------------------------------------------------------------------------

EXR_COMPRESSIONS = (
    "zip", "none", "rle", "zips", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab",
    "htj2k256", "htj2k32",
)  # fmt: skip
_ROWS_PER_BLOCK = {
    "zip": 16, "piz": 32, "pxr24": 16, "b44": 32, "b44a": 32, "dwaa": 32, "dwab": 256,
    "htj2k256": 256, "htj2k32": 32,
}  # fmt: skip
PNG_COMPRESSIONS = ("fast", "small", *"0123456789")
DEPTHS = {"png": ("8", "16"), "exr": ("half", "float")}
COMPRESSIONS = {"png": PNG_COMPRESSIONS, "exr": EXR_COMPRESSIONS}
FORMATS = tuple(DEPTHS)

_PNG_LEVELS = {"fast": 3, "small": 9}
_PNG_TYPES: dict[str, type[np.unsignedinteger[Any]]] = {"8": np.uint8, "16": np.uint16}


def format_of_output(path: str, format: str | None = None) -> str:
    """`png` or `exr`, from the ending of the path or as named; `SettingError` otherwise."""
    if format is not None and format not in FORMATS:
        raise unknown_name("format", format, FORMATS)
    ending = os.path.splitext(path)[1].lower().removeprefix(".")
    if path != STDIN and ending in FORMATS:
        if format not in (None, ending):
            raise SettingError(f"output {path} ends in .{ending} but the format is {format}")
        return ending
    if format is None:
        where = "stdout" if path == STDIN else f"output {path}"
        raise SettingError(
            f"{where} does not say its format: end it in .png or .exr, or give --format"
        )
    return format


@dataclass(frozen=True)
class OutputForm:
    """The form of an output file, checked: `format` and what that format allows."""

    format: str
    depth: str
    compression: str

    def bytes_to_encode(self, width: int) -> int:
        """Memory of the codec while it encodes rows of that width."""
        rows = _ROWS_PER_BLOCK.get(self.compression, 1)
        return _OPEN_FILE_BYTES + 6 * rows * width * 4 * (4 if self.depth == "float" else 2)

    @staticmethod
    def checked(
        format: str, depth: str | int | None = None, compression: str | int | None = None
    ) -> OutputForm:
        """With the format's own defaults; `SettingError` lists what the format allows."""
        depth = None if depth is None else str(depth)
        compression = None if compression is None else str(compression)
        for what, value, valid in (
            ("depth", depth, DEPTHS[format]),
            ("compression", compression, COMPRESSIONS[format]),
        ):
            if value is not None and value not in valid:
                raise unknown_name(f"{format.upper()} {what}", value, valid)
        return OutputForm(
            format, depth or DEPTHS[format][0], compression or COMPRESSIONS[format][0]
        )


class ImageWriter:
    """Writes one picture in strips of rows, top to bottom.

    `path` gets the file; `label` names it in errors. What the format cannot hold is counted in
    `losses`. Close it with `finish`, or `abandon` after a failure.
    """

    def __init__(
        self,
        path: str,
        form: OutputForm,
        data_window: Window,
        display_window: Window,
        *,
        pixel_aspect: float = 1.0,
        pixels_per_metre: tuple[float, float] | None = None,
        label: str | None = None,
    ) -> None:
        self.form, self.window, self.label = form, data_window, label or path
        self.losses = Losses()
        png = form.format == "png"
        kind = {"8": "uint8", "16": "uint16", "half": "half", "float": "float"}[form.depth]
        spec = oiio.ImageSpec(data_window.width, data_window.height, 4, oiio.TypeDesc(kind))
        if not png:
            spec.x, spec.y = data_window.x, data_window.y
            spec.full_x, spec.full_y = display_window.x, display_window.y
            spec.full_width, spec.full_height = display_window.width, display_window.height
        for name, value in self._attributes(png, pixel_aspect, pixels_per_metre).items():
            spec.attribute(name, *value) if isinstance(value, tuple) else spec.attribute(
                name, value
            )
        output = oiio.ImageOutput.create("png" if png else "openexr")
        assert output is not None  # both formats are part of OpenImageIO itself
        self._output = output
        if not self._output.open(path, spec):
            raise self._error()

    def _attributes(
        self, png: bool, pixel_aspect: float, density: tuple[float, float] | None
    ) -> dict[str, Any]:
        found: dict[str, Any] = {"PixelAspectRatio": float(pixel_aspect)}
        if density is not None:
            found["ResolutionUnit"] = "in"
            found["XResolution"] = density[0] * _METRES_PER_INCH
            found["YResolution"] = density[1] * _METRES_PER_INCH
        compression = self.form.compression
        if png:
            level = _PNG_LEVELS.get(compression)
            found["png:compressionLevel"] = int(compression) if level is None else level
            found["oiio:UnassociatedAlpha"] = 1
            found["oiio:ColorSpace"] = "sRGB"
        else:
            found["compression"] = compression
            found["chromaticities"] = (oiio.TypeDesc("float[8]"), tuple(REC709.xy.ravel()))
            found["colorInteropID"] = "lin_rec709_scene"
            # An empty date keeps the clock out of the file.
            found["DateTime"] = ""
        return found

    def write_rows(self, begin: int, rgba: Rgba) -> None:
        """Rows from `begin` on, in canvas coordinates: (rows, width, 4), linear, premultiplied."""
        pixels: NDArray[Any] = rgba
        if self.form.format == "png":
            pixels = to_straight_srgb(rgba, _PNG_TYPES[self.form.depth], self.losses)
            begin -= self.window.y
        elif self.form.depth == "half":
            pixels = to_half_range(rgba, self.losses)
        if not self._output.write_scanlines(begin, begin + len(rgba), 0, pixels):
            raise self._error()

    def finish(self) -> None:
        """Completes the file; `OutputError` where it cannot be."""
        if not self._output.close():
            raise self._error()

    def abandon(self) -> None:
        """Closes the file, whatever state it is in."""
        with contextlib.suppress(Exception):
            self._output.close()

    def _error(self) -> OutputError:
        return OutputError(f"{self.label}: cannot be written: {_error_text(self._output)}")
