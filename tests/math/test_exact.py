"""What must be exact: zeros, signs, colours that are alone, greys; and what is not finite. In both engines."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from engines import run, run_arrays

from hpcomp.blending.orders import ORDERS
from hpcomp.color.encodings import ColorEncoding
from hpcomp.color.primaries import OUT_PRIMARIES, PRIMARIES, WORKING_PRIMARIES, converted
from hpcomp.color.samples import Decoding, Strip
from hpcomp.color.spaces import SPACES
from hpcomp.color.transfer import LINEAR
from hpcomp.engine import reference
from hpcomp.kernel import fused as kernel
from hpcomp.options import stack_rules

BY = {"kernel": kernel, "reference": reference}
engines = pytest.mark.parametrize("by", BY.values(), ids=BY)
spaces = pytest.mark.parametrize("space", SPACES)
orders = pytest.mark.parametrize("order", [*ORDERS, "2,0,3,1"])
BLENDINGS = ("hue-preserving", "traditional", "foremost")
PIXELS = 700


def labels(n, seed=0, zero=None):
    """(n, 1, PIXELS, 4) float32: layers of any colours, some opaque, some empty; a channel may be 0."""
    rng = np.random.default_rng(seed)
    alpha = rng.choice([0, 1, -1, -1, -1], (n, 1, PIXELS, 1)).astype(np.float32)
    alpha = np.where(alpha < 0, rng.random(alpha.shape, np.float32), alpha)
    color = rng.random((n, 1, PIXELS, 3), np.float32)
    # Greys, and the surface of the cube.
    color[:, :, ::5] = color[:, :, ::5, :1]
    color[:, :, 1::5, 1] = 1
    if zero is not None:
        color[..., zero] = 0
    return np.concatenate([color * alpha, alpha], axis=-1)


def bits(samples):
    return samples.view(np.uint32)


def rules_of_four(**rules):
    if rules.get("blending") == "foremost" and rules["order"] != "bottom-up":
        rules["order"] = "bottom-up"
    return stack_rules(4, **rules)


@engines
@spaces
class TestAlone:
    """A colour that is alone is the result, to the bit."""

    @pytest.mark.parametrize("blending", BLENDINGS)
    def test_a_stack_of_one_layer(self, by, space, blending):
        (layer,) = layers = labels(1)
        # Light without alpha, beyond white and below black, and both zeros.
        layer[0, :4, :] = [[0.1, 0, 2, 0], [-0.5, 3, 0.1, 0.5], [1e-30, 1e30, 0, 1], [-0.0, 0, 0, 0]]
        for order, bias in itertools.product(ORDERS, (0.0, 0.5)):
            rules = stack_rules(1, space=space, blending=blending, order=order, gray_bias=bias)
            assert np.array_equal(bits(run_arrays(by, rules, layers).samples), bits(layer))

    @orders
    def test_an_opaque_layer_on_top_and_one_among_empty_ones(self, by, space, order):
        layers = labels(4)
        layers[3, ..., 3] = 1
        found = run_arrays(by, rules_of_four(space=space, order=order), layers).samples
        assert np.array_equal(bits(found), bits(layers[3]))
        for number in range(4):
            alone = np.zeros_like(layers)
            alone[number] = layers[number]
            found = run_arrays(by, rules_of_four(space=space, order=order), alone).samples
            assert np.array_equal(found, layers[number])


@engines
@spaces
@orders
class TestZerosAndSigns:
    @pytest.mark.parametrize("blending", BLENDINGS)
    def test_nothing_is_below_zero_where_nothing_was(self, by, space, order, blending):
        for zero, op, background in ((0, "over", None), (1, "plus", (0.2, 0, 0.7)), (2, "xor", None)):
            for bias in (0.0, 0.7):
                rules = rules_of_four(
                    space=space, order=order, blending=blending, op=op, background=background, gray_bias=bias
                )  # fmt: skip
                found = run_arrays(by, rules, labels(4, zero=zero)).samples
                assert not np.signbit(found).any()

    @pytest.mark.parametrize("color", [(0, 0.3, 0.9), (0.7, 0, 0.2), (0.4, 0.8, 0), (0, 0, 1), (1, 0, 1)])
    def test_a_channel_without_light_gets_none_where_one_hue_is(self, by, space, order, color):
        layers = labels(4)
        layers[..., :3] = layers[..., 3:] * np.array(color, np.float32)
        for blending in ("hue-preserving", "traditional"):
            rules = rules_of_four(space=space, order=order, blending=blending)
            found = run_arrays(by, rules, layers).samples
            assert not found[..., :3][..., np.array(color) == 0].any()
            assert found[..., :3][..., np.array(color) != 0].any()

    def test_greys_are_grey(self, by, space, order):
        layers = labels(4)
        layers[..., :3] = layers[..., :1]
        found = run_arrays(by, rules_of_four(space=space, order=order), layers).samples
        assert np.array_equal(found[..., 0], found[..., 1])
        assert np.array_equal(found[..., 0], found[..., 2])


@engines
@pytest.mark.parametrize("working", WORKING_PRIMARIES)
@pytest.mark.parametrize("source", PRIMARIES)
def test_greys_stay_grey_in_other_primaries(by, source, working):
    ramp = np.linspace(0, 1, 257, dtype=np.float32)
    samples = np.stack([ramp] * 3, axis=-1)[None]
    encoding = ColorEncoding(LINEAR, PRIMARIES[source])
    decoding = Decoding(encoding, "premultiplied", False, working=PRIMARIES[working])
    found = run(by, stack_rules(1, primaries=working), [Strip(samples, decoding)], 257, 1).samples[..., :3]
    assert np.array_equal(found, samples)
    for out in OUT_PRIMARIES:
        grey = converted(samples, PRIMARIES[working], PRIMARIES[out])
        assert np.array_equal(grey, samples)


@engines
@spaces
def test_a_grey_in_front_of_a_hue_leaves_it_foremost_in_other_primaries(by, space):
    ramp = np.linspace(0, 0.5, 256, dtype=np.float32)
    front = np.stack([ramp, ramp, ramp, np.full_like(ramp, 0.5)], axis=-1)[None]
    red = np.broadcast_to(np.array([1, 0, 0, 1], np.float32), front.shape).copy()
    p3 = Decoding(ColorEncoding(LINEAR, PRIMARIES["rec709"]), "premultiplied", False, working=PRIMARIES["display-p3"])
    rules = stack_rules(2, space=space, blending="foremost", primaries="display-p3")
    found = run(by, rules, [Strip(layer, p3) for layer in (red, front)], 256, 1).samples
    assert (found[..., 0] > found[..., 2] + 0.1).all()


@engines
@spaces
@pytest.mark.parametrize("exposure", [0.5, 1.0, 2.0])
def test_codes_keep_the_hues_of_the_space_of_the_stack(by, space, exposure):
    """Also of what is far outside; the codes' own rounding turns hues of dark colours."""
    layers = labels(1, seed=3)
    layers[..., 3] = 1
    layers[0, 0, 0] = [0, 0.0512695, 1, 1]  # (0, 64, 255)
    rules = stack_rules(1, space=space, exposure=exposure)
    codes = run_arrays(by, rules, layers, "uint16").samples[..., :3].reshape(-1, 3) / 65535
    light = np.where(codes > 0.04045, ((codes + 0.055) / 1.055) ** 2.4, codes / 12.92)
    of_layer, of_codes = (
        rules.space.forward(colors.T.astype(float))[1] for colors in (layers[0, 0, :, :3], light)
    )
    clear = (np.hypot(*of_codes) > 0.02) & (np.hypot(*of_layer) > 0.002)
    cross = of_layer[0] * of_codes[1] - of_layer[1] * of_codes[0]
    turn = np.degrees(np.abs(np.arctan2(cross, (of_layer * of_codes).sum(axis=0))))
    assert clear[0]
    assert clear.sum() > 50
    assert turn[clear].max() <= rules.space.gamut_turn + 0.1


