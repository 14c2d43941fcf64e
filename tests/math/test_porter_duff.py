"""The table of operators against the oracle's if-chain, and what Porter and Duff say of it."""

import numpy as np
import oracle
import pytest
import strategies
from hypothesis import given
from tolerances import ROUNDING, assert_near

from hpcomp.blending.porter_duff import OPERATORS, operator
from hpcomp.errors import ExitCode, SettingError

ALIASES = {
    "copy": "src",
    "src-over": "over",
    "under": "dst-over",
    "src-in": "in",
    "mask": "dst-in",
    "src-out": "out",
    "stencil": "dst-out",
    "src-atop": "atop",
    "add": "plus",
    "lighter": "plus",
}

#: `dst-x` is `x` with layer and stack exchanged; an operator that is its own mirror is symmetric.
MIRRORED = {
    "clear": "clear",
    "src": "dst",
    "over": "dst-over",
    "in": "dst-in",
    "out": "dst-out",
    "atop": "dst-atop",
    "xor": "xor",
    "plus": "plus",
}

# Corners, and values whose products and complements are exact in doubles.
ALPHAS = (0.0, 0.25, 0.5, 0.75, 1.0)


def test_the_table_has_these_operators_in_this_order():
    assert tuple(OPERATORS) == strategies.OPERATOR_NAMES
    assert [row.name for row in OPERATORS.values()] == list(OPERATORS)


def test_the_aliases_are_these():
    assert {alias: row.name for row in OPERATORS.values() for alias in row.aliases} == ALIASES


@pytest.mark.parametrize(("alias", "name"), ALIASES.items())
def test_an_alias_is_its_operator(alias, name):
    assert operator(alias) is operator(name) is OPERATORS[name]


@pytest.mark.parametrize("name", [*strategies.OPERATOR_NAMES, *ALIASES])
def test_factors_and_alpha_are_the_oracles_on_exact_alphas(name):
    for alpha_a in ALPHAS:
        for alpha_b in ALPHAS:
            f_a, f_b = operator(name).factors(alpha_a, alpha_b)
            assert (float(f_a), float(f_b)) == oracle.factors(name, alpha_a, alpha_b)
            expected = oracle.alpha_of(name, alpha_a, alpha_b)
            assert float(operator(name).alpha(alpha_a, alpha_b)) == expected


@given(name=strategies.operators, alpha_a=strategies.alphas, alpha_b=strategies.alphas)
def test_factors_and_alpha_are_the_oracles(name, alpha_a, alpha_b):
    factors = [float(f) for f in operator(name).factors(alpha_a, alpha_b)]
    assert_near(factors, oracle.factors(name, alpha_a, alpha_b), ROUNDING)
    alpha = float(operator(name).alpha(alpha_a, alpha_b))
    assert_near(alpha, oracle.alpha_of(name, alpha_a, alpha_b), ROUNDING)
    assert 0 <= alpha <= 1


@pytest.mark.parametrize(("name", "mirrored"), MIRRORED.items())
def test_mirrored_operators_exchange_layer_and_stack(name, mirrored):
    for alpha_a in ALPHAS:
        for alpha_b in ALPHAS:
            f_a, f_b = operator(name).factors(alpha_a, alpha_b)
            g_a, g_b = operator(mirrored).factors(alpha_b, alpha_a)
            assert (float(f_a), float(f_b)) == (float(g_b), float(g_a))


def test_only_dst_over_and_dst_atop_put_a_layer_behind():
    behind = [name for name, row in OPERATORS.items() if row.front_first("layer", "stack")[1] == "layer"]
    assert behind == ["dst-over", "dst-atop"]
    assert operator("over").front_first("layer", "stack") == ("layer", "stack")


@pytest.mark.parametrize("name", strategies.OPERATOR_NAMES)
def test_factors_of_arrays_are_those_of_their_elements(name):
    alpha_a, alpha_b = (grid.copy() for grid in np.meshgrid(ALPHAS, ALPHAS))
    before = alpha_a.copy(), alpha_b.copy()
    f_a, f_b = operator(name).factors(alpha_a, alpha_b)
    f_a, f_b = np.broadcast_to(f_a, alpha_a.shape), np.broadcast_to(f_b, alpha_a.shape)
    alpha = operator(name).alpha(alpha_a, alpha_b)
    for index in np.ndindex(alpha_a.shape):
        expected = oracle.factors(name, float(alpha_a[index]), float(alpha_b[index]))
        assert (f_a[index], f_b[index]) == expected
        assert alpha[index] == oracle.alpha_of(name, float(alpha_a[index]), float(alpha_b[index]))
    assert np.array_equal(alpha_a, before[0])
    assert np.array_equal(alpha_b, before[1])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", strategies.OPERATOR_NAMES)
def test_alpha_keeps_the_type(name, dtype):
    alpha = operator(name).alpha(np.full(3, 0.25, dtype), np.full(3, 0.75, dtype))
    assert alpha.dtype == dtype
    assert alpha.shape == (3,)


def test_plus_clamps_alpha_to_1():
    assert float(operator("plus").alpha(0.75, 0.75)) == 1


@pytest.mark.parametrize("name", ["normal", "ovr", "", "over ", "atop,over", "multiply"])
def test_an_unknown_operator_is_an_error_that_lists_the_valid_ones(name):
    with pytest.raises(SettingError) as caught:
        operator(name)
    message = str(caught.value)
    assert repr(name).strip("'") in message
    for valid in strategies.OPERATOR_NAMES:
        assert valid in message
    assert caught.value.exit_code == ExitCode.USAGE
