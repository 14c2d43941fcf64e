"""Samples along viewing rays: sorting, splitting and merging, held against a literal second opinion."""

import itertools
import math
from functools import partial

import deeporacle
import numpy as np
import oracle
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import BLENDING_NAMES, ORDER_NAMES, STRENGTH_NAMES, WEAVE_NAMES, valid_color

from hpcomp.blending import deepsamples
from hpcomp.blending.deepsamples import DeepSamples
from hpcomp.color.primaries import REC709
from hpcomp.color.quantization import Losses
from hpcomp.color.spaces import SPACES
from hpcomp.engine import choice as engine
from hpcomp.engine.deepcompositing import flat
from hpcomp.geometry import Window
from hpcomp.options import stack_rules

#: Of a few additions of float32, and what the shoulder of ⊕ makes of their rounding.
ROUNDING = 2e-5

# Depths of few values, so that samples meet; -0 and 0 are one.
DEPTHS = st.sampled_from([-1.0, -0.0, 0.0, 1.0, 2.0, 2.5, 4.0, 1e6])
# Hues 40° apart, so that no test hangs on the shoulder.
HUES = st.sampled_from([0, 40, 120, 160, 240, 280])


@st.composite
def samples(draw, opaque=True):
    """(R, G, B, alpha, front, back) as float32 holds them."""
    alphas = [0.0, 1e-30, 1e-6, 0.1, 0.5, 0.99] + [1.0] * opaque
    alpha = draw(st.sampled_from(alphas))
    color = valid_color(draw(HUES), draw(st.sampled_from([0, 0.3, 1])), draw(st.floats(0.1, 0.9)))
    scale = alpha if alpha >= 1e-6 else draw(st.sampled_from([0.0, 0.25]))  # glow
    front = draw(DEPTHS)
    back = front + draw(st.sampled_from([-1.0, 0.0, 0.5, 1.0, 3.0]))
    return tuple(float(np.float32(v)) for v in (*oracle.scaled(scale, color), alpha, front, back))


PIXELS = st.lists(samples(), max_size=5)


#: Small, so that few pixels see all of the pattern.
WOVEN = {"blending": "woven", "weave_size": 2}


def of_pixels(*pixels):
    """The samples of these pixels."""
    values = np.array([s for pixel in pixels for s in pixel], np.float32).reshape(-1, 6)
    counts = np.array([len(pixel) for pixel in pixels])
    return DeepSamples(counts, values[:, 4], values[:, 5], values[:, :4])


def flattened(*pixels, window=None, **rules):
    return flat(
        of_pixels(*pixels), stack_rules(1, **rules), "float", Losses(), REC709, window=window
    )


def test_work_can_be_given_up_in_the_middle(monkeypatch):
    """Of one pixel of many volumes that overlap, and of many deep ones in one stack."""
    monkeypatch.setattr(engine.active(), "pairs_at_once", 4 * 100**2)
    volumes = [(0.01, 0.0, 0.01 * (n % 2), 0.02, n, 1000.0 - n) for n in range(300)]
    points = [[(0.01, 0.0, 0.01 * (n % 2), 0.02, n, n) for n in range(96)]] * 40
    for pixels in ([volumes], points):
        done = []

        def go_on(done=done):
            done.append(True)
            if len(done) == 9:
                raise KeyError

        rules = stack_rules(1, order="simultaneous")
        with pytest.raises(KeyError):
            flat(of_pixels(*pixels), rules, "float", Losses(), REC709, go_on)
        assert len(done) == 9


@pytest.mark.parametrize(("order", "calls"), [("bottom-up", 1), ("balanced", 1), ("simultaneous", 10)])
def test_deep_pixels_share_a_stack_as_far_as_signals_allow(monkeypatch, order, calls):
    """Each call of the engine costs something for each layer, whatever the number of pixels."""
    monkeypatch.setattr(engine.active(), "pairs_at_once", 4 * 400**2)
    begun, start = [], engine.start
    def counted(*given, **named):
        begun.append(given)
        return start(*given, **named)

    monkeypatch.setattr(engine, "start", counted)
    points = [[(0.01, 0.0, 0.01 * (n % 2), 0.02, n, n) for n in range(384)]] * 40
    flattened(*points, order=order)
    assert len(begun) == calls
    assert sum(width for _, width, _ in begun) == 40


