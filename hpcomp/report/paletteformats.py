"""The formats in which a palette is shown, and what chooses how it looks. Renders nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..analysis.palette import Palette
from ..errors import unknown_name
from ..system.outputs import whole_output, write_bytes
from .hueformats import ReportFormat, report_format
from .look import Look

#: The parts of a figure, one of which can be drawn alone.
FIGURES = ("all", "profiles", "discs")


@dataclass(frozen=True)
class PaletteLook(Look):
    """How a palette is shown: `figure` is one of `FIGURES`, the rest is of text, as in `Look`."""

    figure: str = FIGURES[0]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.figure not in FIGURES:
            raise unknown_name("figure", self.figure, FIGURES)


Render = Callable[[Palette, PaletteLook], bytes]

PALETTE_FORMATS: dict[str, ReportFormat] = {
    row.name: row
    for row in (
        ReportFormat(
            "text", ".txt", "a table of pairs, in colour on a terminal", ".palettetext", "as_text",
            True,
        ),
        ReportFormat(
            "json", ".json", "labels, pairs, colours, findings", ".palettedata", "as_json", True
        ),
        ReportFormat(
            "svg", ".svg", "a figure, its letters as outlines", ".palettefigure", "as_svg"
        ),
        ReportFormat("png", ".png", "a figure of 200 dots per inch", ".palettefigure", "as_png"),
        ReportFormat("pdf", ".pdf", "a figure, its font embedded", ".palettefigure", "as_pdf"),
    )
}  # fmt: skip


def palette_format(output: str, name: str | None = None) -> ReportFormat:
    """The format of that name, else that of the output's ending; text for stdout."""
    return report_format(output, name, formats=PALETTE_FORMATS)


def load(format: ReportFormat) -> Render:
    """What renders a palette. Errors: `OutputError` where a library that it needs is missing."""
    render: Any = format.load()
    return render


def write_palette_report(
    palette: Palette,
    output: str | os.PathLike[str],
    *,
    format: str | None = None,
    figure: str = FIGURES[0],
    clobber: bool = True,
) -> None:
    """Writes what labels blend to, as `hpcomp palette` does: text, data or a figure.

    `palette`: what `hpcomp.palette` found. `output`: a path, whose ending is the format where
    `format` is not given, or `-` for stdout. `format`: text, json, svg, png or pdf; figures need
    matplotlib. `figure`: all, or profiles or discs alone. `clobber`: an existing output is
    replaced.
    Errors: `SettingError`, `OutputError`.
    """
    output = os.fspath(output)
    render = load(palette_format(output, format))
    look = PaletteLook(figure=figure)
    with whole_output(output, clobber=clobber) as target:
        write_bytes(target, render(palette, look), output)
