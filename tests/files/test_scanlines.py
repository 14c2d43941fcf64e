"""Plain EXR and PNG files, read and written here, against the libraries that read them too."""

from __future__ import annotations

import contextlib
import json
import os
import struct
import subprocess
import sys
import tracemalloc
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import exrfile
import numpy as np
import OpenImageIO as oiio
import pngfile
import pytest
from command import PATIENCE_S, Desk
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import hpcomp
from hpcomp import InputError, MismatchError, Window
from hpcomp.imagefile import description, exrscanlines, packing, pngheader, pngscanlines
from hpcomp.imagefile.description import describe
from hpcomp.imagefile.exrscanlines import COMPRESSIONS, ExrForm, ExrScanlineWriter
from hpcomp.imagefile.header import PictureHeader
from hpcomp.imagefile.openimageio import OpenImageIOExrWriter, OpenImageIOSource
from hpcomp.imagefile.parts import choose
from hpcomp.imagefile.rawfile import RawFile, identity_of
from hpcomp.imagefile.source import source_of

DTYPES = {"half": np.float16, "float": np.float32}
# Width and height; blocks of ZIP have 16 rows.
SIZES = ((1, 1), (1, 17), (3, 16), (7, 33), (40, 5), (17, 31))


# ---- reading -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Layer:
    """One layer of a file: how it is read here, and by OpenImageIO."""

    path: object
    label: str = "layer 3 (a)"
    part: str | None = None
    layer: str | None = None

    def _found(self):
        file = describe(str(self.path))
        part, group = choose(file, part=self.part, layer=self.layer)
        return file, part, (*group.color, *([group.alpha] if group.alpha else []))

    @property
    def window(self):
        return self._found()[1].data_window

    @property
    def plain(self):
        """Whether it is read here."""
        return not source_of(*self._found(), self.label).by_openimageio

    def source(self):
        source = source_of(*self._found(), self.label)
        assert not source.by_openimageio
        return source

    def rows(self, begin=None, end=None):
        """As read here."""
        window, source = self.window, self.source()
        begin = window.y if begin is None else begin
        end = window.bottom if end is None else end
        try:
            return source.read(begin, end)
        finally:
            source.close()

    def by_openimageio(self):
        file, part, channels = self._found()
        source = OpenImageIOSource(file.path, part, channels, self.label)
        try:
            return source.read(part.data_window.y, part.data_window.bottom)
        finally:
            source.close()


def same(found, expected):
    """Whether two arrays are equal to the bit."""
    return (found.shape, found.dtype, found.tobytes()) == (
        expected.shape, expected.dtype, expected.tobytes(),
    )  # fmt: skip


def put(path, content):
    path.write_bytes(content.encode() if isinstance(content, pngfile.Png) else content)
    return path


def any_bits(names, width, height, dtype, seed=0):
    """Planes of random bits, NaN among them: they do not deflate."""
    rng = np.random.default_rng([seed, width, height])
    unsigned = np.dtype(f"u{np.dtype(dtype).itemsize}")
    top = np.iinfo(unsigned).max
    return {
        name: rng.integers(0, top, (height, width), unsigned, endpoint=True).view(dtype)
        for name in names
    }


def stacked(planes, names="RGBA"):
    return np.stack([planes[name] for name in names], axis=-1)


def split_exr(data):
    """The attributes of a plain EXR as {name: (type, value)}, and its blocks as bytes."""
    attributes, at = {}, 8
    while data[at]:
        name_end = data.index(0, at)
        kind_end = data.index(0, name_end + 1)
        (size,) = struct.unpack_from("<I", data, kind_end + 1)
        value = data[kind_end + 5 : kind_end + 5 + size]
        attributes[data[at:name_end]] = data[name_end + 1 : kind_end], value
        at = kind_end + 5 + size
    spans = exrfile.regions(data)
    starts = sorted(begin for begin, _ in spans["heads"])
    return attributes, [data[b:e] for b, e in zip(starts, [*starts[1:], len(data)], strict=True)]


def attribute(name, kind, value):
    return name + b"\0" + kind + b"\0" + struct.pack("<I", len(value)) + value


def join_exr(attributes, blocks, offsets=None):
    """The file again, from what `split_exr` gave; `offsets` stand in place of the right ones."""
    head = b"\x76\x2f\x31\x01" + struct.pack("<I", 2)
    head += b"".join(attribute(name, *what) for name, what in attributes.items()) + b"\0"
    at, right = len(head) + 8 * len(blocks), []
    for one in blocks:
        right.append(at)
        at += len(one)
    return head + struct.pack(f"<{len(blocks)}Q", *(offsets or right)) + b"".join(blocks)


def block(row, data):
    return struct.pack("<iI", row, len(data)) + data


@contextlib.contextmanager
def peak_below(limit):
    """Fails where Python and numpy have allocated more than so many bytes at a time."""
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < limit


