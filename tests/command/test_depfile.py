"""Depfiles as GNU make and ninja read them, outputs left alone where equal, dates that are written."""

import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import deepfile
import numpy as np
import OpenImageIO as oiio
import pytest
from command import COMMAND, Desk

import hpcomp
from hpcomp.errors import SettingError
from hpcomp.system.depfile import rule
from hpcomp.system.sourcedate import source_date

NINJA = Path(sys.executable).with_name("ninja")

#: Names that shells, make and ninja have their own ideas of.
NAMES = ["plain.png", "two words.png", "a#b.png", "a$b.png", "a:b.png", "100%.png", "~home.png", "a[1].png",
         "a?.png", "it's.png", 'a"b.png', "back\\slash.png", "back\\ slash.png", "a&b.png", "ä é.png",
         "x=y,(z)!.png"]  # fmt: skip


@pytest.fixture
def desk(tmp_path):
    desk = Desk.made(tmp_path)
    for name, value in (("base.png", 0.9), ("top.png", 0.4), ("other.exr", 0.2)):
        hpcomp.write_image(desk / name, np.full((4, 6, 4), value, np.float32))
    return desk


def read(desk, name="out.d"):
    return (desk / name).read_text()


# ---- what stands in it ---------------------------------------------------------------------------

RULE = "out.png: \\\n  base.png \\\n  top.png\n\nbase.png:\n\ntop.png:\n"


def test_a_stack_names_its_output_and_its_layers_once(desk):
    desk.makes("stack", "base.png", "top.png::opacity=0.5", "base.png", "-o", "out.png", "--depfile", "out.d")
    assert read(desk) == RULE


@pytest.mark.parametrize(
    ("more", "targets"),
    [
        ([], "out.png"),
        (["--report", "r.json", "--provenance", "p.exr"], "out.png"),
        (["--depfile-target", "stamp"], "stamp"),
        (["--depfile-target", "a", "--depfile-target", "b c"], "a b\\ c"),
    ],
)
def test_the_target_is_the_picture_or_what_is_asked_for(desk, more, targets):
    desk.makes("stack", "base.png", "top.png", "-o", "out.png", "--depfile", "out.d", *more)
    assert read(desk) == RULE.replace("out.png", targets, 1)


def test_streams_are_no_files_to_depend_on(desk):
    data = (desk / "base.png").read_bytes()
    arguments = ("-", "top.png", "/dev/fd/3", "-o", "-", "--format", "png", "--depfile", "out.d")
    through = ["bash", "-c", 'exec "$@" 3< <(cat base.png)', "bash"]
    run = desk.run("stack", *arguments, "--depfile-target", "x", stdin=data, through=through)
    assert (run.code, run.stderr) == (0, "")
    assert read(desk) == "x: \\\n  top.png\n\ntop.png:\n"


def test_stdout_takes_the_rule_where_nothing_else_does(desk):
    run = desk.makes("stack", "base.png", "top.png", "-o", "out.png", "--depfile", "-")
    assert run.stdout.decode() == RULE


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (["hues", "base.png", "top.png", "-o", "out.json"], RULE.replace("out.png", "out.json", 1)),
        (["hues", "base.png", "--format", "json", "--depfile-target", "x"],
         "x: \\\n  base.png\n\nbase.png:\n"),
        (["palette", "f00", "--from", "other.exr", "-o", "out.json"],
         "out.json: \\\n  other.exr\n\nother.exr:\n"),
        (["palette", "f00", "0f0", "-o", "out.json"], "out.json:\n"),
    ],
)  # fmt: skip
def test_reports_name_what_they_measured(desk, command, expected):
    hpcomp.write_image(desk / "other.exr", np.float32([[[0, 0.1, 0.5, 1]]]).repeat(9, 1))
    run = desk.run(*command, "--depfile", "out.d")
    assert (run.code, run.stderr) == (0, "")
    assert read(desk) == expected


def test_a_check_names_the_picture_and_its_layers_for_a_stamp(desk):
    desk.makes("stack", "base.png", "top.png", "-o", "out.png")
    check = ("check", "out.png", "base.png", "top.png::opacity=1", "--max-foreign", "1", "--depfile", "out.d")
    desk.refuses(2, *check, says=["--depfile-target"])
    assert desk.run(*check, "--depfile-target", "stamp").code == 0
    assert read(desk) == rule(["stamp"], ["out.png", "base.png", "top.png"])


