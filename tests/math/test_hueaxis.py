"""The hue axis: the hexagon of HSL, held against Python's own colorsys."""

import colorsys

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hpcomp.color.hueaxis import HEXAGON, NAMED_COLORS
from hpcomp.color.spaces import SPACES

components = st.floats(0, 1, allow_subnormal=False)


def degrees_apart(a, b):
    return abs((a - b + 180) % 360 - 180)


@given(st.tuples(components, components, components))
def test_hue_is_that_of_hsv(rgb):
    assume(max(rgb) - min(rgb) > 1e-9)
    expected = colorsys.rgb_to_hsv(*rgb)[0] * 360
    found = float(HEXAGON.degrees(np.array(rgb)))
    assert 0 <= found < 360
    # 1e-9 of difference leaves so many digits of an angle.
    assert degrees_apart(found, expected) < 1e-5


@pytest.mark.parametrize("space", SPACES)
@given(hue=st.floats(0, 360))
def test_color_of_a_hue_has_it_and_is_saturated(space, hue):
    axis = SPACES[space].hue_axis
    rgb = axis.color(np.array(hue))
    assert (rgb.min(), rgb.max()) == (0, 1)
    assert degrees_apart(float(axis.degrees(rgb)), hue) < 1e-9


@pytest.mark.parametrize(
    ("space", "degrees"),
    # Ottosson's figures of Oklab, and those of CIELAB as printed for sRGB, D65: h of each primary.
    [("oklab", (29.23, 142.50, 264.05)), ("cielab", (40.0, 136.0, 306.3))],
)
def test_hues_of_the_primaries_are_those_in_print(space, degrees):
    found = SPACES[space].hue_axis.landmarks()
    assert [found[name] for name in ("red", "green", "blue")] == pytest.approx(degrees, abs=0.05)


@pytest.mark.parametrize("space", ["oklab", "cielab"])
@given(c=st.tuples(components, components, components))
def test_a_spaces_own_angle_is_that_of_its_p(space, c):
    rgb = np.array(c)
    _, p = SPACES[space].forward(rgb)
    assume(np.hypot(*p) > 1e-6)
    expected = np.degrees(np.arctan2(p[1], p[0]))
    assert degrees_apart(float(SPACES[space].hue_axis.degrees(rgb)), expected) < 1e-9


@pytest.mark.parametrize("turn", [-720.0, -30.0, 0.0, 360.0])
def test_color_takes_hues_of_any_turn(turn):
    hues = np.arange(0, 360, 7.5)
    assert np.allclose(HEXAGON.color(hues + turn), HEXAGON.color((hues + turn) % 360), atol=1e-12)


def test_named_colors_are_sixty_degrees_apart():
    assert HEXAGON.landmarks() == dict(zip(NAMED_COLORS, range(0, 360, 60), strict=True))


def test_hue_just_below_zero_is_below_360():
    just_below = np.array([1.0, 0.0, 1e-18])
    assert HEXAGON.degrees(just_below) == 0


def test_every_space_has_an_axis():
    for space in SPACES.values():
        assert set(space.hue_axis.landmarks()) == set(NAMED_COLORS)
