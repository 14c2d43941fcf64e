"""Strength: who wins need not be who is most saturated; the laws of ⊕ that stay, and those that go."""

import itertools
import math

import numpy as np
import oracle
import pytest
from engines import composite_by, layers_of_labels
from hypothesis import assume, given
from hypothesis import strategies as st
from steadiness import has_luminance, is_steady
from strategies import (
    ORDER_NAMES,
    SPACE_NAMES,
    STRENGTH_NAMES,
    color_of,
    hues,
    jobs,
    operators,
    rules_of,
    shares,
    stacks,
    valid_color,
)
from tolerances import FLOAT32, FLOAT64, HAS_HUE, assert_near

from hpcomp.color.primaries import PRIMARIES, to_xyz
from hpcomp.errors import SettingError

#: Those that are not the paper's.
OTHERS = tuple(oracle.STRENGTHS)
ORDERS = (*ORDER_NAMES, (2, 0, 4, 3, 1))
PRECISIONS = pytest.mark.parametrize(
    ("dtype", "tolerance"), [(np.float64, FLOAT64), (np.float32, FLOAT32)], ids=["double", "single"]
)

# Near grey `coverage` is 1/0.04 times as steep as the chroma of Oklab, whose roundings are those of cube
# roots of colours that may be negative. Worst of 300 pixels a case, in Oklab: 3e-5, also by chroma 2e-5.
SINGLE = 4 * FLOAT32


def size_of(layers, background=None):
    """What roundings are measured by: the light of all layers, and at least 1 for alpha."""
    colors = [layer[:3] for layer in layers] + ([] if background is None else [background])
    return 1 + sum(max(abs(float(component)) for component in c) for c in colors)


def chroma(c):
    return oracle.length(oracle.difference(tuple(float(component) for component in c[:3])))


def angle_deg(c1, c2):
    d1, d2 = (oracle.difference(tuple(float(x) for x in c[:3])) for c in (c1, c2))
    return math.degrees(oracle.angle(d1, d2))


def label(hue, saturation, luminance, alpha):
    """A premultiplied RGBA layer in gamut."""
    return np.array([*valid_color(hue, saturation, luminance, alpha), alpha])


def oklab_chroma(layer):
    """Of the straight colour."""
    return oracle.oklab_chroma(tuple(float(x) / float(layer[3]) for x in layer[:3]))


strengths = st.sampled_from(STRENGTH_NAMES)
spaces = st.sampled_from(SPACE_NAMES)
labels = st.builds(label, hues, st.floats(0.1, 1), st.floats(0.05, 0.95), st.floats(0.05, 1))


def drawn(job, strength, space):
    """What the oracle makes of a job, as a function of the layers."""
    rest = {name: value for name, value in job.items() if name != "layers"}
    return lambda layers: oracle.composite_in(space, layers, strength=strength, **rest)


def held(values, dtype):
    """What the type holds of them, as doubles: their rounding is no error of the engine.

    A background of 1e-44 has a strength of 1e-15, before which light without alpha, whose strength
    is 0, goes grey. Single precision has no hue of so little chroma; so little is not drawn.
    """
    least = np.finfo(dtype).tiny ** 0.5  # products of two are there, too
    return tuple(float(dtype(value)) if abs(value) > least else 0.0 for value in values)


