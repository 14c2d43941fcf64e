"""The report of a stack as a page: results in one frame, numbers, hues, layers, provenance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..measures.defaults import CELL
from ..measures.histogram import HueHistogram
from ..measures.labels import ContributorMeasures, ResultMeasures, share
from .look import Look, percent, srgb_hex
from .markup import Node, digits, h, isolated, lines
from .page import Section, page
from .pagechart import LARGE, SMALL, Charts, peak_list, swatch
from .pagepictures import data_uri, mask, shown_size
from .stackreport import TRADITIONAL, Preview, StackReport

#: What a picture of that name is; the one of the file is the result, whatever its name.
_PICTURES = {
    TRADITIONAL: "the layers added as usual",
    "hue-preserving": "the layers added so that hues stay",
    "woven": "the hues of all layers side by side",
}
#: What is said of the picture that is the file's.
_OF_FILE = "(the file)"
#: What stands for a layer without any hue.
_COLORLESS = "#808080"


def as_html(report: StackReport) -> bytes:
    """The page, one file; without a preview it has no pictures."""
    sections = [
        Section("comparison", "Comparison", _comparison(report)),
        Section("hues", "Hues", _hues(report)),
        Section("layers", "Layers", _layers(report)),
        Section("making", "How it was made", _making(report)),
    ]
    if report.preview:
        provenance = _provenance(report, report.preview)
        sections.insert(1, Section("provenance", "Where each hue comes from", provenance))
    return page("Stack report", report.output, _lead(report), sections)


def _lead(report: StackReport) -> str:
    measures = report.summary.measures
    ours, plain = measures.result, measures.traditional
    if not plain.chromatic and not ours.chromatic:
        return "No pixel has a hue."
    theirs = percent(plain.foreign_share) if plain.foreign else "none"
    seen = (
        f"A reader finds {percent(ours.visible_share)} of what the layers show; with {TRADITIONAL} "
        f"blending, {percent(plain.visible_share)}."
    )
    if ours.foreign:
        return (
            f"{percent(ours.foreign_share)} of the coloured pixels have a hue that nothing there "
            f"gave them; with {TRADITIONAL} blending, {theirs}. {seen}"
        )
    verdict = f"{theirs} have not" if plain.foreign else "all have, too"
    return (
        "Every coloured pixel has the hue of something that lies there. "
        f"With {TRADITIONAL} blending, {verdict}. {seen}"
    )


# --- pictures -------------------------------------------------------------------------------------


def _comparison(report: StackReport) -> Node:
    cards = h.div(class_="cards")[lines(*_cards(report))]
    counts = _counts(report)
    if report.preview is None:
        return lines(h.div(class_="columns")[cards], counts)
    frame = h.div(class_="frame")[lines(*_frame(report, report.preview), counts)]
    return h.div(class_="columns")[lines(frame, cards)]


def _frame(report: StackReport, preview: Preview) -> tuple[Node, ...]:
    """All pictures on one place, two of them in sight, and what moves the line between these."""
    names = list(preview.pictures)
    left = names[0]
    right = preview.of_file if preview.of_file != left else names[1]
    pictures = [
        _picture(number, name, preview, {left: "before", right: "after"}.get(name))
        for number, name in enumerate(names)
    ]
    control = h.input(
        type="range",
        id="split",
        min=0,
        max=100,
        step="any",
        value=50,
        aria_label="How much of the frame is the left picture",
    )
    knob = h.svg(width=24, height=24, aria_hidden="true")[h.path(d="M9 6 3 12l6 6M15 6l6 6-6 6")]
    handle = h.span(class_="handle", aria_hidden="true")[knob]
    frame = h.div(class_="compare", id="compare")[lines(*pictures, control, handle)]
    hint = h.p(class_="note scripted")[
        "Drag or click in the frame, or use the arrow keys, Home and End."
    ]
    if len(names) == 2:
        return frame, hint, _scale_note(preview)
    sides = h.p(class_="sides scripted")[
        lines(_side("left", "Left", preview, left), _side("right", "Right", preview, right), by=" ")
    ]
    return sides, frame, hint, _scale_note(preview)


def _side(side: str, title: str, preview: Preview, chosen: str) -> Node:
    """What chooses the picture at one side of the line."""
    options = [
        h.option(value=str(number), selected=name == chosen)[
            f"{name} {_OF_FILE}" if name == preview.of_file else name
        ]
        for number, name in enumerate(preview.pictures)
    ]
    return h.label[h.span[title], " ", h.select(id=side, aria_controls="compare")[lines(*options)]]


def _picture(number: int, name: str, preview: Preview, kind: str | None) -> Node:
    pixels = preview.pictures[name]
    what = "the result of this stack" if name == preview.of_file else _PICTURES.get(name, name)
    height, width = pixels.shape[:2]
    shown_width, shown_height, square = shown_size(width, height)
    image = h.img(
        src=data_uri(pixels),
        width=shown_width,
        height=shown_height,
        alt=f"The {name} picture: {what}",
        class_="square" if square else None,
        draggable="false",
    )
    return h.figure(class_=kind, data_picture=str(number), data_name=name)[
        image, h.figcaption[name, [" ", h.span[_OF_FILE]] if name == preview.of_file else ""]
    ]


def _scale_note(preview: Preview) -> Node:
    if preview.scale == 1:
        return ""
    note = f"One pixel here is the mean of {preview.scale} × {preview.scale} of the picture."
    if preview.of_small_layers:
        *others, last = preview.of_small_layers
        names = f"{', '.join(others)} and {last}" if others else last
        note += (
            f" What is shown as {names} is blended from the layers at this size. So a woven "
            f"pattern is seen: it is {preview.scale} times as coarse as in a file."
        )
    return h.p(class_="note")[note]


def _provenance(report: StackReport, preview: Preview) -> Node:
    height, width = preview.provenance.shape
    shown_width, shown_height, square = shown_size(width, height)
    counts = np.bincount(preview.provenance.ravel(), minlength=len(report.labels) + 1)
    images, rows = [], []
    for number, label in enumerate(report.labels):
        color = layer_color(report.summary.layers[number])
        n_pixels = int(counts[number + 1])
        if n_pixels:
            images.append(
                h.img(
                    src=data_uri(mask(preview.provenance == number + 1, color)),
                    width=shown_width,
                    height=shown_height,
                    alt="",
                    id=f"map-{number}",
                    class_="square" if square else None,
                )
            )
        rows.append(_legend_row(number, label, color, n_pixels, preview.provenance.size))
    alone = percent(share(int(counts[0]), preview.provenance.size))
    rows.append(
        h.li[
            h.span(class_="box none", aria_hidden="true"),
            h.span(class_="name")["no layer: grey, transparent, or nobody's hue"],
            h.span(class_="part")[alone],
        ]
    )
    picture = h.div(
        class_="map",
        role="img",
        aria_label="Map of the layers whose hue survived, pixel by pixel, in the layers' colours. "
        "The list beside it says how much each has.",
    )[lines(*images)]
    buttons = h.p(class_="buttons scripted")[
        lines(
            h.button(type="button", data_show="all")["Show all"],
            h.button(type="button", data_show="none")["Show none"],
            by=" ",
        )
    ]
    legend = h.div(class_="beside")[lines(h.ul(class_="legend")[lines(*rows)], buttons)]
    intro = h.p(class_="note")[
        "Each pixel has the colour of the layer whose hue it shows; the share is of the picture."
    ]
    return h.fragment[intro, h.div(class_="columns")[lines(picture, legend)], _scale_note(preview)]


def _legend_row(number: int, label: str, color: str, n_pixels: int, all_pixels: int) -> Node:
    switch = h.input(
        type="checkbox",
        checked=bool(n_pixels),
        disabled=not n_pixels,
        class_="scripted",
        data_map=f"map-{number}" if n_pixels else None,
    )
    words = h.span(class_="name")[layer_name(number, label)]
    part = h.span(class_="part")[percent(share(n_pixels, all_pixels))]
    return h.li[h.label[switch, swatch(color), words, part]]


def layer_color(histogram: HueHistogram) -> str:
    """The colour that stands for a layer: of its largest peak, else the mean of all with a hue."""
    if histogram.peaks:
        return srgb_hex(histogram.peaks[0].rgb)
    weight = float(histogram.alpha_sums.sum()) or float(histogram.chromatic)
    if not weight:
        return _COLORLESS
    return srgb_hex(histogram.rgb_sums.sum(axis=0) / weight)


def layer_name(number: int, label: str) -> Node:
    """A layer's number and name, the number once where the label is like `layer 3 (leaf.png)`."""
    begin = f"layer {number} ("
    if label.startswith(begin) and label.endswith(")"):
        label = label[len(begin) : -1]
    return h.fragment[h.span(class_="number")[str(number)], " ", isolated(label)]


