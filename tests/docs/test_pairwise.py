"""What the plain run and the gate leave out of a product of parameters."""

from itertools import combinations, product

import pytest
from pairwise import covering


def pairs(rows):
    return set().union(*(combinations(enumerate(row), 2) for row in rows))


@pytest.mark.parametrize("sizes", [(2, 3), (2, 2, 2), (13, 3, 5, 4), (5, 1, 4), (9, 9, 2, 2, 2)])
def test_every_pair_is_there_and_few_rows(sizes):
    rows = list(product(*map(range, sizes)))
    kept = [rows[number] for number in covering(rows)]
    assert pairs(kept) == pairs(rows)
    first, second = sorted(sizes)[-2:]
    assert first * second <= len(kept) <= 1.5 * first * second


@pytest.mark.parametrize("sizes", [(2, 3), (2, 2, 2), (13, 3, 5, 4), (5, 1, 4), (7,)])
def test_every_value_is_there_and_as_few_rows_as_can_be(sizes):
    rows = list(product(*map(range, sizes)))
    kept = [rows[number] for number in covering(rows, 1)]
    for column, size in enumerate(sizes):
        assert {row[column] for row in kept} == set(range(size))
    assert len(kept) == max(sizes)


def test_rows_that_are_not_there_are_not_needed():
    rows = [row for row in product(range(3), repeat=3) if row[0] <= row[1]]
    kept = [rows[number] for number in covering(rows)]
    assert pairs(kept) == pairs(rows)
    assert len(kept) < len(rows)


def test_one_parameter_stays_whole():
    assert covering([(value,) for value in "abc"]) == [0, 1, 2]
