"""Reading and writing of PNG and EXR through the public API, on files made byte by byte."""

from __future__ import annotations

import dataclasses
import os
import pathlib
import re
import shlex
import struct
import subprocess
import sys
import sysconfig
import time
import warnings
import zlib

import exrfile
import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pngfile
import pytest

import hpcomp
from hpcomp import HpcompWarning, InputError, MismatchError, OutputError, SettingError, Window

# What is not announced must not happen: a file that is fully understood is read without a word.
pytestmark = pytest.mark.filterwarnings("error")

# A decoded value and a product with alpha, each rounded to float32 once: 2 · 2⁻²⁴, for values to 1.
FLOAT32 = 1.5e-7
# A 3×3 matrix on float32 with coefficients up to 1.7: four roundings of values up to 3.
MATRIX = 1e-6
# Chromaticities are stored as float32 in EXR (and in 5 digits in PNG); matrices repeat that by
# the condition of the primaries, which is below 10.
STORED_XY = 1e-6
STORED_XY_PNG = 5e-5
# Two ways of reckoning the gamut's border may fall on both sides of a code's rounding point.
BORDER_CODES = 1

BLACK = np.array([0.0, 0.0, 0.0, 1.0])
WEIGHTS = pngfile.rgb_to_xyz(pngfile.SRGB_XY, pngfile.D65_XY)[1]


def put(path, content):
    path.write_bytes(content.encode() if isinstance(content, pngfile.Png) else content)
    return path


def pixels(path, **options):
    """The pixels of a layer, after the properties that every layer has."""
    layer = hpcomp.read_layer(path, **options)
    window = layer.data_window
    assert layer.pixels.dtype == np.float32
    assert layer.pixels.shape == (window.height, window.width, 4)
    alpha = layer.pixels[..., 3]
    assert np.all((alpha >= 0) & (alpha <= 1))
    return layer.pixels


def assert_pixels(actual, expected, tolerance=FLOAT32):
    assert actual.shape == expected.shape
    error = np.abs(actual.astype(float) - expected)
    worst = np.unravel_index(np.argmax(error), error.shape)
    assert error.max() <= tolerance, f"{worst}: {actual[worst]} for {expected[worst]}"


def numbers(message, path):
    """The whole numbers in a message, but for those in the file's own name."""
    return [int(digits) for digits in re.findall(r"\d+", str(message).replace(str(path), ""))]


def refused(error, path, *words, **options):
    """Reading fails with this error, in one line that names the file and says these words."""
    with pytest.raises(error) as caught:
        hpcomp.read_layer(path, **options)
    message = str(caught.value)
    assert type(caught.value) is error
    assert "\n" not in message
    assert os.path.basename(str(path)) in message
    for word in words:
        assert word in message, f"{word!r} is not in {message!r}"
    return message


def attempt(path, errors=InputError, **options):
    """The pixels, or the error that says why there are none."""
    try:
        return pixels(path, **options)
    except errors as error:
        return error


# ---- PNG: what the pixels mean --------------------------------------------------------------


@pytest.mark.parametrize("png", pngfile.every_kind(), ids=pngfile.name_of)
def test_png_of_every_kind(tmp_path, png):
    path = put(tmp_path / "a.png", png)
    assert_pixels(pixels(path), png.linear())
    layer = hpcomp.read_layer(path)
    assert layer.data_window == layer.display_window == Window(0, 0, 13, 11)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (2, 3), (5, 5)])
@pytest.mark.parametrize("interlaced", [False, True])
def test_png_of_few_pixels(tmp_path, size, interlaced):
    png = pngfile.random_png(
        pngfile.RGBA, 8, width=size[0], height=size[1] + 1, interlaced=interlaced
    )
    png = dataclasses.replace(png, samples=png.samples[1:])
    assert_pixels(pixels(put(tmp_path / "a.png", png)), png.linear())


def test_png_of_every_code_value(tmp_path):
    codes = np.arange(65536).reshape(256, 256, 1)
    png = pngfile.Png(np.concatenate([codes, 65535 - codes], axis=-1), pngfile.GREY_ALPHA, 16)
    assert_pixels(pixels(put(tmp_path / "a.png", png)), png.linear())


def test_png_in_many_idat_chunks(tmp_path):
    png = dataclasses.replace(pngfile.random_png(pngfile.RGBA, 8), idat_size=5)
    assert_pixels(pixels(put(tmp_path / "a.png", png)), png.linear())


def test_half_transparent_white_over_black_is_half_the_light(tmp_path):
    """Straight alpha, decoded, then premultiplied: 188 in sRGB, not 128."""
    path = put(tmp_path / "white.png", pngfile.rgba_png(np.array([[[255, 255, 255, 128]]])))
    out = hpcomp.composite([BLACK.reshape(1, 1, 4), pixels(path)])
    assert_pixels(out, np.array([[[128 / 255] * 3 + [1.0]]]))
    hpcomp.write_image(tmp_path / "out.png", out)
    assert stored(tmp_path / "out.png").tolist() == [[[188, 188, 188, 255]]]


def test_png_with_an_unknown_colour_beside_the_picture(tmp_path):
    """Chunks without a say in the pixels have none."""
    png = pngfile.random_png(pngfile.RGBA, 8).with_chunks(
        head=[(b"sBIT", bytes([5, 6, 5, 8])), pngfile.text("oiio:ColorSpace", "lin_rec709")],
        body=[pngfile.bkgd(1, 2, 3), pngfile.phys(2835, 2835), (b"abCd", b"anything")],
        tail=[pngfile.time(), pngfile.text("oiio:UnassociatedAlpha", "0")],
    )
    assert_pixels(pixels(put(tmp_path / "a.png", png)), png.linear())


# ---- PNG: the alpha key ---------------------------------------------------------------------


@pytest.fixture
def rgba_png(tmp_path):
    png = pngfile.random_png(pngfile.RGBA, 8)
    return put(tmp_path / "rgba.png", png), png


def test_alpha_straight_is_what_a_png_has(rgba_png):
    path, png = rgba_png
    assert_pixels(pixels(path, alpha="straight"), png.linear())


def test_alpha_premultiplied(rgba_png):
    path, png = rgba_png
    expected = png.straight()
    expected[..., :3] = pngfile.srgb_to_linear(expected[..., :3])
    assert_pixels(pixels(path, alpha="premultiplied"), expected)


def test_alpha_premultiplied_encoded(tmp_path):
    """What drawing libraries keep in memory: the code values were multiplied by alpha."""
    rng = np.random.default_rng(5)
    alpha = rng.integers(1, 256, (6, 7, 1))
    premultiplied = np.round(rng.random((6, 7, 3)) * alpha)
    png = pngfile.rgba_png(np.concatenate([premultiplied, alpha], axis=-1).astype(int))
    expected = png.straight()
    straight = expected[..., :3] / expected[..., 3:]
    expected[..., :3] = pngfile.srgb_to_linear(straight) * expected[..., 3:]
    path = put(tmp_path / "a.png", png)
    assert_pixels(pixels(path, alpha="premultiplied-encoded"), expected, 4 * FLOAT32)


def test_alpha_premultiplied_encoded_of_transparent_black(tmp_path):
    path = put(tmp_path / "a.png", pngfile.rgba_png(np.zeros((1, 1, 4), int)))
    assert pixels(path, alpha="premultiplied-encoded").tolist() == [[[0, 0, 0, 0]]]


def by_luminance(straight, alpha):
    """(…, 4): the straight linear colour kept, its luminance times the file's alpha as alpha."""
    new_alpha = np.clip(straight @ WEIGHTS, 0, 1) * alpha
    return np.concatenate([straight * new_alpha[..., None], new_alpha[..., None]], axis=-1)


@pytest.mark.parametrize("colour", [pngfile.GREY, pngfile.RGB, pngfile.RGBA])
def test_alpha_luminance(tmp_path, colour):
    png = pngfile.random_png(colour, 8)
    encoded = png.straight()
    expected = by_luminance(pngfile.srgb_to_linear(encoded[..., :3]), encoded[..., 3])
    path = put(tmp_path / "mask.png", png)
    assert_pixels(pixels(path, alpha="luminance"), expected, 4 * FLOAT32)


def test_alpha_luminance_of_white_and_black(tmp_path):
    codes = np.array([[[255, 255, 255], [0, 0, 0], [128, 128, 128]]])
    path = put(tmp_path / "mask.png", pngfile.Png(codes, pngfile.RGB, 8))
    alpha = pixels(path, alpha="luminance")[0, :, 3]
    assert alpha[0] == 1
    assert alpha[1] == 0
    assert abs(alpha[2] - pngfile.srgb_to_linear(128 / 255)) < FLOAT32


def test_the_layer_syntax_is_a_path_too(rgba_png):
    path, _ = rgba_png
    by_key = pixels(f"{path}::alpha=luminance")
    assert np.array_equal(by_key, pixels(path, alpha="luminance"))
    assert not np.array_equal(by_key, pixels(path))


def test_a_file_with_two_colons_in_its_name_is_a_file(tmp_path, rgba_png):
    path = put(tmp_path / "x.png::alpha=luminance", rgba_png[1])
    assert_pixels(pixels(path), rgba_png[1].linear())


def test_unknown_alpha_lists_what_there_is(rgba_png):
    with pytest.raises(SettingError) as caught:
        hpcomp.read_layer(rgba_png[0], alpha="associated")
    for name in ("straight", "premultiplied", "premultiplied-encoded", "luminance"):
        assert name in str(caught.value)


# ---- PNG: light -----------------------------------------------------------------------------

P3 = (pngfile.D65_XY, *pngfile.P3_XY)
D50_XY = (0.3457, 0.3585)
#: What makes a profile one of tables, which is not honoured.
TABLES = [(b"A2B0", b"mft2" + bytes(44))]


def with_head(*chunks, colour=pngfile.RGBA):
    return pngfile.random_png(colour, 8).with_chunks(head=chunks)


