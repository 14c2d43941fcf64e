"""The files of pngfile and exrfile are what they say, by OpenImageIO and OpenEXR; no hpcomp."""

from __future__ import annotations

import itertools
import zlib

import exrfile
import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pngfile
import pytest

# The formulas of pngfile and the division of libpng's integers are both float64: a few roundings.
ROUNDING = 1e-12
# The lossy codecs may move a value of [0, 1) by this much: B44 keeps 6 bits, DWA a level of 45.
CODEC_LOSS = 0.13


def read(path, subimage: int = 0):
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)
    image = oiio.ImageInput.open(str(path), hint)
    assert image is not None, oiio.geterror()
    assert image.seek_subimage(subimage, 0)
    spec = image.spec()
    pixels = image.read_image(subimage, 0, 0, spec.nchannels, oiio.UNKNOWN)
    assert pixels is not None, image.geterror()
    return spec, pixels


@pytest.mark.parametrize("png", pngfile.every_kind(), ids=pngfile.name_of)
def test_png_pixels(tmp_path, png):
    path = tmp_path / "a.png"
    path.write_bytes(png.encode())
    spec, pixels = read(path)
    kept = {1: [0], 2: [0, 3], 3: [0, 1, 2], 4: [0, 1, 2, 3]}[spec.nchannels]
    assert (3 in kept) == png.has_alpha
    assert pixels.dtype == (np.uint16 if png.depth == 16 else np.uint8)
    top = np.iinfo(pixels.dtype).max
    assert np.abs(pixels / top - png.straight()[..., kept]).max() < ROUNDING


def test_png_every_kind_is_there_once():
    names = [pngfile.name_of(png) for png in pngfile.every_kind()]
    # 15 pairs of colour type and depth, 11 of them also with tRNS, each interlaced or not.
    assert len(names) == len(set(names)) == 2 * (15 + 11)


def test_png_chunks_and_damage():
    png = pngfile.random_png(pngfile.PALETTE, 8, transparent=True).with_chunks(
        head=[pngfile.gama(45455), pngfile.srgb()],
        body=[pngfile.phys(2835, 2835)],
        tail=[pngfile.text("Comment", "x"), pngfile.time()],
    )
    data = png.encode()
    kinds = [kind for kind, _ in pngfile.split(data)]
    assert kinds == (
        [b"IHDR", b"gAMA", b"sRGB", b"PLTE", b"tRNS", b"pHYs", b"IDAT", b"tEXt", b"tIME", b"IEND"]
    )
    broken = pngfile.break_crc(data, b"pHYs")
    assert sum(a != b for a, b in zip(data, broken, strict=True)) == 1
    with pytest.raises(AssertionError, match="pHYs"):
        pngfile.split(broken)
    without = pngfile.split(pngfile.replace_chunk(data, b"gAMA", None))
    assert b"gAMA" not in dict(without)
    other = dict(pngfile.split(pngfile.replace_chunk(data, b"sRGB", b"\3")))
    assert other[b"sRGB"] == b"\3"
    assert pngfile.flip_bit(b"\0\0", 1, 7) == b"\0\x80"


@pytest.mark.parametrize("version", [2, 4])
def test_icc_profile_is_read(tmp_path, version):
    path = tmp_path / "a.png"
    profile = pngfile.icc_profile("Wide by test", pngfile.P3_XY, version=version)
    png = pngfile.random_png(pngfile.RGBA, 8).with_chunks(head=[pngfile.iccp(profile)])
    path.write_bytes(png.encode())
    spec, _ = read(path)
    assert spec["ICCProfile:profile_description"] == "Wide by test"
    assert spec["ICCProfile:profile_size"] == len(profile)
    assert bytes(bytearray(spec["ICCProfile"])) == profile


def test_matrices_have_the_published_values():
    # IEC 61966-2-1 prints four digits.
    published = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    ours = pngfile.rgb_to_xyz(pngfile.SRGB_XY, pngfile.D65_XY)
    assert np.abs(ours - published).max() < 6e-5
    # ITU-R BT.2087 prints BT.709 -> BT.2020 with four digits; its inverse is ours.
    published = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]]
    xy = np.reshape(exrfile.PRIMARIES["rec2020"], (4, 2))
    assert np.abs(np.linalg.inv(pngfile.to_rec709(xy[:3], xy[3])) - published).max() < 6e-5
    xy = np.reshape(exrfile.PRIMARIES["ap1"], (4, 2))
    # Grey stays grey whatever the white.
    assert np.abs(pngfile.to_rec709(xy[:3], xy[3]) @ np.ones(3) - 1).max() < ROUNDING


@pytest.mark.parametrize("tile", [None, (16, 8)], ids=["scanline", "tiled"])
@pytest.mark.parametrize("compression", exrfile.COMPRESSIONS)
def test_exr_compressions(tmp_path, compression, tile):
    channels = exrfile.planes("RGBA", 23, 19)
    path = exrfile.write(tmp_path / "a.exr", channels, compression=compression, tile=tile)
    spec, pixels = read(path)
    assert spec["compression"] == compression
    assert (spec.tile_width, spec.tile_height) == (tile or (0, 0))
    assert spec.format == oiio.TypeDesc("half")
    loss = np.abs(pixels.astype(float) - exrfile.layer(channels)).max()
    assert loss <= (CODEC_LOSS if compression in exrfile.LOSSY else 0)


