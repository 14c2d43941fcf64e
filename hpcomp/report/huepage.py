"""Hue histograms as a page to read in a browser. Its charts are made in `pagechart`."""

from __future__ import annotations

from collections.abc import Sequence

from .look import Entry, Look
from .markup import h, isolated, lines
from .page import Section, page
from .pagechart import LARGE, Charts


def as_html(entries: Sequence[Entry], look: Look) -> bytes:
    """A page with a chart of each entry, on one scale."""
    charts = Charts(entries, look)
    figures = [charts.figure(isolated(label), histogram, LARGE) for label, histogram in entries]
    content = lines(
        charts.colors(),
        h.p(class_="note")[charts.caption + _one_scale(entries)],
        h.div(class_="charts")[lines(*figures)],
    )
    name = entries[0][0] if len(entries) == 1 else f"{len(entries)} images"
    lead = (
        "Which hues there are, how much of each, and which stand out. Grey and transparent pixels "
        "have none and are counted apart."
    )
    return page("Hue report", name, lead, [Section("hues", "Hues", content)])


def _one_scale(entries: Sequence[Entry]) -> str:
    return " All charts have one scale." if len(entries) > 1 else ""
