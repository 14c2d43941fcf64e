"""The loops between samples and what codecs deflate, against naive ones; their binding."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from bindings import refused, unaligned
from hypothesis import given
from hypothesis import strategies as st

from hpcomp.imagefile import packing
from hpcomp.kernel import fused as kernel
from hpcomp.kernel._kernel import packing as loops

# Bytes of a sample.
SIZES = {"uint": 4, "half": 2, "float": 4}
DTYPES = {"half": np.float16, "float": np.float32}
# Bytes of a pixel: grey to RGBA, in 8 and 16 bits.
PIXEL_BYTES = (1, 2, 3, 4, 6, 8)
LEVELS = ("", *kernel.levels())


def random_bytes(*shape, seed=0):
    return np.random.default_rng([seed, *shape]).integers(0, 256, shape, np.uint8)


def few_bytes(*shape, seed=0):
    """Runs and small steps, so that filters and sums come out equal now and then."""
    steps = np.random.default_rng([seed, *shape]).choice([0, 0, 0, 1, 128, 255], shape)
    return np.cumsum(steps, axis=-1).astype(np.uint8)


def samples(height, width, dtype, seed=0):
    """RGBA of any bits: NaN of every kind among them."""
    size = 4 * width * np.dtype(dtype).itemsize
    return random_bytes(height, size, seed=seed).view(dtype).reshape(height, width, 4)


def same(found, expected):
    """Whether two arrays are equal to the bit."""
    return (found.shape, found.dtype, found.tobytes()) == (
        expected.shape, expected.dtype, expected.tobytes(),
    )  # fmt: skip


# ---- the same, naively -------------------------------------------------------------------------


def differences_undone(packed):
    """OpenEXR's ZIP after inflating: each byte is the one before it, plus itself, less 128."""
    out = [packed[0]]
    for byte in packed[1:]:
        out.append((out[-1] + byte - 128) % 256)
    half = len(out) // 2
    return bytes(out[i // 2 + half * (i % 2)] for i in range(len(out)))


def differences_made(plain):
    split = [*plain[::2], *plain[1::2]]
    steps = [(after - before + 128) % 256 for before, after in itertools.pairwise(split)]
    return bytes([split[0], *steps])


def naive_exr_unpacked(block, packed, row_bytes, channel_bytes, first_row, shape, dtype):
    plain = differences_undone(block) if packed else bytes(block)
    size = np.dtype(dtype).itemsize
    out = bytearray()
    for row in range(first_row, first_row + shape[0]):
        for column in range(shape[1]):
            for begin in channel_bytes:
                at = row * row_bytes + begin + column * size
                out += plain[at : at + size]
    return np.frombuffer(bytes(out), dtype).reshape(shape)


def naive_exr_plain(rgba):
    return b"".join(
        pixel[channel].tobytes() for row in rgba for channel in (3, 2, 1, 0) for pixel in row
    )


def naive_png_unfiltered(filtered, pixel_bytes, above):
    """PNG specification, third edition, 9.2."""
    rows, above = [], list(map(int, above))
    for kind, *row in filtered.tolist():
        out = []
        for i, byte in enumerate(row):
            left = out[i - pixel_bytes] if i >= pixel_bytes else 0
            corner = above[i - pixel_bytes] if i >= pixel_bytes else 0
            out.append((byte + predicted(kind, left, above[i], corner)) % 256)
        rows.append(out)
        above = out
    return np.array(rows, np.uint8).reshape(filtered.shape[0], filtered.shape[1] - 1)


def predicted(kind, left, up, corner):
    if kind == 4:
        estimate = left + up - corner
        # Of equal distances the first.
        return min((left, up, corner), key=lambda value: abs(estimate - value))
    return (0, left, up, (left + up) // 2)[kind]


def paeth(left, up, corner):
    """The same of arrays of 16 bits."""
    estimate = left + up - corner
    each = np.broadcast_arrays(left, up, corner)
    nearest = np.argmin([abs(estimate - value) for value in each], axis=0)  # of equal ones the first
    return np.choose(nearest, each)


def naive_png_filtered(rows, pixel_bytes):
    """Of the filters the one whose differences have the least sum, of equal ones the first."""
    out, above = [], None
    for row in rows.tolist():
        best = None
        for kind in range(5) if above else range(2):
            differences = []
            for i, byte in enumerate(row):
                left = row[i - pixel_bytes] if i >= pixel_bytes else 0
                corner = above[i - pixel_bytes] if above and i >= pixel_bytes else 0
                up = above[i] if above else 0
                differences.append((byte - predicted(kind, left, up, corner)) % 256)
            if best is None or total(differences) < total(best[1:]):
                best = [kind, *differences]
        out.append(best)
        above = row
    return np.array(out, np.uint8)


def total(differences):
    """The sum of their sizes as signed bytes."""
    return sum(min(byte, 256 - byte) for byte in differences)


# ---- EXR ---------------------------------------------------------------------------------------


def exr_unpacked(block, packed, row_bytes, channel_bytes, first_row, shape, dtype, level=""):
    out = np.empty(shape, dtype)
    loops.exr_unpack(
        block=np.frombuffer(block, np.uint8), packed=packed, row_units=row_bytes // 2,
        channels=[begin // 2 for begin in channel_bytes], first_row=first_row, out=out, level=level,
    )  # fmt: skip
    return out


@st.composite
def blocks(draw):
    """Arguments of `exr_unpacked`: channels of any types, of which some of one type are wanted."""
    kinds = draw(st.lists(st.sampled_from(list(SIZES)), min_size=1, max_size=7))
    width, rows = draw(st.integers(1, 21)), draw(st.integers(1, 17))
    kind = draw(st.sampled_from(["half", "float"]))
    begins, row_bytes = [], 0
    for one in kinds:
        begins.append((one, row_bytes))
        row_bytes += SIZES[one] * width
    there = [begin for one, begin in begins if one == kind]
    # Any of them, in any order, and again.
    wanted = draw(st.lists(st.sampled_from(there), min_size=1, max_size=5)) if there else []
    first_row = draw(st.integers(0, rows - 1))
    count = draw(st.integers(0, rows - first_row))
    block = random_bytes(rows * row_bytes, seed=draw(st.integers(0, 9))).tobytes()
    shape = count, width, len(wanted)
    return block, draw(st.booleans()), row_bytes, wanted, first_row, shape, DTYPES[kind]


class TestExr:
    @given(blocks())
    def test_any_rows_of_any_channels(self, block):
        assert same(exr_unpacked(*block), naive_exr_unpacked(*block))

    @pytest.mark.parametrize("level", LEVELS)
    @pytest.mark.parametrize("units", [*range(1, 40), 127, 128, 1000, 4099])
    def test_differences_of_any_length(self, level, units):
        """Eight bytes are undone at once, and what remains one by one."""
        for data in (random_bytes(2 * units), few_bytes(2 * units), np.full(2 * units, 255, "u1")):
            block = data.tobytes()
            found = exr_unpacked(block, True, 2 * units, [0], 0, (1, units, 1), np.float16, level)
            assert found.tobytes() == differences_undone(block)

    @pytest.mark.parametrize("dtype", DTYPES.values())
    @pytest.mark.parametrize("size", [(1, 1), (1, 7), (17, 3), (5, 16), (16, 33)])
    def test_packed(self, size, dtype):
        rgba = samples(*size, dtype)
        plain = naive_exr_plain(rgba)
        assert packing.exr_plain(rgba) == plain
        packed = packing.exr_packed(rgba)
        assert packed.tobytes() == differences_made(plain)
        # And back: the planes stand in the order A, B, G, R.
        plane = size[1] * rgba.dtype.itemsize
        for block, is_packed in ((packed.tobytes(), True), (plain, False)):
            back = exr_unpacked(
                block, is_packed, 4 * plane, [3 * plane, 2 * plane, plane, 0], 0, rgba.shape, dtype
            )
            assert same(back, rgba)

    @pytest.mark.parametrize("dtype", DTYPES.values())
    def test_packed_views(self, dtype):
        whole = samples(12, 20, dtype)
        for view in (whole[3:7], whole[::2], whole[:, 5:9], whole[::-1, ::-3], whole[..., ::-1]):
            assert packing.exr_packed(view).tobytes() == differences_made(naive_exr_plain(view))

    @pytest.mark.parametrize("dtype", DTYPES.values())
    def test_where_the_kernel_was_not_built(self, monkeypatch, dtype):
        rgba = samples(16, 13, dtype)
        packed = packing.exr_packed(rgba)
        monkeypatch.setattr(packing, "UNPACKS", False)
        monkeypatch.setattr(packing, "_loops", None)
        assert same(packing.exr_packed(rgba), packed)

    def test_the_wrapper_counts_bytes(self):
        block = random_bytes(6 * 40).tobytes()
        out = np.empty((3, 4, 2), np.float32)
        packing.exr_unpacked(block, True, 40, [24, 8], 2, out)
        assert same(out, naive_exr_unpacked(block, True, 40, [24, 8], 2, out.shape, np.float32))


# ---- PNG ---------------------------------------------------------------------------------------


def png_unfiltered(filtered, pixel_bytes, above, level=""):
    out = np.empty((filtered.shape[0], filtered.shape[1] - 1), np.uint8)
    loops.png_unfilter(
        filtered=filtered, pixel_bytes=pixel_bytes, above=above, out=out, level=level
    )
    return out


def png_filtered(rows, pixel_bytes, level=""):
    out = np.empty((rows.shape[0], rows.shape[1] + 1), np.uint8)
    loops.png_filter(rows=rows, pixel_bytes=pixel_bytes, out=out, level=level)
    return out


@st.composite
def pictures(draw, filters=False):
    """(rows of bytes, bytes of a pixel); with `filters`, each row behind the number of one."""
    pixel_bytes = draw(st.sampled_from(PIXEL_BYTES))
    height, width = draw(st.integers(1, 9)), draw(st.integers(1, 19))
    make = draw(st.sampled_from([random_bytes, few_bytes]))
    rows = make(height, width * pixel_bytes + filters, seed=draw(st.integers(0, 9)))
    if filters:
        rows[:, 0] = draw(st.lists(st.integers(0, 4), min_size=height, max_size=height))
    return rows, pixel_bytes


class TestPng:
    @given(pictures(filters=True), st.booleans())
    def test_any_filters(self, picture, first):
        filtered, pixel_bytes = picture
        above = np.zeros(filtered.shape[1] - 1, np.uint8)
        if not first:
            above = random_bytes(len(above))
        expected = naive_png_unfiltered(filtered, pixel_bytes, above)
        assert same(png_unfiltered(filtered, pixel_bytes, above), expected)
        # In two goes: the last row of the one is above the first of the other.
        cut = len(filtered) // 2
        upper = png_unfiltered(filtered[:cut], pixel_bytes, above)
        below = upper[-1] if cut else above
        lower = png_unfiltered(filtered[cut:], pixel_bytes, below)
        assert same(np.concatenate([upper, lower]), expected)

    @pytest.mark.parametrize("level", LEVELS)
    @pytest.mark.parametrize("pixel_bytes", PIXEL_BYTES)
    def test_paeth_where_distances_are_equal(self, pixel_bytes, level):
        """Neighbours that are few values, at the ends and in the middle: every tie there is."""
        values = np.array([0, 1, 2, 127, 128, 129, 254, 255], np.uint8)
        shape = 3, 24 * 200
        rows, above = (np.random.default_rng(k).choice(values, shape) for k in (1, 2))
        behind = np.column_stack([np.full(3, 4, np.uint8), rows])
        expected = naive_png_unfiltered(behind, pixel_bytes, above[0])
        assert same(png_unfiltered(behind, pixel_bytes, above[0], level), expected)

    @pytest.mark.slow
    @pytest.mark.parametrize("level", LEVELS)
    def test_paeth_of_any_neighbours(self, level):
        """Every left, up and corner there is: a pixel to have them in each second place."""
        left, up = (plane.reshape(-1).astype(np.int16) for plane in np.mgrid[:256, :256])
        for corner in range(256):
            above = np.stack([np.full_like(up, corner), up], axis=1).reshape(-1)
            nearest = paeth(left, up, np.int16(corner))
            row = np.stack([left, nearest], axis=1).reshape(-1)
            before = (np.concatenate([[0], plane[:-1]]).astype(np.int16) for plane in (row, above))
            filtered = (row - paeth(next(before), above, next(before))).astype(np.uint8)
            assert not filtered[1::2].any()
            behind = np.concatenate([[4], filtered]).astype(np.uint8)[None]
            assert same(png_unfiltered(behind, 1, above.astype(np.uint8), level)[0], row.astype(np.uint8))

    @pytest.mark.parametrize("kind", [5, 6, 127, 128, 255])
    @pytest.mark.parametrize("row", [0, 1, 4])
    def test_filters_that_there_are_not(self, row, kind):
        filtered = np.zeros((5, 13), np.uint8)
        filtered[row, 0] = kind
        with pytest.raises(ValueError, match="filter"):
            png_unfiltered(filtered, 4, np.zeros(12, np.uint8))

    @given(pictures())
    def test_filtered(self, picture):
        rows, pixel_bytes = picture
        filtered = packing.png_filtered(rows, pixel_bytes)
        assert same(filtered, naive_png_filtered(rows, pixel_bytes))
        nothing = np.zeros(rows.shape[1], np.uint8)
        assert same(png_unfiltered(filtered, pixel_bytes, nothing), rows)

    def test_every_filter_is_the_best_of_some_row(self):
        """So that those above prove each of them."""
        y, x = np.mgrid[:3, :60]
        ramp = np.repeat(3 * x + 5 * y, 3, axis=1)  # the mean of left and above, nearly
        edges = np.repeat((x // 7 + y) % 2 * 200 + (y > 1) * 40, 3, axis=1)
        noise, few = random_bytes(9, 60), few_bytes(9, 60)
        found = set()
        for rows in (ramp, edges, noise, few, np.tile(noise[:1], (3, 1)), few // 64):
            rows = np.ascontiguousarray(rows, np.uint8)
            filtered = packing.png_filtered(rows, 3)
            assert same(filtered, naive_png_filtered(rows, 3))
            found |= set(filtered[:, 0].tolist())
        assert found == set(range(5))

    @pytest.mark.parametrize("built", [True, False])
    @pytest.mark.parametrize("pixel_bytes", PIXEL_BYTES)
    def test_of_equal_sums_the_first(self, monkeypatch, pixel_bytes, built):
        """One pixel below nothing is as far from 0 as from its left and from above."""
        if not built:
            monkeypatch.setattr(packing, "_loops", None)
        rows = random_bytes(2, pixel_bytes)
        rows[0] = 0
        assert packing.png_filtered(rows, pixel_bytes)[:, 0].tolist() == [0, 0]

    @pytest.mark.parametrize("pixel_bytes", PIXEL_BYTES)
    def test_all_of_a_long_row_counts(self, pixel_bytes):
        """Its last pixel decides, whatever so many sums add up to."""
        width = 24 * 1000
        rows = np.full((2, width), 128, np.uint8)  # as far from 0 as bytes get
        rows[:, ::2] = 7
        assert packing.png_filtered(rows, pixel_bytes)[1, 0] == 2
        for last in (0, 1, 255):
            rows[1, -1] = last
            assert same(packing.png_filtered(rows, pixel_bytes), naive_png_filtered(rows, pixel_bytes))

    def test_where_the_kernel_was_not_built(self, monkeypatch):
        made = []
        for kernel_or_none in (packing._loops, None):
            monkeypatch.setattr(packing, "_loops", kernel_or_none)
            made.append(
                [
                    packing.png_filtered(make(height, 24 * width), pixel_bytes).tobytes()
                    for pixel_bytes in PIXEL_BYTES
                    for height, width in ((1, 1), (2, 1), (9, 5), (64, 40))
                    for make in (random_bytes, few_bytes)
                ]
            )
        assert made[0] == made[1]


# ---- bytes -------------------------------------------------------------------------------------


def everything_made(level):
    """What the four loops make of the same data, at sizes around those of vectors."""
    made = []
    for width in (*range(1, 71), 257):
        for dtype in DTYPES.values():
            rgba = samples(3, width, dtype)
            packed = np.empty(rgba.nbytes, np.uint8)
            loops.exr_pack(samples=rgba, out=packed, level=level)
            size = width * rgba.dtype.itemsize
            begins = [3 * size, 2 * size, size, 0]
            for wanted in (begins, begins[:3], begins[1:2]):
                shape = 2, width, len(wanted)
                for is_packed in (True, False):
                    made.append(
                        exr_unpacked(packed, is_packed, 4 * size, wanted, 1, shape, dtype, level)
                    )
            made.append(packed)
        for pixel_bytes in PIXEL_BYTES:
            rows = few_bytes(5, width * pixel_bytes)
            filtered = png_filtered(rows, pixel_bytes, level)
            behind = np.column_stack([np.arange(5, dtype=np.uint8), rows])
            made += [filtered, png_unfiltered(behind, pixel_bytes, rows[2], level)]
    return [array.tobytes() for array in made]


class TestBytes:
    def test_do_not_depend_on_the_instruction_set(self):
        fastest = everything_made("")
        for level in kernel.levels():
            assert everything_made(level) == fastest, level

    def test_nor_on_other_threads(self):
        """Each has buffers of its own, of the size of its last block or larger."""
        alone = everything_made("")
        with ThreadPoolExecutor(4) as pool:
            assert all(made == alone for made in pool.map(everything_made, [""] * 8))

    @pytest.mark.parametrize("width", [1, 3, 15, 16, 17, 100])
    @pytest.mark.parametrize("level", LEVELS)
    def test_nothing_is_written_beside_the_rows(self, width, level):
        def guarded(shape, dtype=np.uint8):
            size = int(np.prod(shape))
            memory = np.full(size + 128, 99, dtype)
            return memory, memory[64:-64].reshape(shape)

        def unharmed(memory):
            return (memory[:64] == 99).all() and (memory[-64:] == 99).all()

        for dtype in DTYPES.values():
            rgba = samples(4, width, dtype)
            memory, packed = guarded(rgba.nbytes)
            loops.exr_pack(samples=rgba, out=packed, level=level)
            assert unharmed(memory)
            size = width * rgba.dtype.itemsize // 2
            for channels in (
                [0],
                [3 * size, 0],
                [0, size, 2 * size],
                [0, size, 2 * size, 3 * size],
            ):
                for is_packed in (True, False):
                    memory, out = guarded((2, width, len(channels)), dtype)
                    loops.exr_unpack(
                        block=packed, packed=is_packed, row_units=4 * size, channels=channels,
                        first_row=2, out=out, level=level,
                    )  # fmt: skip
                    assert unharmed(memory)
        for pixel_bytes in PIXEL_BYTES:
            rows = few_bytes(5, width * pixel_bytes)
            memory, filtered = guarded((5, width * pixel_bytes + 1))
            loops.png_filter(rows=rows, pixel_bytes=pixel_bytes, out=filtered, level=level)
            assert unharmed(memory)
            for kind in range(5):
                filtered[:, 0] = kind
                memory, out = guarded(rows.shape)
                loops.png_unfilter(
                    filtered=filtered, pixel_bytes=pixel_bytes, above=rows[0], out=out, level=level
                )
                assert unharmed(memory)

    def test_inputs_are_left_as_they_are(self):
        inputs = [samples(4, 9, np.float16), few_bytes(5, 36), few_bytes(5, 37) % 5, few_bytes(36)]
        before = [array.tobytes() for array in inputs]
        rgba, rows, filtered, above = inputs
        packed = packing.exr_packed(rgba).tobytes()
        exr_unpacked(packed, True, 72, [0, 18], 1, (3, 9, 2), np.float16)
        png_filtered(rows, 4)
        png_unfiltered(filtered, 4, above)
        assert [array.tobytes() for array in inputs] == before


# ---- the binding -------------------------------------------------------------------------------


def read_only(array):
    array.flags.writeable = False
    return array


def call(name, **changed):
    """A function of the binding with arguments that are right but for those given."""
    right = {
        "exr_unpack": {
            "block": np.zeros(4 * 48, np.uint8), "packed": True, "row_units": 24,
            "channels": [0, 6, 12, 18], "first_row": 1, "out": np.zeros((2, 6, 4), np.float16),
        },
        "exr_pack": {"samples": np.zeros((2, 3, 4), np.float16), "out": np.zeros(48, np.uint8)},
        "png_unfilter": {
            "filtered": np.zeros((3, 25), np.uint8), "pixel_bytes": 4,
            "above": np.zeros(24, np.uint8), "out": np.zeros((3, 24), np.uint8),
        },
        "png_filter": {
            "rows": np.zeros((3, 24), np.uint8), "pixel_bytes": 4,
            "out": np.zeros((3, 25), np.uint8),
        },
    }[name]  # fmt: skip
    return getattr(loops, name)(**{**right, **changed})


#: Every array that the binding takes: its type, its shape, whether it is written to.
ARRAYS = {
    ("exr_unpack", "block"): ("u1", (192,), False),
    ("exr_unpack", "out"): ("f2", (2, 6, 4), True),
    ("exr_pack", "samples"): ("f2", (2, 3, 4), False),
    ("exr_pack", "out"): ("u1", (48,), True),
    ("png_unfilter", "filtered"): ("u1", (3, 25), False),
    ("png_unfilter", "above"): ("u1", (24,), False),
    ("png_unfilter", "out"): ("u1", (3, 24), True),
    ("png_filter", "rows"): ("u1", (3, 24), False),
    ("png_filter", "out"): ("u1", (3, 25), True),
}
WRONG_TYPES = (
    "i1", "i2", "u2", "i4", "u4", "u8", "f8", "c8", "?", ">f4", ">f2", ">u2", "O", "S1", "M8[s]",
)  # fmt: skip
#: Neither sizes nor places of anything.
NO_NUMBERS = (2**63, 2**64, -(2**63) - 1, 1.5, None, "1", [1])
#: Sizes and places that nothing has, though a number of 64 bits holds them.
FAR_NUMBERS = (-1, -(2**31), -(2**63), 2**31, 2**40, 2**40 + 1, 2**60, 2**62, 2**63 - 1)


class TestBinding:
    """Nothing that Python can pass reads or writes out of bounds: it is refused."""

    @pytest.mark.parametrize("name", ["exr_unpack", "exr_pack", "png_unfilter", "png_filter"])
    def test_what_is_right_is_taken(self, name):
        assert call(name) is None
        for level in kernel.levels():
            assert call(name, level=level) is None

    @pytest.mark.parametrize("name", ["exr_unpack", "exr_pack", "png_unfilter", "png_filter"])
    @pytest.mark.parametrize("level", ["v9", "V3", "baseline ", None, 0, b"baseline"])
    def test_levels_that_there_are_not(self, name, level):
        with refused():
            call(name, level=level)

    @pytest.mark.parametrize(("name", "array"), ARRAYS)
    def test_arrays_of_another_type(self, name, array):
        dtype, shape, _ = ARRAYS[name, array]
        for wrong in WRONG_TYPES:
            with refused():
                call(name, **{array: np.zeros(shape, wrong)})
        if dtype == "u1":
            with refused():
                call(name, **{array: np.zeros(shape, np.float16)})

    @pytest.mark.parametrize(("name", "array"), ARRAYS)
    def test_arrays_of_another_shape(self, name, array):
        dtype, shape, _ = ARRAYS[name, array]
        for axis, step in itertools.product(range(len(shape)), (1, -1)):
            wrong = list(shape)
            wrong[axis] += step
            if (name, array, axis, step) == ("exr_unpack", "out", 1, -1):
                continue  # fewer columns than the row has are there
            if (name, array, axis) == ("exr_unpack", "out", 0):
                wrong[axis] = 4  # fewer rows than the block has are there
            with refused():
                call(name, **{array: np.zeros(wrong, dtype)})
        for wrong in ((), (0,), (1, *shape), shape[:-1], (*shape[:-1], 0), (*shape, 1)):
            with refused():
                call(name, **{array: np.zeros(wrong, dtype)})

    @pytest.mark.parametrize(("name", "array"), ARRAYS)
    def test_arrays_that_are_not_one_run(self, name, array):
        """A copy of what is written to would be filled, and lost without a word."""
        dtype, shape, _ = ARRAYS[name, array]
        for axis in range(len(shape)):
            twice = list(shape)
            twice[axis] *= 2
            every_other = [slice(None)] * len(shape)
            every_other[axis] = slice(None, None, 2)
            with refused():
                call(name, **{array: np.zeros(twice, dtype)[tuple(every_other)]})
            with refused():
                call(name, **{array: np.flip(np.zeros(shape, dtype), axis)})
        with refused():
            call(name, **{array: np.broadcast_to(np.zeros(shape[-1:], dtype)[:1], shape)})
        if len(shape) > 1:
            with refused():
                call(name, **{array: np.zeros(shape[::-1], dtype).T})

    @pytest.mark.parametrize(("name", "array"), ARRAYS)
    def test_what_is_no_array(self, name, array):
        for wrong in (None, 1, "0" * 192, [0] * 24, object()):
            with refused():
                call(name, **{array: wrong})

    @pytest.mark.parametrize(("name", "array"), [key for key in ARRAYS if ARRAYS[key][2]])
    def test_what_cannot_be_written_to(self, name, array):
        dtype, shape, _ = ARRAYS[name, array]
        size = np.zeros(shape, dtype).nbytes
        for wrong in (read_only(np.zeros(shape, dtype)), bytes(size)):
            with refused():
                call(name, **{array: wrong})

    @pytest.mark.parametrize("dtype", [np.float16, np.float32])
    def test_samples_that_are_not_aligned(self, dtype):
        with refused():
            call("exr_pack", samples=unaligned(dtype, (2, 3, 4)), out=np.zeros(96, np.uint8))
        with refused():
            call("exr_unpack", out=unaligned(dtype, (2, 3, 4)))
        with refused():
            call("exr_unpack", packed=False, block=unaligned(np.uint8, (192,)))
        # What is copied byte by byte may lie anywhere.
        call("exr_unpack", block=unaligned(np.uint8, (192,)))

    @pytest.mark.parametrize("value", [*NO_NUMBERS, *FAR_NUMBERS, 0, 7, 23, 25, 48, 97])
    def test_row_units(self, value):
        for packed in (True, False):
            with refused():
                call("exr_unpack", row_units=value, packed=packed)

    @pytest.mark.parametrize("value", [*NO_NUMBERS, *FAR_NUMBERS, 3, 4])
    def test_first_row(self, value):
        for packed in (True, False):
            with refused():
                call("exr_unpack", first_row=value, packed=packed)

    @pytest.mark.parametrize("value", [*NO_NUMBERS, *FAR_NUMBERS, 19, 24])
    def test_where_a_channel_begins(self, value):
        for place in range(4):
            channels = [0, 6, 12, 18]
            channels[place] = value
            with refused():
                call("exr_unpack", channels=channels)

    @pytest.mark.parametrize(
        "channels", [[], [0], [0] * 3, [0] * 5, [0] * 1000, None, 0, "0123", [None] * 4], ids=str
    )
    def test_channels(self, channels):
        with refused():
            call("exr_unpack", channels=channels)

    def test_a_float_is_two_units(self):
        """Planes that halves would fit into are too short for floats."""
        for channels in ([19], [18, 0]):
            out = np.zeros((2, 3, len(channels)), np.float32)
            if channels == [18, 0]:
                call("exr_unpack", channels=channels, out=out)
            else:
                with refused():
                    call("exr_unpack", channels=channels, out=out)

    @pytest.mark.parametrize(
        "shape",
        [(2**59, 0, 4), (0, 2**59, 4), (2**61, 0, 1), (0, 2**61, 1), (2**30, 2**31, 0), (0, 0, 0)],
        ids=str,
    )
    def test_no_pixels_in_huge_pictures(self, shape):
        """Numpy has such arrays; their sizes must not overflow."""
        out = np.empty(shape, np.float16)
        if shape == (0, 0, 0):
            call("exr_unpack", out=out, channels=[])
        else:
            with refused():
                call("exr_unpack", out=out, channels=[0] * shape[2])
        if shape[2] == 4:
            call("exr_pack", samples=out, out=np.empty(0, np.uint8))
            with refused():
                call("exr_pack", samples=out)

    def test_a_block_without_rows(self):
        nothing = np.empty(0, np.uint8)
        call("exr_unpack", block=nothing, first_row=0, out=np.zeros((0, 6, 4), np.float16))
        with refused():
            call("exr_unpack", block=nothing, first_row=0)

    @pytest.mark.parametrize("name", ["png_unfilter", "png_filter"])
    @pytest.mark.parametrize("value", [*NO_NUMBERS, *FAR_NUMBERS, 0, 5, 7, 9, 12, 16, 24])
    def test_pixel_bytes(self, name, value):
        with refused():
            call(name, pixel_bytes=value)

    @pytest.mark.parametrize("row_bytes", [1, 23, 25])
    def test_rows_of_parts_of_pixels(self, row_bytes):
        rows, behind = np.zeros((3, row_bytes), np.uint8), np.zeros((3, row_bytes + 1), np.uint8)
        with refused():
            call("png_unfilter", filtered=behind, above=rows[0], out=rows)
        with refused():
            call("png_filter", rows=rows, out=behind)

    def test_rows_without_pixels(self):
        nothing = np.zeros((3, 0), np.uint8)
        call("png_unfilter", filtered=np.zeros((3, 1), np.uint8), above=nothing[0], out=nothing)
        with refused():
            call("png_filter", rows=nothing, out=np.zeros((3, 1), np.uint8))

    def test_no_rows(self):
        nothing, behind = np.zeros((0, 24), np.uint8), np.zeros((0, 25), np.uint8)
        call("png_unfilter", filtered=behind, out=nothing)
        call("png_filter", rows=nothing, out=behind)

    def test_arrays_that_share_their_memory(self):
        """Whatever comes out, nothing is read or written beside them."""
        memory = few_bytes(400) % 5
        for kind in range(5):
            memory[:] = kind
            call(
                "png_unfilter", filtered=memory[:75].reshape(3, 25), out=memory[1:73].reshape(3, 24)
            )
        call("png_filter", rows=memory[:72].reshape(3, 24), out=memory[1:76].reshape(3, 25))
        call("exr_pack", samples=memory[:48].view(np.float16).reshape(2, 3, 4), out=memory[1:49])
        call(
            "exr_unpack", block=memory[:192], packed=False,
            out=memory[2:98].view(np.float16).reshape(2, 6, 4),
        )  # fmt: skip
