"""`hpcomp flatten` as a shell and as Python meet it: against oiiotool, stack and the document."""

import dataclasses
import itertools
import json
import struct
import subprocess

import deepfile
import deeporacle
import exrfile
import numpy as np
import OpenEXR
import oracle
import pngfile
import pytest
from command import OLD, PATIENCE_S, Desk, command, shell
from deepfile import Deep, noise, of_pixels
from processes import NOISE_M, peak
from strategies import ORDER_NAMES

import hpcomp
from hpcomp.engine import choice as engine
from hpcomp.pipeline import deepbudget

#: Half-floats have 11 bits: what one rounding, of values up to 1, can change.
HALF = 2.0**-11
FLOAT = 1e-6
#: How far OpenImageIO's merged samples are from the document's formulas in doubles.
OIIO_MERGES = 2e-4

RED = (0.5, 0.0, 0.0, 0.5)
BLUE = (0.0, 0.0, 0.4, 0.5)
CHANNELS = ("R", "G", "B", "A", "Z", "ZBack")


@pytest.fixture
def desk(tmp_path):
    desk = Desk.made(tmp_path)
    deepfile.write(desk / "tidy.exr", noise(31, 23, 6))
    deepfile.write(desk / "messy.exr", noise(31, 23, 6, tidy=False, seed=1))
    return desk


def pixels_of(path):
    return hpcomp.read_layer(str(path)).pixels


def by_oracle(path, **settings):
    """What the document and the paper make of a file."""
    return np.array(
        [
            [
                deeporacle.flat([tuple(s[n] for n in CHANNELS) for s in pixel], **settings)
                for pixel in row
            ]
            for row in deepfile.read_back(path)
        ]
    )


# ---- the same as others give ----------------------------------------------------------------


@pytest.mark.pairwise
@pytest.mark.parametrize("tile", [None, (8, 5)])
@pytest.mark.parametrize("compression", ["none", "rle", "zips"])
@pytest.mark.parametrize("color", ["f2", "f4"])
def test_traditional_is_what_oiiotool_flattens_to(desk, compression, tile, color):
    deepfile.write(desk / "a.exr", noise(31, 23, 6, compression=compression, tile=tile, color=color))
    desk.makes("flatten", "a.exr", "--blending", "traditional", "-o", "out.exr")
    oiiotool = command("--no-autopremult")[0].with_name("oiiotool")
    subprocess.run(
        [oiiotool, "a.exr", "--flatten", "--ch", "R,G,B,A", "-d", "half", "-o", "oiio.exr"],
        cwd=desk.folder, check=True, timeout=PATIENCE_S,
    )  # fmt: skip
    assert np.abs(pixels_of(desk / "out.exr") - pixels_of(desk / "oiio.exr")).max() <= HALF


def test_traditional_of_messy_samples_is_what_openimageio_merges_and_flattens(desk):
    """`oiiotool --flatten` takes samples as they are stored, one over the other.

    No three opaque ones in one place: OpenImageIO halves in pairs, so that their order matters.
    """
    deep = noise(31, 23, 6, tidy=False, seed=1)
    np.minimum(deep.planes["A"], 0.9, out=deep.planes["A"])
    deepfile.write(desk / "messy.exr", deep)
    desk.makes(
        "flatten", "messy.exr", "--blending", "traditional", "--depth", "float", "-o", "out.exr"
    )
    wanted = deepfile.flattened_by_oiio(desk / "messy.exr", tidy=True)
    assert np.abs(pixels_of(desk / "out.exr") - wanted).max() < OIIO_MERGES
    unsorted = deepfile.flattened_by_oiio(desk / "messy.exr")
    assert np.abs(unsorted - wanted).max() > 0.1


@pytest.mark.parametrize("name", ["tidy.exr", "messy.exr"])
@pytest.mark.parametrize("order", ORDER_NAMES)
def test_every_order_is_that_of_the_paper(desk, name, order):
    desk.makes("flatten", name, "--order", order, "--depth", "float", "-o", "out.exr")
    assert np.abs(pixels_of(desk / "out.exr") - by_oracle(desk / name, order=order)).max() < 2e-5


@pytest.mark.parametrize("order", ORDER_NAMES)
@pytest.mark.parametrize("space", ["linear-rgb", "oklab"])
def test_samples_apart_are_a_stack_of_their_slices(tmp_path, order, space):
    slices = write_slices(tmp_path, "deep.exr")
    settings = {"order": order, "space": space, **ALL_BUT_THE_ORDER}
    hpcomp.stack(slices, tmp_path / "stack.exr", **settings)
    hpcomp.flatten(tmp_path / "deep.exr", tmp_path / "flat.exr", **settings)
    assert (tmp_path / "flat.exr").read_bytes() == (tmp_path / "stack.exr").read_bytes()