@pytest.mark.parametrize(
    ("chunks", "curve"),
    [
        ([pngfile.gama(45455)], pngfile.srgb_to_linear),
        ([pngfile.gama(45000)], pngfile.power(1 / 0.45)),
        ([pngfile.gama(50000)], pngfile.power(2.0)),
        ([pngfile.gama(41237)], pngfile.power(1 / 0.41237)),
        ([pngfile.gama(100000)], pngfile.power(1.0)),
        ([pngfile.srgb()], pngfile.srgb_to_linear),
        ([pngfile.gama(100000), pngfile.srgb(3)], pngfile.srgb_to_linear),
        ([pngfile.srgb(), pngfile.gama(100000)], pngfile.srgb_to_linear),
        ([pngfile.cicp(1, 13)], pngfile.srgb_to_linear),
        ([pngfile.cicp(1, 8)], pngfile.power(1.0)),
        ([pngfile.gama(100000), pngfile.cicp(1, 13)], pngfile.srgb_to_linear),
        ([pngfile.srgb(), pngfile.cicp(1, 8)], pngfile.power(1.0)),
        (
            [pngfile.gama(45455), pngfile.chrm(pngfile.D65_XY, *pngfile.SRGB_XY)],
            pngfile.power(1 / 0.45455),
        ),
        ([pngfile.srgb(), pngfile.gama(45455), pngfile.chrm(*P3)], pngfile.srgb_to_linear),
    ],
    ids=lambda value: "+".join(kind.decode() for kind, _ in value) if type(value) is list else "",
)
@pytest.mark.parametrize("depth", [8, 16])
def test_png_curves(tmp_path, chunks, curve, depth):
    png = pngfile.random_png(pngfile.RGBA, depth).with_chunks(head=chunks)
    assert_pixels(pixels(put(tmp_path / "a.png", png)), png.linear(curve), 2 * FLOAT32)


@pytest.mark.parametrize(
    ("chunks", "curve", "primaries", "white"),
    [
        (
            [pngfile.gama(45455), pngfile.chrm(*P3)],
            pngfile.power(1 / 0.45455),
            pngfile.P3_XY,
            pngfile.D65_XY,
        ),
        ([pngfile.cicp(12, 13)], pngfile.srgb_to_linear, pngfile.P3_XY, pngfile.D65_XY),
        (
            [pngfile.gama(55555), pngfile.chrm(D50_XY, *pngfile.ADOBE_XY)],
            pngfile.power(1 / 0.55555),
            pngfile.ADOBE_XY,
            D50_XY,
        ),
    ],
    ids=["gAMA+cHRM of P3", "cICP of P3", "another white"],
)
def test_png_primaries_are_converted(tmp_path, chunks, curve, primaries, white):
    png = with_head(*chunks)
    expected = png.linear(curve)
    expected[..., :3] = expected[..., :3] @ pngfile.to_rec709(primaries, white).T
    found = pixels(put(tmp_path / "a.png", png))
    assert_pixels(found, expected, STORED_XY_PNG)
    # The fixture can tell: without the conversion the test would fail.
    assert np.abs(png.linear(curve) - expected).max() > 100 * STORED_XY_PNG


def test_grey_png_stays_grey_under_any_primaries(tmp_path):
    png = with_head(pngfile.gama(45455), pngfile.chrm(D50_XY, *pngfile.P3_XY), colour=pngfile.GREY)
    found = pixels(put(tmp_path / "a.png", png))
    assert_pixels(found, png.linear(pngfile.power(1 / 0.45455)), MATRIX)


@pytest.mark.parametrize("version", [2, 4])
def test_icc_profile_that_is_srgb_is_silent(tmp_path, version):
    profile = pngfile.iccp(pngfile.icc_profile("any name", version=version))
    png = with_head(profile)
    assert_pixels(pixels(put(tmp_path / "a.png", png)), png.linear())


def test_icc_profile_beats_gama(tmp_path):
    """Writers put a gAMA beside the profile for readers that know no ICC."""
    png = with_head(pngfile.gama(45455), pngfile.iccp(pngfile.icc_profile("sRGB")))
    assert_pixels(pixels(put(tmp_path / "a.png", png)), png.linear())


@pytest.mark.parametrize(
    "chunk",
    [
        pngfile.iccp(b"no profile at all, but long enough to look like one" * 9),
        (b"iCCP", b"broken\0\0this is not deflated"),
        pngfile.cicp(2, 2),
        pngfile.cicp(1, 13, 1),
        (b"cICP", b"\1"),
        (b"gAMA", b"\0\0"),
        pngfile.gama(0),
        pngfile.chrm((0.3, 0.3), (0.3, 0.3), (0.3, 0.3), (0.3, 0.3)),
        (b"cHRM", bytes(32)),
    ],
    ids=["iCCP", "iCCP deflate", "cICP unknown", "cICP matrix", "cICP short", "gAMA short", "gAMA 0", "cHRM", "cHRM 0"],
)
def test_colour_that_cannot_be_honoured_is_a_warning(tmp_path, chunk):
    png = with_head(chunk)
    path = put(tmp_path / "odd.png", png)
    with pytest.warns(HpcompWarning, match=r"odd\.png") as caught:
        found = pixels(path)
    assert len(caught) == 1
    assert_pixels(found, png.linear())


def test_icc_profile_of_two_lines_is_named_in_one(tmp_path):
    profile = pngfile.icc_profile("two\nlines\x1b[31m", more=TABLES)
    path = put(tmp_path / "a.png", with_head(pngfile.iccp(profile)))
    with pytest.warns(HpcompWarning, match="two") as caught:
        pixels(path)
    assert str(caught[0].message).isprintable()


def test_strict_makes_them_errors(tmp_path):
    profile = pngfile.icc_profile("Wide by test", more=TABLES)
    path = put(tmp_path / "a.png", with_head(pngfile.iccp(profile)))
    refused(InputError, path, "Wide by test", strict=True)


@pytest.mark.parametrize(
    ("name", "curve", "primaries"),
    [
        ("srgb", pngfile.srgb_to_linear, pngfile.SRGB_XY),
        ("linear", pngfile.power(1.0), pngfile.SRGB_XY),
        ("display-p3", pngfile.srgb_to_linear, pngfile.P3_XY),
        ("adobe-rgb", pngfile.power(563 / 256), pngfile.ADOBE_XY),
    ],
)
@pytest.mark.parametrize("colour", [pngfile.RGBA, pngfile.PALETTE, pngfile.GREY_ALPHA])
def test_colorspace_key_overrides_the_file(tmp_path, name, curve, primaries, colour):
    """Nor is there a warning of a profile that nobody asks for."""
    profile = pngfile.icc_profile("Wide by test", more=TABLES)
    png = with_head(pngfile.gama(50000), pngfile.iccp(profile), colour=colour)
    expected = png.linear(curve)
    expected[..., :3] = expected[..., :3] @ pngfile.to_rec709(primaries, pngfile.D65_XY).T
    found = pixels(put(tmp_path / "a.png", png), colorspace=name)
    assert_pixels(found, expected, STORED_XY_PNG)


def test_unknown_colorspace_lists_what_there_is(rgba_png):
    with pytest.raises(SettingError, match=r"(?=.*srgb)(?=.*linear)(?=.*acescg)"):
        hpcomp.read_layer(rgba_png[0], colorspace="rgb")


# ---- PNG: damage ----------------------------------------------------------------------------


def small_png(interlaced=False):
    """Few bytes, but every sort of chunk: critical, colour, ancillary, before and after IDAT."""
    png = pngfile.random_png(
        pngfile.PALETTE, 2, transparent=True, width=5, height=4, interlaced=interlaced
    )
    return png.with_chunks(
        head=[pngfile.gama(45455)],
        body=[pngfile.text("Title", "a map")],
        tail=[pngfile.text("Comment", "end")],
    )


@pytest.mark.parametrize("interlaced", [False, True])
def test_every_flipped_bit_of_a_png_is_noticed(tmp_path, interlaced):
    """Every chunk has a CRC, so nothing may go unseen: not in the pixels, not beside them."""
    data = small_png(interlaced).encode()
    path = tmp_path / "damaged.png"
    sound = pixels(put(path, data))
    assert sound.shape == (4, 5, 4)
    unseen = []
    for place in range(len(data)):
        for bit in range(8):
            put(path, pngfile.flip_bit(data, place, bit))
            outcome = attempt(path, strict=True)
            if not (isinstance(outcome, InputError) and "damaged.png" in str(outcome)):
                unseen.append((place, bit))
            # What is read all the same is the same picture.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                outcome = attempt(path)
            if not isinstance(outcome, InputError):
                assert np.array_equal(outcome, sound), (place, bit)
    assert not unseen


@pytest.mark.parametrize("interlaced", [False, True])
def test_every_truncated_png_is_noticed(tmp_path, interlaced):
    data = small_png(interlaced).encode()
    for length in range(len(data)):
        refused(InputError, put(tmp_path / "cut.png", data[:length]))


@pytest.mark.parametrize("kind", [b"IHDR", b"gAMA", b"PLTE", b"tRNS", b"IDAT", b"IEND"])
def test_the_broken_chunk_is_named(tmp_path, kind):
    path = put(tmp_path / "a.png", pngfile.break_crc(small_png().encode(), kind))
    refused(InputError, path, kind.decode())


COLOR_CHUNKS = [
    pngfile.srgb(),
    pngfile.gama(50000),
    pngfile.chrm(pngfile.D65_XY, *pngfile.P3_XY),
    pngfile.cicp(9, 13),
    pngfile.iccp(pngfile.icc_profile("p", pngfile.P3_XY)),
]
OTHER_CHUNKS = [
    pngfile.text("Title", "a map"),
    (b"cLLI", bytes(8)),
    (b"mDCV", bytes(24)),
    pngfile.time(),
    pngfile.phys(3000, 2000),
    pngfile.bkgd(1, 2, 3),
    (b"prVt", b"what only its writer knows"),
]


@pytest.mark.parametrize("chunk", COLOR_CHUNKS, ids=lambda chunk: chunk[0].decode())
def test_a_broken_chunk_that_decides_colour_refuses_the_file(tmp_path, chunk):
    data = pngfile.random_png(pngfile.RGBA, 8).with_chunks(head=[chunk]).encode()
    refused(InputError, put(tmp_path / "a.png", pngfile.break_crc(data, chunk[0])), "checksum")


