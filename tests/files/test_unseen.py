"""What of the samples does not come into the picture is said, once they are read."""

from __future__ import annotations

import warnings

import command
import deepfile
import exrfile
import numpy as np
import pngfile
import pytest

import hpcomp
from hpcomp import HpcompWarning, MismatchError


def said_of(path, **options):
    """What a warning says of the layer; a strict run refuses it for the same."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        hpcomp.read_layer(path, **options)
    said = [str(warning.message) for warning in caught]
    assert all(warning.category is HpcompWarning for warning in caught)
    if said:
        with pytest.raises(MismatchError) as refused:
            hpcomp.read_layer(path, strict=True, **options)
        assert str(refused.value) == f"{said[0]} (an error with --strict)"
    return [words.removeprefix(f"{path}: ") for words in said]


def exr(tmp_path, **planes):
    return exrfile.write(tmp_path / "a.exr", planes)


def png(tmp_path, samples, kind=pngfile.RGBA, depth=8, **options):
    path = tmp_path / "a.png"
    path.write_bytes(pngfile.Png(np.asarray(samples), kind, depth, **options).encode())
    return path


@pytest.fixture
def desk(tmp_path):
    return command.Desk.made(tmp_path)


# ---- alpha outside 0 to 1 -------------------------------------------------------------------

HALF_STEP = 2.0**-10


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([0, 0.5, 1], None),
        ([-0.0, 1 + HALF_STEP, 0.25], None),
        ([0, 2, 1], "1 pixel has an alpha outside 0 to 1, from 0 to 2, held to 0 and 1"),
        ([-0.5, 0.25, 1], "1 pixel has an alpha outside 0 to 1, from -0.5 to 1, held"),
        ([-0.25, 255, 128], "3 pixels have an alpha outside 0 to 1, from -0.25 to 255, held"),
        ([1 + 2 * HALF_STEP, 1, 1], "1 pixel has an alpha outside 0 to 1, from 0 to 1.00195, held to 0 and 1: filters that sharpen"),
        ([0, 2, -0.125], "from -0.125 to 2, held to 0 and 1: divide it first if it has another"),
    ],
    ids=str,
)
def test_alphas_that_are_held_are_counted(tmp_path, values, words, dtype):
    alpha = np.tile(np.array([values], dtype), (1, 1))
    path = exr(tmp_path, **{name: np.full(alpha.shape, 0.5, dtype) for name in "RGB"}, A=alpha)
    said = said_of(path)
    assert len(said) == (words is not None)
    assert not said or words in said[0]


@pytest.mark.parametrize("tile", [None, (16, 8)])
def test_each_pixel_counts_once(tmp_path, desk, tile):
    """Strips, compression blocks and tiles are read as they come; a part of them counts alone."""
    alpha = np.zeros((90, 40), np.float16)
    alpha[::3] = 1.5
    planes = {name: np.zeros(alpha.shape, np.float16) for name in "RGB"} | {"A": alpha}
    exrfile.write(desk / "a.exr", planes, tile=tile)
    for options, rows in ([], 30), (["--region", "40x10+0+0"], 4):
        for memory in ("1G", "48M"):
            run = desk.run("stack", "a.exr", "-o", "out.exr", "--max-memory", memory, *options)
            assert (run.code, run.stderr.count("\n")) == (0, 1)
            assert f"layer 0 (a.exr): {rows * 40} pixels have an alpha outside" in run.stderr
    for arguments in (["hues", "a.exr"], ["explain", "a.exr", "--at", "0,0"]):
        run = desk.run(*arguments)
        assert "pixels have an alpha outside 0 to 1" in run.stderr
    run = desk.run("stack", "a.exr", "-o", "out.exr", "--strict")
    assert run.code == 4


def test_what_is_not_finite_is_the_matter_of_its_policy(tmp_path):
    alpha = np.array([[np.nan, np.inf, -np.inf, 1]], np.float32)
    path = exr(tmp_path, **{name: np.zeros(alpha.shape, np.float32) for name in "RGB"}, A=alpha)
    assert said_of(path, nonfinite="keep") == []


def test_values_of_a_mask_are_alphas(tmp_path):
    """So numbers of classes, which an EXR has as they are, do not all become 1 without a word."""
    path = exr(tmp_path, id=np.array([[0, 1, 2, 4]], np.uint32))
    (words,) = said_of(path, tint="red")
    assert "2 pixels have a value outside 0 to 1, from 0 to 4, held to 0 and 1" in words


@pytest.mark.parametrize("names", ["Y", "RGB"])
def test_luminances_that_are_alphas_are_held_too(tmp_path, names):
    path = exr(tmp_path, **{name: np.array([[0, 0.5, 1, 4]], np.float32) for name in names})
    (words,) = said_of(path, alpha="luminance")
    assert "1 pixel has a value outside 0 to 1, from 0 to 4, held to 0 and 1" in words


def test_deep_samples_too(desk):
    names = ("R", "G", "B", "A", "Z")
    pixels = [[[(0.5, 0, 0, 1.5, 1.0), (0.5, 0, 0, -0.5, 2.0)], [(0, 0, 0.5, 0.5, 1.0)]]]
    deepfile.write(desk / "a.exr", deepfile.of_pixels(pixels, names))
    run = desk.run("flatten", "a.exr", "-o", "out.exr")
    assert (run.code, run.stderr.count("\n")) == (0, 1)
    assert "a.exr: 2 samples have an alpha outside 0 to 1, from -0.5 to 1.5, held" in run.stderr
    assert desk.run("flatten", "a.exr", "-o", "out.exr", "--strict").code == 4


# ---- colours that an alpha of 0 hides -------------------------------------------------------

SEVERAL = [[[10, 20, 30, 0], [40, 50, 60, 0]]]
FILLED = [[[255, 255, 255, 0], [255, 255, 255, 0]]]
HALF_SEEN = [[[10, 20, 30, 0], [40, 50, 60, 0], [0, 0, 0, 255]]]
INVISIBLE = "its alpha is 0 everywhere, so that none of its colours is seen"
LOST = "2 pixels have colours under an alpha of 0, which are lost"


def test_a_picture_whose_alpha_is_0_everywhere(tmp_path):
    (words,) = said_of(png(tmp_path, SEVERAL))
    assert INVISIBLE in words
    assert said_of(tmp_path / "a.png", alpha="straight") == []
    # Empty pictures are ordinary: a label that is not in this frame.
    assert said_of(png(tmp_path, FILLED)) == []
    assert said_of(png(tmp_path, np.zeros((2, 2, 4), int))) == []
    # What is seen is a picture; what lies under it is not in a stack of several.
    assert said_of(png(tmp_path, HALF_SEEN)) == []


def test_it_is_seen_in_all_its_rows(tmp_path):
    samples = np.zeros((300, 4, 4), int)
    samples[..., 0] = np.arange(300)[:, None] % 256
    assert INVISIBLE in said_of(png(tmp_path, samples))[0]
    samples[299, 3, 3] = 1
    assert said_of(png(tmp_path, samples)) == []


def test_hidden_colours_of_the_only_layer_are_lost_with_a_word(desk):
    """Under an alpha of 0 such a picture has nothing else; in a stack of several they are filling."""
    desk.put("a.png", pngfile.rgba_png(np.array(HALF_SEEN)).encode())
    desk.put("filled.png", pngfile.rgba_png(np.array([*FILLED, *FILLED])).encode())
    run = desk.run("stack", "a.png", "-o", "out.png")
    assert (run.code, run.stderr.count("\n")) == (0, 1)
    assert f"layer 0 (a.png): {LOST}" in run.stderr
    assert desk.run("stack", "a.png", "-o", "out.png", "--strict").code == 4
    for quiet in (
        ["a.png::alpha=straight"],
        ["a.png", "--background", "white"],
        ["a.png", "a.png"],
        ["filled.png"],
    ):
        desk.makes("stack", *quiet, "-o", "out.png", "--strict")


def test_glow_is_kept_and_not_hidden(desk):
    """Premultiplied light without alpha is in the picture; a PNG cannot hold it, which is said."""
    planes = {name: np.full((1, 2), 0.25, np.float16) for name in "RGB"}
    planes["R"][0, 1] = 0.5
    exrfile.write(desk / "a.exr", planes | {"A": np.zeros((1, 2), np.float16)})
    desk.makes("stack", "a.exr", "-o", "out.exr", "--strict")
    run = desk.run("stack", "a.exr", "-o", "out.png")
    assert (run.code, run.stderr.count("\n")) == (0, 1)
    assert "2 pixels are light without alpha" in run.stderr


@pytest.mark.parametrize("mode", ["premultiplied-encoded", "luminance"])
def test_modes_that_divide_by_alpha_cannot_keep_glow(tmp_path, mode):
    planes = {name: np.array([[0.25, 0, 0.5]], np.float16) for name in "RGB"}
    path = exr(tmp_path, **planes, A=np.array([[0, 0, 0.5]], np.float16))
    (words,) = said_of(path, alpha=mode)
    assert f"1 pixel has light and an alpha of 0, which alpha={mode} cannot keep" in words
    assert said_of(path, alpha="premultiplied") == []


# ---- masks of class numbers -----------------------------------------------------------------


@pytest.mark.parametrize(("depth", "white"), [(8, 255), (16, 65535)])
@pytest.mark.parametrize("options", [{"tint": "red"}, {"alpha": "luminance"}], ids=str)
def test_numbers_of_classes_cover_next_to_nothing(tmp_path, depth, white, options):
    classes = np.arange(5).repeat(3).reshape(1, -1, 1)
    (words,) = said_of(png(tmp_path, classes, pngfile.GREY, depth), **options)
    assert f"its largest value is 4 of {white}, so that it covers next to nothing" in words
    for fine in (np.zeros_like(classes), classes * white // 4, classes * 0 + white // 8):
        assert said_of(png(tmp_path, fine, pngfile.GREY, depth), **options) == []
    # As a picture it is dark, and that is what it is.
    assert said_of(png(tmp_path, classes, pngfile.GREY, depth)) == []


def test_a_part_of_a_mask_shows_nothing_of_the_rest(desk):
    mask = np.zeros((200, 10, 1), int)
    mask[:100] = 3
    mask[150:] = 255
    desk.put("base.png", pngfile.bands((90, 90, 90), size=(10, 200)))
    desk.put("mask.png", pngfile.Png(mask, pngfile.GREY, 8).encode())
    arguments = ["stack", "base.png", "mask.png::tint=red", "-o", "out.png", "--strict"]
    desk.makes(*arguments)
    desk.makes(*arguments, "--region", "10x50+0+0")


# ---- layers outside the picture -------------------------------------------------------------


@pytest.fixture
def placed(desk):
    desk.put("base.png", pngfile.bands((90, 90, 90), size=(40, 30)))
    desk.put("logo.png", pngfile.bands((200, 0, 0), size=(10, 8)))
    for name, left in (("far", 100), ("near", 30)):
        planes = exrfile.planes("RGBA", 4, 4)
        exrfile.write(desk / f"{name}.exr", planes, origin=(left, 20), display=(0, 0, 40, 30))
    return desk


@pytest.mark.parametrize(
    ("layer", "options", "words"),
    [
        ("logo.png::at=south-east+10+10", [], "10x8+40+32, outside the canvas 40x30+0+0: offsets "
         "count to the right and downwards, whatever the gravity: did you mean at=south-east-10-10?"),
        ("logo.png::at=north-west-20-0", [], "did you mean at=north-west+20+0?"),
        ("logo.png::at=south+3+9", [], "did you mean at=south+3-9?"),
        ("logo.png::at=center+90+0", [], "count to the right and downwards, whatever the gravity"),
        ("logo.png::at=+40+0", [], "place it with at=+X+Y, which counts from the origin"),
        ("far.exr", [], "4x4+100+20, outside the canvas 40x30+0+0: place it with at=+X+Y"),
        ("logo.png::at=+20+10", ["--region", "5x5+0+0"], "10x8+20+10, outside the region 5x5+0+0"),
    ],
    ids=lambda value: value if isinstance(value, str) and "::" in value else "",
)  # fmt: skip
def test_a_layer_of_which_nothing_is_seen(placed, layer, options, words):
    arguments = ["stack", "base.png", layer, "-o", "out.exr", *options]
    run = placed.run(*arguments)
    assert (run.code, run.stderr.count("\n")) == (0, 1)
    assert "layer 1 (" in run.stderr
    assert words in run.stderr
    assert placed.run(*arguments, "--strict").code == 4
    if not options:
        assert words in placed.run("explain", "base.png", layer, "--at", "1,1").stderr


def test_where_its_file_puts_a_layer_is_no_surprise_in_a_region(placed):
    """Tiles and sequences have such layers in every region."""
    placed.makes(
        "stack", "base.png", "near.exr", "-o", "out.exr", "--region", "5x5+0+0", "--strict"
    )


def test_what_is_seen_in_part_is_as_it_was_placed(placed):
    for layer in ("logo.png::at=south-east+9+7", "logo.png::at=+0+0"):
        placed.makes("stack", "base.png", layer, "-o", "out.png", "--strict")
    # Overscan is in the picture, where it is kept.
    placed.makes("stack", "base.png", "far.exr", "-o", "out.exr", "--overscan", "--strict")


def test_deep_images_too(placed):
    deepfile.write(placed / "a.exr", deepfile.noise(5, 4, 3))
    deepfile.write(placed / "b.exr", deepfile.noise(5, 4, 3, seed=1))
    run = placed.run("flatten", "a.exr", "b.exr::at=south-east+1+4", "-o", "out.exr")
    assert (run.code, run.stderr.count("\n")) == (0, 1)
    assert "did you mean at=south-east-1-4?" in run.stderr