@pytest.mark.parametrize("weave", ["stripes", "noise"])
@pytest.mark.parametrize("space", ["linear-rgb", "oklab"])
@pytest.mark.parametrize("strength", ["chroma", "perceived", "coverage"])
def test_woven_samples_apart_are_a_woven_stack_of_their_slices(tmp_path, strength, space, weave):
    """With the phases of the canvas, whose corner is elsewhere; but for what weights round to."""
    slices = write_slices(tmp_path, "deep.exr", origin=(-4, 7))
    settings = {"blending": "woven", "strength": strength, "space": space, "weave": weave, "weave_size": 3}
    settings |= {"canvas": "8x6-5+8", **ALL_BUT_THE_ORDER}
    hpcomp.stack(slices, tmp_path / "stack.exr", **settings)
    hpcomp.flatten(tmp_path / "deep.exr", tmp_path / "flat.exr", **settings)
    found, wanted = pixels_of(tmp_path / "flat.exr"), pixels_of(tmp_path / "stack.exr")
    assert np.ptp(wanted[..., 0]) > 0.1
    assert np.abs(found - wanted).max() < 1e-5


#: Whatever else a stack may be asked for.
ALL_BUT_THE_ORDER = {"depth": "float", "background": "#336699", "exposure": 0.5}
ALL_BUT_THE_ORDER |= {"gray_bias": 0.25, "hue_tolerance": 3, "primaries": "rec2020"}


def write_slices(folder, name, origin=(0, 0)):
    """A deep file of four samples a pixel at four depths, and flat ones of each depth, the farthest first."""
    rng = np.random.default_rng(7)
    counts = np.full((6, 9), 4)
    alpha = rng.random(216).astype("f4") * 0.8
    planes = {name: (rng.random(216) * alpha).astype("f4") for name in "RGB"} | {"A": alpha}
    depth = np.tile(np.array([4, 1, 3, 2], "f4"), 54)
    deepfile.write(folder / name, Deep(counts, {**planes, "Z": depth}, origin=origin))
    slices = []
    for z in (4, 3, 2, 1):
        slices.append(folder / f"{z}.exr")
        of_depth = {name: plane[depth == z].reshape(6, 9) for name, plane in planes.items()}
        exrfile.write(slices[-1], of_depth, origin=origin)
    return slices


def test_a_label_keeps_its_hue_inside_another(desk):
    """Fog of red and of blue in one place: traditional makes a purple, which is no label."""
    deepfile.write(desk / "fog.exr", of_pixels([[[(*RED, 1, 3), (*BLUE, 2, 4)]]]))
    desk.makes("flatten", "fog.exr", "-o", "out.exr", "--depth", "float")
    desk.makes(
        "flatten", "fog.exr", "-o", "plain.exr", "--depth", "float", "--blending", "traditional"
    )
    ours, plain = (tuple(map(float, pixels_of(desk / n)[0, 0])) for n in ("out.exr", "plain.exr"))
    assert abs(oracle.luminance(ours[:3]) - oracle.luminance(plain[:3])) < FLOAT
    hues = [oracle.difference(color[:3]) for color in (RED, BLUE)]
    assert min(oracle.angle(hue, oracle.difference(ours[:3])) for hue in hues) < 1e-3
    assert min(oracle.angle(hue, oracle.difference(plain[:3])) for hue in hues) > 0.1


# ---- several files --------------------------------------------------------------------------


def test_several_files_are_one_and_their_order_changes_no_byte(desk):
    first, second = noise(31, 23, 6, tidy=False), noise(31, 23, 6, tidy=False, seed=1)
    deepfile.write(desk / "first.exr", first)
    made = {}
    for names in itertools.permutations(["first.exr", "messy.exr", "tidy.exr"]):
        desk.makes("flatten", *names, "-o", "out.exr")
        made[names] = (desk / "out.exr").read_bytes()
    assert len(set(made.values())) == 1
    pixels = [
        [a + b for a, b in zip(*rows, strict=True)]
        for rows in zip(*(deepfile.read_back(desk / n) for n in ("first.exr", "messy.exr")),
                        strict=True)
    ]  # fmt: skip
    both = [[[tuple(s[n] for n in CHANNELS) for s in p] for p in row] for row in pixels]
    deepfile.write(desk / "both.exr", of_pixels(both))
    desk.makes("flatten", "both.exr", "-o", "one.exr")
    desk.makes("flatten", "first.exr", "messy.exr", "-o", "two.exr")
    assert (desk / "one.exr").read_bytes() == (desk / "two.exr").read_bytes()
    assert second.counts.sum() > 0


def test_files_of_other_display_windows_have_to_be_placed(desk):
    deepfile.write(desk / "small.exr", of_pixels([[[(*RED, 0, 0)]]]))
    desk.refuses(
        4, "flatten", "tidy.exr", "small.exr", "-o", "x.exr",
        says=["small.exr is 1x1 but the canvas is 31x23", "at=+X+Y", "--canvas"],
    )  # fmt: skip
    desk.makes("flatten", "tidy.exr", "small.exr::at=+4+5", "-o", "out.exr", "--depth", "float")
    desk.makes("flatten", "tidy.exr", "-o", "alone.exr", "--depth", "float")
    changed = np.argwhere((pixels_of(desk / "out.exr") != pixels_of(desk / "alone.exr")).any(-1))
    assert changed.tolist() == [[5, 4]]
    deepfile.write(desk / "beside.exr", of_pixels([[[(*RED, 0, 0)]]], origin=(40, 30)))
    desk.makes("flatten", "tidy.exr", "beside.exr", "--canvas", "union", "-o", "out.exr")
    part = hpcomp.info(str(desk / "out.exr")).parts[0]
    assert str(part.data_window) == str(part.display_window) == "41x31+0+0"
    assert np.allclose(pixels_of(desk / "out.exr")[30, 40], RED)


