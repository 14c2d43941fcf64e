"""The kernel against the reference in all that can be handed to it; its bytes; its binding."""

from __future__ import annotations

import dataclasses
import itertools
import logging
import math
import re
from concurrent.futures import ThreadPoolExecutor

import exrfile
import numpy as np
import pngfile
import pytest
from bindings import (
    ALL_ORDERS,
    ARGUMENTS_OF_A_LAYER,
    BACKGROUND,
    BOTTOM_UP,
    FRONT_TO_BACK,
    PERMUTATION,
    ROWS_OF_MAPS,
    STRIDED,
    WRONG_TYPES,
    make_background,
    make_competition,
    make_layer,
    make_maps,
    make_rules,
    make_weave,
    refused,
    unaligned,
)
from command import hpcomp as command
from engines import (
    CURVES,
    MODES,
    ORDERS,
    SOME_PRIMARIES,
    broken,
    layers_of_labels,
    run,
    run_arrays,
)
from hypothesis import given
from hypothesis import strategies as st
from strategies import (
    BLENDING_NAMES,
    HUE_TOLERANCES,
    OPERATOR_NAMES,
    ORDER_NAMES,
    jobs,
    rules_of,
)

import hpcomp
from hpcomp.blending import addition, blendings
from hpcomp.color.encodings import COLOR_SPACES, LINEAR_REC709, SRGB_ENCODING, ColorEncoding
from hpcomp.color.gamut import into_gamut
from hpcomp.color.primaries import PRIMARIES, REC709
from hpcomp.color.quantization import LARGEST_HALF, Losses, to_straight_srgb
from hpcomp.color.samples import OUTPUT_TYPES, PLAIN, Decoding, Strip, linear_rgba
from hpcomp.color.spaces import SPACES
from hpcomp.color.transfer import LINEAR, SRGB
from hpcomp.engine import choice as engine
from hpcomp.engine import reference
from hpcomp.errors import HpcompError, HpcompWarning, SettingError
from hpcomp.kernel import _kernel
from hpcomp.kernel import fused as kernel
from hpcomp.layers import budget as memory
from hpcomp.options import stack_rules
from hpcomp.pipeline import budget
from hpcomp.pipeline import strips as strip_pass

# Both engines work in float32 and differ in a square root, an angle, and where they divide.
ULPS_OF_LARGEST_TERM = 12
# The length of p is set anew, by two quotients, and a plain sum stands where p is hardly another: 104
# were seen. Roots of some units in the last place are cubed and weighed against each other, in CIELAB
# z by up to 12 times the luminance: 98 and 64.
ULPS_OF_SPACE = {"hsl": 150, "oklab": 200, "cielab": 200}
# Inside the shoulder ⊕ turns a rounding of its inputs into up to 1 + 3/τ of its result.
INSIDE_SHOULDER = 1e-4
INSIDE_SHOULDER_OF_CURVED_SPACES = 4e-4
# Colours of less chroma than this times their luminance have a hue that rounding turns visibly.
HAS_HUE = 0.02

# A code's lower edge and a colour divided by its alpha are each rounded to float32 by half a step:
# where the two come nearer than that, the code may be the neighbour of the one that doubles find.
TIE = 2.0**-23


# ---- agreement with the reference --------------------------------------------------------------


def in_shoulder(rules, arrays):
    """(h, w): where two of the hues that meet are in the shoulder or on its ends, in doubles."""
    height, width = arrays[0].shape[:2]
    found = np.zeros(height * width, bool)
    tau = math.radians(rules.hue_tolerance)
    begin, end = (0.999 * tau, 2.001 * tau) if tau else (0.5e-4, 2e-4)

    def look(p1, p2):
        angle = np.arctan2(abs(p1[0] * p2[1] - p1[1] * p2[0]), p1[0] * p2[0] + p1[1] * p2[1])
        found[:] |= (angle > begin) & (angle < end) & p1.any(axis=0) & p2.any(axis=0)

    def keep(p1, p2, *settings):
        look(p1, p2)
        return addition.keep_hue(p1, p2, *settings)

    def keep_of_many(terms, *settings):
        for p1, p2 in itertools.combinations(terms, 2):
            look(p1, p2)
        return addition.keep_hues(terms, *settings)

    order_matters = rules.blending.depends_on_order
    blending = blendings.Blending("hue-preserving", keep, keep_of_many, order_matters)
    watched = dataclasses.replace(rules, blending=blending)
    assert height * width <= reference.BLOCK_PIXELS  # one call of `keep` sees all pixels
    run_arrays(reference, watched, arrays.astype(np.float64), "float64", dtype=np.float64)
    return found.reshape(height, width)


def largest_terms(rules, arrays):
    """(h, w) float32: the largest component of all w_i c_i and of the background's, exposed."""
    opacities = np.array(rules.opacities)[:, None, None, None]
    layers = opacities * np.clip(arrays, [-np.inf] * 3 + [0], [np.inf] * 3 + [1])
    alpha = layers[0, ..., 3]
    factors = [(np.ones_like(alpha), np.zeros_like(alpha))]
    for operator, layer in zip(rules.operators[1:], layers[1:], strict=True):
        factors.append(operator.factors(layer[..., 3], alpha))
        alpha = operator.alpha(layer[..., 3], alpha)
    largest = np.zeros_like(alpha)
    if rules.background is not None:
        largest = (1 - alpha) * max(map(abs, rules.background))
    above = np.ones_like(alpha)
    for (f_a, f_b), layer in zip(reversed(factors), reversed(layers), strict=True):
        largest = np.maximum(largest, f_a * above * abs(layer[..., :3]).max(axis=-1))
        above = above * f_b
    return (largest * 2**rules.exposure).astype(np.float32)


def all_have_hue(rules, arrays):
    """(h, w): where every layer is grey or has chroma of more than HAS_HUE of its luminance."""
    luminance, p = rules.space.forward(np.moveaxis(arrays, -1, 0)[:3].astype(np.float64))
    m = np.hypot(*p)
    return ((m == 0) | (m >= HAS_HUE * abs(luminance))).all(axis=0)


def assert_engines_agree(rules, arrays):
    """Float results of both; `arrays` (n, h, w, 4) float32."""
    ours = run_arrays(kernel, rules, arrays).samples
    theirs = run_arrays(reference, rules, arrays).samples
    assert np.isfinite(ours).all()
    assert np.array_equal(ours[..., 3], theirs[..., 3])
    if not rules.blending.depends_on_order:
        assert np.array_equal(ours, theirs)  # sums of the same products in the same order
        return
    error = abs(ours.astype(np.float64) - theirs).max(axis=-1)
    largest = largest_terms(rules, arrays)
    shoulder = in_shoulder(rules, arrays)
    if rules.hue_tolerance == 0:
        # On the hard switch sum and difference are both right, and no bound can be given.
        error[shoulder] = 0
    loose = shoulder | ~all_have_hue(rules, arrays)
    ulps = ULPS_OF_SPACE.get(rules.space.name, ULPS_OF_LARGEST_TERM)
    inside = INSIDE_SHOULDER if rules.space.linear else INSIDE_SHOULDER_OF_CURVED_SPACES
    allowed = np.where(loose, inside * largest, ulps * np.spacing(largest))
    worst = np.unravel_index((error - allowed).argmax(), error.shape)
    assert (error <= allowed).all(), (
        f"{error[worst] / np.spacing(largest[worst]):.1f} ulp, in the shoulder: {shoulder[worst]}\n"
        f"kernel    {ours[worst].tolist()!r}\nreference {theirs[worst].tolist()!r}\n"
        f"layers    {arrays[(slice(None), *worst)].tolist()!r}\n{rules}"
    )


