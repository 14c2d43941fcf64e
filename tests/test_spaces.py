"""What every blending space keeps: luminance, degree 1, greys without chroma, the way back."""

from fractions import Fraction

import numpy as np
import oracle
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import any_pairs, hue_tolerances, valid_pairs
from tolerances import ANGLE_DEG, FLOAT64, HARD_SWITCH, HAS_HUE, ROUNDING, assert_near

from hpcomp.arrays import hue_add
from hpcomp.errors import SettingError
from hpcomp.hueaxis import HEXAGON
from hpcomp.spaces import D65, REC709_CHROMATICITIES, REC709_WEIGHTS, SPACES, space

# BT.709-6, item 3.2, prints the luminance coefficients with four digits.
PRINTED_DIGITS = 5e-5

# BT.709 primaries and D65 as exact fractions give these weights exactly.
EXACT_WEIGHTS = (Fraction(87098, 409605), Fraction(175762, 245763), Fraction(12673, 175545))

# There and back through a curved space: cube roots and cubes lose a few digits more.
ROUND_TRIP = 1e-13

bright_colors = st.tuples(*[st.floats(0.01, 100.0)] * 3)
any_colors = st.tuples(*[st.floats(-100, 1e4)] * 3)


def size(*colors):
    return max(abs(component) for c in colors for component in c) + 1e-300


def forward(name, c):
    """(Y, (p, p)) of one colour, as numbers."""
    (luminance,), ((p_1,), (p_2,)) = space(name).forward(np.array(c)[:, None])
    return luminance, (p_1, p_2)


def inverse(name, luminance, p):
    """The colour (R, G, B) of one Y and p."""
    return space(name).inverse(np.array([luminance]), np.array(p)[:, None])[:, 0]


def test_weights_are_those_of_the_primaries_and_white():
    assert_near(REC709_WEIGHTS, [float(w) for w in EXACT_WEIGHTS], ROUNDING)
    assert_near(REC709_WEIGHTS, oracle.luminance_weights(), ROUNDING)
    assert_near(REC709_WEIGHTS, (0.2126, 0.7152, 0.0722), PRINTED_DIGITS)
    assert_near(sum(REC709_WEIGHTS), 1.0, ROUNDING)


def test_spaces_are_listed_under_their_names():
    assert "linear-rgb" in SPACES
    for name, row in SPACES.items():
        assert space(name) is row
        assert row.name == name


@pytest.mark.parametrize("name", ["rgb", "lab", "", "linear_rgb", "Linear-RGB"])
def test_an_unknown_space_is_an_error_that_lists_the_valid_ones(name):
    with pytest.raises(SettingError) as caught:
        space(name)
    for valid in SPACES:
        assert valid in str(caught.value)


@pytest.mark.parametrize("name", SPACES)
class TestEverySpace:
    @given(c=any_colors)
    def test_y_is_the_linear_luminance(self, name, c):
        luminance, _ = forward(name, c)
        assert_near(luminance, oracle.luminance(c), ROUNDING, size(c))

    @given(c=bright_colors)
    def test_there_and_back(self, name, c):
        there = forward(name, c)
        assert_near(inverse(name, *there), c, ROUND_TRIP, size(c))

    @given(grey=st.floats(0, 1e4))
    def test_grey_has_no_chroma(self, name, grey):
        luminance, p = forward(name, (grey,) * 3)
        assert_near(p, [0.0, 0.0], ROUNDING, grey)
        assert_near(inverse(name, luminance, (0.0, 0.0)), [grey] * 3, ROUND_TRIP, grey)

    @given(c=bright_colors, k=st.floats(1e-3, 1e3))
    def test_degree_one(self, name, c, k):
        luminance, p = forward(name, c)
        luminance_k, p_k = forward(name, oracle.scaled(k, c))
        assert_near(luminance_k, k * luminance, ROUNDING, k * size(c))
        assert_near(p_k, k * np.array(p), ROUND_TRIP, k * size(c))

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    @pytest.mark.parametrize("shape", [(0,), (1,), (5,), (2, 3)])
    def test_planes_first_any_shape_and_type(self, name, shape, dtype):
        rgb = np.random.default_rng(1).random((3, *shape)).astype(dtype)
        before = rgb.copy()
        luminance, p = space(name).forward(rgb)
        back = space(name).inverse(luminance, p)
        assert np.shape(luminance) == shape
        assert p.shape == (2, *shape)
        assert back.shape == (3, *shape)
        assert {luminance.dtype, p.dtype, back.dtype} == {np.dtype(dtype)}
        assert np.array_equal(rgb, before)


