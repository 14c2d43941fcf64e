"""Puts the numbers of a build into the page: tables of README.md, made from hpcomp's reports.

    python page.py DIRECTORY README.md           rewrites what stands between the markers
    python page.py --check DIRECTORY README.md   exit code 1 if that would change the page
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
    columns: tuple[str, ...] = ("foreign hue", "peaks")


def percent(share: float) -> str:
    return f"{100 * share:.1f}%"


def peaks(report: Report, side: str) -> str:
    found = [f"{round(p['hue']) % 360}° {percent(p['share'])}" for p in report[side]["peaks"]]
    return ", ".join(found) or "none"


COLUMNS: dict[str, Callable[[Report, str], str]] = {
    "foreign hue": lambda report, side: percent(report["measures"][side]["foreign_share"]),
    "peaks": peaks,
    "lost to grey": lambda report, side: percent(report["measures"][side]["lost_to_grey"]),
    "energy": lambda report, side: f"{report['measures'][side]['energy']:,.0f}",
}


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
#: Of the frog's brain, as in the Makefile.
OPACITIES = ("0.04", "0.1", "0.2", "0.4", "1")
#: Orders of three lights, and which of them remains in the middle.
LAST = {"0-1-2": "blue", "1-0-2": "blue", "0-2-1": "magenta", "2-0-1": "magenta", "1-2-0": "red",
        "2-1-0": "red"}  # fmt: skip

#: By the names of the page's blocks.
TABLES = {
    "profiles": Table(
        tuple(row for p, names in PAIRS.items() for row in two(f"profiles-{p}", f"({p}) {names}, "))
    ),
    "lights": Table(two("lights")),
    "labels": Table(tuple(r for n in (2, 3, 4) for r in two(f"mixtures-{n}", f"{n} labels, "))),
    **{name: Table(two(name)) for name in ("tomato", "tooth", "fish", "piggy-bank")},
    "chest": Table((*two("chest-opposite", "(a) "), *two("chest-cyan", "(b) "))),
    "frog": Table(
        tuple(r for o in OPACITIES for r in two(f"brain-{o}", f"{o}, ")),
        ("foreign hue", "peaks", "lost to grey"),
    ),
    "energy": Table(
        (*two("tooth", "Figure 7, "), *two("tooth-energy", "energy-aware, ")),
        ("foreign hue", "peaks", "energy"),
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
            )
        ),
        ("foreign hue", "lost to grey"),
    ),
    "orders": Table(
        (
            Row("traditional", "orders", "traditional"),
            *(Row(f"`--order {o.replace('-', ',')}`", f"orders-{o}") for o in LAST),
            Row("`--order simultaneous`", "orders-simultaneous"),
        ),
        ("foreign hue", "peaks", "lost to grey"),
    ),
    "oklab": Table((*two("tooth", "linear RGB, "), *two("tooth-oklab", "Oklab, "))),
    "foremost": Table(
        (
            Row("foremost", "foremost"),
            Row("foremost, behind the veil", "foremost-veil"),
            Row("hue-preserving, behind the veil", "veil"),
            Row("foremost, the tooth of Figure 7", "tooth-foremost"),
        ),
        ("foreign hue", "peaks", "lost to grey"),
    ),
}


def table_text(table: Table, directory: Path) -> str:
    lines = ["| | " + " | ".join(table.columns) + " |", "|---" * (len(table.columns) + 1) + "|"]
    for row in table.rows:
        report = json.loads((directory / f"{row.report}.json").read_text())
        cells = [COLUMNS[column](report, row.side) for column in table.columns]
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


def main(words: list[str]) -> int:
    check = words[:1] == ["--check"]
    directory, path = (Path(word) for word in words[check:])
    old = path.read_text(encoding="utf-8")
    new = with_tables(old, directory)
    if check:
        if new != old:
            print(f"{path} has not the numbers of {directory}: run make page", file=sys.stderr)
        return int(new != old)
    path.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
