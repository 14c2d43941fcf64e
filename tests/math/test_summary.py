"""Findings of a stack: the kernel against the reference, parts against the whole, closed forms."""

from __future__ import annotations

import itertools
import math
from contextlib import nullcontext

import numpy as np
import pytest
from agreement import ENGINES, SUMS, TIES, assert_agree
from bindings import (
    MEASURED_ORDERS,
    STRIDED,
    WRONG_TYPES,
    make_background,
    make_layer,
    make_maps,
    make_rules,
    refused,
    unaligned,
)
from engines import CURVES, MODES, ORDERS, SOME_PRIMARIES, broken, layers_of_labels, strips_of
from strategies import BLENDING_NAMES, OPERATOR_NAMES, valid_color

from hpcomp.color.encodings import ColorEncoding
from hpcomp.color.primaries import REC709
from hpcomp.color.quantization import Losses
from hpcomp.color.samples import Decoding, Strip
from hpcomp.engine import choice as engine
from hpcomp.engine import reference
from hpcomp.errors import SettingError
from hpcomp.kernel import _kernel
from hpcomp.kernel import fused as kernel
from hpcomp.measures import labels as measures
from hpcomp.measures import summary
from hpcomp.measures.histogram import hue_histogram
from hpcomp.measures.summary import StripToMeasure
from hpcomp.options import stack_rules

LAYERS = layers_of_labels(4, 3, 700)

#: A background whose hue is not at a bin's edge, where rounding would choose the bin.
RED = 0.9, 0.1, 0.23