class TestEngineIsTheOracle:
    @pytest.mark.parametrize("space", SPACE_NAMES)
    @given(data=st.data(), strength=strengths)
    def test_anything_double(self, composite, space, data, strength):
        job = data.draw(jobs(hdr=space not in oracle.OPEN))
        self.check(composite, job, strength, space, np.float64, FLOAT64)

    @pytest.mark.parametrize("space", SPACE_NAMES)
    @given(data=st.data(), strength=strengths)
    def test_anything_single(self, composite, space, data, strength):
        tolerances = st.sampled_from([2.0, 10.0])
        job = data.draw(jobs(tolerances, hdr=space not in oracle.OPEN))
        self.check(composite, job, strength, space, np.float32, FLOAT32)

    def check(self, composite, job, strength, space, dtype, tolerance):
        job["blending"] = "hue-preserving"
        job["hue_tolerance"] = job["hue_tolerance"] or 2.0  # the hard switch is tested elsewhere
        job["layers"] = [held(layer, dtype) for layer in job["layers"]]
        job["opacities"] = held(job["opacities"], dtype)
        job["background"] = job["background"] and held(job["background"], dtype)
        assume(space not in oracle.OPEN or has_luminance(job["layers"]))
        result_of = drawn(job, strength, space)
        allowed = tolerance * size_of(job["layers"], job["background"])
        assume(is_steady(result_of, job["layers"], dtype, allowed))
        layers = [np.array(layer, dtype) for layer in job["layers"]]
        actual = composite(layers, strength=strength, space=space, **rules_of(job))
        assert actual.dtype == dtype
        assert_near(actual, result_of(job["layers"]), allowed)

    @pytest.mark.pairwise
    @pytest.mark.parametrize(
        ("dtype", "tolerance"), [(np.float64, FLOAT64), (np.float32, SINGLE)], ids=["double", "single"]
    )
    @pytest.mark.parametrize("gray_bias", [0.0, 0.5])
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("space", SPACE_NAMES)
    @pytest.mark.parametrize("strength", OTHERS)
    def test_many_pixels(self, composite, strength, space, order, gray_bias, dtype, tolerance):
        layers = layers_of_labels(5, 1, 24, seed=4)[:, 0].astype(dtype)
        rules = {"order": order, "gray_bias": gray_bias, "background": (0.2, 0.05, 0.4)}
        actual = composite(list(layers), strength=strength, space=space, **rules)
        compared = 0
        for number, pixel in enumerate(layers.swapaxes(0, 1).tolist()):
            result_of = drawn(rules, strength, space)
            allowed = tolerance * size_of(pixel)
            if is_steady(result_of, pixel, dtype, allowed):
                compared += 1
                assert_near(actual[number], result_of([tuple(p) for p in pixel]), allowed)
        assert compared >= 20

    @pytest.mark.parametrize("strength", OTHERS)
    @pytest.mark.parametrize("hue_tolerance", [0.0, 0.5, 10.0])
    def test_other_tolerances(self, composite, strength, hue_tolerance):
        layers = layers_of_labels(4, 1, 60, seed=5)[:, 0].astype(np.float64)
        actual = composite(list(layers), strength=strength, hue_tolerance=hue_tolerance)
        compared = 0
        for number, pixel in enumerate(layers.swapaxes(0, 1).tolist()):
            result_of = drawn({"hue_tolerance": hue_tolerance}, strength, "linear-rgb")
            allowed = 10 * FLOAT64 * size_of(pixel)
            if is_steady(result_of, pixel, np.float64, allowed):
                compared += 1
                assert_near(actual[number], result_of([tuple(p) for p in pixel]), allowed)
        assert compared >= 50


class TestChroma:
    """The default is the paper's: the same bytes with the option and without."""

    @pytest.mark.pairwise
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("space", SPACE_NAMES)
    def test_same_bytes(self, composite, space, order, dtype):
        layers = list(layers_of_labels(5, 7, 31).astype(dtype))
        rules = {"space": space, "order": order, "background": (0.3, 0.3, 0.1), "gray_bias": 0.2}
        by_default = composite(layers, **rules)
        assert composite(layers, strength="chroma", **rules).tobytes() == by_default.tobytes()
        for strength in OTHERS:
            assert composite(layers, strength=strength, **rules).tobytes() != by_default.tobytes()

    @pytest.mark.parametrize("strength", OTHERS)
    @pytest.mark.parametrize("blending", ["traditional", "foremost"])
    def test_where_nothing_is_compared_strength_has_no_effect(self, composite, blending, strength):
        layers = list(layers_of_labels(4, 5, 31))
        expected = composite(layers, blending=blending)
        actual = composite(layers, blending=blending, strength=strength)
        assert actual.tobytes() == expected.tobytes()

    @pytest.mark.parametrize("strength", ["strong", "", "Chroma"])
    def test_an_unknown_name_is_an_error_that_lists_the_valid_ones(self, composite, strength):
        with pytest.raises(SettingError) as error:
            composite([np.zeros(4)], strength=strength)
        assert all(name in str(error.value) for name in STRENGTH_NAMES)
        assert "\n" not in str(error.value)

    @pytest.mark.parametrize("strength", [None, 1])
    def test_what_is_no_name_is_an_error(self, composite, strength):
        with pytest.raises(SettingError, match="strength"):
            composite([np.zeros(4)], strength=strength)