@pytest.mark.parametrize("kind", [pngfile.RGBA, pngfile.PALETTE], ids=["fast", "library"])
@pytest.mark.parametrize("chunk", OTHER_CHUNKS, ids=lambda chunk: chunk[0].decode())
def test_a_broken_chunk_that_decides_nothing_is_dropped_with_a_word(tmp_path, chunk, kind):
    png = pngfile.random_png(kind, 8)
    data = png.with_chunks(body=[chunk]).encode()
    path = put(tmp_path / "a.png", pngfile.break_crc(data, chunk[0]))
    words = f"the checksum of its {chunk[0].decode()} chunk is wrong, and it is left out"
    with pytest.warns(HpcompWarning, match=words):
        assert_pixels(pixels(path), png.linear())
    refused(InputError, path, words, strict=True)
    part = hpcomp.info(path).parts[0]
    assert [omission.text for omission in part.omissions] == [words]
    assert part.pixel_aspect == 1


@pytest.mark.parametrize("sizes", [(40, 10**9), (0, 10**9), (40, 0, 10**9)])
@pytest.mark.parametrize("kind", [pngfile.RGBA, pngfile.PALETTE], ids=["fast", "library"])
def test_image_data_in_pieces_with_something_between(tmp_path, kind, sizes):
    """PNG third edition, 5.6: IDAT chunks are consecutive; libpng refuses others."""
    png = pngfile.random_png(kind, 8, interlaced=False)
    before, data, after = [], b"", []
    for name, body in png.chunks():
        if name == b"IDAT":
            data += body
        else:
            (after if data else before).append((name, body))
    pieces = []
    for size in sizes:
        pieces.append((b"IDAT", data[:size]))
        data = data[size:]
    whole = put(tmp_path / "a.png", pngfile.join([*before, *pieces, *after]))
    assert_pixels(pixels(whole), png.linear())
    for between in (pngfile.text("Title", "a map"), (b"PLTE", bytes(3)), pngfile.gama(50000)):
        parted = [*before, pieces[0], between, *pieces[1:], *after]
        refused(InputError, put(whole, pngfile.join(parted)), "its IDAT chunks are not consecutive")
    broken = pngfile.join([*before, pieces[0], (b"teXt", b"\0"), *pieces[1:], *after])
    refused(InputError, put(whole, pngfile.break_crc(broken, b"teXt")), "are not consecutive")


@pytest.mark.parametrize("chunk", COLOR_CHUNKS, ids=lambda chunk: chunk[0].decode())
def test_colour_chunks_behind_the_image_data_are_left_out_with_a_word(tmp_path, chunk):
    """As libpng has it, so that the picture looks as in other programs."""
    png = pngfile.random_png(pngfile.RGBA, 8)
    path = put(tmp_path / "a.png", png.with_chunks(tail=[chunk]))
    with pytest.warns(HpcompWarning, match=f"its {chunk[0].decode()} chunk is behind the image"):
        assert_pixels(pixels(path), png.linear())


def header(width, height, depth=8, colour=pngfile.RGBA, rest=b"\0\0\0"):
    return struct.pack(">IIBB", width, height, depth, colour) + rest


def sound_chunks_of_nonsense():
    """(name, bytes): files in which every CRC is right and something else is wrong."""
    png = pngfile.random_png(pngfile.RGBA, 8)
    data, raster = png.encode(), png.raster()
    kinds = dict(png.chunks())

    def with_header(*args, **options):
        return pngfile.replace_chunk(data, b"IHDR", header(*args, **options))

    def with_data(content):
        return pngfile.replace_chunk(data, b"IDAT", content)

    palette = pngfile.random_png(pngfile.PALETTE, 8).encode()
    yield "no pixels at all", with_header(0, 11)
    yield "more rows than there are", with_header(13, 12)
    yield "no such depth", with_header(13, 11, depth=7)
    yield "no such colour type", with_header(13, 11, colour=5)
    yield "no such interlacing", with_header(13, 11, rest=b"\0\0\2")
    yield "a header too long", pngfile.replace_chunk(data, b"IHDR", kinds[b"IHDR"] + b"\0")
    yield "a width beyond the format", with_header(2**31, 1)
    yield "sixty thousand squared", with_header(60000, 60000)
    yield "no IHDR", pngfile.replace_chunk(data, b"IHDR", None)
    yield "no IDAT", pngfile.replace_chunk(data, b"IDAT", None)
    yield "an empty IDAT", with_data(b"")
    yield "no IEND", pngfile.replace_chunk(data, b"IEND", None)
    yield "no palette", pngfile.replace_chunk(palette, b"PLTE", None)
    yield "rows missing", with_data(zlib.compress(raster[:-20]))
    yield "no deflate", with_data(b"these are not deflated bytes at all")
    yield "a wrong Adler-32", with_data(zlib.compress(raster)[:-1] + b"\0")
    yield "no such filter", with_data(zlib.compress(b"\7" + raster[1:]))
    yield (
        "an unknown critical chunk",
        pngfile.join([*png.chunks()[:1], (b"ABCD", b"must be understood"), *png.chunks()[1:]]),
    )


@pytest.mark.parametrize(
    "content", [pytest.param(data, id=name) for name, data in sound_chunks_of_nonsense()]
)
def test_png_with_right_checksums_and_wrong_content(tmp_path, content):
    refused(InputError, put(tmp_path / "a.png", content))


# ---- EXR: what the pixels mean --------------------------------------------------------------


@pytest.fixture
def exr(tmp_path):
    """Writes an EXR of these planes and options, gives its path."""

    def write(channels, **options):
        return exrfile.write(tmp_path / "a.exr", channels, **options)

    return write


@pytest.mark.parametrize("tile", [None, (8, 8), (16, 5)], ids=["scanline", "square", "oblong"])
@pytest.mark.parametrize("dtype", [np.float16, np.float32], ids=["half", "float"])
def test_exr_is_premultiplied_linear_and_kept_exactly(exr, dtype, tile):
    """HDR, negative colour, and light at alpha 0 among it."""
    channels = exrfile.rgba(dtype=dtype)
    found = pixels(exr(channels, tile=tile))
    assert np.array_equal(found, exrfile.layer(channels))
    assert found[0, 1].tolist() == [0.25, 0.5, 1.0, 0.0]


@pytest.mark.pairwise
@pytest.mark.parametrize("tile", [None, (16, 8)], ids=["scanline", "tiled"])
@pytest.mark.parametrize("dtype", [np.float16, np.float32], ids=["half", "float"])
@pytest.mark.parametrize("compression", exrfile.COMPRESSIONS)
def test_exr_of_every_compression(exr, compression, dtype, tile):
    channels = exrfile.planes("RGBA", 75, 70, dtype)
    path = exr(channels, compression=compression, tile=tile)
    # Where the codec is lossy, what the other library decodes is the truth.
    truth = exrfile.read_back(path)
    assert np.array_equal(pixels(path), exrfile.layer(truth).astype(np.float32))


@pytest.mark.parametrize("tile", [None, (16, 8)], ids=["scanline", "tiled"])
def test_exr_of_decreasing_lines(exr, tile):
    channels = exrfile.planes("RGBA", 40, 70)
    found = pixels(exr(channels, line_order="decreasing", tile=tile))
    assert np.array_equal(found, exrfile.layer(channels))


@pytest.mark.parametrize("levels", ["mip", "rip"])
@pytest.mark.parametrize("compression", ["none", "zip"])
def test_exr_with_levels_is_read_at_full_size(tmp_path, levels, compression):
    channels = exrfile.rgba(21, 35)
    data = exrfile.raw_bytes(
        channels, (21, 35), tile=(8, 16), levels=levels, compression=compression
    )
    path = put(tmp_path / "a.exr", data)
    assert np.array_equal(pixels(path), exrfile.layer(channels))


def test_exr_uint_is_read_as_stored(exr):
    channels = exrfile.planes("RGB", 9, 8, np.uint32)
    channels["R"][0, 0], channels["G"][0, 0], channels["B"][0, 0] = 7, 0, 2**32 - 1
    found = pixels(exr(channels))
    assert np.array_equal(found, exrfile.layer(channels, ["R", "G", "B", None]).astype(np.float32))
    assert found[0, 0].tolist() == [7.0, 0.0, 2.0**32, 1.0]


@pytest.mark.parametrize("tile", [None, (4, 4)], ids=["scanline", "tiled"])
def test_exr_of_mixed_types(exr, tile):
    channels = {
        "R": exrfile.planes("R", 9, 8, np.uint32)["R"],
        "G": exrfile.planes("G", 9, 8, np.float16)["G"],
        "B": exrfile.planes("B", 9, 8, np.float32)["B"],
        "A": np.ones((8, 9), np.uint32),
    }
    channels["A"][0, 0] = 0
    found = pixels(exr(channels, tile=tile))
    assert np.array_equal(found, exrfile.layer(channels).astype(np.float32))


def test_exr_alpha_is_held_to_0_and_1_and_colour_is_not(exr):
    channels = {
        name: np.array([values], np.float32)
        for name, values in {
            "R": [-3, 5, 1e6],
            "G": [0, 0, -1e-6],
            "B": [2, 2, 2],
            "A": [-0.5, 2, 1],
        }.items()
    }
    with pytest.warns(HpcompWarning, match="2 pixels have an alpha outside 0 to 1, from -0.5 to 2"):
        found = pixels(exr(channels))
    assert found[0, :, 3].tolist() == [0, 1, 1]
    assert np.array_equal(found[0, :, 0], np.float32([-3, 5, 1e6]))
    assert np.array_equal(found[0, :, 1], np.float32([0, 0, -1e-6]))


@pytest.mark.parametrize(
    ("names", "meaning"),
    [
        ("Y", ["Y", "Y", "Y", None]),
        ("YA", ["Y", "Y", "Y", "A"]),
        ("RGB", ["R", "G", "B", None]),
        ("RGBA", ["R", "G", "B", "A"]),
        ("RGBAZ", ["R", "G", "B", "A"]),
        ("YZ", ["Y", "Y", "Y", None]),
        (["r", "g", "b", "a"], ["r", "g", "b", "a"]),
        (["R", "G", "B", "maskA", "fogY"], ["R", "G", "B", None]),
        (["R", "G", "B", "crypto.A"], ["R", "G", "B", None]),
    ],
    ids=lambda value: "/".join(str(name) for name in value),
)
def test_exr_channels(exr, names, meaning):
    channels = exrfile.planes(names, 9, 8)
    found = pixels(exr(channels))
    assert np.array_equal(found, exrfile.layer(channels, meaning))