class TestAgreement:
    def test_the_layers_have_something_of_everything(self):
        found = assert_agree(stack_rules(4), strips_of(LAYERS), 700, 3)
        assert found.measures.order_sensitive > 20
        assert 20 < found.measures.traditional.foreign < found.measures.traditional.chromatic
        assert found.result.grey > 20
        assert all(layer.transparent > 20 for layer in found.layers)
        assert found.result.occupied > 100

    @pytest.mark.pairwise
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("blending", BLENDING_NAMES)
    @pytest.mark.parametrize("op", OPERATOR_NAMES)
    def test_operator_blending_order(self, op, blending, order):
        rules = stack_rules(4, op=op, blending=blending, order=order)
        assert_agree(rules, strips_of(LAYERS), 700, 3)

    @pytest.mark.parametrize("background", [None, RED, (0.5, 0.5, 0.5), (0, 0, 0)])
    @pytest.mark.parametrize("order", ORDERS)
    def test_background_opacity_exposure(self, order, background):
        rules = stack_rules(
            4, order=order, background=background, opacity=[0.25, 1.0, 0.0, 0.7], exposure=2.5
        )
        found = assert_agree(rules, strips_of(LAYERS), 700, 3)
        below = found.measures.result.background
        assert (below.pixels > 0) == (background == RED)

    @pytest.mark.parametrize("hue_tolerance", [0.0, 0.01, 0.5, 10.0, 90.0])
    @pytest.mark.parametrize("order", ORDERS)
    def test_hue_tolerance(self, order, hue_tolerance):
        rules = stack_rules(4, op="plus", order=order, hue_tolerance=hue_tolerance)
        assert_agree(rules, strips_of(LAYERS), 700, 3)

    @pytest.mark.parametrize("gray_bias", [0.1, 1.0])
    @pytest.mark.parametrize("order", ORDERS)
    def test_gray_bias(self, order, gray_bias):
        rules = stack_rules(4, op="xor", order=order, gray_bias=gray_bias, background=RED)
        assert_agree(rules, strips_of(LAYERS), 700, 3)

    @pytest.mark.parametrize("foreign_tolerance", [0.0, 1.0, 90.0, 180.0])
    @pytest.mark.parametrize("half_step", [0.0, measures.HALF_STEP_8_BIT, 0.1])
    def test_settings_of_measures(self, half_step, foreign_tolerance):
        layers = strips_of(LAYERS)
        if foreign_tolerance == 0:  # rounding decides about any two hues
            layers = layers[:1]
        rules = stack_rules(len(layers))
        found = assert_agree(
            rules, layers, 700, 3, half_step=half_step, foreign_tolerance=foreign_tolerance
        )
        if foreign_tolerance == 180:
            assert found.measures.traditional.foreign == 0

    @pytest.mark.parametrize("bins", [6, 359, 3600])
    @pytest.mark.parametrize("achromatic", [0.0, 0.5, 1.0])
    def test_bins_and_achromatic(self, achromatic, bins):
        found = assert_agree(
            stack_rules(4), strips_of(LAYERS), 700, 3, bins=bins, achromatic=achromatic
        )
        assert {h.bins for h in (*found.layers, found.result, found.traditional)} == {bins}
        if achromatic == 1:
            # Left are colours with a component below 0, or of 0 alone.
            assert found.result.grey > found.result.chromatic

    @pytest.mark.parametrize("order", [*ORDERS[:4], "shuffled"])
    @pytest.mark.parametrize("n_layers", [1, 2, 3, 5, 12])
    def test_any_number_of_layers(self, n_layers, order):
        rng = np.random.default_rng(n_layers)
        if order == "shuffled":
            order = rng.permutation(n_layers).tolist()
        ops = rng.choice(["over", "dst-over", "atop", "xor", "plus"], n_layers - 1).tolist()
        rules = stack_rules(n_layers, op=[None, *ops], order=order)
        assert_agree(rules, strips_of(layers_of_labels(n_layers, 2, 600)), 600, 2)

    @pytest.mark.parametrize("width", [1, 2, 15, 17, 511, 512, 513, 1025])
    def test_any_width(self, width):
        for order in ORDERS:
            rules = stack_rules(4, order=order, background=(0.1, 0.2, 0.3))
            layers = layers_of_labels(4, 3, width)
            assert_agree(rules, strips_of(layers), width, 3)

    @pytest.mark.parametrize("size", [1e-38, 1e-30, 1e-12, 1e12, 1e18, 1e30])
    @pytest.mark.parametrize("order", ORDERS)
    def test_colours_of_any_size(self, order, size):
        """Squares of them leave the range of the type; what is too bright is told apart."""
        layers = LAYERS * np.array([size] * 3 + [1], np.float32)
        found = assert_agree(stack_rules(4, order=order), strips_of(layers), 700, 3)
        assert (found.measures.unmeasured > 0) == (size >= 1e18)  # 2**60

    @pytest.mark.pairwise
    @pytest.mark.parametrize("zero", [False, True])
    @pytest.mark.parametrize("dtype", [np.float32, np.float16])
    @pytest.mark.parametrize("order", ORDERS)
    def test_pixels_that_are_not_finite(self, order, dtype, zero):
        with np.errstate(over="ignore"):
            layers = broken(LAYERS).astype(dtype)
        decoding = Decoding(
            ColorEncoding(CURVES[1], SOME_PRIMARIES[0]), "premultiplied", False, zero
        )
        strips = [Strip(layer, decoding) for layer in layers]
        found = assert_agree(stack_rules(4, order=order), strips, 700, 3)
        if zero:
            assert [layer.nonfinite for layer in found.layers] == [0] * 4
        else:
            assert min(layer.nonfinite for layer in found.layers) > 20
            assert found.measures.unmeasured > 200
            # What cannot be measured is a pixel of the picture all the same.
            assert found.result.nonfinite >= found.measures.unmeasured
        assert found.result.pixels == found.traditional.pixels == 2100

    def test_layers_of_nothing(self):
        nothing = np.zeros((3, 700, 4), np.float32)
        found = assert_agree(stack_rules(4), strips_of([nothing] * 4), 700, 3)
        assert found.result.transparent == 2100
        found = assert_agree(stack_rules(2), strips_of([nothing, -nothing]), 700, 3)
        assert found.traditional.transparent == 2100
        layers = [LAYERS[0], nothing, nothing, LAYERS[1]]
        found = assert_agree(stack_rules(4), strips_of(layers), 700, 3)
        assert found.measures.order_sensitive == 0

    @pytest.mark.parametrize("order", ORDERS)
    def test_layers_that_lie_partly_or_not_at_all_in_the_strip(self, order):
        places = list(itertools.product([-700, -650, -1, 0, 3, 512, 599, 600], [-3, -1, 0, 2, 4]))
        rng = np.random.default_rng(5)
        for chosen in rng.choice(len(places), (6, 4)):
            strips = [
                Strip(layer, left=places[place][0], top=places[place][1])
                for layer, place in zip(LAYERS, chosen, strict=True)
            ]
            found = assert_agree(stack_rules(4, order=order, op="xor"), strips, 600, 4)
            assert all(layer.pixels == 2400 for layer in found.layers)
        empty = Strip(np.zeros((0, 0, 4), np.float32))
        rules = stack_rules(4, order=order)
        assert_agree(rules, [empty, *strips_of(LAYERS[1:])], 700, 3)
        assert_agree(rules, [empty] * 4, 700, 3)

    @pytest.mark.pairwise
    @pytest.mark.parametrize("mode", MODES)
    @pytest.mark.parametrize("channels", [1, 2, 3, 4])
    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float16, np.float32])
    def test_samples_of_any_kind(self, dtype, channels, mode):
        rng = np.random.default_rng([channels, np.dtype(dtype).itemsize])
        values = rng.random((3, 2, 530, channels))
        if np.dtype(dtype).kind == "u":
            values *= np.iinfo(dtype).max
        for curve, primaries in itertools.product(CURVES[:2], SOME_PRIMARIES):
            decoding = Decoding(ColorEncoding(curve, primaries), mode, stored_straight=True)
            strips = [Strip(samples.astype(dtype), decoding) for samples in values]
            assert_agree(stack_rules(3, opacity=0.7), strips, 530, 2)


