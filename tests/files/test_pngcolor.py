"""The colour of PNG: which chunk is believed, and what each of them means. PNG third edition."""

from __future__ import annotations

import itertools
import json
import re
import warnings
import zlib

import command
import numpy as np
import pngfile
import pytest

import hpcomp
from hpcomp import HpcompWarning, InputError

# The fixed-point numbers of a profile (16 bits of fraction) and of cHRM (5 digits), repeated by the
# condition of the primaries.
STORED = 2e-4
FLOAT32 = 2e-6
REC2020_XY = ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046))
PROPHOTO_XY = ((0.7347, 0.2653), (0.1596, 0.8404), (0.0366, 0.0001))
D50_XY = (0.3457, 0.3585)
ODD_XY = ((0.66, 0.31), (0.25, 0.64), (0.14, 0.05))
ODD_WHITE = (0.30, 0.32)


def camera(v):
    """Rec. ITU-R BT.709-6, item 1.2, inverted; BT.2020-2 has the same curve."""
    return np.where(v < 0.081, v / 4.5, (np.maximum(v + 0.099, 0) / 1.099) ** (1 / 0.45))


def written(tmp_path, *chunks, colour=pngfile.RGBA, depth=8):
    png = pngfile.random_png(colour, depth).with_chunks(head=chunks)
    path = tmp_path / "a.png"
    path.write_bytes(png.encode())
    return path, png


def meant(png, curve, primaries=pngfile.SRGB_XY, white=pngfile.D65_XY):
    """What the file means in linear Rec. 709."""
    rgba = png.linear(curve)
    rgba[..., :3] = rgba[..., :3] @ pngfile.to_rec709(primaries, white).T
    return rgba