@pytest.mark.parametrize(
    ("origin", "display"),
    [
        ((0, 0), (0, 0, 23, 19)),
        ((5, 4), (0, 0, 40, 30)),
        ((-250, -250), (0, 0, 10, 10)),
        ((-5, 7), (0, 0, 10, 10)),
        ((100, 0), (0, 0, 10, 10)),
        ((-100, -90), (-20, -30, 50, 60)),
        ((-2147483, 5), (-2147490, 0, 100, 100)),
    ],
    ids=["equal", "smaller", "overscan", "partly", "beside", "negative", "far"],
)
@pytest.mark.parametrize("tile", [None, (8, 8)], ids=["scanline", "tiled"])
def test_exr_windows(exr, origin, display, tile):
    channels = exrfile.rgba()
    path = exr(channels, origin=origin, display=display, tile=tile)
    assert np.array_equal(pixels(path), exrfile.layer(channels))
    layer = hpcomp.read_layer(path)
    assert layer.data_window == Window(*origin, 23, 19)
    assert layer.display_window == Window(*display)


def test_exr_of_many_rows(exr):
    """More rows than any strip or compression block has."""
    channels = exrfile.planes("RGBA", 3, 3001)
    for options in (
        {},
        {"line_order": "decreasing"},
        {"tile": (64, 64)},
        # Rows that are read at a time seldom end where such a tile does.
        {"tile": (2, 37), "origin": (-1, -50)},
        {"tile": (3, 200)},
    ):
        assert np.array_equal(pixels(exr(channels, **options)), exrfile.layer(channels))


# ---- EXR: the alpha key ---------------------------------------------------------------------


def test_exr_alpha_straight(exr):
    channels = exrfile.rgba(dtype=np.float32)
    expected = exrfile.layer(channels)
    expected[..., :3] *= expected[..., 3:]
    path = exr(channels)
    assert_pixels(pixels(path, alpha="straight"), expected, FLOAT32 * 17)
    assert np.array_equal(pixels(path, alpha="premultiplied"), exrfile.layer(channels))


def test_exr_alpha_luminance(exr):
    channels = exrfile.planes("RGBA", 9, 8, np.float32)
    channels["A"] += np.float32(0.01)
    stored_layer = exrfile.layer(channels)
    straight = stored_layer[..., :3] / stored_layer[..., 3:]
    path = exr(channels)
    expected = by_luminance(straight, stored_layer[..., 3])
    assert_pixels(pixels(path, alpha="luminance"), expected, 8 * FLOAT32 * straight.max())


def test_exr_alpha_luminance_of_a_y_only_mask(exr):
    channels = {"Y": np.array([[0.0, 0.25, 1.0, 4.0]], np.float16)}
    with pytest.warns(HpcompWarning, match="1 pixel has a value outside 0 to 1, from 0 to 4, held"):
        found = pixels(exr(channels), alpha="luminance")[0]
    assert np.abs(found[:, 3] - [0, 0.25, 1, 1]).max() < FLOAT32


# ---- EXR: layers and parts ------------------------------------------------------------------

LAYERS = [
    *("diffuse." + c for c in "RGBA"),
    *("ViewLayer.Combined." + c for c in "RGBA"),
    *("matte." + c for c in "RGB"),
    "depth.Z",
    "fog.Y",
]


@pytest.mark.parametrize(
    ("layer", "meaning"),
    [
        ("diffuse", ["diffuse." + c for c in "RGBA"]),
        ("ViewLayer.Combined", ["ViewLayer.Combined." + c for c in "RGBA"]),
        ("matte", ["matte.R", "matte.G", "matte.B", None]),
        ("fog", ["fog.Y", "fog.Y", "fog.Y", None]),
    ],
)
@pytest.mark.parametrize("default", [False, True])
def test_exr_layer_by_name(exr, layer, meaning, default):
    channels = exrfile.planes([*LAYERS, *("RGBA" if default else "")], 9, 8)
    assert np.array_equal(pixels(exr(channels), layer=layer), exrfile.layer(channels, meaning))


def test_exr_with_one_layer_and_no_default_is_that_layer(exr):
    channels = exrfile.planes(["beauty.R", "beauty.G", "beauty.B", "beauty.A", "depth.Z"], 9, 8)
    expected = exrfile.layer(channels, ["beauty." + c for c in "RGBA"])
    assert np.array_equal(pixels(exr(channels)), expected)


def test_exr_with_several_layers_and_no_default_lists_them(exr):
    path = exr(exrfile.planes(LAYERS, 9, 8))
    message = refused(InputError, path, "diffuse", "ViewLayer.Combined", "matte", "fog", "layer=")
    assert "depth" not in message


@pytest.mark.parametrize("layer", ["specular", "Diffuse", "ViewLayer", "depth", ""])
def test_exr_unknown_layer_lists_what_there_is(exr, layer):
    path = exr(exrfile.planes(LAYERS, 9, 8))
    refused(InputError, path, "diffuse", "ViewLayer.Combined", "matte", layer=layer)


def test_png_has_no_layers_or_parts(rgba_png):
    refused(InputError, rgba_png[0], "diffuse", layer="diffuse")
    refused(InputError, rgba_png[0], "left", part="left")


@pytest.fixture
def parts(tmp_path):
    left, right = exrfile.rgba(seed=1), exrfile.rgba(seed=2)
    path = exrfile.write_parts(
        tmp_path / "parts.exr",
        [
            ("left", left, {"compression": "piz"}),
            ("depth", exrfile.planes("Z", 23, 19, np.float32), {}),
            ("right", right, {"tile": (8, 8), "origin": (3, -2), "display": (0, 0, 23, 19)}),
        ],
    )
    return path, left, right


@pytest.mark.parametrize("part", ["left", 0, "0"])
def test_exr_first_part(parts, part):
    path, left, _ = parts
    assert np.array_equal(pixels(path, part=part), exrfile.layer(left))


@pytest.mark.parametrize("part", ["right", 2, "2"])
def test_exr_other_part_has_its_own_window(parts, part):
    path, _, right = parts
    assert np.array_equal(pixels(path, part=part), exrfile.layer(right))
    layer = hpcomp.read_layer(path, part=part)
    assert layer.data_window == Window(3, -2, 23, 19)
    assert layer.display_window == Window(0, 0, 23, 19)


def test_two_parts_that_both_fit_are_listed(parts):
    refused(InputError, parts[0], "left", "right", "part=")


@pytest.mark.parametrize("part", ["middle", "Left", 3, -1, "3"])
def test_unknown_part_lists_what_there_is(parts, part):
    refused(InputError, parts[0], str(part), "left", "right", part=part)


def test_part_without_colour(parts):
    refused(InputError, parts[0], "colour", "Z", part="depth")


def test_the_one_part_with_colour_is_taken(tmp_path):
    beauty = exrfile.rgba()
    path = exrfile.write_parts(
        tmp_path / "a.exr",
        [
            ("depth", exrfile.planes("Z", 23, 19, np.float32), {}),
            ("beauty", beauty, {}),
            ("matte", exrfile.planes("A", 23, 19), {}),
        ],
    )
    assert np.array_equal(pixels(path), exrfile.layer(beauty))


def test_the_one_part_that_has_the_layer_is_taken(tmp_path):
    beauty = exrfile.rgba(seed=1)
    diffuse = exrfile.planes(["diffuse." + c for c in "RGBA"], 23, 19)
    path = exrfile.write_parts(
        tmp_path / "a.exr", [("beauty", beauty, {}), ("passes", diffuse, {})]
    )
    expected = exrfile.layer(diffuse, ["diffuse." + c for c in "RGBA"])
    assert np.array_equal(pixels(path, layer="diffuse"), expected)
    assert np.array_equal(pixels(path, part="beauty"), exrfile.layer(beauty))
    assert np.array_equal(pixels(path, part="passes"), expected)


def test_a_single_part_may_be_named(tmp_path):
    channels = exrfile.rgba()
    path = exrfile.write_parts(tmp_path / "a.exr", [("only", channels, {})])
    assert np.array_equal(pixels(path, part="only"), exrfile.layer(channels))
    assert np.array_equal(pixels(path), exrfile.layer(channels))
    refused(InputError, path, "only", part="other")


# ---- EXR: light -----------------------------------------------------------------------------


def matrix(name):
    xy = np.reshape(exrfile.PRIMARIES[name], (4, 2))
    return pngfile.to_rec709(xy[:3], xy[3])


@pytest.mark.parametrize("name", ["rec2020", "p3d65", "ap0", "ap1"])
@pytest.mark.parametrize("attribute", ["chromaticities", "colorInteropID", "both"])
def test_exr_primaries_are_converted(exr, name, attribute):
    """Premultiplied light, glow included, goes through the matrix; alpha does not."""
    channels = exrfile.rgba(dtype=np.float32)
    attributes = {
        "chromaticities": {"chromaticities": exrfile.PRIMARIES[name]},
        "colorInteropID": {"colorInteropID": f"lin_{name}_scene"},
        # The identifier says it by name; the numbers beside it say something else.
        "both": {
            "colorInteropID": f"lin_{name}_scene",
            "chromaticities": exrfile.PRIMARIES["rec709"],
        },
    }[attribute]
    expected = exrfile.layer(channels)
    expected[..., :3] = expected[..., :3] @ matrix(name).T
    largest = np.abs(expected).max()
    found = pixels(exr(channels, **attributes))
    assert_pixels(found, expected, largest * (MATRIX + STORED_XY))
    assert np.abs(exrfile.layer(channels) - expected).max() > 1e-3