# ---- the same bytes ------------------------------------------------------------------------------


def everything(found):
    """Findings with provenance, to be compared with `==`."""
    measured, planes = found
    return measured, [plane.tobytes() for plane in vars(planes).values()]


@pytest.mark.parametrize("order", ORDERS)
def test_every_instruction_set_finds_the_same_bits(monkeypatch, order):
    rules = stack_rules(4, order=order, background=(0.2, 0.3, 0.1), opacity=0.8)
    settings = measures.measure_settings(rules)
    found = []
    for level in kernel.levels():
        monkeypatch.setenv(kernel.LEVEL_VARIABLE, level)
        found.append(
            [
                everything(
                    kernel.ENGINE.summary(StripToMeasure(rules, settings, 360, strips_of(layers), 700, 3, True))
                )
                for layers in (LAYERS, broken(LAYERS))
            ]
        )
    assert len(found) >= 1
    assert all(other == found[0] for other in found)
    monkeypatch.setenv(kernel.LEVEL_VARIABLE, "v9")
    with pytest.raises(SettingError, match="unknown instruction set"):
        kernel.ENGINE.summary(StripToMeasure(rules, settings, 360, strips_of(LAYERS), 700, 3))


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("order", ORDERS)
def test_parts_add_up_to_the_whole_exactly(name, order):
    by = ENGINES[name]
    rules = stack_rules(4, order=order, op="xor", background=(0.2, 0.3, 0.1))
    settings = measures.measure_settings(rules)
    layers = layers_of_labels(4, 37, 530)

    def found(rows, columns):
        strip = StripToMeasure(
            rules,
            settings,
            360,
            # As the pipeline places them: whole layers, of which a part lies in the strip.
            [Strip(layer, left=-columns.start, top=-rows.start) for layer in layers],
            columns.stop - columns.start,
            rows.stop - rows.start,
            True,
        )
        return by.summary(strip)

    whole, planes = found(slice(0, 37), slice(0, 530))
    for height, width in ((16, 530), (32, 530), (48, 530), (16, 96), (37, 1008)):
        total = summary.StackSummary.none(rules, settings, 360)
        for top, left in itertools.product(range(0, 37, height), range(0, 530, width)):
            place = slice(top, min(top + height, 37)), slice(left, min(left + width, 530))
            part, of_part = found(*place)
            total += part
            for whole_plane, plane in zip(
                vars(planes).values(), vars(of_part).values(), strict=True
            ):
                assert np.array_equal(whole_plane[place], plane)
        assert total == whole


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", ENGINES)
def test_findings_beside_a_result_change_neither(name, order, monkeypatch):
    """Of one pass, they are those of a pass of their own, and so is the result."""
    monkeypatch.setenv(engine.VARIABLE, name)
    rules = stack_rules(4, order=order, background=RED, opacity=[1, 0.5, 1, 0.25])
    strips = strips_of(broken(LAYERS))
    strip = StripToMeasure(rules, measures.measure_settings(rules), 90, strips, 700, 3, True)

    def accumulated():
        accumulator = engine.start(rules, 700, 3)
        arriving = strips if rules.arrival[0] == 0 else strips[::-1]
        accumulator.add(list(rules.arrival), arriving)
        return accumulator

    alone, lost = Losses(), Losses()
    with np.errstate(all="ignore"):
        samples = accumulated().result("uint8", alone)
        beside, *found = engine.result_and_summary(accumulated(), "uint8", lost, REC709, strip)
        expected, planes = engine.measuring(rules).summary(strip)
    assert beside.tobytes() == samples.tobytes()
    assert (lost, found[0]) == (alone, expected)
    for plane, other in zip(vars(found[1]).values(), vars(planes).values(), strict=True):
        assert np.array_equal(plane, other, equal_nan=True)


