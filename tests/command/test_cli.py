"""The `hpcomp` command as a shell meets it: exit codes, messages, what it leaves behind."""

from __future__ import annotations

import ast
import contextlib
import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import zlib
from unittest import mock

import click
import exrfile
import numpy as np
import OpenImageIO as oiio
import oracle
import pngfile
import pytest
from command import COMMAND, OLD, PATIENCE_S, Desk, command, hpcomp, shell, snapshot
from processes import INTERRUPTIBLE, SIGNALS, assert_ended, running, temporary_of

import hpcomp as package
from hpcomp.cli import group
from hpcomp.cli.frontpage import COMMANDS
from hpcomp.cli.options import shown_names
from hpcomp.cli.signals import ENDING
from hpcomp.errors import EXIT_CODE_MEANINGS

SIZE = 10, 8

# Drops root's privilege to read and write where the permissions say no, and keeps everything else,
# so that an interpreter in a folder of root's can still be read. For others it changes nothing.
POWERLESS = [
    sys.executable,
    "-ISc",
    "import ctypes, os, sys\n"
    "PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH = 24, 1, 2\n"
    "for capability in CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH:\n"
    "    ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, capability, 0, 0, 0)\n"
    "os.execv(sys.argv[1], sys.argv[1:])",
]


def flat(red, green, blue, alpha, size=SIZE, depth=8):
    """A PNG of one colour."""
    samples = np.empty((size[1], size[0], 4), int)
    samples[:] = red, green, blue, alpha
    return pngfile.rgba_png(samples, depth)


def planes(value=0.5, size=SIZE, names="RGBA", dtype=np.float16):
    return {name: np.full((size[1], size[0]), value, dtype) for name in names}


@pytest.fixture
def desk(tmp_path):
    """base.png, opaque; top.png, half transparent; base.exr and top.exr; outputs that stand."""
    desk = Desk.made(tmp_path)
    desk.put("base.png", flat(200, 40, 40, 255).encode())
    desk.put("top.png", flat(40, 40, 200, 128).encode())
    exrfile.write(desk / "base.exr", planes(1.0))
    exrfile.write(desk / "top.exr", planes(0.5))
    for name in ("out.png", "out.exr"):
        os.utime(desk.put(name, OLD), ns=(10**18, 10**18))
    return desk


def png_size(data):
    kind, header = pngfile.split(data)[0]
    assert kind == b"IHDR"
    return int.from_bytes(header[:4], "big"), int.from_bytes(header[4:8], "big")


# ---- the process and the call ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "arguments"),
    [
        (0, ["stack", "base.png", "-o", "-", "--format", "png"]),
        (0, ["info", "base.png", "top.exr"]),
        (2, ["stack", "base.png"]),
        (2, ["stack", "base.png", "-o", "out.png", "--op", "above"]),
        (3, ["stack", "nowhere.png", "-o", "out.png"]),
        (3, ["info", "nowhere.png"]),
        (4, ["stack", "base.png", "top.png::at=+100+0", "-o", "out.png", "--canvas", "intersection"]),
        (4, ["stack", "base.png", "-o", "out.png", "--max-memory", "1"]),
        (5, ["stack", "base.png", "-o", "nowhere/out.png"]),
        (5, ["hues", "base.png", "-o", "out.png", "--no-clobber"]),
        (6, ["check", "base.png", "--hues", "120", "--max-foreign", "0"]),
        (6, ["check", "base.png", "top.png", "--require-hue", "layer:0"]),
    ],
)
def test_a_process_ends_as_a_call_in_this_one_does(desk, code, arguments):
    """Other tests may therefore call it here, which takes a tenth of the time."""
    called = desk.run(*arguments)
    assert desk.run(*arguments, process=True) == called
    assert called.code == code


def test_a_bug_is_one_line_that_asks_for_a_report(desk, monkeypatch):
    def broken():
        raise RuntimeError("a wheel is off\nand rolls away")

    monkeypatch.setattr(group, "cli", click.Command("hpcomp", callback=broken))
    run = desk.run()
    said = "RuntimeError: a wheel is off and rolls away; please report it with what --debug prints"
    assert (run.code, run.stdout, run.stderr) == (1, b"", f"hpcomp: bug: {said}\n")


# ---- bad input: files -----------------------------------------------------------------------


def truncated_png(desk):
    return desk.put(
        "bad.png", pngfile.random_png(pngfile.RGBA, 8, width=SIZE[0], height=SIZE[1]).encode()[:-30]
    )


def truncated_exr(desk):
    data = exrfile.write(desk / "bad.exr", exrfile.coarse("RGBA", *SIZE)).read_bytes()
    return desk.put("bad.exr", data[:-30])


