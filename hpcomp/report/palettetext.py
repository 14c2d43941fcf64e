"""A palette as tables of characters, with the blends in colour on a terminal. Prints nothing."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np

from ..analysis.palette import Palette, Profile, patch
from ..errors import printable
from .huetext import PLAIN, colored, encoded
from .look import hue_colors, srgb_hex
from .palettedata import ALL, hex_colors, rules_data, rules_sentence, sentence
from .paletteformats import PaletteLook

#: Letters of a name in a table.
_LONGEST_NAME = 16
#: Fewest and most columns of a blend in colour.
_NARROWEST_BAR, _WIDEST_BAR = 12, 60
#: More columns than these make no sentence clearer.
_WIDEST = 110
#: Differences that are closer than this are the same to three digits.
_DIFFERENT = 5e-4
#: What stands where there is no hue.
_GREY = "#808080"


def as_text(palette: Palette, look: PaletteLook) -> bytes:
    """Labels, pairs and findings."""
    rules = rules_data(palette)
    blending = rules.pop("blending")
    given = rules_sentence(rules)
    blocks = [
        textwrap.wrap(
            f"{len(palette.labels)} labels, {blending} beside traditional blending; {given}",
            _width(look),
        ),
        _label_lines(palette, look),
        _pair_lines(palette, look),
        _finding_lines(palette, look),
    ]
    text = "\n\n".join("\n".join(block) for block in blocks)
    return encoded(text + "\n", look)


def _label_lines(palette: Palette, look: PaletteLook) -> list[str]:
    settings = palette.settings
    rows = [("label", "colour", "hue", "chroma", "luminance", "difference", "contrast")]
    for label, on in zip(palette.labels, palette.on_background, strict=True):
        seen = on[palette.blending]
        rows.append(
            (
                _name(label.name),
                srgb_hex(label.rgb),
                "-" if label.hue is None else f"{label.hue:.1f}°",
                f"{label.chroma:.3f}",
                f"{label.luminance:.3f}",
                f"{seen.difference:.3f}",
                f"{seen.contrast:.2f}:1",
            )
        )
    head, *lines = _aligned(rows, left=2)
    marks = [colored("■", srgb_hex(label.rgb), look) for label in palette.labels]
    differ = any(
        abs(one.difference - on["traditional"].difference) > _DIFFERENT
        for on in palette.on_background
        for one in on.values()
    )
    way = f", {palette.blending}" if differ else ""
    return [
        f"  {head}",
        *(f"{mark} {line}" for mark, line in zip(marks, lines, strict=True)),
        f"Difference (Oklab) and contrast at {settings.opacity:.0%} on "
        f"{srgb_hex(settings.background)}{way}.",
    ]


def _pair_lines(palette: Palette, look: PaletteLook) -> list[str]:
    pairs = palette.distinct
    ways = ("traditional", palette.blending)
    woven = palette.stack.blending.depends_on_place
    rows: list[tuple[str, ...]] = [
        ("", "", ways[0], "", ways[1], ""),
        ("back → front", "angle", "foreign", "least chroma", "foreign", "least chroma"),
    ]
    if woven:
        rows = [(*rows[0], ""), (*rows[1], "threads at 50%")]
    for pair in pairs:
        back, front = (_name(palette.labels[n].name) for n in (pair.back, pair.front))
        cells = [
            cell
            for profile in (pair.traditional, pair.result)
            for cell in (f"{profile.foreign:.0%}", _least(profile))
        ]
        angle = "-" if pair.angle is None else f"{pair.angle:.0f}°"
        if woven:
            cells.append(_threads(palette, pair.result, pair.back))
        rows.append((f"{back} → {front}", angle, *cells))
    first, second, *lines = _aligned(rows, left=1)
    table = [first, second]
    for pair, line in zip(pairs, lines, strict=True):
        table.append(line)
        if look.color:
            room = min((look.columns - 6) // 2, _WIDEST_BAR)
            bars = [
                _bar(palette, profile, max(room, _NARROWEST_BAR))
                for profile in (pair.traditional, pair.result)
            ]
            table.append(f"  {bars[0]}  {bars[1]}")
    order = (
        "The other way round, opacities are what is left to 100%."
        if len(pairs) == len(palette.soonest)
        else "Both ways round where they differ."
    )
    caption = ["Opacities of the front label over the opaque back one.", order]
    if woven:
        caption.append(
            "Threads: of each label, its colour and its share of the pixels. Least chroma is the "
            "mean of theirs."
        )
    bars = ["Bars: the blend from opacity 0 to 1 above, its hue below."] if look.color else []
    return [*table, *caption, *bars]


def _threads(palette: Palette, profile: Profile, back: int) -> str:
    """The colours that are side by side in the middle, the back label's first."""
    middle = len(profile.rgb) // 2
    threads = sorted(profile.threads, key=lambda thread: thread.label != back)
    return ", ".join(
        f"{hex_colors(palette, thread.rgb[middle : middle + 1])[0]} {thread.share[middle]:.0%}"
        for thread in threads
        if thread.share[middle] > 0
    )


def _least(profile: Profile) -> str:
    """How much chroma is left where least is, and at which opacity."""
    if profile.left is None:
        return "-"
    if profile.least_at is None or profile.left > ALL:
        return "all"
    left = "grey" if profile.turns_grey else f"{profile.left:.0%}"
    return f"{left} at {profile.least_at:.0%}"


def _bar(palette: Palette, profile: Profile, columns: int) -> str:
    """The blend in the upper halves of characters, its hue in the lower ones."""
    rgb, hues = (row[0] for row in patch(profile, palette.stack.weave, columns, 1))
    colors = hex_colors(palette, rgb)
    axis = palette.stack.space.hue_axis
    below = np.where(np.isnan(hues), _GREY, hue_colors(axis, np.nan_to_num(hues)))
    cells = [
        f"\x1b[38;2;{_codes(above)};48;2;{_codes(under)}m▀"
        for above, under in zip(colors, below.tolist(), strict=True)
    ]
    return "".join(cells) + PLAIN


def _codes(color: str) -> str:
    return ";".join(str(code) for code in bytes.fromhex(color[1:]))


def _finding_lines(palette: Palette, look: PaletteLook) -> list[str]:
    if not palette.findings:
        return ["no findings"]
    n = len(palette.findings)
    lines = [f"{n} finding{'s' if n > 1 else ''}"]
    indent = max(len(finding.kind) for finding in palette.findings) + 4
    for finding in palette.findings:
        first = f"  {finding.kind}".ljust(indent)
        lines += textwrap.wrap(
            sentence(palette, finding),
            max(_width(look), indent + 20),
            initial_indent=first,
            subsequent_indent=" " * indent,
            break_on_hyphens=False,
        )
    return lines


def _width(look: PaletteLook) -> int:
    return max(20, min(look.columns, _WIDEST))


def _name(name: str) -> str:
    """A name with letters taken from its middle where it is long."""
    shown = printable(name)
    if len(shown) <= _LONGEST_NAME:
        return shown
    half = _LONGEST_NAME // 2
    return f"{shown[:half]}…{shown[1 - half :]}"


def _aligned(rows: Sequence[Sequence[str]], left: int) -> list[str]:
    """Columns, the first `left` of them flush left and the others right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            f"{cell:<{width}}" if k < left else f"{cell:>{width}}"
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
