"""What a stack tells beside its picture: findings, provenance and previews, strip by strip.

Imported where a report or a provenance is asked for, with all that those need.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..blending.addition import BLENDINGS
from ..blending.rules import StackRules
from ..color.encoding import Losses, Primaries
from ..color.samples import Rgba, Samples, Strip, encode
from ..engine import choice as engine
from ..errors import OutputError, SettingError, why
from ..geometry import Window
from ..imagefile.exrscanlines import ExrForm, ExrScanlineWriter
from ..imagefile.writing import OutputForm
from ..measures.findings import MeasuredStrip, StackFindings
from ..measures.histogram import DEFAULT_ACHROMATIC, DEFAULT_BINS, HueHistogram
from ..measures.labels import (
    ENERGY_WEIGHTS,
    MeasureSettings,
    Provenance,
    check_energy_weights,
    half_step,
    measure_settings,
)
from ..system.outputs import whole_output
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
#: What a histogram's bin takes, and a strip's findings are held so many times.
_BIN_BYTES, _FINDINGS_HELD = 64, 4
#: What measuring a block of pixels takes for each layer, in numpy.
_BLOCK_BYTES = 1 << 19


@dataclass(frozen=True)
class Inquiry:
    """What is asked of a stack beside its picture, checked.

    `reports`: path and format of each. `provenance`: a path or None. Behind `opened`, `targets` are
    where each of these is written to first.
    """

    reports: tuple[tuple[str, str], ...]
    provenance: str | None
    settings: MeasureSettings
    bins: int
    energy_weights: tuple[float, float, float]
    targets: dict[str, str]

    @staticmethod
    def checked(
        report: Sequence[str | os.PathLike[str]],
        provenance: str | os.PathLike[str] | None,
        *,
        rules: StackRules,
        kind: str,
        foreign_tolerance: float | None,
        achromatic: float | None,
        energy_weights: str | Sequence[float] | None,
        bins: int | None,
    ) -> Inquiry:
        """`kind`: of the samples of the picture.

        Errors: `SettingError`; `OutputError` where a library is missing.
        """
        reports = tuple(
            (path, report_format(path, otherwise="").name)
            for path in (os.fspath(path) for path in report)
        )
        for _, name in reports:
            load_stack_renderer(name)
        planes = None if provenance is None else os.fspath(provenance)
        if planes is not None and os.path.splitext(planes)[1].lower() != ".exr":
            raise SettingError(f"provenance {planes} is an EXR: end it in .exr")
        settings = measure_settings(
            rules,
            half_step=half_step(kind),
            achromatic=DEFAULT_ACHROMATIC if achromatic is None else achromatic,
            foreign_tolerance=foreign_tolerance,
        )
        bins = DEFAULT_BINS if bins is None else bins
        HueHistogram.empty(bins)  # checks them
        return Inquiry(reports, planes, settings, bins, _weights(energy_weights), {})

    @property
    def with_preview(self) -> bool:
        return any(needs_preview(name) for _, name in self.reports)

    def memory(self, layers: int, window: Window) -> tuple[int, int]:
        """Bytes for each pixel of a strip, and for the whole."""
        return Evidence.memory(layers, self.bins, window, self.with_preview)

    @property
    def outputs(self) -> list[str]:
        """The files that it writes."""
        reports = [path for path, _ in self.reports]
        return reports if self.provenance is None else [*reports, self.provenance]

    def opened(self, opened: contextlib.ExitStack, clobber: bool, if_changed: bool) -> Inquiry:
        """The same with a place for each file, which appears when `opened` closes in peace."""
        targets = {
            path: opened.enter_context(whole_output(path, clobber=clobber, if_changed=if_changed))
            for path in self.outputs
        }
        return replace(self, targets=targets)

    @contextlib.contextmanager
    def evidence(
        self, rules: StackRules, window: Window, canvas: Window, pixel_aspect: float
    ) -> Iterator[Evidence]:
        """What gathers the answers."""
        writer = None
        if self.provenance is not None:
            form = ExrForm("float", "zip", window, canvas, pixel_aspect, planes=_PLANES)
            writer = ExrScanlineWriter(self.targets[self.provenance], form, self.provenance)
        try:
            yield Evidence(
                rules,
                self.settings,
                self.bins,
                window,
                with_preview=self.with_preview,
                provenance=writer,
            )
        finally:
            if writer is not None:
                writer.abandon()

    def publish(
        self,
        evidence: Evidence,
        *,
        output: str,
        command: str,
        settings: Mapping[str, str],
        labels: Sequence[str],
    ) -> None:
        """Writes the reports, and completes the provenance. Errors: `OutputError`."""
        evidence.finish()
        report = StackReport(
            output,
            command,
            __version__,
            engine.active().NAME,
            settings,
            tuple(labels),
            evidence.findings,
            self.energy_weights,
            evidence.preview(),
        )
        for path, name in self.reports:
            content = render_stack_report(report, name)
            try:
                with open(self.targets[path], "wb") as file:
                    file.write(content)
            except OSError as reason:
                raise OutputError(f"{path}: cannot be written: {why(reason)}") from None


def _weights(given: str | Sequence[float] | None) -> tuple[float, float, float]:
    """Of red, green and blue; from `0.3,0.25,0.45` too. Errors: `SettingError`."""
    if given is None:
        return ENERGY_WEIGHTS
    if isinstance(given, str):
        try:
            given = [float(word) for word in given.split(",")]
        except ValueError:
            raise SettingError(
                f"energy weights '{given}' are not three numbers: write 0.3,0.25,0.45"
            ) from None
    return check_energy_weights(given)


#: Of a strip: its findings, and its provenance where that is wanted.
Found = tuple[StackFindings, Provenance | None]


@dataclass(frozen=True)
class StripEvidence:
    """That of one strip, on its way to `Evidence.write`."""

    top: int
    findings: StackFindings
    provenance: Provenance | None
    pictures: tuple[Rgba, Rgba] | None


class Evidence:
    """Gathers what a stack tells: `prepare` in any thread, `write` in the order of the strips.

    `bins`: of the hue histograms. `with_preview`: whether pictures are wanted, at the size of a
    page. `provenance`: writes that file, where there is to be one.
    """

    def __init__(
        self,
        rules: StackRules,
        settings: MeasureSettings,
        bins: int,
        window: Window,
        *,
        with_preview: bool,
        provenance: ExrScanlineWriter | None,
    ) -> None:
        self.findings = StackFindings.none(rules, settings, bins)
        self._rules, self._settings, self._bins, self._window = rules, settings, bins, window
        self._preview = _PreviewSums(window, rules.primaries) if with_preview else None
        self._provenance = provenance

    @staticmethod
    def memory(layers: int, bins: int, window: Window, with_preview: bool) -> tuple[int, int]:
        """Bytes for each pixel of a strip, and for the whole."""
        preview = _PreviewSums.memory(window) if with_preview else 0
        histograms = (layers + 2) * (bins + 1) * _BIN_BYTES * _FINDINGS_HELD
        return 24 + (64 if with_preview else 0), histograms + (layers + 4) * _BLOCK_BYTES + preview

    def result(
        self,
        accumulator: engine.Accumulator,
        strips: Sequence[Strip],
        rows: Window,
        form: OutputForm,
        losses: Losses,
    ) -> tuple[Samples, Found]:
        """The accumulated strip `rows` as samples, and what is found of it.

        `strips`: of all layers, bottom first.
        """
        with_provenance = self._provenance is not None or self._preview is not None
        strip = MeasuredStrip(
            self._rules,
            self._settings,
            self._bins,
            strips,
            rows.width,
            rows.height,
            with_provenance,
        )
        samples, findings, provenance = engine.result_and_findings(
            accumulator, form.kind, losses, form.gamut, strip
        )
        return samples, (findings, provenance)

    def prepare(self, strips: Sequence[Strip], rows: Window, found: Found) -> StripEvidence:
        """That of the strip `rows` of the canvas; `strips`: of all layers, bottom first."""
        findings, provenance = found
        pictures = None
        if self._preview is not None:
            plain = replace(self._rules, blending=BLENDINGS["traditional"])
            pictures = (
                self._composite(self._rules, strips, rows),
                self._composite(plain, strips, rows),
            )
        return StripEvidence(rows.y - self._window.y, findings, provenance, pictures)

    def write(self, strip: StripEvidence) -> None:
        """Adds a strip to those above it. Errors: `OutputError`."""
        self.findings += strip.findings
        if self._provenance is not None and strip.provenance is not None:
            found = strip.provenance
            planes = np.empty((*found.layer.shape, len(_PLANES)), np.float32)
            # The last plane of the file comes first; numbers keep their bits.
            planes[..., 0], planes[..., 2] = found.margin, found.grey
            planes.view(np.uint32)[..., 1] = found.layer
            self._provenance.write(self._provenance.prepare(strip.top, planes))
        if (
            self._preview is not None
            and strip.pictures is not None
            and strip.provenance is not None
        ):
            self._preview.add(strip.top, strip.pictures, strip.provenance.layer)

    def finish(self) -> None:
        """Completes the provenance. Errors: `OutputError`."""
        if self._provenance is not None:
            self._provenance.finish()

    def preview(self) -> Preview | None:
        """The pictures of the whole, where they were wanted."""
        return None if self._preview is None else self._preview.result()

    @staticmethod
    def _composite(rules: StackRules, strips: Sequence[Strip], rows: Window) -> Rgba:
        accumulator = engine.start(rules, rows.width, rows.height)
        accumulator.add(rules.arrival, [strips[number] for number in rules.arrival])
        return accumulator.result("float", Losses())


class _PreviewSums:
    """Both pictures as means of squares of pixels, and one pixel of each square's provenance.

    Rows are added one by one, so that the sums do not depend on how they arrive.
    """

    def __init__(self, window: Window, primaries: Primaries) -> None:
        self._primaries = primaries
        self._scale = preview_scale(window.width, window.height)
        shape = -(-window.height // self._scale), -(-window.width // self._scale)
        self._sums = np.zeros((2, *shape, 4))
        self._layer = np.zeros(shape, np.uint32)
        columns = np.arange(0, window.width, self._scale)
        self._columns = columns
        widths = np.diff(np.append(columns, window.width))
        heights = np.diff(np.append(np.arange(0, window.height, self._scale), window.height))
        self._areas = (heights[:, None] * widths)[..., None]

    @staticmethod
    def memory(window: Window) -> int:
        scale = preview_scale(window.width, window.height)
        return (window.width // scale + 1) * (window.height // scale + 1) * 2 * 4 * 8 * 2

    def add(self, top: int, pictures: Sequence[Rgba], layer: NDArray[np.uint32]) -> None:
        for offset in range(len(layer)):
            row, within = divmod(top + offset, self._scale)
            for sums, picture in zip(self._sums, pictures, strict=True):
                sums[row] += np.add.reduceat(
                    picture[offset].astype(np.float64), self._columns, axis=0
                )
            if within == 0:
                self._layer[row] = layer[offset, :: self._scale]

    def result(self) -> Preview:
        result, traditional = (self._picture(sums) for sums in self._sums)
        return Preview(result, traditional, self._layer, self._scale)

    def _picture(self, sums: NDArray[np.float64]) -> Any:
        with np.errstate(invalid="ignore"):
            means = (sums / self._areas).astype(np.float32)
        return encode(means, "uint8", Losses(), self._primaries)
