"""Deep EXR files as they are read: every packing, tiles and parts, what is damaged or missing."""

import contextlib
import dataclasses
import os
import struct

import deepfile
import exrfile
import numpy as np
import OpenEXR
import pytest
from deepfile import Deep, noise, of_pixels

from hpcomp.errors import InputError, MismatchError
from hpcomp.imagefile.deepreading import DeepReader
from hpcomp.imagefile.description import describe
from hpcomp.imagefile.interpretation import Interpretation
from hpcomp.imagefile.parts import choose

PACKINGS = ["none", "rle", "zips"]
TILES = [None, (4, 3), (64, 64), (1, 1)]
GREEN = (0.0, 0.5, 0.0, 0.5, 1.0, 2.0)


def reader_of(path, part=None, layer=None, **options):
    file = describe(str(path))
    chosen, group = choose(file, part=part, layer=layer, deep=True)
    return DeepReader(file, chosen, group, Interpretation(**options))


def samples_of(reader, rows=1000):
    """All samples, read so many rows at a time: (counts, front, back, rgba)."""
    window = reader.window
    found = []
    for y in range(window.y, window.bottom, rows):
        samples, left_out = reader.read(y, min(y + rows, window.bottom))
        assert left_out == 0
        found.append(samples)
    return [
        np.concatenate([getattr(samples, name) for samples in found])
        for name in ("counts", "front", "back", "rgba")
    ]


def read_whole(path, **options):
    """How many samples there are, as counted before and as read."""
    with contextlib.closing(reader_of(path, **options)) as reader:
        counted = reader.count()
        counts, *_ = samples_of(reader)
    return counted.rows.sum(), counts.sum()


def refused(content, tmp_path, *says, error=InputError, **options):
    path = tmp_path / "bad.exr"
    path.write_bytes(content)
    with pytest.raises(error) as caught:
        read_whole(path, **options)
    for word in ("bad.exr", *says):
        assert word in str(caught.value)


# ---- what is read ---------------------------------------------------------------------------


@pytest.mark.pairwise
@pytest.mark.parametrize("tile", TILES)
@pytest.mark.parametrize("compression", PACKINGS)
@pytest.mark.parametrize(("color", "depth"), [("f4", "f4"), ("f2", "f2"), ("f2", "u4")])
def test_samples_are_those_that_the_library_reads(tmp_path, compression, tile, color, depth):
    deep = noise(
        13, 11, 5, compression=compression, tile=tile, color=color, depth=depth, origin=(-3, 7)
    )
    path = deepfile.write(tmp_path / "a.exr", deep)
    wanted = [sample for row in deepfile.read_back(path) for pixel in row for sample in pixel]
    for rows in (1, 4, 11):
        counts, front, back, rgba = samples_of(reader_of(path), rows)
        assert np.array_equal(counts, deep.counts.ravel())
        assert np.array_equal(front, [sample["Z"] for sample in wanted])
        assert np.array_equal(back, [sample["ZBack"] for sample in wanted])
        for column, name in enumerate("RGBA"):
            assert np.array_equal(rgba[:, column], [sample[name] for sample in wanted])


@pytest.mark.parametrize("tile", [None, (8, 4)])
@pytest.mark.parametrize("compression", PACKINGS)
def test_files_that_openexr_writes(tmp_path, compression, tile):
    rng = np.random.default_rng(5)
    counts = rng.integers(0, 7, (20, 17))
    planes = {}
    for name in "ABGRZ":
        planes[name] = np.empty(counts.shape, object)
        for at in np.ndindex(*counts.shape):
            # Of few values, which shrink, and so are packed.
            planes[name][at] = (rng.integers(0, 3, counts[at]) / 2).astype(np.float32)
    header = exrfile.header(planes, compression=compression, tile=tile, deep=tile is None)
    if tile:
        header["type"] = OpenEXR.deeptile
    wanted = {name: np.concatenate(plane.ravel()) for name, plane in planes.items()}
    OpenEXR.File(header, planes).write(str(tmp_path / "a.exr"))
    found, front, back, rgba = samples_of(reader_of(tmp_path / "a.exr"), 3)
    assert np.array_equal(found, counts.ravel())
    assert np.array_equal(front, wanted["Z"])
    assert np.array_equal(back, wanted["Z"])
    for column, name in enumerate("RGBA"):
        assert np.array_equal(rgba[:, column], wanted[name])


@pytest.mark.parametrize("tile", [None, (5, 4)])
def test_how_many_samples_there_are_is_known_before_they_are_read(tmp_path, tile):
    deep = noise(13, 11, 5, tile=tile)
    counted = reader_of(deepfile.write(tmp_path / "a.exr", deep)).count()
    assert np.array_equal(counted.rows, deep.counts.sum(axis=1))
    assert counted.deepest == deep.counts.max()
    chunks = [deep.counts[i : i + 1] for i in range(11)]
    if tile:
        chunks = [deep.counts[y : y + 4, x : x + 5] for y in (0, 4, 8) for x in (0, 5, 10)]
    assert counted.largest_chunk == 24 * max(chunk.sum() for chunk in chunks)


