"""What a file holds, as data: parts, channels, colours, and which one is meant. Reads no file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

from ..color.encodings import ColorEncoding
from ..color.transfer import HDR_TRANSFERS
from ..errors import InputError, nearest
from ..geometry import Window
from ..records import record
from .exrscanlines import ExrLayout
from .filecolor import FileColor
from .pngscanlines import PngLayout
from .rawfile import Identity


@record
class Channel:
    """One channel of a part: its full name, its stored type, its index.

    `sampling`: it has a value for every pixel of so many, across and down.
    """

    name: str
    type: str
    index: int
    sampling: tuple[int, int] = (1, 1)


@record
class ColorGroup:
    """The channels of one layer name (empty for the default layer) that make up a colour.

    `color` is R, G, B or a single Y, and empty where only an alpha is deep; `alpha` is None where
    the group has none.
    """

    layer: str
    color: tuple[Channel, ...]
    alpha: Channel | None


@record
class Omission:
    """What a file holds that is not in the picture, and what to do, in words behind its label.

    `answered_by`: the settings of a layer that say that this is meant.
    """

    text: str
    answered_by: tuple[str, ...] = ()


@record
class Part:
    """One picture of a file, and how it will be read; with a `layout`, without OpenImageIO.

    `icc_profile`: its name, honoured or not, or empty. `omissions`: what of it is not read.
    `unread`: nothing of it is, and it has no `groups`.
    """

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
    color: FileColor
    icc_profile: str
    omissions: tuple[Omission, ...]
    layout: ExrLayout | PngLayout | None = field(repr=False)
    unread: bool = False

    @property
    def encoding(self) -> ColorEncoding:
        """How its stored RGB means light."""
        return self.color.encoding

    @property
    def problems(self) -> tuple[str, ...]:
        """What it says of its colours and is not honoured."""
        return tuple(f"{problem} is not honoured" for problem in self.color.problems)

    @property
    def is_subsampled(self) -> bool:
        """Whether some of its channels have one value for several pixels; none of it is read."""
        return any(channel.sampling != (1, 1) for channel in self.channels)

    @property
    def refusal(self) -> str:
        """Why its colours cannot be read, and what to do; empty where they can."""
        transfer = self.encoding.transfer
        if transfer not in HDR_TRANSFERS.values():
            return ""
        return (
            f"its {self.color.transfer_from} says {transfer.name}, an HDR curve (Rec. ITU-R "
            "BT.2100), which is not read: convert it to SDR, or to linear EXR, or overrule it with "
            "colorspace="
        )

    def excess(self, max_pixels: int) -> str:
        """What to say of it where it claims more pixels than so many; empty where it does not.

        A display window counts as a data window does: a canvas may be made of it.
        """
        larger = max(self.data_window, self.display_window, key=lambda window: window.pixels)
        if larger.pixels <= max_pixels:
            return ""
        return (
            f"it claims {larger.width}x{larger.height}, which is {larger.pixels:,} pixels and more "
            f"than {max_pixels:,}: raise --max-pixels if that is right"
        )


@record
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


_COMPONENTS = {"r": "R", "red": "R", "g": "G", "green": "G", "b": "B", "blue": "B",
               "x": "X", "y": "Y", "ry": "RY", "by": "BY", "a": "A", "alpha": "A"}  # fmt: skip


def color_groups(channels: Sequence[Channel]) -> tuple[ColorGroup, ...]:
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
    for layer, components in layers.items():
        if all(name in components for name in "RGB"):
            color = tuple(components[name] for name in "RGB")
        elif "Y" in components and not components.keys() & {"X", "RY", "BY"}:
            color = (components["Y"],)
        else:
            continue
        groups.append(ColorGroup(layer, color, components.get("A")))
    return tuple(groups)


def _component(channel: Channel) -> str | None:
    """What a channel is of a colour: R, G, B, Y, A, or another of `_COMPONENTS`; None for none."""
    return _COMPONENTS.get(channel.name.rpartition(".")[2].lower())


def alphas_of(part: Part) -> list[tuple[str, Channel]]:
    """The alphas of a part, each with the name of its layer."""
    return [(c.name.rpartition(".")[0], c) for c in part.channels if _component(c) == "A"]


def _masks(part: Part, layer: str | None) -> list[ColorGroup]:
    """Channels that make no colour, but may be a mask: the one named, an alpha, or the only one."""
    if layer is not None:
        masks = [c for c in part.channels if c.name == layer]
        masks = masks or [c for c in part.channels if _is_alpha(c, f"{layer}.")]
    else:
        masks = [c for c in part.channels if _is_alpha(c, "")] or list(part.channels)
    return [ColorGroup(layer or "", (masks[0],), None)] if len(masks) == 1 else []


def _is_alpha(channel: Channel, prefix: str) -> bool:
    component = channel.name.removeprefix(prefix)
    return channel.name.startswith(prefix) and _COMPONENTS.get(component.lower()) == "A"


def choose(
    file: ImageFile,
    *,
    part: str | None = None,
    layer: str | None = None,
    mask: bool = False,
    deep: bool = False,
    label: str | None = None,
) -> tuple[Part, ColorGroup]:
    """The one colour that `part` (name or index) and `layer` name, or the only one there is.

    Of flat parts, or of `deep` ones, where its alpha may be that of an enclosing layer.

    Without `layer` the default RGBA goes before named layers. Where a `mask` is wanted and there is
    no such colour, an alpha or a single channel will do; `layer` may be its name. Of `deep` parts
    without a colour an alpha will do: its samples are black. Errors: `InputError` that lists what
    there is, for an unknown part or layer, for none, and for several.
    """
    label = label or file.path
    parts = list(file.parts)
    if part is not None:
        parts = [p for p in parts if p.name == part] or [p for p in parts if str(p.index) == part]
        if not parts:
            raise InputError(f"{label}: there is no part '{part}'{_part_like(part, file)}")
    flat = [p for p in parts if p.deep == deep]
    if not flat and deep:
        raise InputError(
            f"{label} is flat, with one value a pixel and channel: composite it with hpcomp stack"
        )
    if not flat:
        raise InputError(
            f"{label} is a deep EXR, with many samples a pixel: flatten it with hpcomp flatten"
        )
    unread, flat = flat, [p for p in flat if not p.unread]
    if not flat:
        raise InputError(f"{label}: {_why_unread(unread, file)}")
    colors = [(p, group) for p in flat for group in p.groups]
    if deep and not colors:
        colors = [
            (p, ColorGroup(name, (), c))
            for p in flat
            for name, c in alphas_of(p)
            if not _some_of_a_color(p, name)
        ]
    channels = ", ".join(c.name for p in flat for c in p.channels)
    if layer is not None:
        named = [(p, g) for p, g in colors if g.layer == layer]
        if mask and not named:
            named = [(p, g) for p in flat for g in _masks(p, layer)]
        if not named:
            there_is = ", ".join(dict.fromkeys(g.layer or "(default)" for _, g in colors))
            there_is = there_is or (f"none, only {channels}" if channels else "none")
            raise InputError(
                f"{label}: there is no colour layer '{layer}': there is {there_is}"
                f"{_layer_like(layer, file, flat)}"
            )
    else:
        named = [(p, g) for p, g in colors if not g.layer] or colors
        if mask and not named:
            named = [(p, g) for p in flat for g in _masks(p, None)]
    if not named:
        components = {_component(c) for p in flat for c in p.channels}
        what_next = (
            "R, G and B are in several parts, of which one is read: write them into one"
            if len(flat) > 1 and components >= set("RGB")
            else "choose the mask with layer=" if mask
            else "R, G and B or Y, or A, are needed" if deep
            else "R, G, B or Y is needed, or tint= to colour a mask"
        )  # fmt: skip
        raise InputError(f"{label} has no colour, only {channels}: {what_next}")
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


_FRONT = "Z"
#: As OpenEXR spells it, and as OpenImageIO did.
_BACKS = ("ZBack", "Zback")
#: Alphas of one colour each, by both spellings that were ever recommended.
ALPHAS_OF_COLORS = ("AR", "AG", "AB", "RA", "GA", "BA")


def _deep_alpha(part: Part, group: ColorGroup, label: str) -> Channel:
    """The alpha of a deep colour: of its layer, or of the nearest that encloses it.

    Errors: `InputError` where there is none, or one for each colour. OpenEXR: Interpreting Deep
    Pixels, Required Alpha Channels.
    """
    channels = {channel.name: channel for channel in part.channels}
    layer = group.layer
    while True:
        prefix = f"{layer}." if layer else ""
        several = [prefix + name for name in ALPHAS_OF_COLORS if prefix + name in channels]
        if several:
            raise InputError(
                f"{label} has an alpha for each colour, {', '.join(several)}, which would give "
                "every depth three weights: replace them by one A first"
            )
        alpha = channels.get(f"{prefix}A")
        if group.alpha is not None and layer == group.layer:
            alpha = group.alpha
        if alpha is not None:
            return alpha
        if not layer:
            there_is = ", ".join(channels)
            raise InputError(
                f"{label} has no alpha A, which says how much a sample hides of what is behind it, "
                f"only {there_is}: write it with an A"
            )
        layer = layer.rpartition(".")[0]


def deep_channel_names(part: Part, group: ColorGroup, label: str) -> tuple[list[str], list[str]]:
    """The channels of deep data: of colour and alpha, and of the depths.

    Errors: `InputError` where one is missing.
    """
    names = [channel.name for channel in part.channels]
    color = [c.name for c in (*group.color, _deep_alpha(part, group, label))]
    if _FRONT not in names:
        raise InputError(
            f"{label} has no depth {_FRONT}, only {', '.join(names)}: "
            "deep data need one to be sorted by"
        )
    return color, [_FRONT, *[name for name in _BACKS if name in names][:1]]


def _some_of_a_color(part: Part, layer: str) -> bool:
    """Whether a layer of a part has any of the channels of a colour."""
    prefix = f"{layer}." if layer else ""
    return any(channel.name in [prefix + c for c in "RGBY"] for channel in part.channels)


def _part_name(part: Part) -> str:
    return part.name or str(part.index)


def _why_unread(parts: Sequence[Part], file: ImageFile) -> str:
    """What to say of parts of which none can be read."""
    subsampled = [c.name for part in parts for c in part.channels if c.sampling != (1, 1)]
    if subsampled:
        return (
            f"its channels {', '.join(subsampled)} are subsampled (luminance/chroma), which is not "
            "read: store it as RGB, such as with ImageMagick: magick IN.exr OUT.exr"
        )
    names = ", ".join(map(_part_name, parts))
    if file.parts[0].is_subsampled:
        return (
            f"part {names} cannot be read, as the channels of part {_part_name(file.parts[0])} "
            "before it are subsampled: write it to a file of its own"
        )
    return f"part {names} cannot be read, it is damaged"


def _part_like(name: str, file: ImageFile) -> str:
    """What was probably meant by the name of a part that a file has not, and all that it has."""
    names = [_part_name(part) for part in file.parts]
    there_is = f"hoose part= one of {', '.join(names)}"
    if any(group.layer == name for part in file.parts for group in part.groups):
        return f", but a layer of that name: write layer={name}, or c{there_is}"
    near = nearest(name, names)
    return f"{near} C{there_is}" if near else f": c{there_is}"


def _layer_like(name: str, file: ImageFile, chosen: Sequence[Part]) -> str:
    """What was probably meant by the name of a layer that the chosen parts have not."""
    if any(part.name == name for part in file.parts):
        return f", and a part of that name: write part={name}"
    for part in file.parts:
        if part not in chosen and any(group.layer == name for group in part.groups):
            return f"; part {_part_name(part)} has it: write part={_part_name(part)},layer={name}"
    layers = [group.layer for part in chosen for group in part.groups if group.layer]
    if (of_channel := name.rpartition(".")[0]) in layers:
        return f"; '{name}' is a channel: write layer={of_channel}"
    return nearest(name, layers).replace(":", ";")
