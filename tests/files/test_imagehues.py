"""Hue histograms of files: read in strips, on any number of threads, with the keys of a LAYER."""

import itertools
import logging
import re

import exrfile
import numpy as np
import pngfile
import pytest

import hpcomp
from hpcomp import SPACES, InputError, MismatchError, SettingError, hue_histogram, read_hues
from hpcomp.analysis import hues
from hpcomp.color import spaces
from hpcomp.color.encodings import ALPHA_MODES, COLOR_SPACES, LINEAR_REC709, SRGB_ENCODING
from hpcomp.color.samples import Decoding, Strip, linear_rgba
from hpcomp.engine import reference
from hpcomp.measures.histogram import HueHistogram


def noise(height, width, seed=5):
    """Premultiplied pixels of every hue, some of them transparent."""
    rng = np.random.default_rng(seed)
    pixels = rng.random((height, width, 4), dtype=np.float32)
    pixels[..., :3] *= pixels[..., 3:]
    pixels[rng.random((height, width)) < 0.2] = 0
    return pixels


def exr(path, pixels, **options):
    # OpenEXR writes the memory of a view, not what it shows.
    planes = {name: pixels[..., k].copy() for k, name in enumerate("RGBA")}
    return exrfile.write(path, planes, **options)


@pytest.mark.pairwise
@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("height", [1, 64, 65, 300])
@pytest.mark.parametrize("compression", ["none", "zip", "dwab"])
def test_histogram_of_a_file_is_that_of_its_pixels(tmp_path, threads, height, compression):
    """Blocks of 1, 16 and 256 rows."""
    pixels = noise(height, 31)
    path = exr(tmp_path / "a.exr", pixels, compression=compression)
    whole = hpcomp.read_layer(path).pixels
    assert read_hues(path, threads=threads) == hue_histogram(whole)
    settings = {"bins": 90, "achromatic": 0.2}
    assert read_hues(path, threads=threads, **settings) == hue_histogram(whole, **settings)


@pytest.mark.parametrize("compression", ["none", "zip", "dwab"])
def test_memory_does_not_show(tmp_path, compression, caplog):
    """The least there must be leaves one thread, and one compression block at a time."""
    caplog.set_level(logging.INFO, "hpcomp")
    path = exr(tmp_path / "a.exr", noise(300, 31), compression=compression)
    whole = read_hues(path)
    with pytest.raises(MismatchError, match=r"a.exr needs at least \d+M.*--max-memory") as refusal:
        read_hues(path, threads=3, max_memory="64K")
    least = re.search(r"at least (\d+M)", str(refusal.value))[1]
    caplog.clear()
    assert read_hues(path, threads=3, max_memory=least) == whole
    assert caplog.text.rstrip().endswith(", 1 threads")


def test_blocks_do_not_show(tmp_path, monkeypatch):
    """Of whole rows, and of parts of one: where numpy counts."""
    monkeypatch.setenv("HPCOMP_ENGINE", "reference")
    path = exr(tmp_path / "a.exr", noise(70, 31))
    whole = read_hues(path)
    for pixels in (7, 31, 100):
        monkeypatch.setattr(hues, "BLOCK_PIXELS", pixels)
        assert read_hues(path) == whole


@pytest.mark.parametrize("png", pngfile.every_kind(), ids=pngfile.name_of)
def test_every_kind_of_png(tmp_path, png):
    path = tmp_path / "a.png"
    path.write_bytes(png.encode())
    assert read_hues(path) == hue_histogram(hpcomp.read_layer(path).pixels)


def test_keys_of_a_layer_say_how_it_is_read(tmp_path):
    names = ["R", "G", "B", "A", "sky.R", "sky.G", "sky.B"]
    path = exrfile.write(tmp_path / "a.exr", exrfile.planes(names, 20, 30))
    histograms = []
    keys = ("part=0", "layer=sky", "part=0,alpha=straight", "part=0,colorspace=srgb")
    for settings in (f"::{key}" for key in keys):
        layer = f"{path}{settings}"
        histograms.append(read_hues(layer))
        assert histograms[-1] == hue_histogram(hpcomp.read_layer(layer).pixels)
    for number, one in enumerate(histograms):
        assert all(one != other for other in histograms[:number])


@pytest.mark.parametrize("setting", ["op=in", "opacity=0.5", "at=+1+1"])
def test_settings_that_only_a_stack_understands(setting):
    with pytest.raises(SettingError, match=f"'{setting.partition('=')[0]}' says nothing"):
        read_hues(f"a.png::{setting}")


def test_pixels_that_are_not_finite(tmp_path):
    pixels = noise(200, 10)
    pixels[150, 3, 1] = np.nan
    pixels[20, 7, 0] = np.inf
    path = exr(tmp_path / "a.exr", pixels)
    for threads in (1, 3):
        with pytest.raises(MismatchError, match="2 pixels are NaN or infinite, the first at 7,20"):
            read_hues(path, threads=threads)
    kept = read_hues(path, nonfinite="keep")
    assert kept.nonfinite == 2
    with pytest.warns(hpcomp.HpcompWarning, match="2 pixels are NaN or infinite and became"):
        zeroed = read_hues(path, nonfinite="zero")
    assert (zeroed.nonfinite, zeroed.transparent) == (0, kept.transparent + 2)
    with pytest.raises(MismatchError, match="--strict"):
        read_hues(path, nonfinite="zero", strict=True)