class TestAgreement:
    LAYERS = layers_of_labels(4, 3, 1100)

    def test_the_layers_are_on_both_sides_of_every_case(self):
        rules = stack_rules(4)
        shoulder = in_shoulder(rules, self.LAYERS).mean()
        assert 0.2 < shoulder < 0.8
        assert 0.5 < all_have_hue(rules, self.LAYERS).mean() < 1

    @pytest.mark.pairwise
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("blending", BLENDING_NAMES)
    @pytest.mark.parametrize("op", OPERATOR_NAMES)
    def test_operator_blending_order(self, op, blending, order):
        assert_engines_agree(stack_rules(4, op=op, blending=blending, order=order), self.LAYERS)

    @pytest.mark.pairwise
    @pytest.mark.parametrize("background", [None, (0.9, 0.1, 0.2)])
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("space", [name for name in SPACES if name != "linear-rgb"])
    def test_spaces(self, space, order, background):
        for op in ("over", "atop", "plus"):
            rules = stack_rules(4, order=order, space=space, background=background, op=op)
            assert_engines_agree(rules, self.LAYERS)

    @pytest.mark.parametrize("space", SPACES)
    def test_plain_addition_has_the_bits_of_linear_rgb(self, space):
        rules = stack_rules(4, blending="traditional", space=space, background=(0.9, 0.1, 0.2))
        assert_engines_agree(rules, self.LAYERS)
        if space != "xyz":
            plain = dataclasses.replace(rules, space=SPACES["linear-rgb"])
            found, expected = (run_arrays(kernel, row, self.LAYERS) for row in (rules, plain))
            assert found.everything == expected.everything

    @pytest.mark.parametrize("hue_tolerance", [0.0, 0.01, 0.5, 10.0, 90.0])
    @pytest.mark.parametrize("order", ORDERS)
    def test_tolerance(self, order, hue_tolerance):
        rules = stack_rules(4, order=order, op="plus", hue_tolerance=hue_tolerance)
        assert_engines_agree(rules, self.LAYERS)

    @pytest.mark.parametrize("gray_bias", [1e-30, 1e-3, 0.1, 0.5, 1.0])
    @pytest.mark.parametrize("order", ORDERS)
    def test_gray_bias(self, order, gray_bias):
        for op, more in (("plus", {}), ("xor", {"background": (0.9, 0.1, 0.2)})):
            rules = stack_rules(4, order=order, op=op, gray_bias=gray_bias, **more)
            assert_engines_agree(rules, self.LAYERS)

    @pytest.mark.parametrize("order", [*ORDER_NAMES, "shuffled"])
    @pytest.mark.parametrize("n_layers", [1, 2, 3, 5, 8, 17])
    def test_any_number_of_layers(self, n_layers, order):
        rng = np.random.default_rng(n_layers)
        if order == "shuffled":
            order = rng.permutation(n_layers).tolist()
        # Operators that keep most of what is below, so that the lower layers matter.
        ops = rng.choice(["over", "dst-over", "atop", "xor", "plus"], n_layers - 1).tolist()
        rules = stack_rules(n_layers, op=[None, *ops], order=order)
        assert_engines_agree(rules, layers_of_labels(n_layers, 2, 600))

    @pytest.mark.pairwise
    @pytest.mark.parametrize("exposure", [-30.0, -1.5, 0.5, 20.0])
    @pytest.mark.parametrize("background", [None, (0.9, 0.1, 0.2), (0.5, 0.5, 0.5)])
    @pytest.mark.parametrize("order", ["bottom-up", "top-down", "simultaneous"])
    def test_background_exposure_opacity(self, order, background, exposure):
        rules = stack_rules(
            4,
            order=order,
            background=background,
            exposure=exposure,
            opacity=[0.25, 1.0, 0.0, 0.7],
        )
        assert_engines_agree(rules, self.LAYERS)

    @pytest.mark.parametrize("size", [1e-30, 1e-12, 1e12, 1e30])
    @pytest.mark.parametrize("order", ORDERS)
    def test_colours_of_any_size(self, order, size):
        """Squares of them leave the range of the type."""
        layers = self.LAYERS[:, :1] * np.array([size] * 3 + [1], np.float32)
        for space in SPACES:
            assert_engines_agree(stack_rules(4, order=order, space=space), layers)

    @given(job=jobs(tolerances=st.sampled_from(HUE_TOLERANCES)))
    def test_anything(self, job):
        # The engines' own rounding of HDR sums is what `test_composite` looks at.
        rules = stack_rules(len(job["layers"]), **rules_of(job))
        assert_engines_agree(rules, np.array(job["layers"], np.float32)[:, None, None])


# ---- what is handed in -----------------------------------------------------------------------


def assert_same(rules, strips, width, height, kind="float"):
    """Both engines give the same numbers, NaN where the other has it, and count the same."""
    ours = run(kernel, rules, strips, width, height, kind)
    theirs = run(reference, rules, strips, width, height, kind)
    assert ours.samples.dtype == theirs.samples.dtype
    assert np.array_equal(ours.samples, theirs.samples, equal_nan=ours.samples.dtype.kind == "f")
    assert ours.nonfinite == theirs.nonfinite
    assert ours.losses == theirs.losses
    return ours


class TestSamples:
    """One layer alone is not added to anything: both engines must agree to the bit."""

    @pytest.mark.pairwise
    @pytest.mark.parametrize("mode", MODES)
    @pytest.mark.parametrize("channels", [1, 2, 3, 4])
    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
    def test_codes(self, dtype, channels, mode):
        rng = np.random.default_rng(channels)
        largest = np.iinfo(dtype).max
        every = np.arange(largest + 1, dtype=dtype)
        samples = np.stack([rng.permutation(every) for _ in range(channels)], axis=-1)
        samples = samples.reshape(16, -1, channels)
        height, width = samples.shape[:2]
        for curve, primaries in itertools.product(CURVES, SOME_PRIMARIES):
            decoding = Decoding(ColorEncoding(curve, primaries), mode, stored_straight=True)
            assert decoding.is_plain(samples) == (mode in ("straight", "premultiplied"))
            result = assert_same(stack_rules(1), [Strip(samples, decoding)], width, height)
            assert np.isfinite(result.samples).all()
            alpha = result.samples[..., 3]
            assert 0 <= alpha.min() <= alpha.max() <= 1
            if channels == 2 and mode != "luminance":
                assert np.array_equal(alpha, (samples[..., 1] / largest).astype(np.float32))

    @pytest.mark.pairwise
    @pytest.mark.parametrize("mode", MODES)
    @pytest.mark.parametrize("channels", [1, 2, 3, 4])
    @pytest.mark.parametrize("dtype", [np.float16, np.float32])
    def test_floats(self, dtype, channels, mode):
        rng = np.random.default_rng(channels)
        samples = rng.uniform(-0.5, 1.5, (7, 600, channels)).astype(dtype)
        samples[rng.random(samples.shape) < 0.1] = 0
        samples[rng.random(samples.shape) < 0.1] = 1
        samples[rng.random(samples.shape) < 0.1] *= dtype(20)
        for curve, primaries in itertools.product(CURVES[:2], SOME_PRIMARIES):
            decoding = Decoding(ColorEncoding(curve, primaries), mode, stored_straight=False)
            result = assert_same(stack_rules(1, opacity=0.6), [Strip(samples, decoding)], 600, 7)
            assert np.isfinite(result.samples).all()

    @pytest.mark.parametrize("encoding", COLOR_SPACES.values(), ids=COLOR_SPACES)
    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float16, np.float32])
    def test_colour_spaces(self, dtype, encoding):
        rng = np.random.default_rng(3)
        top = np.iinfo(dtype).max if np.issubdtype(dtype, np.integer) else 1
        samples = (rng.random((3, 50, 4)) * top).astype(dtype)
        decoding = Decoding(encoding, "straight", stored_straight=True)
        assert_same(stack_rules(1), [Strip(samples, decoding)], 50, 3)

    def test_every_half_as_light(self):
        """Subnormal halves too; Inf and NaN are counted, and stay what they are where one is alone."""
        halves = np.arange(65536, dtype=np.uint16).view(np.float16).reshape(64, 1024, 1)
        result = run(kernel, stack_rules(1), [Strip(halves)], 1024, 64)
        expected = np.broadcast_to(halves, (64, 1024, 3)).astype(np.float32)
        assert np.array_equal(result.samples[..., :3], expected, equal_nan=True)
        assert (result.samples[..., 3] == 1).all()
        assert result.nonfinite == [2 * 1024]
        assert_same(stack_rules(1), [Strip(halves)], 1024, 64)

    def test_every_half_as_alpha(self):
        """Held to 0 and 1; NaN stays NaN."""
        halves = np.arange(65536, dtype=np.uint16).view(np.float16).reshape(64, 1024, 1)
        grey_alpha = np.concatenate([np.zeros_like(halves), halves], axis=2)
        result = run(kernel, stack_rules(1), [Strip(grey_alpha)], 1024, 64)
        expected = np.clip(halves[..., 0].astype(np.float32), 0, 1)
        assert np.array_equal(result.samples[..., 3], expected, equal_nan=True)
        assert result.nonfinite == [2 * 1024]
        assert_same(stack_rules(1), [Strip(grey_alpha)], 1024, 64)

    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float16, np.float32])
    def test_a_grey_is_one_in_all_channels_and_primaries(self, dtype):
        top = np.iinfo(dtype).max if np.issubdtype(dtype, np.integer) else 1
        grey = (np.random.default_rng(4).random((2, 40, 1)) * top).astype(dtype)
        results = [
            run(kernel, stack_rules(1), [Strip(samples, decoding)], 40, 2).samples
            for samples in (grey, np.repeat(grey, 3, axis=2))
            for decoding in (Decoding(LINEAR_REC709, "straight", stored_straight=True),)
        ]
        in_acescg = Decoding(
            ColorEncoding(LINEAR, PRIMARIES["acescg"]), "straight", stored_straight=True
        )
        results.append(run(kernel, stack_rules(1), [Strip(grey, in_acescg)], 40, 2).samples)
        for result in results:
            assert np.array_equal(result, results[0])
            assert np.array_equal(result[..., 0], result[..., 1])
            assert np.array_equal(result[..., 0], result[..., 2])

    @pytest.mark.parametrize("order", ORDERS)
    def test_kinds_mix(self, order):
        """Whatever a layer is stored as, it is the layer that its light is."""
        rng = np.random.default_rng(5)
        strips = [
            Strip(
                rng.integers(0, 256, (5, 40, 4), dtype=np.uint8),
                Decoding(SRGB_ENCODING, "straight", stored_straight=True),
            ),
            Strip(
                rng.integers(0, 65536, (5, 40, 2), dtype=np.uint16),
                Decoding(SRGB_ENCODING, "straight", stored_straight=True),
            ),
            Strip(rng.random((5, 40, 4)).astype(np.float16)),
            Strip(
                rng.random((5, 40, 4)).astype(np.float32),
                Decoding(
                    ColorEncoding(LINEAR, PRIMARIES["rec2020"]),
                    "premultiplied",
                    stored_straight=False,
                ),
            ),
        ]
        rules = stack_rules(4, order=order, op="atop")
        stored = run(kernel, rules, strips, 40, 5, "half", at_once=4)
        decoded = [Strip(linear_rgba(strip)[0]) for strip in strips]
        assert stored.everything == run(kernel, rules, decoded, 40, 5, "half").everything

    @pytest.mark.parametrize("order", ORDERS)
    def test_rows_may_lie_anywhere(self, order):
        """Rows of a larger picture, from the bottom up, or all the same one; read-only ones."""
        layers = layers_of_labels(4, 6, 40)
        whole = np.zeros((4, 12, 90, 4), np.float32)
        whole[:, ::2, 7:47] = layers
        whole.flags.writeable = False
        rules = stack_rules(4, order=order)
        expected = run_arrays(kernel, rules, layers).everything
        assert run_arrays(kernel, rules, list(whole[:, ::2, 7:47])).everything == expected
        flipped = [np.ascontiguousarray(layer[::-1])[::-1] for layer in layers]
        assert run_arrays(kernel, rules, flipped).everything == expected
        one_row = [np.broadcast_to(layer[:1], layer.shape) for layer in layers]
        copied = [layer.copy() for layer in one_row]
        assert (
            run_arrays(kernel, rules, one_row).everything
            == run_arrays(kernel, rules, copied).everything
        )


