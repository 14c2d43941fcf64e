"""Products of parameters, thinned: the plain run takes rows that hold every pair of values."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from itertools import combinations

import pytest


def covering(rows: Sequence[Sequence[Hashable]]) -> list[int]:
    """Which rows to keep so that any two columns still show each pair of values that they show in all.

    Greedy: always the first of the rows that add most pairs. Ascending.
    """
    pairs = [set(combinations(enumerate(row), min(2, len(row)))) for row in rows]
    missing = set().union(*pairs)
    kept = set()
    while missing:
        best = max(range(len(rows)), key=lambda row: (len(pairs[row] & missing), -row))
        kept.add(best)
        missing -= pairs[best]
    return sorted(kept)


def mark_products(items: Iterable[pytest.Item]) -> None:
    """Marks as `thorough` what a test marked `pairwise` has beside a covering of its product."""
    products: dict[str, list[pytest.Function]] = {}
    for item in items:
        if item.get_closest_marker("pairwise"):
            products.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for product in products.values():
        kept = set(covering([values(item) for item in product]))
        for number, item in enumerate(product):
            if number not in kept:
                item.add_marker(pytest.mark.thorough)


def values(item: pytest.Function) -> list[Hashable]:
    """What tells a value of each parameter from others; names set together are one parameter."""
    params = {name: id(value) for name, value in item.callspec.params.items()}
    found: list[Hashable] = []
    for mark in item.iter_markers("parametrize"):
        names = mark.args[0] if mark.args else mark.kwargs["argnames"]
        names = names.replace(" ", "").split(",") if isinstance(names, str) else names
        found.append(tuple(params.pop(name) for name in names))
    return [*found, *params.values()]