def test_exr_windows_and_attributes(tmp_path):
    path = exrfile.write(
        tmp_path / "a.exr",
        exrfile.rgba(),
        origin=(-5, 7),
        display=(-20, -30, 50, 60),
        line_order="decreasing",
        pixel_aspect=2.0,
        chromaticities=exrfile.PRIMARIES["ap1"],
        colorInteropID="lin_ap1_scene",
    )
    spec, pixels = read(path)
    assert (spec.x, spec.y, spec.width, spec.height) == (-5, 7, 23, 19)
    window = (spec.full_x, spec.full_y, spec.full_width, spec.full_height)
    assert window == (-20, -30, 50, 60)
    assert spec["openexr:lineOrder"] == "decreasingY"
    assert spec["PixelAspectRatio"] == 2.0
    assert spec["colorInteropID"] == "lin_ap1_scene"
    assert np.array_equal(np.float32(spec["chromaticities"]), np.float32(exrfile.PRIMARIES["ap1"]))
    assert np.array_equal(pixels, exrfile.layer(exrfile.rgba()).astype(np.float16))


def test_exr_mixed_types(tmp_path):
    channels = {
        "R": exrfile.planes("R", 6, 5, np.float32)["R"],
        "G": exrfile.planes("G", 6, 5, np.float16)["G"],
        "B": exrfile.planes("B", 6, 5, np.uint32)["B"],
    }
    spec, _ = read(exrfile.write(tmp_path / "a.exr", channels))
    assert spec.channelnames == ("R", "G", "B")
    assert [str(kind) for kind in spec.channelformats] == ["float", "half", "uint"]


def test_exr_parts(tmp_path):
    path = exrfile.write_parts(
        tmp_path / "a.exr",
        [
            ("left", exrfile.rgba(seed=1), {}),
            ("depth", exrfile.planes("Z", 23, 19, np.float32), {"tile": (8, 8)}),
        ],
    )
    spec, pixels = read(path, 0)
    assert spec["oiio:subimages"] == 2
    assert spec["name"] == "left"
    assert np.array_equal(pixels, exrfile.layer(exrfile.rgba(seed=1)).astype(np.float16))
    spec, _ = read(path, 1)
    assert (spec["name"], spec.channelnames, spec.tile_width) == ("depth", ("Z",), 8)


def test_exr_deep(tmp_path):
    image = oiio.ImageInput.open(str(exrfile.write_deep(tmp_path / "a.exr")))
    assert image.spec().deep
    assert image.spec().channelnames == ("R", "G", "B", "A", "Z")


@pytest.mark.parametrize("compression", ["none", "zip"])
def test_exr_byte_by_byte(tmp_path, compression):
    channels = {
        "R": exrfile.planes("R", 21, 35, np.float32)["R"],
        "G": exrfile.planes("G", 21, 35, np.float16)["G"],
    }
    path = tmp_path / "a.exr"
    path.write_bytes(exrfile.raw_bytes(channels, (21, 35), origin=(3, -4), compression=compression))
    for name, plane in exrfile.read_back(path).items():
        assert np.array_equal(plane, channels[name])
    spec, _ = read(path)
    assert (spec.x, spec.y) == (3, -4)


@pytest.mark.parametrize("levels", ["one", "mip", "rip"])
@pytest.mark.parametrize("compression", ["none", "zip"])
def test_exr_levels(tmp_path, levels, compression):
    channels = exrfile.rgba(21, 35)
    path = tmp_path / "a.exr"
    path.write_bytes(
        exrfile.raw_bytes(channels, (21, 35), tile=(8, 16), levels=levels, compression=compression)
    )
    _, pixels = read(path)
    assert np.array_equal(pixels, exrfile.layer(channels).astype(np.float16))
    # The module reads back a file only if all chunks of all its levels are there.
    for name, plane in exrfile.read_back(path).items():
        assert np.array_equal(plane, channels[name])
    if levels == "mip":
        image = oiio.ImageInput.open(str(path))
        assert image.seek_subimage(0, 1)
        assert (image.spec().width, image.spec().height) == (10, 17)
        assert (image.read_image(0, 1, 0, 4, oiio.FLOAT) == 99).all()


def test_exr_subsampled(tmp_path):
    channels = {
        "Y": exrfile.planes("Y", 8, 6)["Y"],
        "RY": exrfile.planes(["RY"], 4, 3)["RY"],
        "BY": exrfile.planes(["BY"], 4, 3)["BY"],
    }
    path = tmp_path / "a.exr"
    steps = {"RY": (2, 2), "BY": (2, 2)}
    path.write_bytes(exrfile.raw_bytes(channels, (8, 6), sampling=steps))
    found = OpenEXR.File(str(path), separate_channels=True).channels()
    assert (found["RY"].xSampling, found["RY"].ySampling) == (2, 2)
    for name, plane in channels.items():
        assert np.array_equal(found[name].pixels, plane)


@pytest.mark.parametrize("tile", [None, (16, 16)], ids=["scanline", "tiled"])
def test_exr_regions(tmp_path, tile):
    data = exrfile.write(tmp_path / "a.exr", exrfile.coarse(), tile=tile).read_bytes()
    found = exrfile.regions(data)
    spans = sorted(span for spans in found.values() for span in spans)
    assert spans[0][0] == 0
    assert spans[-1][1] == len(data)
    assert all(a[1] == b[0] for a, b in itertools.pairwise(spans))
    assert len(found["pixels"]) == (6 if tile else 3)
    assert all(zlib.decompress(data[slice(*span)]) for span in found["pixels"])