# --- numbers --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Measure:
    """A share of each result, by its name, and what it is, in one sentence; some may be unknown."""

    title: str
    meaning: str
    shares: dict[str, float]


def _measures(report: StackReport) -> list[_Measure]:
    measures = report.summary.measures

    def of_all(measure: Callable[[ResultMeasures], float]) -> dict[str, float]:
        return {name: measure(result) for name, result in measures.results.items()}

    red, green, blue = (f"{weight:g}" for weight in report.energy_weights)
    white = (measures.pixels - measures.unmeasured) * sum(report.energy_weights)
    return [
        _Measure(
            "Visible",
            "The share of the layers’ pixels where a reader finds their hue: it is seen at least "
            f"once in that square of {CELL} × {CELL} pixels.",
            of_all(lambda result: result.visible_share),
        ),
        _Measure(
            "Foreign hue, by pixel",
            "The share of the coloured pixels whose hue is more than "
            f"{measures.settings.foreign_tolerance:.3g}° from that of every layer that contributes "
            "there.",
            of_all(lambda result: result.foreign_share),
        ),
        _Measure(
            "Foreign hue, by chroma",
            "The same with every pixel counted by its chroma, so that what is vivid weighs more.",
            of_all(lambda result: result.foreign_chroma_share),
        ),
        _Measure(
            "Lost to grey",
            "The share of the layers’ chroma that blending cancelled: colour that went in and "
            "came out as grey.",
            of_all(lambda result: result.lost),
        ),
        _Measure(
            "Order sensitivity",
            "The share of the coloured pixels that would show another layer’s hue if the layers "
            "were blended from the top down instead of from the bottom up.",
            {"result": measures.order_sensitivity},
        ),
        _Measure(
            "Energy",
            "An estimate of what an emissive display takes for the picture over black, as a share "
            f"of what it takes for white; linear red, green and blue weigh {red}, {green} and "
            f"{blue}.",
            of_all(lambda result: share(result.energy(report.energy_weights), white)),
        ),
    ]


