"""What the header of an EXR says of its colours, and of parts that OpenImageIO refuses.

These are described, those with subsampled channels above all, so that `info` can say what they are;
none of their colours can be read.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

from ..color.encodings import COLOR_INTEROP_IDS, LINEAR_REC709, ColorEncoding
from ..color.primaries import primaries_from_xy
from ..color.transfer import LINEAR
from .exrscanlines import TYPES, channels_of, headers_of, window_of
from .filecolor import DEFAULT, FileColor
from .parts import Channel, Part

#: Headers are longer where they hold many attributes; no more of them is read.
_HEADER_BYTES = 1 << 20
#: Of the compressions by number, as in the file layout of OpenEXR.
_COMPRESSIONS = ("none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab")


def color_of(interop_id: str, chromaticities: Sequence[float] | None) -> FileColor:
    """The colours of a part with that colorInteropID, empty for none, and those chromaticities."""
    problems: list[str] = []
    if interop_id in COLOR_INTEROP_IDS:
        source = "colorInteropID"
        return FileColor(COLOR_INTEROP_IDS[interop_id], source, source)
    if interop_id and interop_id not in ("data", "unknown"):
        problems.append(f"colorInteropID '{interop_id}'")
    if chromaticities is not None:
        try:
            encoding = ColorEncoding(LINEAR, primaries_from_xy(chromaticities))
            return FileColor(encoding, DEFAULT, "chromaticities", tuple(problems))
        except ValueError:
            problems.append("a chromaticities attribute that spans no gamut")
    return FileColor(LINEAR_REC709, DEFAULT, DEFAULT, tuple(problems))


def unread_parts(path: str) -> list[Part]:
    """All parts of an EXR as parts of which nothing is read; none where its header is damaged."""
    try:
        with open(path, "rb") as file:
            headers, _, _ = headers_of(file.read(_HEADER_BYTES))
        return [_part(header, number) for number, header in enumerate(headers)]
    except (OSError, ValueError, KeyError, IndexError, struct.error):
        return []  # whatever is wrong, OpenImageIO says it


def _part(header: Mapping[bytes, bytes], number: int) -> Part:
    kinds = {number: name for name, (number, _) in TYPES.items()}
    xy = header.get(b"chromaticities")
    return Part(
        index=number,
        name=header.get(b"name", b"").decode("utf-8", "replace"),
        channels=tuple(
            Channel(name.decode("utf-8", "replace"), kinds[kind], index, sampling)
            for index, (name, kind, sampling) in enumerate(channels_of(header[b"channels"]))
        ),
        groups=(),
        data_window=window_of(header[b"dataWindow"]),
        display_window=window_of(header[b"displayWindow"]),
        tile=struct.unpack_from("<2I", header[b"tiles"]) if b"tiles" in header else None,
        rows_per_block=1,
        compression=dict(enumerate(_COMPRESSIONS)).get(header[b"compression"][0], "unknown"),
        deep=header.get(b"type", b"").startswith(b"deep"),
        interlaced=False,
        pixel_aspect=struct.unpack("<f", header[b"pixelAspectRatio"])[0],
        pixels_per_metre=None,
        color=color_of(
            header.get(b"colorInteropID", b"").decode("utf-8", "replace"),
            None if xy is None else struct.unpack("<8f", xy),
        ),
        icc_profile="",
        omissions=(),
        layout=None,
        unread=True,
    )