def test_a_data_window_beyond_the_canvas_is_cut_or_kept(desk):
    deep = noise(20, 16, 4, origin=(-3, -2), display=(0, 0, 10, 9))
    deepfile.write(desk / "a.exr", deep)
    whole = by_oracle(desk / "a.exr")
    desk.makes("flatten", "a.exr", "-o", "cut.exr", "--depth", "float")
    assert np.abs(pixels_of(desk / "cut.exr") - whole[2:11, 3:13]).max() < 2e-5
    desk.makes("flatten", "a.exr", "-o", "all.exr", "--depth", "float", "--overscan")
    assert np.abs(pixels_of(desk / "all.exr") - whole).max() < 2e-5
    part = hpcomp.info(str(desk / "all.exr")).parts[0]
    assert (str(part.data_window), str(part.display_window)) == ("20x16-3-2", "10x9+0+0")
    desk.makes("flatten", "a.exr", "-o", "r.exr", "--depth", "float", "--region", "4x3+2+5")
    assert np.abs(pixels_of(desk / "r.exr") - whole[7:10, 5:9]).max() < 2e-5
    desk.refuses(4, "flatten", "a.exr", "-o", "x.exr", "--region", "4x3+9+5", says=["region"])


# ---- the same bytes, whatever the machine ---------------------------------------------------


@pytest.mark.parametrize("tile", [None, (16, 12)])
@pytest.mark.parametrize(
    "rules", [{"order": "bottom-up"}, {"order": "simultaneous"}, {"preset": "woven"}], ids=str
)
def test_threads_and_strips_change_no_byte(desk, monkeypatch, tile, rules):
    deepfile.write(desk / "a.exr", noise(40, 50, 12, tidy=False, tile=tile))
    monkeypatch.chdir(desk.folder)
    made = set()
    for samples, rows, threads in ((1, 64, 1), (1, 64, 3), (4000, 7, 2), (1 << 18, 64, 1)):
        monkeypatch.setattr(deepbudget, "STRIP_SAMPLES", samples)
        monkeypatch.setattr(deepbudget, "STRIP_ROWS", rows)
        hpcomp.flatten("a.exr", "out.exr", threads=threads, **rules)
        made.add((desk / "out.exr").read_bytes())
    assert len(made) == 1


@pytest.mark.parametrize("preset", ["paper", "woven"])
def test_little_memory_changes_no_byte(desk, preset):
    deepfile.write(desk / "a.exr", noise(300, 60, 12, tidy=False, tile=(64, 50)))
    how = ("flatten", "a.exr", "--preset", preset, "-o")
    desk.makes(*how, "much.exr")
    desk.makes(*how, "little.exr", "--max-memory", "16M")
    assert (desk / "much.exr").read_bytes() == (desk / "little.exr").read_bytes()


@pytest.fixture(
    scope="module",
    params=[{"tidy": True, "volumes": False}, {"tidy": False}, {"tidy": False, "tile": (64, 128)}],
    ids=str,
)
def tiny_and_large(request, tmp_path_factory):
    """Files of few and of many samples of one kind."""
    folder = tmp_path_factory.mktemp("deep")
    for name, shape in (("tiny.exr", (4, 4, 3)), ("large.exr", (1000, 260, 14))):
        deepfile.write(folder / name, noise(*shape, **request.param))
    return folder / "tiny.exr", folder / "large.exr"


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("preset", ["paper", "woven"])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("budget", [64, 160])
def test_memory_stays_in_the_budget(tmp_path, tiny_and_large, budget, threads, preset):
    tiny, large = tiny_and_large
    out = ["-o", tmp_path / "out.exr", "--threads", threads, "--preset", preset]
    base, code, stderr = peak("flatten", tiny, *out)
    assert (code, stderr) == (0, "")
    most, code, stderr = peak("flatten", large, *out, "--max-memory", f"{budget}M")
    assert (code, stderr) == (0, "")
    assert most - base <= budget + NOISE_M


def skewed(samples, seed=0, *, apart=True):
    """32 pixels of a sample each, but for one of so many, of two labels; each at its depth or all at one."""
    rng = np.random.default_rng(seed)
    counts = np.ones((4, 8), int)
    counts[2, 3] = samples
    alpha = rng.uniform(0.0005, 0.01, counts.sum())
    labels = np.array([(1, 0.05, 0), (0, 0.1, 1)])[rng.integers(0, 2, len(alpha))]
    colors = labels * (alpha * rng.uniform(0.3, 1, len(alpha)))[:, None]
    planes = {name: plane.astype("f2") for name, plane in zip("RGB", colors.T, strict=True)}
    depth = rng.permutation(len(alpha)).astype("f4") * apart
    return Deep(counts, {**planes, "A": alpha.astype("f2"), "Z": depth})


