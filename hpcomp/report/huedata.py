"""Hue histograms as data for scripts: JSON, whose keys are in `JSON_KEYS`, and CSV. No pictures."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..errors import printable
from ..measures.histogram import PEAK_RADIUS_DEG, HueHistogram
from .look import Entry, Look, common_axis, srgb_hex

SCHEMA = "hpcomp.hues"
#: Version of the data; it grows when a key changes its meaning or goes.
SCHEMA_VERSION = 1

#: The keys of the JSON document; lists are of one number for each bin. The man page prints this.
JSON_KEYS: dict[str, str] = {
    "schema": '"hpcomp.hues".',
    "version": "Of the schema, 1: it grows when a key changes its meaning or goes.",
    "space": "The blending space whose hue and chroma were measured.",
    "bins": "How many bins each histogram has.",
    "achromatic": "The saturation below which pixels were grey.",
    "peak_radius": "2, the degrees around a peak that belong to it.",
    "images": "A list with the keys that follow for each image.",
    "name": "The name of the image: the one it was given, or its path, or `stdin`.",
    "pixels": "Counts: `all`, and of these `chromatic`, `grey`, `transparent` and `nonfinite`.",
    "peaks": "A list, the largest first: `hue` in degrees, of the mean colour; `count`; `share` "
    "and `chroma_share`, of all pixels with a hue and of their chroma; the mean colour, straight, "
    "as `rgb`, linear, and as `srgb`, `#rrggbb`.",
    "concentration": "`share` and `chroma_share` within 2° of the peaks; `entropy` of the counts, "
    "in bits, and `relative_entropy`, from 0 to 1; `occupied`, the number of bins with a pixel.",
    "histogram": "Lists: `hue`, the centre of the bin in degrees; `count`; and the sums `chroma` "
    "(|p| in the blending space), `alpha`, and `red`, `green`, `blue` (linear, premultiplied). "
    "Sums are exact multiples of 2^-24, and those of parts of an image add up.",
}

#: Digits of what is computed from sums: the same on every machine.
_DIGITS = 9

CSV_COLUMNS = ("image", "kind", "hue", "count", "chroma", "alpha", "red", "green", "blue")


def as_data(entries: Sequence[Entry]) -> dict[str, Any]:
    """Histograms of the same settings as dictionaries, lists, strings and numbers."""
    common_axis(entries)
    first = entries[0][1]
    return {
        "schema": SCHEMA,
        "version": SCHEMA_VERSION,
        "space": first.space,
        "bins": first.bins,
        "achromatic": first.achromatic,
        "peak_radius": PEAK_RADIUS_DEG,
        "images": [{"name": label, **histogram_data(histogram)} for label, histogram in entries],
    }


def histogram_data(histogram: HueHistogram) -> dict[str, Any]:
    """One histogram, as in `images` of the document."""
    concentration = histogram.concentration
    return {
        "pixels": {
            "all": histogram.pixels,
            "chromatic": histogram.chromatic,
            "grey": histogram.grey,
            "transparent": histogram.transparent,
            "nonfinite": histogram.nonfinite,
        },
        "peaks": [
            {
                "hue": _rounded(peak.hue),
                "count": peak.count,
                "share": _rounded(peak.share),
                "chroma_share": _rounded(peak.chroma_share),
                "rgb": [_rounded(component) for component in peak.rgb],
                "srgb": srgb_hex(peak.rgb),
            }
            for peak in histogram.peaks
        ],
        "concentration": {
            "share": _rounded(concentration.share),
            "chroma_share": _rounded(concentration.chroma_share),
            "entropy": _rounded(concentration.entropy),
            "relative_entropy": _rounded(concentration.relative_entropy),
            "occupied": histogram.occupied,
        },
        "histogram": {
            "hue": [_rounded(hue) for hue in histogram.hues.tolist()],
            "count": histogram.count.tolist(),
            "chroma": histogram.chroma_sums.tolist(),
            "alpha": histogram.alpha_sums.tolist(),
            **dict(zip(("red", "green", "blue"), histogram.rgb_sums.T.tolist(), strict=True)),
        },
    }


def _rounded(value: float) -> float:
    return round(value, _DIGITS)


def as_json(entries: Sequence[Entry], look: Look) -> bytes:
    """The JSON document, ASCII, a list of numbers on one line."""
    return one_line_lists(json.dumps(as_data(entries), indent=2)).encode() + b"\n"


#: A list that holds no string, list or object, in JSON with line breaks; strings have none.
_NUMBERS = re.compile(r'\[\n([^\[\]{}"]*)\n *\]')


def one_line_lists(text: str) -> str:
    """Indented JSON with each list of numbers on one line."""
    return _NUMBERS.sub(lambda match: f"[{' '.join(match[1].split())}]", text)


def as_csv(
    entries: Sequence[Entry], look: Look, more: Mapping[str, Sequence[float]] | None = None
) -> bytes:
    """A table with a row for each bin of each image, and for the pixels that are in none; UTF-8.

    `kind` is `hue`, with the bin's centre in `hue`, or `grey`, `transparent` or `nonfinite`, whose
    rows have a count alone. The other columns are sums, as in the JSON document. `more`: columns
    at the right, a number for each of the entries, which stands in each of its rows.
    """
    common_axis(entries)
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    added = {} if more is None else more
    writer.writerow((*CSV_COLUMNS, *added))
    for number, (label, histogram) in enumerate(entries):
        of_entry = [column[number] for column in added.values()]
        for row in _rows(histogram):
            writer.writerow((printable(label), *row, *of_entry))
    return text.getvalue().encode()


def _rows(histogram: HueHistogram) -> Iterator[tuple[Any, ...]]:
    data = histogram_data(histogram)
    for values in zip(*data["histogram"].values(), strict=True):
        yield ("hue", *values)
    for kind in ("grey", "transparent", "nonfinite"):
        yield (kind, "", data["pixels"][kind], *[""] * 5)