class TestExr:
    @pytest.mark.parametrize("kind", DTYPES)
    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_of_any_size(self, tmp_path, compression, kind):
        for (width, height), make in ((s, m) for s in SIZES for m in (exrfile.coarse, any_bits)):
            for origin in ((0, 0), (-40, -7), (1000, 3)):
                planes = make("RGBA", width, height, DTYPES[kind])
                path = exrfile.write(
                    tmp_path / "a.exr", planes, compression=compression, origin=origin,
                    display=(-5, 2, 9, 9),
                )  # fmt: skip
                rows = Layer(path).rows()
                assert same(rows, stacked(planes))
                assert same(rows, Layer(path).by_openimageio())
                assert same(rows, stacked(exrfile.read_back(path)))

    def test_layers_are_what_their_channels_mean(self, tmp_path):
        planes = exrfile.rgba()
        path = exrfile.write(tmp_path / "a.exr", planes, origin=(-3, 9))
        layer = hpcomp.read_layer(path)
        assert Layer(path).plain
        assert layer.data_window == Window(-3, 9, 23, 19)
        assert np.array_equal(layer.pixels, exrfile.layer(planes).astype(np.float32))

    @pytest.mark.parametrize("compression", ["zip", "zips"])
    def test_blocks_that_do_not_deflate_among_others(self, tmp_path, compression):
        planes = exrfile.coarse("RGBA", 230, 80)
        noise = any_bits("RGBA", 230, 80, np.float16)
        for name, plane in planes.items():
            plane[16:48] = noise[name][16:48]
        path = exrfile.write(tmp_path / "a.exr", planes, compression=compression)
        _, blocks = split_exr(path.read_bytes())
        whole = 8 + COMPRESSIONS[compression][1] * 230 * 8
        assert {len(one) == whole for one in blocks} == {True, False}
        assert same(Layer(path).rows(), stacked(planes))

    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_some_channels_of_many(self, tmp_path, compression):
        """Layers of one type are plain, whatever stands between their planes."""
        planes = {
            **any_bits("RGBA", 19, 21, np.float16, 1),
            **{f"light.{n}": p for n, p in any_bits("RGB", 19, 21, np.float32, 2).items()},
            **{f"mask.{n}": p for n, p in any_bits("Y", 19, 21, np.float16, 3).items()},
            **{f"mixed.{n}": p for n, p in any_bits("RGB", 19, 21, np.float16, 4).items()},
            "mixed.A": any_bits("A", 19, 21, np.float32, 5)["A"],
            "Z": any_bits("Z", 19, 21, np.float32, 6)["Z"],
            "id": np.arange(19 * 21, dtype=np.uint32).reshape(21, 19),
            **{f"count.{n}": np.full((21, 19), 7, np.uint32) for n in "RGB"},
        }
        path = exrfile.write(tmp_path / "a.exr", planes, compression=compression)
        for layer, names in {"": "RGBA", "light": "RGB", "mask": "Y"}.items():
            wanted = [f"{layer}.{name}".lstrip(".") for name in names]
            assert same(Layer(path, layer=layer).rows(), stacked(planes, wanted)), layer
        for layer in ("mixed", "count"):
            assert not Layer(path, layer=layer).plain
            assert Layer(path, layer=layer).by_openimageio().dtype == np.float32

    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_many_layers(self, tmp_path, compression):
        names = [f"light{number:03}.{name}" for number in range(200) for name in "RGBA"]
        planes = any_bits(names, 5, 18, np.float16)
        path = exrfile.write(tmp_path / "a.exr", planes, compression=compression)
        for layer in ("light000", "light117", "light199"):
            wanted = [f"{layer}.{name}" for name in "RGBA"]
            assert same(Layer(path, layer=layer).rows(), stacked(planes, wanted))

    @pytest.mark.parametrize("layer", ["x" * 200, "Blätter", "a.b.c"])
    def test_names_that_are_long_or_not_ascii(self, tmp_path, layer):
        planes = {f"{layer}.{n}": p for n, p in any_bits("RGB", 4, 3, np.float16).items()}
        path = exrfile.write(tmp_path / "a.exr", planes)
        wanted = [f"{layer}.{name}" for name in "RGB"]
        assert same(Layer(path, layer=layer).rows(), stacked(planes, wanted))

    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_rows_in_any_order(self, tmp_path_factory, compression):
        planes = exrfile.coarse("RGB", 5, 70)
        path = tmp_path_factory.mktemp("exr") / "a.exr"
        exrfile.write(path, planes, compression=compression, origin=(2, -30))
        whole, source = stacked(planes, "RGB"), Layer(path).source()

        @given(st.integers(-30, 39), st.integers(1, 70))
        def test(begin, count):
            end = min(begin + count, 40)
            assert same(source.read(begin, end), whole[begin + 30 : end + 30])

        test()
        source.close()
        # And again, opened anew.
        assert same(source.read(-30, 40), whole)
        source.close()

    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_decreasing_lines(self, tmp_path, compression):
        planes = exrfile.coarse("RGBA", 6, 37)
        path = exrfile.write(
            tmp_path / "a.exr", planes, compression=compression, line_order="decreasing"
        )
        assert b"lineOrder\0lineOrder\0\1\0\0\0\1" in path.read_bytes()
        assert same(Layer(path).rows(), stacked(planes))

    @pytest.mark.parametrize(
        "options",
        [{"compression": "rle"}, {"compression": "piz"}, {"compression": "pxr24"},
         {"compression": "dwaa"}, {"compression": "htj2k32"}, {"tile": (8, 8)}, {"tile": (16, 5)}],
        ids=str,
    )  # fmt: skip
    def test_others_are_openimageio_s(self, tmp_path, options):
        path = exrfile.write(tmp_path / "a.exr", exrfile.coarse("RGBA", 20, 40), **options)
        assert not Layer(path).plain
        assert hpcomp.read_layer(path).pixels.shape == (40, 20, 4)

    def test_parts_are_openimageio_s(self, tmp_path):
        parts = [(name, exrfile.coarse("RGBA", 9, 20, seed=n), {}) for n, name in enumerate("ab")]
        path = exrfile.write_parts(tmp_path / "a.exr", parts)
        for name, planes, _ in parts:
            assert not Layer(path, part=name).plain
            assert same(Layer(path, part=name).by_openimageio(), stacked(planes))

    @pytest.mark.parametrize(("size", "plain"), [(60_000, True), (1 << 16, False), (10**6, False)])
    def test_a_long_header(self, tmp_path, size, plain):
        planes = exrfile.coarse("RGBA", 9, 40)
        attributes, blocks = split_exr(exrfile.write(tmp_path / "a.exr", planes).read_bytes())
        attributes[b"comment"] = b"string", b"x" * size
        path = put(tmp_path / "a.exr", join_exr(attributes, blocks))
        assert Layer(path).plain == plain
        layer = hpcomp.read_layer(path)
        assert np.array_equal(layer.pixels, exrfile.layer(planes).astype(np.float32))