def undecodable_png(desk):
    """Every checksum is right, and the compressed data end too early."""
    data = pngfile.random_png(pngfile.RGBA, 8, width=SIZE[0], height=SIZE[1])
    short = zlib.compress(data.raster()[: len(data.raster()) // 2])
    return desk.put("bad.png", pngfile.replace_chunk(data.encode(), b"IDAT", short))


def flipped_exr(desk):
    path = exrfile.write(desk / "bad.exr", exrfile.coarse("RGBA", *SIZE))
    data = path.read_bytes()
    begin, end = exrfile.regions(data)["pixels"][-1]
    return desk.put("bad.exr", pngfile.flip_bit(data, (begin + end) // 2, 4))


def other_format(desk, ending, name=None):
    path = desk / f"other.{ending}"
    spec = oiio.ImageSpec(*SIZE, 3, oiio.UINT8)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec)
    assert out.write_image(np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    assert out.close()
    return path.rename(desk / name) if name else path


def directory(desk):
    (desk / "bad.png").mkdir()
    return desk / "bad.png"


def exr_without_colour(desk):
    return exrfile.write(desk / "bad.exr", planes(names=["Z", "A", "id"]))


def subsampled_exr(desk):
    width, height = SIZE
    chroma = np.full((height // 2, width // 2), 0.1, np.float16)
    data = exrfile.raw_bytes(
        {"Y": planes()["R"], "RY": chroma, "BY": chroma}, SIZE,
        sampling={"RY": (2, 2), "BY": (2, 2)},
    )  # fmt: skip
    return desk.put("bad.exr", data)


BAD_FILES = {
    "missing": (lambda desk: desk / "bad.png", ["no such file"]),
    "missing folder": (lambda desk: desk / "nowhere" / "bad.exr", ["no such file"]),
    "directory": (directory, ["is a directory", "name a PNG or EXR file"]),
    "empty": (lambda desk: desk.put("bad.png", b""), ["is empty"]),
    "empty EXR": (lambda desk: desk.put("bad.exr", b""), ["is empty"]),
    "truncated PNG": (truncated_png, ["truncated PNG"]),
    "truncated EXR": (truncated_exr, ["cannot be read"]),
    "PNG of too few data": (undecodable_png, ["cannot be read"]),
    "flipped bit in EXR": (flipped_exr, ["cannot be read, rows"]),
    "text": (lambda desk: desk.put("bad.png", b"hello, world\n" * 40), ["neither a PNG nor an EXR"]),
    "TIFF": (lambda desk: other_format(desk, "tif"), ["is a TIFF file: convert it", "oiiotool"]),
    "JPEG": (lambda desk: other_format(desk, "jpg"), ["is a JPEG file: convert it", "oiiotool"]),
    "TIFF as .png": (lambda desk: other_format(desk, "tif", "bad.png"), ["is a TIFF file: convert it", "oiiotool"]),
    "JPEG as .exr": (lambda desk: other_format(desk, "jpg", "bad.exr"), ["is a JPEG file: convert it", "oiiotool"]),
    "EXR without colour": (exr_without_colour, ["no colour", "Z", "id", "R, G, B or Y"]),
    "subsampled EXR": (subsampled_exr, ["RY", "BY", "subsampled", "store it as RGB"]),
    "deep EXR": (
        lambda desk: exrfile.write_deep(desk / "bad.exr", *SIZE), ["deep EXR", "flatten it"]
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", list(BAD_FILES))
def test_file_that_is_no_layer(desk, kind):
    make, words = BAD_FILES[kind]
    path = make(desk)
    out = "out.exr" if path.suffix == ".exr" else "out.png"
    name = str(path.relative_to(desk.folder))
    desk.refuses(3, "stack", "base.png", name, "-o", out, says=["layer 1", name, *words])


def test_info_describes_an_exr_that_is_subsampled(desk):
    """It holds no layer, and so `info` says what it holds, and why none of it is read."""
    subsampled_exr(desk)
    run = desk.run("info", "bad.exr")
    assert (run.code, run.stderr) == (0, "")
    text = run.stdout.decode()
    for words in ("cannot be read as it is", "store it as RGB", "RY half for every 2x2 pixels"):
        assert words in text
    (file,) = json.loads(desk.run("info", "--json", "bad.exr").stdout)["files"]
    assert file["read_as"] is None
    assert "subsampled" in file["problem"]
    samplings = {c["name"]: c["sampling"] for c in file["parts"][0]["channels"]}
    assert samplings == {"BY": [2, 2], "RY": [2, 2], "Y": [1, 1]}


def flips():
    """One flipped bit in each chunk of a PNG, in its data or, where it has none, in its CRC."""
    png = pngfile.random_png(pngfile.PALETTE, 8, transparent=True, width=SIZE[0], height=SIZE[1])
    data = png.with_chunks(
        head=[pngfile.gama(45455)], body=[pngfile.phys(3000, 3000)], tail=[pngfile.text("a", "b")]
    ).encode()
    for kind, begin, end in pngfile.chunk_spans(data):
        place = (begin + 8 + end) // 2  # the first 8 bytes are its length and its name
        yield pytest.param(pngfile.flip_bit(data, place, 2), kind, id=kind.decode())


@pytest.mark.parametrize(("content", "kind"), list(flips()))
def test_flipped_bit_in_any_chunk_of_a_png(desk, content, kind):
    desk.put("bad.png", content)
    arguments = ["stack", "base.png", "bad.png", "-o", "out.png"]
    says = ["layer 1", "bad.png", kind.decode()]
    if kind in (b"pHYs", b"tEXt"):  # the picture does not depend on them
        run = desk.run(*arguments)
        assert (run.code, run.stderr.count("\n")) == (0, 1)
        assert all(words in run.stderr for words in ("warning", *says))
        arguments.append("--strict")
        (desk / "out.png").unlink()
    desk.refuses(3, *arguments, says=says)


@pytest.mark.parametrize("name", ["bad.png", "bad.exr"])
def test_file_that_may_not_be_read(desk, name):
    shutil.copy(desk / f"base{name[3:]}", desk / name)
    os.chmod(desk / name, 0)
    desk.refuses(
        3, "stack", name, "-o", "out.png", through=POWERLESS, says=[name, "permission denied"]
    )


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("", ["2 parts fit", "part=", "left", "right"]),
        ("::part=middle", ["middle", "part=", "left", "right", "depth"]),
        ("::part=3", ["'3'", "left", "right", "depth"]),
        ("::part=depth", ["no colour", "Z"]),
        ("::part=left,layer=glow", ["glow", "(default)", "diffuse"]),
        ("::layer=glow", ["glow", "diffuse"]),
    ],
)
def test_part_or_layer_that_is_not_there(desk, setting, words):
    exrfile.write_parts(
        desk / "parts.exr",
        [
            ("left", planes(names=["R", "G", "B", "diffuse.R", "diffuse.G", "diffuse.B"]), {}),
            ("right", planes(), {}),
            ("depth", planes(names=["Z"]), {}),
        ],
    )
    desk.refuses(
        3, "stack", "base.exr", f"parts.exr{setting}", "-o", "out.exr",
        says=["layer 1", "parts.exr", *words],
    )  # fmt: skip


def test_layer_of_a_png(desk):
    desk.refuses(3, "stack", "base.png::layer=glow", "-o", "out.png", says=["layer 0", "glow"])


def test_named_layer_is_called_by_its_name(desk):
    desk.refuses(
        3, "stack", "base.png", "nowhere.png::name=roads", "-o", "out.png",
        says=["layer 1", "roads", "nowhere.png"],
    )  # fmt: skip


# ---- bad input: pixels and windows ----------------------------------------------------------


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("channel", "RA")
def test_pixels_that_are_not_finite(desk, value, channel):
    """They are refused with the place of the first and the count, and named ways out work."""
    broken = planes(0.25)
    broken[channel][5, 3] = value
    broken[channel][6, 2] = value
    exrfile.write(desk / "bad.exr", broken, origin=(100, 200))
    arguments = "stack", "bad.exr", "-o", "out.exr"
    line = desk.refuses(4, *arguments, says=["layer 0 (bad.exr)", "2 pixels", "103,205"])
    assert "--nonfinite zero or keep" in line

    run = desk.run(*arguments, "--nonfinite", "zero")
    assert run.code == 0
    assert run.lines == [run.stderr.rstrip("\n")]
    assert run.stderr.startswith("hpcomp: warning: layer 0 (bad.exr): 2 pixels are NaN or infinite")
    pixels = exrfile.read_back(desk / "out.exr")["A"]
    assert pixels[5, 3] == pixels[6, 2] == 0
    assert np.all(np.isfinite(pixels))

    run = desk.run(*arguments, "--nonfinite", "keep")
    assert (run.code, run.stderr) == (0, "")


def test_strict_makes_nonfinite_pixels_that_became_zero_an_error(desk):
    broken = planes(0.25)
    broken["G"][5, 3] = np.nan
    exrfile.write(desk / "bad.exr", broken)
    desk.refuses(
        4, "stack", "bad.exr", "-o", "out.exr", "--nonfinite", "zero", "--strict",
        says=["layer 0 (bad.exr)", "1 pixel is NaN", "--strict"],
    )  # fmt: skip


def test_layer_that_does_not_fit_the_canvas(desk):
    desk.put("small.png", flat(0, 0, 0, 255, (3, 2)).encode())
    desk.refuses(
        4, "stack", "base.png", "small.png", "-o", "out.png",
        says=["layer 1 (small.png) is 3x2", "canvas is 10x8", "at=+X+Y", "--canvas"],
    )  # fmt: skip


def test_layers_without_a_common_pixel(desk):
    desk.refuses(
        4, "stack", "base.png", "top.png::at=+10+0", "-o", "out.png", "--canvas", "intersection",
        says=["layer 1 (top.png)", "at=+X+Y", "--canvas"],
    )  # fmt: skip


def test_region_outside_the_canvas(desk):
    desk.refuses(
        4, "stack", "base.png", "-o", "out.png", "--region", "5x5+6+0",
        says=["5x5+6+0", "10x8+0+0"],
    )  # fmt: skip


# ---- bad input: settings --------------------------------------------------------------------

OPERATORS = ["clear", "src", "copy", "dst", "over", "src-over", "dst-over", "under", "in", "src-in", "dst-in", "mask", "out", "src-out", "dst-out", "stencil", "atop", "src-atop", "dst-atop", "xor", "plus", "add", "lighter"]
KEYS = ["op", "opacity", "at", "alpha", "colorspace", "part", "layer", "name"]
GRAVITIES = ["north", "north-west", "center", "east", "south-east"]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ("op=blend", ["'blend'", *OPERATORS]),
        ("op=", ["op=", "key=value"]),
        ("op", ["'op'", "key=value"]),
        ("color=red", ["'color'", *KEYS]),
        ("opacity=1.01", ["1.01", "0 to 1"]),
        ("opacity=-0.01", ["-0.01", "0 to 1"]),
        ("opacity=nan", ["nan", "0 to 1"]),
        ("opacity=50%", ["50%", "0 to 1"]),
        ("opacity=0.5,opacity=0.5", ["opacity", "twice"]),
        (
            "alpha=none",
            ["'none'", "straight", "premultiplied", "premultiplied-encoded", "luminance"],
        ),
        ("colorspace=cmyk", ["'cmyk'", "srgb", "linear", "acescg", "linear-rec2020"]),
        ("at=upper-left", ["'upper-left'", *GRAVITIES]),
        ("at=5", ["'5'", "+X+Y", "center"]),
        ("at=+5", ["'+5'", "+X+Y", "center"]),
    ],
)
def test_layer_setting_that_does_not_exist(desk, settings, words):
    desk.refuses(
        2, "stack", "base.png", f"top.png::{settings}", "-o", "out.png",
        says=["layer 1", "top.png", *words],
    )  # fmt: skip


@pytest.mark.parametrize("space", package.SPACES)
def test_space(desk, space):
    desk.makes(
        "stack", "base.png", "top.png", "-o", "out.exr", "--depth", "float", "--space", space
    )
    layers = [
        package.read_layer(desk / name).pixels[0, 0].tolist() for name in ("base.png", "top.png")
    ]
    expected = oracle.composite(layers)
    if space != "linear-rgb":
        expected = oracle.composite_in(space, layers)
    assert package.read_layer(desk / "out.exr").pixels[0, 0] == pytest.approx(expected, abs=2e-6)
    desk.makes("stack", "base.png", "top.png", "-o", "out.exr", "--space", space,
               "--report", "made.json")  # fmt: skip
    assert json.loads((desk / "made.json").read_text())["space"] == space


@pytest.mark.parametrize("rule", ["gray_bias", "blending"])
def test_rules_beside_the_papers(desk, rule):
    value, order = {"gray_bias": (0.5, "simultaneous"), "blending": ("foremost", "bottom-up")}[rule]
    options = [f"--{rule.replace('_', '-')}", str(value), "--order", order]
    desk.makes("stack", "base.png", "top.png", "-o", "out.exr", "--depth", "float", *options)
    layers = [
        package.read_layer(desk / name).pixels[0, 0].tolist() for name in ("base.png", "top.png")
    ]
    expected = oracle.composite(layers, order=order, ops=[None, "over"], **{rule: value})
    assert package.read_layer(desk / "out.exr").pixels[0, 0] == pytest.approx(expected, abs=2e-6)
    desk.makes("stack", "base.png", "top.png", "-o", "out.exr", *options, "--report", "made.json",
               "--provenance", "origin.exr")  # fmt: skip
    made = json.loads((desk / "made.json").read_text())
    assert made["settings"][rule.replace("_", " ")] == str(value)
    assert made["measures"]["result"] != made["measures"]["traditional"]
    shown = desk.makes("explain", "base.png", "top.png", "--at", "0,0", "--format", "json", *options)
    data = json.loads(shown.stdout)
    assert data[rule] == value
    assert data["result"]["rgba"] == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--op", "blend"], ["--op", "'blend'", *OPERATORS]),
        (["--blending", "multiply"], ["multiply", "hue-preserving", "traditional", "foremost"]),
        (["--order", "sideways"], ["'sideways'", "bottom-up", "balanced", "simultaneous", "2,0,1"]),
        (["--order", "1"], ["1", "permutation", "0 to 1"]),
        (["--order", "0,0"], ["0,0", "permutation", "0 to 1"]),
        (["--order", "0,2"], ["0,2", "permutation", "0 to 1"]),
        (["--order", "0,1,2"], ["0,1,2", "permutation", "0 to 1"]),
        (["--order", "0,-1"], ["0,-1", "permutation", "0 to 1"]),
        (["--space", "lab"], ["'lab'", *package.SPACES]),
        (["--hue-tolerance", "-1"], ["-1", "0 to 90"]),
        (["--hue-tolerance", "nan"], ["nan", "0 to 90"]),
        (["--hue-tolerance", "wide"], ["wide", "--hue-tolerance"]),
        (["--gray-bias", "-0.1"], ["-0.1", "0 to 1"]),
        (["--gray-bias", "1.5"], ["gray bias 1.5", "0 to 1"]),
        (["--gray-bias", "nan"], ["nan", "0 to 1"]),
        (["--gray-bias", "strong"], ["strong", "--gray-bias"]),
        (["--canvas", "top"], ["'top'", "bottom", "union", "intersection", "WxH+X+Y"]),
        (["--canvas", "10x8"], ["10x8", "WxH+X+Y"]),
        (["--canvas", "0x8+0+0"], ["0x8"]),
        (["--region", "10x8"], ["10x8", "WxH+X+Y"]),
        (["--region", "0x3+0+0"], ["0x3"]),
        (["--depth", "half"], ["PNG depth", "half", "8", "16"]),
        (["--depth", "12"], ["12", "8", "16"]),
        (["--compression", "zip"], ["PNG compression", "zip", "fast", "small", "9"]),
        (["--compression", "10"], ["compression '10'", "for PNG", "fast", "small", "9"]),
        (["--exposure", "inf"], ["inf"]),
        (["--exposure", "nan"], ["nan"]),
        (["--background", "mauve"], ["mauve", "CSS", "#"]),
        (["--background", "#12345"], ["#12345", "CSS"]),
        (["--nonfinite", "ignore"], ["ignore", "error", "zero", "keep"]),
        (["--threads", "0"], ["--threads", "0"]),
        (["--threads", "many"], ["--threads", "many"]),
        (["--max-memory", "lots"], ["lots", "512M"]),
        (["--max-memory", "-1M"], ["-1M", "512M"]),
        (["--overscan"], ["--overscan", "EXR"]),
        (["--format", "exr"], ["out.png", "exr"]),
        (["--format", "tiff"], ["tiff", "png", "exr"]),
        (["--colour"], ["--colour"]),
        (["-o"], ["-o", "argument"]),
    ],
    ids=" ".join,
)
def test_option_that_does_not_exist_or_is_out_of_range(desk, options, words):
    desk.refuses(2, "stack", "base.png", "top.png", "-o", "out.png", *options, says=words)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--depth", "8"], ["EXR depth", "half", "float"]),
        (["--compression", "small"], ["EXR compression", "none", "zip", "piz", "dwab"]),
    ],
    ids=" ".join,
)
def test_option_that_an_exr_does_not_have(desk, options, words):
    desk.refuses(2, "stack", "base.exr", "-o", "out.exr", *options, says=words)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["stack", "-o", "out.png"], ["LAYER"]),
        (["stack", "base.png"], ["-o"]),
        (["stack", "base.png::op=over", "-o", "out.png"], ["layer 0", "bottom", "over"]),
        (["stack", "::op=over", "-o", "out.png"], ["::op=over"]),
        (["stack", "-", "-", "-o", "out.png"], ["stdin"]),
        (["stack", "-", "base.png", "-::opacity=0.5", "-o", "out.png"], ["stdin"]),
        (["stack", "base.png", "-o", "-"], ["stdout", "--format"]),
        (["stack", "base.png", "-o", "picture"], ["picture", ".png", ".exr"]),
        (["stack", "base.png", "-o", "picture.jpg"], ["picture.jpg", ".png", ".exr"]),
        (["stack", "base.png", "-o", ""], [".png", ".exr"]),
        (["info"], ["FILE"]),
        (["info", "--colour", "base.png"], ["--colour"]),
        (["completion"], ["bash", "zsh", "fish"]),
        (["completion", "tcsh"], ["tcsh", "bash", "zsh", "fish"]),
        (["blend", "base.png"], ["blend"]),
        (["--colour"], ["--colour"]),
    ],
    ids=lambda value: " ".join(value) or "nothing",
)
def test_command_line_that_means_nothing(desk, arguments, words):
    desk.refuses(2, *arguments, stdin=(desk / "base.png").read_bytes(), says=words)


