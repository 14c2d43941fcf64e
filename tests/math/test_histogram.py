"""Hue histograms: closed forms, a literal second opinion pixel by pixel, and the laws of merging."""

import functools
import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hpcomp
from hpcomp import HueHistogram, MismatchError, SettingError, hue_histogram
from hpcomp.color.hueaxis import HEXAGON
from hpcomp.measures.histogram import BLOCK_PIXELS, LARGEST_ADDEND, SUM_UNIT

UNITS = 2**24
RED, YELLOW, GREEN, CYAN, BLUE, MAGENTA = (
    (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1), (1, 0, 1),
)  # fmt: skip


def label(hue, chroma=0.5, grey=0.1, alpha=1.0):
    """A premultiplied colour of that hue."""
    return (*(alpha * (grey + chroma * HEXAGON.color(np.array(float(hue))))), alpha)


def of_counts(counts, **settings):
    """The histogram of so many pixels of each hue, {degrees: count}."""
    pixels = [np.tile(label(hue), (count, 1)) for hue, count in counts.items()]
    return hue_histogram(np.concatenate(pixels), **settings)


def literal(pixels, bins=360, achromatic=0.02):
    """What the histogram is by its definition: one pixel at a time, in float32 scalars."""
    f32 = np.float32
    found = {
        "count": [0] * bins, "chroma": [0] * bins, "alpha": [0] * bins,
        "rgb": [[0, 0, 0] for _ in range(bins)], "grey": 0, "transparent": 0, "nonfinite": 0,
    }  # fmt: skip
    basis = hpcomp.SPACES["linear-rgb"].coefficients.to_p

    def units(value):
        limited = float(value) if abs(value) < LARGEST_ADDEND else math.copysign(4096, value)
        return round(limited * UNITS)

    for pixel in np.asarray(pixels, np.float32).reshape(-1, 4):
        r, g, b, a = pixel
        if not all(math.isfinite(v) for v in pixel):
            found["nonfinite"] += 1
            continue
        a = min(max(a, f32(0)), f32(1))
        mx, mn = max(r, g, b), min(r, g, b)
        c = mx - mn
        if a == 0 and r == g == b == 0:
            found["transparent"] += 1
        elif c == 0 or c < f32(achromatic) * max(abs(mx), abs(mn)):
            found["grey"] += 1
        else:
            if mx == r:
                h = (g - b) / c
            elif mx == g:
                h = f32(2) + (b - r) / c
            else:
                h = f32(4) + (r - g) / c
            place = math.floor(h * f32(bins / 6) + f32(0.5)) % bins
            p = [(r - g) * f32(m[0]) + (b - g) * f32(m[1]) for m in basis]
            found["count"][place] += 1
            found["chroma"][place] += units(np.sqrt(p[0] * p[0] + p[1] * p[1]))
            found["alpha"][place] += units(a)
            for channel, value in enumerate((r, g, b)):
                found["rgb"][place][channel] += units(value)
    return found


def assert_is_literal(histogram, pixels, **settings):
    for name, expected in literal(pixels, **settings).items():
        assert np.array_equal(getattr(histogram, name), expected), name


# ---- closed forms ----------------------------------------------------------------------------


def test_six_corners_of_the_cube():
    colors = (RED, YELLOW, GREEN, CYAN, BLUE, MAGENTA)
    pixels = [(*c, 1.0) for n, c in enumerate(colors, 1) for _ in range(n)]
    found = hue_histogram(pixels)
    assert {h: n for h, n in zip(found.hues.tolist(), found.count.tolist(), strict=True) if n} == {
        0: 1, 60: 2, 120: 3, 180: 4, 240: 5, 300: 6,
    }  # fmt: skip
    assert (found.chromatic, found.pixels, found.occupied) == (21, 21, 6)
    assert found.alpha_sums[::60].tolist() == [1, 2, 3, 4, 5, 6]
    assert found.rgb_sums[60].tolist() == [2, 2, 0]
    assert found.mean_rgb[300].tolist() == [1, 0, 1]
    _, p = hpcomp.SPACES["linear-rgb"].forward(np.array([BLUE], np.float32).T)
    assert found.chroma_sums[240] == pytest.approx(5 * math.hypot(*p[:, 0]), rel=1e-6)


