"""Woven blending: each pixel has the hue of one term, the pattern says which, and the mean is the sum."""

import itertools
import math
from pathlib import Path

import numpy as np
import oracle
import pytest
from engines import composite_by, layers_of_labels
from hypothesis import assume, given
from hypothesis import strategies as st
from steadiness import has_luminance
from strategies import (
    OPERATOR_NAMES,
    ORDER_NAMES,
    SPACE_NAMES,
    STRENGTH_NAMES,
    WEAVE_NAMES,
    color_of,
    operators,
    shares,
    stacks,
    valid_color,
)
from tolerances import FLOAT32, FLOAT64, assert_near

import hpcomp
from hpcomp.color.spaces import SPACES
from hpcomp.errors import SettingError

TILE = np.load(Path(hpcomp.__file__).parent / "blending" / "bluenoise.npy").astype(int).tolist()
#: How far u has to be from the next boundary: single precision adds the strengths.
MARGIN = 1e-5
#: How far from the bound G a space may end. Where curves of one hue touch the gamut's edges, at pure
#: primaries in CIELAB, the largest t is known by its square root. Worst of 12,000 pixels: 1.2e-4, 3e-13.
AT_EDGES = {"cielab": 2e-4, "oklab": 1e-8}
PRECISIONS = pytest.mark.parametrize(
    ("dtype", "tolerance"), [(np.float64, FLOAT64), (np.float32, FLOAT32)], ids=["double", "single"]
)
by_strength = pytest.mark.parametrize("strength", STRENGTH_NAMES)
by_space = pytest.mark.parametrize("space", SPACE_NAMES)
by_weave = pytest.mark.parametrize("weave", WEAVE_NAMES)


def phase(weave, x, y, size):
    """u of a pixel, in single precision."""
    u = oracle.stripes(x, y, size) if weave == "stripes" else oracle.noise(x, y, size, TILE)
    return float(np.float32(u))


def canvas(layers, height, width, dtype=np.float64):
    """The same colours at every pixel: a list of (height, width, 4)."""
    return [np.tile(np.array(layer, dtype), (height, width, 1)) for layer in layers]


def woven(composite, layers, **rules):
    return composite(layers, blending="woven", **rules)


def label(hue, saturation, luminance, alpha=1.0):
    """A premultiplied RGBA layer in gamut."""
    return (*valid_color(hue, saturation, luminance, alpha), alpha)


def chroma(c):
    return oracle.length(oracle.difference(tuple(float(component) for component in c[:3])))


#: Pale enough for their sum to have a place in any hue, each its own share.
PALE = [(*color_of(hue, m, 0.3), 1.0) for hue, m in ((10, 0.05), (130, 0.03), (250, 0.02))]
PALE_CHROMA = [chroma(layer) for layer in PALE]
VIVID = [label(hue, 1.0, y, alpha) for hue, y, alpha in ((20, 0.3, 0.4), (150, 0.5, 0.9), (260, 0.1, 0.6))]


def luminances(result):
    return result[..., :3] @ np.array(oracle.WEIGHTS)


def hue_numbers(result, layers):
    """(…): which layer's hue each pixel of linear RGB has, by the smallest angle."""
    directions = np.array([oracle.unit(oracle.difference(layer[:3])) for layer in layers])
    d = result[..., :3] - luminances(result)[..., None]
    return np.argmax(d @ directions.T, axis=-1)


def size_of(layers, background=None):
    """(height, width): what roundings are measured by."""
    light = 1 + sum(np.abs(layer).max(axis=-1) for layer in layers)
    return light if background is None else light + max(background)


