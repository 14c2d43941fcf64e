"""Products of parameters, thinned: to rows that hold every pair of values, or every value."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Sequence
from itertools import combinations

import pytest

#: Markers of products: of how many columns the rows that are kept show each combination, and what the
#: others are marked as. Those that take long are left out of the gate, too.
PRODUCTS = {"pairwise": (2, "thorough"), "singly": (1, "exhaustive")}


def covering(rows: Sequence[Sequence[Hashable]], together: int = 2) -> list[int]:
    """Which rows to keep so that any two columns, or as many as are to be looked at together, still show
    each combination of values that they show in all.

    Greedy: always one of the rows that add most combinations; of these, one whose values have been seen
    least, so that values that are left over go round; of these, the first. Ascending.
    """
    pairs = [set(combinations(enumerate(row), min(together, len(row)))) for row in rows]
    missing = set().union(*pairs)
    kept = set()
    seen: Counter[tuple[int, Hashable]] = Counter()

    def worth(row: int) -> tuple[int, int, int]:
        return len(pairs[row] & missing), -sum(seen[value] for value in enumerate(rows[row])), -row

    while missing:
        best = max(range(len(rows)), key=worth)
        kept.add(best)
        seen.update(enumerate(rows[best]))
        missing -= pairs[best]
    return sorted(kept)


def mark_products(items: Iterable[pytest.Item]) -> None:
    """Marks what a test of such a marker has beside a covering of its product."""
    products: dict[tuple[str, str], list[pytest.Function]] = {}
    for item in items:
        for marker in PRODUCTS:
            if item.get_closest_marker(marker):
                products.setdefault((item.nodeid.partition("[")[0], marker), []).append(item)
    for (_, marker), product in products.items():
        together, left_out = PRODUCTS[marker]
        kept = set(covering([values(item) for item in product], together))
        for number, item in enumerate(product):
            if number not in kept:
                item.add_marker(left_out)


def values(item: pytest.Function) -> list[Hashable]:
    """What tells a value of each parameter from others; names set together are one parameter."""
    params = {name: id(value) for name, value in item.callspec.params.items()}
    found: list[Hashable] = []
    for mark in item.iter_markers("parametrize"):
        names = mark.args[0] if mark.args else mark.kwargs["argnames"]
        names = names.replace(" ", "").split(",") if isinstance(names, str) else names
        found.append(tuple(params.pop(name) for name in names))
    return [*found, *params.values()]
