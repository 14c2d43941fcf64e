"""The formats of hue reports, by name and by the ending of a file. What makes each is elsewhere."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module

from ..errors import SettingError, unknown_name
from ..measures.histogram import HueHistogram
from ..system.outputs import whole_output, write_bytes
from ..system.streams import STDOUT
from .look import Entry, Look

Render = Callable[[Sequence[Entry], Look], bytes]


@dataclass(frozen=True)
class ReportFormat:
    """A format: its name, the ending of its files, what it is, and where what makes it lives.

    `on_terminal`: whether it is anything to look at on one.
    """

    name: str
    ending: str
    title: str
    module: str
    function: str
    on_terminal: bool = False

    def load(self) -> Render:
        """What makes it. Errors: `OutputError` where a library that it needs is missing."""
        render: Render = getattr(import_module(self.module, __package__), self.function)
        return render


REPORT_FORMATS: dict[str, ReportFormat] = {
    row.name: row
    for row in (
        ReportFormat(
            "text",
            ".txt",
            "bars of characters, in colour on a terminal",
            ".huetext",
            "as_text",
            True,
        ),
        ReportFormat(
            "json", ".json", "settings, counts, peaks, every bin", ".huedata", "as_json", True
        ),
        ReportFormat("csv", ".csv", "a row for each bin of each image", ".huedata", "as_csv", True),
        ReportFormat("svg", ".svg", "a figure, its letters as outlines", ".huefigure", "as_svg"),
        ReportFormat("png", ".png", "a figure of 200 dots per inch", ".huefigure", "as_png"),
        ReportFormat("pdf", ".pdf", "a figure, its font embedded", ".huefigure", "as_pdf"),
        ReportFormat("html", ".html", "a page for a browser, one file", ".huepage", "as_html"),
    )
}


def report_format(
    output: str,
    name: str | None = None,
    otherwise: str = ", or give --format",
    formats: Mapping[str, ReportFormat] = REPORT_FORMATS,
) -> ReportFormat:
    """The format of that name, else that of the output's ending; text for stdout.

    `otherwise`: what else can be done about an ending that names none. `formats`: those to choose
    from. Errors: `SettingError`.
    """
    if name is not None:
        if name not in formats:
            raise unknown_name("format", name, formats)
        return formats[name]
    if output == STDOUT:
        return formats["text"]
    ending = os.path.splitext(output)[1].lower()
    for row in formats.values():
        if row.ending == ending:
            return row
    endings = ", ".join(row.ending for row in formats.values())
    raise SettingError(f"{output}: its ending names no format: end it in {endings}{otherwise}")


def write_hue_report(
    histograms: Mapping[str, HueHistogram],
    output: str | os.PathLike[str],
    *,
    format: str | None = None,
    weight: str = "count",
    scale: str = "sqrt",
    axes: str = "both",
    clobber: bool = True,
) -> None:
    """Writes histograms as a report, as `hpcomp hues` does: text, data, a figure or a page.

    `histograms`: by what the report calls each, at least one, of the same bins and space.
    `output`: a path, whose ending is the format where `format` is not given, or `-` for stdout.
    `format`: text, json, csv, svg, png, pdf or html; figures need matplotlib. `weight`: what shares
    are shares of, count, chroma or alpha. `scale`: of shares, sqrt, linear or log. `axes`: of
    figures, both, linear or polar. `clobber`: an existing output is replaced.
    Errors: `SettingError`, `MismatchError`, `OutputError`.
    """
    output = os.fspath(output)
    render = report_format(output, format).load()
    look = Look(weight=weight, scale=scale, axes=axes)
    if not histograms:
        raise SettingError("a report needs a histogram: there is none")
    with whole_output(output, clobber=clobber) as target:
        write_bytes(target, render(list(histograms.items()), look), output)