@pytest.mark.slow
@pytest.mark.parametrize(
    "rules", [*(["--order", name] for name in ORDER_NAMES), ["--blending", "woven"]], ids=str
)
def test_thousands_of_samples_in_one_pixel_stay_in_the_budget(tmp_path, rules):
    deepfile.write(tmp_path / "tiny.exr", skewed(3))
    deepfile.write(tmp_path / "a.exr", skewed(5000))
    how = ["-o", tmp_path / "out.exr", *rules, "--depth", "float"]
    base, *_ = peak("flatten", tmp_path / "tiny.exr", *how)
    most, code, stderr = peak("flatten", tmp_path / "a.exr", *how, "--max-memory", "96M")
    assert (code, stderr) == (0, "")
    assert most - base <= 96 + NOISE_M
    # Of two hues one is left, and it is that of a label.
    red, green, blue, alpha = pixels_of(tmp_path / "out.exr")[2, 3]
    assert alpha > 0.99
    strong, weak = max(red, blue), min(red, blue)
    assert (green - weak) / (strong - weak) == pytest.approx(0.05 if red > blue else 0.1, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["points", "places", "volumes"])
@pytest.mark.parametrize("by", engine.NAMES)
def test_thousands_of_woven_samples_stay_in_the_budget(tmp_path, by, kind):
    """Points apart or in one place, and volumes of which each cuts all others, into millions of pieces."""
    number, budget = 3000, 96
    env = {engine.VARIABLE: by}
    deepfile.write(tmp_path / "tiny.exr", skewed(3))
    deep = skewed(number, apart=kind != "places")
    if kind == "volumes":
        back = 2 * number - deep.planes["Z"]
        deep = dataclasses.replace(deep, planes={**deep.planes, "ZBack": back})
    deepfile.write(tmp_path / "a.exr", deep)
    how = ["-o", tmp_path / "out.exr", "--depth", "float", "--blending", "woven"]
    base, *_ = peak("flatten", tmp_path / "tiny.exr", *how, env=env)
    most, code, stderr = peak("flatten", tmp_path / "a.exr", *how, "--max-memory", f"{budget}M", env=env)
    assert (code, stderr) == (0, "")
    assert most - base <= budget + NOISE_M
    assert pixels_of(tmp_path / "out.exr")[2, 3, 3] > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("by", engine.NAMES)
def test_thousands_of_samples_in_one_place_stay_in_the_budget(tmp_path, by):
    """What they take follows their number, in which there is no step, and not its square."""
    number, budget = {"kernel": (40_000, 64), "reference": (2000, 160)}[by]
    env = {engine.VARIABLE: by}
    deepfile.write(tmp_path / "tiny.exr", skewed(3, apart=False))
    deepfile.write(tmp_path / "a.exr", skewed(number, apart=False))
    how = ["-o", tmp_path / "out.exr", "--depth", "float"]
    base, *_ = peak("flatten", tmp_path / "tiny.exr", *how, env=env)
    most, code, stderr = peak("flatten", tmp_path / "a.exr", *how, "--max-memory", f"{budget}M", env=env)
    assert (code, stderr) == (0, "")
    assert most - base <= budget + NOISE_M
    red, green, blue, alpha = pixels_of(tmp_path / "out.exr")[2, 3]
    assert alpha > 0.99
    strong, weak = max(red, blue), min(red, blue)
    assert (green - weak) / (strong - weak) == pytest.approx(0.05 if red > blue else 0.1, abs=0.01)


@pytest.mark.parametrize("order", ["balanced", "simultaneous"])
def test_a_pixel_that_does_not_fit_names_the_least_memory(desk, order):
    deepfile.write(desk / "a.exr", skewed(5000))
    how = ("flatten", "a.exr", "-o", "x.exr", "--order", order, "--max-memory")
    line = desk.refuses(4, *how, "48M", says=["at least", "and one pixel up to 5000", "which is 48M"])
    desk.makes(*how, line.partition("at least ")[2].partition(",")[0])


@pytest.mark.slow
def test_memory_does_not_follow_the_height(tmp_path):
    """500 rows more are 46 MiB of samples; what their offsets and counts take is far less."""
    peaks = []
    for height in (100, 600):
        deepfile.write(tmp_path / "a.exr", noise(500, height, 8, volumes=False))
        most, code, _ = peak("flatten", tmp_path / "a.exr", "-o", tmp_path / "out.exr", "--threads", 1)
        assert code == 0
        peaks.append(most)
    assert peaks[1] - peaks[0] <= NOISE_M + 4