def test_findings_of_no_pixel_and_of_other_settings():
    rules = stack_rules(2)
    none = summary.StackSummary.none(rules, measures.measure_settings(rules), 360)
    assert none + none == none
    assert (none.result.pixels, none.measures.pixels) == (0, 0)
    other = summary.StackSummary.none(
        rules, measures.measure_settings(rules, foreign_tolerance=1), 360
    )
    with pytest.raises(SettingError, match="do not add up"):
        none + other


@pytest.mark.parametrize("name", ENGINES)
def test_findings_are_those_of_measures_and_histograms(name):
    rules = stack_rules(4, opacity=[1, 0.5, 1, 0.25])
    settings = measures.measure_settings(rules, foreign_tolerance=3.0)
    found, planes = ENGINES[name].summary(StripToMeasure(rules, settings, 90, strips_of(LAYERS), 700, 3))
    assert planes is None
    for histogram, layer, opacity in zip(found.layers, LAYERS, rules.opacities, strict=True):
        assert histogram == hue_histogram(layer * np.float32(opacity), bins=90)
    if name == "reference":
        rows = LAYERS.reshape(4, 3, 700, 4)
        assert found.measures == measures.measures_of(rules, settings, rows)[0]


def test_the_engine_that_is_chosen_finds(monkeypatch):
    rules = stack_rules(4)
    strip = StripToMeasure(
        rules, measures.measure_settings(rules), 360, strips_of(LAYERS), 700, 3, True
    )
    for name, by in ENGINES.items():
        monkeypatch.setenv(engine.VARIABLE, name)
        assert engine.measuring(rules) is by
        assert everything(engine.measuring(rules).summary(strip)) == everything(by.summary(strip))


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("blending", BLENDING_NAMES)
def test_every_blending_is_measured(monkeypatch, name, blending):
    rules = stack_rules(4, blending=blending, op="dst-over", background=RED)
    strip = StripToMeasure(
        rules, measures.measure_settings(rules), 360, strips_of(LAYERS), 700, 3, True
    )
    monkeypatch.setenv(engine.VARIABLE, name)
    ours, planes = engine.measuring(rules).summary(strip)
    theirs, their_planes = reference.ENGINE.summary(strip)
    for found, expected in zip(ours.measures.result.layers, theirs.measures.result.layers, strict=True):
        assert abs(found.survived - expected.survived) <= TIES
        assert found.kept == pytest.approx(expected.kept, rel=SUMS)
    assert np.count_nonzero(planes.layer != their_planes.layer) <= TIES


# ---- closed forms --------------------------------------------------------------------------------

#: In the middle of bins, far from one another.
HUES = 20.0, 150.0, 265.0


def labels(alphas, hues=HUES):
    """A layer of one straight colour for each hue, at these alphas (layers, h, w)."""
    colors = np.array([valid_color(hue, 0.9, 0.3) for hue in hues])
    rgba = np.concatenate([colors, np.ones((len(hues), 1))], axis=1)
    return (alphas[..., None] * rgba[:, None, None]).astype(np.float32)