def test_exr_colorspace_key_overrides_the_file(exr):
    channels = exrfile.planes("RGBA", 9, 8, np.float32)
    expected = exrfile.layer(channels)
    path = exr(
        channels,
        chromaticities=exrfile.PRIMARIES["rec2020"],
        colorInteropID="lin_rec2020_scene",
    )
    assert np.array_equal(pixels(path, colorspace="linear"), expected)
    acescg = expected.copy()
    acescg[..., :3] = acescg[..., :3] @ matrix("ap1").T
    assert_pixels(pixels(path, colorspace="acescg"), acescg, MATRIX)
    # The decoded value is already premultiplied, as the stored one was.
    encoded = expected.copy()
    encoded[..., :3] = pngfile.srgb_to_linear(encoded[..., :3])
    assert_pixels(pixels(path, colorspace="srgb"), encoded, FLOAT32)


def test_how_numpy_prints_is_left_as_it_was(exr):
    """The library that converts primaries changes it when it is imported."""
    code = (
        "import sys, numpy, hpcomp; before = numpy.get_printoptions(); "
        "hpcomp.read_layer(sys.argv[1]); "
        "assert 'colour' in sys.modules; assert numpy.get_printoptions() == before"
    )
    path = exr(exrfile.rgba(), chromaticities=(0.66, 0.31, 0.25, 0.64, 0.14, 0.05, 0.30, 0.32))
    subprocess.run([sys.executable, "-c", code, path], check=True, cwd=path.parent)


def test_exr_of_rec709_is_not_touched(exr):
    channels = exrfile.rgba(dtype=np.float32)
    for attributes in (
        {"chromaticities": exrfile.PRIMARIES["rec709"]},
        {"colorInteropID": "lin_rec709_scene"},
    ):
        assert np.array_equal(pixels(exr(channels, **attributes)), exrfile.layer(channels))


def test_exr_y_only_is_grey_under_any_primaries(exr):
    channels = exrfile.planes("YA", 9, 8, np.float32)
    found = pixels(exr(channels, chromaticities=exrfile.PRIMARIES["ap1"]))
    assert_pixels(found, exrfile.layer(channels, ["Y", "Y", "Y", "A"]), MATRIX)


@pytest.mark.parametrize(
    "attributes",
    [{"colorInteropID": "lin_ofmyown_scene"}, {"chromaticities": (0.3,) * 8}],
    ids=["unknown name", "no gamut"],
)
def test_exr_colour_that_cannot_be_honoured_is_a_warning(exr, attributes):
    channels = exrfile.rgba(dtype=np.float32)
    path = exr(channels, **attributes)
    word = attributes.get("colorInteropID", "chromaticities")
    with pytest.warns(HpcompWarning, match=word) as caught:
        found = pixels(path)
    assert len(caught) == 1
    assert "a.exr" in str(caught[0].message)
    assert np.array_equal(found, exrfile.layer(channels))


# ---- EXR: numbers that are none -------------------------------------------------------------


def with_bad_pixels():
    """Six bad values in five pixels; the first, in rows from the top, is (x, y) = (17, 3)."""
    channels = exrfile.rgba(dtype=np.float32)
    channels["B"][3, 17] = np.nan
    channels["R"][5, 2] = np.inf
    channels["G"][5, 2] = -np.inf
    channels["A"][11, 0] = np.nan
    channels["A"][12, 7] = np.inf
    channels["R"][18, 22] = np.nan
    return channels, [(3, 17), (5, 2), (11, 0), (12, 7), (18, 22)]


@pytest.mark.parametrize("options", [{}, {"nonfinite": "error"}])
@pytest.mark.parametrize("tile", [None, (8, 8)], ids=["scanline", "tiled"])
def test_nonfinite_pixels_are_refused(exr, options, tile):
    path = exr(with_bad_pixels()[0], tile=tile)
    message = refused(MismatchError, path, "zero", "keep", **options)
    assert re.search(r"\b17\b\D+\b3\b", message), message
    assert 5 in numbers(message, path), message


def test_nonfinite_pixel_is_named_in_the_coordinates_of_the_file(exr):
    path = exr(with_bad_pixels()[0], origin=(100, 200))
    message = refused(MismatchError, path)
    assert re.search(r"\b117\b\D+\b203\b", message), message


@pytest.mark.parametrize("dtype", [np.float16, np.float32], ids=["half", "float"])
def test_nonfinite_zero_makes_the_whole_pixel_transparent(exr, dtype):
    channels, bad = with_bad_pixels()
    channels = {name: plane.astype(dtype) for name, plane in channels.items()}
    expected = exrfile.layer(channels)
    for place in bad:
        expected[place] = 0
    path = exr(channels)
    with pytest.warns(HpcompWarning, match=r"a\.exr") as caught:
        found = pixels(path, nonfinite="zero")
    assert [numbers(one.message, path) for one in caught] == [[5]]
    assert np.array_equal(found, expected)


def test_nonfinite_keep(exr):
    channels = exrfile.rgba(dtype=np.float32)
    channels["B"][3, 17] = np.nan
    channels["R"][5, 2] = -np.inf
    found = pixels(exr(channels), nonfinite="keep")
    assert np.array_equal(found, exrfile.layer(channels), equal_nan=True)


def test_nonfinite_values_in_channels_that_are_not_read_do_not_matter(exr):
    channels = exrfile.planes("RGBAZ", 9, 8, np.float32)
    channels["Z"][:] = np.inf
    assert np.array_equal(pixels(exr(channels)), exrfile.layer(channels))


@pytest.mark.parametrize("alpha", ["luminance", "premultiplied-encoded", "straight"])
def test_nonfinite_values_do_not_hide_under_alpha_0(exr, alpha):
    channels = exrfile.planes("RGBA", 9, 8, np.float32)
    channels["A"][4, 5] = 0
    channels["G"][4, 5] = np.nan
    refused(MismatchError, exr(channels), alpha=alpha)


def test_unknown_nonfinite_policy_lists_what_there_is(exr):
    path = exr(exrfile.rgba())
    with pytest.raises(SettingError, match=r"(?=.*error)(?=.*zero)(?=.*keep)"):
        hpcomp.read_layer(path, nonfinite="ignore")


# ---- EXR: what is refused, and damage -------------------------------------------------------


def test_exr_vectors_are_no_colour(exr):
    """The Y of a normal, a position or a motion is no luminance."""
    vectors = ["Normal.X", "Normal.Y", "Normal.Z", "Motion.X", "Motion.Y"]
    beauty = ["beauty." + c for c in "RGBA"]
    channels = exrfile.planes([*vectors, *beauty], 9, 8, np.float32)
    assert np.array_equal(pixels(exr(channels)), exrfile.layer(channels, beauty).astype(np.float32))


@pytest.mark.parametrize(
    "names", ["A", "Z", "RG", "XYZ", ["depth.Z"], ["crypto.A"], ["N.X", "N.Y", "N.Z"]]
)
def test_exr_without_colour(exr, names):
    path = exr(exrfile.planes(names, 9, 8, np.float32))
    refused(InputError, path, "colour", *names)


def test_exr_with_subsampled_chroma(tmp_path):
    channels = {
        "Y": exrfile.planes("Y", 8, 6)["Y"],
        "RY": exrfile.planes(["RY"], 4, 3)["RY"],
        "BY": exrfile.planes(["BY"], 4, 3)["BY"],
    }
    steps = {"RY": (2, 2), "BY": (2, 2)}
    content = exrfile.raw_bytes(channels, (8, 6), sampling=steps, origin=(2, 4))
    path = put(tmp_path / "a.exr", content)
    refused(InputError, path, "its channels BY, RY are subsampled", "store it as RGB")
    refused(InputError, path, "subsampled", part="0", layer="")
    (part,) = hpcomp.info(path).parts
    assert [(c.name, c.type, c.sampling) for c in part.channels] == [
        ("BY", "half", (2, 2)), ("RY", "half", (2, 2)), ("Y", "half", (1, 1))
    ]  # fmt: skip
    assert part.data_window == part.display_window == Window(2, 4, 8, 6)
    assert (part.compression, part.tile, part.deep, part.groups) == ("none", None, False, ())
    # What is damaged besides is an error as before.
    put(path, content[:200])
    with pytest.raises(InputError):
        hpcomp.info(path)


def test_exr_of_full_size_chroma_is_not_taken_for_grey(exr):
    refused(InputError, exr(exrfile.planes(["Y", "RY", "BY"], 9, 8)), "RY")


def test_deep_exr(tmp_path):
    refused(InputError, exrfile.write_deep(tmp_path / "a.exr"), "deep")


def zip_exr(path, tile):
    data = exrfile.write(path, exrfile.coarse(), tile=tile).read_bytes()
    # A chunk that did not shrink would be stored without a checksum.
    assert all(zlib.decompress(data[slice(*span)]) for span in exrfile.regions(data)["pixels"])
    return data


@pytest.mark.parametrize("tile", [None, (16, 16)], ids=["scanline", "tiled"])
def test_flipped_bits_in_zip_pixels_are_noticed(tmp_path, tile):
    """ZIP carries a checksum of the pixels: what is read must be refused or be the same."""
    path = tmp_path / "damaged.exr"
    data = zip_exr(path, tile)
    expected = pixels(path)
    noticed = 0
    for first, last in exrfile.regions(data)["pixels"]:
        for place in range(first, last):
            outcome = attempt(put(path, pngfile.flip_bit(data, place, place % 8)))
            if isinstance(outcome, InputError):
                assert "damaged.exr" in str(outcome)
                noticed += 1
            else:
                assert np.array_equal(outcome, expected), f"byte {place}"
    # All but a few bits, which only pad the end of a deflate stream.
    assert noticed > 0.99 * sum(b - a for a, b in exrfile.regions(data)["pixels"])


@pytest.mark.parametrize("tile", [None, (16, 16)], ids=["scanline", "tiled"])
@pytest.mark.filterwarnings("ignore::hpcomp.HpcompWarning")
def test_flipped_bits_elsewhere_in_an_exr_are_an_error_or_a_layer(tmp_path, tile):
    """Nothing but pixels has a checksum: a changed header may be legal, but never a crash."""
    path = tmp_path / "damaged.exr"
    data = zip_exr(path, tile)
    parts = exrfile.regions(data)
    for first, last in parts["header"] + parts["table"] + parts["heads"]:
        for place in range(first, last):
            put(path, pngfile.flip_bit(data, place, place % 8))
            outcome = attempt(path, (InputError, MismatchError))
            if isinstance(outcome, Exception):
                assert "damaged.exr" in str(outcome)
                assert "\n" not in str(outcome)


