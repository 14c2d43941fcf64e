"""The memory that commands take: peaks of their process, measured from outside."""

from __future__ import annotations

import re
import subprocess
import zlib
from functools import cache

import exrfile
import numpy as np
import pngfile
import processes
import pytest
from command import command
from processes import NOISE_M

import hpcomp
from hpcomp.engine import choice as engine

ENDINGS = ["png", "exr"]
WIDTH = 3000


def png_bytes(width, height, interlaced=False):
    """RGBA of smooth columns, so that all rows are one and deflate to next to nothing."""
    x = np.arange(width)
    row = np.stack(
        [x * 255 // width, 255 - x * 255 // width, x * 0 + 60, 128 + x * 127 // width], -1
    )
    if interlaced:
        samples = np.broadcast_to(row, (height, width, 4))
        return pngfile.Png(samples, pngfile.RGBA, 8, interlaced=True).encode()
    raster = (b"\0" + row.astype("u1").tobytes()) * height
    chunks = pngfile.rgba_png(np.zeros((1, 1, 4))).chunks()
    header = width.to_bytes(4, "big") + height.to_bytes(4, "big") + chunks[0][1][8:]
    return pngfile.join([(b"IHDR", header), (b"IDAT", zlib.compress(raster, 1)), (b"IEND", b"")])


def planes(width, height, dtype=np.float16):
    """Premultiplied RGBA of smooth columns."""
    x = np.linspace(0, 1, width)
    alpha = 0.5 + 0.5 * x
    rows = {"R": x * alpha, "G": (1 - x) * alpha, "B": 0.25 * alpha, "A": alpha}
    return {
        name: np.ascontiguousarray(np.broadcast_to(row.astype(dtype), (height, width)))
        for name, row in rows.items()
    }


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """name -> path of a layer, made when it is asked for first."""
    folder = tmp_path_factory.mktemp("files")
    recipes = {
        "tiny.png": lambda path: path.write_bytes(png_bytes(16, 16)),
        "tiny.exr": lambda path: exrfile.write(path, planes(16, 16)),
        "tiny interlaced.png": lambda path: path.write_bytes(png_bytes(16, 16, interlaced=True)),
        "wide.png": lambda path: path.write_bytes(png_bytes(WIDTH, 300)),
        "wide.exr": lambda path: exrfile.write(path, planes(WIDTH, 300)),
        "tall.png": lambda path: path.write_bytes(png_bytes(WIDTH, 1200)),
        "tall.exr": lambda path: exrfile.write(path, planes(WIDTH, 1200)),
        "float.exr": lambda path: exrfile.write(path, planes(WIDTH, 300, np.float32)),
        "noise.exr": lambda path: exrfile.write(
            path, exrfile.planes("RGBA", WIDTH, 300), compression="none"
        ),
        "interlaced.png": lambda path: path.write_bytes(png_bytes(1500, 400, interlaced=True)),
        "blocks.exr": lambda path: exrfile.write(path, planes(1000, 512), compression="dwab"),
        "tiles.exr": lambda path: exrfile.write(path, planes(1000, 512), tile=(256, 256)),
        "narrow.exr": lambda path: exrfile.write(path, planes(500, 1500)),
        "narrow tall.exr": lambda path: exrfile.write(path, planes(500, 6000)),
    }

    @cache
    def path(name):
        recipes[name](folder / name)
        return folder / name

    return path


def run(layers, out, *options, env=None):
    """(peak resident MiB, exit code, stderr)."""
    return processes.peak("stack", *layers, "-o", out, *options, env=env)


@pytest.fixture
def peak(files, tmp_path):
    """peak(layers, ending, budget, threads, *options): MiB above the same run of tiny layers."""

    def measured(names, ending, memory, threads, *options, env=None):
        options = (*options, "--threads", threads)
        layers, tiny = [], []
        for name in names:
            name, colons, settings = name.partition("::")
            layers.append(f"{files(name)}{colons}{settings}")
            # Of the same kind, so that the same libraries are loaded.
            small = "tiny interlaced.png" if "interlaced" in name else f"tiny.{name[-3:]}"
            tiny.append(f"{files(small)}{colons}{settings}")
        base, code, stderr = run(tiny, tmp_path / f"tiny.{ending}", *options, env=env)
        assert (code, stderr) == (0, "")
        most, code, stderr = run(
            layers, tmp_path / f"out.{ending}", *options, "--max-memory", f"{memory}M", env=env
        )
        assert (code, stderr) == (0, "")
        return most - base

    return measured


# ---- many small layers ----------------------------------------------------------------------


def column(folder, number, height):
    """Layers one below the other, their canvas among the options."""
    rng = np.random.default_rng(3)
    words = []
    for k in range(number):
        pixels = np.full((height, 64, 4), 0.5, np.float32)
        pixels[..., :3] *= rng.random((height, 64, 3))
        hpcomp.write_image(folder / f"{k}.png", pixels)
        words.append(f"{folder / str(k)}.png::at=+0+{k * height}")
    return [*words, "--canvas", f"64x{number * height}+0+0"]


def test_layers_below_each_other_take_what_one_strip_meets(tmp_path):
    """In one place all their files are open at once."""
    words = column(tmp_path, 300, 70)
    options = ("--threads", 1, "--max-memory", "16M")
    out = tmp_path / "out.exr"
    base, code, _ = run(words[:1], out, *words[-2:], *options)
    assert code == 0
    most, code, stderr = run(words[:-2], out, *words[-2:], *options)
    assert (code, stderr) == (0, "")
    assert most - base < 16
    together = [word.partition("::")[0] for word in words[:-2]]
    _, code, stderr = run(together, out, *options)
    assert code == 4
    assert int(re.search(r"needs at least (\d+)M", stderr)[1]) > 40


def test_a_file_is_open_from_its_first_row_to_its_last_one(tmp_path):
    words = column(tmp_path, 80, 200)
    done = subprocess.run(
        ["sh", "-c", 'ulimit -n 40; exec "$@"', "sh", *command("stack", *words, "-o", tmp_path / "out.png")],
        capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")


# ---- the budget -----------------------------------------------------------------------------


@pytest.mark.pairwise
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("name", ["wide.png", "wide.exr"])
def test_four_layers_stay_in_the_budget(peak, name, ending, threads):
    assert peak([name] * 4, ending, 48, threads) <= 48


@pytest.mark.singly
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", ["wide.png", "wide.exr", "float.exr"])
def test_small_budget(peak, name, threads):
    """Strips of a few rows, where what does not depend on rows counts most."""
    assert peak([name] * 4, "exr", 20, threads) <= 20


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("engine_name", list(dict.fromkeys([engine.active().name, "reference"])))
@pytest.mark.parametrize("threads", [1, 2])
def test_budget_of_every_engine(peak, engine_name, threads):
    env = {"HPCOMP_ENGINE": engine_name}
    for space in ("linear-rgb", "oklab"):
        used = peak(
            ["wide.png", "wide.exr"] * 2, "exr", 40, threads, "--space", space, env=env
        )
        assert used <= 40


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("engine_name", list(dict.fromkeys([engine.active().name, "reference"])))
@pytest.mark.parametrize("threads", [1, 2])
def test_a_report_in_a_space_that_numpy_measures(peak, engine_name, threads, tmp_path):
    env = {"HPCOMP_ENGINE": engine_name}
    options = ("--space", "cielab", "--order", "balanced", "--report", tmp_path / "made.json")
    assert peak(["wide.png", "wide.exr"] * 3, "exr", 80, threads, *options, env=env) <= 80


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["wide.exr::colorspace=srgb", "wide.exr::colorspace=acescg", "wide.exr::alpha=straight",
     "wide.exr::alpha=luminance", "wide.png::alpha=premultiplied-encoded",
     "wide.png::colorspace=display-p3"],
)  # fmt: skip
def test_layers_that_take_more_decoding(peak, name):
    assert peak([name] * 3, "exr", 48, 2) <= 48


@pytest.mark.parametrize("compression", ["none", "piz", "b44", "dwaa"])
def test_output_that_takes_more_encoding(peak, compression):
    assert peak(["wide.png"] * 2, "exr", 48, 2, "--compression", compression) <= 48


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("budget", [None, 192, 320])
def test_output_in_blocks_of_256_rows(peak, files, tmp_path, budget, threads):
    """DWAB takes the most of all: several blocks at once, each with tables of its own."""
    options = "--compression", "dwab"
    if budget is None:
        layers = [files("tall.exr")] * 2
        out = tmp_path / "out.exr"
        _, _, stderr = run(layers, out, *options, "--threads", threads, "--max-memory", "256K")
        budget = int(re.search(r"at least (\d+)M", stderr)[1])
    assert peak(["tall.exr"] * 2, "exr", budget, threads, *options) <= budget


@pytest.mark.parametrize("compression", ["piz", "b44", "htj2k32"])
def test_output_in_many_threads(peak, compression):
    """Each thread of OpenEXR has blocks of its own."""
    assert peak(["tall.exr"] * 2, "exr", 64, 8, "--compression", compression) <= 64


@pytest.mark.parametrize("compression", ["none", "zips", "zip"])
def test_output_that_does_not_shrink(peak, compression):
    """Noise is stored as it is: there is a second copy of the strip until it is written."""
    options = "--depth", "float", "--compression", compression
    assert peak(["noise.exr"] * 2, "exr", 32, 4, *options) <= 32


@pytest.mark.slow
@pytest.mark.parametrize("order", ["balanced", "simultaneous", "permutation"])
def test_orders_that_hold_every_layer(peak, order):
    """They take more for each layer, out of shorter strips."""
    if order == "permutation":
        order = ",".join(map(str, [1, 0, *range(2, 24)]))
    assert peak(["wide.exr"] * 24, "exr", 64, 2, "--order", order) <= 64


# ---- what does not matter -------------------------------------------------------------------


@pytest.mark.singly
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("ending", ENDINGS)
def test_height_does_not_matter(peak, ending, threads):
    """Four times the rows; as a picture they would take 41 MiB more for each layer."""
    low = peak([f"wide.{ending}"] * 2, ending, 32, threads)
    high = peak([f"tall.{ending}"] * 2, ending, 32, threads)
    # With two threads it depends a little on how far reading and writing are apart.
    assert high - low <= 12


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("order", ["bottom-up", "top-down"])
def test_number_of_layers_does_not_matter(peak, order, threads):
    """Only what an open file takes: a strip of 64 rows of each more would be 60 MiB."""
    few, many = (
        # How far two threads are apart changes a peak by some MiB from run to run.
        sorted(peak(["wide.exr"] * n, "exr", 64, threads, "--order", order) for _ in range(3))
        for n in (4, 24)
    )
    assert max(many) <= 64
    assert many[1] - few[1] <= 20 * 1.0


# ---- reports --------------------------------------------------------------------------------


@pytest.fixture(params=["json", "html", "provenance"])
def told(request, tmp_path):
    """Options for something that a stack is to tell beside its picture."""
    if request.param == "provenance":
        return "--provenance", tmp_path / "told.exr"
    return "--report", tmp_path / f"told.{request.param}"


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", ["wide.png", "wide.exr"])
def test_reports_of_four_layers_stay_in_the_budget(peak, told, name, threads):
    assert peak([name] * 4, "exr", 48, threads, *told) <= 48


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("order", ["bottom-up", "top-down", "simultaneous"])
def test_reports_of_many_layers_stay_in_the_budget(peak, told, order):
    """All layers of a strip are looked at together, whatever the order, and decoded for that."""
    layers = ["wide.exr", "wide.exr::colorspace=srgb"] * 12
    assert peak(layers, "exr", 112, 2, "--order", order, *told) <= 112


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("threads", [1, 2])
def test_height_does_not_matter_to_a_report(peak, told, threads):
    """Four times the rows; whole, the three layers would take 50 MiB more. A page's pictures have
    a largest size, whatever the canvas."""
    low = peak(["narrow.exr"] * 3, "exr", 56, threads, *told)
    high = peak(["narrow tall.exr"] * 3, "exr", 56, threads, *told)
    assert high - low <= 12


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("engine_name", list(dict.fromkeys([engine.active().name, "reference"])))
def test_minimum_of_a_report(peak, files, tmp_path, told, engine_name):
    env = {"HPCOMP_ENGINE": engine_name}
    layers, options = [files("wide.exr")] * 3, ("--threads", 2, *told)
    _, code, stderr = run(
        layers, tmp_path / "out.exr", *options, "--max-memory", "256K", env=env
    )
    assert code == 4
    least = int(re.search(r"needs at least (\d+)M", stderr)[1])
    assert peak(["wide.exr"] * 3, "exr", least, 2, *told, env=env) <= least + NOISE_M


# ---- the least ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", ["interlaced.png", "blocks.exr", "tiles.exr", "wide.exr"])
def test_minimum(peak, files, tmp_path, name, threads):
    """A smaller budget is refused with the least that there must be, which is enough."""
    layers, out = [files(name)] * 3, tmp_path / "out.exr"
    out.write_bytes(b"old")
    _, code, stderr = run(layers, out, "--threads", threads, "--max-memory", "256K")
    assert code == 4
    assert stderr.count("\n") == 1
    found = re.search(r"^hpcomp: error: .*needs at least (\d+)M.*--max-memory", stderr)
    assert found, stderr
    assert out.read_bytes() == b"old"
    least = int(found[1])
    _, code, stderr = run(
        layers, out, "--threads", threads, "--max-memory", f"{(least - 1) * 1024}K"
    )
    assert code == 4
    assert f"at least {least}M" in stderr
    assert peak([name] * 3, "exr", least, threads) <= least + NOISE_M


def test_minimum_of_an_interlaced_png_is_the_picture(files, tmp_path):
    """It has to be decoded as a whole: 1500×400 RGBA are 2.3 MiB for each of eight."""
    layers = [files("interlaced.png")] * 8
    _, code, stderr = run(layers, tmp_path / "out.png", "--max-memory", "16M")
    assert code == 4
    assert int(re.search(r"at least (\d+)M", stderr)[1]) >= 18


def test_minimum_is_no_more_than_it_takes(files, tmp_path):
    """An estimate that is far too high would refuse what could be made."""
    layers = [files("wide.exr")] * 4
    _, code, stderr = run(layers, tmp_path / "out.exr", "--threads", 1, "--max-memory", "16M")
    assert (code, stderr) == (0, "")


# ---- commands that write no picture ---------------------------------------------------------


def arguments(command, path, at):
    """A command, and how it reads a file: `check` reads four in all, and `explain` three."""
    return {
        "check": ["check", path, path, path, path, "--max-foreign", "1"],
        "check hues": ["check", path, "--hues", "0,120,240", "--max-foreign", "1"],
        "hues": ["hues", path, "--format", "json"],
        "explain": ["explain", path, path, path, "--at", at],
    }[command]


COMMANDS = ["check", "check hues", "hues", "explain"]


@pytest.fixture
def reading_peak(files):
    """reading_peak(command, name, budget, threads, *options): as `peak`."""

    def measured(command, name, memory, threads, *options):
        path, colons, settings = name.partition("::")
        settings = f"{colons}{settings}"
        small = "tiny interlaced.png" if "interlaced" in name else f"tiny.{path[-3:]}"
        options = (*options, "--threads", threads)
        base, *end = processes.peak(*arguments(command, f"{files(small)}{settings}", "3,3"), *options)
        assert end == [0, ""]
        most, *end = processes.peak(
            *arguments(command, f"{files(path)}{settings}", "450,250"), *options,
            "--max-memory", f"{memory}M",
        )  # fmt: skip
        assert end == [0, ""]
        return most - base

    return measured


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("threads", [1, 5])
@pytest.mark.parametrize(
    "name",
    ["tall.png", "tall.exr", "float.exr", "noise.exr", "interlaced.png", "blocks.exr",
     "tall.exr::colorspace=acescg", "tall.png::alpha=premultiplied-encoded",
     "wide.exr::alpha=luminance"],
)  # fmt: skip
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_that_reads_stays_in_the_budget(reading_peak, command, name, threads):
    """Of the tall ones the check would take 50 MiB as they are stored, and 200 as it decodes them."""
    assert reading_peak(command, name, 48, threads) <= 48


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_that_reads_stays_in_a_small_budget(reading_peak, command):
    assert reading_peak(command, "tall.exr", 24, 2) <= 24


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("space", ["oklab", "cielab"])
@pytest.mark.parametrize("command", ["check", "hues"])
def test_a_space_that_is_not_linear_stays_in_the_budget(reading_peak, command, space):
    assert reading_peak(command, "tall.png", 48, 2, "--space", space) <= 48


@pytest.mark.slow
@pytest.mark.singly
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", ["interlaced.png", "blocks.exr", "tiles.exr", "wide.exr"])
@pytest.mark.parametrize("command", COMMANDS)
def test_minimum_of_a_command_that_reads(reading_peak, files, command, name, threads):
    asked = [*arguments(command, files(name), "450,250"), "--threads", threads, "--max-memory"]
    _, code, stderr = processes.peak(*asked, "64K")
    assert code == 4
    assert stderr.count("\n") == 1
    found = re.search(r"^hpcomp: error: .*needs at least (\d+)M.*: raise --max-memory, which is 0M", stderr)
    assert found, stderr
    least = int(found[1])
    _, code, stderr = processes.peak(*asked, f"{(least - 1) * 1024}K")
    assert code == 4
    assert f"at least {least}M" in stderr
    assert reading_peak(command, name, least, threads) <= least + NOISE_M