def assert_agrees(composite, layers, dtype, tolerance, *, space="linear-rgb", **rules):
    """An engine is the oracle wherever no rounding decides on hues.

    The share of pixels that were compared, and the share of these that agree without `AT_EDGES`.
    """
    rules = {"weave": "stripes", "weave_size": 8, "origin": (0, 0), "strength": "chroma", **rules}
    layers = [layer.astype(dtype) for layer in layers]
    actual = woven(composite, layers, space=space, **rules)
    assert actual.dtype == dtype
    height, width = layers[0].shape[:2]
    sizes = size_of(layers, rules.get("background"))
    left, top = rules["origin"]
    compared, strictly = 0, 0
    for y, x in itertools.product(range(height), range(width)):
        expected = oracle.woven(
            space,
            [tuple(layer[y, x].tolist()) for layer in layers],
            phase(rules["weave"], left + x, top + y, rules["weave_size"]),
            rules.get("op"),
            rules.get("opacity"),
            rules.get("background"),
            rules["strength"],
        )
        if expected.margin > MARGIN:
            compared += 1
            allowed = tolerance * (sizes[y, x] + chroma(expected.rgba) * expected.gain)
            strictly += np.abs(actual[y, x] - expected.rgba).max() <= allowed
            assert_near(actual[y, x], expected.rgba, allowed + AT_EDGES.get(space, 0) * sizes[y, x])
    return compared / (height * width), strictly / max(1, compared)


class TestEngineIsTheOracle:
    LAYERS = layers_of_labels(4, 9, 14, seed=16).astype(np.float64)
    #: Near greys, equal hues in the last digits, hues at the cut of the angle: those are not compared.
    LEAST = 0.8
    #: Of what is compared so much agrees to the last roundings.
    STRICTLY = 0.95

    @pytest.mark.pairwise
    @PRECISIONS
    @pytest.mark.parametrize(
        ("weave", "weave_size", "origin"),
        [
            ("stripes", 8, (0, 0)),
            ("stripes", 2, (-13, 5)),
            ("stripes", 3, (10**6, 77)),
            ("stripes", 1024, (1020, -6)),
            ("noise", 8, (0, 0)),
            ("noise", 2, (-250, -3)),
            ("noise", 3, (10**6, 77)),
            ("noise", 1024, (1020, -6)),
        ],
    )
    @by_strength
    @by_space
    def test_patterns(
        self, composite, space, strength, weave, weave_size, origin, dtype, tolerance
    ):
        compared, strictly = assert_agrees(
            composite,
            self.LAYERS,
            dtype,
            tolerance,
            space=space,
            strength=strength,
            weave=weave,
            weave_size=weave_size,
            origin=origin,
        )
        assert compared > self.LEAST
        assert strictly > self.STRICTLY

    @pytest.mark.pairwise
    @PRECISIONS
    @pytest.mark.parametrize("background", [None, (0.1, 0.4, 0.2), (0.5, 0.5, 0.5)])
    @pytest.mark.parametrize("op", OPERATOR_NAMES)
    @by_space
    def test_operators_opacities_and_backgrounds(
        self, composite, space, op, background, dtype, tolerance
    ):
        compared, strictly = assert_agrees(
            composite,
            self.LAYERS,
            dtype,
            tolerance,
            space=space,
            op=[None, op, "over", op],
            opacity=[1.0, 0.5, 0.25, 0.8],
            background=background,
            strength="perceived",
        )
        assert compared > self.LEAST
        assert strictly > self.STRICTLY

    @by_space
    @given(data=st.data(), strength=st.sampled_from(STRENGTH_NAMES))
    def test_any_stack(self, composite, space, data, strength):
        layers = data.draw(stacks())
        assume(space not in oracle.OPEN or has_luminance(layers))
        rules = {
            "op": [None, *(data.draw(operators) for _ in layers[1:])],
            "background": data.draw(st.one_of(st.none(), st.tuples(shares, shares, shares))),
            "origin": data.draw(st.tuples(*[st.integers(-3000, 3000)] * 2)),
            "weave": data.draw(st.sampled_from(WEAVE_NAMES)),
            "weave_size": data.draw(st.integers(2, 1024)),
        }
        arrays = canvas(layers, 2, 3)
        assert_agrees(composite, arrays, np.float64, FLOAT64, space=space, strength=strength, **rules)