@engines
@spaces
def test_the_end_of_halves_keeps_hues(by, space):
    layers = np.array([[60000, 30000, 0, 1], [0, 60000, 60000, 1], [-40000, 1000, 60000, 1]], np.float32)
    rules = stack_rules(1, space=space, exposure=1.0)
    result = run_arrays(by, rules, layers[None, None], "half")
    largest = abs(layers[:, :3]).max(axis=1, keepdims=True)
    assert np.array_equal(result.samples[0, :, :3], (layers[:, :3] / largest * 65504).astype(np.float16))
    assert result.losses.beyond_half == 3


@spaces
@orders
def test_what_is_not_finite_is_the_same_in_both_engines(space, order):
    """In any channel of any layer, whatever else is asked."""
    values = np.array([np.nan, np.inf, -np.inf], np.float32)
    layers = labels(4, seed=9)
    spots = np.random.default_rng(2).permutation(4 * PIXELS * 4)[: 4 * PIXELS // 3]
    layers.reshape(-1)[spots] = np.resize(values, len(spots))
    for op, blending, background in itertools.product(
        ("over", "plus", "atop"), BLENDINGS, (None, (0.2, 0.4, 0.6))
    ):
        rules = rules_of_four(space=space, order=order, op=op, blending=blending, background=background)
        with np.errstate(all="ignore"):
            ours, theirs = (run_arrays(by, rules, layers).samples for by in BY.values())
            assert np.array_equal(np.isnan(ours), np.isnan(theirs))
            assert np.array_equal(np.isinf(ours), np.isinf(theirs))
            ours, theirs = (run_arrays(by, rules, layers, "uint8") for by in BY.values())
        assert ours.losses == theirs.losses
        assert np.abs(ours.samples.astype(int) - theirs.samples).max() <= 1


@pytest.mark.parametrize("tolerance", [1e-12, 1e-7, 1e-4])
@engines
def test_no_tolerance_is_below_that_of_rounding(by, tolerance):
    """What counts as one hue at tolerance 0 does at every other."""
    layers = labels(2, seed=4)
    layers[1] = layers[0] * np.float32(0.3)
    exact, tiny = (
        run_arrays(by, stack_rules(2, op="plus", hue_tolerance=degrees), layers).samples
        for degrees in (0.0, tolerance)
    )
    assert np.allclose(exact[..., :3], layers.sum(axis=0)[..., :3], rtol=1e-6)
    assert np.array_equal(exact, tiny)