class TestExrHeaders:
    """What OpenEXR takes otherwise than we would is left to it."""

    PLANES = exrfile.coarse("ABGRZ", 12, 40)

    @pytest.fixture
    def parts(self, tmp_path):
        path = exrfile.write(tmp_path / "a.exr", self.PLANES, origin=(-3, 5))
        return split_exr(path.read_bytes())

    def agree(self, path, plain):
        """What is read from it, where `plain` here and by OpenImageIO, else by the latter."""
        layer = Layer(path)
        assert layer.plain == plain
        theirs = layer.by_openimageio()
        if plain:
            assert same(layer.rows(), theirs)
        return theirs

    def test_as_it_was(self, tmp_path, parts):
        path = put(tmp_path / "b.exr", join_exr(*parts))
        assert same(self.agree(path, True), stacked(self.PLANES))

    def test_channels_that_are_not_sorted(self, tmp_path, parts):
        """OpenEXR sorts them, and takes the planes to be sorted: the first is A's all the same."""
        attributes, blocks = parts
        kind, value = attributes[b"channels"]
        each = [value[at : at + 18] for at in range(0, 90, 18)]
        for order in ((3, 2, 1, 0, 4), (4, 0, 1, 2, 3), (0, 1, 3, 2, 4)):
            attributes[b"channels"] = kind, b"".join(each[i] for i in order) + b"\0"
            path = put(tmp_path / "b.exr", join_exr(attributes, blocks))
            assert same(self.agree(path, False), stacked(self.PLANES))

    def test_a_channel_that_is_there_twice(self, tmp_path, parts):
        attributes, blocks = parts
        kind, value = attributes[b"channels"]
        attributes[b"channels"] = kind, value.replace(b"Z\0", b"R\0")
        path = put(tmp_path / "b.exr", join_exr(attributes, blocks))
        assert exrscanlines.layout_of(str(path)) is None

    @pytest.mark.parametrize(
        "name",
        [b"channels", b"compression", b"dataWindow", b"displayWindow", b"lineOrder",
         b"pixelAspectRatio", b"screenWindowCenter", b"screenWindowWidth"],
    )  # fmt: skip
    def test_attributes_that_must_be_there(self, tmp_path, parts, name):
        attributes, blocks = parts
        kind, value = attributes[name]
        for other in ({}, {name: (kind + b"x", value)}, {name + b"x": (kind, value)}):
            kept = {key: what for key, what in attributes.items() if key != name}
            path = put(tmp_path / "b.exr", join_exr({**kept, **other}, blocks))
            assert exrscanlines.layout_of(str(path)) is None

    def test_an_attribute_that_is_there_twice(self, tmp_path, parts):
        attributes, blocks = parts
        for name, what in attributes.items():
            # A name of the same length, which is then made the same.
            other = name[:-1] + b"\xff"
            data = join_exr({**attributes, other: what}, blocks).replace(other, name)
            assert exrscanlines.layout_of(str(put(tmp_path / "b.exr", data))) is None

    @pytest.mark.parametrize("kind", [b"scanlineimage", b"tiledimage", b"deepscanline", b"?"])
    def test_flags_decide_not_the_type(self, tmp_path, parts, kind):
        attributes, blocks = parts
        attributes[b"type"] = b"string", kind
        attributes[b"tiles"] = b"tiledesc", struct.pack("<IIB", 4, 4, 0)
        path = put(tmp_path / "b.exr", join_exr(attributes, blocks))
        assert same(self.agree(path, True), stacked(self.PLANES))

    def test_a_table_that_was_not_written(self, tmp_path, parts):
        """An interrupted writer leaves zeros: OpenEXR finds the blocks where they are."""
        attributes, blocks = parts
        data = join_exr(attributes, blocks)
        first, second, third = (begin for begin, _ in exrfile.regions(data)["heads"])
        for wrong in (0, 8, first - 1, len(data) - 7, len(data), 2**63, 2**64 - 1):
            for offsets in ([wrong] * 3, [wrong, second, third], [first, second, wrong]):
                path = put(tmp_path / "b.exr", join_exr(attributes, blocks, offsets))
                assert not Layer(path).plain
        for offsets in ([0] * 3, [first, 0, third], [first, second, 0], [len(data)] * 3):
            path = put(tmp_path / "b.exr", join_exr(attributes, blocks, offsets))
            assert same(self.agree(path, False), stacked(self.PLANES))

    def test_windows_without_pixels(self, tmp_path, parts):
        attributes, blocks = parts
        for window in (
            (5, 5, 4, 9), (5, 5, 9, 4), (0, 0, -(2**31), 9), (2**31 - 1, 0, -(2**31), 0),
        ):  # fmt: skip
            attributes[b"dataWindow"] = b"box2i", struct.pack("<4i", *window)
            path = put(tmp_path / "b.exr", join_exr(attributes, blocks))
            assert exrscanlines.layout_of(str(path)) is None

    def test_more_rows_than_the_file_has_room_for(self, tmp_path, parts):
        """Nor is so large a table read."""
        attributes, blocks = parts
        attributes[b"dataWindow"] = b"box2i", struct.pack("<4i", 0, -(2**31), 11, 2**31 - 1)
        path = put(tmp_path / "b.exr", join_exr(attributes, blocks))
        with peak_below(1 << 20):
            assert exrscanlines.layout_of(str(path)) is None

    def test_headers_cut_short(self, tmp_path, parts):
        data = join_exr(*parts)
        blocks = exrfile.regions(data)["heads"][0][0]
        for length in range(blocks):
            assert exrscanlines.layout_of(str(put(tmp_path / "b.exr", data[:length]))) is None


# ---- damage ------------------------------------------------------------------------------------


def refused(path, *words):
    """Reading fails with `InputError`: one line that begins with the layer and says these words."""
    layer = Layer(path)
    with pytest.raises(InputError) as caught:
        layer.rows()
    message = str(caught.value)
    assert message.startswith(layer.label + ": cannot be read")
    assert "\n" not in message
    for word in words:
        assert word in message
    return message


def attempt(read):
    """What is read, or the error that says why it cannot be."""
    try:
        return read()
    except (InputError, MismatchError) as error:
        return error