def test_a_flattened_picture_names_its_deep_files(desk):
    deepfile.write(desk / "a.exr", deepfile.noise(6, 4, 3, seed=1))
    deepfile.write(desk / "b.exr", deepfile.noise(6, 4, 3, seed=2))
    desk.makes("flatten", "a.exr", "b.exr", "-o", "out.exr", "--depfile", "out.d", "--write-if-changed")
    assert read(desk) == rule(["out.exr"], ["a.exr", "b.exr"])
    before = identity(desk / "out.exr")
    desk.makes("flatten", "b.exr", "a.exr", "-o", "out.exr", "--write-if-changed")
    assert identity(desk / "out.exr") == before


def test_a_batch_names_its_job_file_and_not_what_it_makes_itself(desk):
    desk.put("jobs.jsonl", b'{"layers": ["base.png", "top.png"], "output": "a.png"}\n'
                           b'{"layers": ["./a.png", "other.exr"], "output": "b.png"}\n')  # fmt: skip
    run = desk.run("batch", "jobs.jsonl", "--depfile", "out.d", "-q")
    assert (run.code, run.stderr) == (0, "")
    inputs = ["jobs.jsonl", "base.png", "top.png", "other.exr"]
    assert read(desk) == rule(["a.png", "b.png"], inputs)
    assert desk.run("batch", "jobs.jsonl", "--depfile", "out.d", "--depfile-target", "s", "-q").code == 0
    assert read(desk) == rule(["s"], inputs)


def test_a_job_and_a_frame_have_depfiles_of_their_own(desk):
    for number in (1, 2):
        shutil.copy(desk / "top.png", desk / f"f{number}.png")
    desk.put("jobs.json", b'[{"layers": ["base.png"], "output": "a.png", "depfile": "a.d"}]')
    assert desk.run("batch", "jobs.json", "-q").code == 0
    assert read(desk, "a.d") == rule(["a.png"], ["base.png"])
    stack = ("stack", "base.png", "f%d.png", "-o", "o%d.png", "--frames", "1-2", "-q", "--depfile")
    assert desk.run(*stack, "o%d.d").code == 0
    for number in (1, 2):
        assert read(desk, f"o{number}.d") == rule([f"o{number}.png"], ["base.png", f"f{number}.png"])
    assert desk.run(*stack, "all.d").code == 0
    assert read(desk, "all.d") == rule(["o1.png", "o2.png"], ["base.png", "f1.png", "f2.png"])


def test_what_no_depfile_can_be(desk):
    stack = ("stack", "base.png")
    desk.refuses(2, *stack, "-o", "a.png", "--depfile-target", "x", says=["x", "--depfile"])
    desk.refuses(2, *stack, "-o", "-", "--format", "png", "--depfile", "out.d", says=["--depfile-target"])
    desk.refuses(2, *stack, "-o", "a.png", "--depfile", "a.png", says=["a.png", "two outputs"])
    desk.refuses(5, *stack, "-o", "a.png", "--depfile", "none/a.d", says=["none/a.d", "no directory"])
    desk.refuses(2, "hues", "base.png", "-o", "a.json", "--depfile", "a.json", says=["two outputs"])
    for name in ("new\nline.png", "a;b.png"):
        with pytest.raises(SettingError, match="rename it"):
            rule(["out.png"], [name])
    with pytest.raises(SettingError, match="depfile-target"):
        rule(["a=b.png"], [])


def test_a_run_that_fails_leaves_the_depfile_as_it_was(desk):
    desk.put("out.d", b"old")
    desk.put("broken.png", b"no picture")
    desk.refuses(3, "stack", "base.png", "broken.png", "-o", "out.png", "--depfile", "out.d", says=["broken.png"])


# ---- as make and ninja read it -------------------------------------------------------------------


def later(path):
    """Touches a file: all others are a minute older, in the order that they had."""
    for other in path.parent.iterdir():
        time = other.stat().st_mtime_ns - 60 * 10**9
        os.utime(other, ns=(time, time))
    os.utime(path)