class TestNonfinite:
    LAYERS = broken(layers_of_labels(4, 3, 700))

    @pytest.mark.pairwise
    @pytest.mark.parametrize("kind", OUTPUT_TYPES)
    @pytest.mark.parametrize("mode", MODES)
    @pytest.mark.parametrize("dtype", [np.float16, np.float32])
    def test_zero_makes_the_pixel_transparent(self, dtype, mode, kind):
        with np.errstate(over="ignore"):
            samples = np.concatenate(list(self.LAYERS)).astype(dtype)
        decoding = Decoding(LINEAR_REC709, mode, stored_straight=False, zero_nonfinite=True)
        height = len(samples)
        strips, rules = [Strip(samples, decoding)], stack_rules(1)
        light = assert_same(rules, strips, 700, height)
        result = run(kernel, rules, strips, 700, height, kind)
        assert result.nonfinite == light.nonfinite
        assert result.losses == run(reference, rules, strips, 700, height, kind).losses
        if result.samples.dtype.kind == "u":
            assert_codes(result.samples, light.samples)
        lost = ~np.isfinite(samples).all(axis=2)
        assert 0.1 < lost.mean() < 0.5
        assert result.nonfinite[0] >= lost.sum()  # luminance of 1e38 may be infinite too
        if mode in ("straight", "premultiplied"):
            assert result.nonfinite == [lost.sum()]
        assert not result.samples[lost].any()

    @pytest.mark.parametrize("mode", MODES)
    @pytest.mark.parametrize("channels", [1, 2, 3, 4])
    def test_both_engines_count_and_keep_the_same(self, channels, mode):
        samples = np.ascontiguousarray(self.LAYERS[0][..., 4 - channels :])
        decoding = Decoding(LINEAR_REC709, mode, stored_straight=False)
        assert_same(stack_rules(1), [Strip(samples, decoding)], 700, 3)

    @pytest.mark.parametrize("mode", MODES)
    def test_numbers_that_decoding_makes_infinite_are_not_the_file_s(self, mode):
        """They are as large as they are: no policy refuses them, in neither engine."""
        samples = np.full((1, 4, 4), 0.5, np.float32)
        samples[0, 1:3, 0], samples[0, 1:3, 2] = 3.2e38, -3.2e38
        samples[0, 2, 3] = 0.01
        for zero in (False, True):
            decoding = Decoding(
                ColorEncoding(LINEAR, PRIMARIES["aces2065-1"]), mode, False, zero_nonfinite=zero
            )
            result = assert_same(stack_rules(1), [Strip(samples, decoding)], 4, 1)
            assert result.nonfinite == [0]

    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("op", ["over", "plus", "xor", "dst-in"])
    def test_of_each_layer(self, op, order):
        rules = stack_rules(4, op=op, order=order)
        decoding = dataclasses.replace(PLAIN, zero_nonfinite=True)
        for strips in (
            [Strip(layer) for layer in self.LAYERS],
            [Strip(layer, decoding) for layer in self.LAYERS],
        ):
            ours = run(kernel, rules, strips, 700, 3)
            theirs = run(reference, rules, strips, 700, 3)
            expected = [int((~np.isfinite(layer).all(axis=2)).sum()) for layer in self.LAYERS]
            assert ours.nonfinite == theirs.nonfinite == expected
            assert np.array_equal(ours.samples[..., 3], theirs.samples[..., 3], equal_nan=True)

    @pytest.mark.parametrize("mode", MODES)
    @pytest.mark.parametrize("zero", [False, True])
    def test_only_pixels_on_the_canvas_count(self, mode, zero):
        """What is cut off takes no part, and refuses nothing."""
        samples = np.full((4, 6, 4), 0.5, np.float32)
        samples[0, 0, 0] = samples[3, 5, 3] = samples[2, 2, 1] = np.nan
        decoding = Decoding(LINEAR_REC709, mode, stored_straight=True, zero_nonfinite=zero)
        for offset, count in (
            ((0, 0), 3), ((-1, 0), 2), ((0, -1), 2), ((1, 1), 2), ((-3, 0), 1), ((9, 9), 0),
        ):  # fmt: skip
            result = assert_same(stack_rules(1), [Strip(samples, decoding, *offset)], 6, 4)
            assert result.nonfinite == [count], offset

    @pytest.mark.parametrize("name", engine.NAMES)
    def test_in_a_file_beyond_the_canvas(self, tmp_path, monkeypatch, name):
        monkeypatch.setenv(engine.VARIABLE, name)
        planes = exrfile.rgba(20, 10, np.float32)
        planes["R"][4, 2] = np.nan
        exrfile.write(tmp_path / "a.exr", planes, origin=(-6, 0), display=(0, 0, 10, 10))
        hpcomp.stack([tmp_path / "a.exr"], tmp_path / "out.exr")
        with pytest.raises(HpcompError, match="1 pixel is NaN or infinite, the first at -4,4"):
            hpcomp.stack([tmp_path / "a.exr"], tmp_path / "out.exr", overscan=True)


# ---- where it is placed ------------------------------------------------------------------------


def on_strip(strip, width, height):
    """(h, w, 4) float32 of the whole strip, pixel by pixel: transparent where the layer is not."""
    rgba = linear_rgba(strip)[0]
    whole = np.zeros((height, width, 4), np.float32)
    for y, x in np.ndindex(height, width):
        row, column = y - strip.top, x - strip.left
        if 0 <= row < rgba.shape[0] and 0 <= column < rgba.shape[1]:
            whole[y, x] = rgba[row, column]
    return whole


offsets = st.one_of(st.integers(-12, 12), st.sampled_from([-(2**28), 2**28]))


class TestPlacement:
    @given(data=st.data())
    def test_anywhere(self, data):
        width, height = data.draw(st.integers(1, 20)), data.draw(st.integers(1, 6))
        n_layers = data.draw(st.integers(1, 4))
        strips = []
        for number in range(n_layers):
            rows, columns = data.draw(st.integers(0, 7)), data.draw(st.integers(0, 25))
            samples = layers_of_labels(1, rows, columns, number)[0]
            strips.append(Strip(samples, PLAIN, data.draw(offsets), data.draw(offsets)))
        rules = stack_rules(
            n_layers,
            op=[None, *(data.draw(st.sampled_from(OPERATOR_NAMES)) for _ in strips[1:])],
            order=data.draw(st.sampled_from(ORDER_NAMES)),
        )
        placed = run(kernel, rules, strips, width, height, at_once=n_layers)
        whole = run_arrays(kernel, rules, [on_strip(strip, width, height) for strip in strips])
        assert placed.everything == whole.everything
        plain = dataclasses.replace(rules, blending=blendings.blending("traditional"))
        assert_same(plain, strips, width, height)

    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float16, np.float32])
    @pytest.mark.parametrize("channels", [1, 2, 3, 4])
    def test_of_any_kind(self, channels, dtype):
        """Not a sample of the neighbours: rows and pixels are as long as their kind says."""
        top_value = np.iinfo(dtype).max if np.issubdtype(dtype, np.integer) else 1
        rng = np.random.default_rng(7)
        samples = (rng.random((6, 530, channels)) * top_value).astype(dtype)
        decoding = Decoding(LINEAR_REC709, "straight", stored_straight=True)
        for left, top in itertools.product((-529, -513, -512, -1, 0, 1, 511, 512, 520), (-5, 0, 3)):
            strip = Strip(samples, decoding, left, top)
            result = run(kernel, stack_rules(1), [strip], 521, 4).samples
            expected = np.zeros((4, 521, 4), np.float32)
            whole = run(kernel, stack_rules(1), [Strip(samples, decoding)], 530, 6).samples
            rows = slice(max(0, -top), min(6, 4 - top))
            columns = slice(max(0, -left), min(530, 521 - left))
            part = whole[rows, columns]
            expected[max(0, top) :, max(0, left) :][: part.shape[0], : part.shape[1]] = part
            assert np.array_equal(result, expected)

    def test_a_layer_without_pixels_is_transparent(self):
        red = np.zeros((2, 3, 4), np.float32)
        red[..., ::3] = 1
        for shape in ((0, 0, 4), (0, 3, 4), (2, 0, 4), (0, 0, 1)):
            for dtype in (np.uint8, np.float32):
                nothing = Strip(np.zeros(shape, dtype))
                for op, expected in (("over", red), ("in", 0 * red)):
                    rules = stack_rules(2, op=op)
                    result = run(kernel, rules, [Strip(red), nothing], 3, 2).samples
                    assert np.array_equal(result, expected)


# ---- what comes out ----------------------------------------------------------------------------


def greys(values):
    """A strip (1, n, 1) of float32, whose light comes through an engine as it is."""
    return Strip(np.asarray(values, np.float32).reshape(1, -1, 1))


def assert_codes(codes, rgba):
    """`codes` are those of `quantization.to_straight_srgb`, or their neighbours at a tie."""
    largest = np.iinfo(codes.dtype).max
    with np.errstate(all="ignore"):
        expected = to_straight_srgb(rgba, codes.dtype.type, Losses())
    assert np.array_equal(codes[..., 3], expected[..., 3])
    off = codes[..., :3] != expected[..., :3]
    if not off.any():
        return
    pixels = off.any(axis=-1)
    codes, expected, off = codes[pixels][:, :3], expected[pixels][:, :3], off[pixels]
    assert abs(codes.astype(int) - expected)[off].max() == 1
    straight = rgba[pixels][:, :3] / rgba[pixels][:, 3:].astype(np.float64)
    size = abs(straight).max(axis=1, keepdims=True)
    inside = ((straight >= 0) & (straight <= 1)).all(axis=1, keepdims=True)
    mapped = np.where(inside, straight, into_gamut(straight))
    edge = SRGB.decode((np.maximum(codes, expected) - 0.5) / largest)
    # What moves into the gamut is as uncertain as its largest channel and its luminance were.
    uncertain = TIE * np.where(inside, edge, edge + 2 * size)
    assert (abs(mapped - edge) <= uncertain)[off].all()