def plain_sum(counts, rgba):
    return np.add.reduceat(rgba, np.cumsum(counts) - counts, axis=0)


# ---- the second opinion ---------------------------------------------------------------------


@pytest.fixture(params=engine.NAMES)
def by_each_engine(request, monkeypatch):
    monkeypatch.setenv(engine.VARIABLE, request.param)


@pytest.mark.pairwise
@pytest.mark.usefixtures("by_each_engine")
@pytest.mark.parametrize("order", ORDER_NAMES)
@pytest.mark.parametrize("blending", [name for name in BLENDING_NAMES if name != "foremost"])
def test_pixels_are_those_of_the_document_and_the_paper(blending, order):
    @given(st.lists(PIXELS, min_size=1, max_size=3))
    def holds(pixels):
        found = flattened(*pixels, blending=blending, order=order)
        wanted = [deeporacle.flat(pixel, blending, order) for pixel in pixels]
        assert np.abs(found - wanted).max() < ROUNDING

    holds()


@pytest.mark.pairwise
@pytest.mark.usefixtures("by_each_engine")
@pytest.mark.parametrize("order", ORDER_NAMES)
@pytest.mark.parametrize("strength", STRENGTH_NAMES[1:])
def test_a_merged_sample_is_as_strong_as_its_own_colour(strength, order):
    @given(st.lists(PIXELS, min_size=1, max_size=3))
    def holds(pixels):
        found = flattened(*pixels, strength=strength, order=order)
        wanted = [deeporacle.flat(pixel, order=order, strength=strength) for pixel in pixels]
        assert np.abs(found - wanted).max() < ROUNDING

    holds()


@pytest.mark.parametrize("blending", [*BLENDING_NAMES, "woven"])
@given(PIXELS, st.randoms(use_true_random=False))
def test_the_order_of_samples_changes_no_bit(blending, pixel, random):
    shuffled = list(pixel)
    random.shuffle(shuffled)
    # One place on the canvas for both.
    found = [flattened(samples, blending=blending) for samples in (pixel, shuffled)]
    assert found[0].tobytes() == found[1].tobytes()


@given(PIXELS, PIXELS)
def test_several_images_are_one(first, second):
    both = deepsamples.merged([of_pixels(first, second), of_pixels(second, [])])
    assert both.counts.tolist() == [len(first) + len(second), len(second)]
    wanted = of_pixels([*first, *second], second)
    for name in ("front", "back", "rgba"):
        assert np.array_equal(getattr(both, name), getattr(wanted, name))


# ---- splitting ------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ORDER_NAMES)
@given(sample=samples(), cuts=st.lists(st.floats(0.01, 0.99), min_size=1, max_size=4))
def test_a_split_volume_flattens_to_what_it_was(order, sample, cuts):
    whole = (*sample[:4], 1.0, 3.0)
    depths = sorted({1.0, 3.0, *(float(np.float32(1 + 2 * cut)) for cut in cuts)})
    parts = [
        deeporacle.part(whole, near, far) for near, far in itertools.pairwise(depths)
    ]
    found = flattened([whole], parts, order=order)
    wanted = np.array(whole[:4])
    assert np.abs(found[0] - wanted).max() < 1e-6
    assert np.abs(found[1] - wanted).max() < ROUNDING