def read(path, **options):
    """Its pixels, read without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return hpcomp.read_layer(path, **options).pixels


def assert_read(path, expected, tolerance=STORED):
    error = np.abs(read(path) - expected).max()
    assert error <= tolerance, error


# ---- precedence -----------------------------------------------------------------------------

# Each says something else, so that it shows which one is believed: the curve and the primaries.
SAYING = {
    "cICP": ([pngfile.cicp(9, 13)], pngfile.srgb_to_linear, REC2020_XY),
    "iCCP": (
        [pngfile.iccp(pngfile.icc_profile("p", pngfile.P3_XY, 1.8))],
        pngfile.power(round(1.8 * 256) / 256),
        pngfile.P3_XY,
    ),
    "sRGB chunk": ([pngfile.srgb()], pngfile.srgb_to_linear, pngfile.SRGB_XY),
    "gAMA and cHRM": (
        [pngfile.gama(40000), pngfile.chrm(pngfile.D65_XY, *pngfile.ADOBE_XY)],
        pngfile.power(2.5),
        pngfile.ADOBE_XY,
    ),
}
# mDCV and cLLI tell of a display and of the brightest pixels, not of what a sample means.
HDR_METADATA = [(b"mDCV", bytes(24)), (b"cLLI", bytes(8))]


@pytest.mark.parametrize("n", range(1, len(SAYING) + 1))
def test_the_highest_chunk_that_is_there_is_believed(tmp_path, n):
    """In whatever order they stand in the file: PNG third edition, 4.3, table of precedence."""
    for there in itertools.combinations(SAYING, n):
        _, curve, primaries = SAYING[there[0]]
        for order in (there, there[::-1]):
            chunks = [chunk for name in order for chunk in SAYING[name][0]]
            path, png = written(tmp_path, *chunks, *HDR_METADATA)
            assert_read(path, meant(png, curve, primaries))
            color = hpcomp.info(path).parts[0].color
            sources = there[0].split(" and ")
            assert [color.transfer_from, color.primaries_from] == [sources[0], sources[-1]]


def test_metadata_of_hdr_alone_change_nothing(tmp_path):
    path, png = written(tmp_path, *HDR_METADATA)
    assert_read(path, png.linear(), FLOAT32)
    color = hpcomp.info(path).parts[0].color
    assert (color.transfer_from, color.primaries_from) == ("default", "default")


@pytest.mark.parametrize(
    ("chunks", "transfer_from", "primaries_from"),
    [
        ([pngfile.gama(40000)], "gAMA", "default"),
        ([pngfile.chrm(pngfile.D65_XY, *pngfile.ADOBE_XY)], "default", "cHRM"),
        ([pngfile.gama(0), pngfile.chrm(pngfile.D65_XY, *pngfile.ADOBE_XY)], "default", "cHRM"),
        ([pngfile.gama(40000), (b"cHRM", bytes(31))], "gAMA", "default"),
    ],
    ids=["gAMA", "cHRM", "cHRM and a gAMA of 0", "gAMA and a cut cHRM"],
)
def test_curve_and_primaries_are_taken_from_a_chunk_each(
    tmp_path, chunks, transfer_from, primaries_from
):
    """PNG third edition, 4.3; and what one of them cannot say changes nothing for the other."""
    path, png = written(tmp_path, *chunks)
    part = hpcomp.info(path).parts[0]
    assert (part.color.transfer_from, part.color.primaries_from) == (transfer_from, primaries_from)
    curve = pngfile.power(2.5) if transfer_from == "gAMA" else pngfile.srgb_to_linear
    primaries = pngfile.ADOBE_XY if primaries_from == "cHRM" else pngfile.SRGB_XY
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        error = np.abs(hpcomp.read_layer(path).pixels - meant(png, curve, primaries)).max()
    assert error <= STORED
    one_is_damaged = len(chunks) == 2
    assert len(part.problems) == one_is_damaged


@pytest.mark.parametrize(
    "chunk",
    [
        pngfile.cicp(22, 13),
        pngfile.cicp(1, 2),
        pngfile.cicp(1, 13, 5),
        pngfile.iccp(pngfile.icc_profile("tables", more=[(b"A2B0", b"mft2" + bytes(44))])),
    ],
    ids=["primaries", "curve", "matrix", "tables"],
)
def test_what_is_not_honoured_gives_way_to_the_next(tmp_path, chunk):
    path, png = written(tmp_path, chunk, *SAYING["gAMA and cHRM"][0])
    with pytest.warns(HpcompWarning, match="not honoured"):
        found = hpcomp.read_layer(path).pixels
    assert np.abs(found - meant(png, pngfile.power(2.5), pngfile.ADOBE_XY)).max() <= STORED


# ---- cICP -----------------------------------------------------------------------------------

CICP = {
    (1, 13): (pngfile.srgb_to_linear, pngfile.SRGB_XY, "sRGB", "rec709"),
    (1, 1): (camera, pngfile.SRGB_XY, "BT.709", "rec709"),
    (1, 8): (pngfile.power(1), pngfile.SRGB_XY, "linear", "rec709"),
    (12, 13): (pngfile.srgb_to_linear, pngfile.P3_XY, "sRGB", "display-p3"),
    (9, 1): (camera, REC2020_XY, "BT.709", "rec2020"),
    (9, 6): (camera, REC2020_XY, "BT.709", "rec2020"),
    (9, 14): (camera, REC2020_XY, "BT.709", "rec2020"),
    (9, 15): (camera, REC2020_XY, "BT.709", "rec2020"),
    (9, 13): (pngfile.srgb_to_linear, REC2020_XY, "sRGB", "rec2020"),
    (9, 8): (pngfile.power(1), REC2020_XY, "linear", "rec2020"),
}


@pytest.mark.parametrize("codes", CICP, ids=lambda codes: f"{codes[0]}-{codes[1]}")
@pytest.mark.parametrize("depth", [8, 16])
def test_cicp(tmp_path, codes, depth):
    curve, primaries, curve_name, primaries_name = CICP[codes]
    path, png = written(tmp_path, pngfile.cicp(*codes), depth=depth)
    assert_read(path, meant(png, curve, primaries), 10 * FLOAT32)
    encoding = hpcomp.info(path).parts[0].encoding
    assert (encoding.transfer.name, encoding.primaries.name) == (curve_name, primaries_name)


@pytest.mark.parametrize(
    ("colour", "depth", "black", "white"),
    [
        (pngfile.RGBA, 8, 16 / 255, 235 / 255),
        (pngfile.RGBA, 16, 16 * 256 / 65535, 235 * 256 / 65535),
        (pngfile.PALETTE, 4, 16 / 255, 235 / 255),
        (pngfile.GREY, 4, 1 / 15, 235 / 16 / 15),
    ],
)
def test_narrow_range(tmp_path, colour, depth, black, white):
    """Black and white lie inside the codes; alpha has all of them."""
    path, png = written(tmp_path, pngfile.cicp(1, 8, full_range=0), colour=colour, depth=depth)
    assert_read(path, png.linear(lambda v: (v - black) / (white - black)), 2 * FLOAT32)
    assert hpcomp.info(path).parts[0].encoding.transfer.name == "linear, narrow range"


HDR = {"PQ": 16, "HLG": 18}


@pytest.mark.pairwise
@pytest.mark.parametrize("full_range", [0, 1])
@pytest.mark.parametrize("primaries", [1, 9, 12])
@pytest.mark.parametrize("name", HDR)
def test_hdr_is_an_error_that_says_so(tmp_path, name, primaries, full_range):
    """Even where a lower chunk could be read: that is a guess at another picture."""
    path, _ = written(
        tmp_path, pngfile.srgb(), pngfile.cicp(primaries, HDR[name], full_range=full_range)
    )
    with pytest.raises(InputError, match=rf"a\.png: its cICP says {name}.*colorspace="):
        hpcomp.read_layer(path)


def test_hdr_can_be_overruled(tmp_path):
    path, png = written(tmp_path, pngfile.cicp(9, 16))
    found = read(path, colorspace="srgb")
    assert np.abs(found - png.linear()).max() <= FLOAT32


@pytest.mark.parametrize("name", HDR)
def test_a_profile_that_approximates_hdr_is_an_error_too(tmp_path, name):
    """ICC.1:2022, 9.2.17: the curves beside a cicp tag are for those who do not know it."""
    tag = b"cicp\0\0\0\0" + bytes([9, HDR[name], 0, 1])
    profile = pngfile.icc_profile("h", REC2020_XY, 2.2, more=[(b"cicp", tag)])
    path, _ = written(tmp_path, pngfile.iccp(profile))
    with pytest.raises(InputError, match=f"its iCCP says {name}"):
        hpcomp.read_layer(path)


# ---- ICC profiles ---------------------------------------------------------------------------

RISING = np.linspace(0, 1, 33) ** 2 * 0.7 + np.linspace(0, 1, 33) * 0.3


def table_curve(v):
    return np.interp(v, np.linspace(0, 1, 33), np.round(RISING * 65535) / 65535)


#: ICC.1:2022, table 68, each function with parameters whose ends meet somewhere.
CURVES = {
    "para 0": (pngfile.parametric(0, 1.9), lambda v: v**1.9),
    "para 1": (
        pngfile.parametric(1, 2.0, 0.9, 0.1),
        lambda v: np.where(v >= -0.1 / 0.9, (0.9 * v + 0.1) ** 2.0, 0),
    ),
    "para 1 with a toe": (
        pngfile.parametric(1, 2.0, 1.25, -0.25),
        lambda v: np.where(v >= 0.2, np.maximum(1.25 * v - 0.25, 0) ** 2, 0),
    ),
    "para 2": (
        pngfile.parametric(2, 2.0, 1.0, -0.2, 0.1),
        lambda v: np.where(v >= 0.2, np.maximum(v - 0.2, 0) ** 2 + 0.1, 0.1),
    ),
    "para 3": (
        pngfile.parametric(3, 3.0, 0.9, 0.1, 0.1, 0.25),
        lambda v: np.where(v >= 0.25, (0.9 * v + 0.1) ** 3, 0.1 * v),
    ),
    "para 4": (
        pngfile.parametric(4, 2.0, 0.9, 0.05, 0.3, 0.25, 0.05, 0.01),
        lambda v: np.where(v >= 0.25, (0.9 * v + 0.05) ** 2 + 0.05, 0.3 * v + 0.01),
    ),
    "curv of none": (b"curv\0\0\0\0\0\0\0\0", lambda v: v),
    "curv of one": (b"curv\0\0\0\0\0\0\0\1\2\x40", lambda v: v**2.25),
    "curv of 33": (pngfile.table(RISING), table_curve),
}


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("name", CURVES)
def test_curves_of_profiles(tmp_path, name, depth):
    tag, curve = CURVES[name]
    profile = pngfile.icc_profile("c", curve=[tag] * 3)
    path, png = written(tmp_path, pngfile.iccp(profile), depth=depth)
    assert_read(path, png.linear(curve))


@pytest.mark.filterwarnings("ignore:.*colours under an alpha of 0")
def test_a_curve_for_each_channel(tmp_path):
    """As measured displays have them."""
    names = ["para 0", "para 3", "curv of 33"]
    profile = pngfile.icc_profile("c", pngfile.P3_XY, [CURVES[name][0] for name in names])
    for depth in (8, 16):
        path, png = written(tmp_path, pngfile.iccp(profile), depth=depth)

        def each(rgb):
            curves = [CURVES[name][1] for name in names]
            return np.stack([curve(rgb[..., i]) for i, curve in enumerate(curves)], axis=-1)

        assert_read(path, meant(png, each, pngfile.P3_XY))
        out = tmp_path / "out.exr"
        hpcomp.stack([path], out, depth="float")
        assert np.abs(read(out) - read(path)).max() <= FLOAT32


@pytest.mark.parametrize("version", [2, 4])
@pytest.mark.parametrize(
    ("name", "primaries", "white", "curve", "known"),
    [
        ("Display P3 by test", pngfile.P3_XY, pngfile.D65_XY, "srgb", "sRGB, display-p3"),
        ("Adobe by test", pngfile.ADOBE_XY, pngfile.D65_XY, 563 / 256, "gamma 2.199, adobe-rgb"),
        ("2020 by test", REC2020_XY, pngfile.D65_XY, "srgb", "sRGB, rec2020"),
        ("gamma 1.8", pngfile.SRGB_XY, pngfile.D65_XY, 461 / 256, "gamma 1.801, rec709"),
        ("ProPhoto by test", PROPHOTO_XY, D50_XY, 461 / 256, "gamma 1.801, custom"),
        ("measured", ODD_XY, ODD_WHITE, "srgb", "sRGB, custom"),
        # The name lies: the numbers of a profile decide.
        ("sRGB IEC61966-2.1", pngfile.ADOBE_XY, pngfile.D65_XY, "srgb", "sRGB, adobe-rgb"),
    ],
)
def test_profiles_of_matrix_and_curves(tmp_path, name, primaries, white, curve, known, version):
    profile = pngfile.icc_profile(name, primaries, curve, white=white, version=version)
    path, png = written(tmp_path, pngfile.iccp(profile))
    decode = pngfile.srgb_to_linear if curve == "srgb" else pngfile.power(curve)
    assert_read(path, meant(png, decode, primaries, white))
    part = hpcomp.info(path).parts[0]
    assert (str(part.encoding), part.icc_profile) == (known, name)
    # Back from D50 to the white that it was made for.
    assert np.abs(part.encoding.primaries.xy - [*primaries, white]).max() < STORED


def test_without_a_word_of_the_white_nothing_else_changes(tmp_path):
    """Colorants are relative to D50: the white decides what the primaries are called."""
    for white, known in ((pngfile.D65_XY, "display-p3"), (ODD_WHITE, "custom")):
        whole = pngfile.icc_profile("p", pngfile.P3_XY, white=white)
        bare = pngfile.icc_profile("p", pngfile.P3_XY, white=white, without=[b"chad"])
        told = read(written(tmp_path, pngfile.iccp(whole))[0])
        path, _ = written(tmp_path, pngfile.iccp(bare))
        assert np.abs(read(path) - told).max() <= STORED
        assert hpcomp.info(path).parts[0].encoding.primaries.name == known


def test_a_grey_profile_in_a_grey_picture(tmp_path):
    profile = pngfile.iccp(pngfile.icc_profile("grey", curve=2.0, space=b"GRAY"))
    for colour in (pngfile.GREY, pngfile.GREY_ALPHA):
        path, png = written(tmp_path, profile, colour=colour)
        assert_read(path, png.linear(pngfile.power(2.0)), FLOAT32)


def test_an_rgb_profile_of_one_curve_in_a_grey_picture(tmp_path):
    """The specification forbids it, but what is meant is clear: grey is grey in all primaries."""
    profile = pngfile.iccp(pngfile.icc_profile("p3", pngfile.P3_XY, 2.0))
    path, png = written(tmp_path, profile, colour=pngfile.GREY)
    assert_read(path, png.linear(pngfile.power(2.0)), FLOAT32)


def broken(profile, at, data):
    return profile[:at] + data + profile[at + len(data) :]


SOUND = pngfile.icc_profile("odd", pngfile.P3_XY)
THREE_CURVES = pngfile.icc_profile("odd", curve=[CURVES[f"para {i}"][0] for i in (0, 3, 4)])
NOT_HONOURED = {
    "tables": (
        pngfile.icc_profile("odd", more=[(b"A2B0", bytes(48))]),
        pngfile.RGB,
        "made of tables",
    ),
    "Lab": (broken(SOUND, 20, b"Lab "), pngfile.RGB, "made of tables"),
    "CMYK": (broken(SOUND, 16, b"CMYK"), pngfile.RGB, "of CMYK, in an RGB picture"),
    "grey": (
        pngfile.icc_profile("odd", space=b"GRAY"),
        pngfile.RGB,
        "of grey, in an RGB picture",
    ),
    "RGB in grey": (THREE_CURVES, pngfile.GREY, "of RGB, in a grey picture"),
    "link": (pngfile.icc_profile("odd", device=b"link"), pngfile.RGB, "not of a device"),
    "no curve": (pngfile.icc_profile("odd", without=[b"gTRC"]), pngfile.RGB, "damaged"),
    "no colorant": (pngfile.icc_profile("odd", without=[b"bXYZ"]), pngfile.RGB, "damaged"),
    "no chad": (
        pngfile.icc_profile("odd", ODD_XY, without=[b"chad"], more=[(b"chad", bytes(44))]),
        pngfile.RGB,
        "damaged",
    ),
    "short table": (
        pngfile.icc_profile("odd", curve=[pngfile.table(RISING)[:30]] * 3),
        pngfile.RGB,
        "damaged",
    ),
    "falling": (
        pngfile.icc_profile("odd", curve=[pngfile.table(1 - RISING)] * 3),
        pngfile.RGB,
        "not of rising curves",
    ),
    "infinite": (
        pngfile.icc_profile("odd", curve=[pngfile.parametric(0, -1.0)] * 3),
        pngfile.RGB,
        "not of rising curves",
    ),
    "divided by zero": (
        pngfile.icc_profile("odd", curve=[pngfile.parametric(1, 2.0, 0.0, 0.1)] * 3),
        pngfile.RGB,
        "damaged",
    ),
    "another function": (
        pngfile.icc_profile("odd", curve=[pngfile.parametric(5, 1.0)] * 3),
        pngfile.RGB,
        "of unknown curves",
    ),
}


@pytest.mark.parametrize("kind", NOT_HONOURED)
def test_other_profiles_are_named_in_a_warning(tmp_path, kind):
    profile, colour, why = NOT_HONOURED[kind]
    path, png = written(tmp_path, pngfile.iccp(profile), colour=colour)
    with pytest.warns(HpcompWarning, match=re.escape(f"the ICC profile 'odd' ({why})")) as caught:
        found = hpcomp.read_layer(path).pixels
    assert len(caught) == 1
    assert np.abs(found - png.linear()).max() <= FLOAT32
    with pytest.raises(InputError, match="--strict"):
        hpcomp.read_layer(path, strict=True)


def test_no_damage_to_a_profile_goes_further_than_a_warning(tmp_path):
    """Every byte of the header and of the tags' directory, and every length."""
    whole = pngfile.icc_profile("odd", ODD_XY, [CURVES["para 4"][0]] * 3, white=ODD_WHITE)
    profiles = [whole[:size] for size in range(0, len(whole), 7)]
    profiles += [broken(whole, at, bytes([255 - whole[at]])) for at in range(0, len(whole), 3)]
    for profile in profiles:
        path, _ = written(tmp_path, pngfile.iccp(profile))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", HpcompWarning)
            assert np.isfinite(hpcomp.read_layer(path).pixels).all()


