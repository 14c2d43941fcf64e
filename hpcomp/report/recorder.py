"""What a stack tells beside its picture: it is watched strip by strip, and reports are written.

Imported where a report or a provenance is asked for, with all that those need.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..blending.rules import StackRules
from ..color.primaries import REC709
from ..color.quantization import Losses
from ..color.samples import Rgba, Samples, Strip, encode
from ..engine import choice as engine
from ..engine.contract import Accumulator
from ..geometry import Window
from ..imagefile.exrscanlines import ExrForm, ExrScanlineWriter
from ..imagefile.header import PictureHeader
from ..imagefile.writing import OutputForm
from ..measures.defaults import CELL, DEFAULT_BINS, check_energy_weights
from ..measures.labels import (
    ENERGY_WEIGHTS,
    Provenance,
    half_step,
    measure_settings,
)
from ..measures.summary import StackSummary, StripToMeasure
from ..options import StackOptions
from ..system.outputs import whole_output, write_bytes
from ..version import __version__
from .hueformats import report_format
from .stackreport import (
    Preview,
    StackReport,
    load_stack_renderer,
    needs_preview,
    preview_scale,
    render_stack_report,
)

#: The planes of a provenance file, in the order of the file.
_PLANES = (("grey", "float"), ("layer", "uint"), ("margin", "float"))
#: What a histogram's bin takes, and a strip's summary is held so many times.
_BIN_BYTES, _FINDINGS_HELD = 64, 4
#: What the kernel keeps of each layer in each cell.
_CELL_BYTES = 4
#: What measuring a block of pixels takes for each layer, in numpy.
_BLOCK_BYTES = 1 << 19


@dataclass(frozen=True)
class SeenStrip:
    """What is kept of one strip: its measures, and planes (height, width) where they are wanted.

    `top`: its first row, from that of the window. `pictures`: RGBA of those of `compared`.
    """

    top: int
    summary: StackSummary
    provenance: Provenance | None
    pictures: list[Rgba] | None


#: The blendings of which a page always shows a picture.
COMPARED = ("traditional", "hue-preserving", "woven")


def compared(rules: StackRules) -> dict[str, StackRules]:
    """The pictures that a page compares, by the names of their blendings."""
    return {name: rules.blended(name) for name in dict.fromkeys((*COMPARED, rules.blending.name))}


class Recorder:
    """Observes a stack: measures every strip, and writes reports and the provenance.

    `output`: what messages call the picture; `labels`: what reports call the layers, bottom first;
    `command`: what reports say made it. `summary`: of the strips that were written so far.
    Errors: `SettingError`; `OutputError` where a library is missing.
    """

    sees_layers = True
    cell = CELL

    def __init__(
        self,
        options: StackOptions,
        rules: StackRules,
        form: OutputForm,
        *,
        output: str,
        labels: Sequence[str],
        command: str,
    ) -> None:
        asked = options.reports
        self._options, self._form = options, form
        self._output, self._labels, self._command = output, tuple(labels), command
        self._reports = [(path, report_format(path, otherwise="").name) for path in asked.report]
        for _, name in self._reports:
            load_stack_renderer(name)
        self._provenance_path = asked.provenance
        self._settings = measure_settings(
            rules,
            half_step=half_step(form.kind),
            achromatic=asked.achromatic,
            foreign_tolerance=asked.foreign_tolerance,
        )
        self._bins = DEFAULT_BINS if asked.bins is None else asked.bins
        weights = asked.energy_weights
        self._energy_weights = ENERGY_WEIGHTS if weights is None else check_energy_weights(weights)
        with_preview = any(needs_preview(name) for _, name in self._reports)
        self._n_pictures = len(compared(rules)) if with_preview else 0
        self.outputs = [path for path, _ in self._reports]
        if asked.provenance is not None:
            self.outputs.append(asked.provenance)
        self._places: dict[str, str] = {}
        self.summary: StackSummary | None = None

    def place(self, opened: contextlib.ExitStack) -> None:
        """Gives each file a place; they appear when `opened` closes without an error."""
        asked = self._options.output
        for path in self.outputs:
            self._places[path] = opened.enter_context(
                whole_output(path, clobber=asked.clobber, if_changed=asked.write_if_changed)
            )

    def memory(self, layers: int, window: Window) -> tuple[int, int]:
        """Bytes for each pixel of a strip, and for the whole."""
        preview = _PreviewSums.memory(window, self._n_pictures)
        histograms = (layers + 2) * (self._bins + 1) * _BIN_BYTES * _FINDINGS_HELD
        cells = -(-(layers + 1) * _CELL_BYTES // CELL**2)
        return (
            24 + cells + 32 * self._n_pictures,
            histograms + (layers + 4) * _BLOCK_BYTES + preview,
        )

    @contextlib.contextmanager
    def watch(
        self, rules: StackRules, window: Window, canvas: Window, pixel_aspect: float
    ) -> Iterator[None]:
        """Around the pass over the strips of `window`."""
        self._rules, self._window, self._canvas = rules, window, canvas
        self.summary = StackSummary.none(rules, self._settings, self._bins)
        self._preview = _PreviewSums(window, rules) if self._n_pictures else None
        self._provenance = None
        if self._provenance_path is not None:
            header = PictureHeader(window, canvas, pixel_aspect=pixel_aspect)
            form = ExrForm("float", "zip", header, _PLANES)
            place = self._places[self._provenance_path]
            self._provenance = ExrScanlineWriter(place, form, self._provenance_path)
        try:
            yield
        finally:
            if self._provenance is not None:
                self._provenance.abandon()

    def composite(
        self,
        accumulator: Accumulator,
        strips: Sequence[Strip],
        rows: Window,
        form: OutputForm,
        losses: Losses,
    ) -> tuple[Samples, SeenStrip]:
        """The accumulated strip `rows` as samples, and what is seen of it; in any thread.

        `strips`: of all layers, bottom first.
        """
        origin = rows.x - self._canvas.x, rows.y - self._canvas.y
        strip = StripToMeasure(
            self._rules,
            self._settings,
            self._bins,
            strips,
            rows.width,
            rows.height,
            with_provenance=self._provenance is not None or self._preview is not None,
            origin=origin,
        )
        samples, summary, provenance = engine.result_and_summary(
            accumulator, form.kind, losses, form.gamut, strip
        )
        pictures = None
        if self._preview is not None:
            scale = self._preview.scale
            pictures = [
                _composited(_at_scale(shown, scale), strips, rows, origin)
                for shown in compared(self._rules).values()
            ]
        return samples, SeenStrip(rows.y - self._window.y, summary, provenance, pictures)

    def write(self, seen: SeenStrip) -> None:
        """Adds a strip to those above it. Errors: `OutputError`."""
        assert self.summary is not None
        self.summary += seen.summary
        if seen.provenance is None:
            return
        if self._provenance is not None:
            planes = np.empty((*seen.provenance.layer.shape, len(_PLANES)), np.float32)
            # The last plane of the file comes first; numbers keep their bits.
            planes[..., 0], planes[..., 2] = seen.provenance.margin, seen.provenance.grey
            planes.view(np.uint32)[..., 1] = seen.provenance.layer
            self._provenance.write(self._provenance.prepare(seen.top, planes))
        if self._preview is not None and seen.pictures is not None:
            self._preview.add(seen.top, seen.pictures, seen.provenance.layer)

    def publish(self) -> None:
        """Completes the provenance, and writes the reports. Errors: `OutputError`."""
        assert self.summary is not None
        if self._provenance is not None:
            self._provenance.finish()
        report = StackReport(
            self._output,
            self._command,
            __version__,
            engine.active().name,
            self._settings_in_words(),
            self._labels,
            self.summary,
            self._energy_weights,
            None if self._preview is None else self._preview.result(),
        )
        for path, name in self._reports:
            content = render_stack_report(report, name)
            write_bytes(self._places[path], content, path)

    def _settings_in_words(self) -> dict[str, str]:
        """What was chosen, as a report shows it."""
        rules, form = self._rules, self._form
        background = self._options.rules.background
        return {
            "blending": rules.blending.name,
            "order": rules.order.name,
            "space": rules.space.name,
            "primaries": rules.primaries.name,
            "hue tolerance": f"{rules.hue_tolerance:g}°",
            "strength": rules.strength.name,
            "gray bias": f"{rules.gray_bias:g}",
            **({"weave": str(rules.weave)} if rules.blending.depends_on_place else {}),
            "background": "none" if background is None else str(background),
            "exposure": f"{rules.exposure:g} stops, left out of all measures",
            "canvas": str(self._canvas),
            "output": f"{form.format.upper()}, {form.depth}, {form.compression}"
            + ("" if form.gamut == REC709 else f", {form.gamut.name}"),
        }


def _at_scale(rules: StackRules, scale: int) -> StackRules:
    """The rules for a picture that becomes so many times smaller: its weave shall be seen there."""
    return replace(rules, weave=replace(rules.weave, size=rules.weave.size * scale))


def _composited(
    rules: StackRules, strips: Sequence[Strip], rows: Window, origin: tuple[int, int]
) -> Rgba:
    accumulator = engine.start(rules, rows.width, rows.height, origin=origin)
    accumulator.add(rules.arrival, [strips[number] for number in rules.arrival])
    return accumulator.result("float", Losses())


class _PreviewSums:
    """All pictures as means of squares of pixels, and one pixel of each square's provenance.

    Rows are added one by one, so that the sums do not depend on how they arrive.
    """

    def __init__(self, window: Window, rules: StackRules) -> None:
        self._rules = rules
        self.scale = preview_scale(window.width, window.height)
        shape = -(-window.height // self.scale), -(-window.width // self.scale)
        self._sums = {name: np.zeros((*shape, 4)) for name in compared(rules)}
        self._layer = np.zeros(shape, np.uint32)
        columns = np.arange(0, window.width, self.scale)
        self._columns = columns
        widths = np.diff(np.append(columns, window.width))
        heights = np.diff(np.append(np.arange(0, window.height, self.scale), window.height))
        self._areas = (heights[:, None] * widths)[..., None]

    @staticmethod
    def memory(window: Window, pictures: int) -> int:
        scale = preview_scale(window.width, window.height)
        return (window.width // scale + 1) * (window.height // scale + 1) * pictures * 4 * 8 * 2

    def add(self, top: int, pictures: Sequence[Rgba], layer: NDArray[np.uint32]) -> None:
        for offset in range(len(layer)):
            row, within = divmod(top + offset, self.scale)
            for sums, picture in zip(self._sums.values(), pictures, strict=True):
                sums[row] += np.add.reduceat(
                    picture[offset].astype(np.float64), self._columns, axis=0
                )
            if within == 0:
                self._layer[row] = layer[offset, :: self.scale]

    def result(self) -> Preview:
        pictures = {name: self._picture(sums) for name, sums in self._sums.items()}
        return Preview(pictures, self._rules.blending.name, self._layer, self.scale)

    def _picture(self, sums: NDArray[np.float64]) -> Any:
        with np.errstate(invalid="ignore"):
            means = (sums / self._areas).astype(np.float32)
        rules = self._rules
        return encode(means, "uint8", Losses(), rules.primaries, space_name=rules.space.name)