@pytest.mark.parametrize("options", [{}, {"tile": (16, 16)}, {"compression": "none"}], ids=str)
def test_every_truncated_exr_is_noticed(tmp_path, options):
    path = tmp_path / "cut.exr"
    data = exrfile.write(path, exrfile.coarse(width=12, height=18), **options).read_bytes()
    assert pixels(path).shape == (18, 12, 4)
    for length in range(0, len(data), 3):
        refused(InputError, put(path, data[:length]))
    refused(InputError, put(path, data[:-1]))


def test_exr_that_claims_to_be_huge_is_refused_at_once(exr):
    """A few hundred bytes must not make hpcomp reserve a terabyte."""
    path = exr(exrfile.coarse())
    data = bytearray(path.read_bytes())
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        place = data.index(name) + len(name) + 4
        data[place : place + 16] = struct.pack("<4i", 0, 0, 299999, 299999)
    put(path, bytes(data))
    start = time.monotonic()
    refused(InputError, path)
    assert time.monotonic() - start < 5


# ---- info -----------------------------------------------------------------------------------


def test_info_of_a_png(tmp_path):
    png = pngfile.random_png(pngfile.GREY_ALPHA, 16, interlaced=True).with_chunks(
        head=[pngfile.gama(50000), pngfile.phys(3000, 2000)]
    )
    found = hpcomp.info(put(tmp_path / "a.png", png))
    assert (found.format, found.alpha_mode, len(found.parts)) == ("png", "straight", 1)
    (part,) = found.parts
    assert part.data_window == part.display_window == Window(0, 0, 13, 11)
    assert [channel.type for channel in part.channels] == ["uint16", "uint16"]
    assert part.groups[0].alpha is not None
    assert part.interlaced
    assert part.pixels_per_metre == (3000, 2000)
    # 3000 pixels to the metre across, 2000 down: a pixel is two thirds as wide as it is high.
    assert part.pixel_aspect == pytest.approx(2 / 3)
    assert part.encoding.primaries.name == "rec709"
    assert part.encoding.transfer.decode(np.float64(0.5)) == 0.25
    assert (part.color.transfer_from, part.color.primaries_from) == ("gAMA", "default")


def test_info_of_an_exr(tmp_path):
    options = {"origin": (-3, 4), "display": (0, 0, 9, 9), "pixel_aspect": 2.0}
    path = exrfile.write_parts(
        tmp_path / "a.exr",
        [
            (
                "beauty",
                exrfile.planes([*"RGBA", "fog.Y"], 23, 19),
                {"chromaticities": exrfile.PRIMARIES["ap1"], "xDensity": 72.0, **options},
            ),
            (
                "depth",
                exrfile.planes("Z", 8, 8, np.float32),
                {"tile": (4, 2), "compression": "piz", **options},
            ),
        ],
    )
    found = hpcomp.info(path)
    assert (found.format, found.alpha_mode) == ("exr", "premultiplied")
    beauty, depth = found.parts
    assert (beauty.index, beauty.name, depth.index, depth.name) == (0, "beauty", 1, "depth")
    assert [(c.name, c.type) for c in beauty.channels] == [(c, "half") for c in [*"RGBA", "fog.Y"]]
    assert [(c.name, c.type) for c in depth.channels] == [("Z", "float")]
    assert [group.layer for group in beauty.groups] == ["", "fog"]
    assert not depth.groups
    assert beauty.data_window == Window(-3, 4, 23, 19)
    assert beauty.display_window == Window(0, 0, 9, 9)
    assert (beauty.tile, depth.tile) == (None, (4, 2))
    assert (beauty.compression, depth.compression) == ("zip", "piz")
    assert beauty.pixel_aspect == 2.0
    assert beauty.pixels_per_metre == pytest.approx((72 / 0.0254, 2 * 72 / 0.0254))
    assert beauty.encoding.primaries.name == "acescg"
    color = beauty.color
    assert (color.transfer_from, color.primaries_from) == ("default", "chromaticities")
    assert depth.encoding.primaries.name == "rec709"


def test_info_names_what_is_not_honoured(tmp_path):
    profile = pngfile.icc_profile("Wide by test", more=TABLES)
    path = put(tmp_path / "a.png", with_head(pngfile.iccp(profile)))
    assert any("Wide by test" in problem for problem in hpcomp.info(path).parts[0].problems)


def test_info_of_a_deep_exr(tmp_path):
    assert hpcomp.info(exrfile.write_deep(tmp_path / "a.exr")).parts[0].deep


def test_info_of_damaged_files(tmp_path):
    png = small_png().encode()
    broken = put(tmp_path / "a.png", pngfile.break_crc(png, b"IDAT"))
    for path in (broken, tmp_path / "nowhere.exr", tmp_path, put(tmp_path / "b.png", png[:-5])):
        with pytest.raises(InputError, match=path.name):
            hpcomp.info(path)


# ---- what is no layer at all ----------------------------------------------------------------


def other_images(folder):
    """(ending, bytes) of whole images in formats that hpcomp does not read."""
    for ending in ("jpg", "tif", "bmp", "hdr", "dpx", "tga"):
        path = str(folder / f"other.{ending}")
        spec = oiio.ImageSpec(4, 3, 3, oiio.UINT8)
        out = oiio.ImageOutput.create(path)
        assert out.open(path, spec)
        assert out.write_image(np.zeros((3, 4, 3), np.uint8))
        assert out.close()
        with open(path, "rb") as file:
            yield ending, file.read()


KINDS = {
    "jpg": "a JPEG file", "tif": "a TIFF file", "bmp": "a BMP file",
    "hdr": "a Radiance HDR file", "dpx": "a DPX file", "tga": "neither a PNG nor an EXR file",
}  # fmt: skip


@pytest.mark.parametrize("ending", [".png", ".exr"])
def test_other_formats_are_refused_whatever_their_name(tmp_path, ending):
    for kind, content in other_images(tmp_path):
        assert len(content) > 20
        words = f"is {KINDS[kind]}: convert it"
        refused(InputError, put(tmp_path / f"{kind}{ending}", content), words)
        refused(InputError, put(tmp_path / f"picture.{kind}", content), words)


@pytest.mark.parametrize("name", ["{0}.{0}", "it's a {0}.png", "-{0}.exr", "{0}"])
def test_the_command_that_converts_does(tmp_path, monkeypatch, name):
    """As typed, whatever the file is called; no file is replaced by its own conversion."""
    monkeypatch.chdir(tmp_path)
    scripts = sysconfig.get_path("scripts")
    monkeypatch.setenv("PATH", os.pathsep.join([scripts, os.environ["PATH"]]))
    for kind, content in other_images(tmp_path):
        path = put(pathlib.Path(name.format(kind)), content)
        with pytest.raises(InputError) as caught:
            hpcomp.info(path)
        _, with_it, line = str(caught.value).partition("such as with: ")
        if not with_it:
            assert kind == "tga"
            continue
        subprocess.run(line, shell=True, check=True, timeout=60)
        assert path.read_bytes() == content
        converted = pathlib.Path(shlex.split(line)[-1])
        assert hpcomp.info(converted).parts[0].data_window == Window(0, 0, 4, 3)
        assert converted.suffix == {"hdr": ".exr"}.get(kind, ".png")
        converted.unlink()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"RIFF\x24\0\0\0WEBPVP8 ", "is a WebP file: convert it, such as with: oiiotool --no-autopremult "),
        (b"GIF89a\x10\0\x10\0", "is a GIF file: convert it, such as with: oiiotool --no-autopremult "),
        (b"%PDF-1.7\n", "is a PDF file: convert it, such as with: pdftocairo "),
        (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "is an SVG file: convert it"),
        (b"\xef\xbb\xbf<?xml version='1.0'?>\n<!-- a --><svg/>", "is an SVG file: convert it"),
        (b"<!DOCTYPE html>\n<html><h1>404</h1></html>", "is a web page: look into it"),
        (b"\0\0\0\x1cftypavif\0\0", "is an AVIF file"),
        (b"\0\0\0\x18ftypheic\0\0", "is a HEIF file"),
        (b"\0\0\0\x0cJXL \r\n\x87\n", "is a JPEG XL file"),
        (b"\0\0\0\x0cjP  \r\n\x87\n", "is a JPEG 2000 file"),
        (b"8BPS\0\1", "is a Photoshop file"),
        (b"version https://git-lfs.github.com/spec/v1\n", "is a Git LFS pointer: git lfs pull"),
        (b"<xml>no picture</xml>", "is neither a PNG nor an EXR file"),
    ],
    ids=lambda value: value.split(b"\n")[0].decode("latin-1") if isinstance(value, bytes) else "",
)
def test_what_is_no_layer_is_called_what_it_is(tmp_path, content, words):
    refused(InputError, put(tmp_path / "a.png", content), words)


def test_png_and_exr_are_told_by_their_content_and_not_by_their_name(tmp_path):
    """By those that are read here, and by those that OpenImageIO reads."""
    for colour in (pngfile.RGBA, pngfile.PALETTE):
        png = pngfile.random_png(colour, 8)
        path = put(tmp_path / "a.exr", png)
        assert_pixels(pixels(path), png.linear())
        assert hpcomp.info(path).format == "png"
    channels = exrfile.rgba(8, 6)
    for compression in ("zip", "piz"):
        path = exrfile.write(tmp_path / "b.exr", channels, compression=compression)
        assert_pixels(pixels(path.rename(tmp_path / "b.png")), exrfile.layer(channels))
        assert hpcomp.info(tmp_path / "b.png").format == "exr"


@pytest.mark.parametrize("name", ["a.png", "a.exr", "a.txt", "a"])
@pytest.mark.parametrize(
    "content",
    [b"", b"\0", b"hello, world\n" * 40, bytes(1000), pngfile.SIGNATURE, b"\x76\x2f\x31\x01"],
    ids=["empty", "one byte", "text", "zeros", "PNG signature", "EXR signature"],
)
def test_files_that_are_no_image(tmp_path, name, content):
    refused(InputError, put(tmp_path / name, content))


def test_empty_file_is_called_empty(tmp_path):
    refused(InputError, put(tmp_path / "a.png", b""), "empty")