@pytest.mark.parametrize("name", NAMES)
def test_make_reads_any_name(desk, name):
    """It is a layer of one picture, and the output of another one."""
    shutil.copy(desk / "top.png", desk / name)
    desk.put(
        "Makefile",
        b"all: out.png stamp\n"
        b"out.png:\n\t@" + bytes(COMMAND) + b" stack base.png -o $@ --depfile out.d -- \"$$NAME\"\n"
        b"\t@echo made $@\n"
        b"stamp:\n\t@" + bytes(COMMAND) + b' stack top.png -o "$$NAME.exr" --depfile s.d $$MORE\n'
        b"\t@touch stamp\n\t@echo made $@\n"
        b"-include out.d s.d\n",
    )  # fmt: skip
    environment = {**os.environ, "NAME": name, "MORE": "--depfile-target=x" if "=" in name else ""}
    run = lambda: subprocess.run(  # noqa: E731
        ["make"], cwd=desk.folder, env=environment, capture_output=True, text=True
    )
    first = run()
    assert (first.returncode, first.stdout) == (0, "made out.png\nmade stamp\n"), first.stderr
    again = run()
    assert (again.returncode, again.stderr) == (0, "")
    assert "made" not in again.stdout
    later(desk / name)
    touched = run()
    assert (touched.returncode, touched.stderr, touched.stdout) == (0, "", "made out.png\n")
    if "=" in name:
        return  # which an empty rule cannot have
    (desk / name).unlink()
    gone = run()  # an empty rule for it: the recipe runs, and it is hpcomp that misses the layer
    assert "No rule to make target" not in gone.stderr
    assert "hpcomp: error: layer 1 (" in gone.stderr