# ---- bad input: outputs ---------------------------------------------------------------------

ENDINGS = ["png", "exr"]


@pytest.mark.parametrize("ending", ENDINGS)
def test_output_in_a_missing_directory(desk, ending):
    out = f"nowhere/out.{ending}"
    desk.refuses(5, "stack", "base.png", "-o", out, says=[out, "no directory nowhere"])


@pytest.mark.parametrize("ending", ENDINGS)
def test_output_in_a_file_as_directory(desk, ending):
    desk.refuses(5, "stack", "base.png", "-o", f"top.png/out.{ending}", says=["top.png/out."])


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("stands", [True, False])
def test_output_in_a_read_only_directory(desk, ending, stands):
    folder = desk / "locked"
    folder.mkdir()
    out = f"locked/out.{ending}"
    if stands:
        desk.put(out, OLD)
    os.chmod(folder, 0o555)
    touched = subprocess.run([*POWERLESS, shutil.which("touch"), folder / "other"], check=False)
    assert touched.returncode != 0, "the directory can be written to, and this test shows nothing"
    desk.refuses(
        5, "stack", "base.png", "-o", out, through=POWERLESS,
        says=[out, "directory locked", "permission denied"],
    )  # fmt: skip


def test_output_where_nobody_can_write(desk):
    desk.refuses(5, "stack", "base.png", "-o", "/proc/out.png", says=["/proc/out.png"])