@pytest.mark.parametrize("name", ["nowhere.png", "nowhere.exr", "no/where.exr", "nowhere"])
def test_missing_file(tmp_path, name):
    refused(InputError, tmp_path / name, "no such file")


@pytest.mark.parametrize("name", ["folder.png", "folder.exr", "folder"])
def test_directory(tmp_path, name):
    (tmp_path / name).mkdir()
    refused(InputError, tmp_path / name, "directory")


def test_paths_are_any_paths(tmp_path, monkeypatch, rgba_png):
    path = put(tmp_path / "ünïcödé näme %d.png", rgba_png[1])
    monkeypatch.chdir(tmp_path)
    for name in (path, str(path), path.name, f"./{path.name}"):
        assert_pixels(pixels(name), rgba_png[1].linear())


# ---- writing: PNG ---------------------------------------------------------------------------


def stored(path):
    """(h, w, 4) code values of a PNG, straight; read by OpenImageIO, checked to be sound."""
    kinds = [kind for kind, _ in pngfile.split(path.read_bytes())]
    assert kinds[0] == b"IHDR"
    assert kinds[-1] == b"IEND"
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)
    image = oiio.ImageInput.open(str(path), hint)
    spec = image.spec()
    codes = image.read_image(0, 0, 0, spec.nchannels, oiio.UNKNOWN)
    image.close()
    height, width, count = codes.shape
    out = np.full((height, width, 4), np.iinfo(codes.dtype).max, int)
    out[..., : min(count, 3) if count > 2 else 3] = codes[..., : 3 if count > 2 else 1]
    if count in (2, 4):
        out[..., 3] = codes[..., -1]
    return out


def opaque(rgb):
    rgb = np.asarray(rgb, np.float32)
    return np.concatenate([rgb, np.ones_like(rgb[..., :1])], axis=-1)


def codes_of(rgba, depth):
    """Code values from premultiplied float32, reckoned in float64; for colours in the gamut."""
    top = 2**depth - 1
    rgba = rgba.astype(float)
    alpha = rgba[..., 3:]
    straight = np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0)
    encoded = np.concatenate([pngfile.linear_to_srgb(np.clip(straight, 0, 1)), alpha], axis=-1)
    return np.floor(encoded * top + 0.5).astype(int)


def test_linear_half_is_188(tmp_path):
    hpcomp.write_image(tmp_path / "a.png", opaque(np.full((2, 3, 3), 0.5)))
    assert (stored(tmp_path / "a.png") == [188, 188, 188, 255]).all()