class TestEveryPixel:
    @pytest.mark.pairwise
    @by_strength
    @by_space
    @by_weave
    @PRECISIONS
    def test_luminance_and_alpha_are_those_of_plus(
        self, composite, space, strength, weave, dtype, tolerance
    ):
        layers = list(layers_of_labels(5, 16, 20).astype(dtype))
        rules = {"space": space, "strength": strength, "weave": weave, "background": (0.1, 0.5, 0.9)}
        result = woven(composite, layers, **rules)
        plain = composite(layers, blending="traditional", background=rules["background"])
        assert_near(luminances(result), luminances(plain), tolerance, size_of(layers))
        assert_near(result[..., 3], plain[..., 3], tolerance)

    @pytest.mark.pairwise
    @by_strength
    @by_space
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_nothing_leaves_the_gamut(self, composite, space, strength, dtype):
        layers = layers_of_labels(5, 16, 20).astype(dtype)
        # What is valid: no HDR, no negative colour, no glow.
        layers[..., :3] = np.clip(layers[..., :3], 0, layers[..., 3:])
        result = woven(composite, list(layers), strength=strength, space=space)
        room = FLOAT64 if dtype == np.float64 else FLOAT32
        assert result[..., :3].min() >= -room
        # `over`: the weights times α add to α.
        assert (result[..., :3] <= result[..., 3:] + room).all()

    @by_strength
    @by_space
    @by_weave
    def test_the_hue_is_an_inputs(self, composite, space, strength, weave):
        layers = canvas(VIVID, 12, 12)
        rules = {"space": space, "strength": strength, "weave": weave, "weave_size": 2}
        result = woven(composite, layers, op="plus", **rules)
        inputs = [oracle.weaving_chroma(space, layer[:3]) for layer in VIVID]
        found = set()
        for pixel in result.reshape(-1, 4).tolist():
            p = oracle.weaving_chroma(space, pixel[:3])
            angles = [math.degrees(oracle.plane_angle(p, own)) for own in inputs]
            assert min(angles) < 1e-5 + SPACES[space].gamut_turn
            found.add(int(np.argmin(angles)))
        assert found == {0, 1, 2}

    @pytest.mark.pairwise
    @by_strength
    @pytest.mark.parametrize("space", ["linear-rgb", "xyz", "hsl"])
    @PRECISIONS
    def test_one_hue_is_plus(self, composite, space, strength, dtype, tolerance):
        # Shadings of one hue, greys, and nothing: by any strength what ⊕ makes of equal hues.
        layers = [
            label(200, 1.0, 0.1, 0.5),
            (0.3, 0.3, 0.3, 0.3),
            label(200, 0.3, 0.7, 0.8),
            (0.0, 0.0, 0.0, 0.0),
            label(200, 0.7, 0.4, 0.2),
        ]
        arrays = canvas(layers, 9, 9, dtype)
        rules = {"op": "plus", "space": space}
        expected = composite(arrays, **rules)
        assert_near(woven(composite, arrays, strength=strength, **rules), expected, tolerance, 3)
        if space != "hsl":  # whose p does not add as colours do
            plain = composite(arrays, op="plus", blending="traditional")
            assert_near(expected, plain, tolerance, 3)

    @pytest.mark.pairwise
    @by_strength
    @by_space
    @PRECISIONS
    def test_one_colour_in_several_strengths_is_plus(
        self, composite, space, strength, dtype, tolerance
    ):
        c = np.array(valid_color(300, 0.8, 0.4))
        layers = [np.array([*(k * c), alpha]) for k, alpha in ((0.3, 1), (0.4, 0.4), (0.01, 0.5), (0.05, 1))]
        arrays = canvas(layers, 9, 9, dtype)
        expected = composite(arrays, blending="traditional")
        actual = woven(composite, arrays, space=space, strength=strength)
        assert_near(actual, expected, tolerance, 2)

    @by_strength
    def test_glow_of_the_labels_own_hue_is_no_other_hue(self, composite, strength):
        glow, own = color_of(200, 0.2, 0.4), label(200, 0.9, 0.4, 0.5)
        layers = canvas([own, (*glow, 0.0)], 4, 4)
        plain = composite(layers, op="plus", blending="traditional")
        assert_near(woven(composite, layers, op="plus", strength=strength), plain, FLOAT64, 2)

    @pytest.mark.parametrize("strength", ["perceived", "coverage"])
    def test_glow_of_another_hue_has_no_thread(self, composite, strength):
        glow, own = color_of(80, 0.2, 0.4), label(200, 0.9, 0.4, 0.5)
        layers = canvas([own, (*glow, 0.0)], 12, 12)
        result = woven(composite, layers, op="plus", strength=strength)
        y = oracle.luminance(glow) + oracle.luminance(own)
        expected = oracle.color(y, oracle.difference(own[:3]))
        assert_near(result[..., :3], np.tile(expected, (12, 12, 1)), FLOAT64, 2)

    @by_strength
    def test_glows_alone_weave_by_p(self, composite, strength):
        layers = canvas([(*layer[:3], 0.0) for layer in VIVID], 12, 12)
        expected = woven(composite, layers, op="plus")
        assert_near(woven(composite, layers, op="plus", strength=strength), expected, FLOAT64, 2)

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    @by_space
    def test_greys_stay_grey_and_nothing_stays_nothing(self, composite, space, dtype):
        greys = canvas([(0.25, 0.25, 0.25, 0.5), (0.1, 0.1, 0.1, 0.7)], 5, 5, dtype)
        result = woven(composite, greys, space=space)
        assert np.ptp(result[..., :3], axis=-1).max() == 0
        nothing = canvas([(0, 0, 0, 0)] * 2, 5, 5, dtype)
        assert not woven(composite, nothing, space=space).any()

    @by_space
    def test_a_colour_that_is_alone_comes_out_as_it_went_in(self, composite, space):
        layers = canvas([(0, 0, 0, 0), (0.2, 0.1, 0.4, 0.5), (0, 0, 0, 0)], 5, 5, np.float32)
        assert np.array_equal(woven(composite, layers, space=space), layers[1])