def test_pixels_that_have_no_hue():
    pixels = [
        *[(0, 0, 0, 0)] * 2,  # transparent
        (0, 0, 0, -3),  # an alpha outside its range is its nearer end
        *[(0.5, 0.5, 0.5, 1)] * 3, (0, 0, 0, 1), (0.2, 0.2, 0.2, 0),  # grey, black, grey glow
        (np.nan, 0, 0, 1), (1, np.inf, 0, 1), (1, 0, 0, np.nan), (0, 0, -np.inf, 0),
    ]  # fmt: skip
    found = hue_histogram(pixels)
    assert (found.transparent, found.grey, found.nonfinite, found.chromatic) == (3, 5, 4, 0)
    assert found.pixels == len(pixels)
    assert found == HueHistogram.empty() + found
    assert found.peaks == ()
    assert (found.concentration.share, found.concentration.entropy) == (0, 0)
    assert not found.shares().any()
    assert not found.mean_rgb.any()


def test_light_without_alpha_has_a_hue():
    found = hue_histogram([(0.25, 0, 0, 0), (0.75, 0, 0, 0)])
    assert (found.count[0], found.alpha[0]) == (2, 0)
    assert found.mean_rgb[0].tolist() == [0.5, 0, 0]
    assert found.peaks[0].rgb == (0.5, 0, 0)


@pytest.mark.parametrize(("saturation", "grey"), [(0.019, 1), (0.021, 0)])
@pytest.mark.parametrize("size", [1e-30, 1e-3, 1.0, 1e30])
def test_achromatic_is_a_saturation_whatever_the_brightness(saturation, grey, size):
    pixel = np.array([size, size * (1 - saturation), size * (1 - saturation), 1])
    assert hue_histogram(pixel).grey == grey


def test_achromatic_of_negative_components():
    """Out of gamut: the size is that of the largest component, to either side."""
    assert hue_histogram([(-1.0, -1.01, -1.0, 1)]).grey == 1
    assert hue_histogram([(0.01, -1.0, 0.01, 1)]).grey == 0


def test_at_achromatic_zero_only_equal_components_are_grey():
    smallest = np.nextafter(np.float32(0.5), np.float32(1))
    found = hue_histogram([(smallest, 0.5, 0.5, 1), (0.5, 0.5, 0.5, 1)], achromatic=0)
    assert (found.grey, found.count[0]) == (1, 1)


