"""What the report of a stack is made from, and what renders it in which format. Renders nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

from ..errors import MismatchError, unknown_name
from ..measures.summary import StackSummary
from .look import Entry
from .measures import title

#: The name of the result by plain +.
TRADITIONAL = "traditional"

#: The longest side of a preview: enough to see labels, and a page that can be sent by mail.
PREVIEW_SIDE = 960


@dataclass(frozen=True)
class Preview:
    """Pictures small enough for a page; one preview pixel is `scale` × `scale` canvas pixels.

    `pictures`: two or more to be compared, by name, in the order to be shown, the one first that
    the others are compared with; (h, w, 4) uint8 each, straight sRGB with alpha. `of_file`: the
    name of that which is in the file. `provenance` (h, w): uint32, the number plus 1 of the layer
    whose hue survived there, 0 for none. `of_small_layers`: the pictures that are blended from
    layers of this size; the others are means of squares of the whole picture.
    """

    pictures: Mapping[str, NDArray[np.uint8]]
    of_file: str
    provenance: NDArray[np.uint32]
    scale: int
    of_small_layers: tuple[str, ...] = ()


def result_name(blending: str) -> str:
    """What a stack's result is called beside the traditional one: by its blending, if another."""
    return "result" if blending in ("", TRADITIONAL) else blending


def preview_scale(width: int, height: int) -> int:
    """The smallest scale at which no side of a preview of that canvas exceeds `PREVIEW_SIDE`."""
    return max(1, -(-max(width, height) // PREVIEW_SIDE))


@dataclass(frozen=True)
class StackReport:
    """All that a report of a stack says, whatever its format.

    `output`: what the picture is called. `command`: the exact command, each word quoted as
    `shlex.join` does; empty where the API was called. `version`, `engine`: of hpcomp, and the name
    of the engine that ran. `settings`: what was chosen, name to text, in the order to be shown;
    `blending` among them is what pages call the result. `labels`: of the layers, bottom first.
    `energy_weights`: of red, green and blue. `preview`: for formats that show pictures.
    Errors: `MismatchError` where labels and summary are of different numbers of layers.
    """

    output: str
    command: str
    version: str
    engine: str
    settings: Mapping[str, str]
    labels: tuple[str, ...]
    summary: StackSummary
    energy_weights: tuple[float, float, float]
    preview: Preview | None = None

    def __post_init__(self) -> None:
        if len(self.labels) != len(self.summary.layers):
            raise MismatchError(
                f"{len(self.labels)} labels for the findings of {len(self.summary.layers)} "
                "layers: give one for each"
            )

    @property
    def entries(self) -> list[Entry]:
        """The histograms, as a report of hues has them: layers, then results."""
        summary = self.summary
        return [
            *zip(self.labels, summary.layers, strict=True),
            *((title(name), histogram) for name, histogram in summary.results.items()),
        ]

    @property
    def names(self) -> dict[str, str]:
        """What a page calls each of the results, by its attribute of the summary."""
        own = result_name(self.settings.get("blending", ""))
        return {name: own if name == "result" else title(name) for name in self.summary.results}


Render = Callable[[StackReport], bytes]


@dataclass(frozen=True)
class _Renderer:
    """Where what renders a format lives, and whether it shows pictures."""

    module: str
    function: str
    pictures: bool = False


_RENDERERS: dict[str, _Renderer] = {
    "text": _Renderer(".stackdata", "as_text"),
    "json": _Renderer(".stackdata", "as_json"),
    "csv": _Renderer(".stackdata", "as_csv"),
    "svg": _Renderer(".huefigure", "stack_as_svg"),
    "png": _Renderer(".huefigure", "stack_as_png"),
    "pdf": _Renderer(".huefigure", "stack_as_pdf"),
    "html": _Renderer(".stackpage", "as_html", pictures=True),
}


def load_stack_renderer(format: str) -> Render:
    """What renders a stack's report in the format of that name, one of `REPORT_FORMATS`.

    Errors: `SettingError`; `OutputError` where a library that it needs is missing.
    """
    row = _renderer(format)
    render: Render = getattr(import_module(row.module, __package__), row.function)
    return render


def render_stack_report(report: StackReport, format: str) -> bytes:
    """The report in the format of that name, one of `REPORT_FORMATS`: a whole file.

    Errors: as `load_stack_renderer`, which can be called first so that nothing is made in vain.
    """
    return load_stack_renderer(format)(report)


def needs_preview(format: str) -> bool:
    """Whether a report in that format shows pictures. Errors: `SettingError`."""
    return _renderer(format).pictures


def _renderer(format: str) -> _Renderer:
    if format not in _RENDERERS:
        raise unknown_name("format", format, _RENDERERS)
    return _RENDERERS[format]