@pytest.mark.parametrize("strength", STRENGTH_NAMES)
class TestLaws:
    """What holds for every strength."""

    @given(data=st.data(), space=spaces, bias=st.sampled_from([0.0, 0.5]))
    def test_commutative(self, composite, strength, data, space, bias):
        pair = [np.array(layer) for layer in data.draw(stacks(min_size=2, max_size=2))]
        rules = {"op": "plus", "strength": strength, "space": space, "gray_bias": bias}
        for order in ("bottom-up", "simultaneous"):
            first, second = (composite(c, order=order, **rules) for c in (pair, pair[::-1]))
            assert_near(first, second, FLOAT64, size_of(pair))

    @given(data=st.data(), space=spaces)
    def test_simultaneous_is_permutation_invariant(self, composite, strength, data, space):
        layers = data.draw(stacks(min_size=2))
        shuffled = data.draw(st.permutations(layers))
        rules = {"op": "plus", "order": "simultaneous", "strength": strength, "space": space}
        job = {"ops": ["plus"] * len(layers), "order": "simultaneous"}
        allowed = FLOAT64 * size_of(layers)
        assume(is_steady(drawn(job, strength, space), layers, np.float64, allowed))
        first, second = (composite([np.array(c) for c in some], **rules) for some in (layers, shuffled))
        assert_near(first, second, allowed)

    @given(data=st.data(), space=spaces, bias=st.sampled_from([0.0, 0.5]))
    def test_simultaneous_of_two_is_plus_in_a_circle(self, composite, strength, data, space, bias):
        pair = [np.array(layer) for layer in data.draw(stacks(min_size=2, max_size=2))]
        rules = {"op": "plus", "strength": strength, "space": space, "gray_bias": bias}
        fold, at_once = (composite(pair, order=o, **rules) for o in ("bottom-up", "simultaneous"))
        assert_near(at_once, fold, FLOAT64, size_of(pair))

    @given(data=st.data(), space=spaces, order=st.sampled_from(ORDER_NAMES), k=st.floats(1e-3, 1))
    def test_homogeneous_in_the_weights(self, composite, strength, data, space, order, k):
        # With plus an opacity is a weight, of c and α alike.
        layers = data.draw(stacks(min_size=2))
        weights = [data.draw(st.floats(0.01, 1)) for _ in layers]
        ops = ["plus"] * len(layers)
        job = {"ops": ops, "order": order, "opacities": weights}
        allowed = FLOAT64 * size_of(layers)
        assume(is_steady(drawn(job, strength, space), layers, np.float64, allowed))
        rules = {"op": "plus", "order": order, "strength": strength, "space": space}
        arrays = [np.array(layer) for layer in layers]
        whole = composite(arrays, opacity=weights, **rules)
        less = composite(arrays, opacity=[k * weight for weight in weights], **rules)
        assert_near(less[:3], k * whole[:3], allowed)

    @PRECISIONS
    @given(data=st.data(), space=spaces, order=st.sampled_from(ORDER_NAMES))
    def test_luminance_is_exact_and_nothing_leaves_the_gamut(
        self, composite, strength, dtype, tolerance, data, space, order
    ):
        layers = data.draw(stacks(hdr=False))
        ops = [None, *(data.draw(operators) for _ in layers[1:])]
        background = data.draw(st.one_of(st.none(), st.tuples(shares, shares, shares)))
        arrays = [np.array(layer, dtype) for layer in layers]
        rules = {"op": ops, "background": background}
        plain = composite(arrays, blending="traditional", **rules)
        result = composite(arrays, strength=strength, space=space, order=order, **rules)
        assert_near(oracle.luminance(result), oracle.luminance(plain), tolerance, len(layers))
        assert_near(result[3], plain[3], tolerance)
        w, terms, _ = oracle.weighted_terms(layers, ops, background=background)
        most = sum(w_i * alpha for w_i, (_, alpha) in zip(w, terms, strict=True))
        assert result[:3].min() >= -tolerance
        assert result[:3].max() <= most + tolerance

    @pytest.mark.pairwise
    @pytest.mark.parametrize("order", ["bottom-up", "simultaneous"])
    @pytest.mark.parametrize("space", SPACE_NAMES)
    @pytest.mark.parametrize("n_layers", [2, 3])
    def test_continuous_along_random_paths(self, composite, strength, space, order, n_layers):
        # Straight ways from corner to corner of what is valid, through both shoulders and through
        # equal strengths; not through black or α = 0, where Oklab is infinitely steep.
        rng = np.random.default_rng([n_layers, 5])
        steps, ways = 20_000, 8
        alpha = rng.uniform(0.1, 1, (n_layers, ways + 1, 1))
        corners = np.concatenate([alpha * rng.uniform(0.05, 1, (n_layers, ways + 1, 3)), alpha], axis=-1)
        at = np.linspace(0, ways, steps + 1)
        layers = [
            np.stack([np.interp(at, np.arange(ways + 1), way[:, i]) for i in range(4)], axis=1)
            for way in corners
        ]
        result = composite(layers, op="plus", strength=strength, space=space, order=order)
        jumps = np.linalg.norm(np.diff(result, axis=0), axis=1)
        moved = sum(np.linalg.norm(np.diff(c, axis=0), axis=1) for c in layers)
        assert (jumps / moved).max() <= STEEPEST[order]
        # And the ways do pass the places where one hue takes over from the other.
        grey = np.array([chroma(c) for c in result[::50]])
        assert (grey < 0.02).any() or n_layers > 2

    @given(data=st.data())
    def test_equal_colours_add(self, composite, strength, data):
        layer = data.draw(labels)
        result = composite([layer, layer, layer], op="plus", strength=strength)
        assert_near(result[:3], 3 * layer[:3], FLOAT64, 3)

    @given(hue=hues, data=st.data())
    def test_one_hue_adds_whatever_its_strength(self, composite, strength, hue, data):
        layers = [
            label(hue, data.draw(st.floats(0.01, 1)), data.draw(st.floats(0.05, 0.95)), alpha)
            for alpha in data.draw(st.lists(st.floats(0.01, 1), min_size=2, max_size=4))
        ]
        for order in ORDER_NAMES:
            result = composite(layers, op="plus", strength=strength, order=order)
            assert_near(result[:3], np.sum(layers, axis=0)[:3], FLOAT64, len(layers))

    @PRECISIONS
    @given(data=st.data(), grey=st.floats(0, 1), order=st.sampled_from(ORDER_NAMES))
    def test_a_grey_never_wins(self, composite, strength, dtype, tolerance, data, grey, order):
        layer = data.draw(labels)
        greys = np.array([grey, grey, grey, 1.0])
        for layers in ([greys, layer], [layer, greys]):
            layers = [c.astype(dtype) for c in layers]
            result = composite(layers, op="plus", strength=strength, order=order)
            assert_near(result[:3], layers[0][:3] + layers[1][:3], tolerance, 2)

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    @pytest.mark.parametrize("order", ORDER_NAMES)
    def test_pixels_do_not_depend_on_their_array(self, composite, strength, order, dtype):
        layers = layers_of_labels(4, 1, 3000)[:, 0].astype(dtype)
        rules = {"order": order, "strength": strength, "space": "oklab", "background": (0.1, 0.3, 0.9)}
        whole = composite(list(layers), **rules)
        for ends in ([0, 1, 2, 1027, 3000], [0, 1500, 3000]):
            parts = [
                composite(list(layers[:, begin:end]), **rules)
                for begin, end in itertools.pairwise(ends)
            ]
            assert np.concatenate(parts).tobytes() == whole.tobytes()

    def test_strength_is_that_of_the_colour_in_any_primaries(self, composite, strength):
        # In XYZ, p is the same whatever the primaries; Oklab is a property of the colour too.
        layers = layers_of_labels(4, 1, 200, seed=9)[:, 0].astype(np.float64)
        layers = layers[:, np.all(layers[..., :3] <= 1, axis=(0, 2))]
        to_p3, from_p3 = (np.array(to_xyz(PRIMARIES[name])) for name in ("rec709", "display-p3"))
        matrix = np.linalg.solve(from_p3, to_p3)
        in_p3 = np.concatenate([layers[..., :3] @ matrix.T, layers[..., 3:]], axis=-1)
        rules = {"space": "xyz", "strength": strength}
        expected = composite(list(layers), **rules)
        actual = composite(list(in_p3), primaries="display-p3", **rules)
        expected = np.concatenate([expected[:, :3] @ matrix.T, expected[:, 3:]], axis=-1)
        # Greys are not exact once converted, and what rounding leaves of their p has a strength.
        error = np.abs(actual - expected).max(axis=-1)
        assert np.count_nonzero(error > 1e-9) <= 0.05 * len(error)