def test_a_profile_is_not_unpacked_beyond_all_measure(tmp_path):
    bomb = (b"iCCP", b"bomb\0\0" + zlib.compress(bytes(1 << 27), 9))
    path, _ = written(tmp_path, bomb)
    with pytest.warns(HpcompWarning, match="the ICC profile 'bomb'"):
        hpcomp.read_layer(path)


# ---- gAMA of 2.2 ----------------------------------------------------------------------------

CODES = [16, 32, 64, 128, 200]
OF_SRGB = pngfile.chrm(pngfile.D65_XY, *pngfile.SRGB_XY)


@pytest.mark.parametrize(
    ("chunks", "shown"),
    [
        ([], CODES),
        ([pngfile.gama(45455)], CODES),
        ([pngfile.gama(45454)], CODES),
        ([pngfile.gama(45455), OF_SRGB], [7, 26, 62, 129, 201]),
        ([pngfile.gama(45455), OF_SRGB, pngfile.srgb()], CODES),
        ([pngfile.gama(100000)], [71, 99, 137, 188, 229]),
        ([pngfile.gama(100000), OF_SRGB], [71, 99, 137, 188, 229]),
    ],
    ids=lambda value: "+".join(kind.decode() for kind, _ in value if isinstance(kind, bytes))
    if isinstance(value, list) and value and isinstance(value[0], tuple)
    else "",
)
def test_gama_means_what_browsers_take_it_for(tmp_path, chunks, shown):
    """The codes are what Chromium 150 draws into a canvas; Firefox and libpng do the same.

    PNG third edition, 11.3.2.2, has a pure power: as all of them do where there is cHRM beside it.
    """
    samples = np.repeat(np.array(CODES)[None, :, None], 3, axis=2)
    png = pngfile.Png(samples, pngfile.RGB, 8).with_chunks(head=chunks)
    (tmp_path / "a.png").write_bytes(png.encode())
    hpcomp.stack([str(tmp_path / "a.png")], tmp_path / "out.png")
    found = pngfile.decode((tmp_path / "out.png").read_bytes())[0, :, :3]
    assert np.array_equal(found, np.repeat(np.array(shown)[:, None], 3, axis=1))