class TestLaws:
    @pytest.mark.pairwise
    @by_strength
    @by_space
    def test_permutation_invariant(self, composite, space, strength):
        layers = list(layers_of_labels(4, 8, 20, seed=2).astype(np.float64))
        rules = {"op": "plus", "space": space, "strength": strength}
        expected = woven(composite, layers, **rules)
        for permutation in ((3, 2, 1, 0), (1, 3, 0, 2)):
            result = woven(composite, [layers[number] for number in permutation], **rules)
            error = np.abs(result - expected).max(axis=-1) / size_of(layers)
            # Rounding decides where a hue lies on the cut of the angle, or in p that is rounding.
            assert np.count_nonzero(error > FLOAT64) <= 0.02 * error.size

    @pytest.mark.pairwise
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    @by_weave
    @by_space
    def test_neither_order_nor_tolerance_nor_bias_has_an_effect(self, composite, space, weave, dtype):
        layers = list(layers_of_labels(4, 8, 20).astype(dtype))
        rules = {"space": space, "weave": weave, "background": (0.9, 0.2, 0.1)}
        expected = woven(composite, layers, **rules)
        others = (
            *({"order": order} for order in (*ORDER_NAMES, "2,0,3,1")),
            {"hue_tolerance": 10.0},
            {"hue_tolerance": 0.0},
            {"gray_bias": 0.7},
        )
        for other in others:
            assert woven(composite, layers, **rules, **other).tobytes() == expected.tobytes(), other

    @pytest.mark.pairwise
    @by_strength
    @by_space
    @PRECISIONS
    def test_homogeneous_in_the_weights(self, composite, space, strength, dtype, tolerance):
        layers = canvas(VIVID, 9, 9, dtype)
        rules = {"op": "plus", "space": space, "strength": strength}
        whole = woven(composite, layers, opacity=[1.0, 0.5, 0.25], **rules)
        less = woven(composite, layers, opacity=[0.125, 0.0625, 0.03125], **rules)
        assert_near(8 * less[..., :3], whole[..., :3], tolerance, 3)

    @by_space
    def test_exposure_scales_the_result(self, composite, space):
        layers = canvas(VIVID, 9, 9)
        expected = woven(composite, layers, space=space)
        exposed = woven(composite, layers, space=space, exposure=1.0)
        assert_near(exposed[..., :3], 2 * expected[..., :3], FLOAT64, 3)

    def test_it_is_none_of_the_others(self, composite):
        layers = canvas(VIVID, 9, 9)
        result = woven(composite, layers)
        for blending in ("hue-preserving", "traditional", "foremost"):
            assert np.abs(result - composite(layers, blending=blending)).max() > 1e-3

    @pytest.mark.pairwise
    @by_space
    @by_weave
    @by_strength
    def test_both_engines_agree_on_pure_colours(self, space, weave, strength):
        # Primaries and secondaries, of which some lie on the cut of the hue's angle.
        pure = [c for c in itertools.product((0.0, 0.5), repeat=3) if len(set(c)) > 1]
        differing = 0
        for colors in itertools.combinations(pure, 2):
            layers = canvas([(*c, 0.5) for c in colors], 16, 16, np.float32)
            results = [
                woven_by(name, layers, op="plus", space=space, weave=weave, strength=strength)
                for name in ("kernel", "reference")
            ]
            error = np.abs(results[0] - results[1]).max(axis=-1)
            differing += np.count_nonzero(error > FLOAT32 + AT_EDGES.get(space, 0))
        assert differing == 0