def angle_deg(p1, p2):
    """Between two chroma vectors."""
    return np.degrees(oracle.angle((*p1, 0.0), (*p2, 0.0)))


#: How much ⊕ at 2° may turn a step of its inputs into, both in linear RGB. In linear-rgb the slope of
#: the shoulder, 1 + 3/τ = 87, and the luminance; X and Z stretch what p is, to 195 at worst of 40 ways.
STEEPEST = {"linear-rgb": 90, "xyz": 250}


@pytest.mark.parametrize("name", SPACES)
class TestAddition:
    """§1.2, with the hue that the space measures."""

    @given(pair=any_pairs, hue_tolerance=hue_tolerances)
    def test_luminance_adds(self, name, pair, hue_tolerance):
        c1, c2 = (layer[:3] for layer in pair)
        result = hue_add(np.array(c1), np.array(c2), hue_tolerance=hue_tolerance, space=name)
        expected = oracle.luminance(c1) + oracle.luminance(c2)
        assert_near(oracle.luminance(result), expected, 10 * ROUNDING, size(c1, c2))

    @given(pair=valid_pairs(), hue_tolerance=hue_tolerances)
    def test_hue_is_an_inputs_within_twice_the_tolerance(self, name, pair, hue_tolerance):
        c1, c2 = (layer[:3] for layer in pair)
        result = hue_add(np.array(c1), np.array(c2), hue_tolerance=hue_tolerance, space=name)
        p, p1, p2 = (forward(name, c)[1] for c in (result, c1, c2))
        assume(np.hypot(*p) > HAS_HUE * size(c1, c2))
        nearest = min(angle_deg(p, q) for q in (p1, p2) if any(q))
        assert nearest <= max(2 * hue_tolerance, np.degrees(oracle.ROUNDING_ANGLE)) + ANGLE_DEG

    @given(pair=any_pairs, hue_tolerance=hue_tolerances, k=st.floats(1e-3, 1e3))
    def test_homogeneous(self, name, pair, hue_tolerance, k):
        c1, c2 = (np.array(layer[:3]) for layer in pair)
        whole = hue_add(k * c1, k * c2, hue_tolerance=hue_tolerance, space=name)
        expected = k * hue_add(c1, c2, hue_tolerance=hue_tolerance, space=name)
        tolerance = FLOAT64 if hue_tolerance else HARD_SWITCH
        assert_near(whole, expected, tolerance, k * size(c1, c2))

    @given(pair=valid_pairs(), hue_tolerance=hue_tolerances)
    def test_in_gamut(self, name, pair, hue_tolerance):
        (*c1, alpha_1), (*c2, alpha_2) = pair
        result = hue_add(np.array(c1), np.array(c2), hue_tolerance=hue_tolerance, space=name)
        assert result.min() >= -FLOAT64
        assert result.max() <= alpha_1 + alpha_2 + FLOAT64

    @given(greys=st.tuples(*[st.floats(0, 1e4)] * 2))
    def test_greys_stay_grey_to_the_last_bit(self, name, greys):
        c1, c2 = (np.full(3, grey) for grey in greys)
        result = hue_add(c1, c2, space=name)
        assert result.max() == result.min()

    @pytest.mark.parametrize("seed", range(4))
    def test_continuous_along_random_paths(self, name, seed):
        # Straight ways from corner to corner of what is valid, through both shoulders.
        rng = np.random.default_rng(seed)
        steps = 20_000
        corners = rng.random((2, 9, 3)) ** rng.uniform(0.3, 4, (2, 9, 1))
        at = np.linspace(0, 8, steps + 1)
        c1, c2 = (
            np.stack([np.interp(at, np.arange(9), way[:, i]) for i in range(3)], axis=1)
            for way in corners
        )
        result = hue_add(c1, c2, space=name)
        jumps = np.linalg.norm(np.diff(result, axis=0), axis=1)
        moved = sum(np.linalg.norm(np.diff(c, axis=0), axis=1) for c in (c1, c2))
        assert (jumps / moved).max() <= STEEPEST[name]


