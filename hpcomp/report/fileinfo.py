"""How a file will be read, as text for people and as plain data for JSON. Reads no file."""

from __future__ import annotations

from typing import Any

from ..errors import InputError, printable
from ..geometry import Window
from ..imagefile.header import METRES_PER_INCH
from ..imagefile.omissions import omissions
from ..imagefile.parts import Channel, ColorGroup, ImageFile, Part, choose, deep_channel_names
from ..system.memory import MAX_PIXELS, parse_pixels

#: Version of the data that `as_data` gives; it grows when a key changes its meaning or goes.
SCHEMA_VERSION = 2


def as_data(file: ImageFile) -> dict[str, Any]:
    """One file as dictionaries, lists, strings and numbers.

    `read_as` names the part and layer that are read where nothing is chosen, or is null with the
    reason in `problem`. `warnings` say what of the file is then not in the picture, and whether it
    claims more pixels than are read where nobody says otherwise.
    """
    data: dict[str, Any] = {"path": file.path, "format": file.format}
    try:
        if all(part.deep for part in file.parts):
            deep_channel_names(*choose(file, deep=True), file.path)  # else flatten refuses it too
        part, group = choose(file)
        if part.refusal:
            raise InputError(f"{file.path}: {part.refusal}")
        data["read_as"] = {"part": part.index, "layer": group.layer}
    except InputError as problem:
        data["read_as"], data["problem"] = None, str(problem)
    data["warnings"] = _warnings(file)
    data["parts"] = [_part_data(file, part) for part in file.parts]
    return data


def _warnings(file: ImageFile) -> list[str]:
    """What `stack` says of its default layer, or `flatten` where it is deep."""
    notes = [part.excess(parse_pixels(MAX_PIXELS)) for part in file.parts]
    try:
        chosen = choose(file, deep=all(part.deep for part in file.parts))
        notes += [omission.text for omission in omissions(file, *chosen)]
    except InputError:
        pass  # nothing is read of it, so nothing is left out
    return [note for note in dict.fromkeys(notes) if note]


def _part_data(file: ImageFile, part: Part) -> dict[str, Any]:
    return {
        "index": part.index,
        "name": part.name,
        "storage": _storage(part),
        "compression": part.compression,
        "data_window": _window_data(part.data_window),
        "display_window": _window_data(part.display_window),
        "pixel_aspect": part.pixel_aspect,
        "pixels_per_metre": part.pixels_per_metre,
        "channels": [
            {"name": c.name, "type": c.type, "sampling": list(c.sampling)} for c in part.channels
        ],
        "layers": [
            {
                "name": group.layer,
                "color": [c.name for c in group.color],
                "alpha": group.alpha and group.alpha.name,
                "alpha_mode": _alpha(file, group),
            }
            for group in part.groups
        ],
        "transfer": part.encoding.transfer.name,
        "primaries": part.encoding.primaries.name,
        "chromaticities": part.encoding.primaries.xy.tolist(),
        "transfer_from": part.color.transfer_from,
        "primaries_from": part.color.primaries_from,
        "icc_profile": part.icc_profile or None,
        "problems": list(part.problems),
    }


def _window_data(window: Window) -> dict[str, int]:
    return {"x": window.x, "y": window.y, "width": window.width, "height": window.height}


def _storage(part: Part) -> str:
    if part.deep:
        return "deep"
    if part.tile is not None:
        return f"tiles of {part.tile[0]}x{part.tile[1]}"
    return "interlaced" if part.interlaced else "scanlines"


def _primaries(part: Part) -> str:
    """The name of the primaries; for those without a name, the numbers."""
    primaries = part.encoding.primaries
    if primaries.name != "custom":
        return primaries.name
    corners = zip(("red", "green", "blue", "white"), primaries.xy.tolist(), strict=True)
    return "custom: " + ", ".join(f"{name} {x:.4f} {y:.4f}" for name, (x, y) in corners)


def _channel(channel: Channel) -> str:
    x, y = channel.sampling
    shared = "" if (x, y) == (1, 1) else f" for every {x}x{y} pixels"
    return f"{channel.name} {channel.type}{shared}"


def _alpha(file: ImageFile, group: ColorGroup) -> str:
    return "opaque" if group.alpha is None else file.alpha_mode


def as_text(file: ImageFile) -> str:
    """One file in a few aligned lines."""
    data = as_data(file)
    lines = [f"{file.path}: {file.format.upper()}, {len(file.parts)} part(s)"]
    if data["read_as"] is None:
        lines.append(f"  cannot be read as it is: {data['problem']}")
    for part in file.parts:
        chosen = data["read_as"] is not None and data["read_as"]["part"] == part.index
        rows = [
            ("part", f"{part.index} {part.name}".rstrip() + (" (read)" if chosen else "")),
            ("windows", f"data {part.data_window}, display {part.display_window}"),
            ("storage", ", ".join(filter(None, [_storage(part), part.compression]))),
            ("channels", ", ".join(map(_channel, part.channels))),
            ("light", f"{part.encoding.transfer.name}, from {part.color.transfer_from}"),
            ("primaries", f"{_primaries(part)}, from {part.color.primaries_from}"),
        ]
        if part.icc_profile:
            rows.append(("ICC profile", part.icc_profile))
        for group in part.groups:
            color = "".join(c.name.rpartition(".")[2] for c in group.color)
            rows.append(
                (f"layer {group.layer}".rstrip(), f"colour {color}, alpha {_alpha(file, group)}")
            )
        if part.pixel_aspect != 1:
            rows.append(("pixel aspect", f"{part.pixel_aspect:g}"))
        if part.pixels_per_metre:
            x, y = (density * METRES_PER_INCH for density in part.pixels_per_metre)
            rows.append(("resolution", f"{x:.6g} x {y:.6g} pixels per inch"))
        rows += [("warning", problem) for problem in part.problems]
        width = max(len(name) for name, _ in rows)
        lines += [f"  {name:<{width}}  {value}" for name, value in rows]
    lines += [f"  warning: {text}" for text in data["warnings"]]
    return "\n".join(map(printable, lines))
