"""Puts the numbers of a build into the page: tables of README.md, made from hpcomp's reports.

    python page.py DIRECTORY README.md           rewrites what stands between the markers
    python page.py --check DIRECTORY README.md   exit code 1 if the page has other numbers

Another processor may round otherwise: numbers that differ in their last digit are not others.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Report = dict[str, Any]


@dataclass(frozen=True)
class Row:
    """A line of a table: what it is called, the report, and which of its two results."""

    label: str
    report: str
    side: str = "result"


@dataclass(frozen=True)
class Table:
    rows: tuple[Row, ...]
    columns: tuple[str, ...] = ("foreign hue", "peaks", "lost to grey")


# How far a number may be from that of the page, which is rounded as well.
POINTS = 0.3  # of a percentage
HUE_DEG = 1.0
ENERGY = 0.002  # of it
SMALL_PEAK = 1.3  # percent: at 1 a peak is listed, or just not


def percent(share: float) -> str:
    return f"{100 * share:.1f}%"


def peaks(report: Report, side: str) -> str:
    found = [f"{round(p['hue']) % 360}° {percent(p['share'])}" for p in report[side]["peaks"]]
    return ", ".join(found) or "none"


def numbers(cell: str) -> list[float]:
    return [float(word.replace(",", "")) for word in re.findall(r"[\d.,]*\d", cell)]


def same_share(here: str, there: str) -> bool:
    return abs(numbers(here)[0] - numbers(there)[0]) <= POINTS + 1e-9


def same_energy(here: str, there: str) -> bool:
    one, other = numbers(here)[0], numbers(there)[0]
    return abs(one - other) <= ENERGY * max(one, other)


def same_peaks(here: str, there: str) -> bool:
    """Each peak of one has its like in the other, or is small."""

    def listed(cell: str) -> list[tuple[float, float]]:
        found = numbers(cell)
        return list(zip(found[::2], found[1::2], strict=True))

    def has_like(peak: tuple[float, float], others: list[tuple[float, float]]) -> bool:
        return peak[1] <= SMALL_PEAK or any(
            abs((peak[0] - hue + 180) % 360 - 180) <= HUE_DEG
            and abs(peak[1] - share) <= POINTS + 1e-9
            for hue, share in others
        )

    one, other = listed(here), listed(there)
    return all(has_like(p, other) for p in one) and all(has_like(p, one) for p in other)


@dataclass(frozen=True)
class Column:
    """What its cells say of a report, and whether two cells say the same."""

    cell: Callable[[Report, str], str]
    same: Callable[[str, str], bool]


COLUMNS = {
    "foreign hue": Column(
        lambda report, side: percent(report["measures"][side]["foreign_share"]), same_share
    ),
    "peaks": Column(peaks, same_peaks),
    "lost to grey": Column(
        lambda report, side: percent(report["measures"][side]["lost_to_grey"]), same_share
    ),
    "visible": Column(
        lambda report, side: percent(report["measures"][side]["visible_share"]), same_share
    ),
    "energy": Column(
        lambda report, side: f"{report['measures'][side]['energy']:,.0f}", same_energy
    ),
}


def words_of(variable: str) -> list[str]:
    """Of the Makefile."""
    text = Path(__file__).with_name("Makefile").read_text(encoding="utf-8")
    (words,) = re.findall(rf"^{variable} := (.*)$", text, re.MULTILINE)
    return words.split()


def two(report: str, before: str = "") -> tuple[Row, Row]:
    """A report's traditional result and its hue-preserving one."""
    return (
        Row(f"{before}traditional", report, "traditional"),
        Row(f"{before}hue-preserving", report),
    )


PAIRS = {
    "a": "teal, orange",
    "b": "red, green",
    "c": "blue, yellow",
    "d": "red, cyan",
    "e": "one hue",
}
OPACITIES = words_of("OPACITIES")  # of the frog's brain
ORDERS = words_of("ORDERS")  # of three lights

HUES = ("foreign hue", "peaks")