class TestOutput:
    LAYERS = layers_of_labels(4, 3, 1100)

    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("op", ["over", "plus", "xor", "dst-out"])
    def test_codes_are_those_of_the_light(self, op, order):
        rules = stack_rules(4, op=op, order=order)
        light = run_arrays(kernel, rules, self.LAYERS)
        for kind in ("uint8", "uint16"):
            stored = run_arrays(kernel, rules, self.LAYERS, kind)
            assert stored.samples.dtype == OUTPUT_TYPES[kind]
            assert_codes(stored.samples, light.samples)
            # Nearly all of them, not only within the bound.
            same = to_straight_srgb(light.samples, OUTPUT_TYPES[kind], Losses())
            assert (same == stored.samples).mean() > 0.999

    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("exposure", [0.0, 3.0, -3.0])
    def test_losses_are_those_of_the_reference(self, order, exposure):
        layers = self.LAYERS.copy()
        layers[:, :, ::50, :3] *= 1e5
        seen = Losses()
        for op in ("over", "plus", "dst-out", "xor"):
            rules = stack_rules(4, op=op, order=order, exposure=exposure)
            for kind in OUTPUT_TYPES:
                ours = run_arrays(kernel, rules, layers, kind)
                theirs = run_arrays(reference, rules, layers, kind)
                assert ours.losses == theirs.losses
                seen.add(ours.losses)
        assert seen.out_of_gamut
        assert seen.light_without_alpha
        assert seen.beyond_half

    @pytest.mark.parametrize("order", ORDERS)
    def test_losses_of_what_is_no_number(self, order):
        layers = broken(self.LAYERS)
        rules = stack_rules(4, op="plus", order=order)
        light = run_arrays(kernel, rules, layers).samples
        unknown = np.isnan(light).any(axis=2)
        assert unknown.any()
        for kind in ("uint8", "uint16"):
            ours = run_arrays(kernel, rules, layers, kind)
            counted = Losses()
            with np.errstate(all="ignore"):
                to_straight_srgb(light, OUTPUT_TYPES[kind], counted)
            assert ours.losses == counted
            assert ours.losses.not_a_number == unknown.sum()
            assert not ours.samples[unknown].any()
            assert_codes(ours.samples[~unknown], light[~unknown])

    @pytest.mark.parametrize("exposure", [0.0, 4.0])
    def test_half_is_the_rounded_light(self, exposure):
        """Every half, its neighbours in float32, the middles between halves, and anything."""
        every = np.arange(65536, dtype=np.uint16).view(np.float16)
        halves = np.unique(every[np.isfinite(every)].astype(np.float32))
        middles = (halves[1:] + halves[:-1]) / 2
        values = np.concatenate([halves, middles])
        values = np.concatenate(
            [
                values,
                np.nextafter(values, np.float32(np.inf)),
                np.nextafter(values, np.float32(-np.inf)),
                np.random.default_rng(8).integers(0, 2**32, 100_000, np.uint32).view(np.float32),
                np.array([65519.9, 65520, 65536, 3e38, np.inf, np.nan, -np.inf], np.float32),
            ]
        )
        rules, strips = stack_rules(1, exposure=exposure), [greys(values)]
        light = run(kernel, rules, strips, len(values), 1).samples
        result = run(kernel, rules, strips, len(values), 1, "half")
        if not exposure:
            finite = np.isfinite(values)
            assert np.array_equal(light[0, finite, 0], values[finite])
        clamped = np.clip(light, -LARGEST_HALF, LARGEST_HALF)
        expected = np.where(np.isfinite(light), clamped, light).astype(np.float16)
        assert result.samples.dtype == np.float16
        assert np.array_equal(result.samples, expected, equal_nan=True)
        numbers = ~np.isnan(expected)
        assert np.array_equal(np.signbit(result.samples[numbers]), np.signbit(expected[numbers]))
        assert np.isinf(expected).any()
        beyond = (abs(light) > LARGEST_HALF) & np.isfinite(light)
        assert result.losses == Losses(beyond_half=int(beyond.any(axis=2).sum()))

    @pytest.mark.parametrize("kind", ["uint8", "uint16"])
    def test_edges_between_codes(self, kind):
        """Where a code begins, to three float32 steps to both sides."""
        largest = np.iinfo(OUTPUT_TYPES[kind]).max
        edges = SRGB.decode((np.arange(largest) + 0.5) / largest).astype(np.float32)
        values = [edges]
        for _ in range(3):
            values.append(np.nextafter(values[-1], np.float32(0)))
        values.append(np.nextafter(edges, np.float32(1)))
        for _ in range(2):
            values.append(np.nextafter(values[-1], np.float32(1)))
        strip = greys(np.concatenate(values))
        width = strip.samples.shape[1]
        light = run(kernel, stack_rules(1), [strip], width, 1).samples
        result = run(kernel, stack_rules(1), [strip], width, 1, kind)
        assert result.losses == Losses()
        expected = to_straight_srgb(light, OUTPUT_TYPES[kind], Losses())
        off = (result.samples != expected).any(axis=2)
        # Opaque: nothing is divided, and only the rounded edge itself can be on the other side.
        assert np.isin(light[off][:, 0], edges).all()
        assert_codes(result.samples, light)

    def test_every_8_bit_pixel_comes_back(self):
        color, alpha = np.meshgrid(np.arange(256), np.arange(256))
        samples = np.stack([color, 255 - color, color ^ 85, alpha], axis=-1).astype(np.uint8)
        decoding = Decoding(SRGB_ENCODING, "straight", stored_straight=True)
        result = assert_same(stack_rules(1), [Strip(samples, decoding)], 256, 256, "uint8")
        assert np.array_equal(result.samples[1:], samples[1:])
        assert not result.samples[0].any()
        assert result.losses == Losses()

    def test_every_16_bit_code_comes_back(self):
        color = np.arange(65536, dtype=np.uint16)
        for alpha in (65535, 65534, 32768, 257, 2, 1):
            samples = np.stack([color, color[::-1], color ^ 21845, np.full_like(color, alpha)], -1)
            strip = Strip(samples[None], Decoding(SRGB_ENCODING, "straight", stored_straight=True))
            result = run(kernel, stack_rules(1), [strip], 65536, 1, "uint16")
            assert np.array_equal(result.samples[0], samples)
            assert result.losses == Losses()

    @pytest.mark.pairwise
    @pytest.mark.parametrize("space", SPACES)
    @pytest.mark.parametrize("kind", ["uint8", "uint16"])
    @pytest.mark.parametrize("order", ORDERS)
    def test_labels_on_the_edge_of_the_gamut_stay_in_it(self, order, kind, space):
        """Rounding alone does not make a warning, however thin the layers are."""
        layers = layers_of_labels(4, 10, 1100, seed=9)
        layers[..., :3] = np.clip(layers[..., :3], 0, layers[..., 3:])
        for op in ("over", "atop", "xor", "dst-over"):
            for opacity in (1.0, 0.3, 1 / 255):
                rules = stack_rules(4, op=op, order=order, opacity=opacity, space=space)
                assert run_arrays(kernel, rules, layers, kind).losses == Losses()

    @pytest.mark.parametrize("space", ["hsl", "oklab", "cielab"])
    @pytest.mark.parametrize("order", ORDERS)
    def test_channels_stay_within_what_the_terms_allow(self, order, space):
        layers = layers_of_labels(4, 10, 1100, seed=5)
        layers[..., :3] = np.clip(layers[..., :3], 0, layers[..., 3:])
        for op in ("over", "plus"):
            rules = stack_rules(4, op=op, order=order, space=space)
            found = run_arrays(kernel, rules, layers).samples
            most = found[..., 3:] if op == "over" else layers[..., 3].sum(axis=0)[..., None]
            assert found.min() >= -np.finfo(np.float32).eps
            assert (found[..., :3] <= most + 4 * np.finfo(np.float32).eps * most).all()

    @pytest.mark.parametrize("space", SPACES)
    @pytest.mark.parametrize("grey", [0.0, 1e-12, 0.2, 0.75, 1.0, 3e7])
    def test_greys_stay_grey_in_every_space(self, space, grey):
        layers = np.zeros((3, 1, 700, 4), np.float32)
        layers[..., 3] = 0.5
        layers[..., :3] = (grey * np.random.default_rng(1).random((3, 1, 700, 1))).astype(np.float32)
        rules = stack_rules(3, space=space, background=(0.5, 0.5, 0.5))
        red, green, blue = np.moveaxis(run_arrays(kernel, rules, layers).samples, -1, 0)[:3]
        assert np.array_equal(red, green)
        assert np.array_equal(green, blue)


# ---- bytes -------------------------------------------------------------------------------------


def everything_made(layers, rules):
    """What the kernel gives in all four kinds."""
    return [run_arrays(kernel, rules, layers, kind).everything for kind in OUTPUT_TYPES]