@pytest.mark.parametrize("threads", [1, 4])
def test_damage_after_the_first_strips(tmp_path, threads):
    path = exr(tmp_path / "a.exr", noise(400, 40))
    data = bytearray(path.read_bytes())
    begin, end = exrfile.regions(bytes(data))["pixels"][-1]
    data[begin + 8 : end] = bytes(end - begin - 8)
    path.write_bytes(data)
    with pytest.raises(InputError, match="cannot be read, rows 384 to 399"):
        read_hues(path, threads=threads)


def test_the_first_failure_is_that_of_the_first_strip_on_any_number_of_threads(tmp_path):
    pixels = noise(400, 40)
    pixels[10, 10, 0] = np.nan
    path = exr(tmp_path / "a.exr", pixels)
    for threads in (1, 2, 8):
        with pytest.raises(MismatchError, match="the first at 10,10"):
            read_hues(path, threads=threads)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"threads": 0}, "threads 0 is below 1"),
        ({"max_memory": "much"}, "'much' is not an amount of memory"),
        ({"nonfinite": "drop"}, "unknown nonfinite policy 'drop'"),
        ({"bins": 2}, "bins 2"),
        ({"space": "rgb"}, "unknown blending space"),
    ],
)
def test_settings_are_checked_before_the_file_is_opened(settings, words):
    with pytest.raises(SettingError, match=words):
        read_hues("nowhere.png", **settings)


def test_missing_file():
    with pytest.raises(InputError, match=r"nowhere.png: cannot be read: no such file"):
        read_hues("nowhere.png")


# ---- by the engine ------------------------------------------------------------------------------

#: Colours as files have them, and as the rarest do: of every transfer and of two sets of primaries.
ENCODINGS = [
    SRGB_ENCODING, LINEAR_REC709, COLOR_SPACES["adobe-rgb"], COLOR_SPACES["acescg"], COLOR_SPACES["display-p3"],
]  # fmt: skip


def stored(kind, channels, seed):
    """(9, 700, channels) samples: labels, greys, runs of one colour, noise, and what is not finite."""
    rng = np.random.default_rng(seed)
    samples = rng.random((9, 700, channels))
    samples[1] = samples[1, :1]
    samples[2] = samples[2, ::1, :1]
    samples[3] = 0
    samples[4, :, -1] = 0
    samples[5] = np.repeat(samples[5, ::70], 70, axis=0)
    if np.dtype(kind).kind == "u":
        return (samples * np.iinfo(kind).max).round().astype(kind)
    samples[6] = samples[6] * 40 - 20
    samples[7] = np.where(rng.random((700, channels)) < 0.05, rng.choice([np.nan, np.inf, -np.inf]), samples[7])
    with np.errstate(over="ignore"):
        samples[8] *= 10.0 ** rng.integers(-8, 39, (700, channels))
        return samples.astype(kind)


@pytest.mark.parametrize("kind", ["uint8", "uint16", "float16", "float32"])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("space", SPACES)
def test_the_engine_counts_as_numpy_does(kind, channels, space):
    """To the bit, whatever is stored; where it does not count, it says so."""
    by_kernel = pytest.importorskip("hpcomp.kernel.fused").ENGINE
    counted = 0
    for number, (encoding, mode, zero) in enumerate(
        itertools.product(ENCODINGS, ALPHA_MODES, [False, True])
    ):
        decoding = Decoding(encoding, mode, stored_straight=True, zero_nonfinite=zero)
        strip = Strip(stored(kind, channels, number), decoding)
        bins, achromatic = [(360, 0.02), (6, 0.0), (3600, 1.0), (7, 0.5)][number % 4]
        like = HueHistogram.empty(bins, space, achromatic)
        assert reference.ENGINE.hues(strip, like) is None
        found = by_kernel.hues(strip, like)
        if not decoding.is_plain(strip.samples) or not spaces.space(space).linear:
            assert found is None
            continue
        with np.errstate(all="ignore"):
            rgba, _ = linear_rgba(strip)
        expected = hue_histogram(rgba, bins=bins, space=space, achromatic=achromatic)
        assert found == expected, (encoding, mode, zero)
        counted += 1
    assert counted or not spaces.space(space).linear


def test_hues_of_a_file_are_the_same_by_both_engines(tmp_path, monkeypatch):
    picture = pngfile.random_png(pngfile.RGBA, 16, width=301, height=97)
    (tmp_path / "a.png").write_bytes(picture.encode())
    exr(tmp_path / "a.exr", noise(97, 301))
    for name in ("a.png", "a.exr"):
        for options in ({}, {"space": "oklab"}, {"bins": 90, "achromatic": 0.3}):
            monkeypatch.delenv("HPCOMP_ENGINE", raising=False)
            found = [read_hues(tmp_path / name, threads=n, **options) for n in (1, 2, 3)]
            monkeypatch.setenv("HPCOMP_ENGINE", "reference")
            found += [read_hues(tmp_path / name, threads=n, **options) for n in (1, 2)]
            assert found[0].pixels == 97 * 301
            assert all(histogram == found[0] for histogram in found[1:])


def test_the_kernel_counts_where_it_can(tmp_path, monkeypatch):
    """Numpy takes ten times as long."""
    pytest.importorskip("hpcomp.kernel.fused")
    (tmp_path / "a.png").write_bytes(pngfile.random_png(pngfile.RGBA, 8, width=31, height=70).encode())
    before = read_hues(tmp_path / "a.png")

    def by_numpy(*arguments, **settings):
        raise AssertionError("numpy counts")

    monkeypatch.setattr(hues, "hue_histogram", by_numpy)
    assert read_hues(tmp_path / "a.png", threads=2) == before
