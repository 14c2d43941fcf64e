"""`--max-pixels`: what claims more pixels is refused before one of them is looked at."""

from __future__ import annotations

import json
import os
import struct

import deepfile
import exrfile
import numpy as np
import pngfile
import pytest
from command import Desk
from processes import peak

import hpcomp
from hpcomp import InputError, MismatchError, SettingError
from hpcomp.system.memory import parse_bytes, parse_pixels

#: Of all pictures on the desk, and one less than that.
SIZE, TOO_FEW = (20, 10), "199"


@pytest.fixture
def desk(tmp_path):
    desk = Desk.made(tmp_path)
    desk.put("a.png", pngfile.random_png(pngfile.RGBA, 8, width=20, height=10).encode())
    for number in (1, 2):
        desk.put(f"f{number}.png", (desk / "a.png").read_bytes())
    desk.put("palette.png", pngfile.random_png(pngfile.PALETTE, 8, width=20, height=10).encode())
    desk.put("red.png", pngfile.rgba_png(np.full((10, 20, 4), (200, 40, 40, 255)), 8).encode())
    exrfile.write(desk / "a.exr", exrfile.planes("RGBA", 20, 10))
    exrfile.write(desk / "shown.exr", exrfile.planes("RGBA", 2, 2), display=(0, 0, 20, 10))
    deepfile.write(desk / "deep.exr", deepfile.noise(20, 10, 6))
    desk.put("jobs.json", json.dumps([{"layers": ["a.png"], "output": "batch.exr"}]).encode())
    desk.put(
        "own.json",
        json.dumps([{"layers": ["a.png"], "output": "own.exr", "max_pixels": 199}]).encode(),
    )
    return desk


RUNS = [
    ("a.png", ["stack", "a.png", "-o", "out.exr"]),
    ("palette.png", ["stack", "palette.png", "-o", "out.exr"]),
    ("a.exr", ["stack", "a.exr", "-o", "out.exr"]),
    ("shown.exr", ["stack", "shown.exr", "-o", "out.exr"]),
    ("deep.exr", ["flatten", "deep.exr", "-o", "out.exr"]),
    ("a.png", ["hues", "a.png"]),
    ("red.png", ["palette", "blue", "--from", "red.png"]),
    ("a.png", ["explain", "a.png", "--at", "1,2"]),
    ("a.png", ["check", "a.exr", "a.png", "--max-foreign", "1"]),
    ("a.png", ["check", "a.png", "--hues", "0", "--max-foreign", "1"]),
    ("a.png", ["batch", "jobs.json"]),
    ("f2.png", ["stack", "f%d.png", "-o", "frame%d.exr", "--frames", "1-2"]),
]


@pytest.mark.parametrize(("name", "arguments"), RUNS, ids=lambda value: " ".join(value[:2]))
def test_every_command_refuses_more_and_takes_as_many(desk, name, arguments):
    before = set(os.listdir(desk.folder))
    run = desk.run(*arguments, "--max-pixels", TOO_FEW)
    assert run.code == 3
    says = f"{name})" if arguments[0] not in ("hues", "palette", "flatten") else name
    errors = [line for line in run.lines if "error" in line]
    for line in errors:
        assert "it claims 20x10, which is 200 pixels and more than 199: raise --max-pixels" in line
    assert any(says in line for line in errors)
    made = set(os.listdir(desk.folder)) - before
    assert made <= {".jobs.json.hpcomp-state"}
    enough = "1200" if name == "deep.exr" else "200"
    assert desk.run(*arguments, "--max-pixels", enough).code in (0, 6)


def test_a_job_has_a_number_of_its_own(desk):
    run = desk.run("batch", "own.json", "--max-pixels", "1G")
    assert run.code == 3
    assert "more than 199" in run.stderr


def test_more_samples_than_pixels_may_be_are_refused_too(desk):
    run = desk.run("flatten", "deep.exr", "-o", "out.exr", "--max-pixels", "200")
    assert run.code == 3
    assert "deep.exr: it claims" in run.stderr
    assert "samples, which is more than 200" in run.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--canvas", "30x10+0+0"], "30x10, which is 300 pixels and more than 200"),
        (["--canvas", "union"], "120x10, which is 1,200 pixels"),
    ],
)
def test_a_canvas_of_more_is_refused_and_a_region_of_it_is_not(desk, options, words):
    """Files may lie far apart, and none of them claims much."""
    layers = ["a.png", "a.exr::at=+100+0"]
    arguments = ["stack", *layers, "-o", "out.exr", *options, "--max-pixels", "200"]
    run = desk.run(*arguments)
    assert run.code == 4
    assert words in run.stderr
    assert "--max-pixels" in run.stderr
    assert desk.run(*arguments, "--region", "20x10+0+0").code == 0