@pytest.mark.parametrize("ending", ENDINGS)
def test_output_that_is_a_directory(desk, ending):
    (desk / f"folder.{ending}").mkdir()
    desk.refuses(
        5, "stack", "base.png", "-o", f"folder.{ending}", says=[f"folder.{ending}", "directory"]
    )


@pytest.mark.parametrize("ending", ENDINGS)
def test_no_clobber_keeps_an_output(desk, ending):
    desk.refuses(
        5, "stack", "base.png", "-o", f"out.{ending}", "--no-clobber",
        says=[f"out.{ending}", "exists", "--no-clobber"],
    )  # fmt: skip


def test_no_clobber_makes_an_output_that_does_not_stand(desk):
    desk.makes("stack", "base.png", "-o", "new.png", "--no-clobber")
    assert png_size((desk / "new.png").read_bytes()) == SIZE


@pytest.fixture
def noise(desk):
    """A layer that does not compress, so that its result is as large as it looks: 240 kB."""
    rng = np.random.default_rng(0)
    samples = rng.integers(0, 256, (200, 300, 4))
    samples[..., 3] = 255
    desk.put("noise.png", pngfile.rgba_png(samples).encode())
    return desk


@pytest.mark.pairwise
@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("blocks", [0, 16])
@pytest.mark.parametrize("threads", [1, 2])
def test_full_disk(noise, ending, blocks, threads):
    """A limit on the size of files fails as a full disk does, at the same calls."""
    noise.refuses(
        5, "stack", "noise.png", "-o", f"out.{ending}", "--threads", threads,
        through=shell(f'ulimit -f {blocks}; exec "$@"'), says=[f"out.{ending}"],
    )  # fmt: skip


@pytest.mark.parametrize("ending", ENDINGS)
def test_full_disk_of_a_small_output(desk, ending):
    """All of it fits the buffers of the library that writes it, which fails on closing at last."""
    desk.refuses(
        5, "stack", "base.png", "-o", f"out.{ending}",
        through=shell('ulimit -f 0; exec "$@"'), says=[f"out.{ending}"],
    )  # fmt: skip


@pytest.mark.parametrize("ending", ENDINGS)
def test_full_disk_behind_stdout(noise, ending):
    noise.refuses(
        5, "stack", "noise.png", "-o", "-", "--format", ending,
        through=shell('exec "$@" >/dev/full'), says=["stdout", "no space"],
    )  # fmt: skip


def test_full_disk_behind_a_device(desk):
    desk.refuses(
        5, "stack", "base.png", "-o", "/dev/full", "--format", "png", says=["/dev/full", "no space"]
    )


def test_full_disk_behind_a_report(desk):
    desk.refuses(
        5, "info", "base.png", through=shell('exec "$@" >/dev/full'), says=["stdout", "no space"]
    )


def test_full_disk_for_what_comes_from_stdin(noise):
    """A pipe is kept in a temporary file; the message is not that of a broken layer."""
    noise.refuses(
        3, "stack", "-", "-o", "out.png", stdin=(noise / "noise.png").read_bytes(),
        through=shell('ulimit -f 16; exec "$@"'), says=["layer 0 (stdin)", "large"],
    )  # fmt: skip


# ---- interruptions --------------------------------------------------------------------------


IMPORTING = """
import os, signal, sys
os.environ["OPENBLAS_NUM_THREADS"] = "1"  # as the command does; another thread would take signals
from hpcomp.cli import signals

class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == "OpenImageIO":
            os.kill(os.getpid(), signal.SIGTERM)

sys.meta_path.insert(0, Interrupting())
signals.install()
try:
    import hpcomp.imagefile.openimageio
except signals.Terminated:
    print("OpenImageIO" in sys.modules)
"""


