"""What every blending space keeps: luminance, degree 1, greys without chroma, the way back."""

from fractions import Fraction

import numpy as np
import oracle
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import any_pairs, hue_tolerances, valid_pairs
from tolerances import ANGLE_DEG, FLOAT64, HARD_SWITCH, HAS_HUE, ROUNDING, assert_near

from hpcomp.blending.addition import added, keep_hue
from hpcomp.color.gamut import bounds_of, colors_within
from hpcomp.color.hueaxis import HEXAGON
from hpcomp.color.primaries import D65, REC709, REC709_TO_XYZ, REC709_WEIGHTS
from hpcomp.color.spaces import SPACES, space
from hpcomp.engine.arrays import hue_add
from hpcomp.errors import SettingError

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

    @pytest.mark.pairwise
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
#: the shoulder, 1 + 3/τ = 87, and the luminance; X and Z stretch what p is, to 195 at worst of 40 ways,
#: Oklab and CIELAB to 84 and 82 of 24.
STEEPEST = {"linear-rgb": 90, "xyz": 250, "hsl": 90, "oklab": 100, "cielab": 100}


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
        turn = max(2 * hue_tolerance, np.degrees(oracle.ROUNDING_ANGLE))
        assert nearest <= turn + ANGLE_DEG + SPACES[name].gamut_turn

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
        if name in oracle.OPEN:
            assert result.max() <= max(c1) + max(c2) + FLOAT64

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


def rgb_to_xyz(colour, chromaticities=REC709.rgb):
    """(3, 3) by colour-science, for primaries with the white D65."""
    return colour.RGB_Colourspace("", chromaticities, D65).matrix_RGB_to_XYZ


class TestXyz:
    @given(c=any_colors)
    def test_p_is_what_x_and_z_differ_by_from_grey(self, c):
        _, p = forward("xyz", c)
        assert_near(p, oracle.chroma_of_xyz(c), ROUNDING, size(c))

    def test_is_the_xyz_of_colour_science(self):
        import colour

        white = colour.xy_to_XYZ(D65)
        rgb = np.random.default_rng(1).random((50, 3))
        x, y, z = (rgb @ rgb_to_xyz(colour).T).T
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


class TestHsl:
    @given(c=any_colors)
    def test_chroma_is_the_difference_of_the_largest_and_the_smallest_channel(self, c):
        _, p = forward("hsl", c)
        assert_near(np.hypot(*p), max(c) - min(c), ROUNDING, size(c))

    @given(c=any_colors)
    def test_hues_are_those_of_linear_rgb(self, c):
        assume(max(c) - min(c) > 1e-3 * size(c))
        p, plane = (forward(name, c)[1] for name in ("hsl", "linear-rgb"))
        assert angle_deg(p, plane) <= ANGLE_DEG
        assert SPACES["hsl"].hue_axis is HEXAGON

    @given(c=any_colors)
    def test_there_and_back_of_any_colour(self, c):
        assert_near(inverse("hsl", *forward("hsl", c)), c, 1e1 * ROUNDING, size(c))


# Corners, edges and faces of the cube, and what is within: (n, 3).
IN_GAMUT = np.concatenate(
    [
        np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8).T[1:].astype(float),
        np.random.default_rng(1).random((200, 3)) ** np.array([[0.3], [1], [3], [6]]).repeat(50, 0),
    ]
)

# colour-science has Oklab's matrices as they were first published, for a slightly other white; the
# digits of the W3C's, after Ottosson, keep greys neutral.
FIRST_DIGITS = 1e-3

#: Display P3, BT.2020: SMPTE EG 432-1 and ITU-R BT.2020-2.
WIDE = {
    "display-p3": ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)),
    "rec2020": ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),
}
PRIMARIES = {"rec709": REC709.rgb, **WIDE}