@pytest.mark.parametrize("depth", [None, 8, 16, "8", "16"])
def test_png_rounding_is_exact(tmp_path, depth):
    """A dense sweep, and every code's own value and the rounding points around it."""
    bits = int(depth or 8)
    codes = np.arange(2**bits) / (2**bits - 1)
    borders = (np.arange(2**bits - 1) + 0.5) / (2**bits - 1)
    light = pngfile.srgb_to_linear(np.concatenate([codes, borders * (1 + 1e-4), borders * 0.9999]))
    sweep = np.concatenate([light, np.linspace(0, 1, 100001)])
    sweep = np.clip(sweep[: len(sweep) // 3 * 3], 0, 1).astype(np.float32)
    rgba = opaque(sweep.reshape(1, -1, 3))
    path = tmp_path / "a.png"
    hpcomp.write_image(path, rgba, depth=depth)
    assert np.array_equal(stored(path), codes_of(rgba, bits))
    (header_data,) = [data for kind, data in pngfile.split(path.read_bytes()) if kind == b"IHDR"]
    assert header_data[8] == bits


@pytest.mark.parametrize("depth", [8, 16])
def test_png_is_written_straight(tmp_path, depth):
    rng = np.random.default_rng(4)
    alpha = rng.random((50, 40, 1))
    alpha[0, :3] = [[0], [1], [0.5]]
    rgba = np.concatenate([rng.random((50, 40, 3)) * alpha * 0.999, alpha], -1).astype(np.float32)
    path = tmp_path / "a.png"
    hpcomp.write_image(path, rgba, depth=depth)
    found, expected = stored(path), codes_of(rgba, depth)
    seen = expected[..., 3] > 0
    assert np.array_equal(found[seen], expected[seen])
    assert (found[~seen] == 0).all()


@pytest.mark.parametrize("depth", [8, 16])
def test_png_survives_a_round_trip(tmp_path, depth):
    """Read, written, read: the same codes, for every colour that can be seen."""
    png = pngfile.random_png(pngfile.RGBA, depth, width=60, height=50)
    source = put(tmp_path / "a.png", png)
    hpcomp.write_image(tmp_path / "b.png", pixels(source), depth=depth)
    seen = png.samples[..., 3] > 0
    assert np.array_equal(stored(tmp_path / "b.png")[seen], png.samples[seen])


def test_png_is_tagged_srgb_and_carries_nothing_else(tmp_path):
    hpcomp.write_image(tmp_path / "a.png", opaque(np.full((2, 3, 3), 0.5)))
    chunks = dict(pngfile.split((tmp_path / "a.png").read_bytes()))
    assert b"sRGB" in chunks
    # No clock, host, path or command line: no text, no time, and no entry in the Exif data.
    colour = {b"sRGB", b"gAMA", b"cHRM", b"cICP"}
    assert set(chunks) <= {b"IHDR", b"pHYs", b"oFFs", b"eXIf", b"IDAT", b"IEND"} | colour
    assert chunks.get(b"eXIf", b"")[8:].count(0) == len(chunks.get(b"eXIf", b"")[8:])


def mapped(straight):
    """(…, 3) straight linear colour, moved to grey at constant Y until it is in the gamut."""
    out = np.empty_like(straight)
    for place in np.ndindex(straight.shape[:-1]):
        colour = straight[place]
        grey = min(max(float(WEIGHTS @ colour), 0.0), 1.0)
        scale = 1.0
        for value in colour - grey:
            if value > 0:
                scale = min(scale, (1 - grey) / value)
            elif value < 0:
                scale = min(scale, grey / -value)
        out[place] = grey + scale * (colour - grey)
    return out


@pytest.mark.parametrize("depth", [8, 16])
def test_out_of_gamut_colours_keep_luminance_and_hue(tmp_path, depth):
    rng = np.random.default_rng(3)
    straight = rng.uniform(-0.5, 1.6, (30, 40, 3))
    alpha = rng.uniform(0.2, 1, (30, 40, 1))
    rgba = np.concatenate([straight * alpha, alpha], -1).astype(np.float32)
    straight = rgba[..., :3].astype(float) / rgba[..., 3:]
    outside = ((straight < -1e-3) | (straight > 1 + 1e-2)).any(axis=-1)
    inside = ((straight >= 0) & (straight <= 1)).all(axis=-1)
    path = tmp_path / "hdr.png"
    with pytest.warns(HpcompWarning, match=r"hdr\.png") as caught:
        hpcomp.write_image(path, rgba, depth=depth)
    assert len(caught) == 1
    counted = numbers(caught[0].message, path)[0]
    # Between the two lies the half code value that is not worth a warning.
    assert outside.sum() <= counted <= (~inside).sum()
    expected = codes_of(np.concatenate([mapped(straight), np.ones_like(alpha)], -1), depth)
    found = stored(path)
    assert np.abs(found - expected)[..., :3].max() <= BORDER_CODES
    assert (found == expected)[..., :3].mean() > 0.999


def test_brighter_than_white_is_white_and_darker_than_black_is_black(tmp_path):
    rgba = opaque([[[3, 2, 1.5], [0.5, 1.3, 0.9], [-0.5, -0.01, 0.1], [9, 0, 0], [0.5] * 3]])
    with pytest.warns(HpcompWarning) as caught:
        hpcomp.write_image(tmp_path / "a.png", rgba)
    assert 4 in numbers(caught[0].message, tmp_path / "a.png")
    found = stored(tmp_path / "a.png")[0, :, :3]
    assert found[0].tolist() == found[1].tolist() == found[3].tolist() == [255] * 3
    assert found[2].tolist() == [0] * 3
    assert found[4].tolist() == [188] * 3


def test_rounding_noise_beyond_the_gamut_is_not_worth_a_warning(tmp_path):
    rgba = opaque([[[1.0000002, 1, 1], [-1e-8, 0.5, 1], [1.001, 0, 0]]])
    hpcomp.write_image(tmp_path / "a.png", rgba)
    assert stored(tmp_path / "a.png")[0, :, :3].tolist() == [[255] * 3, [0, 188, 255], [255, 0, 0]]


def test_light_without_alpha_is_counted(tmp_path):
    rgba = np.zeros((4, 5, 4), np.float32)
    rgba[1, 1, 0] = rgba[2, 3, 2] = rgba[3, 4, 1] = 0.5
    with pytest.warns(HpcompWarning, match="alpha") as caught:
        hpcomp.write_image(tmp_path / "glow.png", rgba)
    assert [numbers(one.message, tmp_path / "glow.png") for one in caught] == [[3]]
    assert (stored(tmp_path / "glow.png") == 0).all()


def test_what_is_no_number_cannot_be_a_code_and_is_counted(tmp_path):
    rgba = opaque(np.full((2, 3, 3), 0.5))
    rgba[0, 1, 0] = rgba[1, 2, 3] = np.nan
    path = tmp_path / "a.png"
    with pytest.warns(HpcompWarning, match="NaN") as caught:
        hpcomp.write_image(path, rgba)
    assert [numbers(one.message, path) for one in caught] == [[2]]
    found = stored(path)
    assert found[0, 1].tolist() == found[1, 2].tolist() == [0] * 4
    assert (found[[0, 0, 1, 1], [0, 2, 0, 1]] == [188, 188, 188, 255]).all()


def test_infinite_light_is_white(tmp_path):
    with pytest.warns(HpcompWarning, match=r"a\.png"):
        hpcomp.write_image(tmp_path / "a.png", opaque([[[np.inf] * 3, [np.inf, 0, 0]]]))
    assert stored(tmp_path / "a.png").tolist() == [[[255] * 4] * 2]


@pytest.mark.parametrize("what", ["gamut", "glow"])
def test_strict_makes_them_errors_and_writes_nothing(tmp_path, what):
    rgba = opaque(np.full((2, 2, 3), 0.5))
    rgba[0, 0] = (3, 0, 0, 1) if what == "gamut" else (0.5, 0, 0, 0)
    path = put(tmp_path / "a.png", b"what stood here")
    with pytest.raises(MismatchError, match=r"a\.png"):
        hpcomp.write_image(path, rgba, strict=True)
    assert path.read_bytes() == b"what stood here"
    assert os.listdir(tmp_path) == ["a.png"]


@pytest.mark.parametrize("compression", ["fast", "small", 0, 1, 9, "0", "5"])
def test_png_compression_changes_bytes_alone(tmp_path, compression):
    rgba = pixels(put(tmp_path / "a.png", pngfile.random_png(pngfile.RGBA, 8)))
    hpcomp.write_image(tmp_path / "b.png", rgba, compression=compression)
    hpcomp.write_image(tmp_path / "c.png", rgba)
    assert np.array_equal(stored(tmp_path / "b.png"), stored(tmp_path / "c.png"))


def test_png_compression_does_something(tmp_path):
    light = np.broadcast_to(np.linspace(0, 1, 200)[:, None, None], (200, 200, 3))
    sizes = {}
    for compression in ("fast", "small", 0):
        hpcomp.write_image(tmp_path / "a.png", opaque(light), compression=compression)
        sizes[compression] = (tmp_path / "a.png").stat().st_size
    assert sizes["small"] <= sizes["fast"] < sizes[0]


# ---- writing: EXR ---------------------------------------------------------------------------


def hdr(dtype=np.float32):
    return exrfile.layer(exrfile.rgba(dtype=dtype)).astype(np.float32)


def assert_stored(path, rgba, kind):
    channels = exrfile.read_back(path)
    assert {name: plane.dtype for name, plane in channels.items()} == dict.fromkeys("RGBA", kind)
    assert np.array_equal(np.stack([channels[c] for c in "RGBA"], -1), rgba.astype(kind))


def test_exr_is_half_unless_told(tmp_path):
    path = tmp_path / "a.exr"
    hpcomp.write_image(path, hdr())
    assert_stored(path, hdr(), np.float16)
    header_found = OpenEXR.File(str(path), header_only=True).header()
    assert header_found["compression"] == OpenEXR.ZIP_COMPRESSION


@pytest.mark.parametrize(("depth", "kind"), [("half", np.float16), ("float", np.float32)])
def test_exr_depth(tmp_path, depth, kind):
    hpcomp.write_image(tmp_path / "a.exr", hdr(), depth=depth)
    assert_stored(tmp_path / "a.exr", hdr(), kind)


@pytest.mark.parametrize("depth", ["half", "float"])
@pytest.mark.parametrize("compression", ["none", "rle", "zips", "zip", "piz"])
def test_exr_compression_without_loss(tmp_path, compression, depth):
    path = tmp_path / "a.exr"
    rgba = exrfile.layer(exrfile.planes("RGBA", 40, 70, np.float32)).astype(np.float32)
    hpcomp.write_image(path, rgba, depth=depth, compression=compression)
    assert_stored(path, rgba, np.float16 if depth == "half" else np.float32)
    found = OpenEXR.File(str(path), header_only=True).header()["compression"]
    assert found == exrfile.COMPRESSIONS[compression]


@pytest.mark.parametrize("compression", ["pxr24", "b44", "b44a", "dwaa", "dwab"])
def test_exr_compression_with_loss(tmp_path, compression):
    path = tmp_path / "a.exr"
    rgba = exrfile.layer(exrfile.planes("RGBA", 40, 70)).astype(np.float32)
    hpcomp.write_image(path, rgba, compression=compression)
    found = OpenEXR.File(str(path), header_only=True).header()["compression"]
    assert found == exrfile.COMPRESSIONS[compression]
    # The bound that test_fixtures holds the codecs to.
    assert np.abs(pixels(path) - rgba).max() < 0.13


def test_exr_windows_are_kept(tmp_path):
    path = tmp_path / "a.exr"
    data, display = Window(-5, 7, 23, 19), Window(-20, -30, 50, 60)
    hpcomp.write_image(path, hdr(), data_window=data, display_window=display, depth="float")
    layer = hpcomp.read_layer(path)
    assert (layer.data_window, layer.display_window) == (data, display)
    assert np.array_equal(layer.pixels, hdr())


def test_exr_is_tagged_with_its_primaries_and_carries_no_clock(tmp_path):
    path = tmp_path / "a.exr"
    hpcomp.write_image(path, hdr())
    found = OpenEXR.File(str(path), header_only=True).header()
    assert np.array_equal(
        np.float32(found["chromaticities"]), np.float32(exrfile.PRIMARIES["rec709"])
    )
    expected = {"channels", "chromaticities", "compression", "dataWindow", "displayWindow"}
    expected |= {"lineOrder", "pixelAspectRatio", "screenWindowCenter", "screenWindowWidth", "type"}
    assert set(found) <= expected | {"colorInteropID", "name"}


def test_exr_is_read_back_as_it_was(tmp_path):
    hpcomp.write_image(tmp_path / "a.exr", hdr(), depth="float")
    assert np.array_equal(pixels(tmp_path / "a.exr"), hdr())


def test_half_overflow_becomes_darker_and_is_counted(tmp_path):
    rgba = opaque(np.full((3, 4, 3), 0.5))
    rgba[0, 0, :2] = 1e5, -1e9
    rgba[2, 3, 2] = 65519.9
    rgba[1, 1, 0] = 65504
    path = tmp_path / "hot.exr"
    with pytest.warns(HpcompWarning, match=r"hot\.exr") as caught:
        hpcomp.write_image(path, rgba)
    assert len(caught) == 1
    assert 2 in numbers(caught[0].message, path)
    darker = rgba.copy()
    darker[0, 0, :3] *= 65504 / 1e9  # as a whole, so that its hue stays
    darker[2, 3, :3] *= 65504 / 65519.9
    assert np.array_equal(pixels(path), darker.astype(np.float16))
    with pytest.raises(MismatchError):
        hpcomp.write_image(path, rgba, strict=True)
    hpcomp.write_image(path, rgba, depth="float", strict=True)
    assert np.array_equal(pixels(path), rgba)


# ---- writing: both --------------------------------------------------------------------------

ENDINGS = ["png", "exr"]


def test_same_pixels_same_bytes(tmp_path):
    rgba = opaque(np.random.default_rng(1).random((70, 40, 3)))
    endings = [*ENDINGS, "PNG", "EXR"]
    for ending in endings:
        hpcomp.write_image(tmp_path / f"a.{ending}", rgba)
    # Longer than a clock in whole seconds needs to show itself.
    time.sleep(1.1)
    for ending in endings:
        hpcomp.write_image(str(tmp_path / f"another name.{ending}"), rgba)
        first, second = (tmp_path / f"{name}.{ending}" for name in ("a", "another name"))
        assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("ending", ENDINGS)
def test_any_array_of_pixels_is_written(tmp_path, ending):
    """Layout in memory and number type do not matter."""
    rgba = opaque(np.random.default_rng(1).random((7, 9, 3)))
    path = tmp_path / f"a.{ending}"
    hpcomp.write_image(path, rgba)
    data = path.read_bytes()
    before = rgba.copy()
    for same in (rgba.astype(float), np.asfortranarray(rgba), rgba[:, ::-1][:, ::-1]):
        hpcomp.write_image(path, same)
        assert path.read_bytes() == data
    assert np.array_equal(rgba, before)


@pytest.mark.parametrize("ending", ENDINGS)
def test_output_is_replaced_as_a_whole(tmp_path, ending):
    """A second name of the old file still holds the old bytes: nothing was written into it."""
    path, other = tmp_path / f"a.{ending}", tmp_path / "other"
    put(path, b"what stood here")
    os.link(path, other)
    hpcomp.write_image(path, opaque(np.zeros((2, 2, 3))))
    assert other.read_bytes() == b"what stood here"
    assert pixels(path).shape == (2, 2, 4)
    assert sorted(os.listdir(tmp_path)) == sorted([path.name, "other"])


@pytest.mark.parametrize("name", ["a.jpg", "a", "a.png.txt", ".png", "a.tif"])
def test_unknown_ending(tmp_path, name):
    with pytest.raises(SettingError, match=r"(?=.*\.png)(?=.*\.exr)"):
        hpcomp.write_image(tmp_path / name, opaque(np.zeros((2, 2, 3))))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("ending", ENDINGS)
def test_missing_directory(tmp_path, ending):
    with pytest.raises(OutputError, match="nowhere"):
        hpcomp.write_image(tmp_path / "nowhere" / f"a.{ending}", opaque(np.zeros((2, 2, 3))))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("ending", ENDINGS)
def test_output_that_is_a_directory(tmp_path, ending):
    (tmp_path / f"a.{ending}").mkdir()
    with pytest.raises(OutputError, match=f"a.{ending}.*directory"):
        hpcomp.write_image(tmp_path / f"a.{ending}", opaque(np.zeros((2, 2, 3))))
    assert os.listdir(tmp_path) == [f"a.{ending}"]


@pytest.mark.parametrize(
    ("ending", "options", "words"),
    [
        ("png", {"depth": "half"}, ["8", "16"]),
        ("png", {"depth": 12}, ["8", "16"]),
        ("exr", {"depth": 8}, ["half", "float"]),
        ("exr", {"depth": "double"}, ["half", "float"]),
        ("exr", {"compression": "lzw"}, ["none", "zip", "piz", "dwaa"]),
        ("exr", {"compression": "fast"}, ["none", "zip", "piz", "dwaa"]),
        ("png", {"compression": "zip"}, ["fast", "small", "9"]),
        ("png", {"compression": 10}, ["fast", "small", "9"]),
    ],
    ids=str,
)
def test_unknown_settings_list_what_there_is(tmp_path, ending, options, words):
    with pytest.raises(SettingError) as caught:
        hpcomp.write_image(tmp_path / f"a.{ending}", opaque(np.zeros((2, 2, 3))), **options)
    for word in words:
        assert word in str(caught.value)
    assert os.listdir(tmp_path) == []