@pytest.mark.parametrize("order", ORDERS[:4])
@pytest.mark.parametrize("name", ENGINES)
def test_three_labels_at_random_opacities_stay_three_hues(name, order):
    """The paper's claim: three lines in the histogram, where plain + makes a smear."""
    alphas = np.random.default_rng(9).random((3, 60, 80))
    rules = stack_rules(3, order=order)
    settings = measures.measure_settings(rules)
    found, _ = ENGINES[name].summary(StripToMeasure(rules, settings, 360, strips_of(labels(alphas)), 80, 60))
    lines = [set(np.flatnonzero(layer.count)) for layer in found.layers]
    assert [len(line) for line in lines] == [1, 1, 1]
    assert set(np.flatnonzero(found.result.count)) == set.union(*lines)
    assert found.result.count.sum() + found.result.grey == 4800
    assert found.result.grey > 0
    assert found.measures.result.foreign == 0
    assert found.traditional.occupied > 200
    assert found.measures.traditional.foreign_share > 0.6


@pytest.mark.parametrize("name", ENGINES)
def test_halves_of_one_label_each(name):
    """Two labels side by side: all is told by the colours."""
    alphas = np.zeros((2, 4, 700))
    alphas[0, :, :300] = alphas[1, :, 300:] = 0.5
    layers = labels(alphas, HUES[:2])
    rules = stack_rules(2)
    settings = measures.measure_settings(rules)
    found, planes = ENGINES[name].summary(StripToMeasure(rules, settings, 360, strips_of(layers), 700, 4, True))
    for k, pixels in enumerate((1200, 1600)):
        histogram, layer = found.layers[k], found.measures.result.layers[k]
        assert (histogram.chromatic, histogram.transparent) == (pixels, 2800 - pixels)
        assert histogram.alpha_sums.sum() == pixels / 2
        assert (layer.pixels, layer.survived, layer.lost) == (pixels, pixels, 0)
        assert layer.chroma == pytest.approx(histogram.chroma.sum(), rel=1e-6)
    assert found.result.count.tolist() == sum(found.layers).count.tolist()
    assert found.measures.result == found.measures.traditional
    assert found.measures.order_sensitive == 0
    assert (planes.layer[:, :300] == 1).all()
    assert (planes.layer[:, 300:] == 2).all()
    assert (planes.margin == 1).all()
    assert abs(planes.grey).max() < 1e-6


@pytest.mark.parametrize("name", ENGINES)
def test_provenance_of_two_labels_that_meet(name):
    alphas = np.array([0.8, 0.2])[:, None, None] * np.ones((2, 1, 600))
    layers = labels(alphas, (0.0, 180.0))
    rules = stack_rules(2, op="plus")
    settings = measures.measure_settings(rules)
    _, planes = ENGINES[name].summary(StripToMeasure(rules, settings, 360, strips_of(layers), 600, 1, True))
    chroma = [np.hypot(*rules.space.forward(layer[0, :1, :3].T)[1])[0] for layer in layers]
    assert (planes.layer == 1 + int(np.argmax(chroma))).all()
    small, big = sorted(chroma)
    assert np.allclose(planes.grey, 1 - (big - small) / (big + small), atol=1e-5)
    assert np.allclose(planes.margin, 1 - small / big, atol=1e-5)


# ---- the binding ---------------------------------------------------------------------------------

WIDTH, HEIGHT, BINS = 3, 2, 6


def planes_of(height=HEIGHT, width=WIDTH):
    """What `_kernel.provenance` takes."""
    return {
        "layer": np.zeros((height, width), np.uint32),
        "grey": np.zeros((height, width), np.float32),
        "margin": np.zeros((height, width), np.float32),
    }


PLANES_OF_PROVENANCE = tuple(planes_of())


def make_provenance(**changed):
    return _kernel.provenance(**{**planes_of(), **changed})


def make_measures(**changed):
    """`_kernel.measures` of two layers, but for what is changed."""
    arguments = {
        "layers": 2, "width": WIDTH, "height": HEIGHT, "left": 0, "top": 0, "bins": BINS, "half_step": 1e-5,
        "achromatic": 0.02, "foreign_sine": 0.07, "foreign_cosine": 0.99, "depends_on_order": True,
        "provenance": make_provenance(),
    }  # fmt: skip
    return _kernel.measures(**{**arguments, **changed})


def measure(measures=None, **changed):
    """`_kernel.measure` of two layers, but for what is changed: the measures that it adds to."""
    measures = make_measures() if measures is None else measures
    stack = {"rules": make_rules(), "layers": [make_layer(), make_layer()], "level": ""}
    _kernel.measure(measures=measures, **{**stack, **changed})
    return measures