def woven_by(name, layers, **rules):
    return composite_by(name, layers, blending="woven", **rules)


class TestFromAfar:
    """Over many periods of constant terms the mean of p tends to the sum of p, where no bound shortens it."""

    SUM = sum(np.array(oracle.difference(layer[:3])) for layer in PALE)

    def mean_of_p(self, result):
        return (result[..., :3] - luminances(result)[..., None]).reshape(-1, 3).mean(axis=0)

    def shares_by(self, strength):
        if strength == "chroma":
            m = np.array(PALE_CHROMA)
        else:
            m = np.array([oracle.strength_of(strength, layer[:3], layer[3]) for layer in PALE])
        return m / m.sum()

    @pytest.mark.parametrize("weave_size", [2, 8, 13])
    @by_strength
    def test_of_stripes(self, composite, strength, weave_size):
        layers = canvas(PALE, 1, 2000 * weave_size)
        result = woven(composite, layers, op="plus", strength=strength, weave_size=weave_size)
        assert_near(self.mean_of_p(result), self.SUM, 1e-3, sum(PALE_CHROMA))
        counts = np.bincount(hue_numbers(result, PALE).ravel(), minlength=3)
        assert_near(counts / counts.sum(), self.shares_by(strength), 1e-3)

    @pytest.mark.parametrize("weave_size", [2, 3])
    @by_strength
    def test_of_noise_over_one_tile(self, composite, strength, weave_size):
        side = len(TILE) * weave_size
        layers = canvas(PALE, side, side, np.float32)
        result = woven(
            composite, layers, op="plus", strength=strength, weave="noise", weave_size=weave_size
        )
        counts = np.bincount(hue_numbers(result, PALE).ravel(), minlength=3)
        # Each share to one rank of the tile.
        ranks = len(TILE) ** 2
        assert_near(counts / counts.sum(), self.shares_by(strength), 1.01 / ranks)
        assert_near(self.mean_of_p(result), self.SUM, 1e-3, sum(PALE_CHROMA))

    @pytest.mark.parametrize("weave_size", [2, 8])
    def test_shares_below_one_pixel_of_a_stripe_appear_in_some(self, composite, weave_size):
        share = 1 / (5 * weave_size)
        layers = [(*color_of(10, 0.08 * (1 - share), 0.3), 1.0), (*color_of(200, 0.08 * share, 0.3), 1.0)]
        n_stripes = 400
        arrays = canvas(layers, 1, n_stripes * weave_size)
        numbers = hue_numbers(woven(composite, arrays, op="plus", weave_size=weave_size), layers)
        in_stripe = numbers.reshape(n_stripes, weave_size).sum(axis=1)
        assert set(in_stripe.tolist()) == {0, 1}
        assert in_stripe.sum() == pytest.approx(n_stripes / 5, rel=0.05)
        # And never long without: the golden ratio spreads them.
        gaps = np.diff(np.flatnonzero(in_stripe))
        assert gaps.max() <= 8

    @by_strength
    def test_a_thread_is_as_long_as_the_bound_lets_it_be(self, composite, strength):
        # Dark and vivid: the sum of all p has no place at that luminance in every hue.
        layers = [label(0, 1.0, 0.1), label(120, 1.0, 0.1), label(240, 1.0, 0.05)]
        result = woven(composite, canvas(layers, 9, 9), op="plus", strength=strength)
        numbers, bounded = hue_numbers(result, layers), 0
        m = [chroma(c) if strength == "chroma" else oracle.strength_of(strength, c[:3], 1.0) for c in layers]
        for number, layer in enumerate(layers):
            direction = oracle.unit(oracle.difference(layer[:3]))
            bound = 0.25 / -min(direction)  # Y = 0.25; no channel reaches hi = 3
            wanted = chroma(layer) * sum(m) / m[number]
            bounded += wanted > bound
            pixels = result[numbers == number]
            assert len(pixels)
            assert_near([chroma(c) for c in pixels], [min(wanted, bound)] * len(pixels), FLOAT64)
        assert bounded