# ---- the command ----------------------------------------------------------------------------


@pytest.fixture
def desk(tmp_path):
    return command.Desk.made(tmp_path)


def info(desk, path, *options):
    found = desk.run("info", *options, path)
    assert (found.code, found.stderr) == (0, "")
    return found.stdout.decode()


def test_info_says_where_colour_comes_from(desk):
    profile = pngfile.icc_profile("Display P3 by test", pngfile.P3_XY)
    path, _ = written(desk.folder, pngfile.iccp(profile))
    text = info(desk, path.name)
    for line in ("light.*sRGB, from iCCP", "primaries.*display-p3", "ICC profile.*Display P3 by"):
        assert re.search(line, text), text
    (part,) = json.loads(info(desk, path.name, "--json"))["files"][0]["parts"]
    assert part["icc_profile"] == "Display P3 by test"
    assert (part["transfer"], part["primaries"]) == ("sRGB", "display-p3")
    assert (part["transfer_from"], part["primaries_from"]) == ("iCCP", "iCCP")
    assert part["problems"] == []


def test_info_says_where_each_of_light_and_primaries_comes_from(desk):
    path, _ = written(desk.folder, pngfile.chrm(pngfile.D65_XY, *pngfile.ADOBE_XY))
    text = info(desk, path.name)
    assert re.search("light +sRGB, from default", text), text
    assert re.search("primaries +adobe-rgb, from cHRM", text), text
    (part,) = json.loads(info(desk, path.name, "--json"))["files"][0]["parts"]
    assert (part["transfer_from"], part["primaries_from"]) == ("default", "cHRM")