class TestExrDamage:
    PLANES = exrfile.coarse("RGBA", 12, 40)
    BLOCK = 16 * 12 * 8  # bytes

    @pytest.fixture
    def parts(self, tmp_path):
        return split_exr(exrfile.write(tmp_path / "a.exr", self.PLANES).read_bytes())

    def test_offsets_of_other_blocks(self, tmp_path, parts):
        attributes, blocks = parts
        spans = exrfile.regions(join_exr(attributes, blocks))["heads"]
        first, second, third = (begin for begin, _ in spans)
        for offsets in (
            [second, first, third], [first] * 3, [third] * 3, [first + 1, second, third],
            [first, second - 1, third],
        ):  # fmt: skip
            path = put(tmp_path / "b.exr", join_exr(attributes, blocks, offsets))
            refused(path, "rows ", "their block is not where it should be")
        # Those rows that can be found are read.
        path = put(tmp_path / "b.exr", join_exr(attributes, blocks, [first, first, third]))
        assert same(Layer(path).rows(0, 16), stacked(self.PLANES)[:16])
        assert same(Layer(path).rows(35, 40), stacked(self.PLANES)[35:])

    @pytest.mark.parametrize("size", [2**31 - 1, 2**31, 2**32 - 1, BLOCK + 1])
    def test_blocks_that_are_too_large(self, tmp_path, parts, size):
        attributes, (first, *others) = parts
        damaged = first[:4] + struct.pack("<I", size) + first[8:]
        path = put(tmp_path / "b.exr", join_exr(attributes, [damaged, *others]))
        with peak_below(1 << 20):
            refused(path, "rows 0 to 15", "their block is not where it should be")

    def test_a_block_that_ends_behind_the_file(self, tmp_path, parts):
        data = join_exr(*parts)
        refused(put(tmp_path / "b.exr", data[:-1]), f"it ends before byte {len(data)}")

    def test_memory_is_not_reserved_for_what_the_file_has_not(self, tmp_path):
        """A block of 1 GiB in a file of few bytes."""
        planes = exrfile.coarse("RGBA", 12, 16)
        attributes, _ = split_exr(exrfile.write(tmp_path / "a.exr", planes).read_bytes())
        attributes[b"dataWindow"] = b"box2i", struct.pack("<4i", 0, 0, (1 << 23) - 1, 15)
        data = join_exr(attributes, [struct.pack("<iI", 0, 1 << 30) + bytes(100)])
        layout = exrscanlines.layout_of(str(put(tmp_path / "b.exr", data)))
        assert layout is not None
        assert layout.row_bytes * layout.block_rows == 1 << 30
        path = str(tmp_path / "b.exr")
        file = RawFile(path, identity_of(path), "a.exr")
        source = exrscanlines.ExrScanlines(file, layout, ["R"], "a.exr")
        with peak_below(600 << 20), pytest.raises(InputError, match="it ends before byte"):
            source.read(0, 16)
        source.close()

    @pytest.mark.parametrize("zeros", [10**6, 50 * 10**6])
    def test_a_block_that_inflates_to_more(self, tmp_path, parts, zeros):
        """No more of it is inflated than there must be."""
        attributes, (_, *others) = parts
        bomb = zlib.compress(bytes(zeros), 9)[: self.BLOCK - 1]
        path = put(tmp_path / "b.exr", join_exr(attributes, [block(0, bomb), *others]))
        with peak_below(1 << 20):
            refused(path, "rows 0 to 15: their deflated data are damaged")

    @pytest.mark.parametrize(
        "content",
        [b"", b"\0", b"x\x9c", bytes(100), zlib.compress(bytes(BLOCK - 1)),
         zlib.compress(bytes(BLOCK + 1)), zlib.compress(bytes(BLOCK))[:-1],
         zlib.compress(bytes(BLOCK))[:-4], zlib.compress(bytes(BLOCK)) + b"\0",
         zlib.compress(bytes(BLOCK))[:-1] + b"\xff", zlib.compress(b"")],
        ids=range(11),
    )  # fmt: skip
    def test_blocks_of_another_size(self, tmp_path, parts, content):
        attributes, (_, *others) = parts
        path = put(tmp_path / "b.exr", join_exr(attributes, [block(0, content), *others]))
        refused(path, "rows 0 to 15: their deflated data are damaged")
        with pytest.raises(InputError):
            Layer(path).by_openimageio()

    def test_plain_blocks_that_are_too_short(self, tmp_path):
        path = exrfile.write(tmp_path / "a.exr", self.PLANES, compression="none")
        attributes, (first, *others) = split_exr(path.read_bytes())
        damaged = block(0, first[8:-1])
        path = put(tmp_path / "b.exr", join_exr(attributes, [damaged, *others]))
        refused(path, "rows 0 to 0: their block is too short")

    @pytest.mark.slow
    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_at_random(self, tmp_path, compression):
        """An error or a layer, and the same one that OpenImageIO reads."""
        rng = np.random.default_rng([7, *compression.encode()])
        planes = exrfile.coarse("ABGRZ", 9, 37)
        path = exrfile.write(tmp_path / "a.exr", planes, compression=compression, origin=(-3, 5))
        data, read, refusals = path.read_bytes(), 0, 0
        table = exrfile.regions(data)["table"][0][0]
        with peak_below(64 << 20):
            for number in range(600):
                damaged = bytearray(data)
                # Headers are small, and most can go wrong there.
                reach = table + 24 if number % 3 else len(data)
                for place in rng.integers(0, reach, rng.integers(1, 4)):
                    damaged[place] = rng.choice([damaged[place] ^ (1 << rng.integers(8)), 0, 255])
                if number % 10 == 0:
                    del damaged[rng.integers(8, len(data)) :]
                layer = Layer(put(path, bytes(damaged)))
                window = attempt(lambda layer=layer: layer.window)
                if isinstance(window, Exception) or window.height * window.width > 10**5:
                    continue
                if not layer.plain:
                    continue
                ours, theirs = attempt(layer.rows), attempt(layer.by_openimageio)
                assert isinstance(ours, Exception) == isinstance(theirs, Exception), (ours, theirs)
                if isinstance(ours, Exception):
                    refusals += 1
                else:
                    read += 1
                    assert same(ours, theirs)
        assert read > 20
        assert refusals > 20


# ---- PNG ---------------------------------------------------------------------------------------


PLAIN_PNGS = [
    png for png in pngfile.every_kind()
    if png.depth >= 8 and png.colour != pngfile.PALETTE and not png.interlaced
    and png.transparency is None
]  # fmt: skip
PLAIN_NAMES = {pngfile.name_of(png) for png in PLAIN_PNGS}