def hues_of(measures, layers=2):
    """Its histograms: the layers', then those of both results."""
    found = [measures.layer_hues(number=number) for number in range(layers)]
    return [*found, measures.result_hues, measures.traditional_hues]


def pixels_of(measures):
    """How many pixels each histogram has."""
    return [
        int(hues.count.sum()) + hues.grey + hues.transparent + hues.nonfinite
        for hues in hues_of(measures)
    ]


def sums_of(found):
    """(name, value) of each sum, as numbers and arrays, of what the binding gave."""
    for name in dir(found):
        if name.startswith("_") or name == "layer_hues" or name.endswith("_squares"):
            continue
        value = getattr(found, name)
        if isinstance(value, list):
            for index, item in enumerate(value):
                yield from ((f"{name}[{index}].{inner}", number) for inner, number in sums_of(item))
        elif type(value).__module__.endswith("_kernel"):
            yield from ((f"{name}.{inner}", number) for inner, number in sums_of(value))
        else:
            yield name, value


class TestBinding:
    """Nothing that Python can pass reads or writes out of bounds: it is refused."""

    def test_what_is_right_is_taken(self):
        for provenance in (make_provenance(), None):
            measures = measure(make_measures(provenance=provenance))
            assert (measures.unmeasured, measures.order_sensitive) == (0, 0)
            assert pixels_of(measures) == [6] * 4

    @pytest.mark.parametrize("name", PLANES_OF_PROVENANCE)
    @pytest.mark.parametrize("dtype", [*WRONG_TYPES, "i8", "f4", "u4"])
    def test_planes_of_another_type(self, name, dtype):
        good = planes_of()[name]
        if np.dtype(dtype) == good.dtype:
            return
        with refused():
            make_provenance(**{name: good.astype(dtype)})

    @pytest.mark.parametrize("name", PLANES_OF_PROVENANCE)
    def test_planes_of_another_shape(self, name):
        good = planes_of()[name]
        wrong = [(), (6,), (1, 2, 3), (2, 3, 1), (0, 0), (1, 3), (3, 3), (2, 2), (2, 4)]
        for shape in wrong:
            with refused():
                make_measures(provenance=make_provenance(**{name: np.zeros(shape, good.dtype)}))

    @pytest.mark.parametrize("name", PLANES_OF_PROVENANCE)
    def test_planes_that_are_not_one_run(self, name):
        good = planes_of()[name]
        for other in (
            good[::-1],
            np.repeat(good, 2, axis=0)[::2],
            np.repeat(good, 2, axis=-1)[..., ::2],
            np.asfortranarray(good),
            np.broadcast_to(good[:1], good.shape),
        ):
            with refused():
                make_provenance(**{name: other})

    @pytest.mark.parametrize("name", PLANES_OF_PROVENANCE)
    def test_planes_that_cannot_be_written_or_are_not_aligned(self, name):
        good = planes_of()[name]
        fixed = good.copy()
        fixed.flags.writeable = False
        for other in (fixed, unaligned(good.dtype, good.shape)):
            with refused():
                make_measures(provenance=make_provenance(**{name: other}))

    @pytest.mark.parametrize("name", PLANES_OF_PROVENANCE)
    @pytest.mark.parametrize("other", [None, [[0]], b"0123", 1.0, object()], ids=lambda other: type(other).__name__)
    def test_planes_that_are_none(self, name, other):
        with refused():
            make_provenance(**{name: other})

    @pytest.mark.parametrize("provenance", [0, (), planes_of()], ids=type)
    def test_what_is_no_provenance(self, provenance):
        with refused():
            make_measures(provenance=provenance)

    @pytest.mark.parametrize("name", ["layers", "width", "height", "bins"])
    @pytest.mark.parametrize("value", [0, -1, 2**31, 2**63, 1.5, None, "1", [1]], ids=str)
    def test_sizes(self, name, value):
        with refused():
            measure(make_measures(provenance=None, **{name: value}))

    def test_too_many_layers_or_bins(self):
        large = {"width": 1 << 29, "height": 1 << 29, "provenance": None}
        for wrong in ({"layers": (1 << 20) + 1}, {"bins": (1 << 16) + 1}, large):
            with refused():
                make_measures(**wrong)

    @pytest.mark.parametrize("place", [0, -1, 15, 16, -(2**63), 2**63 - 1])
    def test_a_strip_may_lie_anywhere(self, place):
        expected = measure(make_measures(left=place % 16, top=place % 16))
        found = measure(make_measures(left=place, top=place))
        for one, two in zip(expected.result.layers, found.result.layers, strict=True):
            assert (one.pixels, one.visible) == (two.pixels, two.visible)
        for wrong in (2**63, 0.5, None, "0"):
            with refused():
                make_measures(left=wrong)
            with refused():
                make_measures(top=wrong)

    @pytest.mark.parametrize("limit", ["half_step", "achromatic", "foreign_sine", "foreign_cosine"])
    def test_limits(self, limit):
        for wrong in (None, "0.1", [0.1]):
            with refused():
                make_measures(**{limit: wrong})

    def test_keywords_alone_are_taken(self):
        with refused():
            _kernel.provenance(*planes_of().values())
        with refused():
            _kernel.measure(make_rules(), [make_layer(), make_layer()], make_measures(), "")
        with refused():
            make_measures(margin=None)
        with refused():
            make_measures().layer_hues(0)

    @pytest.mark.parametrize("number", [-1, 2, 2**31, 2**63, None, 0.5])
    def test_hues_of_no_layer(self, number):
        with refused():
            make_measures().layer_hues(number=number)

    @pytest.mark.parametrize(
        "layers",
        [[], [None], [None, None], None, [0, 0], "ab"],
        ids=str,
    )
    def test_layers(self, layers):
        with refused():
            measure(layers=layers)

    def test_another_number_of_layers(self):
        for n in (1, 3):
            with refused():
                measure(layers=[make_layer()] * n)
            with refused():
                measure(rules=make_rules(layers=n))
        with refused():
            measure(layers=[make_layer(), None])

    @pytest.mark.parametrize("rules", [None, 0, "over"], ids=repr)
    def test_rules(self, rules):
        with refused():
            measure(rules=rules)

    @pytest.mark.parametrize("level", ["v9", None, 0])
    def test_instruction_set(self, level):
        with refused():
            measure(level=level)

    @pytest.mark.parametrize("order", MEASURED_ORDERS)
    def test_limits_of_any_value(self, order):
        """Numbers decide what is counted, never where."""
        strange = [0.0, -1.0, 1e38, math.inf, -math.inf, math.nan]
        samples = broken(layers_of_labels(2, 2, 520))
        limits = ("half_step", "achromatic", "foreign_sine", "foreign_cosine")
        for value, limit, bins in itertools.product(strange, limits, (1, 6, 65536)):
            if bins == 65536 and (limit, value) != ("achromatic", -1.0):
                continue
            measures = measure(
                make_measures(
                    width=520,
                    bins=bins,
                    provenance=make_provenance(**planes_of(2, 520)),
                    **{limit: value},
                ),
                rules=make_rules(order=order, permutation=[1, 0], background=make_background()),
                layers=[make_layer(layer) for layer in samples],
            )
            assert pixels_of(measures) == [1040] * 4

    @pytest.mark.parametrize("coefficient", [0.0, math.inf, math.nan, 1e38])
    def test_coefficients_of_any_value(self, coefficient):
        background = make_background(luminance=coefficient, p=[coefficient] * 2)
        space = make_maps(coefficient=coefficient, weight_red=coefficient, weight_blue=coefficient)
        for order in MEASURED_ORDERS:
            rules = make_rules(
                order=order, permutation=[1, 0], background=background, gain=coefficient, space=space
            )
            layers = [make_layer(layer) for layer in broken(layers_of_labels(2, 2, 3))]
            assert pixels_of(measure(rules=rules, layers=layers)) == [6] * 4

    @pytest.mark.parametrize("width", [1, 3, 15, 16, 17, 511, 512, 513])
    def test_nothing_is_written_beside_the_planes(self, width):
        for order in MEASURED_ORDERS:
            memories, planes = [], {}
            for name, good in planes_of(2, width).items():
                memory = np.full(good.size + 128, 99, good.dtype)
                planes[name] = memory[64:-64].reshape(good.shape)
                memories.append(memory)
            measure(
                make_measures(width=width, provenance=make_provenance(**planes)),
                rules=make_rules(order=order, permutation=[1, 0]),
                layers=[make_layer(layer) for layer in layers_of_labels(2, 2, width)],
            )
            for memory in memories:
                assert (memory[:64] == 99).all()
                assert (memory[-64:] == 99).all()

    def test_sums_are_added_to_and_provenance_is_set(self):
        layers = [make_layer(layer) for layer in layers_of_labels(2, 2, 3)]
        planes = planes_of()
        again = {name: np.full_like(plane, 7) for name, plane in planes.items()}
        once = measure(make_measures(provenance=make_provenance(**planes)), layers=layers)
        twice = make_measures(provenance=make_provenance(**again))
        for _ in range(2):
            measure(twice, layers=layers)
        for one, two in ((once, twice), *zip(hues_of(once), hues_of(twice), strict=True)):
            names = []
            for (name, a), (_, b) in zip(sums_of(one), sums_of(two), strict=True):
                assert np.array_equal(2 * np.asarray(a), b), name
                names.append(name)
            assert {"count", "rgb"} < set(names) or "result.layers[1].survived" in names
        for name, plane in planes.items():
            assert np.array_equal(plane, again[name])

    def test_squares_are_added_to_and_outlive_what_was_measured(self):
        layers = [make_layer(layer) for layer in layers_of_labels(2, HEIGHT, WIDTH)]
        measures = make_measures(square_scale=2, square_top=1)
        found = []
        for _ in range(2):
            measure(measures, layers=layers)
            of_layers = [measures.layer_squares(number=n) for n in range(2)]
            results = [measures.result_squares(), measures.traditional_squares()]
            found.append([sums.copy() for sums in (*of_layers, *results)])
        del measures
        for once, twice, held in zip(*found, (*of_layers, *results), strict=True):
            assert once.any()
            assert np.array_equal(2 * once, twice)
            assert np.array_equal(held, twice)

    def test_squares_that_are_none(self):
        for wrong in ({"square_scale": 2, "square_top": 2}, {"square_scale": 2, "square_top": -1},
                      {"square_scale": 1 << 40}):  # fmt: skip
            with refused():
                make_measures(**wrong)
        measures = make_measures(square_scale=2)
        for number in (-1, 2):
            with refused():
                measures.layer_squares(number=number)
        unasked = make_measures()
        for ask in (unasked.result_squares, unasked.traditional_squares):
            with refused():
                ask()
        with refused():
            unasked.layer_squares(number=0)

    def test_arrays_that_were_given_are_nobody_elses(self):
        measures = measure(layers=[make_layer(layer) for layer in layers_of_labels(2, 2, 3)])
        hues = measures.result_hues
        before = {name: getattr(hues, name).copy() for name in ("count", "chroma", "alpha", "rgb")}
        for name in before:
            getattr(hues, name)[:] = -1
        del hues
        for name, values in before.items():
            assert np.array_equal(getattr(measures.result_hues, name), values)

    @pytest.mark.parametrize("changed", [{"layers": 3}, {"width": 4}, {"height": 1}])
    def test_measures_belong_to_one_strip(self, changed):
        accumulator = _kernel.Accumulator(
            rules=make_rules(), width=WIDTH, height=HEIGHT, left=0, top=0, phases=None
        )
        accumulator.add(numbers=[0, 1], layers=[make_layer(), make_layer()])
        out = np.empty((HEIGHT, WIDTH, 4), np.float32)
        with refused():
            accumulator.result(
                out=out, codes=None, measures=make_measures(provenance=None, **changed)
            )

    @pytest.mark.parametrize("at_once", [1, 2])
    def test_layers_are_measured_when_all_come_at_once(self, at_once):
        accumulator = _kernel.Accumulator(
            rules=make_rules(), width=WIDTH, height=HEIGHT, left=0, top=0, phases=None
        )
        for begin in range(0, 2, at_once):
            numbers = list(range(begin, begin + at_once))
            accumulator.add(numbers=numbers, layers=[make_layer() for _ in numbers])
        out = np.empty((HEIGHT, WIDTH, 4), np.float32)
        with nullcontext() if at_once == 2 else refused():
            accumulator.result(out=out, codes=None, measures=make_measures())

    @pytest.mark.parametrize("stride", STRIDED)
    def test_layers_are_checked_where_they_are_made(self, stride):
        with refused():
            measure(layers=[make_layer(STRIDED[stride](np.zeros((2, 3, 4), np.float32)))] * 2)