@pytest.mark.parametrize("alpha", [1e-40, 1e-30, 1e-12, 1e-7])
def test_a_part_of_almost_nothing_is_its_share(alpha):
    """1 - (1 - α)^t in float32 would be 0."""
    volume = (0.25, 0.125, 0.5, alpha, 0.0, 4.0)
    mark = (0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
    counts, rgba = deepsamples.tidied(of_pixels([volume, mark]), plain_sum)
    assert counts.tolist() == [3]
    assert np.allclose(rgba[0, :3], np.array(volume[:3]) / 4, rtol=1e-6)
    assert np.allclose(rgba[0, 3], np.float32(alpha) / 4, rtol=1e-6, atol=1e-45)
    assert rgba[1].tolist() == [0, 0, 0, 0]
    assert np.allclose(rgba[2, :3], 0.75 * np.array(volume[:3]), rtol=1e-6)


def test_alpha_follows_the_length():
    volume, mark = (0.75, 0.0, 0.0, 0.75, 0.0, 2.0), (0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
    _, rgba = deepsamples.tidied(of_pixels([volume, mark]), plain_sum)
    assert np.allclose(rgba[[0, 2]], [[0.5, 0, 0, 0.5]] * 2)


def test_an_opaque_volume_is_opaque_from_its_front_on():
    volume, inside = (0.5, 0.25, 0.0, 1.0, 0.0, 2.0), (0.0, 0.0, 1.0, 1.0, 1.0, 1.0)
    counts, rgba = deepsamples.visible(*deepsamples.tidied(of_pixels([volume, inside]), plain_sum))
    assert counts.tolist() == [1]
    assert rgba.tolist() == [[0.5, 0.25, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("front", "back", "shares"),
    [(0.0, math.inf, [0, 0, 1]), (-math.inf, 2.0, [1, 0, 0]), (-math.inf, math.inf, [0.5, 0, 0.5])],
)
def test_an_endless_volume_is_at_its_endless_end(front, back, shares):
    volume = (0.5, 0.0, 0.0, 0.0, front, back)  # glow, whose parts are their shares
    marks = [(0.0, 0.0, 0.0, 0.0, depth, depth) for depth in (0.5, 1.0)]
    _, rgba = deepsamples.tidied(of_pixels([volume, *marks]), plain_sum)
    assert rgba[::2, 0].tolist() == [share * 0.5 for share in shares]


def test_a_back_before_the_front_is_a_point():
    """As OpenEXR's document has it; some writers leave ZBack 0."""
    point, behind = (0.5, 0.0, 0.0, 0.5, 3.0, 0.0), (0.0, 0.5, 0.0, 0.5, 4.0, 4.0)
    counts, rgba = deepsamples.tidied(of_pixels([behind, point]), plain_sum)
    assert counts.tolist() == [2]
    assert rgba.tolist() == [[0.5, 0, 0, 0.5], [0, 0.5, 0, 0.5]]


def test_a_point_where_a_volume_begins_is_in_front_of_it_and_where_it_ends_behind():
    volume = (0.5, 0.0, 0.0, 0.5, 1.0, 2.0)
    before, after = (0.0, 0.5, 0.0, 0.5, 1.0, 1.0), (0.0, 0.0, 0.5, 0.5, 2.0, 2.0)
    counts, rgba = deepsamples.tidied(of_pixels([after, volume, before]), plain_sum)
    assert counts.tolist() == [3]
    assert rgba[:, :3].argmax(axis=1).tolist() == [1, 0, 2]


# ---- merging --------------------------------------------------------------------------------


@given(st.lists(samples(), min_size=2, max_size=5))
def test_weights_are_those_of_the_document(coincident):
    coincident = [(*s[:4], 1.0, 2.0) for s in coincident]
    counts, rgba = deepsamples.tidied(of_pixels(coincident), plain_sum)
    colors, alpha = deeporacle.weighted(coincident)
    assert counts.tolist() == [1]
    assert np.abs(rgba[0] - (*deeporacle.plain_sum(colors), alpha)).max() < ROUNDING


def test_two_labels_in_one_place_do_not_make_a_third():
    """Where + makes orange of red and yellow, the stronger one keeps its hue."""
    red, yellow = (0.5, 0.0, 0.0, 0.5, 1.0, 2.0), (0.2, 0.2, 0.0, 0.5, 1.0, 2.0)
    (kept,) = flattened([red, yellow])
    hue_of = partial(oracle.angle, oracle.difference(red[:3]))
    assert hue_of(oracle.difference(kept[:3])) < 1e-3
    (plain,) = flattened([red, yellow], blending="traditional")
    assert hue_of(oracle.difference(plain[:3])) > 0.1
    weights = (0.212639, 0.715169, 0.072192)
    assert abs(np.dot(kept[:3], weights) - np.dot(plain[:3], weights)) < 1e-6


def test_opaque_points_in_one_place_share_it():
    """Their mean, however many: in pairs, as OpenEXR's document has it, the last counts most."""
    points = [(1.0, 0.0, 0.0, 1.0, 1.0, 1.0), (0.0, 0.0, 1.0, 1.0, 1.0, 1.0)]
    points += [(1.0, 0.0, 0.0, 1.0, 1.0, 1.0), (0.0, 0.9, 0.0, 0.9, 1.0, 1.0)]
    (found,) = flattened(points, blending="traditional")
    assert np.abs(found - [2 / 3, 0, 1 / 3, 1]).max() < 1e-6


def test_foremost_adds_in_one_place_as_hue_preserving_does():
    strong, weak = (0.0, 0.6, 0.0, 0.6, 1.0, 1.0), (0.1, 0.0, 0.0, 0.1, 1.0, 1.0)
    behind = (0.0, 0.0, 0.9, 0.9, 2.0, 2.0)
    (found,) = flattened([weak, strong, behind], blending="foremost")
    green = oracle.difference((0, 1, 0))
    assert oracle.angle(green, oracle.difference(tuple(map(float, found[:3])))) < 1e-3
    for n in MANY:
        alike = [flattened(coincident(n), blending=b) for b in ("foremost", "hue-preserving")]
        assert alike[0].tobytes() == alike[1].tobytes()


# ---- many in one place ----------------------------------------------------------------------


#: Around where pixels are no longer added side by side, and where pairs are no longer tabled.
MANY = (2, 31, 32, 33, 34, 64, 65, 100, 200)
HUES_OF_MANY = {
    "labels": lambda rng, n: rng.choice([0, 120, 240], n),
    "anywhere": lambda rng, n: rng.uniform(0, 360, n),
    "a band": lambda rng, n: rng.uniform(10, 17, n),  # within the shoulders of each other
}


def coincident(n, hues="labels", *, volumes=False, seed=0):
    """(n) samples in one place, whose alphas add up to about a half."""
    rng = np.random.default_rng([seed, n])
    alphas = rng.uniform(0.1, 1, n) * rng.choice([1, 1e-3], n)
    alphas *= 0.7 / alphas.sum()
    back = 3.0 if volumes else 1.0
    return [
        (*oracle.scaled(a, valid_color(h, rng.uniform(0.2, 1), 0.4)), float(a), 1.0, back)
        for a, h in zip(alphas, HUES_OF_MANY[hues](rng, n).tolist(), strict=True)
    ]


def stored(samples):
    """As float32 holds them."""
    return [tuple(float(np.float32(value)) for value in sample) for sample in samples]


@pytest.mark.singly
@pytest.mark.parametrize("volumes", [False, True])
@pytest.mark.parametrize("hues", HUES_OF_MANY)
@pytest.mark.parametrize("blending", [name for name in BLENDING_NAMES if name != "foremost"])
@pytest.mark.parametrize("n", MANY)
def test_many_in_one_place_are_those_of_the_document_and_the_paper(
    monkeypatch, n, blending, hues, volumes
):
    behind = (0.0, 0.25, 0.125, 0.5, 4.0, 4.0)
    pixel = [*stored(coincident(n, hues, volumes=volumes)), behind]
    wanted = deeporacle.flat(pixel, blending)
    for name in engine.NAMES:
        monkeypatch.setenv(engine.VARIABLE, name)
        (found,) = flattened(pixel, blending=blending)
        assert np.abs(found - wanted).max() < ROUNDING, name


#: What is hardly there, beside colours of 0.01 and more: of a hue that the others have and of one
#: that none has, weaker still, without alpha, black, and nothing at all.
VANISHING = {
    "of a hue": (0.0, 1e-7, 0.0, 1e-7),
    "of a hue of its own": (1e-7, 1e-7, 0.0, 1e-7),
    "weaker": (0.0, 0.0, 1e-12, 1e-12),
    "without alpha": (0.0, 1e-7, 0.0, 0.0),
    "black": (0.0, 0.0, 0.0, 1e-7),
    "nothing": (0.0, 0.0, 0.0, 0.0),
}


@pytest.mark.singly
@pytest.mark.usefixtures("by_each_engine")
@pytest.mark.parametrize("kind", VANISHING)
@pytest.mark.parametrize("order", ORDER_NAMES)
def test_a_vanishing_sample_changes_nothing_at_any_number(order, kind):
    more = (*VANISHING[kind], 1.0, 1.0)
    for n in MANY:
        pixel = coincident(n)
        for times in (1, 40):
            found = flattened(pixel, [*pixel, *[more] * times], order=order)
            assert np.abs(found[1] - found[0]).max() < times * 1e-6, (n, times)


@pytest.mark.usefixtures("by_each_engine")
def test_a_strong_label_among_many_keeps_its_hue():
    """Of reds, greens and blues 16 : 8 : 8 red is left, with and without what is hardly there."""
    c = 0.02
    reds, greens, blues = ((*oracle.scaled(c, rgb), c, 1.0, 1.0) for rgb in np.eye(3).tolist())
    pixel = [reds] * 16 + [greens] * 8 + [blues] * 8
    found = flattened(pixel, [*pixel, (0.0, 1e-7, 0.0, 1e-7, 1.0, 1.0)])
    assert np.abs(found[1] - found[0]).max() < 1e-6
    red, green, blue, _ = found[1]
    assert red > 1.5 * green
    assert abs(green - blue) < 1e-6


@pytest.mark.usefixtures("by_each_engine")
@pytest.mark.parametrize("n", MANY)
def test_a_sample_among_nothing_is_what_it_was(n):
    sample = (0.25, 0.125, 0.0, 0.5)
    pixel = [(*sample, 1.0, 1.0), *[(0.0, 0.0, 0.0, 0.0, 1.0, 1.0)] * (n - 1)]
    (found,) = flattened(pixel)
    assert np.abs(found - sample).max() < 1e-7


@pytest.mark.usefixtures("by_each_engine")
@pytest.mark.parametrize("n", MANY)
def test_the_order_of_many_samples_changes_no_bit(n):
    pixel = [*coincident(n, "anywhere"), (0.0, 0.0, 0.0, 0.0, 1.0, 1.0)]
    shuffled = [pixel[i] for i in np.random.default_rng(n).permutation(len(pixel))]
    for blending in (*BLENDING_NAMES, "woven"):
        found = [flattened(samples, blending=blending) for samples in (pixel, shuffled)]
        assert found[0].tobytes() == found[1].tobytes()


@pytest.mark.pairwise
@pytest.mark.parametrize("gray_bias", [0, 0.4])
@pytest.mark.parametrize("hue_tolerance", [0, 2, 30])
@pytest.mark.parametrize("space", ["linear-rgb", "xyz", "hsl", "oklab", "cielab"])
@pytest.mark.parametrize("hues", HUES_OF_MANY)
@pytest.mark.parametrize("n", [32, 33, 65, 200])
def test_engines_agree_on_many_in_one_place(monkeypatch, n, hues, space, hue_tolerance, gray_bias):
    pixels = [coincident(n, hues, seed=seed) for seed in range(3)]
    rules = stack_rules(1, space=space, hue_tolerance=hue_tolerance, gray_bias=gray_bias)
    found = []
    for name in engine.NAMES:
        monkeypatch.setenv(engine.VARIABLE, name)
        found.append(flat(of_pixels(*pixels), rules, "float", Losses(), REC709))
    assert np.abs(found[1] - found[0]).max() < (ROUNDING if rules.space.linear else 2e-4)


# ---- many pixels ----------------------------------------------------------------------------


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize("most", [1, 5, 40])
def test_zeros_and_signs_are_exact(by_each_engine, space, most):
    """At one depth and at several; a sample that is alone stays as it is, to the bit."""
    rng = np.random.default_rng(most)
    pixels = []
    for channel in np.resize(np.arange(3), 90):
        values = rng.random((most, 6)).astype(np.float32)
        values[:, :3] *= values[:, 3:4]
        values[:, channel] = 0
        values[:, 4:] = np.floor(3 * values[:, 4:5])
        pixels.append([tuple(map(float, sample)) for sample in values])
    for order in ("bottom-up", "simultaneous"):
        rules = stack_rules(1, space=space, order=order)
        found = flat(of_pixels(*pixels), rules, "float", Losses(), REC709)
        assert not np.signbit(found).any()
        if most == 1:
            colors = np.array([pixel[0][:4] for pixel in pixels], np.float32)
            assert np.array_equal(found.view(np.uint32), colors.view(np.uint32))
    one_hue = [[(0.0, 0.3 * a, 0.9 * a, a, d, d) for _, _, _, a, d, _ in pixel] for pixel in pixels]
    found = flat(of_pixels(*one_hue), stack_rules(1, space=space), "float", Losses(), REC709)
    assert not found[:, 0].any()
    assert found[:, 2].any()


def many_samples(rng, pixels, most):
    """Pixels of few depths and up to so many samples."""
    return [
        [
            (*(rng.random(3) * a).tolist(), a, front, front + length)
            for a, front, length in zip(
                rng.choice([0.1, 0.25, 0.5], n), rng.integers(0, 9, n), rng.integers(0, 5, n),
                strict=True,
            )
        ]
        for n in rng.integers(0, most + 1, pixels)
    ]  # fmt: skip


def test_how_many_pieces_are_in_memory_changes_no_bit(monkeypatch):
    pixels = many_samples(np.random.default_rng(3), 40, 30)
    for rules in ({}, WOVEN):
        whole = flattened(*pixels, **rules)
        for at_once in (1, 7, 100):
            with monkeypatch.context() as patched:
                patched.setattr(deepsamples, "PIECES_AT_ONCE", at_once)
                assert flattened(*pixels, **rules).tobytes() == whole.tobytes()


@pytest.mark.parametrize("at_once", [deepsamples.PIECES_AT_ONCE, 11])
@pytest.mark.parametrize("rules", [*({"order": name} for name in ORDER_NAMES), WOVEN], ids=str)
def test_what_else_is_in_the_strip_changes_no_bit(monkeypatch, rules, at_once):
    pixels = many_samples(np.random.default_rng(4), 60, 20)
    whole = flattened(*pixels, **rules)
    monkeypatch.setattr(deepsamples, "PIECES_AT_ONCE", at_once)
    for number in range(0, 60, 7):
        alone = flattened(pixels[number], window=Window(number, 0, 1, 1), **rules)
        assert alone.tobytes() == whole[number].tobytes()


def test_one_pixel_of_a_thousand_samples_makes_no_thousand_layers_of_all():
    counts = np.ones(5000, int)
    counts[17] = 1000
    rgba = np.full((int(counts.sum()), 4), 0.001, np.float32)
    held = [stack.shape for _, stack in deepsamples.layers(counts, rgba)]
    assert held == [(1, 4999, 4), (1024, 1, 4)]


def test_every_pixel_is_in_one_stack_with_its_samples_from_the_back():
    counts = np.array([0, 3, 9, 1, 0, 17, 200])
    rgba = np.arange(4 * counts.sum(), dtype=np.float32).reshape(-1, 4) + 1
    begin = np.cumsum(counts) - counts
    seen = []
    for pixels, stack in deepsamples.layers(counts, rgba):
        seen += pixels.tolist()
        for at, pixel in enumerate(pixels):
            own = rgba[begin[pixel] : begin[pixel] + counts[pixel]][::-1]
            assert np.array_equal(stack[: counts[pixel], at], own)
            assert not stack[counts[pixel] :, at].any()
            assert len(stack) <= max(8, 1.25 * counts[pixel] + 1)
    assert sorted(seen) == list(range(len(counts)))


def test_no_samples_are_a_transparent_pixel():
    assert flattened([], []).tolist() == [[0, 0, 0, 0]] * 2


def test_hidden_samples_change_nothing_in_any_order():
    front = [(0.1, 0.0, 0.0, 0.25, 1.0, 1.0), (0.0, 0.5, 0.0, 1.0, 2.0, 2.0)]
    hidden = [(0.0, 0.0, 0.5, 0.5, 3.0, 4.0), (9.0, 0.0, 0.0, 0.5, 5.0, 5.0)]
    for rules in (*({"order": order} for order in ORDER_NAMES), WOVEN):
        found = [flattened(samples, **rules) for samples in (front, front + hidden)]
        assert found[0].tobytes() == found[1].tobytes()


# ---- woven ----------------------------------------------------------------------------------


#: How far the phase has to be from where another hue begins: single precision adds the strengths.
MARGIN = 1e-5
LUMINANCE = np.array(oracle.WEIGHTS)


def phase(x, y, size=8):
    return float(np.float32(oracle.stripes(x, y, size)))


def assert_woven(pixels, window, background=None, strength="chroma"):
    """As the oracle has it, wherever no rounding decides on hues; the share of pixels where it does not."""
    rules = {"blending": "woven", "strength": strength, "background": background}
    found = flattened(*pixels, window=window, **rules)
    compared = 0
    for number, pixel in enumerate(pixels):
        row, column = divmod(number, window.width)
        u = phase(window.x + column, window.y + row)
        wanted = deeporacle.woven(pixel, u, background, strength)
        if wanted.margin > MARGIN:
            compared += 1
            chroma = oracle.length(oracle.difference(wanted.rgba[:3]))
            room = ROUNDING * (1 + chroma * wanted.gain)
            assert np.abs(found[number] - wanted.rgba).max() < room, number
    return compared / len(pixels)


@pytest.mark.usefixtures("by_each_engine")
@pytest.mark.parametrize("strength", STRENGTH_NAMES)
@given(
    pixels=st.lists(PIXELS, min_size=1, max_size=6),
    corner=st.tuples(*[st.integers(-40, 40)] * 2),
    background=st.sampled_from([None, (0.1, 0.4, 0.2)]),
)
def test_woven_samples_are_those_of_the_oracle(strength, pixels, corner, background):
    assert_woven(pixels, Window(*corner, len(pixels), 1), background, strength)


@pytest.mark.usefixtures("by_each_engine")
@pytest.mark.parametrize("strength", STRENGTH_NAMES)
def test_woven_pixels_have_the_phase_of_their_place(strength):
    """Pixels of as many samples are made together, wherever they are."""
    pixels = many_samples(np.random.default_rng(8), 15 * 9, 12)
    assert assert_woven(pixels, Window(-3, 5, 15, 9), (0.3, 0.1, 0.2), strength) > 0.9


@pytest.mark.usefixtures("by_each_engine")
@pytest.mark.parametrize("volumes", [False, True])
@pytest.mark.parametrize("n", MANY)
def test_many_woven_samples_in_one_place_are_those_of_the_oracle(n, volumes):
    behind = (0.0, 0.25, 0.125, 0.5, 4.0, 4.0)
    pixel = [*stored(coincident(n, volumes=volumes)), behind]
    assert assert_woven([pixel] * 8, Window(0, 0, 8, 1)) > 0.8


@pytest.mark.usefixtures("by_each_engine")
@pytest.mark.parametrize("strength", STRENGTH_NAMES)
@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize("weave", WEAVE_NAMES)
def test_woven_luminance_and_alpha_are_those_of_plus(weave, space, strength):
    pixels = many_samples(np.random.default_rng(9), 64, 12)
    rules = {"weave": weave, "space": space, "strength": strength}
    found = flattened(*pixels, window=Window(0, 0, 8, 8), blending="woven", **rules)
    plain = flattened(*pixels, blending="traditional")
    assert np.abs(found[:, 3] - plain[:, 3]).max() < 1e-6
    assert np.abs((found - plain)[:, :3] @ LUMINANCE).max() < 2e-6


@pytest.mark.usefixtures("by_each_engine")
@pytest.mark.parametrize("strength", STRENGTH_NAMES)
@given(pixels=st.lists(PIXELS, min_size=1, max_size=6))
def test_woven_samples_of_one_hue_are_plus(strength, pixels):
    one = [[(0.1 * s[3], 0.4 * s[3], 0.2 * s[3], *s[3:]) for s in pixel] for pixel in pixels]
    found = flattened(*one, blending="woven", strength=strength)
    assert np.abs(found - flattened(*one, blending="traditional")).max() < 1e-6


@pytest.mark.usefixtures("by_each_engine")
@pytest.mark.parametrize("strength", STRENGTH_NAMES)
def test_volumes_in_one_place_keep_the_shares_of_their_densities(strength):
    """However finely others cut them: a red of density 3 and a blue of 1, over many pixels."""
    red, blue = 1 - math.exp(-3), 1 - math.exp(-1)
    # Of one chroma, so that no strength tells colours apart from amounts.
    of_red, of_blue = (valid_color(h, s, 0.2) for h, s in ((10, 0.3), (250, 0.3)))
    lengths = [oracle.length(oracle.difference(c)) for c in (of_red, of_blue)]
    of_blue = oracle.color(0.2, oracle.scaled(lengths[0] / lengths[1], oracle.difference(of_blue)))
    pixel = [(*oracle.scaled(red, of_red), red, 1.0, 3.0), (*oracle.scaled(blue, of_blue), blue, 1.0, 3.0)]
    cuts = [(0.0, 0.0, 0.0, 0.0, float(z), float(z)) for z in np.linspace(1, 3, 50)]
    side = 64
    strengths = [oracle.oklab_chroma(c) for c in (of_red, of_blue)]
    weight = {"chroma": (1, 1), "perceived": strengths}.get(
        strength, [c / (c + oracle.HALF_STRENGTH) for c in strengths]
    )
    wanted = 3 * weight[0] / (3 * weight[0] + weight[1])
    made = []
    for samples in (pixel, [*pixel, *cuts]):
        window = Window(0, 0, side, side)
        found = flattened(*[samples] * side**2, window=window, blending="woven", strength=strength)
        made.append(found)
        is_red = found[:, 0] > found[:, 2]
        assert abs(is_red.mean() - wanted) < 0.01
    assert (made[0][:, 0] > made[0][:, 2]).tolist() == (made[1][:, 0] > made[1][:, 2]).tolist()
    assert np.abs(made[1] - made[0]).max() < ROUNDING


@given(PIXELS)
def test_what_is_seen_of_samples_adds_up_to_the_pixel(pixel):
    counts, rgba = deepsamples.seen(of_pixels(pixel))
    assert counts.tolist() == [len(rgba)]
    assert len(rgba) <= len(pixel)
    wanted = deeporacle.flat(pixel, "traditional")
    assert np.abs(rgba.sum(axis=0, dtype=float) - wanted).max() < ROUNDING