@pytest.mark.parametrize("primaries", PRIMARIES)
class TestAgainstColourScience:
    """p = Y·(a, b)/L of the colour scaled to Y = 1, for colours of several primaries."""

    @pytest.fixture
    def colour(self):
        import colour

        return colour

    def of(self, colour, primaries, name):
        matrix = rgb_to_xyz(colour, PRIMARIES[primaries])
        rows = tuple(tuple(float(value) for value in row) for row in matrix)
        built = space(name) if primaries == "rec709" else space(name, rows)
        xyz = IN_GAMUT @ matrix.T
        luminance, p = built.forward(IN_GAMUT.T)
        assert_near(luminance, xyz[:, 1], 1e-14)
        assert_near(built.inverse(luminance, p), IN_GAMUT.T, ROUND_TRIP)
        return xyz[:, 1], xyz / xyz[:, 1:2], p

    def test_cielab(self, colour, primaries):
        luminance, at_one, p = self.of(colour, primaries, "cielab")
        lightness, a, b = colour.XYZ_to_Lab(at_one, np.array(D65)).T
        assert_near(lightness, np.full(len(lightness), 100.0), 1e-9)
        assert_near(p, luminance * [a, b] / lightness, 1e-13, 1 + np.abs(p))

    def test_oklab(self, colour, primaries):
        luminance, at_one, p = self.of(colour, primaries, "oklab")
        lightness, a, b = colour.XYZ_to_Oklab(at_one).T
        assert_near(p, luminance * [a, b] / lightness, FIRST_DIGITS)

    def test_linear_rgb_and_xyz(self, colour, primaries):
        luminance, at_one, p = self.of(colour, primaries, "xyz")
        white = colour.xy_to_XYZ(D65)
        assert_near(p, luminance * (at_one - white).T[[0, 2]], 1e-14)
        _, _, p = self.of(colour, primaries, "linear-rgb")
        assert_near(np.hypot(*p), np.linalg.norm(IN_GAMUT - luminance[:, None], axis=1), 1e-14)


@pytest.mark.parametrize("name", SPACES)
def test_a_space_is_built_once_for_each_primaries(name):
    assert space(name, REC709_TO_XYZ) is SPACES[name]
    other = tuple(tuple(row) for row in np.array(REC709_TO_XYZ)[:, [1, 0, 2]].tolist())
    assert space(name, other) is space(name, other) is not SPACES[name]
    # Red and green have changed places, and nothing else has.
    c = (0.2, 0.7, 0.1)
    (luminance,), ((p_1,), (p_2,)) = space(name, other).forward(np.array(c)[[1, 0, 2], None])
    assert_near(luminance, oracle.luminance(c), ROUNDING)
    assert_near(np.hypot(p_1, p_2), np.hypot(*forward(name, c)[1]), ROUND_TRIP)


@pytest.mark.parametrize("name", ["oklab", "cielab"])
class TestBeyondAllColours:
    """Y ≤ 0 gives p = 0, and |p| is bounded by Y."""

    @given(c=any_colors)
    def test_chroma_is_bounded_by_luminance(self, name, c):
        luminance, p = forward(name, c)
        most = SPACES[name].coefficients.largest
        assert np.hypot(*p) <= max(0, luminance) * most * (1 + ROUND_TRIP)

    @given(y=st.one_of(st.floats(-10, 0), st.floats(1e-6, 10)), p=st.tuples(*[st.floats(-100, 100)] * 2))
    def test_any_p_has_a_colour_of_its_luminance(self, name, y, p):
        c = inverse(name, y, p)
        assert_near(oracle.luminance(c), y, ROUND_TRIP, size(c))
        if y <= 0:
            assert_near(c, [y] * 3, 0)
        else:
            # Within the bound nothing is lost, beyond it p is as long as it may be.
            most = SPACES[name].coefficients.largest
            expected = oracle.no_longer_than(most, tuple(component / y for component in p))
            assert_near(np.divide(forward(name, c)[1], y), expected, 1e3 * ROUND_TRIP)

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_luminance_that_vanishes(self, name, dtype):
        # Towards, onto and beyond Y = 0, with channels of either sign.
        green = -(REC709_WEIGHTS[0] + REC709_WEIGHTS[2]) / REC709_WEIGHTS[1]
        steps = np.concatenate([-np.logspace(0, -40, 81), [0], np.logspace(-40, 0, 81)])
        rgb = np.stack([np.ones(163), green + steps, np.ones(163)]).astype(dtype)
        with np.errstate(all="ignore"):
            luminance, p = space(name).forward(rgb)
        assert np.isfinite(p).all()
        assert not p[:, luminance <= 0].any()
        largest = SPACES[name].coefficients.largest
        assert (np.hypot(*p) <= np.maximum(luminance, 0) * largest * (1 + 1e-5)).all()