def test_a_signal_waits_for_the_import_of_an_extension(tmp_path):
    """One that is interrupted while it starts may abort the process."""
    done = subprocess.run(
        [sys.executable, "-c", IMPORTING], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\n", "")


LOSING = """
import os, signal, sys, time, weakref
from hpcomp.cli import signals

def interrupt(*_):
    os.kill(os.getpid(), int(sys.argv[2]))

class Thing:
    if sys.argv[1] == "finalizer":
        __del__ = interrupt

signals.install()
thing = Thing()
callback = weakref.ref(thing, interrupt) if sys.argv[1] == "weakref" else None
try:
    del thing
    time.sleep(60)
except tuple(signals.ENDING.values()) as error:
    print(type(error).__name__)
"""


@pytest.mark.parametrize("number", list(ENDING), ids=lambda number: number.name)
@pytest.mark.parametrize("where", ["finalizer", "weakref"])
def test_a_signal_is_not_lost_where_nothing_can_be_raised(tmp_path, number, where):
    """Python drops exceptions of such callbacks: one that a signal raises comes again."""
    done = subprocess.run(
        [*INTERRUPTIBLE, sys.executable, "-c", LOSING, where, str(int(number))],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{ENDING[number].__name__}\n", "")


@pytest.mark.pairwise
@pytest.mark.parametrize("number", list(SIGNALS), ids=lambda number: number.name)
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("options", [["png", "0"], ["exr", "none"]], ids=ENDINGS)
def test_signal_while_compositing(desk, number, threads, options):
    """One large layer many times over: it takes a while to read, and nothing to make."""
    ending, compression = options
    exrfile.write(desk / "large.exr", planes(0.5, (1000, 2000)))
    before = snapshot(desk.folder.parent)
    known = set(desk.folder.iterdir())
    layers = ["large.exr"] * 100
    with running(
        desk, "stack", *layers, "-o", f"out.{ending}", "--compression", compression,
        "--threads", threads,
    ) as process:  # fmt: skip
        temporary_of(process, desk.folder, known, at_least=100_000)
        process.send_signal(number)
        assert_ended(process, number)
    assert snapshot(desk.folder.parent) == before


@pytest.mark.parametrize("number", list(SIGNALS), ids=lambda number: number.name)
@pytest.mark.parametrize(
    "given", [None, b"", b"\x89PNG\r\n\x1a\n"], ids=["unopened", "empty", "head"]
)
def test_signal_while_waiting_for_a_layer(desk, number, given):
    """A pipe that nobody writes to, one that nothing comes from, and one that stops."""
    os.mkfifo(desk / "slow.png")
    before = snapshot(desk.folder.parent)
    known = set(desk.folder.iterdir())
    with contextlib.ExitStack() as opened:
        process = opened.enter_context(
            running(desk, "stack", "base.png", "slow.png", "-o", "out.png")
        )
        temporary_of(process, desk.folder, known)
        if given is not None:
            pipe = opened.enter_context(open(desk / "slow.png", "wb", buffering=0))
            pipe.write(given)
        process.send_signal(number)
        assert_ended(process, number)
    assert snapshot(desk.folder.parent) == before


def test_hang_up(desk):
    os.mkfifo(desk / "slow.png")
    before = snapshot(desk.folder.parent)
    known = set(desk.folder.iterdir())
    with running(desk, "stack", "slow.png", "-o", "out.png") as process:
        temporary_of(process, desk.folder, known)
        process.send_signal(signal.SIGHUP)
        process.communicate(timeout=PATIENCE_S)
        assert process.returncode == package.ExitCode.TERMINATED
    assert snapshot(desk.folder.parent) == before


# ---- streams --------------------------------------------------------------------------------


def read_and_close(desk, *arguments, size):
    """Runs it into a pipe whose reader closes after `size` bytes: (exit code, stderr)."""
    with running(desk, *arguments) as process:
        assert len(process.stdout.read(size)) == size
        process.stdout.close()
        code = process.wait(PATIENCE_S)
        return code, process.stderr.read().decode()


@pytest.mark.parametrize("ending", ENDINGS)
def test_closed_pipe(noise, ending):
    before = snapshot(noise.folder.parent)
    arguments = "stack", "noise.png", "-o", "-", "--format", ending
    assert read_and_close(noise, *arguments, size=10) == (141, "")
    assert snapshot(noise.folder.parent) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ["info", "base.png"],
        ["info", "--json", "base.png"],
        ["--help"],
        ["stack", "--help"],
        ["--version"],
        ["completion", "bash"],
    ],
    ids=" ".join,
)
def test_closed_pipe_of_a_report(desk, arguments):
    """Nobody reads it from the start."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            command(*arguments), cwd=desk.folder, stdout=writing, stderr=subprocess.PIPE
        )
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (141, b"")


def test_long_report_into_a_closed_pipe(desk):
    files = ["base.png"] * 500
    assert read_and_close(desk, "info", "--json", *files, size=10) == (141, "")


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_stream_that_is_not_used(desk, ending, closed):
    """Files that are opened then get its number: nothing that is printed may end up in them."""
    broken = pngfile.iccp(b"no profile at all")
    desk.put("odd.png", flat(40, 40, 200, 128).with_chunks(head=[broken]).encode())
    arguments = "stack", "base.png", "odd.png", "-o", f"out.{ending}"
    desk.run(*arguments, "-q")
    expected = (desk / f"out.{ending}").read_bytes()
    os.remove(desk / f"out.{ending}")
    run = desk.run(*arguments, "-v", through=shell(f'exec "$@" {closed}'))
    assert run.code == 0
    assert run.stdout == b""
    assert (desk / f"out.{ending}").read_bytes() == expected
    assert os.listdir(desk.temporary) == []


def test_closed_stdin_that_is_a_layer(desk):
    desk.refuses(
        3, "stack", "base.png", "-", "-o", "out.png", through=shell('exec "$@" <&-'),
        says=["layer 1 (stdin)"],
    )  # fmt: skip


@pytest.mark.parametrize("ending", ENDINGS)
def test_closed_stdout_that_is_the_output(desk, ending):
    desk.refuses(
        5, "stack", "base.png", "-o", "-", "--format", ending, through=shell('exec "$@" >&-'),
        says=["stdout"],
    )  # fmt: skip


def test_closed_stdout_of_a_report(desk):
    desk.refuses(5, "info", "base.png", through=shell('exec "$@" >&-'), says=["stdout"])


@pytest.mark.parametrize(
    ("code", "arguments"),
    [
        (3, ["stack", "nowhere.png", "-o", "out.png"]),
        (2, ["stack", "base.png", "-o", "out"]),
        (2, ["stack"]),
        (3, ["info", "nowhere.png"]),
    ],
)
def test_closed_stderr_keeps_the_exit_code(desk, code, arguments):
    before = snapshot(desk.folder.parent)
    run = desk.run(*arguments, through=shell('exec "$@" 2>&-'))
    assert (run.code, run.stdout, run.stderr) == (code, b"", "")
    assert snapshot(desk.folder.parent) == before


@pytest.mark.parametrize("what", [b"", b"hello, world\n"])
def test_stdin_that_is_no_layer(desk, what):
    desk.refuses(3, "stack", "base.png", "-", "-o", "out.png", stdin=what, says=["layer 1 (stdin)"])


def test_stdout_carries_the_picture_alone(desk):
    run = desk.run("stack", "base.png", "-o", "-", "--format", "png", "-v")
    assert run.code == 0
    assert png_size(run.stdout) == SIZE
    assert all(line.startswith("hpcomp: ") for line in run.lines)


def test_failure_on_the_way_to_stdout_prints_nothing_there(desk):
    flipped_exr(desk)
    desk.refuses(3, "stack", "bad.exr", "-o", "-", "--format", "exr", says=["bad.exr"])


# ---- paths and files ------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ENDINGS)
def test_layer_that_is_also_the_output(desk, ending):
    base, top = f"base.{ending}", f"top.{ending}"
    desk.makes("stack", base, top, "-o", f"out.{ending}")
    expected = (desk / f"out.{ending}").read_bytes()
    for output in (base, top):
        shutil.copy(desk / output, desk / "kept")
        desk.makes("stack", base, top, "-o", output)
        assert (desk / output).read_bytes() == expected
        shutil.copy(desk / "kept", desk / output)


def test_output_through_a_link_keeps_the_link(desk):
    (desk / "elsewhere").mkdir()
    desk.put("elsewhere/real.png", OLD)
    (desk / "link.png").symlink_to("elsewhere/real.png")
    (desk / "dangling.png").symlink_to("elsewhere/new.png")
    for link, real in (("link.png", "real.png"), ("dangling.png", "new.png")):
        desk.makes("stack", "base.png", "-o", link)
        assert os.readlink(desk / link) == f"elsewhere/{real}"
        assert png_size((desk / "elsewhere" / real).read_bytes()) == SIZE
    assert sorted(os.listdir(desk / "elsewhere")) == ["new.png", "real.png"]


def test_output_through_a_link_to_itself(desk):
    (desk / "loop.png").symlink_to("loop.png")
    desk.refuses(5, "stack", "base.png", "-o", "loop.png", says=["loop.png"])


@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_new_output_has_the_permissions_of_the_umask(desk, umask):
    desk.makes("stack", "base.png", "-o", "new.png", umask=umask)
    assert stat.S_IMODE((desk / "new.png").stat().st_mode) == 0o666 & ~umask


@pytest.mark.parametrize("mode", [0o600, 0o664, 0o444])
def test_replaced_output_keeps_its_permissions(desk, mode):
    os.chmod(desk / "out.png", mode)
    desk.makes("stack", "base.png", "-o", "out.png", umask=0o027)
    assert stat.S_IMODE((desk / "out.png").stat().st_mode) == mode


@pytest.mark.parametrize("ending", ENDINGS)
def test_output_to_a_device(desk, ending):
    desk.makes("stack", "base.png", "-o", "/dev/null", "--format", ending)
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


def test_output_to_dev_stdout(desk):
    run = desk.makes("stack", "base.png", "-o", "/dev/stdout", "--format", "png")
    assert png_size(run.stdout) == SIZE


@pytest.mark.parametrize("ending", ENDINGS)
def test_pipe_as_a_layer(desk, ending):
    """As bash's <(…) gives one."""
    base, top = f"base.{ending}", f"top.{ending}"
    desk.makes("stack", base, top, "-o", "plain.png")
    desk.makes(
        "stack", base, f"-o{'piped.png'}",
        through=["bash", "-c", f'exec "$@" <(cat {top}) <(cat {top})::opacity=0', "bash"],
    )  # fmt: skip
    assert (desk / "piped.png").read_bytes() == (desk / "plain.png").read_bytes()