def test_a_row_that_does_not_fit_names_the_least_memory(desk):
    counts = np.ones((8, 20), int)
    counts[3, 4] = 100_000
    names = ("R", "G", "B", "A", "Z", "ZBack")
    planes = {name: np.full(counts.sum(), 0.5, "f2") for name in names}
    deepfile.write(desk / "a.exr", Deep(counts, planes, origin=(0, 5)))
    line = desk.refuses(
        4, "flatten", "a.exr", "-o", "x.exr", "--max-memory", "20M",
        says=["at least", "row 8 has 100019 samples, and one pixel up to 100000", "which is 20M"],
    )  # fmt: skip
    least = line.partition("at least ")[2].partition(",")[0]
    planes["Z"][:] = np.arange(counts.sum()) % 1000
    planes["ZBack"] = planes["Z"]
    deepfile.write(desk / "a.exr", Deep(counts, planes, origin=(0, 5)))
    desk.makes("flatten", "a.exr", "-o", "x.exr", "--max-memory", least)


# ---- settings -------------------------------------------------------------------------------


def test_defaults_are_those_of_stack(desk):
    desk.makes("flatten", "tidy.exr", "-o", "a.exr")
    hpcomp.flatten(desk / "tidy.exr", desk / "b.exr")
    desk.makes(
        "flatten", "tidy.exr", "-o", "c.exr", "--order", "bottom-up", "--blending",
        "hue-preserving", "--space", "linear-rgb", "--depth", "half", "--compression", "zip",
    )  # fmt: skip
    assert len({(desk / name).read_bytes() for name in ("a.exr", "b.exr", "c.exr")}) == 1


def test_png_pipes_and_background(desk):
    desk.makes("flatten", "tidy.exr", "-o", "a.png", "--background", "#ffffff", "--depth", "16")
    content = (desk / "tidy.exr").read_bytes()
    run = desk.makes(
        "flatten", "-", "-o", "-", "--format", "png", "--background", "#ffffff", "--depth", "16",
        stdin=content,
    )  # fmt: skip
    assert run.stdout == (desk / "a.png").read_bytes()
    run = desk.makes(
        "flatten", "-::name=smoke", "-o", "-", "--format", "exr", stdin=content
    )
    desk.makes("flatten", "tidy.exr", "-o", "b.exr")
    assert run.stdout == (desk / "b.exr").read_bytes()
    assert (pixels_of(desk / "a.png")[..., 3] == 1).all()


def test_a_layer_of_a_part(desk):
    names = ("R", "G", "B", "A", "Z", "glow.R", "glow.G", "glow.B")
    values = [[[(*RED, 1.0, 0.125, 0.25, 0.0)]]]
    near = of_pixels(values, names, name="near")
    far = of_pixels([[[(*BLUE, 1.0, 0, 0, 0)]]], names, name="far")
    deepfile.write(desk / "a.exr", near, far)
    desk.makes("flatten", "a.exr::part=near,layer=glow", "-o", "out.exr", "--depth", "float")
    assert np.abs(pixels_of(desk / "out.exr")[0, 0] - [0.125, 0.25, 0.0, 0.5]).max() < FLOAT
    desk.refuses(3, "flatten", "a.exr", "-o", "x.exr", says=["a.exr", "part= one of near, far"])
    desk.refuses(
        3, "flatten", "a.exr::part=near,layer=no", "-o", "x.exr", says=["there is (default), glow"]
    )


ALPHA_ALONE = "it has no colour, only the alpha A: its samples are black"


def without_color(deep, prefix=""):
    """The same samples with their alphas and depths alone, and these as black ones."""
    names = {n: p for n, p in deep.planes.items() if n in ("A", "Z", "ZBack")}
    black = {n: np.zeros_like(p) if n in "RGB" else p for n, p in deep.planes.items()}
    alone = {f"{prefix}{n}" if n == "A" else n: p for n, p in names.items()}
    return dataclasses.replace(deep, planes=alone), dataclasses.replace(deep, planes=black)


@pytest.mark.parametrize("tile", [None, (8, 5)])
def test_samples_with_alpha_alone_are_black(desk, tile):
    alone, black = without_color(noise(31, 23, 6, tidy=False, tile=tile))
    deepfile.write(desk / "alone.exr", alone)
    deepfile.write(desk / "black.exr", black)
    for images in (["{}.exr"], ["{}.exr", "tidy.exr"]):
        run = desk.run("flatten", *(i.format("alone") for i in images), "-o", "a.exr")
        assert (run.code, run.stderr.count("\n")) == (0, 1)
        assert f"alone.exr: {ALPHA_ALONE}" in run.stderr
        desk.makes("flatten", *(i.format("black") for i in images), "-o", "b.exr")
        assert (desk / "a.exr").read_bytes() == (desk / "b.exr").read_bytes()
    desk.refuses(3, "flatten", "alone.exr", "--strict", "-o", "x.exr", says=[ALPHA_ALONE])
    # Who names the part has seen what is in it.
    desk.makes("flatten", "alone.exr::part=0", "--strict", "-o", "x.exr")