def test_info_of_custom_primaries_has_their_numbers(desk):
    path, _ = written(desk.folder, pngfile.chrm(ODD_WHITE, *ODD_XY))
    text = info(desk, path.name)
    assert (
        "custom: red 0.6600 0.3100, green 0.2500 0.6400, blue 0.1400 0.0500, white 0.3000" in text
    )


def test_info_of_hdr_says_that_it_cannot_be_read(desk):
    path, _ = written(desk.folder, pngfile.cicp(9, 16))
    text = info(desk, path.name)
    assert "cannot be read as it is" in text
    assert "PQ, from cICP" in text
    data = json.loads(info(desk, path.name, "--json"))["files"][0]
    assert (data["read_as"], data["parts"][0]["transfer"]) == (None, "PQ")
    assert "HDR" in data["problem"]


def test_a_stack_of_hdr_ends_with_its_code(desk):
    path, _ = written(desk.folder, pngfile.cicp(9, 18))
    found = desk.run("stack", path.name, "-o", "out.png")
    assert found.code == 3
    assert "layer 0 (a.png): its cICP says HLG" in found.stderr
    assert not (desk / "out.png").exists()


def test_a_damaged_chunk_beside_the_colours_is_a_warning_of_every_command(desk):
    png = pngfile.random_png(pngfile.RGBA, 8).with_chunks(body=[(b"cLLI", bytes(8))]).encode()
    (desk.folder / "a.png").write_bytes(pngfile.break_crc(png, b"cLLI"))
    words = "the checksum of its cLLI chunk is wrong, and it is left out"
    for arguments in (["stack", "a.png::alpha=straight", "-o", "out.png"], ["hues", "a.png"]):
        found = desk.run(*arguments)
        assert (found.code, found.stderr.count("\n")) == (0, 1)
        assert words in found.stderr
        assert desk.run(*arguments, "--strict").code == 3
    assert f"warning: {words}" in info(desk, "a.png")
    (file,) = json.loads(info(desk, "a.png", "--json"))["files"]
    assert file["warnings"] == [words]