#: A step of the inputs is enlarged by no more: measured, and half as much again. Near grey the strengths
#: change fastest.
STEEPEST = {"bottom-up": 120, "simultaneous": 120}


#: Linear, after ColorBrewer's Set1: red, blue, green, purple, orange. Their Oklab chroma is from 0.11 to
#: 0.23, so that C/(C + 0.04) is from 0.74 to 0.85.
SET1 = ((0.77, 0.01, 0.01), (0.04, 0.21, 0.48), (0.07, 0.43, 0.07), (0.31, 0.08, 0.37), (1.0, 0.21, 0.0))


class TestWhoWins:
    @pytest.mark.parametrize("strength", OTHERS)
    @given(data=st.data())
    def test_the_stronger_one_does(self, composite, strength, data):
        first, second = data.draw(labels), data.draw(labels)
        assume(angle_deg(first, second) > 6)
        m = [oracle.strength_of(strength, tuple(c[:3]), c[3]) for c in (first, second)]
        assume(abs(m[0] - m[1]) > 1e-3 * max(m))
        winner, share = (first, m[1] / m[0]) if m[0] > m[1] else (second, m[0] / m[1])
        result = composite([first, second], op="plus", strength=strength)
        kept = oracle.scaled(1 - share, oracle.difference(tuple(winner[:3])))
        expected = oracle.color(oracle.luminance(first) + oracle.luminance(second), kept)
        assert_near(result[:3], expected, FLOAT64, 2)

    @pytest.mark.parametrize("order", ORDER_NAMES)
    @given(data=st.data())
    def test_by_coverage_who_covers_most(self, composite, order, data):
        colors = data.draw(st.lists(st.sampled_from(SET1), min_size=2, max_size=4, unique=True))
        most = data.draw(st.floats(0.5, 1))
        alphas = [most, *(most / 1.3 / len(colors) * data.draw(st.floats(0.1, 1)) for _ in colors[1:])]
        layers = [np.array([*oracle.scaled(alpha, c), alpha]) for c, alpha in zip(colors, alphas, strict=True)]
        result = composite(data.draw(st.permutations(layers)), op="plus", strength="coverage", order=order)
        assert chroma(result) > HAS_HUE
        assert angle_deg(result, layers[0]) < 1e-4

    def test_a_pale_cover_beats_a_saturated_trace_only_by_coverage(self, composite):
        pale = label(230, 0.5, 0.3, 0.7)
        trace = label(0, 1.0, 0.2, 0.5)
        results = {
            strength: composite([pale, trace], op="plus", strength=strength)
            for strength in STRENGTH_NAMES
        }
        assert chroma(trace) > chroma(pale)
        assert angle_deg(results["chroma"], trace) < 1e-4
        assert angle_deg(results["coverage"], pale) < 1e-4

    def test_dark_blue_and_bright_yellow(self, composite):
        # By |p| in linear RGB blue is far the weaker; to the eye it is not.
        blue = np.array([0.0, 0.0, 0.2, 1.0])
        yellow = np.array([0.9, 0.8, 0.5, 1.0])
        assert chroma(yellow) > chroma(blue)
        assert oklab_chroma(blue) > oklab_chroma(yellow)
        by_chroma, perceived = (
            composite([blue, yellow], op="plus", strength=name) for name in ("chroma", "perceived")
        )
        assert angle_deg(by_chroma, yellow) < 1e-4
        assert angle_deg(perceived, blue) < 1e-4

    @pytest.mark.parametrize("strength", OTHERS)
    @given(hue=hues, m=st.tuples(*[st.floats(0.05, 0.5)] * 2), y=st.tuples(*[st.floats(0.2, 2)] * 2))
    def test_opposite_hues_are_plus_only_by_chroma(self, composite, strength, hue, m, y):
        first, second = color_of(hue, m[0], y[0]), color_of(hue + 180, m[1], y[1])
        layers = [np.array([*c, 1.0]) for c in (first, second)]
        plain, by_chroma, other = (
            composite(layers, op="plus", **rules)
            for rules in ({"blending": "traditional"}, {"strength": "chroma"}, {"strength": strength})
        )
        assert_near(by_chroma, plain, FLOAT64, size_of(layers))
        # The hue may be the other one, or its length another; equal where the strengths of both are
        # to each other as their chromas.
        ratios = [
            oracle.strength_of(strength, c, 1.0) / chroma
            for c, chroma in ((first, m[0]), (second, m[1]))
        ]
        assume(abs(ratios[0] / ratios[1] - 1) > 0.01)
        assume(abs(m[0] - m[1]) > 0.01)
        assert np.abs(other - plain).max() > 1e-6