def png_of_filter(kind, colour, depth, width, height):
    """Samples of few values, and a PNG of them in which each row has the same filter."""
    bits = pngfile.CHANNELS[colour] * depth
    shape = height, -(-width * bits // 8)
    rng = np.random.default_rng([kind, colour, depth, width, height])
    rows = rng.choice([0, 1, 127, 128, 254, 255], shape).astype(np.uint8)
    above, filtered = bytes(shape[1]), b""
    for row in rows:
        filtered += bytes([kind])
        filtered += pngfile._filter(kind, row.tobytes(), above, max(1, bits // 8))
        above = row.tobytes()
    samples = unpacked(rows, depth, width)
    return samples, with_image_data(samples, colour, depth, [zlib.compress(filtered)])


def unpacked(rows, depth, width):
    """The samples (rows, width, channels) in rows of bytes, as PNG packs them."""
    if depth < 8:
        bits = np.unpackbits(rows, axis=1)[:, : width * depth].reshape(len(rows), width, depth)
        return (bits @ (1 << np.arange(depth)[::-1]))[..., None].astype(np.uint8)
    stored = rows if depth == 8 else rows.view(">u2").astype(np.uint16)
    return stored.reshape(len(rows), width, -1)


def with_image_data(samples, colour, depth, pieces):
    """A PNG of that size whose IDAT chunks are these."""
    palette = PALETTE[: 2**depth] if colour == pngfile.PALETTE else None
    chunks = [c for c in pngfile.Png(samples, colour, depth, palette).chunks() if c[0] != b"IDAT"]
    return pngfile.join([*chunks[:-1], *((b"IDAT", piece) for piece in pieces), chunks[-1]])


PALETTE = tuple((i, 255 - i, i * 7 % 256) for i in range(256))


def shown(samples, colour, depth):
    """The samples that readers make of stored ones: of 8 bits at least, and without a palette."""
    if colour == pngfile.PALETTE:
        return np.array(PALETTE, np.uint8)[samples[..., 0]]
    return samples if depth >= 8 else samples * np.uint8(255 // (2**depth - 1))


def by_pillow(path, colour):
    """The samples (rows, width, channels) as Pillow has them: of 16 bits but grey the upper 8."""
    with Image.open(path) as image:
        grey = image.mode if image.mode.startswith("I") else "L"
        modes = {pngfile.GREY: grey, pngfile.PALETTE: "RGB", pngfile.GREY_ALPHA: "LA"}
        pixels = np.array(image.convert(modes.get(colour, image.mode)))
    return pixels.reshape(*pixels.shape[:2], -1)


def cut(data, *sizes):
    """The data in pieces of these sizes, again and again."""
    pieces, at = [], 0
    while at < len(data):
        for size in sizes:
            pieces.append(data[at : at + size])
            at += size
    return pieces


class TestPng:
    def test_which_are_plain(self, tmp_path):
        assert len(PLAIN_PNGS) == 8
        for png in pngfile.every_kind():
            layer = Layer(put(tmp_path / "a.png", png))
            assert layer.plain == (pngfile.name_of(png) in PLAIN_NAMES), pngfile.name_of(png)
            if layer.plain:
                assert same(layer.rows(), png.samples.astype(f"u{png.depth // 8}"))
                assert same(layer.rows(), layer.by_openimageio())

    @pytest.mark.pairwise
    @pytest.mark.parametrize(
        ("colour", "depth"), [(c, depth) for c, depths in pngfile.DEPTHS.items() for depth in depths]
    )
    @pytest.mark.parametrize("kind", range(5))
    @pytest.mark.parametrize("first", range(1, 71, 10))
    def test_filters(self, tmp_path, first, kind, colour, depth):
        """Of every width to 70: what is undone many bytes at a time, and what remains."""
        for width in range(first, first + 10):
            samples, data = png_of_filter(kind, colour, depth, width, height=4)
            layer = Layer(put(tmp_path / "a.png", data))
            expected = shown(samples, colour, depth)
            assert same(layer.by_openimageio(), expected)
            assert layer.plain == (colour != pngfile.PALETTE and depth >= 8)
            if layer.plain:
                assert same(layer.rows(), expected)
            pillow = by_pillow(layer.path, colour)
            upper = depth == 16 and pillow.dtype == np.uint8
            assert np.array_equal(pillow, expected >> 8 if upper else expected)

    @pytest.mark.parametrize("width", [9_000, 33_000])
    def test_rows_around_what_is_inflated_at_a_time(self, tmp_path, width):
        rng = np.random.default_rng(width)
        samples = np.cumsum(rng.choice([0, 0, 1], (9, width, 4)), axis=1).astype(np.uint16)
        path = put(tmp_path / "a.png", pngfile.Png(samples, pngfile.RGBA, 16))
        assert same(Layer(path).rows(), samples)
        assert same(Layer(path).rows(3, 8), samples[3:8])

    @pytest.mark.parametrize("sizes", [(1,), (1, 0), (0, 0, 2), (0, 7), (3, 50_000), (10**9,)])
    def test_image_data_in_any_pieces(self, tmp_path, sizes):
        samples = np.random.default_rng(1).integers(0, 9, (60, 50, 4), np.uint8)
        data = zlib.compress(pngfile.Png(samples, pngfile.RGBA, 8).raster())
        pieces = [b"", *cut(data, *sizes), b"", b""]
        path = put(tmp_path / "a.png", with_image_data(samples, pngfile.RGBA, 8, pieces))
        assert same(Layer(path).rows(), samples)
        assert same(Layer(path).rows(57, 60), samples[57:])
        assert same(Layer(path).by_openimageio(), samples)

    @pytest.mark.parametrize("level", [0, 1, 9])
    def test_one_huge_piece(self, tmp_path, level):
        """More than is read at a time, stored and deflated."""
        samples = np.random.default_rng(1).integers(0, 200, (300, 400, 4), np.uint8)
        data = zlib.compress(pngfile.Png(samples, pngfile.RGBA, 8).raster(), level)
        assert len(data) > 4 * pngscanlines._PIECE_BYTES
        path = put(tmp_path / "a.png", with_image_data(samples, pngfile.RGBA, 8, [data]))
        assert same(Layer(path).rows(), samples)

    @pytest.mark.parametrize("bits", [9, 10, 12, 15])
    def test_small_windows(self, tmp_path, bits):
        samples = np.random.default_rng(1).integers(0, 9, (90, 50, 4), np.uint8)
        stream = zlib.compressobj(9, zlib.DEFLATED, bits)
        data = stream.compress(pngfile.Png(samples, pngfile.RGBA, 8).raster()) + stream.flush()
        path = put(tmp_path / "a.png", with_image_data(samples, pngfile.RGBA, 8, [data]))
        assert same(Layer(path).rows(), samples)

    @pytest.mark.parametrize("at_once", [1, 1000, 1 << 18])
    def test_rows_in_any_order(self, tmp_path_factory, at_once):
        """Going back begins anew; rows between are skipped."""
        png = pngfile.random_png(pngfile.RGB, 16, width=21, height=70)
        samples = png.samples.astype(np.uint16)
        source = Layer(put(tmp_path_factory.mktemp("png") / "a.png", png)).source()

        @given(st.integers(0, 69), st.integers(1, 70))
        def test(begin, count):
            end = min(begin + count, 70)
            assert same(source.read(begin, end), samples[begin:end])

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(pngscanlines, "_FILTERED_BYTES", at_once)
            test()
        source.close()
        # And again, opened anew.
        assert same(source.read(0, 70), samples)
        source.close()

    def test_a_part_of_the_canvas(self, tmp_path):
        desk = Desk.made(tmp_path)
        put(desk / "a.png", pngfile.random_png(pngfile.RGBA, 8, width=40, height=90))
        desk.makes("stack", "a.png::alpha=straight", "-o", "whole.png")
        desk.makes("stack", "a.png::alpha=straight", "--region", "11x30+5+41", "-o", "part.png")
        whole, part = (pngfile.decode((desk / n).read_bytes()) for n in ("whole.png", "part.png"))
        assert np.array_equal(part, whole[41:71, 5:16])

    def test_more_pieces_than_are_kept(self, tmp_path, monkeypatch):
        """They are left to OpenImageIO."""
        png = PLAIN_PNGS[-1]
        data = zlib.compress(png.raster())
        pieces = [b"", *cut(data, 1, 0)]
        path = put(tmp_path / "a.png", with_image_data(png.samples, png.colour, png.depth, pieces))
        for most, plain in ((len(data), True), (len(data) - 1, False), (5, False)):
            for module in (pngheader, pngscanlines):
                monkeypatch.setattr(module, "MOST_PIECES", most)
            assert Layer(path).plain == plain
            assert np.array_equal(Layer(path).by_openimageio(), png.samples)

    def test_pieces_of_nothing_take_no_memory(self, tmp_path):
        png = PLAIN_PNGS[-1]
        data = zlib.compress(png.raster())
        pieces = [*[b""] * 30_000, *cut(data, 1), *[b""] * 30_000]
        path = put(tmp_path / "a.png", with_image_data(png.samples, png.colour, png.depth, pieces))
        with peak_below(2 << 20):
            assert np.array_equal(Layer(path).rows(), png.samples)


class TestPngDamage:
    PNG = pngfile.random_png(pngfile.RGBA, 8, width=30, height=40)
    RASTER = PNG.raster()
    DATA = zlib.compress(RASTER)

    def file(self, tmp_path, *pieces):
        return put(tmp_path / "a.png", with_image_data(self.PNG.samples, pngfile.RGBA, 8, pieces))

    @pytest.mark.parametrize(
        ("data", "words"),
        [
            (zlib.compress(RASTER[:-1]), "its image data end too early"),
            (DATA[:-1], "its image data end too early"),
            (DATA[:-4], "its image data end too early"),
            (DATA[:-30], "its image data end too early"),
            (DATA[:-1] + bytes([DATA[-1] ^ 1]), "its deflated data are damaged"),
            (b"\x78\x02" + DATA[2:], "its deflated data are damaged"),
            (b"\x79\x9b" + DATA[2:], "its deflated data are damaged"),
            (b"\x78\xbb" + DATA[2:], "its deflated data are damaged"),
            (DATA[:2] + b"\7" + DATA[3:], "its deflated data are damaged"),
            (b"not deflated at all" * 20, "its deflated data are damaged"),
            (zlib.compress(b"\5" + RASTER[1:]), "a filter that PNG does not know"),
            (zlib.compress(RASTER[:-121] + b"\xff" + RASTER[-120:]), "a filter that PNG does not"),
        ],
        ids=range(12),
    )
    def test_in_the_stream(self, tmp_path, data, words):
        """Whatever the pieces that it comes in, and whatever was read before."""
        for sizes in ((10**9,), (1,), (len(data) - 4, 4), (0, 99)):
            path = self.file(tmp_path, *cut(data, *sizes))
            refused(path, "rows from ", words)
            source = Layer(path).source()
            # Never rows that have shifted.
            for begin, end in ((0, 3), (10, 40), (39, 40), (3, 40), (0, 40)):
                found = attempt(lambda source=source, b=begin, e=end: source.read(b, e))
                if isinstance(found, Exception):
                    assert words in str(found)
                else:
                    assert np.array_equal(found, self.PNG.samples[begin:end])
            assert isinstance(found, Exception)
            source.close()

    @pytest.mark.parametrize(
        "data",
        [zlib.compress(RASTER + bytes(121)), zlib.compress(RASTER + b"\7"), DATA + b"bytes",
         DATA * 2],
        ids=["a row", "a byte", "bytes", "a stream"],
    )  # fmt: skip
    def test_more_than_there_must_be_is_let_be(self, tmp_path, data):
        for sizes in ((10**9,), (1,)):
            path = self.file(tmp_path, *cut(data, *sizes))
            assert np.array_equal(Layer(path).rows(), self.PNG.samples)
            assert np.array_equal(Layer(path).by_openimageio(), self.PNG.samples)

    def test_data_that_inflate_to_far_more(self, tmp_path):
        path = self.file(tmp_path, zlib.compress(self.RASTER + bytes(200 << 20), 9))
        with peak_below(4 << 20):
            assert np.array_equal(Layer(path).rows(), self.PNG.samples)

    def test_data_that_inflate_to_nothing(self, tmp_path):
        """Empty blocks of deflate: much to read, and nothing in it."""
        path = self.file(tmp_path, self.DATA[:2] + b"\0\0\0\xff\xff" * 400_000 + self.DATA[2:])
        with peak_below(4 << 20):
            assert np.array_equal(Layer(path).rows(), self.PNG.samples)

    def test_headers_that_are_out_of_place(self, tmp_path):
        header, *others = self.PNG.chunks()
        for chunks in (
            [pngfile.gama(45455), header, *others],
            [header, header, *others],
            others,
            [others[0], header, *others[1:]],
        ):
            path = put(tmp_path / "a.png", pngfile.join(chunks))
            with pytest.raises(InputError, match="out of place"):
                describe(str(path))

    @pytest.mark.slow
    def test_at_random(self, tmp_path):
        """With checksums of chunks put right, or the decoder would never see the damage."""
        rng = np.random.default_rng(11)
        read = refusals = 0
        with peak_below(32 << 20):
            for number in range(400):
                raster, data = bytearray(self.RASTER), bytearray(self.DATA)
                if number % 3 == 0:
                    for row in rng.integers(0, 40, 2):
                        raster[121 * row] = rng.integers(0, 6)
                    data = bytearray(zlib.compress(bytes(raster)))
                else:
                    for place in rng.integers(0, 60 if number % 2 else len(data), 2):
                        data[place] ^= 1 << rng.integers(8)
                if number % 7 == 0:
                    del data[rng.integers(2, len(data)) :]
                pieces = cut(bytes(data), *rng.integers(0, 3000, 3), 999)
                rows = attempt(Layer(self.file(tmp_path, *pieces)).rows)
                if isinstance(rows, Exception):
                    refusals += 1
                    continue
                read += 1
                inflate = zlib.decompressobj()
                raw = inflate.decompress(bytes(data))
                assert inflate.eof or len(raw) > 4840
                above = np.zeros(120, np.uint8)
                for y, row in enumerate(np.frombuffer(raw[:4840], np.uint8).reshape(40, 121)):
                    above = pngfile._unfiltered(int(row[0]), row[1:], above, 4)
                    assert above.tobytes() == rows[y].tobytes()
        assert read > 50
        assert refusals > 50


class TestChangedFiles:
    """Between the look at its headers and the first of its rows a file can become another."""

    @pytest.fixture(params=["exr", "png"])
    def files(self, request, tmp_path):
        """A file, and one to put in its place."""
        if request.param == "exr":
            return [exrfile.write(tmp_path / f"{n}.exr", exrfile.rgba(seed=n)) for n in (1, 2)]
        return [
            put(tmp_path / f"{n}.png", pngfile.random_png(pngfile.RGBA, 8, seed=n)) for n in (1, 2)
        ]

    def refuses(self, source, words):
        with pytest.raises(InputError) as caught:
            source.read(0, 1)
        assert str(caught.value) == f"layer 3 (a): {words}"

    def test_replaced(self, files):
        path, other = files
        source = Layer(path).source()
        os.replace(other, path)
        self.refuses(source, "it was changed while it was read: try again")
        source.close()

    @pytest.mark.parametrize("change", ["touched", "longer", "shorter"])
    def test_changed(self, files, change):
        path, _ = files
        source = Layer(path).source()
        if change == "touched":
            os.utime(path, ns=(1, 1))
        else:
            os.truncate(path, path.stat().st_size + (5 if change == "longer" else -5))
        for _ in range(2):
            self.refuses(source, "it was changed while it was read: try again")
        source.close()

    def test_gone(self, files):
        path, _ = files
        source = Layer(path).source()
        path.unlink()
        self.refuses(source, "cannot be read: no such file or directory")
        source.close()

    def test_gone_before_its_header_is_read(self, files, monkeypatch):
        path, _ = files
        kind = path.suffix[1:]

        def format_of(*_):
            path.unlink()
            return kind

        monkeypatch.setattr(description, "_format_of", format_of)
        with pytest.raises(InputError, match=r"^a: cannot be read: no such file"):
            describe(str(path), "a")

    def test_open_files_stay_what_they_were(self, files):
        """Another file of that name is another file."""
        path, other = files
        expected, source = Layer(path).rows(), Layer(path).source()
        first = source.read(0, 1)
        os.replace(other, path)
        rest = source.read(1, len(expected))
        source.close()
        assert same(np.concatenate([first, rest]), expected)

    def test_files_are_closed(self, files):
        before = len(os.listdir("/proc/self/fd"))
        source = Layer(files[0]).source()
        assert len(os.listdir("/proc/self/fd")) == before  # not opened before they are read
        source.read(0, 1)
        assert len(os.listdir("/proc/self/fd")) == before + 1
        source.close()
        source.close()
        assert len(os.listdir("/proc/self/fd")) == before


# ---- writing -----------------------------------------------------------------------------------


def form_of(samples, compression, x=0, y=0, **others):
    height, width = samples.shape[:2]
    window = Window(x, y, width, height)
    depth = {2: "half", 4: "float"}[samples.dtype.itemsize]
    header = PictureHeader(window, **{"display_window": window, **others})
    return ExrForm(depth, compression, header)


def written(path, samples, form, cuts=(), by=ExrScanlineWriter):
    """The picture in strips that end at `cuts`; the file's bytes."""
    opened = by(str(path), form, "out.exr")
    begin = 0
    for strip in np.split(samples, cuts):
        opened.write(opened.prepare(begin, strip))
        begin += len(strip)
    opened.finish()
    opened.abandon()
    return path.read_bytes()


def rgba(width, height, dtype, make=any_bits):
    return stacked(make("RGBA", width, height, dtype))


class TestWrittenExr:
    @pytest.mark.parametrize("kind", DTYPES)
    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_is_read_by_all(self, tmp_path, compression, kind):
        for (width, height), make in ((s, m) for s in SIZES for m in (exrfile.coarse, any_bits)):
            samples = rgba(width, height, DTYPES[kind], make)
            path = tmp_path / "out.exr"
            form = form_of(samples, compression, -7, 30, display_window=Window(0, 0, 64, 48))
            _, blocks = split_exr(written(path, samples, form))
            assert same(stacked(exrfile.read_back(path)), samples)
            assert same(Layer(path).by_openimageio(), samples)
            assert same(Layer(path).rows(), samples)
            rows = COMPRESSIONS[compression][1]
            assert len(blocks) == -(-height // rows)
            assert max(map(len, blocks)) <= 8 + rows * samples[0].nbytes

    def test_noise_is_stored_as_it_is(self, tmp_path):
        samples = rgba(33, 40, np.float16)
        _, blocks = split_exr(written(tmp_path / "out.exr", samples, form_of(samples, "zip")))
        assert [len(one) - 8 for one in blocks] == [16 * 33 * 8, 16 * 33 * 8, 8 * 33 * 8]

    @pytest.mark.parametrize("compression", ["zip", "zips"])
    def test_what_can_be_is_deflated(self, tmp_path, compression):
        samples = rgba(200, 40, np.float16, exrfile.coarse)
        data = written(tmp_path / "out.exr", samples, form_of(samples, compression))
        assert len(data) < 0.5 * samples.nbytes

    @pytest.mark.pairwise
    @pytest.mark.parametrize("kind", DTYPES)
    @pytest.mark.parametrize("compression", COMPRESSIONS)
    @pytest.mark.parametrize("aspect", [1.0, 2.0, 0.7])
    @pytest.mark.parametrize("density", [None, 72.0, 299.5])
    def test_says_what_openimageio_would(self, tmp_path, kind, compression, aspect, density):
        samples = rgba(9, 21, DTYPES[kind], exrfile.coarse)
        form = form_of(
            samples, compression, -3, 4, display_window=Window(-1, 2, 90, 80), pixel_aspect=aspect,
            pixels_per_metre=None if density is None else (density / 0.0254, density / 0.0254),
        )  # fmt: skip
        ours = written(tmp_path / "ours.exr", samples, form)
        theirs = written(tmp_path / "theirs.exr", samples, form, by=OpenImageIOExrWriter)
        expected, _ = split_exr(theirs)
        # OpenEXR itself knows densities in inches alone.
        expected.pop(b"ResolutionUnit", None)
        attributes, _ = split_exr(ours)
        assert attributes == expected
        assert list(attributes) == sorted(attributes)
        assert ours[:8] == theirs[:8]

    def test_its_description_is_complete(self, tmp_path):
        samples = rgba(9, 21, np.float16, exrfile.coarse)
        form = form_of(
            samples, "zip", 5, -6, display_window=Window(-1, 2, 90, 80), pixel_aspect=2.0,
            pixels_per_metre=(72 / 0.0254, 72 / 0.0254),
        )  # fmt: skip
        written(tmp_path / "out.exr", samples, form)
        (part,) = describe(str(tmp_path / "out.exr")).parts
        assert part.data_window == Window(5, -6, 9, 21)
        assert part.display_window == Window(-1, 2, 90, 80)
        assert (part.pixel_aspect, part.compression) == (2.0, "zip")
        assert part.color.primaries_from == "colorInteropID"
        assert part.pixels_per_metre == pytest.approx((72 / 0.0254, 144 / 0.0254))
        assert part.problems == ()

    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_bytes_do_not_depend_on_the_strips(self, tmp_path_factory, compression):
        path = tmp_path_factory.mktemp("exr") / "out.exr"
        samples = rgba(7, 53, np.float16, exrfile.coarse)
        form = form_of(samples, compression)
        whole = written(path, samples, form)

        @given(st.lists(st.integers(1, 52), unique=True).map(sorted))
        def test(cuts):
            assert written(path, samples, form, cuts) == whole

        test()

    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_nor_on_the_threads_that_prepare(self, tmp_path, compression):
        samples = rgba(300, 333, np.float16, exrfile.coarse)
        form = form_of(samples, compression)
        whole = written(tmp_path / "a.exr", samples, form)
        opened = ExrScanlineWriter(str(tmp_path / "b.exr"), form, "b")
        with ThreadPoolExecutor(4) as pool:
            for prepared in pool.map(
                lambda begin: opened.prepare(begin, samples[begin : begin + 48]),
                range(0, 333, 48),
            ):
                opened.write(prepared)
        opened.finish()
        assert (tmp_path / "b.exr").read_bytes() == whole

    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_nor_on_threads_and_strips_of_a_stack(self, tmp_path, monkeypatch, compression):
        layers = [
            exrfile.write(tmp_path / f"{kind}.exr", exrfile.rgba(61, 90), compression=kind)
            for kind in COMPRESSIONS
        ]
        made = set()
        for threads, rows in ((1, 64), (1, 5), (2, 16), (3, 7), (4, 90)):
            monkeypatch.setattr("hpcomp.layers.budget.STRIP_ROWS", rows)
            out = tmp_path / "out.exr"
            hpcomp.stack(layers, out, compression=compression, threads=threads)
            made.add(out.read_bytes())
        assert len(made) == 1

    def test_samples_are_left_as_they_are(self, tmp_path):
        samples = rgba(9, 21, np.float16)
        before = samples.tobytes()
        written(tmp_path / "out.exr", samples, form_of(samples, "zip"))
        assert samples.tobytes() == before

    def test_to_a_pipe(self, tmp_path):
        """A pipe has no table to go back to: the file is made elsewhere first."""
        desk = Desk.made(tmp_path)
        put(desk / "a.png", pngfile.random_png(pngfile.RGBA, 8))
        desk.makes("stack", "a.png::alpha=straight", "-o", "out.exr")
        run = desk.makes("stack", "a.png::alpha=straight", "-o", "-", "--format", "exr")
        assert run.stdout == (desk / "out.exr").read_bytes()


# ---- with and without --------------------------------------------------------------------------

#: Runs the command in this process, then says which of some modules it imported.
IMPORTS = """
import json, sys
from hpcomp.cli.group import cli
code = cli.main(sys.argv[1:], prog_name="hpcomp", standalone_mode=False)
modules = ["OpenImageIO", "OpenEXR", "hpcomp.imagefile.openimageio"]
print(json.dumps([code or 0, [name for name in modules if name in sys.modules]]))
"""


class TestLibraries:
    PNGS = tuple(f"{number}.png" for number in range(8))

    @pytest.fixture
    def desk(self, tmp_path):
        desk = Desk.made(tmp_path)
        for name, png in zip(self.PNGS, PLAIN_PNGS, strict=True):
            put(desk / name, png)
        put(desk / "palette.png", pngfile.random_png(pngfile.PALETTE, 8))
        exrfile.write(desk / "a.exr", exrfile.rgba(13, 11))
        return desk

    def imported(self, desk, *arguments):
        done = subprocess.run(
            [sys.executable, "-c", IMPORTS, *arguments], capture_output=True, text=True,
            cwd=desk.folder, timeout=PATIENCE_S,
        )  # fmt: skip
        assert done.stderr == ""
        code, modules = json.loads(done.stdout.splitlines()[-1])
        assert code == 0
        return modules

    @pytest.mark.parametrize("output", ["out.png", "out.exr"])
    def test_plain_pngs_need_no_openimageio(self, desk, output):
        assert self.imported(desk, "stack", "-q", *self.PNGS, "-o", output) == []

    def test_nor_does_what_is_said_of_them(self, desk):
        assert self.imported(desk, "info", *self.PNGS) == []

    @pytest.mark.parametrize(
        "arguments",
        [("palette.png", "-o", "out.png"), ("a.exr", "-o", "out.png"),
         ("0.png", "-o", "out.exr", "--compression", "piz")],
        ids=" ".join,
    )  # fmt: skip
    def test_others_do(self, desk, arguments):
        """So that the tests above could fail."""
        found = self.imported(desk, "stack", "-q", *arguments)
        assert found == ["OpenImageIO", "hpcomp.imagefile.openimageio"]

    @pytest.mark.parametrize("ending", ["png", "exr"])
    @pytest.mark.filterwarnings("ignore::hpcomp.HpcompWarning")
    def test_the_stack_is_the_same_without_our_loops(self, tmp_path, desk, monkeypatch, ending):
        layers = [
            *(f"{desk / name}::opacity=0.6" for name in self.PNGS),
            f"{desk / 'a.exr'}::opacity=0.4,op=atop",
            f"{desk / 'palette.png'}::opacity=0.2",
        ]
        out = tmp_path / f"out.{ending}"
        made, plain = [], []
        for unpacks in (True, False):
            if not unpacks:
                for module in (packing, exrscanlines, pngscanlines):
                    monkeypatch.setattr(module, "UNPACKS", False)
                monkeypatch.setattr(packing, "_loops", None)
            plain.append({Layer(desk / name).plain for name in (*self.PNGS, "a.exr")})
            hpcomp.stack(layers, out)
            made.append(out.read_bytes())
        assert plain == [{True}, {False}]
        assert made[0] == made[1]

    def test_openimageio_threads_are_put_back(self, tmp_path, desk):
        before = oiio.get_int_attribute("threads"), oiio.get_int_attribute("exr_threads")
        hpcomp.stack([desk / "palette.png"], tmp_path / "out.png", threads=2)
        after = oiio.get_int_attribute("threads"), oiio.get_int_attribute("exr_threads")
        assert after == before