def test_samples_with_alpha_alone_are_repacked_and_chosen_by_layer_like_others(desk):
    alone, black = without_color(noise(31, 23, 6), "fog.")
    deepfile.write(desk / "fog.exr", alone)
    deepfile.write(desk / "black.exr", black)
    deepfile.repacked(desk / "fog.exr", desk / "z.exr", OpenEXR.ZSTD_COMPRESSION)
    desk.makes("flatten", "black.exr", "-o", "b.exr")
    for image in ("fog.exr::layer=fog", "z.exr::layer=fog"):
        desk.makes("flatten", image, "-o", "a.exr")
        assert (desk / "a.exr").read_bytes() == (desk / "b.exr").read_bytes()
    run = desk.run("flatten", "z.exr", "-o", "a.exr")
    assert (run.code, run.stderr.count("only the alpha fog.A")) == (0, 1)
    desk.refuses(3, "flatten", "fog.exr::layer=smoke", "-o", "x.exr", says=["there is fog"])


@pytest.mark.parametrize("tile", [None, (8, 5)])
def test_zstd_is_repacked_first(desk, tile):
    p3 = struct.pack("<8f", *exrfile.PRIMARIES["p3d65"])
    deep = noise(31, 23, 6, tidy=False, tile=tile, attributes={"chromaticities": ("chromaticities", p3)})
    deepfile.write(desk / "a.exr", dataclasses.replace(deep, origin=(-3, 7)))
    deepfile.repacked(desk / "a.exr", desk / "z.exr", OpenEXR.ZSTD_COMPRESSION)
    desk.makes("flatten", "a.exr", "-o", "a-flat.exr")
    run = desk.run("flatten", "z.exr", "-o", "z-flat.exr", "-v")
    assert run.code == 0
    assert "z.exr is packed as zstd, and repacked first" in run.stderr
    assert (desk / "z-flat.exr").read_bytes() == (desk / "a-flat.exr").read_bytes()
    desk.makes("flatten", "-", "-o", "piped.exr", stdin=(desk / "z.exr").read_bytes())
    assert (desk / "piped.exr").read_bytes() == (desk / "a-flat.exr").read_bytes()
    assert list(desk.temporary.iterdir()) == []


def test_zstd_that_is_cut_short_or_has_no_room_is_an_error_of_one_line(desk):
    deepfile.write(desk / "a.exr", noise(120, 40, 6))
    deepfile.repacked(desk / "a.exr", desk / "z.exr", OpenEXR.ZSTD_COMPRESSION)
    content = (desk / "z.exr").read_bytes()
    (desk / "cut.exr").write_bytes(content[: len(content) * 2 // 3])
    desk.refuses(3, "flatten", "cut.exr", "-o", "x.exr", says=["cut.exr", "cannot be read"])
    script = 'mount -t tmpfs -o size=64k tmpfs "$TMPDIR"; exec "$@"'
    full = ["unshare", "--map-root-user", "--mount", "sh", "-c", script, "sh"]
    how = {"through": full, "says": ["z.exr", "is the disk full?"]}
    desk.refuses(3, "flatten", "z.exr", "-o", "x.exr", **how)
    nowhere = ["sh", "-c", 'ulimit -f 0; exec "$@"', "sh"]
    for name, output, code in (("z.exr", "x.exr", 3), ("-", "x.exr", 3), ("a.exr", "-", 5)):
        desk.refuses(code, "flatten", name, "-o", output, "--format", "exr", stdin=content,
                     through=nowhere, says=["no temporary file can be made"])  # fmt: skip


def test_what_cannot_be_flattened_is_not_repacked_first(desk):
    deepfile.write(desk / "a.exr", of_pixels([[[(0.1, 0.2, 0.3, 0.5)]]], ("R", "G", "B", "A")))
    deepfile.repacked(desk / "a.exr", desk / "z.exr", OpenEXR.ZSTD_COMPRESSION)
    run = desk.run("flatten", "z.exr", "-o", "x.exr", "-v")
    assert run.code == 3
    assert "has no depth Z" in run.stderr
    assert "repacked" not in run.stderr


@pytest.mark.parametrize("names", ["GBAZ", "RAZ"])
def test_a_colour_of_which_a_channel_is_missing_is_not_black(desk, names):
    deepfile.write(desk / "a.exr", of_pixels([[[(0.5,) * len(names)]]], tuple(names)))
    listed = ", ".join(names)
    desk.refuses(3, "flatten", "a.exr", "-o", "x.exr", says=[f"has no colour, only {listed}: "])


@pytest.mark.parametrize("missing", ["A", "Z", "RGBA"])
def test_info_says_why_a_deep_file_cannot_be_flattened(desk, missing):
    names = tuple(name for name in "RGBAZ" if name not in missing)
    deepfile.write(desk / "a.exr", of_pixels([[[(0.5,) * len(names)]]], names))
    run = desk.run("flatten", "a.exr", "-o", "x.exr")
    assert run.code == 3
    (file,) = json.loads(desk.run("info", "--json", "a.exr").stdout)["files"]
    assert run.lines == [f"hpcomp: error: {file['problem']}"]


@pytest.mark.slow
@pytest.mark.parametrize("tile", [None, (64, 128)])
def test_zstd_stays_in_the_budget(tmp_path, tile):
    peaks = []
    for size in ((4, 4, 3), (1000, 260, 14)):
        deepfile.write(tmp_path / "a.exr", noise(*size, tile=tile))
        deepfile.repacked(tmp_path / "a.exr", tmp_path / "z.exr", OpenEXR.ZSTD_COMPRESSION)
        most, *rest = peak(
            "flatten", tmp_path / "z.exr", "-o", tmp_path / "out.exr",
            "--threads", 1, "--max-memory", "64M",
        )  # fmt: skip
        assert rest == [0, ""]
        peaks.append(most)
    assert peaks[1] - peaks[0] <= 64 + NOISE_M


def test_colours_are_converted_to_the_working_primaries(desk):
    deepfile.write(desk / "a.exr", of_pixels([[[(*RED, 1, 1)]]]))
    options = ("--primaries", "acescg", "--depth", "float")
    desk.makes("flatten", "a.exr", "-o", "out.exr", *options)
    exrfile.write(desk / "flat.exr", {n: np.full((1, 1), v, "f4") for n, v in zip("RGBA", RED, strict=True)})
    desk.makes("stack", "flat.exr", "-o", "stack.exr", *options)
    assert (desk / "out.exr").read_bytes() == (desk / "stack.exr").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["tidy.exr", "--order", "1,0"], ["order '1,0'", "bottom-up, top-down"]),
        (["tidy.exr", "--order", "sideways"], ["order 'sideways'"]),
        (["tidy.exr::opacity=0.5"], ["tidy.exr", "'opacity'"]),
        (["tidy.exr::op=atop"], ["tidy.exr", "'op'"]),
        (["tidy.exr::tint=#f00"], ["tidy.exr", "'tint'"]),
        (["tidy.exr::dept=1"], ["layer key 'dept'"]),
        (["tidy.exr", "--canvas", "no"], ["canvas 'no'"]),
        (["-", "-"], ["stdin can be only one"]),
        (["tidy.exr", "--max-memory", "lots"], ["'lots'"]),
        (["tidy.exr", "--report", "a.json"], ["--report"]),
        ([], ["IMAGE..."]),
    ],
    ids=str,
)
def test_usage_errors(desk, arguments, says):
    desk.refuses(2, "flatten", *arguments, "-o", "x.exr", says=says)