class TestXyz:
    @given(c=any_colors)
    def test_p_is_what_x_and_z_differ_by_from_grey(self, c):
        _, p = forward("xyz", c)
        assert_near(p, oracle.chroma_of_xyz(c), ROUNDING, size(c))

    def test_is_the_xyz_of_colour_science(self):
        colour = pytest.importorskip("colour")
        bt709 = colour.RGB_Colourspace("709", REC709_CHROMATICITIES, D65)
        white = colour.xy_to_XYZ(D65)
        rgb = np.random.default_rng(1).random((50, 3))
        x, y, z = (rgb @ bt709.matrix_RGB_to_XYZ.T).T
        luminance, p = space("xyz").forward(rgb.T)
        assert_near(luminance, y, 1e-14)
        assert_near(p, [x - white[0] * y, z - white[2] * y], 1e-14)

    @given(c=any_colors, grey=st.floats(-10, 10), k=st.floats(0.01, 10))
    def test_the_half_planes_are_those_of_linear_rgb(self, c, grey, k):
        _, p = forward("xyz", c)
        _, other = forward("xyz", tuple(k * component + grey for component in c))
        assert_near(other, k * np.array(p), 1e2 * ROUNDING, k * size(c) + abs(grey))
        assert SPACES["xyz"].hue_axis is HEXAGON

    @given(grey=st.floats(-1e4, 1e4))
    def test_grey_has_exactly_no_chroma(self, grey):
        _, p = forward("xyz", (grey,) * 3)
        assert not any(p)


class TestLinearRgb:
    """§1.1: p is the difference vector in an orthonormal basis of its plane."""

    @given(c=any_colors)
    def test_chroma_is_the_length_of_the_difference_vector(self, c):
        _, p = forward("linear-rgb", c)
        assert_near(np.hypot(*p), oracle.length(oracle.difference(c)), ROUNDING, size(c))

    @given(c1=any_colors, c2=any_colors)
    def test_angles_between_p_are_those_between_difference_vectors(self, c1, c2):
        p1, p2 = (forward("linear-rgb", c)[1] for c in (c1, c2))
        d1, d2 = oracle.difference(c1), oracle.difference(c2)
        assume(oracle.length(d1) > 1e-3 * size(c1) and oracle.length(d2) > 1e-3 * size(c2))
        angle = oracle.angle((*p1, 0.0), (*p2, 0.0))
        # Rounding of the components, seen from vectors a thousand times shorter.
        assert_near(angle, oracle.angle(d1, d2), 1e3 * ROUNDING)

    @given(c1=any_colors, c2=any_colors)
    def test_forward_is_linear(self, c1, c2):
        (luminance_1, p1), (luminance_2, p2) = (forward("linear-rgb", c) for c in (c1, c2))
        luminance, p = forward("linear-rgb", oracle.added(c1, c2))
        assert_near(luminance, luminance_1 + luminance_2, ROUNDING, size(c1, c2))
        assert_near(p, oracle.added(p1, p2), ROUNDING, size(c1, c2))

    @given(c=any_colors)
    def test_there_and_back_of_any_colour(self, c):
        there = forward("linear-rgb", c)
        assert_near(inverse("linear-rgb", *there), c, ROUNDING, size(c))

    @given(grey=st.floats(-1e4, 1e4))
    def test_grey_has_exactly_no_chroma(self, grey):
        _, p = forward("linear-rgb", (grey,) * 3)
        assert not any(p)