@pytest.mark.parametrize("strength", OTHERS)
class TestGlow:
    """Light at α = 0 covers nothing: it has no strength, and its light stays."""

    GLOW = np.array([4.0, 0.5, 0.1, 0.0])

    @pytest.mark.parametrize("order", ORDER_NAMES)
    @given(data=st.data())
    def test_any_label_wins_beside_it(self, composite, strength, order, data):
        layer = data.draw(labels)
        assume(angle_deg(layer, self.GLOW) > 6)
        y = oracle.luminance(layer) + oracle.luminance(self.GLOW)
        expected = oracle.color(y, oracle.difference(tuple(layer[:3])))
        for layers in ([layer, self.GLOW], [self.GLOW, layer]):
            result = composite(layers, op="plus", strength=strength, order=order)
            assert_near(result[:3], expected, FLOAT64, size_of(layers))

    @pytest.mark.parametrize("order", ORDER_NAMES)
    @given(data=st.data(), space=spaces)
    def test_alone_p_decides(self, composite, strength, order, data, space):
        layers = [np.array([*c[:3], 0.0]) for c in data.draw(stacks(min_size=2, max_size=2))]
        rules = {"op": "plus", "order": order, "space": space}
        by_chroma = composite(layers, **rules)
        assert_near(composite(layers, strength=strength, **rules), by_chroma, FLOAT64, size_of(layers))

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_over_everything_is_finite(self, composite, strength, dtype):
        layers = layers_of_labels(4, 3, 300, seed=3).astype(dtype)
        tiny = np.finfo(dtype).smallest_subnormal
        layers[1, ..., 3] = np.where(layers[1, ..., 3] > 0.5, tiny, layers[1, ..., 3])
        for order in ORDER_NAMES:
            assert np.isfinite(composite(list(layers), strength=strength, order=order)).all()


@pytest.mark.parametrize("strength", OTHERS)
@pytest.mark.parametrize("order", ["bottom-up", "balanced", "simultaneous"])
def test_a_chroma_that_overflows_is_added_as_it_is(order, strength):
    """Its strength is still a number. Both engines keep all where what meets is not finite."""
    colors = [(3e38, 0, 0, 1), (3e38, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)]
    layers = [np.array([[color]], np.float32) for color in colors]
    kernel, reference, plain = (
        composite_by(name, layers, op="plus", order=order, strength=strength, **more)
        for name, more in (("kernel", {}), ("reference", {}), ("reference", {"blending": "traditional"}))
    )
    assert not np.isfinite(plain).all()
    np.testing.assert_allclose(kernel, reference, rtol=4 * FLOAT32)
    if order == "bottom-up":  # all others meet the sum that overflowed
        assert np.array_equal(kernel, plain)
        assert np.array_equal(reference, plain)