@pytest.mark.parametrize("bins", [6, 7, 90, 360, 720, 3600])
def test_bins_are_centred_on_multiples_of_their_width(bins):
    width = 360 / bins
    for k in (0, 1, bins // 2, bins - 1):
        for offset in (-0.49, 0, 0.49):
            found = hue_histogram([label((k + offset) * width % 360)], bins=bins)
            assert found.count[k] == 1, (k, offset)
            assert found.hues[k] == pytest.approx(k * width)


def test_shares_by_weight():
    found = hue_histogram([(1, 0, 0, 1), (0, 0.5, 0, 0.25), (0, 0.5, 0, 0.25)])
    assert found.shares()[[0, 120]].tolist() == pytest.approx([1 / 3, 2 / 3])
    assert found.shares("alpha")[[0, 120]].tolist() == pytest.approx([2 / 3, 1 / 3])
    chroma = found.shares("chroma")
    assert chroma[120] == pytest.approx(found.chroma_sums[120] / found.chroma_sums.sum())
    assert chroma.sum() == pytest.approx(1)


# ---- a second opinion ------------------------------------------------------------------------

floats32 = st.floats(width=32)
pixels_of_any_kind = st.lists(
    st.tuples(*[st.one_of(st.sampled_from((0.0, 1.0, 0.5, -0.25)), st.floats(-2, 2, width=32), floats32)] * 4),
    max_size=12,
)  # fmt: skip


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
@given(pixels_of_any_kind, st.sampled_from((6, 35, 360, 3600)), st.sampled_from((0.0, 0.02, 0.5)))
def test_histogram_is_what_its_definition_says(pixels, bins, achromatic):
    # Differences that overflow are for a test of their own.
    array = np.array([p for p in pixels if max(map(abs, p[:3])) < 1e18], np.float32).reshape(-1, 4)
    found = hue_histogram(array, bins=bins, achromatic=achromatic)
    assert_is_literal(found, array, bins=bins, achromatic=achromatic)


def test_a_picture_is_what_the_definition_says():
    rng = np.random.default_rng(7)
    pixels = rng.random((40, 50, 4), dtype=np.float32)
    pixels[..., :3] *= pixels[..., 3:]
    assert_is_literal(hue_histogram(pixels), pixels)


def test_values_beyond_what_a_float_adds():
    largest = float(np.finfo(np.float32).max)
    assert hue_histogram([(largest, -largest, 0, 1)]).nonfinite == 1
    found = hue_histogram([(largest, 0, 0, 1), (0.0, largest, largest, 1)])
    assert (found.count[0], found.count[180], found.nonfinite) == (1, 1, 0)
    assert found.chroma_sums[0] == found.rgb_sums[0, 0] == LARGEST_ADDEND
    assert found.rgb_sums[180].tolist() == [0, LARGEST_ADDEND, LARGEST_ADDEND]
    assert hue_histogram([(1e300, 0, 0, 1)]).nonfinite == 1  # no float32


# ---- merging ---------------------------------------------------------------------------------


@functools.cache
def picture():
    """A picture of more than two blocks, with all that can be in one."""
    rng = np.random.default_rng(3)
    pixels = rng.normal(0.2, 0.5, (331, 407, 4)).astype(np.float32)
    pixels[rng.random((331, 407)) < 0.1] = 0
    pixels[rng.random((331, 407)) < 0.01, 1] = np.nan
    pixels[rng.random((331, 407)) < 0.05, :3] = 0.25
    pixels[rng.random((331, 407)) < 0.01] *= 1e5
    pixels.setflags(write=False)
    assert pixels[..., 0].size > 2 * BLOCK_PIXELS
    return pixels


@pytest.mark.parametrize("rows", [1, 13, 64, 330])
def test_strips_merge_to_the_whole_exactly_in_any_order(rows):
    whole = hue_histogram(picture())
    assert 0 not in (whole.grey, whole.transparent, whole.nonfinite, whole.chromatic)
    assert whole.pixels == 331 * 407
    strips = [hue_histogram(picture()[k : k + rows]) for k in range(0, 331, rows)]
    assert sum(strips) == whole
    random.Random(1).shuffle(strips)
    assert functools.reduce(lambda a, b: b + a, strips) == whole


@given(pixels_of_any_kind, st.integers(0, 12))
def test_two_parts_merge_to_the_whole(pixels, cut):
    array = np.array(pixels, np.float32).reshape(-1, 4)
    assert hue_histogram(array[:cut]) + hue_histogram(array[cut:]) == hue_histogram(array)


def test_shape_does_not_matter():
    flat = hue_histogram(picture().reshape(-1, 4))
    assert flat == hue_histogram(picture()) == hue_histogram(picture().transpose(1, 0, 2))


def test_one_difference_is_enough_to_be_unequal():
    one, other = hue_histogram([(1, 0, 0, 1)]), hue_histogram([(1, 0, 0, 0.5)])
    assert one != other
    assert np.array_equal(one.count, other.count)
    assert one != 1


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"bins": 36}, "bins 360 and 36"), ({"achromatic": 0.1}, "achromatic 0.02 and 0.1")],
)
def test_what_was_measured_otherwise_does_not_merge(settings, words):
    with pytest.raises(MismatchError, match=words):
        HueHistogram.empty() + HueHistogram.empty(**settings)


def test_only_histograms_are_added():
    with pytest.raises(TypeError):
        HueHistogram.empty() + 1
    with pytest.raises(TypeError):
        1 + HueHistogram.empty()
    assert sum([HueHistogram.empty()]) == HueHistogram.empty()