def test_an_output_needs_a_format_and_its_options_have_to_fit(desk):
    desk.refuses(2, "flatten", "tidy.exr", "-o", "x", says=["x", ".png or .exr"])
    desk.refuses(2, "flatten", "tidy.exr", "-o", "x.png", "--depth", "half", says=["PNG depth"])
    desk.refuses(2, "flatten", "tidy.exr", "-o", "x.png", "--overscan", says=["--overscan"])
    desk.put("old.exr", OLD)
    desk.refuses(
        5, "flatten", "tidy.exr", "-o", "old.exr", "--no-clobber", says=["old.exr exists"]
    )
    desk.refuses(5, "flatten", "tidy.exr", "-o", "none/x.exr", says=["no directory none"])


# ---- files that are not for it --------------------------------------------------------------


def test_flat_files_belong_to_stack_and_deep_ones_to_flatten(desk):
    desk.put("flat.png", pngfile.rgba_png(np.zeros((3, 4, 4))).encode())
    exrfile.write(desk / "flat.exr", exrfile.rgba())
    for name in ("flat.png", "flat.exr"):
        desk.refuses(3, "flatten", name, "-o", "x.exr", says=[name, "is flat", "hpcomp stack"])
    for verb in (["stack"], ["check"], ["explain"]):
        rest = {"stack": ["-o", "x.exr"], "check": ["tidy.exr", "--max-grey", "1"], "explain": ["--at", "0,0"]}
        desk.refuses(
            3, *verb, "tidy.exr", *rest[verb[0]], says=["tidy.exr", "deep EXR", "hpcomp flatten"]
        )
    run = desk.run("info", "--json", "tidy.exr")
    (found,) = json.loads(run.stdout)["files"]
    assert found["parts"][0]["storage"] == "deep"
    assert "hpcomp flatten" in found["problem"]


@pytest.mark.parametrize("tile", [None, (8, 5)])
def test_a_truncated_file_leaves_what_was_there(desk, tile):
    whole = deepfile.content(noise(31, 23, 6, tile=tile))
    desk.put("out.exr", OLD)
    for share in (0.1, 0.4, 0.7, 0.99):
        desk.put("cut.exr", whole[: int(len(whole) * share)])
        desk.refuses(3, "flatten", "cut.exr", "-o", "out.exr", says=["cut.exr", "cannot be read"])
    desk.refuses(3, "flatten", "missing.exr", "-o", "out.exr", says=["missing.exr", "no such file"])
    desk.refuses(3, "flatten", desk.folder, "-o", "out.exr", says=["is a directory"])