#: By the names of the page's blocks.
TABLES = {
    "profiles": Table(
        tuple(r for p, names in PAIRS.items() for r in two(f"profiles-{p}", f"({p}) {names}, ")),
        HUES,
    ),
    "lights": Table(two("lights"), HUES),
    "labels": Table(
        tuple(r for n in (2, 3, 4) for r in two(f"mixtures-{n}", f"{n} labels, ")), HUES
    ),
    **{name: Table(two(name)) for name in ("tomato", "tooth", "fish", "piggy-bank")},
    "chest": Table((*two("chest-opposite", "(a) "), *two("chest-cyan", "(b) "))),
    "frog": Table(
        tuple(r for o in OPACITIES for r in two(f"brain-{o}", f"{o}, ")),
    ),
    "energy": Table(
        (*two("tooth", "Figure 7, "), *two("tooth-energy", "energy-aware, ")),
        ("foreign hue", "peaks", "lost to grey", "energy"),
    ),
    "grey": Table(
        tuple(
            row
            for part, rows in (("two", "two labels, "), ("four", "four labels, "))
            for row in (
                Row(f"{rows}traditional", f"grey-{part}", "traditional"),
                Row(f"{rows}hue-preserving", f"grey-{part}"),
                Row(f"{rows}`--gray-bias 1`", f"grey-bias-{part}"),
                Row(f"{rows}`--order simultaneous`", f"grey-simultaneous-{part}"),
                Row(f"{rows}`--preset woven`", f"grey-woven-{part}"),
            )
        ),
        ("foreign hue", "lost to grey", "visible"),
    ),
    "orders": Table(
        (
            Row("traditional", "orders", "traditional"),
            *(Row(f"`--order {o.replace('-', ',')}`", f"orders-{o}") for o in ORDERS),
            Row("`--order simultaneous`", "orders-simultaneous"),
            Row("`--preset woven`", "orders-woven"),
        ),
        ("foreign hue", "peaks", "lost to grey", "visible"),
    ),
    "oklab": Table((*two("tooth", "linear RGB, "), *two("tooth-oklab", "Oklab, "))),
    "foremost": Table(
        (
            Row("foremost", "foremost"),
            Row("foremost, behind the veil", "foremost-veil"),
            Row("hue-preserving, behind the veil", "veil"),
            Row("foremost, the tooth of Figure 7", "tooth-foremost"),
        ),
    ),
}


def table_text(table: Table, directory: Path) -> str:
    lines = ["| | " + " | ".join(table.columns) + " |", "|---" * (len(table.columns) + 1) + "|"]
    for row in table.rows:
        report = json.loads((directory / f"{row.report}.json").read_text())
        cells = [COLUMNS[column].cell(report, row.side) for column in table.columns]
        lines.append("| " + " | ".join([row.label, *cells]) + " |")
    return "\n".join(lines)


def with_tables(page: str, directory: Path) -> str:
    """The page with the numbers of that build. Errors: ValueError for a block that is missing."""
    for name, table in TABLES.items():
        begin, end = f"<!-- begin generated: {name} -->", f"<!-- end generated: {name} -->"
        if page.count(begin) != 1 or page.count(end) != 1:
            raise ValueError(f"the page needs one block for {name}: {begin} … {end}")
        block = f"{begin}\n\n{table_text(table, directory)}\n\n{end}"
        page = re.sub(f"{begin}.*?{end}", lambda _, b=block: b, page, flags=re.DOTALL)
    return page


def tables(page: str) -> dict[str, list[list[str]]]:
    """The rows of cells of the page's blocks, by name; the first row has the titles."""
    found = {}
    blocks = re.findall(r"<!-- begin generated: ([\w-]+) -->(.*?)<!-- end", page, re.DOTALL)
    for name, block in blocks:
        lines = [line for line in block.splitlines() if line.startswith("| ")]
        found[name] = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return found


def differences(page: str, directory: Path) -> list[str]:
    """What the page says otherwise than that build, a line for each cell."""
    shown, built = tables(page), tables(with_tables(page, directory))
    found = []
    for name, rows in built.items():
        titles, old = rows[0], shown[name]
        if [titles, *(row[0] for row in rows)] != [old[0], *(row[0] for row in old)]:
            found.append(f"{name}: the table has other rows or columns")
            continue
        found += [
            f"{name}, {row[0]}: {title} is {there} there, {here} on the page"
            for row, page_row in zip(rows[1:], old[1:], strict=True)
            for title, there, here in zip(titles[1:], row[1:], page_row[1:], strict=True)
            if not COLUMNS[title].same(here, there)
        ]
    return found


def main(words: list[str]) -> int:
    check = words[:1] == ["--check"]
    directory, path = (Path(word) for word in words[check:])
    old = path.read_text(encoding="utf-8")
    if not check:
        path.write_text(with_tables(old, directory), encoding="utf-8")
        return 0
    found = differences(old, directory)
    if found:
        print(f"{path} has not the numbers of {directory}: run make page", *found,
              sep="\n", file=sys.stderr)  # fmt: skip
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