class TestPattern:
    """Which thread a pixel has depends on its place on the canvas alone."""

    @by_weave
    @pytest.mark.parametrize("weave_size", [2, 5, 8])
    def test_by_default_the_first_pixel_is_the_corner(self, composite, weave, weave_size):
        layers = canvas(PALE, 20, 30)
        rules = {"op": "plus", "weave": weave, "weave_size": weave_size}
        numbers = hue_numbers(woven(composite, layers, **rules), PALE)
        u = np.array([[phase(weave, x, y, weave_size) for x in range(30)] for y in range(20)])
        # Sorted by the angle of p from that of red, cut at its opposite: 250° is −110°.
        order = np.array([2, 0, 1])
        m = np.array(PALE_CHROMA)[order]
        edges = np.cumsum(m / m.sum())
        assert np.array_equal(numbers, order[np.searchsorted(edges, u, side="right").clip(0, 2)])

    def test_stripes_run_along_diagonals(self, composite):
        result = woven(composite, canvas(PALE, 30, 30), op="plus")
        assert np.array_equal(result[1:, :-1], result[:-1, 1:])
        assert np.abs(result[0, 1:] - result[0, :-1]).max() > 1e-3

    @pytest.mark.parametrize("weave_size", [2, 5])
    def test_noise_has_square_cells(self, composite, weave_size):
        n = 12
        layers = canvas(PALE, n * weave_size, n * weave_size)
        result = woven(composite, layers, op="plus", weave="noise", weave_size=weave_size)
        cells = result[::weave_size, ::weave_size]
        assert np.array_equal(result, cells.repeat(weave_size, 0).repeat(weave_size, 1))
        assert len(np.unique(hue_numbers(cells, PALE))) == 3

    def test_size_and_weave_default_to_stripes_of_eight(self, composite):
        layers = canvas(PALE, 20, 30)
        expected = woven(composite, layers, op="plus", weave="stripes", weave_size=8, origin=(0, 0))
        assert woven(composite, layers, op="plus").tobytes() == expected.tobytes()
        for other in ({"weave": "noise"}, {"weave_size": 4}, {"origin": (1, 0)}):
            assert woven(composite, layers, op="plus", **other).tobytes() != expected.tobytes()

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    @pytest.mark.parametrize("origin", [(0, 0), (-37, -5), (12345, 678)])
    @pytest.mark.parametrize("weave_size", [3, 8, 1024])
    @by_weave
    def test_parts_are_those_of_the_whole(self, composite, weave, weave_size, origin, dtype):
        height, width = 33, 47
        layers = layers_of_labels(4, height, width).astype(dtype)
        rules = {"weave": weave, "weave_size": weave_size, "strength": "coverage", "space": "oklab"}
        left, top = origin
        whole = woven(composite, list(layers), origin=origin, **rules)
        strips = [(0, y, width, min(y + 7, height)) for y in range(0, height, 7)]
        regions = [(5, 3, 6, 4), (1, 1, 40, 30), (20, 0, 47, 33), (0, 17, 23, 18)]
        for x_0, y_0, x_1, y_1 in (*strips, *regions):
            part = [layer[y_0:y_1, x_0:x_1] for layer in layers]
            result = woven(composite, part, origin=(left + x_0, top + y_0), **rules)
            assert result.tobytes() == whole[y_0:y_1, x_0:x_1].tobytes()

    @by_weave
    def test_an_array_without_rows_is_one_row(self, composite, weave):
        layers = layers_of_labels(4, 1, 300)
        rules = {"weave": weave, "origin": (4, 9)}
        image = woven(composite, list(layers), **rules)
        row = woven(composite, list(layers[:, 0]), **rules)
        assert row.shape == (300, 4)
        assert row.tobytes() == image.tobytes()
        pixel = woven(composite, list(layers[:, 0, 0]), **rules)
        assert pixel.tobytes() == row[0].tobytes()

    @by_weave
    def test_of_many_images_each_has_the_pattern_from_its_corner(self, composite, weave):
        layers = layers_of_labels(4, 6 * 11, 17).reshape(4, 2, 3, 11, 17, 4)
        rules = {"weave": weave, "origin": (-3, 8)}
        together = woven(composite, list(layers), **rules)
        assert together.shape == layers.shape[1:]
        for number in itertools.product(range(2), range(3)):
            alone = woven(composite, [layer[number] for layer in layers], **rules)
            assert together[number].tobytes() == alone.tobytes()

    @by_weave
    def test_of_more_pixels_than_are_composited_at_once(self, composite, weave):
        height, width = 260, 301
        layers = canvas(PALE, height, width, np.float32)
        whole = woven(composite, layers, op="plus", weave=weave)
        for y in (0, 108, 109, 217, 259):
            row = woven(composite, [c[y : y + 1] for c in layers], op="plus", weave=weave, origin=(0, y))
            assert row.tobytes() == whole[y : y + 1].tobytes()

    def test_noise_repeats_after_its_tile_and_stripes_do_not(self, composite):
        layers = canvas(PALE, 4, 40)
        side = 8 * len(TILE)
        results = {
            (weave, x): woven(composite, layers, op="plus", weave=weave, origin=(x, 2 * x)).tobytes()
            for weave in WEAVE_NAMES
            for x in (0, side, -3 * side)
        }
        assert len({value for (weave, _), value in results.items() if weave == "noise"}) == 1
        assert len({value for (weave, _), value in results.items() if weave == "stripes"}) == 3

    def test_other_blendings_know_no_pattern(self, composite):
        layers = canvas(VIVID, 6, 9)
        expected = composite(layers)
        actual = composite(layers, weave="noise", weave_size=3, origin=(5, -2))
        assert actual.tobytes() == expected.tobytes()


