"""The PNG files that are written: read back by four readers, and chunk by chunk."""

from __future__ import annotations

import itertools
import os
import shutil
import struct
import subprocess
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pngfile
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import hpcomp
from hpcomp.geometry import Window
from hpcomp.imagefile import deflate
from hpcomp.imagefile.header import PictureHeader
from hpcomp.imagefile.packing import png_filtered
from hpcomp.imagefile.pngwriter import COMPRESSIONS, PngWriter

DTYPES = {8: np.uint8, 16: np.uint16}
TERRAIN = Path(__file__).parents[2] / "samples" / "terrain" / "layers"

# What the default compression may cost over OpenImageIO's, which takes ten times as long.
SHARE_OF_DEFAULT = 1.1


# ---- pictures ----------------------------------------------------------------------------------


def noise(width, height, depth):
    rng = np.random.default_rng([width, height, depth])
    return rng.integers(0, 2**depth, (height, width, 4), DTYPES[depth])


def smooth(width, height, depth):
    y, x = np.mgrid[0:height, 0:width] / max(width, height)
    planes = np.stack([x, y, (x + y) / 2, 1 - x * y], axis=-1)
    return np.rint(planes * (2**depth - 1)).astype(DTYPES[depth])


def flat(width, height, depth):
    """A few labels with sharp edges, over nothing."""
    rng = np.random.default_rng([width, height])
    colors = rng.integers(0, 2**depth, (5, 4), DTYPES[depth])
    colors[0] = 0
    y, x = np.mgrid[0:height, 0:width]
    return colors[(x // 9 + y // 14 * 3) % 5]


def empty(width, height, depth):
    return np.zeros((height, width, 4), DTYPES[depth])


PICTURES = (noise, smooth, flat, empty)


def writer(path, samples, compression="fast", **density):
    height, width = samples.shape[:2]
    window = Window(0, 0, width, height)
    header = PictureHeader(window, window, **density)
    return PngWriter(str(path), header, 8 * samples.dtype.itemsize, compression, "out.png")


def write(path, samples, compression="fast", cuts=(), **density):
    """The picture in strips that end at `cuts`; the file's bytes."""
    opened = writer(path, samples, compression, **density)
    begin = 0
    for strip in np.split(samples, cuts):
        opened.write(opened.prepare(begin, strip))
        begin += len(strip)
    opened.finish()
    opened.abandon()
    return Path(path).read_bytes()


def by_openimageio(path):
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)
    image = oiio.ImageInput.open(str(path), hint)
    assert image is not None, oiio.geterror()
    pixels = image.read_image(0, 0, 0, 4, image.spec().format)
    assert pixels is not None, image.geterror()
    image.close()
    return pixels


def by_pillow(path):
    """(h, w, 4) of 8 bits; of 16 bits Pillow keeps the upper 8."""
    with Image.open(path) as image:
        image.verify()
    with Image.open(path) as image:
        assert image.mode == "RGBA"
        return np.array(image)


def assert_reads_as(path, samples):
    """By OpenImageIO, Pillow, the tests' own decoder, and no fault found by pngcheck."""
    for pixels in (by_openimageio(path), pngfile.decode(Path(path).read_bytes())):
        assert pixels.dtype == samples.dtype
        assert np.array_equal(pixels, samples)
    upper = samples if samples.dtype == np.uint8 else (samples >> 8).astype(np.uint8)
    assert np.array_equal(by_pillow(path), upper)
    # A fourth opinion where there is one: the three above have read every pixel.
    pngcheck = shutil.which("pngcheck")
    if pngcheck:
        done = subprocess.run([pngcheck, "-q", path], capture_output=True, text=True)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


# ---- pixels ------------------------------------------------------------------------------------

SIZES = ((1, 1), (2, 1), (1, 2), (1, 77), (77, 1), (13, 5), (64, 64), (31, 65))


class TestPixels:
    @pytest.mark.parametrize("depth", DTYPES)
    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_of_any_size(self, tmp_path, compression, depth):
        for (width, height), picture in itertools.product(SIZES, PICTURES):
            samples = picture(width, height, depth)
            write(tmp_path / "a.png", samples, compression)
            assert_reads_as(tmp_path / "a.png", samples)

    @pytest.mark.pairwise
    @pytest.mark.parametrize("depth", DTYPES)
    @pytest.mark.parametrize("compression", ["fast", "small", "0", "6"])
    @pytest.mark.parametrize("size", [(1200, 131), (40, 3500), (4000, 70)], ids=str)
    def test_of_many_segments(self, tmp_path, size, compression, depth):
        """Each is filtered and deflated by itself; the last one is short."""
        width, height = size
        samples = np.concatenate([noise(width, height // 2, depth),
                                  smooth(width, height - height // 2, depth)])  # fmt: skip
        data = write(tmp_path / "a.png", samples, compression)
        assert_reads_as(tmp_path / "a.png", samples)
        assert [kind for kind, _ in pngfile.split(data)].count(b"IDAT") - 2 > 1

    def test_every_filter_is_used(self, tmp_path):
        """So that reading back proves each of them."""
        found = set()
        for picture, depth in itertools.product(PICTURES, DTYPES):
            data = write(tmp_path / "a.png", picture(40, 30, depth), "small")
            stream = b"".join(body for kind, body in pngfile.split(data) if kind == b"IDAT")
            raw = zlib.decompress(stream)
            found |= set(raw[:: len(raw) // 30])
        # A ramp in both directions is what the mean of left and above predicts.
        y, x = np.mgrid[0:30, 0:40]
        ramp = np.repeat((3 * x + 5 * y)[..., None] % 256, 4, axis=2).astype(np.uint8)
        data = write(tmp_path / "a.png", ramp, "small")
        assert_reads_as(tmp_path / "a.png", ramp)
        stream = b"".join(body for kind, body in pngfile.split(data) if kind == b"IDAT")
        raw = zlib.decompress(stream)
        found |= set(raw[:: len(raw) // 30])
        assert found == {0, 1, 2, 3, 4}

    @pytest.mark.parametrize("depth", DTYPES)
    def test_every_value_in_every_channel(self, tmp_path, depth):
        values = np.arange(2**depth, dtype=DTYPES[depth]).reshape(-1, 256)
        samples = np.stack([values, values[::-1], values[:, ::-1], values ^ 85], axis=-1)
        for compression in ("fast", "small"):
            write(tmp_path / "a.png", samples, compression)
            assert_reads_as(tmp_path / "a.png", samples)

    def test_samples_are_left_as_they_are(self, tmp_path):
        for depth in DTYPES:
            samples = noise(20, 10, depth)
            samples.flags.writeable = False
            write(tmp_path / "a.png", samples)
            assert np.array_equal(samples, noise(20, 10, depth))

    def test_strips_may_be_views(self, tmp_path):
        samples = noise(20, 10, 16)
        plain = write(tmp_path / "a.png", samples)
        turned = np.ascontiguousarray(samples[::-1])[::-1]
        assert write(tmp_path / "b.png", turned) == plain
        assert write(tmp_path / "b.png", np.asfortranarray(samples)) == plain


# ---- bytes -------------------------------------------------------------------------------------

#: Three segments of 64 rows, the last of them short.
WIDE = {depth: noise(1200 if depth == 8 else 600, 131, depth) for depth in DTYPES}


class TestBytes:
    @given(
        cuts=st.lists(
            st.one_of(st.integers(1, 130), st.sampled_from([63, 64, 65, 127, 128, 129])),
            max_size=6,
            unique=True,
        ).map(sorted),
        depth=st.sampled_from(sorted(DTYPES)),
    )
    def test_do_not_depend_on_the_strips(self, tmp_path_factory, cuts, depth):
        folder = tmp_path_factory.mktemp("strips", numbered=True)
        whole = write(folder / "a.png", WIDE[depth])
        assert write(folder / "b.png", WIDE[depth], cuts=cuts) == whole
        shutil.rmtree(folder)

    @pytest.mark.parametrize("compression", ["fast", "small", "0", "3"])
    def test_do_not_depend_on_the_strips_whatever_the_compression(self, tmp_path, compression):
        whole = write(tmp_path / "a.png", WIDE[8], compression)
        for cuts in (range(1, 131), range(7, 131, 7), (64,), (64, 100), (60, 128), (64, 128)):
            assert write(tmp_path / "b.png", WIDE[8], compression, cuts) == whole
        assert_reads_as(tmp_path / "b.png", WIDE[8])

    @pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (17, 200)])
    def test_of_small_pictures_neither(self, tmp_path, size):
        samples = flat(*size, 16)
        whole = write(tmp_path / "a.png", samples)
        for rows in (1, 2, 7, 64, 100):
            cuts = range(rows, len(samples), rows)
            assert write(tmp_path / "b.png", samples, cuts=cuts) == whole

    @pytest.mark.parametrize("compression", ["fast", "small"])
    def test_nor_on_the_threads_that_prepare(self, tmp_path, compression):
        """They may do it in any order, many at a time."""
        whole = write(tmp_path / "a.png", WIDE[8], compression)
        opened = writer(tmp_path / "b.png", WIDE[8], compression)
        begins = [0, 64, 100, 110, 128]
        strips = np.split(WIDE[8], begins[1:])
        with ThreadPoolExecutor(4) as pool:
            prepared = [
                pool.submit(opened.prepare, begin, strip)
                for begin, strip in reversed(list(zip(begins, strips, strict=True)))
            ]
            for future in reversed(prepared):
                opened.write(future.result())
        opened.finish()
        assert (tmp_path / "b.png").read_bytes() == whole

    def test_nor_on_the_path(self, tmp_path):
        first = write(tmp_path / "a.png", WIDE[8])
        (tmp_path / "other").mkdir()
        assert write(tmp_path / "other" / "name.png", WIDE[8]) == first

    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_a_sum_of_checksums_is_the_checksum(self, compression, tmp_path):
        """Of all bytes 255 and of all bytes 0 too, where its parts wrap around."""
        for fill in (0, 255):
            samples = np.full((131, 1200, 4), fill, np.uint8)
            data = write(tmp_path / "a.png", samples, compression)
            stream = b"".join(body for kind, body in pngfile.split(data) if kind == b"IDAT")
            raw = zlib.decompress(stream)  # checks the Adler-32 too
            assert stream[-4:] == struct.pack(">I", zlib.adler32(raw))


# ---- chunks ------------------------------------------------------------------------------------

# IEC 61966-2-1 and ITU-R BT.709: white, red, green, blue.
CHRM = struct.pack(">8I", 31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)


class TestChunks:
    @pytest.mark.parametrize("depth", DTYPES)
    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_are_exactly_these(self, tmp_path, compression, depth):
        data = write(tmp_path / "a.png", noise(13, 5, depth), compression)
        chunks = pngfile.split(data)  # checks every CRC
        header = struct.pack(">IIBBBBB", 13, 5, depth, pngfile.RGBA, 0, 0, 0)
        colour = [(b"sRGB", b"\0"), (b"gAMA", struct.pack(">I", 45455)), (b"cHRM", CHRM)]
        assert chunks[:4] == [(b"IHDR", header), *colour]
        assert {kind for kind, _ in chunks[4:-1]} == {b"IDAT"}
        assert chunks[-1] == (b"IEND", b"")
        assert all(body for kind, body in chunks if kind == b"IDAT")

    def test_pillow_finds_the_colours_and_the_resolution(self, tmp_path):
        write(tmp_path / "a.png", noise(3, 2, 8), pixels_per_metre=(11811.0, 5905.5))
        with Image.open(tmp_path / "a.png") as image:
            assert image.info["srgb"] == 0
            assert image.info["gamma"] == 0.45455
            white_and_red = image.info["chromaticity"][:4]
            assert white_and_red == pytest.approx((0.3127, 0.3290, 0.64, 0.33), abs=1e-6)
            assert image.info["dpi"] == pytest.approx((300, 150), abs=0.02)

    @pytest.mark.parametrize(
        ("density", "expected"),
        [
            ({}, None),
            ({"pixels_per_metre": (2834.6457, 3937.0079)}, (2835, 3937, 1)),
            ({"pixels_per_metre": (11811.02, 5905.51)}, (11811, 5906, 1)),
            ({"pixels_per_metre": (1.0, 1.0)}, (1, 1, 1)),
            ({"pixels_per_metre": (2147483646.0, 7.0)}, (2147483646, 7, 1)),
            # A resolution says what the shape is, too.
            ({"pixels_per_metre": (100.0, 200.0), "pixel_aspect": 2.0}, (100, 200, 1)),
            ({"pixel_aspect": 2.0}, (10000, 20000, 0)),
            ({"pixel_aspect": 0.5}, (10000, 5000, 0)),
            ({"pixel_aspect": 4 / 3}, (10000, 13333, 0)),
            ({"pixel_aspect": 1.0}, None),
            # What no pHYs can hold is left out: a wrong number would be worse.
            ({"pixels_per_metre": (1e12, 1e12)}, None),
            ({"pixels_per_metre": (float("inf"), 1.0)}, None),
            ({"pixels_per_metre": (0.01, 0.01)}, None),
            ({"pixel_aspect": 1e6}, None),
            ({"pixel_aspect": 1e-6}, None),
        ],
    )
    def test_density(self, tmp_path, density, expected):
        samples = noise(3, 2, 8)
        chunks = pngfile.split(write(tmp_path / "a.png", samples, **density))
        kinds = [kind for kind, _ in chunks]
        found = [struct.unpack(">IIB", body) for kind, body in chunks if kind == b"pHYs"]
        assert found == ([expected] if expected else [])
        place = [b"pHYs"] if expected else []
        assert kinds[:4] == [b"IHDR", b"sRGB", b"gAMA", b"cHRM"]
        assert kinds[4 : kinds.index(b"IDAT")] == place
        assert_reads_as(tmp_path / "a.png", samples)

    def test_a_shape_of_pixels_comes_through_a_stack(self, tmp_path):
        png = pngfile.random_png(pngfile.RGBA, 8, width=6, height=5)
        (tmp_path / "a.png").write_bytes(png.with_chunks(body=[pngfile.phys(3, 4, 0)]).encode())
        hpcomp.stack([tmp_path / "a.png"], tmp_path / "out.png")
        chunks = dict(pngfile.split((tmp_path / "out.png").read_bytes()))
        x, y, unit = struct.unpack(">IIB", chunks[b"pHYs"])
        assert unit == 0
        assert y / x == pytest.approx(4 / 3, abs=5e-5)


# ---- sizes -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    """The terrain sample as its README composites it, with each compression that has a name."""
    folder = tmp_path_factory.mktemp("terrain")
    names = ("hillshade.png", "elevation.png", "steep.exr", "summits.exr", "fault.exr")
    layers = [*(str(TERRAIN / name) for name in names), f"{TERRAIN / 'streams.png'}::opacity=0.65"]
    for compression in ("fast", "small"):
        hpcomp.stack(layers, folder / f"{compression}.png", compression=compression)
    return folder


def size_by_openimageio(path, pixels):
    """Of the file that it writes by default."""
    height, width = pixels.shape[:2]
    spec = oiio.ImageSpec(width, height, 4, oiio.UINT8)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    output = oiio.ImageOutput.create("png")
    assert output.open(str(path), spec), output.geterror()
    assert output.write_image(pixels)
    assert output.close()
    assert np.array_equal(by_openimageio(path), pixels)
    return os.path.getsize(path)


def grainy(width, height, depth):
    """Smooth light with a little noise, as most pictures have it."""
    rng = np.random.default_rng([width, height, depth])
    grain = rng.normal(0, 0.004, (height, width, 4))
    y, x = np.mgrid[0:height, 0:width, 0:1][:2] / 200
    light = 0.5 + 0.4 * np.sin(x + y + np.arange(4)) * np.cos(y - 2 * x) + grain
    return np.rint(light * (2**depth - 1)).astype(DTYPES[depth])


class TestFast:
    """Deflated in one of several ways, which a sample chooses."""

    #: Pictures, and the way that each is for.
    WAYS = ((noise, 0), (grainy, 1), (flat, 2))

    def rows(self, picture, depth=8):
        return png_filtered(picture(600, 130, depth).view(np.uint8).reshape(130, -1), depth // 2)

    @pytest.mark.parametrize(("picture", "way"), WAYS)
    def test_every_way_is_chosen(self, picture, way):
        rows = self.rows(picture)
        found = deflate.deflated_fast(rows)
        sizes = [len(each(rows)) for each in deflate._FAST]
        assert found == deflate._FAST[way](rows)
        assert len(found) <= 1.02 * min(sizes)
        assert len(found) < 0.9 * max(sizes) or picture is noise

    @pytest.mark.parametrize("size", [1, 2, 4095, 4096, 4097, 16_384, 16_385, 70_001])
    def test_any_size(self, size):
        for data in (noise(size, 1, 8).reshape(-1)[:size], np.zeros(size, np.uint8), np.arange(size).astype(np.uint8)):
            deflated = deflate.deflated_fast(data) + deflate.LAST_BLOCK
            stream = zlib.decompressobj(-zlib.MAX_WBITS)
            assert stream.decompress(deflated) == data.tobytes()
            assert stream.eof

    def test_the_sample_is_from_all_over(self):
        """Half of a segment that is blank says nothing of the other half."""
        blank, busy = np.zeros((65, 2401), np.uint8), self.rows(flat)[:65]
        for halves in ((blank, busy), (busy, blank)):
            rows = np.concatenate(halves)
            assert deflate.deflated_fast(rows) == deflate._FAST[2](rows)

    def test_light_with_grain_is_smaller_than_by_openimageio(self, tmp_path):
        samples = grainy(1200, 300, 8)
        ours = len(write(tmp_path / "a.png", samples))
        assert ours <= size_by_openimageio(tmp_path / "b.png", samples)


class TestSizes:
    def test_fast_costs_little_more_than_the_default_of_openimageio(self, terrain):
        pixels = by_openimageio(terrain / "fast.png")
        default = size_by_openimageio(terrain / "default.png", pixels)
        assert os.path.getsize(terrain / "fast.png") <= SHARE_OF_DEFAULT * default

    def test_the_terrain_reads_the_same_however_it_is_compressed(self, terrain):
        fast, small = (by_openimageio(terrain / f"{name}.png") for name in ("fast", "small"))
        assert np.array_equal(fast, small)
        for name in ("fast", "small"):
            assert np.array_equal(by_pillow(terrain / f"{name}.png"), fast)
        assert np.array_equal(pngfile.decode((terrain / "fast.png").read_bytes()), fast)

    def test_small_is_no_larger_than_any_other(self, terrain, tmp_path):
        pixels = by_openimageio(terrain / "small.png")[:200]
        sizes = {c: len(write(tmp_path / "a.png", pixels, c)) for c in COMPRESSIONS}
        assert sizes["small"] == min(sizes.values())
        assert sizes["0"] == max(sizes.values())

    @pytest.mark.parametrize("depth", DTYPES)
    @pytest.mark.parametrize("picture", PICTURES)
    def test_small_is_no_larger_than_fast(self, tmp_path, picture, depth):
        for width, height in ((1, 1), (50, 40), (300, 200), (1200, 140)):
            samples = picture(width, height, depth)
            fast, small = (len(write(tmp_path / "a.png", samples, c)) for c in ("fast", "small"))
            assert small <= 1.02 * fast, (width, height)  # a filter more or less in tiny pictures

    def test_level_0_stores(self, tmp_path):
        samples = noise(300, 200, 8)
        raw = 200 * (1 + 4 * 300)
        assert raw < len(write(tmp_path / "a.png", samples, "0")) < 1.001 * raw + 400