def boundary_pairs(n):
    """Colours of the surface of the RGB cube, weighted as by `over`: two of (3, n), and the weights."""
    rng = np.random.default_rng(3)
    pair = rng.random((2, 3, n))
    np.put_along_axis(pair, rng.integers(0, 3, (2, 1, n)), rng.integers(0, 2, (2, 1, n)), axis=1)
    weight = rng.random(n)
    return pair[0] * weight, pair[1] * (1 - weight), weight


@pytest.mark.parametrize("name", oracle.OPEN)
class TestGamut:
    """What ⊕ takes out of gamut comes back in its hue, and no farther than needed."""

    def fitted(self, name):
        c1, c2, weight = boundary_pairs(20_000)
        blending_space = space(name)
        (y1, p1), (y2, p2) = (blending_space.forward(c) for c in (c1, c2))
        p = added((p1, p2), keep_hue(p1, p2, 2.0))
        bounds = bounds_of(blending_space, c1, weight) + bounds_of(blending_space, c2, 1 - weight)
        before = blending_space.inverse(y1 + y2, p)
        after = colors_within(blending_space, y1 + y2, p, c1 + c2, bounds)
        return y1 + y2, bounds, before, after

    def test_bounds_are_those_of_alpha(self, name):
        _, (lo, hi), _, _ = self.fitted(name)
        assert not lo.any()
        assert_near(hi, np.ones(len(hi)), ROUNDING)

    def test_result_is_within_and_only_what_was_not_has_moved(self, name):
        _, (lo, hi), before, after = self.fitted(name)
        outside = (before.min(axis=0) < lo) | (before.max(axis=0) > hi)
        assert 0 < outside.sum() < 0.1 * outside.size
        assert (after >= lo).all()
        assert (after <= hi).all()
        assert np.array_equal(after[:, ~outside], before[:, ~outside])
        touches = np.minimum(after.min(axis=0) - lo, hi - after.max(axis=0))[outside]
        assert_near(touches, np.zeros(outside.sum()), 10 * ROUNDING)

    def test_luminance_stays_and_the_hue_hardly_turns(self, name):
        luminance, _, before, after = self.fitted(name)
        assert_near(np.array(REC709_WEIGHTS) @ after, luminance, 10 * ROUNDING)
        p, q = (space(name).forward(c)[1] for c in (before, after))
        clear = np.hypot(*q) > 1e-6
        turn = np.degrees(np.arctan2(p[0] * q[1] - p[1] * q[0], (p * q).sum(axis=0)))
        assert np.abs(turn[clear]).max() <= space(name).gamut_turn + ANGLE_DEG

    def test_it_goes_no_farther_than_needed(self, name):
        luminance, (lo, hi), before, after = self.fitted(name)
        outside = (before.min(axis=0) < lo) | (before.max(axis=0) > hi)
        blending_space = space(name)
        (_, p), (_, q) = (blending_space.forward(c[:, outside]) for c in (before, after))
        t = np.hypot(*q) / np.hypot(*p)
        for further in (1e-3, 1e-2, 0.1):
            colors = blending_space.inverse(luminance[outside], (t + further * (1 - t)) * p)
            excess = np.maximum(colors.max(axis=0) - hi[outside], (lo[outside] - colors).max(axis=0))
            below, above = blending_space.gamut_slack
            assert (excess > -max(below, above) * luminance[outside] - ROUNDING).all()

    def test_what_is_negative_may_stay_so(self, name):
        rgb = np.array([[-0.5, 1.0, 0.2], [0.3, 2.0, 0.1]]).T
        blending_space = space(name)
        luminance, p = blending_space.forward(rgb)
        bounds = bounds_of(blending_space, rgb, np.array([0.5, 1.0]))
        assert_near(bounds, [[-0.5, 0.0], [1.0, 2.0]], 0)
        expected = blending_space.inverse(luminance, p)
        nothing = np.zeros_like(rgb)
        found = colors_within(blending_space, luminance, p, nothing, bounds)
        assert_near(found, expected, ROUND_TRIP)


@pytest.mark.parametrize("name", ["linear-rgb", "xyz"])
def test_linear_spaces_need_no_bounds(name):
    assert space(name).linear
    assert bounds_of(space(name), np.ones((3, 5))).shape == (0, 5)