class TestArguments:
    LAYERS = canvas(VIVID, 2, 2)

    @pytest.mark.parametrize("weave_size", [1, 1025, 0, -8, 2.5, math.nan])
    def test_a_size_out_of_range_is_an_error(self, composite, weave_size):
        with pytest.raises(SettingError) as error:
            woven(composite, self.LAYERS, weave_size=weave_size)
        assert "\n" not in str(error.value)
        assert "1024" in str(error.value)

    @pytest.mark.parametrize("weave_size", ["eight", None])
    def test_what_is_no_number_is_an_error(self, composite, weave_size):
        with pytest.raises(SettingError, match="weave"):
            woven(composite, self.LAYERS, weave_size=weave_size)

    @pytest.mark.parametrize("weave_size", [2, 1024, np.int64(8), np.uint8(8)])
    def test_whole_numbers_of_any_kind_are_sizes(self, composite, weave_size):
        expected = woven(composite, self.LAYERS, weave_size=int(weave_size))
        assert np.array_equal(woven(composite, self.LAYERS, weave_size=weave_size), expected)

    @pytest.mark.parametrize("weave", ["plaid", "", "Stripes"])
    def test_an_unknown_weave_is_an_error_that_lists_the_valid_ones(self, composite, weave):
        with pytest.raises(SettingError) as error:
            woven(composite, self.LAYERS, weave=weave)
        assert all(name in str(error.value) for name in WEAVE_NAMES)

    @pytest.mark.parametrize("weave", [None, 8])
    def test_what_is_no_name_is_an_error(self, composite, weave):
        with pytest.raises(SettingError, match="weave"):
            woven(composite, self.LAYERS, weave=weave)

    @pytest.mark.parametrize("origin", [(1,), (1, 2, 3), (0.5, 0), ("a", "b"), 3, None])
    def test_an_origin_is_two_whole_numbers(self, composite, origin):
        with pytest.raises(SettingError):
            woven(composite, self.LAYERS, origin=origin)