def test_a_part_is_chosen_by_name_or_number(tmp_path):
    shown = {"display": (0, 0, 9, 6)}
    first = noise(9, 5, name="near", **shown)
    second = noise(7, 6, seed=1, name="far", tile=(4, 4), **shown)
    path = deepfile.write(tmp_path / "a.exr", first, second)
    for part, deep in (("near", first), ("far", second), ("1", second)):
        counts, front, _, _ = samples_of(reader_of(path, part=part))
        assert np.array_equal(counts, deep.counts.ravel())
        assert np.array_equal(front, deep.planes["Z"])
    with pytest.raises(InputError, match="part= one of near, far"):
        reader_of(path)


def test_alpha_of_a_layer_is_its_own_or_that_around_it(tmp_path):
    names = ("A", "B", "G", "R", "Z", "a.A", "a.B", "a.G", "a.R", "a.b.B", "a.b.G", "a.b.R", "c.B",
             "c.G", "c.R")  # fmt: skip
    values = [[[tuple(np.arange(len(names)) / 32)]]]
    path = deepfile.write(tmp_path / "a.exr", of_pixels(values, names))
    for layer, alpha in ((None, "A"), ("a", "a.A"), ("a.b", "a.A"), ("c", "A")):
        _, _, _, rgba = samples_of(reader_of(path, layer=layer))
        colors = [f"{layer}.{name}" if layer else name for name in "RGB"]
        assert rgba[0].tolist() == [names.index(name) / 32 for name in (*colors, alpha)]


def test_grey_colours_and_the_old_name_of_the_back(tmp_path):
    deep = of_pixels([[[(0.25, 0.5, 1.0, 3.0)]]], ("Y", "A", "Z", "Zback"))
    _, front, back, rgba = samples_of(reader_of(deepfile.write(tmp_path / "a.exr", deep)))
    assert (front.tolist(), back.tolist()) == ([1], [3])
    assert rgba.tolist() == [[0.25, 0.25, 0.25, 0.5]]


def test_alpha_is_held_to_its_range_and_straight_colours_are_multiplied(tmp_path):
    deep = of_pixels([[[(1.0, 0.5, 0.0, 0.5, 1, 1), (1, 1, 1, 2, 2, 2), (1, 1, 1, -1, 3, 3)]]])
    path = deepfile.write(tmp_path / "a.exr", deep)
    _, _, _, rgba = samples_of(reader_of(path))
    assert rgba[:, 3].tolist() == [0.5, 1, 0]
    _, _, _, rgba = samples_of(reader_of(path, alpha="straight"))
    assert rgba[0].tolist() == [0.5, 0.25, 0, 0.5]


@pytest.mark.parametrize(
    ("channel", "value"), [("Z", np.nan), ("ZBack", np.nan), ("R", np.inf), ("A", np.nan)]
)
def test_policies_on_samples_that_are_not_finite(tmp_path, channel, value):
    pixels = [[[GREEN], [GREEN, GREEN]], [[], [GREEN]]]
    deep = of_pixels(pixels)
    deep.planes[channel][[2, 3]] = value
    path = deepfile.write(tmp_path / "a.exr", deep)
    with pytest.raises(MismatchError, match=r"2 samples are NaN or infinite, .* pixel 1,0: "):
        samples_of(reader_of(path))
    with pytest.raises(MismatchError, match=r"1 sample is NaN or infinite, .* pixel 1,1: "):
        reader_of(path).read(1, 2)
    samples, left_out = reader_of(path, nonfinite="zero").read(0, 2)
    assert (samples.counts.tolist(), left_out) == ([1, 1, 0, 0], 2)
    assert np.isfinite(samples.rgba).all()
    samples, left_out = reader_of(path, nonfinite="keep").read(0, 2)
    assert (samples.counts.tolist(), left_out) == ([1, 2, 0, 1], 0)
    assert not np.isnan(samples.front).any()
    assert not np.isnan(samples.back).any()


def test_infinitely_far_is_a_depth(tmp_path):
    deep = of_pixels([[[(0.0, 0.5, 0.0, 0.5, np.inf, np.inf)]]])
    _, front, _, _ = samples_of(reader_of(deepfile.write(tmp_path / "a.exr", deep)))
    assert front.tolist() == [np.inf]


# ---- what is refused ------------------------------------------------------------------------


def of_names(*names):
    return deepfile.content(of_pixels([[[(0.5,) * len(names)]]], names))


