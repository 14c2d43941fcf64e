"""What a stack tells beside its picture: it is watched strip by strip, and reports are written.

Imported where a report or a provenance is asked for, with all that those need.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..blending.rules import StackRules
from ..color.primaries import REC709
from ..color.quantization import Losses
from ..color.samples import Samples, Strip
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
from ..measures.squares import Squares
from ..measures.summary import StackSummary, StripToMeasure
from ..options import StackOptions
from ..system.outputs import whole_output, write_bytes
from ..version import __version__
from .hueformats import report_format
from .smallpictures import SmallPictures
from .stackreport import (
    StackReport,
    load_stack_renderer,
    needs_preview,
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

    `rows`: of the canvas. `squares`: of its layers and results, where a page shows pictures.
    """

    rows: Window
    summary: StackSummary
    provenance: Provenance | None
    squares: Squares | None


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
        self._with_preview = any(needs_preview(name) for _, name in self._reports)
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

    def memory(self, rules: StackRules, met: int, window: Window) -> tuple[int, int]:
        """Bytes for each pixel of a strip in which so many layers meet, and for the whole."""
        small = SmallPictures.memory(rules, met, window) if self._with_preview else (0, 0)
        histograms = (len(rules.operators) + 2) * (self._bins + 1) * _BIN_BYTES * _FINDINGS_HELD
        cells = -(-(met + 1) * _CELL_BYTES // CELL**2)
        return 24 + cells + small[0], histograms + (met + 4) * _BLOCK_BYTES + small[1]

    @contextlib.contextmanager
    def watch(
        self, rules: StackRules, window: Window, canvas: Window, pixel_aspect: float
    ) -> Iterator[None]:
        """Around the pass over the strips of `window`."""
        self._rules, self._window, self._canvas = rules, window, canvas
        self.summary = StackSummary.none(rules, self._settings, self._bins)
        self._pictures = SmallPictures(rules, window, canvas) if self._with_preview else None
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
        squares = None if self._pictures is None else self._pictures.squares(rows)
        strip = StripToMeasure(
            self._rules,
            self._settings,
            self._bins,
            strips,
            rows.width,
            rows.height,
            with_provenance=self._provenance is not None or squares is not None,
            origin=(rows.x - self._canvas.x, rows.y - self._canvas.y),
            squares=squares,
        )
        samples, summary, provenance = engine.result_and_summary(
            accumulator, form.kind, losses, form.gamut, strip
        )
        return samples, SeenStrip(rows, summary, provenance, squares)

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
            self._provenance.write(self._provenance.prepare(seen.rows.y - self._window.y, planes))
        if self._pictures is not None and seen.squares is not None:
            self._pictures.add(seen.rows, seen.squares, seen.provenance.layer)

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
            None if self._pictures is None else self._pictures.result(),
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