@pytest.mark.filterwarnings("ignore:.*colours under an alpha of 0")
def test_python_has_it_too(desk):
    path = str(desk / "a.png")
    for call in (
        lambda most: hpcomp.read_layer(path, max_pixels=most),
        lambda most: hpcomp.read_hues(path, max_pixels=most),
        lambda most: hpcomp.palette(["blue"], layers=[str(desk / "red.png")], max_pixels=most),
        lambda most: hpcomp.stack([path], desk / "out.exr", max_pixels=most),
        lambda most: hpcomp.explain([path], (0, 0), max_pixels=most),
    ):
        with pytest.raises(InputError, match="more than 199"):
            call(199)
        call("0.2K")
        with pytest.raises(SettingError, match="'lots' is not a number of pixels"):
            call("lots")
    deep = str(desk / "deep.exr")
    with pytest.raises(InputError, match="more than 199"):
        hpcomp.flatten(deep, desk / "out.exr", max_pixels=199)
    with pytest.raises(MismatchError, match="30x10"):
        hpcomp.stack([path], desk / "out.exr", canvas="30x10+0+0", max_pixels=200)


def claiming(width, height):
    """A PNG of some megabytes that could hold so many grey pixels; there are none in it."""
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = bytes(height * (width + 1) // 1032 + 1)
    return pngfile.join([(b"IHDR", header), (b"IDAT", data), (b"IEND", b"")])


@pytest.mark.parametrize("size", [(1, 2**31 - 1), (44722, 44722)])
def test_two_thousand_million_are_refused_unless_one_asks_for_them(desk, size):
    desk.put("huge.png", claiming(*size))
    for arguments in (["stack", "huge.png", "-o", "out.png"], ["hues", "huge.png"]):
        run = desk.run(*arguments)
        assert (run.code, run.stderr.count("\n")) == (3, 1)
        assert f"{size[0]}x{size[1]}" in run.stderr
        assert "more than 2,000,000,000" in run.stderr
        # Then it is what it is: no image data.
        assert "cannot be read, rows from 0 on" in desk.run(*arguments, "--max-pixels", "4G").stderr


def test_no_memory_is_taken_for_them(desk):
    desk.put("huge.png", claiming(1, 2**31 - 1))
    refused, code, _ = peak("hues", desk / "huge.png")
    small, _, _ = peak("hues", desk / "a.png")
    assert code == 3
    assert refused < small + 8  # the file itself has 4 MiB


def test_rows_that_are_asked_for_take_no_memory_before_they_are_made(desk):
    desk.put("huge.png", claiming(1, 2**31 - 1))
    out = ["-o", desk / "out.png", "--max-pixels", "4G"]
    small, code, _ = peak("stack", desk / "a.png", *out)
    assert code == 0
    asked, code, stderr = peak("stack", desk / "huge.png", *out)
    assert code == 3
    assert "cannot be read, rows from 0 on" in stderr
    assert asked < small + 32  # a few strips, and the file


def test_info_describes_it_and_says_so(desk):
    desk.put("huge.png", claiming(1, 2**31 - 1))
    exrfile.write(desk / "far.exr", exrfile.planes("RGBA", 2, 2), display=(0, 0, 60000, 60000))
    for name, claim in (("huge.png", "1x2147483647"), ("far.exr", "60000x60000")):
        run = desk.run("info", name)
        assert (run.code, run.stderr) == (0, "")
        assert f"warning: it claims {claim}" in run.stdout.decode()
        (file,) = json.loads(desk.run("info", "--json", name).stdout)["files"]
        assert [claim in text for text in file["warnings"]] == [True]
    (file,) = json.loads(desk.run("info", "--json", "a.png").stdout)["files"]
    assert file["warnings"] == []


@pytest.mark.parametrize(
    ("text", "number"), [("500M", 500_000_000), ("1.5g", 1_500_000_000), (7, 7), ("0.2K", 200)]
)
def test_numbers_of_pixels_are_in_thousands(text, number):
    assert parse_pixels(text) == number


@pytest.mark.parametrize("parse", [parse_pixels, parse_bytes])
@pytest.mark.parametrize("text", ["", "4X", "-1", "1e9", "4G 4G", "9" * 400, "1." + "9" * 400], ids=str)
def test_what_is_no_number_of_them_is_a_wrong_setting(parse, text):
    """Also more digits than a float has room for."""
    with pytest.raises(SettingError, match="is not a"):
        parse(text)


def test_few_bytes_hold_few_pixels(desk):
    """A byte of deflated data gives 1032 at most, and each row has a filter before its pixels."""
    png = claiming(1, 2_000_000)
    hpcomp.info(desk.put("a.png", png))
    few = pngfile.replace_chunk(png, b"IDAT", bytes(3000))
    with pytest.raises(InputError, match="its image data are too few for 1x2000000 pixels"):
        hpcomp.info(desk.put("a.png", few))