def test_sums_hold_the_largest_addends_of_a_large_picture():
    pixels = np.tile(np.float32([5000, 0, 0, 1]), (BLOCK_PIXELS * 3 + 1, 1))
    found = hue_histogram(pixels)
    assert found.rgb[0, 0] == (BLOCK_PIXELS * 3 + 1) * int(LARGEST_ADDEND / SUM_UNIT)


# ---- peaks -----------------------------------------------------------------------------------


def hues_of(histogram):
    return [round(peak.hue, 3) for peak in histogram.peaks]


def test_labels_are_peaks_by_size_with_their_own_hue():
    found = of_counts({47.3: 200, 231.8: 300, 120.0: 500})
    assert hues_of(found) == [120, 231.8, 47.3]
    assert [peak.count for peak in found.peaks] == [500, 300, 200]
    assert [peak.share for peak in found.peaks] == [0.5, 0.3, 0.2]
    assert sum(peak.chroma_share for peak in found.peaks) == pytest.approx(1)
    assert found.peaks[0].rgb == pytest.approx((0.1, 0.6, 0.1), abs=1e-6)
    assert found.concentration.share == found.concentration.chroma_share == 1


def test_color_of_a_peak_is_straight():
    found = hue_histogram(np.tile(label(120, alpha=0.25), (9, 1)))
    assert found.peaks[0].rgb == pytest.approx((0.1, 0.6, 0.1), abs=1e-6)


def test_a_peak_around_red_is_one():
    found = of_counts({358.9: 30, 359.8: 50, 0.9: 40})
    (peak,) = found.peaks
    assert peak.count == 120
    assert 359 < peak.hue < 360


def test_near_labels_are_two_peaks():
    """Distinct hues of the common palettes are at least 4.7° apart."""
    for share in (100, 500, 900):
        found = of_counts({100.0: share, 104.7: 1000 - share})
        assert sorted(hues_of(found)) == [100, 104.7]
        assert found.concentration.share == 1


def test_near_labels_in_several_shades_are_as_many_peaks():
    """As 8-bit files store them: each label fills three bins."""
    shades = {-1: 1, 0: 8, 1: 1}
    hues = (100, 105, 110, 115)
    found = of_counts({hue + offset: 10 * n for hue in hues for offset, n in shades.items()})
    assert [round(hue, 1) for hue in hues_of(found)] == list(hues)
    assert found.concentration.share == 1


def test_nearer_labels_are_one_peak():
    assert len(of_counts({100.0: 900, 102.0: 800}).peaks) == 1


@pytest.mark.parametrize(("count", "listed"), [(9, False), (11, True)])
def test_a_peak_has_a_hundredth_of_the_pixels(count, listed):
    found = of_counts({10.0: 1000 - count, 200.0: count})
    assert (len(found.peaks) == 2) == listed
    assert found.concentration.share == pytest.approx(1 if listed else 1 - count / 1000)


def test_an_even_histogram_has_no_peak():
    found = of_counts(dict.fromkeys(range(360), 3))
    assert found.peaks == ()
    assert found.concentration.share == 0
    assert found.concentration.entropy == pytest.approx(math.log2(360))
    assert found.concentration.relative_entropy == pytest.approx(1)


def test_a_smear_has_no_peak_and_hides_none():
    smear = of_counts({hue: 20 + hue % 3 for hue in range(30, 90)})
    assert smear.peaks == ()
    assert of_counts(dict.fromkeys(range(30, 90, 2), 20)).peaks == ()  # with gaps, as of 8 bits
    both = smear + of_counts({60.0: 500, 200.0: 300})
    assert [round(hue) for hue in hues_of(both)] == [60, 200]
    assert both.peaks[0].count == 500 + sum(20 + hue % 3 for hue in range(58, 63))
    assert both.concentration.share == pytest.approx(
        (both.peaks[0].count + 300) / both.chromatic, rel=1e-12
    )


def test_equal_peaks_are_listed_by_hue():
    assert hues_of(of_counts({300.0: 50, 20.0: 50, 180.0: 50})) == [20, 180, 300]