def _cards(report: StackReport) -> list[Node]:
    return [
        h.div(class_="card")[
            h.h3[row.title],
            h.dl[
                (
                    _pair(report.names[name], value, "ours" if name == "result" else "plain")
                    for name, value in row.shares.items()
                )
            ],
            h.p[row.meaning],
        ]
        for row in _measures(report)
    ]


def _counts(report: StackReport) -> Node:
    measures = report.summary.measures
    sentences = [
        f"Of {measures.pixels:,} pixels, {measures.result.chromatic:,} have a hue in the result "
        f"and {measures.traditional.chromatic:,} in the {TRADITIONAL} one."
    ]
    if measures.unmeasured:
        sentences.append(f"{measures.unmeasured:,} hold NaN or Inf and are left out.")
    return h.p(class_="note")[lines(*sentences, by=" ")]


def _pair(name: str, value: float, kind: str) -> tuple[Node, Node]:
    return (
        h.dt(class_=kind)[name],
        h.dd(class_=kind)[h.b[percent(value)], _bar(value)],
    )


def _bar(value: float) -> Node:
    return h.svg(
        class_="bar", viewBox="0 0 100 6", preserveAspectRatio="none", height=6, aria_hidden="true"
    )[h.rect(width=digits(100 * min(1.0, value)), height=6)]


# --- hues and layers ------------------------------------------------------------------------------


def _hues(report: StackReport) -> Node:
    summary = report.summary
    results = [(report.names[name], found) for name, found in summary.results.items()]
    # A scale of their own: layers are often one bar, beside which a smear would be flat.
    charts = Charts(results, Look())
    figures = [charts.figure(_title(name), histogram, LARGE) for name, histogram in results]
    return lines(
        charts.colors(),
        h.p(class_="note")[
            f"{charts.caption} {'Both' if len(results) == 2 else 'All'} charts have one scale."
        ],
        h.div(class_="charts")[lines(*figures)],
    )


def _title(name: str) -> str:
    return name[:1].upper() + name[1:]