def test_damage_in_the_last_rows_leaves_what_was_there(desk):
    content = bytearray(deepfile.content(noise(31, 90, 6)))
    content[-40:-20] = bytes(20)
    desk.put("bad.exr", bytes(content))
    desk.put("out.exr", OLD)
    desk.refuses(3, "flatten", "bad.exr", "-o", "out.exr", says=["bad.exr", "row 89", "damaged"])


def test_samples_that_are_not_finite(desk):
    deep = of_pixels([[[(*RED, 1, 1)], [(*BLUE, 2, 2), (*RED, 1, 1)]]])
    deep.planes["Z"][2] = np.nan
    deepfile.write(desk / "a.exr", deep)
    desk.refuses(4, "flatten", "a.exr", "-o", "x.exr", says=["1 sample is NaN", "pixel 1,0"])
    run = desk.run("flatten", "a.exr", "-o", "x.exr", "--nonfinite", "zero")
    assert run.code == 0
    assert run.lines == ["hpcomp: warning: a.exr: 1 sample is NaN or infinite, and left out"]
    assert np.abs(pixels_of(desk / "x.exr")[0] - [RED, BLUE]).max() < HALF
    (desk / "x.exr").unlink()
    desk.refuses(
        4, "flatten", "a.exr", "-o", "x.exr", "--nonfinite", "zero", "--strict", says=["left out"]
    )
    desk.makes("flatten", "a.exr", "-o", "x.exr", "--nonfinite", "keep")
    assert np.isfinite(pixels_of(desk / "x.exr")).all()


# ---- how it talks ---------------------------------------------------------------------------


def test_verbose_says_what_is_done_and_help_what_can_be(desk):
    run = desk.run("flatten", "tidy.exr", "-o", "out.exr", "-v")
    assert run.code == 0
    assert f"{noise(31, 23, 6).counts.sum()} samples, up to 6 in a pixel" in run.stderr
    assert f"engine {engine.active().name}" in run.stderr
    run = desk.run("flatten", "--help")
    assert run.code == 0
    assert "hpcomp flatten smoke.exr -o smoke.png" in run.stdout.decode()
    assert b"flatten" in desk.run("--help").stdout


def test_an_interrupted_pipe_ends_quietly(desk):
    through = shell('"$@" | head -c 10; exit 0')
    run = desk.run("flatten", "tidy.exr", "-o", "-", "--format", "exr", through=through)
    assert (run.code, len(run.stdout), run.stderr) == (0, 10, "")


def test_python_takes_one_file_or_several_and_says_what_it_wrote(desk):
    for images in (desk / "tidy.exr", str(desk / "tidy.exr"), [hpcomp.LayerSpec(str(desk / "tidy.exr"))]):
        result = hpcomp.flatten(images, desk / "out.exr")
        assert result.output == str(desk / "out.exr")
        assert str(result.canvas) == str(result.data_window) == "31x23+0+0"
        assert result.findings is None
    with pytest.raises(hpcomp.SettingError, match="nothing to flatten"):
        hpcomp.flatten([], desk / "out.exr")
    with pytest.raises(hpcomp.SettingError, match="nonfinite"):
        hpcomp.flatten(desk / "tidy.exr", desk / "out.exr", nonfinite="no")


# ---- many in one place -----------------------------------------------------------------------


@pytest.mark.parametrize("volume", [False, True])
def test_many_samples_in_one_place_keep_a_hue_of_its_own_in_whatever_order(tmp_path, volume):
    """More samples than pixels have side by side: two shades of red, and as many of a weaker blue."""
    rng = np.random.default_rng(0)
    samples = []
    for number in range(200):
        share = rng.uniform(0.5, 1)
        red, blue = (0.02 * share, 0.001 * share, 0, 0.03), (0, 0, 0.008 * share, 0.03)
        depth = (1, 2 + number % 7) if volume else (1, 1)
        samples += [(*red, *depth), (*blue, *depth)]
    made = {}
    for name, order in (("one", samples), ("other", [samples[i] for i in rng.permutation(len(samples))])):
        deepfile.write(tmp_path / "many.exr", of_pixels([[order, samples[:3]]]))
        for blending in ("hue-preserving", "traditional"):
            path = tmp_path / f"{name}-{blending}.exr"
            hpcomp.flatten(tmp_path / "many.exr", path, depth="float", blending=blending)
            made[name, blending] = path.read_bytes()
    assert made["one", "hue-preserving"] == made["other", "hue-preserving"]
    kept = pixels_of(tmp_path / "one-hue-preserving.exr")[0, 0]
    plain = pixels_of(tmp_path / "one-traditional.exr")[0, 0]
    weights = np.array([0.2126, 0.7152, 0.0722])
    assert kept[3] == pytest.approx(plain[3], abs=FLOAT)
    assert weights @ kept[:3] == pytest.approx(weights @ plain[:3], rel=1e-4)
    red, green, blue = kept[:3]
    assert red > blue  # red has more chroma, and is as it was in the place of the first volumes
    assert (green - blue) / (red - blue) == pytest.approx(0.001 / 0.02, abs=0.01)