def test_of_equal_neighbours_the_first_is_the_peak():
    (peak,) = of_counts({100.0: 50, 101.0: 50}).peaks
    assert peak.count == 100
    assert peak.hue == pytest.approx(100.5, abs=0.01)


@pytest.mark.parametrize("bins", [6, 12, 36, 90, 180, 3600])
def test_peaks_of_wider_and_narrower_bins(bins):
    found = of_counts({0.0: 100, 120.0: 200, 240.0: 300}, bins=bins)
    assert hues_of(found) == [240, 120, 0]
    assert found.concentration.share == 1


def test_peak_too_dark_for_its_sums_is_at_its_bin():
    found = hue_histogram(np.tile(np.float32([1e-30, 1e-30, 0, 1]), (10, 1)))
    assert hues_of(found) == [60]
    assert found.peaks[0].rgb == (0, 0, 0)


def test_entropy_of_equal_labels():
    found = of_counts({0.0: 10, 120.0: 10, 240.0: 10, 300.0: 10})
    assert found.concentration.entropy == pytest.approx(2)
    assert found.concentration.relative_entropy == pytest.approx(2 / math.log2(360))
    assert of_counts({10.0: 5}).concentration.entropy == 0


# ---- settings --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"bins": 5}, "bins 5 is outside 6 to 3600"),
        ({"bins": 3601}, "bins 3601"),
        ({"achromatic": -0.1}, "achromatic -0.1 is outside 0 to 1"),
        ({"achromatic": math.nan}, "achromatic nan"),
        ({"space": "rgb"}, "unknown blending space 'rgb': choose one of linear-rgb"),
    ],
)
def test_setting_out_of_range(settings, words):
    with pytest.raises(SettingError, match=words):
        hue_histogram([(1, 0, 0, 1)], **settings)


@pytest.mark.parametrize("pixels", [0.5, np.zeros((4, 3)), [["a"] * 4], np.zeros((2, 4), complex)])
def test_what_are_no_pixels(pixels):
    with pytest.raises(MismatchError, match=r"numbers \(…, 4\) are needed"):
        hue_histogram(pixels)


def test_unknown_weight():
    with pytest.raises(SettingError, match="unknown weight 'size': choose one of count, chroma"):
        HueHistogram.empty().shares("size")


def test_pixels_are_not_changed():
    pixels = np.array([[2.0, -1.0, 0.5, 7.0]], np.float32)
    before = pixels.copy()
    hue_histogram(pixels)
    assert np.array_equal(pixels, before)


# ---- the paper's claim -----------------------------------------------------------------------


def stacked(blending):
    """Three labels at random opacities over one another, before quantisation."""
    rng = np.random.default_rng(2009)
    layers = []
    for hue in (0, 60, 240):
        opacity = rng.random((150, 150, 1)).astype(np.float32)
        layers.append(opacity * np.float32(label(hue, chroma=0.9, grey=0.02)))
    return hue_histogram(hpcomp.composite(layers, blending=blending))


def test_three_labels_stay_three_hues():
    found = stacked("hue-preserving")
    assert np.flatnonzero(found.count).tolist() == [0, 60, 240]
    assert found.concentration.share == 1
    assert found.pixels == found.chromatic + found.grey == 150 * 150


def test_ordinary_addition_smears_them():
    found = stacked("traditional")
    assert found.occupied > 150
    assert found.concentration.share < 0.3
    assert found.concentration.entropy > stacked("hue-preserving").concentration.entropy + 3


@pytest.mark.parametrize("space", ["oklab", "cielab"])
def test_a_colour_without_luminance_has_no_hue_where_the_space_sees_none(space):
    dark = np.array([[0.1, -0.5, 0.2, 1.0], [-1.0, -2.0, -1.0, 1.0], [1.0, 0.5, 0.0, 1.0]], np.float32)
    found = hue_histogram(dark, space=space)
    assert (found.grey, int(found.count.sum())) == (2, 1)
    assert hue_histogram(dark).grey == 0