def _layers(report: StackReport) -> Node:
    summary = report.summary
    charts = Charts(list(zip(report.labels, summary.layers, strict=True)), Look())
    heads = ("Layer", "Peaks", "Pixels", "Visible", "Hue survived", "Lost to grey")
    results = list(summary.measures.results.values())
    names = list(report.names.values())
    rows = [
        _layer_row(
            h.fragment[swatch(layer_color(histogram)), layer_name(number, label)],
            list(zip(names, (result.layers[number] for result in results), strict=True)),
            peak_list(histogram) if histogram.chromatic else h.span["no hue"],
            heads,
        )
        for number, (label, histogram) in enumerate(zip(report.labels, summary.layers, strict=True))
    ]
    if summary.measures.result.background.chroma:
        background = zip(names, (result.background for result in results), strict=True)
        rows.append(_layer_row("background", list(background), "", heads))
    table = h.table(role="table")[
        lines(
            h.caption[
                "Bottom first. Pixels: where the layer contributes chroma. Visible: the share of "
                "those where a reader finds its hue nearby. Hue survived: the share that shows it. "
                f"Small print: {' and '.join(names[1:])} blending."
            ],
            h.thead(role="rowgroup")[
                h.tr(role="row")[(h.th(scope="col", role="columnheader")[head] for head in heads)]
            ],
            h.tbody(role="rowgroup")[lines(*rows)],
        )
    ]
    figures = [
        charts.figure(layer_name(number, label), histogram, SMALL)
        for number, (label, histogram) in enumerate(zip(report.labels, summary.layers, strict=True))
    ]
    return lines(
        table,
        h.p(class_="note")[
            "The hues of each layer at its opacity, as far as it lies on the canvas, on one scale:"
        ],
        h.div(class_="charts small")[lines(*figures)],
    )


def _layer_row(
    name: Node,
    measured: Sequence[tuple[str, ContributorMeasures]],
    peaks: Node,
    heads: tuple[str, ...],
) -> Node:
    """`measured`: what became of the layer in each result, with its name, the stack's own first."""
    (_, ours), *others = measured

    def each(of: Callable[[ContributorMeasures], float]) -> Node:
        if not ours.pixels:
            return "–"
        small = [h.small[f"{other} {percent(of(theirs))}"] for other, theirs in others]
        return h.fragment[h.b[percent(of(ours))], _bar(of(ours)), lines(*small)]

    cells = (
        peaks,
        f"{ours.pixels:,}",
        each(lambda contributor: contributor.visible_share),
        each(lambda contributor: contributor.survived_share),
        each(lambda contributor: contributor.lost),
    )
    return h.tr(role="row")[
        h.th(scope="row", role="rowheader")[name],
        (
            h.td(role="cell", data_head=head)[cell]
            for head, cell in zip(heads[1:], cells, strict=True)
        ),
    ]


# --- how it was made ------------------------------------------------------------------------------


def _making(report: StackReport) -> Node:
    settings = [
        part
        for name, text in report.settings.items()
        for part in (h.dt[name], h.dd[isolated(text)])
    ]
    parts = []
    if report.command:
        parts += [
            h.h3["Command"],
            h.div(class_="command")[
                h.pre(tabindex=0, role="region", aria_label="Command")[
                    h.code(id="command")[_command(report.command)]
                ],
                h.p(class_="buttons scripted")[
                    lines(
                        h.button(type="button", id="copy")["Copy"],
                        h.span(id="copied", role="status"),
                        by=" ",
                    )
                ],
            ],
        ]
    else:
        parts.append(h.p["It was made from Python, not by a command."])
    groups = [("Settings", settings)] if settings else []
    versions = [
        h.dt["hpcomp"], h.dd[report.version],
        h.dt["engine"], h.dd[report.engine],
    ]  # fmt: skip
    groups.append(("Versions", versions))
    lists = [h.div[h.h3[title], h.dl(class_="settings")[rows]] for title, rows in groups]
    return lines(*parts, h.div(class_="columns")[lists])


def _command(command: str) -> Node:
    """A command that does when it is pasted what it did, and shows what it will do.

    What cannot be seen, or would turn the letters beside it around, stands between single quotes,
    as `shlex.join` has it: there it is spelt out in the $'…' of POSIX shells.
    """
    shown = "".join(c if c.isprintable() else f"'$'{_spelt_out(c)}''" for c in command)
    # Lines break between words, not at the hyphens of an option.
    return h.fragment[lines(*(h.span[word] for word in shown.split(" ")), by=" ")]


def _spelt_out(character: str) -> str:
    # A byte of a name that is no UTF-8 arrives as half a surrogate pair.
    raw = "\udc80" <= character <= "\udcff"
    code = character.encode("utf-8", "surrogateescape" if raw else "surrogatepass")
    return "".join(f"\\x{byte:02x}" for byte in code)