class TestBytes:
    """They depend neither on the processor nor on how the work is divided."""

    LAYERS = layers_of_labels(4, 3, 700)
    BROKEN = broken(LAYERS)

    def test_levels(self):
        assert kernel.levels()[0] == "baseline"
        assert len(set(kernel.levels())) == len(kernel.levels())

    @pytest.mark.pairwise
    @pytest.mark.parametrize("layers", ["LAYERS", "BROKEN"])
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("op", ["over", "plus", "xor", "dst-atop"])
    def test_not_on_the_instruction_set(self, monkeypatch, op, order, layers):
        layers = getattr(self, layers)
        for rules in (
            stack_rules(4, op=op, order=order),
            stack_rules(4, op=op, order=order, background=(0.1, 0.2, 0.9), exposure=0.3,
                        opacity=0.7, hue_tolerance=0),
            stack_rules(4, op=op, order=order, gray_bias=0.37),
            stack_rules(4, op=op, blending="foremost", background=(0.1, 0.2, 0.9)),
            *(stack_rules(4, op=op, order=order, space=space, background=(0.1, 0.2, 0.9))
              for space in ("hsl", "oklab", "cielab")),
        ):  # fmt: skip
            fastest = everything_made(layers, rules)
            for level in kernel.levels():
                monkeypatch.setenv(kernel.LEVEL_VARIABLE, level)
                assert everything_made(layers, rules) == fastest, level
            monkeypatch.delenv(kernel.LEVEL_VARIABLE)

    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float16])
    def test_not_on_the_instruction_set_for_stored_samples(self, monkeypatch, dtype):
        """Of the floats, every bit pattern of a half."""
        bits = np.arange(65536, dtype=np.uint16)
        if dtype == np.float16:
            samples = np.random.default_rng(1).permutation(np.repeat(bits, 4)).view(np.float16)
        else:
            samples = np.repeat(bits, 4).astype(dtype)
        encoding = ColorEncoding(LINEAR if dtype == np.float16 else SRGB, PRIMARIES["rec2020"])
        strip = Strip(
            samples.reshape(64, 1024, 4), Decoding(encoding, "straight", stored_straight=True)
        )
        for kind in OUTPUT_TYPES:
            made = set()
            for level in kernel.levels():
                monkeypatch.setenv(kernel.LEVEL_VARIABLE, level)
                result = run(kernel, stack_rules(1), [strip], 1024, 64, kind)
                made.add((result.samples.tobytes(), repr(result.losses), *result.nonfinite))
            assert len(made) == 1

    def test_a_level_that_there_is_not_is_an_error_that_lists_the_valid_ones(self, monkeypatch):
        monkeypatch.setenv(kernel.LEVEL_VARIABLE, "v9")
        with pytest.raises(ValueError, match=r"v9.*baseline"):
            kernel.ENGINE.start(stack_rules(1), 1, 1)

    @pytest.mark.parametrize("space", ["linear-rgb", "oklab"])
    @pytest.mark.parametrize("order", ORDERS)
    def test_not_on_how_many_layers_are_added_at_once(self, order, space):
        layers = layers_of_labels(7, 2, 600)
        rules = stack_rules(7, order="2,0,3,1,6,5,4" if "," in order else order, space=space)
        one_by_one = run_arrays(kernel, rules, layers)
        for at_once in (2, 3, 7):
            together = run_arrays(kernel, rules, layers, at_once=at_once)
            assert together.everything == one_by_one.everything

    @pytest.mark.pairwise
    @pytest.mark.parametrize("space", ["linear-rgb", "hsl", "oklab", "cielab"])
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("kind", OUTPUT_TYPES)
    def test_not_on_the_strip(self, order, kind, space):
        """Nor on where in a row or a block a pixel lies."""
        layers = self.BROKEN
        rules = stack_rules(4, order=order, background=(0.2, 0.9, 0.1), space=space)
        whole = run_arrays(kernel, rules, layers, kind)
        for cuts in ([1, 2], [1], [2]):
            parts = [
                run_arrays(kernel, rules, part, kind) for part in np.split(layers, cuts, axis=1)
            ]
            joined = np.concatenate([part.samples for part in parts])
            assert joined.tobytes() == whole.samples.tobytes()
            total = Losses()
            for part in parts:
                total.add(part.losses)
            assert total == whole.losses
            counts = np.sum([part.nonfinite for part in parts], axis=0)
            assert counts.tolist() == whole.nonfinite
        for cuts in ([1, 16, 17, 32], [511, 512, 513], [15, 31, 600]):
            parts = [
                run_arrays(kernel, rules, part, kind).samples
                for part in np.split(layers, cuts, axis=2)
            ]
            assert np.concatenate(parts, axis=1).tobytes() == whole.samples.tobytes()

    @pytest.mark.parametrize("order", ["bottom-up", "simultaneous"])
    def test_not_on_other_threads(self, order):
        rules = stack_rules(4, order=order)
        stacks = [layers_of_labels(4, 8, 1100, seed) for seed in range(4)]
        alone = [run_arrays(kernel, rules, layers, "uint8").everything for layers in stacks]
        with ThreadPoolExecutor(4) as pool:
            together = pool.map(
                lambda layers: run_arrays(kernel, rules, layers, "uint8").everything, stacks * 4
            )
            assert list(together) == alone * 4

    def test_inputs_are_left_as_they_are(self):
        layers = self.BROKEN.copy()
        for order in ORDERS:
            run_arrays(kernel, stack_rules(4, order=order), layers, "uint8")
        assert layers.tobytes() == self.BROKEN.tobytes()


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Layers of every kind that can be read row by row, one of them placed beyond the edges."""
    folder = tmp_path_factory.mktemp("layers")
    width, height = 70, 23
    for number, depth in enumerate((8, 16)):
        png = pngfile.random_png(pngfile.RGBA, depth, width=width, height=height)
        (folder / f"{number}.png").write_bytes(png.encode())
    exrfile.write(
        folder / "2.exr",
        exrfile.rgba(60, 30),
        origin=(-8, 5),
        display=(0, 0, width, height),
        compression="zips",
    )
    exrfile.write(folder / "3.exr", exrfile.rgba(width, height, np.float32, 1), compression="none")
    layers = [str(folder / name) for name in ("0.png", "1.png", "2.exr", "3.exr")]
    layers[1] += "::opacity=0.6"
    layers[3] += "::op=atop"
    return layers


class TestStackBytes:
    @pytest.mark.filterwarnings("ignore::hpcomp.HpcompWarning")
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("ending", ["png", "exr"])
    def test_depend_on_nothing_but_the_stack(
        self, tmp_path, files, monkeypatch, caplog, order, ending
    ):
        """Levels, strips, threads and layers at once, all against one run as it is."""
        layers = files if "," in order else files * 3
        caplog.set_level(logging.INFO, "hpcomp")
        hpcomp.stack(layers, tmp_path / f"plain.{ending}", order=order)
        plain = (tmp_path / f"plain.{ending}").read_bytes()
        cases = itertools.product((1, 7, 23), (1, 2), (1, 3, 12), [kernel.levels()[-1]])
        for rows, threads, at_once, level in [
            *cases,
            *((7, 2, 8, level) for level in kernel.levels()),
        ]:
            monkeypatch.setattr(memory, "STRIP_ROWS", rows)
            for module in (budget, strip_pass):
                monkeypatch.setattr(module, "LAYERS_AT_ONCE", at_once)
            monkeypatch.setenv(kernel.LEVEL_VARIABLE, level)
            caplog.clear()
            out = tmp_path / f"out.{ending}"
            hpcomp.stack(layers, out, order=order, threads=threads)
            assert out.read_bytes() == plain, (rows, threads, at_once, level)
            said = re.search(r"in strips of (\d+) rows, (\d+) threads, engine kernel", caplog.text)
            assert said is not None
            assert [int(number) for number in said.groups()] == [rows, threads]


# ---- the binding -------------------------------------------------------------------------------


def make_accumulator(rules=None, width=3, height=2, level="", place=(), **changed):
    return _kernel.Accumulator(
        rules=rules or make_rules(**changed),
        width=width,
        height=height,
        **{"left": 0, "top": 0, "phases": None, **dict(place)},
        level=level,
    )


BALANCED, SIMULTANEOUS = _kernel.Order.BALANCED, _kernel.Order.SIMULTANEOUS
#: What is no choice: numbers, names, and members of other enums.
NO_CHOICES = (-1, 0, 1, 2**31, None, "over", "BOTTOM_UP", 1.5, _kernel.Losses)
CODES = {"matrix": None, "luminance_weights": [0.2, 0.7, 0.1]}
CODES_8 = kernel.code_tables(np.dtype(np.uint8))
CODES_16 = kernel.code_tables(np.dtype(np.uint16))


def full(**changed):
    """An accumulator that both its layers have come to."""
    accumulator = make_accumulator(permutation=[1, 0], **changed)
    turns = [1, 0] if changed.get("order") == FRONT_TO_BACK else [0, 1]
    accumulator.add(numbers=turns, layers=[make_layer(), make_layer()])
    return accumulator


def out(dtype=np.float32, height=2, width=3, channels=4):
    return np.zeros((height, width, channels), dtype)


def make_codes(tables=CODES_8, **changed):
    """`_kernel.codes` of a depth, but for what is changed."""
    return _kernel.codes(
        **{**tables, **CODES, "space": make_maps(), **changed}
    )


WRONG_SHAPES = ((), (4,), (2, 4), (2, 3, 4, 1), (2, 3, 0), (2, 3, 5))
NO_COORDINATES = (2**30 + 1, -(2**30) - 1, 2**31, -(2**31), 2**63, -(2**64), 1.5, None, "1")
TILE = np.array([[2, 0], [3, 1]], np.uint16)
TABLE_8, TABLE_16 = np.zeros(256, np.float32), np.zeros(65536, np.float32)

BAD_TABLES = {
    "none": None,
    "short": TABLE_8[:255],
    "long": TABLE_16,
    "empty": TABLE_8[:0],
    "doubles": TABLE_8.astype(np.float64),
    "big-endian": TABLE_8.astype(">f4"),
    "two-dimensional": TABLE_8[:, None],
    "every other": np.zeros(512, np.float32)[::2],
    "backwards": TABLE_8[::-1],
    "codes": TABLE_8.astype(np.uint16),
    "a list": [0.0] * 256,
    "unaligned": unaligned(np.float32, (256,)),
}
BAD_THRESHOLDS = {
    **BAD_TABLES,
    "zeros": TABLE_8,
    "from high to low": np.ascontiguousarray(CODES_8["thresholds"][::-1]),
    "one twice": np.concatenate(
        [CODES_8["thresholds"][:1], CODES_8["thresholds"][:-2], [np.inf]], dtype=np.float32
    ),
    "one NaN": np.where(np.arange(256) == 7, np.nan, CODES_8["thresholds"]).astype(np.float32),
    "none infinite": np.arange(1, 257, dtype=np.float32),
    "negative": np.append(np.arange(-5, 250), np.inf).astype(np.float32),
}
BAD_FIRST_CODES = {
    "none": None,
    "short": CODES_8["first_code"][:-1],
    "long": np.append(CODES_8["first_code"], CODES_8["first_code"][-1]),
    "one beyond": CODES_8["first_code"] + np.uint16(1),
    "largest": np.full_like(CODES_8["first_code"], 65535),
    "floats": CODES_8["first_code"].astype(np.float32),
    "signed": CODES_8["first_code"].astype(np.int16),
    "backwards": CODES_8["first_code"][::-1],
    "unaligned": unaligned(np.uint16, CODES_8["first_code"].shape),
}


class TestBinding:
    """Nothing that Python can pass reads or writes out of bounds: it is refused."""

    @pytest.mark.parametrize("dtype", WRONG_TYPES)
    def test_samples_of_another_type(self, dtype):
        with refused():
            make_layer(np.zeros((2, 3, 4), dtype))

    @pytest.mark.parametrize("shape", WRONG_SHAPES, ids=str)
    def test_samples_of_another_shape(self, shape):
        with refused():
            make_layer(np.zeros(shape, np.float32))

    @pytest.mark.parametrize("stride", STRIDED)
    def test_samples_whose_rows_are_not_one_run(self, stride):
        with refused():
            make_layer(STRIDED[stride](np.zeros((2, 3, 4), np.float32)))

    @pytest.mark.parametrize("samples", [None, [[[0.0] * 4]], b"0123", 1.0, object()], ids=lambda samples: type(samples).__name__)
    def test_samples_that_are_no_array(self, samples):
        with refused():
            _kernel.layer(**{**ARGUMENTS_OF_A_LAYER, "samples": samples})

    @pytest.mark.parametrize(
        ("dtype", "table"), [(np.float32, None), (np.float16, None), (np.uint16, TABLE_16)]
    )
    def test_samples_that_are_not_aligned(self, dtype, table):
        with refused():
            make_layer(unaligned(dtype, (2, 3, 4)), table)

    def test_too_many_rows_or_columns(self):
        with refused():
            make_layer(np.zeros((0, 2**31, 4), np.float32))
        with refused():
            make_layer(np.broadcast_to(np.zeros((1, 1, 4), np.float32), (2**31, 1, 4)))

    @pytest.mark.parametrize("table", BAD_TABLES)
    def test_decode_table(self, table):
        with refused():
            make_layer(np.zeros((2, 3, 4), np.uint8), BAD_TABLES[table])

    def test_decode_table_of_8_bits_for_16(self):
        with refused():
            make_layer(np.zeros((2, 3, 4), np.uint16), TABLE_8)

    @pytest.mark.parametrize("value", NO_COORDINATES)
    @pytest.mark.parametrize("axis", ["left", "top"])
    def test_coordinates(self, axis, value):
        with refused():
            make_layer(**{axis: value})

    @pytest.mark.parametrize("value", [*NO_CHOICES, BOTTOM_UP], ids=str)
    @pytest.mark.parametrize("factor", ["factor_a", "factor_b"])
    def test_factors(self, factor, value):
        with refused():
            make_layer(**{factor: value})

    @pytest.mark.parametrize(
        "opacity", [-0.1, 1.1, math.nan, math.inf, -math.inf, 1e300, None, "1"]
    )
    def test_opacity(self, opacity):
        with refused():
            make_layer(opacity=opacity)

    @pytest.mark.parametrize(
        "matrix", [[1.0] * 6, [[1.0, 2.0]] * 2, [[None] * 2] * 3, np.eye(3)], ids=len
    )
    def test_matrix(self, matrix):
        with refused():
            make_layer(matrix=matrix)

    @pytest.mark.parametrize("order", [*NO_CHOICES, _kernel.Factor.ONE], ids=str)
    def test_unknown_order(self, order):
        with refused():
            make_rules(order=order)
        with refused():
            _kernel.scratch_bytes(order=order, layers=3)

    @pytest.mark.parametrize("blending", [*NO_CHOICES, BOTTOM_UP], ids=str)
    def test_unknown_blending(self, blending):
        with refused():
            make_rules(blending=blending)

    @pytest.mark.parametrize("order", [order for order in ALL_ORDERS if order is not BOTTOM_UP])
    def test_the_foremost_is_found_from_the_bottom_up_alone(self, order):
        make_rules(blending=_kernel.Blending.FOREMOST)
        with refused():
            make_rules(blending=_kernel.Blending.FOREMOST, order=order, permutation=[1, 0])

    @pytest.mark.parametrize("gray_bias", [-0.1, 1.1, np.nan, np.inf, None])
    def test_gray_bias(self, gray_bias):
        with refused():
            make_rules(gray_bias=gray_bias)

    @pytest.mark.parametrize("layers", [0, -1, 2**20 + 1, 2**31, None, 1.5])
    def test_number_of_layers(self, layers):
        with refused():
            make_rules(layers=layers)

    @pytest.mark.parametrize(
        "permutation",
        [[], [0], [0, 0], [0, 2], [-1, 0], [0, 1, 1], [0, 1, 2], [0, 2**31], None, [None, 0]],
        ids=str,
    )
    def test_permutation(self, permutation):
        with refused():
            make_rules(order=PERMUTATION, permutation=permutation)

    @pytest.mark.parametrize(
        ("what", "value"),
        [("luminance", None), ("luminance", [0.1]), ("p", [0.1]), ("p", [0.1] * 3), ("p", None),
         ("lo", None), ("hi", "1")],
        ids=str,
    )  # fmt: skip
    def test_background(self, what, value):
        with refused():
            make_background(**{what: value})

    @pytest.mark.parametrize("background", [0, [0.1, 0.2, 0.3], (0.1, [0.2, 0.3])], ids=str)
    def test_what_is_no_background(self, background):
        with refused():
            make_rules(background=background)

    @pytest.mark.parametrize("kind", ROWS_OF_MAPS)
    def test_maps_of_a_space(self, kind):
        for name, rows in ROWS_OF_MAPS[kind].items():
            for wrong in (
                None, [], [[0.5] * 2] * (rows - 1), [[0.5] * 2] * (rows + 1), [[0.5] * 3] * rows,
                [[0.5]] * rows, [0.5] * 2 * rows, [[None] * 2] * rows,
            ):  # fmt: skip
                with refused():
                    make_maps(kind, **{name: wrong})
        for weight in ("weight_red", "weight_blue"):
            with refused():
                make_maps(kind, **{weight: None})

    @pytest.mark.parametrize("space", [None, 0, "linear-rgb", [[1.0] * 2] * 2], ids=str)
    def test_what_are_no_maps(self, space):
        with refused():
            make_rules(space=space)

    @pytest.mark.parametrize("kind", ["oklab", "cielab"])
    @pytest.mark.parametrize("bound", [0.0, -1.0, math.nan, None])
    def test_bound_of_a_space(self, kind, bound):
        make_maps(kind)
        with refused():
            make_maps(kind, inverse_largest=bound)

    def test_objects_without_content(self):
        kinds = (
            _kernel.Layer, _kernel.Rules, _kernel.Accumulator, _kernel.SpaceMaps, _kernel.Background,
            _kernel.Codes, _kernel.Measures, _kernel.Provenance, _kernel.Competition, _kernel.Weave,
        )  # fmt: skip
        for kind in kinds:
            with refused():
                kind()

    @pytest.mark.parametrize(
        "changed",
        [
            *({"counts": np.array(counts)} for counts in ([3], [3, 3], [-1, 6], [2**62, 2**62], [[3, 2]], [3.0, 2.0])),
            *({"p": p} for p in (np.ones((5, 2)), np.ones(5), np.ones((2, 5), np.float32), np.ones((2, 10))[:, ::2])),
            *({"kept": kept} for kept in (np.zeros(4), np.zeros((1, 5)), np.zeros(5, np.float32), None)),
            {"p": unaligned("f8", (2, 5))}, {"kept": unaligned("f8", (5,))},
            {"counts": unaligned("i8", (2,))}, {"rules": None},
            {"rules": make_rules(blending=_kernel.Blending.FOREMOST)},
            {"rules": make_rules(order=_kernel.Order.WOVEN)},
            *({"strengths": m} for m in (np.zeros(4), np.zeros((1, 5)), np.zeros(5, np.float32))),
            {"strengths": unaligned("f8", (5,))},
        ],
        ids=lambda changed: next(iter(changed)),
    )  # fmt: skip
    def test_runs(self, changed):
        right = {
            "rules": make_rules(), "counts": np.array([3, 2]), "p": np.ones((2, 5)),
            "strengths": np.ones(5), "kept": np.empty(5),
        }  # fmt: skip
        _kernel.keep_runs(**right)
        with refused():
            _kernel.keep_runs(**{**right, **changed})

    def test_keywords_alone_are_taken(self):
        """No argument has a place, none is left out, and none is of another name."""
        calls = {
            _kernel.layer: {**ARGUMENTS_OF_A_LAYER, "samples": np.zeros((2, 3, 4), np.float32)},
            _kernel.background: BACKGROUND,
            _kernel.codes: {**CODES_8, **CODES, "space": make_maps()},
            _kernel.scratch_bytes: {"order": BALANCED, "layers": 3},
            _kernel.run_bytes: {"terms": 3},
            _kernel.keep_runs: {
                "rules": make_rules(), "counts": np.array([3, 0, 2]), "p": np.ones((2, 5)),
                "strengths": None, "kept": np.empty(5),
            },
            _kernel.competition: {
                "strength": _kernel.Strength.PERCEIVED, "oklab": make_maps("oklab"), "half_chroma": 0.1,
            },
            _kernel.weave: {"pattern": _kernel.Pattern.STRIPES, "size": 8, "tile": None},
        }
        for call, arguments in calls.items():
            call(**arguments)
            with refused():
                call(*arguments.values())
            with refused():
                call(**arguments, more=0)
            for name in arguments:
                with refused():
                    call(**{other: value for other, value in arguments.items() if other != name})

    @pytest.mark.parametrize(
        ("width", "height"),
        [(0, 1), (1, 0), (-1, 1), (1, -1), (2**31, 1), (1, 2**63), (2**30, 2**30), (1.5, 1)],
    )
    def test_size_of_a_strip(self, width, height):
        with refused():
            make_accumulator(width=width, height=height)

    @pytest.mark.parametrize("place", NO_COORDINATES)
    def test_place_of_a_strip(self, place):
        make_accumulator(place={"left": -(2**29), "top": 2**29})
        for side in ("left", "top"):
            with refused():
                make_accumulator(place={side: place})

    @pytest.mark.parametrize(
        "changed",
        [
            {"pattern": None}, {"pattern": 0}, {"size": 0}, {"size": 2**21}, {"size": 1.5},
            {"pattern": _kernel.Pattern.NOISE}, {"tile": TILE},
            *(
                {"pattern": _kernel.Pattern.NOISE, "tile": tile}
                for tile in (
                    TILE[:1], TILE[0], TILE[:0, :0], TILE.astype(np.int16), TILE + np.uint16(1),
                    np.zeros((257, 257), np.uint16), unaligned("u2", (2, 2)), [[0, 1], [2, 3]],
                )
            ),
        ],
        ids=lambda changed: next(iter(changed)),
    )  # fmt: skip
    def test_what_is_no_weave(self, changed):
        make_weave(), make_weave(pattern=_kernel.Pattern.NOISE, tile=TILE)
        with refused():
            make_weave(**changed)

    @pytest.mark.parametrize(
        "changed",
        [
            {"order": _kernel.Order.WOVEN, "weave": None},
            {"order": _kernel.Order.WOVEN, "blending": _kernel.Blending.TRADITIONAL},
            {"blending": _kernel.Blending.WOVEN, "weave": make_weave()},
            {"weave": make_weave()}, {"competition": make_weave()}, {"weave": 8},
        ],
        ids=lambda changed: next(iter(changed)),
    )  # fmt: skip
    def test_what_are_no_rules_of_a_weave(self, changed):
        make_rules(order=_kernel.Order.WOVEN)
        with refused():
            make_rules(**changed)

    @pytest.mark.parametrize(
        "changed",
        [
            {"strength": None}, {"strength": 1}, {"oklab": None}, {"oklab": make_maps("cielab")},
            {"half_chroma": 0.0}, {"half_chroma": math.nan}, {"half_chroma": None},
        ],
        ids=lambda changed: next(iter(changed)),
    )  # fmt: skip
    def test_what_is_no_competition(self, changed):
        make_competition()
        with refused():
            make_competition(**changed)

    def test_memory_that_there_is_not(self):
        # Layers that come one by one are folded into planes of the whole strip.
        accumulator = make_accumulator(width=2**26, height=2**26)
        with pytest.raises(MemoryError):
            accumulator.add(numbers=[0], layers=[make_layer()])

    def test_strip_without_rules_or_level(self):
        with refused():
            _kernel.Accumulator(
                rules=None, width=1, height=1, left=0, top=0, phases=None, level=""
            )
        for level in ("v9", None, 0):
            with refused():
                make_accumulator(level=level)

    @pytest.mark.parametrize("layer", [np.zeros((2, 3, 4), np.float32), 0], ids=type)
    @pytest.mark.parametrize("order", ALL_ORDERS)
    def test_layers_that_are_none(self, order, layer):
        for layers in ([layer, make_layer()], [make_layer(), layer], [layer, layer]):
            accumulator = make_accumulator(order=order, permutation=[1, 0])
            with refused():
                accumulator.add(
                    numbers=[1, 0] if order == FRONT_TO_BACK else [0, 1], layers=layers
                )

    @pytest.mark.parametrize("order", ALL_ORDERS)
    def test_a_layer_that_is_absent(self, order):
        """None above the bottom is one that is transparent all over; the bottom is needed."""

        def made(layers):
            accumulator = make_accumulator(order=order, permutation=[1, 0])
            turns = [1, 0] if order == FRONT_TO_BACK else [0, 1]
            accumulator.add(numbers=turns, layers=[layers[number] for number in turns])
            out = np.empty((2, 3, 4), np.float32)
            accumulator.result(out=out, codes=None)
            return out

        bottom = np.random.default_rng(2).random((2, 3, 4), np.float32)
        clear = make_layer(np.zeros((2, 3, 4), np.float32))
        expected = made([make_layer(bottom), clear])
        assert expected.any()
        assert np.array_equal(made([make_layer(bottom), None]), expected)
        for layers in ([None, make_layer()], [None, None]):
            with refused():
                made(layers)

    @pytest.mark.parametrize("order", ALL_ORDERS)
    def test_numbers_and_layers_that_do_not_pair(self, order):
        layer = make_layer()
        for numbers, layers in (
            ([0], [layer, layer]),
            ([0, 1], [layer]),
            ([0], []),
            ([], [layer]),
            ([None], [layer]),
            ([0], None),
            (None, [layer]),
            (None, None),
        ):
            with refused():
                make_accumulator(order=order, permutation=[1, 0]).add(numbers=numbers, layers=layers)

    @pytest.mark.parametrize("order", ALL_ORDERS)
    def test_layers_out_of_turn(self, order):
        right = [1, 0] if order == FRONT_TO_BACK else [0, 1]
        for numbers in (
            [-1], [2], [2**31], [0, 0], [1, 1], right[1:], right[::-1], [*right, 0], [*right, 2],
        ):  # fmt: skip
            with refused():
                make_accumulator(order=order, permutation=[1, 0]).add(
                    numbers=numbers, layers=[make_layer()] * len(numbers)
                )
        for number in (-1, 0, 1, 2):
            with refused():
                full(order=order).add(numbers=[number], layers=[make_layer()])

    @pytest.mark.parametrize("order", ALL_ORDERS)
    def test_result_before_all_layers_have_come(self, order):
        accumulator = make_accumulator(order=order, permutation=[1, 0])
        with refused():
            accumulator.result(out=out(), codes=None)
        accumulator.add(numbers=[1 if order == FRONT_TO_BACK else 0], layers=[make_layer()])
        with refused():
            accumulator.result(out=out(), codes=None)

    @pytest.mark.parametrize("dtype", WRONG_TYPES)
    def test_out_of_another_type(self, dtype):
        with refused():
            full().result(out=out(dtype), codes=None)

    @pytest.mark.parametrize(
        "shape",
        [*WRONG_SHAPES, (2, 3, 3), (3, 2, 4), (1, 3, 4), (2, 4, 4), (24,), (0, 3, 4)],
        ids=str,
    )
    def test_out_of_another_shape(self, shape):
        with refused():
            full().result(out=np.zeros(shape, np.float32), codes=None)

    @pytest.mark.parametrize("stride", STRIDED)
    def test_out_that_is_not_one_run(self, stride):
        """A copy would be filled, and the result lost without a word."""
        with refused():
            full().result(out=STRIDED[stride](out()), codes=None)

    def test_out_whose_rows_are_not_one_run(self):
        for rows in (out()[::-1], out(height=4)[::2]):
            with refused():
                full().result(out=rows, codes=None)

    def test_out_that_cannot_be_written(self):
        with refused():
            full().result(out=np.frombuffer(bytes(96), np.float32).reshape(2, 3, 4), codes=None)
        for nothing in (None, [[[0.0] * 4] * 3] * 2, bytes(96)):
            with refused():
                full().result(out=nothing, codes=None)

    @pytest.mark.parametrize(
        ("dtype", "tables"), [(np.float32, None), (np.float16, None), (np.uint16, CODES_16)]
    )
    def test_out_that_is_not_aligned(self, dtype, tables):
        codes = None if tables is None else make_codes(tables)
        with refused():
            full().result(out=unaligned(dtype, (2, 3, 4)), codes=codes)

    def test_codes_of_another_depth(self):
        for dtype, codes in (
            (np.uint8, None),
            (np.uint8, make_codes(CODES_16)),
            (np.uint16, None),
            (np.uint16, make_codes(CODES_8)),
            (np.float16, make_codes(CODES_16)),
            (np.float32, make_codes(CODES_8)),
            (np.uint8, CODES_8),
            (np.uint8, 8),
        ):
            with refused():
                full().result(out=out(dtype), codes=codes)

    @pytest.mark.parametrize("table", BAD_THRESHOLDS)
    def test_thresholds(self, table):
        with refused():
            make_codes(thresholds=BAD_THRESHOLDS[table])

    @pytest.mark.parametrize("table", BAD_FIRST_CODES)
    def test_first_codes(self, table):
        with refused():
            make_codes(first_code=BAD_FIRST_CODES[table])

    @pytest.mark.parametrize("bits", [-1, 0, 6, 8, 17, 31, 32, 64, 2**31, None])
    def test_bucket_bits(self, bits):
        with refused():
            make_codes(bucket_bits=bits)

    @pytest.mark.parametrize("limit", ["lowest", "darkest", "highest", "smallest"])
    def test_limits(self, limit):
        for wrong in (None, [0.5], "0.5"):
            with refused():
                make_codes(**{limit: wrong})

    def test_tables_of_codes_are_copied(self):
        """What is changed after it was checked would lead out of bounds."""
        tables = {name: np.copy(CODES_8[name]) for name in ("thresholds", "first_code")}
        codes, made = make_codes(**tables), [out(np.uint8), out(np.uint8)]
        full().result(out=made[0], codes=codes)
        tables["thresholds"][:] = 0
        tables["first_code"][:] = 65535
        full().result(out=made[1], codes=codes)
        assert np.array_equal(*made)

    @pytest.mark.parametrize("weights", [None, [], [0.1] * 2, [0.1] * 4, [None] * 3], ids=str)
    def test_luminance_weights(self, weights):
        with refused():
            make_codes(luminance_weights=weights)

    @pytest.mark.parametrize(
        "matrix", [[1.0] * 6, [[1.0, 2.0]] * 2, [[None] * 2] * 3, np.eye(3)], ids=len
    )
    def test_matrix_of_codes(self, matrix):
        with refused():
            make_codes(matrix=matrix)

    @pytest.mark.parametrize(
        "smallest", [math.nan, math.inf, 1.0, 2.0, -0.5, 0.3, 2.0**-40, 2.0**-64, 1e-45]
    )
    def test_where_buckets_begin(self, smallest):
        with refused():
            make_codes(smallest=smallest)

    @pytest.mark.parametrize("order", ALL_ORDERS)
    def test_an_accumulator_survives_a_refusal(self, order):
        def added(numbers):
            return accumulator.add(numbers=numbers, layers=[make_layer(grey) for _ in numbers])

        grey = np.full((2, 3, 4), 0.5, np.float32)
        flat = make_maps(from_p=[[0.0] * 2] * 3)
        accumulator = make_accumulator(order=order, permutation=[1, 0], space=flat)
        first, second = (1, 0) if order == FRONT_TO_BACK else (0, 1)
        for wrong in ([first, first], [second], [7], [first, second, 0]):
            with pytest.raises(ValueError, match="layer"):
                added(wrong)
        added([first])
        with pytest.raises(ValueError, match="layer"):
            accumulator.result(out=out(), codes=None)
        added([second])
        with pytest.raises(ValueError, match="out"):
            accumulator.result(out=out(width=4), codes=None)
        made = out()
        accumulator.result(out=made, codes=None)
        assert np.array_equal(made, np.full_like(made, 0.75))

    @pytest.mark.parametrize("order", ALL_ORDERS)
    def test_a_second_result_is_the_same_or_refused(self, order):
        accumulator = full(order=order)
        first, second = out(), out()
        accumulator.result(out=first, codes=None)
        try:
            accumulator.result(out=second, codes=None)
        except ValueError:
            return
        assert np.array_equal(first, second)

    @pytest.mark.parametrize("kind", OUTPUT_TYPES)
    @pytest.mark.parametrize("width", [1, 3, 15, 16, 17, 511, 512, 513])
    def test_nothing_is_written_beside_the_picture(self, kind, width):
        dtype = np.dtype(OUTPUT_TYPES[kind])
        size = 2 * width * 4
        memory = np.full(size + 128, 99, dtype)
        made = memory[64:-64].reshape(2, width, 4)
        for order in ALL_ORDERS:
            accumulator = make_accumulator(width=width, order=order, permutation=[1, 0])
            layers = [make_layer(np.ones((2, width, 4), np.float32)) for _ in range(2)]
            accumulator.add(
                    numbers=[1, 0] if order == FRONT_TO_BACK else [0, 1], layers=layers
                )
            accumulator.result(out=made, codes=kernel._codes(dtype))
            assert (memory[:64] == 99).all()
            assert (memory[-64:] == 99).all()
            assert not (made == 99).any()

    def test_light_beyond_every_limit_stays_within_the_codes(self):
        """Whatever the limits of the gamut are said to be."""
        huge = np.full((2, 3, 4), 3e38, np.float32)
        for lowest, darkest, highest in itertools.product((-math.inf, 0.0, math.nan), repeat=3):
            codes = make_codes(lowest=lowest, darkest=darkest, highest=highest)
            for sign in (1, -1):
                accumulator = make_accumulator(layers=1, gain=16.0)
                accumulator.add(numbers=[0], layers=[make_layer(sign * huge)])
                made = out(np.uint8)
                try:
                    accumulator.result(out=made, codes=codes)
                except ValueError:
                    continue
                assert set(made[..., :3].ravel().tolist()) <= {0, 255}

    def test_layers_keep_their_arrays_alive(self):
        for order in (BOTTOM_UP, BALANCED, SIMULTANEOUS):
            accumulator = make_accumulator(width=1000, height=100, order=order)
            for number in range(2):
                samples = np.full((100, 1000, 4), 128, np.uint8)
                table = np.full(256, 0.25, np.float32)
                layer = make_layer(samples, table)
                del samples, table
                accumulator.add(numbers=[number], layers=[layer])
                del layer
                np.full((100, 1000, 4), 7, np.uint8)  # takes the place of what was freed
            made = out(height=100, width=1000)
            accumulator.result(out=made, codes=None)
            assert (made[..., 0] == made[0, 0, 0]).all()

    @pytest.mark.parametrize("dtype", WRONG_TYPES)
    def test_a_strip_of_another_type_is_refused(self, dtype):
        """Before anything is made for it: a table for 32-bit codes would fill the memory."""
        accumulator = kernel.ENGINE.start(stack_rules(1), 3, 2)
        with refused():
            accumulator.add([0], [Strip(np.zeros((2, 3, 4), dtype))])

    def test_strips_and_numbers_must_pair(self):
        strip = Strip(np.zeros((2, 3, 4), np.float32))
        with pytest.raises(ValueError, match="argument"):
            kernel.ENGINE.start(stack_rules(2), 3, 2).add([0, 1], [strip])
        for numbers in ([1], [-1], [0, 0], [1, 0]):
            with pytest.raises(ValueError, match="layer"):
                kernel.ENGINE.start(stack_rules(2), 3, 2).add(numbers, [strip] * len(numbers))


# ---- which engine ------------------------------------------------------------------------------


class TestChoice:
    @pytest.mark.parametrize(
        ("wanted", "active"),
        [("kernel", "kernel"), ("reference", "reference"), ("", "kernel")],
    )
    def test_version_says_which(self, wanted, active):
        done = command("--version", env={engine.VARIABLE: wanted})
        expected = f"hpcomp {hpcomp.__version__} (engine: {active})\n"
        assert (done.code, done.stdout.decode(), done.stderr) == (0, expected, "")

    @pytest.mark.parametrize("arguments", [["--version"], ["stack", "a.png", "-o", "b.png"]])
    @pytest.mark.parametrize("wanted", ["fast", "KERNEL", "kernel ", "numpy"])
    def test_an_unknown_one_is_a_usage_error_that_lists_the_valid_ones(
        self, tmp_path, wanted, arguments
    ):
        (tmp_path / "a.png").write_bytes(pngfile.random_png(pngfile.RGBA, 8).encode())
        done = command(*arguments, env={engine.VARIABLE: wanted}, cwd=tmp_path)
        assert (done.code, done.stdout) == (2, b"")
        assert done.lines[0].startswith("Usage: hpcomp")
        assert done.lines[1].startswith(f"hpcomp: error: unknown engine in {engine.VARIABLE}")
        for word in (f"'{wanted}'", *engine.NAMES):
            assert word in done.lines[1]
        assert len(done.lines) == 2
        assert not (tmp_path / "b.png").exists()

    def test_help_needs_no_engine(self):
        done = command("--help", env={engine.VARIABLE: "fast"})
        assert (done.code, done.stderr) == (0, "")

    @pytest.mark.parametrize("name", engine.NAMES)
    def test_the_stack_is_made_by_it(self, tmp_path, files, monkeypatch, caplog, name):
        monkeypatch.setenv(engine.VARIABLE, name)
        caplog.set_level(logging.INFO, "hpcomp")
        hpcomp.stack(files[:2], tmp_path / "out.png")
        assert f"engine {name}" in caplog.text

    def test_doubles_are_composited_in_doubles(self, monkeypatch):
        monkeypatch.setenv(engine.VARIABLE, "kernel")
        assert engine.start(stack_rules(1), 1, 1).__module__.startswith("hpcomp.kernel")
        in_doubles = engine.start(stack_rules(1), 1, 1, np.float64)
        assert type(in_doubles).__module__ == "hpcomp.engine.reference"

    def test_where_it_was_not_built(self, monkeypatch):
        """The reference takes its place, and asking for it says what to do."""
        monkeypatch.setattr(engine, "_kernel", lambda: None)
        monkeypatch.delenv(engine.VARIABLE, raising=False)
        engine._warn_of_the_missing_kernel.cache_clear()
        with pytest.warns(HpcompWarning, match="not built"):
            assert engine.active() is reference.ENGINE
        assert engine.active() is reference.ENGINE  # a second warning would be an error here
        monkeypatch.setenv(engine.VARIABLE, "kernel")
        with pytest.raises(SettingError, match=r"not built.*C\+\+ compiler"):
            engine.active()
        monkeypatch.setenv(engine.VARIABLE, "reference")
        assert engine.active() is reference.ENGINE


def test_the_kernel_knows_every_primary_that_there_is():
    """Its matrices are those of the reference, whatever the primaries."""
    samples = np.random.default_rng(6).random((2, 9, 3)).astype(np.float32)
    for primaries in PRIMARIES.values():
        decoding = Decoding(ColorEncoding(LINEAR, primaries), "straight", stored_straight=False)
        result = assert_same(stack_rules(1), [Strip(samples, decoding)], 9, 2)
        plain = run(kernel, stack_rules(1), [Strip(samples)], 9, 2)
        assert np.array_equal(result.samples, plain.samples) == (primaries is REC709)
