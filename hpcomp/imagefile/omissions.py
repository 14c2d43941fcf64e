"""What a file holds that is not in the picture which is read of it. From headers alone, no pixels.

Nothing is said of metadata that say nothing of the picture, of the smaller levels of a mipmap,
which show the same, and of what is no colour, such as depth and layers of numbers.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator

from .parts import ALPHAS_OF_COLORS, ColorGroup, ImageFile, Omission, Part, alphas_of
from .pngheader import PngHeader

#: So many names are listed, and the others counted.
_LISTED = 5
#: Layers of numbers that renderers store as three channels beside their picture: Cryptomatte,
#: normals, positions, coordinates of textures, motion.
_DATA = re.compile(
    r"crypto\w*|n|normals?|p|pref|pos(ition)?|uvw?|st|motion(vectors?)?|velocity|vector",
    re.IGNORECASE,
)
#: The tag of Exif that says how a picture is to be turned, and its value for not at all.
_ORIENTATION, _UPRIGHT = 0x0112, 1


def omissions_of_png(header: PngHeader) -> tuple[Omission, ...]:
    """What of a PNG is not read, whatever is chosen of it."""
    found = [Omission(text) for text in header.dropped]
    frames = header.chunks.get(b"acTL", b"")
    if len(frames) == 8 and int.from_bytes(frames[:4]) > 1:
        found.append(
            Omission(
                f"it is animated, and of its {int.from_bytes(frames[:4])} frames none is read but "
                "the still picture: write the frames as files first, or say part=0",
                ("part",),
            )
        )
    orientation = _orientation(header.chunks.get(b"eXIf", b""))
    if orientation != _UPRIGHT:
        found.append(
            Omission(
                f"its eXIf chunk says that it is to be turned (orientation {orientation}), and it "
                "is read as stored: turn it first, such as with oiiotool --no-autopremult IN "
                "--reorient -o OUT, or say part=0",
                ("part",),
            )
        )
    offset = header.chunks.get(b"oFFs", b"")
    if len(offset) == 9 and offset[8] == 0 and any(offset[:8]):
        x, y = struct.unpack(">2i", offset[:8])
        found.append(
            Omission(
                f"its oFFs chunk puts it at {x:+d}{y:+d}, and it is not put there: at={x:+d}{y:+d} "
                "does that, and at=+0+0 says that it is not meant",
                ("at",),
            )
        )
    return tuple(found)


def _orientation(exif: bytes) -> int:
    """How Exif says that the picture is to be turned; `_UPRIGHT` where it does not say.

    Exif 2.32, 4.6.2: TIFF's first directory of entries of 12 bytes.
    """
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(exif[:4])
    try:
        if order is None:
            return _UPRIGHT
        (at,) = struct.unpack_from(f"{order}I", exif, 4)
        (entries,) = struct.unpack_from(f"{order}H", exif, at)
        for number in range(entries):
            tag, _, _, value = struct.unpack_from(f"{order}HHIH", exif, at + 2 + 12 * number)
            if tag == _ORIENTATION and 1 <= value <= 8:
                return int(value)
    except struct.error:
        pass  # whatever it says, it does not say this
    return _UPRIGHT


def omissions(file: ImageFile, part: Part, group: ColorGroup) -> tuple[Omission, ...]:
    """What of the file is not in the picture where this colour of this part is read."""
    return (
        *part.omissions,
        *_of_alpha_alone(part, group),
        *_alphas_left_out(file, part, group),
        *_colors_left_out(file, part, group),
        *_pictures_left_out(file, part, group),
        *_parts_left_out(file),
    )


def _of_alpha_alone(part: Part, group: ColorGroup) -> Iterator[Omission]:
    if part.deep and not group.color and group.alpha is not None:
        yield Omission(
            f"it has no colour, only the alpha {group.alpha.name}: its samples are black, and "
            "hide what is behind them",
            ("part", "layer"),
        )


def _alphas_left_out(file: ImageFile, part: Part, group: ColorGroup) -> Iterator[Omission]:
    """Alphas that may be this colour's and no other's: of R, G and B each, or elsewhere."""
    prefix = f"{group.layer}." if group.layer else ""
    names = [c.name for c in part.channels]
    of_colors = [prefix + name for name in ALPHAS_OF_COLORS if prefix + name in names]
    if of_colors and group.color and not part.deep:
        what = "only A is" if group.alpha else "and the layer is opaque"
        yield Omission(
            f"its alphas of single colours, {_listed(of_colors)}, are not read, {what}: write one "
            "A, or say alpha=premultiplied",
            ("alpha",),
        )
    if group.alpha is not None or _is_mask(part, group):
        return
    for other in file.parts:
        taken = {g.alpha for g in other.groups}
        for layer, channel in alphas_of(other):
            encloses = not layer or f"{group.layer}.".startswith(f"{layer}.")
            if channel not in taken and encloses and other.data_window == part.data_window:
                where = f" in part {_name(other)}" if other is not part else ""
                yield Omission(
                    f"the alpha {channel.name}{where} is not read, and the layer is opaque: "
                    "write it beside the colours, with their layer's name, or say "
                    "alpha=premultiplied",
                    ("alpha",),
                )


def _is_mask(part: Part, group: ColorGroup) -> bool:
    """Whether what is read is no colour of the part, but a channel that is a mask."""
    return group not in part.groups


def _colors_left_out(file: ImageFile, part: Part, group: ColorGroup) -> Iterator[Omission]:
    """Chroma of a luminance that is read as grey."""
    if len(group.color) != 1 or _is_mask(part, group):
        return
    prefix = f"{group.layer}." if group.layer else ""
    for other in file.parts:
        chroma = [c.name for c in other.channels if c.name in (f"{prefix}RY", f"{prefix}BY")]
        if chroma and other is not part:
            yield Omission(
                f"the colours {_listed(chroma)} in part {_name(other)} are not read, and it is "
                "grey: store it as RGB"
            )


def _pictures_left_out(file: ImageFile, part: Part, group: ColorGroup) -> Iterator[Omission]:
    """Other colours of the file, where its user has not chosen this one."""
    others = [
        _title(file, other, found.layer)
        for other in file.parts
        for found in _pictures_of(other)
        if not _DATA.fullmatch(found.layer.rpartition(".")[2])
        and (other.index, found.layer) != (part.index, group.layer)
    ]
    if others:
        read = _title(file, part, group.layer)
        yield Omission(
            f"{read} is read, and not {_listed(others)}: choose with part= and layer=, or say "
            f"part={part.index} where this is meant",
            ("part", "layer"),
        )


def _parts_left_out(file: ImageFile) -> Iterator[Omission]:
    """Parts that cannot be read at all."""
    for part in file.parts:
        if part.unread:
            why = "its channels are subsampled" if part.is_subsampled else "it is damaged"
            yield Omission(f"part {_name(part)} cannot be read, {why}", ("part",))


def _pictures_of(part: Part) -> Iterable[ColorGroup]:
    """The colours of a part; of a deep one without any its alphas."""
    if part.groups or not part.deep:
        return part.groups
    return [ColorGroup(layer, (), alpha) for layer, alpha in alphas_of(part)]


def _title(file: ImageFile, part: Part, layer: str) -> str:
    """What messages call one of the pictures of a file."""
    named = f"layer {layer}" if layer else "the layer without a name"
    return named if len(file.parts) == 1 else f"{named} of part {_name(part)}"


def _name(part: Part) -> str:
    return f"{part.index} ({part.name})" if part.name else str(part.index)


def _listed(names: list[str]) -> str:
    shown = ", ".join(names[:_LISTED])
    return shown if len(names) <= _LISTED else f"{shown} and {len(names) - _LISTED} others"
