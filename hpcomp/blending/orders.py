"""Blend orders: in which sequence the terms of a stack are reduced, two of them by `addition`.

The stacking order decides the weights of the terms, the blend order only how they are reduced.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from typing import Any

from ..errors import SettingError, unknown_name
from ..records import record

#: Reduces terms, bottom first, given how two of them add and how all do at once. A term is anything
#: that adds: p (2, …), a `terms.Term` or what else.
Reducer = Callable[[Any, Callable[[Any, Any], Any], Callable[[Any], Any]], Any]


def _bottom_up(terms: Any, add: Any, add_all: Any) -> Any:
    return reduce(add, terms)


def _top_down(terms: Any, add: Any, add_all: Any) -> Any:
    return reduce(add, terms[::-1])


def _balanced(terms: Any, add: Any, add_all: Any) -> Any:
    level = list(terms)
    while len(level) > 1:
        odd_one = level[len(level) & ~1 :]
        level = [add(*pair) for pair in zip(level[0::2], level[1::2], strict=False)] + odd_one
    return level[0]


def _simultaneous(terms: Any, add: Any, add_all: Any) -> Any:
    return add_all(terms)


@record
class Order:
    """A blend order: its name, and how it reduces the terms of a stack.

    `sequence` is that of an explicit permutation.
    """

    name: str
    reduce: Reducer
    sequence: tuple[int, ...] = ()


ORDERS: dict[str, Order] = {
    row.name: row
    for row in (
        Order("bottom-up", _bottom_up),
        Order("top-down", _top_down),
        Order("balanced", _balanced),
        Order("simultaneous", _simultaneous),
    )
}


def _permutation(sequence: Sequence[int], n_layers: int) -> Order:
    """A left fold in an explicit order of the layers' numbers, 0 being the bottom."""
    if sorted(sequence) != list(range(n_layers)):
        counted_from_1 = sorted(sequence) == list(range(1, n_layers + 1))
        hint = f": write {_written(n - 1 for n in sequence)}" if counted_from_1 else ""
        raise SettingError(
            f"order {_written(sequence)} is not a permutation: name each of the layers 0 to "
            f"{n_layers - 1} exactly once, 0 being the bottom{hint}"
        )
    numbers = tuple(int(number) for number in sequence)

    def reduce_permuted(terms: Any, add: Any, add_all: Any) -> Any:
        return reduce(add, (terms[number] for number in numbers))

    return Order(_written(numbers), reduce_permuted, numbers)


def _written(sequence: Iterable[int]) -> str:
    return ",".join(map(str, sequence))


def order(name: str | Sequence[int], n_layers: int) -> Order:
    """The blend order of that name, or of a permutation: `"2,0,1"` or a sequence of ints.

    Errors: `SettingError` for an unknown name, listing the valid ones, and for a sequence that
    does not name each of the `n_layers` layers once.
    """
    wanted = check_order(name)
    return ORDERS[wanted] if isinstance(wanted, str) else _permutation(wanted, n_layers)


def check_order(name: str | Sequence[int]) -> str | Sequence[int]:
    """A name as it is, or the numbers of a permutation, of whatever number of layers.

    Errors: `SettingError` as `order`.
    """
    if not isinstance(name, str) or name in ORDERS:
        return name
    try:
        return [int(number) for number in name.split(",")]
    except ValueError:
        numbers = re.split(r"[\s,;:<>-]+", name.strip("[]() "))
        example = ",".join(numbers) if all(map(str.isdecimal, numbers)) else "2,0,1"
        raise unknown_name(
            "order",
            name,
            ORDERS,
            otherwise=f", or a permutation of the layers such as {example}",
        ) from None