def ninja(desk, **environment):
    run = subprocess.run(
        [NINJA, "-v"], cwd=desk.folder, env={**os.environ, **environment}, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout
    return run.stdout


@pytest.mark.parametrize("name", NAMES)
def test_ninja_reads_any_name(desk, name):
    shutil.copy(desk / "top.png", desk / name)
    desk.put(
        "build.ninja",
        b"rule stack\n  command = " + bytes(COMMAND) + b' stack base.png -o out.png --depfile out.d -- "$$NAME"\n'
        b"  depfile = out.d\n  deps = gcc\n"
        b"build out.png: stack\n",
    )  # fmt: skip
    assert "[1/1]" in ninja(desk, NAME=name)
    assert "no work to do" in ninja(desk, NAME=name)
    later(desk / name)
    assert "[1/1]" in ninja(desk, NAME=name)
    listed = subprocess.run([NINJA, "-t", "deps", "out.png"], cwd=desk.folder, capture_output=True, text=True)
    assert listed.stdout.splitlines()[1:3] == ["    base.png", f"    {name}"]


def test_ninja_makes_again_what_a_missing_layer_was_in(desk):
    shutil.copy(desk / "top.png", desk / "x.png")
    text = (b"rule stack\n  command = " + bytes(COMMAND) + b" stack base.png %s -o out.png --depfile out.d\n"
            b"  depfile = out.d\n  deps = gcc\nbuild out.png: stack\n")  # fmt: skip
    desk.put("build.ninja", text % b"x.png")
    assert "[1/1]" in ninja(desk)
    (desk / "x.png").unlink()
    desk.put("build.ninja", text % b"top.png")
    assert "[1/1]" in ninja(desk)
    assert "no work to do" in ninja(desk)


# ---- outputs that are equal ----------------------------------------------------------------------


def identity(path):
    found = path.stat()
    return found.st_ino, found.st_mtime_ns


STACK = ("stack", "base.png", "top.png", "-o", "out.png", "--report", "out.json", "--provenance",
         "prov.exr", "--depfile", "out.d")  # fmt: skip


def test_equal_outputs_are_left_alone_and_others_are_replaced(desk):
    names = ["out.png", "out.json", "prov.exr", "out.d"]
    desk.makes(*STACK, "--write-if-changed")
    before = {name: identity(desk / name) for name in names}
    desk.makes(*STACK, "--write-if-changed")
    assert {name: identity(desk / name) for name in names} == before
    same = (desk / "out.png").read_bytes()
    for other in (same[:-1] + b"x", same + b"x", same[:-1]):
        (desk / "out.png").write_bytes(other)
        os.utime(desk / "out.png", ns=(1, 1))
        desk.makes(*STACK, "--write-if-changed")
        assert (desk / "out.png").read_bytes() == same
        assert identity(desk / "prov.exr") == before["prov.exr"]
    desk.makes(*STACK)
    assert identity(desk / "out.png") != before["out.png"]


def test_equal_reports_are_left_alone(desk):
    for command in (["hues", "base.png"], ["palette", "f00", "0f0"]):
        desk.makes(*command, "-o", "out.json", "--write-if-changed")
        before = identity(desk / "out.json")
        desk.makes(*command, "-o", "out.json", "--write-if-changed")
        assert identity(desk / "out.json") == before
        desk.makes(*command, "-o", "out.json")
        assert identity(desk / "out.json") != before


def test_a_batch_leaves_equal_outputs_alone(desk):
    desk.put("jobs.json", b'[{"layers": ["base.png"], "output": "a.png"},'
                          b'{"layers": ["top.png"], "output": "b.png", "write_if_changed": false}]')  # fmt: skip
    desk.run("batch", "jobs.json")
    before = [identity(desk / name) for name in ("a.png", "b.png")]
    assert desk.run("batch", "jobs.json", "--write-if-changed").code == 0
    assert identity(desk / "a.png") == before[0]
    assert identity(desk / "b.png") != before[1]  # a job's own setting goes first
    assert not [name for name in os.listdir(desk.folder) if name.startswith(".hpcomp.")]


def test_no_clobber_goes_first(desk):
    desk.makes(*STACK)
    desk.refuses(5, *STACK, "--write-if-changed", "--no-clobber", says=["out.png", "exists"])


def test_with_restat_ninja_makes_nothing_of_what_is_equal(desk):
    desk.put(
        "build.ninja",
        b"rule stack\n  command = " + bytes(COMMAND) + b" stack $in -o $out --write-if-changed\n  restat = 1\n"
        b"build middle.png: stack base.png\nbuild out.png: stack middle.png\n",
    )  # fmt: skip
    assert "[2/2]" in ninja(desk)
    later(desk / "base.png")
    assert "[1/2]" in (again := ninja(desk))
    assert "[2/2]" not in again
    assert "no work to do" in ninja(desk)


# ---- dates ---------------------------------------------------------------------------------------

#: SOURCE_DATE_EPOCH, and the same as PNG and EXR have it.
DATES = {"0": ("1970:01:01 00:00:00", (1970, 1, 1, 0, 0, 0)),
         "1000000000": ("2001:09:09 01:46:40", (2001, 9, 9, 1, 46, 40)),
         "253402300799": ("9999:12:31 23:59:59", (9999, 12, 31, 23, 59, 59))}  # fmt: skip


def png_time(data):
    at = data.find(b"tIME")
    return None if at < 0 else struct.unpack(">H5B", data[at + 4 : at + 11])


@pytest.mark.parametrize("epoch", [*DATES, ""])
@pytest.mark.parametrize("compression", ["zip", "piz"])
def test_the_date_of_the_environment_is_the_only_one_that_is_written(desk, epoch, compression):
    env = {"SOURCE_DATE_EPOCH": epoch, "TZ": "Asia/Tokyo"}
    exr, png = DATES.get(epoch, (None, None))
    for command in (
        ["stack", "base.png", "top.png", "-o", "out.png", "--provenance", "prov.exr"],
        ["stack", "base.png", "top.png", "-o", "out.exr", "--compression", compression],
    ):
        desk.makes(*command, env=env)
    assert png_time((desk / "out.png").read_bytes()) == png
    for name in ("out.exr", "prov.exr"):
        spec = oiio.ImageInput.open(str(desk / name)).spec()
        assert spec.getattribute("DateTime") == exr
        assert spec.getattribute("utcOffset") == (None if exr is None else 0)


@pytest.mark.parametrize(
    ("ending", "date"),
    [("svg", b"<dc:date>1970-01-01T00:00:00"), ("pdf", b"(D:19700101000000"), ("png", b"Thu, 01 Jan 1970 00:00:00 GMT")],
)  # fmt: skip
def test_figures_have_the_date_of_the_environment(desk, ending, date):
    for env, there in (({"SOURCE_DATE_EPOCH": "0", "TZ": "Asia/Tokyo"}, True), ({}, False)):
        desk.makes("hues", "base.png", "top.png", "-o", f"out.{ending}", env=env)
        data = (desk / f"out.{ending}").read_bytes()
        assert (date in data) == there
        if not there:
            assert not any(word in data for word in (b"dc:date", b"CreationDate", b"Creation Time"))


@pytest.mark.parametrize("epoch", ["soon", "-1", "1.5", "١", "253402300800", "9" * 30, " 1"])
def test_what_is_no_date(desk, epoch):
    env = {"SOURCE_DATE_EPOCH": epoch}
    for name in ("out.png", "out.exr"):
        line = desk.refuses(2, "stack", "base.png", "-o", name, env=env, says=["SOURCE_DATE_EPOCH"])
        assert "1970" in line


def test_a_changed_date_is_a_changed_option(desk, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    assert source_date().year == 1970
    desk.put("jobs.json", b'[{"layers": ["base.png"], "output": "a.png"}]')
    for epoch, status in (("0", "made"), ("0", "current"), ("5", "made")):
        run = desk.run("batch", "jobs.json", "--update", env={"SOURCE_DATE_EPOCH": epoch})
        assert run.lines[-1].endswith(f": 1 {status}")