NAMES = [
    "with space.png",
    "a::b.png",
    "a::op=over",
    "a?b=c.png",
    "ünïcödé 层.png",
    "-dash.png",
    "%04d.png",
    "#.png",
    "a,b=c.png",
    "quote'\".png",
    "~.png",
    "new\nline.png",
    b"latin-\xe9.png",
    "n" * 251 + ".png",
]


@pytest.mark.parametrize("name", NAMES, ids=lambda name: ascii(name)[:20])
def test_any_file_name(desk, name):
    """It is read, described and written, and named in one line where it cannot be."""
    path = os.path.join(os.fsencode(desk.folder), os.fsencode(name))
    shutil.copy(os.fsencode(desk / "top.png"), path)
    desk.makes("stack", "base.png", "top.png", "-o", "out.png")
    desk.makes("stack", "-o", "piped.png", "--", "base.png", name)
    assert (desk / "piped.png").read_bytes() == (desk / "out.png").read_bytes()
    assert b"PNG, 1 part" in desk.makes("info", "--", name).stdout
    with open(path, "wb") as broken:
        broken.write(b"no picture")
    desk.refuses(3, "stack", "-o", "out.png", "--", name, says=["layer 0 ("])
    os.remove(path)
    settings = b"--format=png", b"--output=" + os.fsencode(name)
    desk.makes("stack", "base.png", "top.png", *settings)
    with open(path, "rb") as made:
        assert made.read() == (desk / "out.png").read_bytes()


def test_settings_after_a_name_with_colons(desk):
    """The last :: splits, unless the whole argument is a file."""
    shutil.copy(desk / "top.png", desk / "a::b.png")
    desk.makes("stack", "base.png", "top.png::opacity=0.5", "-o", "out.png")
    desk.makes("stack", "base.png", "a::b.png::opacity=0.5", "-o", "piped.png")
    assert (desk / "piped.png").read_bytes() == (desk / "out.png").read_bytes()


# ---- messages -------------------------------------------------------------------------------


def foreign(desk):
    """A PNG with a profile that is not honoured."""
    profile = pngfile.icc_profile("Adobe RGB (1998)", more=[(b"A2B0", bytes(48))])
    desk.put(
        "foreign.png", flat(9, 99, 199, 255).with_chunks(head=[pngfile.iccp(profile)]).encode()
    )


def glow(desk):
    """An EXR with light at alpha 0, which a PNG cannot hold."""
    exrfile.write(desk / "glow.exr", {**planes(0.5), "A": np.zeros(SIZE[::-1], np.float16)})