def test_channels_that_must_be_there(tmp_path):
    refused(of_names("R", "G", "B", "Z"), tmp_path, "no alpha A", "only R, G, B, Z")
    refused(of_names("R", "G", "B", "A"), tmp_path, "no depth Z")
    refused(of_names("A", "ZBack"), tmp_path, "no depth Z")
    refused(of_names("id", "Z"), tmp_path, "no colour", "R, G and B or Y, or A, are needed")
    refused(of_names("R", "G", "B", "A", "AR", "Z"), tmp_path, "alpha for each colour", "AR")
    refused(of_names("R", "G", "B", "RA", "GA", "BA", "Z"), tmp_path, "BA", "one A first")


def test_flat_files_are_told_where_to_go(tmp_path):
    path = exrfile.write(tmp_path / "bad.exr", exrfile.rgba())
    refused(path.read_bytes(), tmp_path, "is flat", "hpcomp stack")


@pytest.mark.parametrize("tile", [None, (4, 3)])
@pytest.mark.parametrize("compression", PACKINGS)
def test_a_truncated_file_is_refused(tmp_path, compression, tile):
    """And not left open."""
    whole = deepfile.content(noise(9, 7, tile=tile, compression=compression))
    before = os.listdir("/dev/fd")
    for size in range(len(whole) // 9, len(whole), len(whole) // 17):
        refused(whole[:size], tmp_path)
    assert os.listdir("/dev/fd") == before


@pytest.mark.parametrize("tile", [None, (4, 3)])
@pytest.mark.parametrize("compression", PACKINGS)
def test_damage_anywhere_is_refused_or_read_as_what_it_then_is(tmp_path, compression, tile):
    """Never a crash, never another error than those that are one line."""
    whole = deepfile.content(noise(9, 7, tile=tile, compression=compression))
    rng = np.random.default_rng(6)
    path = tmp_path / "bad.exr"
    refusals = 0
    for _ in range(300):
        damaged = bytearray(whole)
        for at in rng.integers(8, len(whole), rng.integers(1, 4)):
            damaged[at] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            counted, read = read_whole(path, nonfinite="keep")
        except InputError:
            refusals += 1
        else:
            assert counted == read < 10_000
    assert refusals > 50


def test_billions_of_samples_that_are_not_there_take_no_memory(tmp_path):
    deep = noise(9, 1, compression="none")
    content = bytearray(deepfile.content(deep))
    start = struct.unpack_from("<Q", content, len(content) - len(deep.chunk(0, None)) - 8)[0]
    table = start + 4 + 24
    # The last pixel counts up to two billion, and the sizes agree with it.
    struct.pack_into("<i", content, table + 32, 2_000_000_000)
    struct.pack_into("<Q", content, start + 20, 2_000_000_000 * 24)
    refused(content, tmp_path, "row 0", "fewer samples than counted")
    struct.pack_into("<Q", content, start + 12, 2_000_000_000 * 24)
    refused(content, tmp_path, "row 0", "end behind the file")
    content = bytearray(deepfile.content(deep))
    struct.pack_into("<i", content, table + 32, -5)
    refused(content, tmp_path, "row 0", "table of counts is damaged")


def test_sizes_that_contradict_each_other(tmp_path):
    deep = noise(9, 1, compression="none")
    content = bytearray(deepfile.content(deep))
    start = len(content) - len(deep.chunk(0, None))
    struct.pack_into("<Q", content, start + 20, 24 * int(deep.counts.sum()) + 24)
    refused(content, tmp_path, "samples are not as many as counted")
    struct.pack_into("<i", content, start, 1)
    refused(content, tmp_path, "not where they should be")


def test_a_table_of_rows_with_gaps_is_that_of_a_file_that_is_not_whole(tmp_path):
    deep = noise(9, 4)
    content = bytearray(deepfile.content(deep))
    first = len(content) - sum(len(deep.chunk(n, None)) for n in range(4))
    struct.pack_into("<Q", content, first - 8, 0)
    refused(content, tmp_path)


def test_a_compression_that_cannot_be_read_is_named(tmp_path):
    planes = {name: np.empty((2, 2), object) for name in "RGBAZ"}
    for plane in planes.values():
        for at in np.ndindex(2, 2):
            plane[at] = np.full(3, 0.5, np.float32)
    header = exrfile.header(planes, compression="zstd", deep=True)
    OpenEXR.File(header, planes).write(str(tmp_path / "z.exr"))
    refused((tmp_path / "z.exr").read_bytes(), tmp_path, "zstd", "store them as zips")


def test_a_long_header_is_read_whole(tmp_path):
    deep = noise(5, 4)
    deep = dataclasses.replace(deep, attributes={"comments": ("string", b"x" * 300_000)})
    counts, *_ = samples_of(reader_of(deepfile.write(tmp_path / "a.exr", deep)))
    assert np.array_equal(counts, deep.counts.ravel())


def test_a_file_without_any_sample(tmp_path):
    empty = Deep(np.zeros((3, 4), int), {name: np.empty(0, "f4") for name in deepfile.NAMES})
    counts, front, _, rgba = samples_of(reader_of(deepfile.write(tmp_path / "a.exr", empty)))
    assert (counts.sum(), len(front), rgba.shape) == (0, 0, (0, 4))