WARNINGS = {
    "foreign profile": (
        3, foreign, ["foreign.png"], ["layer 0 (foreign.png)", "Adobe RGB (1998)"]
    ),
    "glow": (4, glow, ["glow.exr"], ["out.png", "80 pixels", "light without alpha"]),
    "gamut": (
        4, lambda desk: exrfile.write(desk / "hdr.exr", {**planes(1.0), "R": planes(4.0)["R"]}),
        ["hdr.exr"], ["out.png", "80 pixels", "gamut"],
    ),
    "mask without alpha": (
        4, lambda desk: exrfile.write(desk / "grey.exr", planes(0.5, names="Y")),
        ["base.exr", "grey.exr::op=dst-in"], ["layer 1 (grey.exr)", "no alpha", "tint=white", "alpha=luminance"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", list(WARNINGS))
def test_warning(desk, kind):
    """One line on stderr; none with -q; an error with --strict, whatever -q says."""
    code, make, layers, words = WARNINGS[kind]
    make(desk)
    desk.refuses(code, "stack", *layers, "-o", "out.png", "--strict", says=[*words, "--strict"])
    desk.refuses(code, "stack", *layers, "-o", "out.png", "--strict", "-q", says=words)
    run = desk.run("stack", *layers, "-o", "out.png")
    assert (run.code, run.stdout, len(run.lines)) == (0, b"", 1)
    assert run.stderr.startswith("hpcomp: warning: ")
    assert all(word in run.stderr for word in words), run.stderr
    expected = (desk / "out.png").read_bytes()
    desk.makes("stack", *layers, "-o", "out.png", "-q")
    assert (desk / "out.png").read_bytes() == expected


def test_strict_without_a_warning_is_silent(desk):
    desk.makes("stack", "base.png", "top.exr", "-o", "out.png", "--strict")


def test_warnings_are_not_lost_in_the_environment(desk):
    """PYTHONWARNINGS is for programmers; it neither hides a message nor makes it an error."""
    glow(desk)
    for setting in ("ignore", "error"):
        run = hpcomp(
            "stack", "glow.exr", "-o", "out.png",
            cwd=desk.folder, env={**desk.env, "PYTHONWARNINGS": setting},
        )  # fmt: skip
        assert run.code == 0
        assert run.stderr.startswith("hpcomp: warning: ")


def test_verbose_tells_decisions_and_timings(desk):
    run = desk.run("stack", "base.png", "top.png", "-o", "out.png", "-v", "--threads", "1")
    assert (run.code, run.stdout) == (0, b"")
    assert all(line.startswith("hpcomp: ") for line in run.lines)
    for word in (
        "2 layers",
        "10x8+0+0",
        "hue-preserving",
        "bottom-up",
        "space linear-rgb",
        "strips",
        "reading",
        "writing",
    ):
        assert word in run.stderr


def test_libraries_do_not_speak_for_themselves(desk):
    """libpng prints on file descriptor 2 what it thinks of this file's profile and of its data."""
    odd = flat(40, 40, 200, 128).with_chunks(head=[pngfile.iccp(b"no profile at all")])
    desk.put("odd.png", odd.encode())
    run = desk.run("stack", "odd.png", "-o", "out.png")
    assert run.code == 0
    assert [line.partition(" layer")[0] for line in run.lines] == ["hpcomp: warning:"]
    desk.put("odd.png", pngfile.replace_chunk(odd.encode(), b"IDAT", zlib.compress(b"short")))
    assert "libpng" not in desk.run("stack", "odd.png", "-o", "out.png", "-q").stderr
    assert b"libpng" in subprocess.run(
        [sys.executable, "-c", "import OpenImageIO as o; o.ImageInput.open('odd.png').read_image()"],
        cwd=desk.folder, capture_output=True,
    ).stderr, "this file provokes no message, and the test shows nothing"  # fmt: skip


def test_debug_shows_a_traceback(desk):
    run = desk.run("stack", "nowhere.png", "-o", "out.png", "--debug", process=True)
    assert run.code != 0
    assert "Traceback" in run.stderr
    assert "InputError" in run.stderr
    assert (desk / "out.png").read_bytes() == OLD


# ---- what is loaded -------------------------------------------------------------------------

LOADED = """
import sys
from hpcomp.cli import run
try:
    run(sys.argv[1:])
except SystemExit as end:
    assert not end.code, end.code
    own = {name for name in sys.modules if name.startswith("hpcomp.")}
    found = sorted({name.partition(".")[0] for name in sys.modules} | own)
    print("loaded", found)
"""


def modules(desk, *arguments):
    """The modules that a run has imported when it ends: all of hpcomp, of others those at the top."""
    done = subprocess.run(
        [sys.executable, "-Wignore", "-c", LOADED, *arguments],
        cwd=desk.folder, capture_output=True, check=True,
    )  # fmt: skip
    return set(ast.literal_eval(done.stdout.decode().partition("loaded ")[2]))


HEAVY = {
    "numpy", "OpenImageIO", "OpenEXR", "colour", "matplotlib", "scipy", "dask",
    "htpy", "msgspec", "tqdm", "webcolors",
}  # fmt: skip

#: Of Python's own, those that take long to import.
SLOW_OF_PYTHON = {"argparse", "asyncio", "datetime", "email", "inspect", "json", "pathlib", "platform",
    "random", "socket", "ssl", "subprocess", "tempfile", "urllib"}  # fmt: skip

#: Modules of hpcomp that a stack of PNG files imports. Each costs every run of every loop: one more
#: needs a reason, one that only some runs need is imported by these.
MODULES_OF_A_STACK = 89


def test_help_loads_next_to_nothing(desk):
    loaded = modules(desk, "--help")
    assert not loaded & {*HEAVY, *SLOW_OF_PYTHON, "click", "dataclasses"}
    assert {name for name in loaded if name.startswith("hpcomp.")} <= {
        "hpcomp.__main__", "hpcomp.cli", "hpcomp.cli.frontpage", "hpcomp.cli.messages", "hpcomp.cli.printing",
        "hpcomp.cli.signals", "hpcomp.errors", "hpcomp.system", "hpcomp.system.outputs",
        "hpcomp.system.signals", "hpcomp.system.streams", "hpcomp.version",
    }  # fmt: skip


def test_help_of_a_command_loads_click_alone(desk):
    loaded = modules(desk, "info", "--help")
    assert "click" in loaded
    assert not loaded & HEAVY


def test_a_stack_of_png_files_loads_no_module_more(desk):
    shutil.copy(desk / "base.png", desk / "second.png")
    loaded = modules(desk, "stack", "base.png", "second.png", "-o", "out.png")
    assert loaded & HEAVY == {"numpy"}
    numpy = subprocess.run(
        [sys.executable, "-c", "import numpy, sys; print(list(sys.modules))"],
        capture_output=True, check=True,
    )  # fmt: skip
    assert not loaded & SLOW_OF_PYTHON - set(ast.literal_eval(numpy.stdout.decode()))
    assert len([name for name in loaded if name.startswith("hpcomp.")]) <= MODULES_OF_A_STACK


@pytest.mark.parametrize("ending", ENDINGS)
def test_stack_loads_what_it_needs(desk, ending):
    loaded = modules(desk, "stack", "base.png", "top.exr", "-o", f"out.{ending}")
    assert loaded & HEAVY == {"numpy", "OpenImageIO"}


def test_new_chromaticities_alone_load_colour(desk):
    exrfile.write(desk / "wide.exr", planes(), chromaticities=exrfile.PRIMARIES["rec2020"])
    known = ("stack", "wide.exr", "-o", "out.exr", "--primaries", "acescg")
    assert modules(desk, *known) & HEAVY == {"numpy", "OpenImageIO"}
    new = (0.66, 0.31, 0.25, 0.64, 0.14, 0.05, 0.30, 0.32)
    exrfile.write(desk / "new.exr", planes(), chromaticities=new)
    assert "colour" in modules(desk, "stack", "new.exr", "-o", "out.exr")


def test_importing_the_package_loads_nothing():
    code = "import sys, hpcomp; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & HEAVY
    assert "click" not in done.stdout.split()


# ---- help -----------------------------------------------------------------------------------


def test_version():
    for arguments in ([COMMAND], [sys.executable, "-m", "hpcomp"]):
        done = subprocess.run([*arguments, "--version"], capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith(f"hpcomp {package.__version__} ")
        assert len(done.stdout.splitlines()) == 1


@pytest.mark.parametrize("columns", ["30", "64", "80", "90", "300"])
def test_help_is_the_page_that_click_would_make(columns):
    """Which is made without it, as its import takes longer than all the rest."""
    env = {"COLUMNS": columns}

    def shown(ctx):
        formatter = ctx.make_formatter()
        click.Group.format_usage(group.cli, ctx, formatter)
        click.Group.format_help_text(group.cli, ctx, formatter)
        click.Command.format_options(group.cli, ctx, formatter)
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in COMMANDS.items()])
        with formatter.section("Exit codes"):
            formatter.write_dl([(str(int(k)), v) for k, v in EXIT_CODE_MEANINGS.items()])
        return formatter.getvalue()

    with mock.patch.dict(os.environ, env):
        expected = shown(click.Context(group.cli, info_name="hpcomp", **group.cli.context_settings))
    for arguments in (["--help"], ["-h"], ["--help", "stack"]):
        run = hpcomp(*arguments, env=env)
        assert (run.code, run.stdout.decode(), run.stderr) == (0, expected, "")
    run = hpcomp(env=env)
    assert (run.code, run.stdout, run.stderr) == (2, b"", expected)


@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_help(flag):
    run = hpcomp(flag)
    assert (run.code, run.stderr) == (0, "")
    text = run.stdout.decode()
    for name, (_, line) in COMMANDS.items():
        assert any(row.split() == [name, *line.split()] for row in text.splitlines())
    for code in package.ExitCode:
        assert f" {int(code)} " in text


@pytest.mark.parametrize("name", list(COMMANDS))
def test_help_of_a_command(name):
    run = hpcomp(name, "--help")
    assert (run.code, run.stderr) == (0, "")
    text = run.stdout.decode()
    assert text.startswith(f"Usage: hpcomp {name} ")
    found = group.cli.get_command(None, name)
    assert found.short_help == COMMANDS[name][1]
    assert COMMANDS[name][1] in " ".join(text.split())
    for parameter in found.params:
        if getattr(parameter, "hidden", False):
            continue  # of other commands, or in another spelling
        if isinstance(parameter, click.Option):
            assert parameter.help, f"{parameter.name} has no help"
            assert all(name in text for name in shown_names(parameter))
            assert not any(name in text for name in set(parameter.opts) - set(shown_names(parameter)))


def test_help_of_stack_lists_what_can_be_said():
    words = hpcomp("stack", "--help").stdout.decode().replace(",", " ").split()
    for word in (*package.OPERATORS, *package.ORDERS, *(f"{key}={'X'}"[:-1] for key in KEYS)):
        assert any(found.startswith(word) for found in words), word


def test_a_module_is_the_command(desk):
    done = subprocess.run(
        [sys.executable, "-m", "hpcomp", "stack", "base.png", "-o", "out.png"], cwd=desk.folder
    )
    assert done.returncode == 0
    assert png_size((desk / "out.png").read_bytes()) == SIZE


# ---- info -----------------------------------------------------------------------------------


def test_info_as_text(desk):
    foreign(desk)
    exrfile.write(
        desk / "parts.exr", planes(names=["glow.R", "glow.G", "glow.B", "Z"], dtype=np.float32),
        origin=(-3, 2), display=(0, 0, 30, 20), compression="piz", pixel_aspect=2.0,
    )  # fmt: skip
    run = desk.run("info", "foreign.png", "parts.exr")
    assert (run.code, run.stderr) == (0, "")
    png, exr = run.stdout.decode().split("\n\n")
    for word in (
        "foreign.png: PNG",
        "10x8+0+0",
        "uint8",
        "sRGB",
        "rec709",
        "Adobe RGB (1998)",
        "straight",
    ):
        assert word in png
    for word in ("parts.exr: EXR", "10x8-3+2", "30x20+0+0", "piz", "glow.R float", "Z float", "linear",
                 "opaque", "pixel aspect  2"):  # fmt: skip
        assert word in exr


def test_info_as_json(desk):
    exrfile.write_parts(
        desk / "parts.exr",
        [("left", planes(), {}), ("depth", planes(names=["Z"]), {})],
    )
    run = desk.run("info", "--json", "base.png", "parts.exr")
    assert (run.code, run.stderr) == (0, "")
    document = json.loads(run.stdout)
    assert list(document) == ["schema", "version", "files"]
    assert document["schema"] == "hpcomp.info"
    assert document["version"] == 2
    png, exr = document["files"]
    assert (png["path"], png["format"]) == ("base.png", "png")
    assert png["read_as"] == {"part": 0, "layer": ""}
    (part,) = png["parts"]
    assert part["channels"] == [
        {"name": name, "type": "uint8", "sampling": [1, 1]} for name in "RGBA"
    ]
    assert (part["transfer_from"], part["primaries_from"]) == ("default", "default")
    assert (png["warnings"], exr["warnings"]) == ([], [])
    assert part["data_window"] == {"x": 0, "y": 0, "width": 10, "height": 8}
    assert part["display_window"] == part["data_window"]
    assert part["layers"] == [
        {"name": "", "color": ["R", "G", "B"], "alpha": "A", "alpha_mode": "straight"}
    ]
    assert (part["transfer"], part["primaries"]) == ("sRGB", "rec709")
    assert part["chromaticities"] == [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.329]]
    assert (exr["path"], exr["format"]) == ("parts.exr", "exr")
    assert [p["name"] for p in exr["parts"]] == ["left", "depth"]
    assert [p["index"] for p in exr["parts"]] == [0, 1]
    assert exr["parts"][0]["transfer"] == "linear"
    assert exr["parts"][0]["layers"][0]["alpha_mode"] == "premultiplied"
    assert exr["parts"][1]["layers"] == []


def test_info_of_what_cannot_be_read_as_it_is(desk):
    """It is described all the same: info is how one finds out what to choose."""
    exrfile.write_parts(desk / "parts.exr", [("left", planes(), {}), ("right", planes(), {})])
    exrfile.write_deep(desk / "deep.exr")
    run = desk.run("info", "--json", "parts.exr", "deep.exr")
    assert (run.code, run.stderr) == (0, "")
    parts, deep = json.loads(run.stdout)["files"]
    assert parts["read_as"] is deep["read_as"] is None
    assert "part=" in parts["problem"]
    assert "deep" in deep["problem"]
    assert deep["parts"][0]["storage"] == "deep"
    run = desk.run("info", "parts.exr", "deep.exr")
    assert (run.code, run.stderr) == (0, "")
    assert b"left, right" in run.stdout


@pytest.mark.parametrize("flags", [[], ["--json"]], ids=["text", "json"])
def test_info_goes_on_after_a_file_that_cannot_be_read(desk, flags):
    truncated_png(desk)
    run = desk.run("info", *flags, "base.png", "bad.png", "nowhere.png", "top.exr")
    assert run.code == 3
    assert [line[: len("hpcomp: error: bad")] for line in run.lines] == [
        "hpcomp: error: bad", "hpcomp: error: now"
    ]  # fmt: skip
    assert "truncated" in run.lines[0]
    if flags:
        assert [file["path"] for file in json.loads(run.stdout)["files"]] == ["base.png", "top.exr"]
    else:
        assert [text.partition(":")[0] for text in run.stdout.decode().split("\n\n")] == [
            "base.png", "top.exr"
        ]  # fmt: skip


def test_info_of_stdin(desk):
    run = desk.run("info", "-", "--json", stdin=(desk / "top.exr").read_bytes())
    assert (run.code, run.stderr) == (0, "")
    assert json.loads(run.stdout)["files"][0]["format"] == "exr"
    assert os.listdir(desk.temporary) == []
