"""Outputs are the same wherever, whenever and by whom they are made: what no file may hold.

What a date that is asked for does, SOURCE_DATE_EPOCH, is in the tests of each format.
"""

import json
import platform
import shutil
import socket
import time
from pathlib import Path

import numpy as np
import pytest
from command import hpcomp

import hpcomp as package
from hpcomp.report.stackreport import _RENDERERS as REPORT_FORMATS

LAYERS = ["base.png", "roads.exr::opacity=0.6"]
ENDINGS = [*(name for name in REPORT_FORMATS if name != "text"), "txt"]
#: One command for each kind of output; `{}` stands for where the files are.
COMMANDS = [
    ["stack", *LAYERS, "-o", "{}map.png", "--provenance", "{}origin.exr", "--depfile", "{}map.d"]
    + [word for ending in ENDINGS for word in ("--report", f"{{}}report.{ending}")],
    ["stack", *LAYERS, "-o", "{}float.exr", "--depth", "float", "--compression", "piz"],
    ["stack", *LAYERS, "-o", "{}wide.png", "--depth", "16", "--out-primaries", "display-p3"],
    *(["hues", "map.png", "-o", f"{{}}hues.{ending}"] for ending in ENDINGS),
    *(["palette", "a=#ff7200", "b=#0050ff", "-o", f"{{}}palette.{ending}"]
      for ending in ENDINGS if ending not in ("csv", "html")),
    ["stack", *LAYERS, "-o", "{}job.png", "--report", "{}job.html", "--save-job", "{}jobs.json"],
]  # fmt: skip
BATCH = ["batch", "jobs.json", "--log", "jobs.log", "--depfile", "jobs.d"]
#: What is about a run, and not about a picture: it may say how long that took, and when.
RECORDS = {"jobs.log", ".jobs.json.hpcomp-state"}


def put_layers(folder):
    folder.mkdir(parents=True)
    rgba = np.zeros((16, 24, 4), np.float32)
    rgba[...] = (0.3, 0.3, 0.3, 1)
    package.write_image(folder / "base.png", rgba)
    rgba[...] = 0
    rgba[4:12] = (0.6, 0.05, 0.05, 0.8)
    package.write_image(folder / "roads.exr", rgba)


def made(folder, where="", run_batch=True):
    """{name: bytes} of all that is there after the commands."""
    for words in COMMANDS:
        run = hpcomp(*(word.format(where) for word in words), cwd=folder)
        assert run.code == 0, run.stderr
    if run_batch:
        assert hpcomp(*BATCH, cwd=folder).code == 0
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """(folder, what was made there)."""
    folder = tmp_path_factory.mktemp("first-place") / "inner-place"
    put_layers(folder)
    return folder, made(folder)


@pytest.fixture
def elsewhere(monkeypatch):
    """Makes the process another user's, on another machine."""

    def moved(name):
        for variable in ("HOME", "USER", "LOGNAME", "HOSTNAME"):
            monkeypatch.setenv(variable, f"/home/{name}" if variable == "HOME" else name)
        monkeypatch.setenv("TZ", "Pacific/Apia")
        for module, function in ((socket, "gethostname"), (platform, "node")):
            monkeypatch.setattr(module, function, lambda: name)

    return moved


def test_outputs_hold_no_folder_user_host_or_time(place, tmp_path, elsewhere):
    first_folder, first = place
    folder = tmp_path / "second-place"
    put_layers(folder)
    elsewhere("somebody-else")
    time.sleep(1.1)  # a clock in whole seconds shows itself
    second = made(folder)
    assert {Path(name).suffix for name in first} >= {
        f".{e}" for e in (*ENDINGS, "exr", "d", "log", "hpcomp-state")
    }
    assert first.keys() == second.keys()
    for name, content in second.items():
        if name not in RECORDS:
            assert content == first[name], name
        for word in ("somebody-else", folder.name, str(tmp_path.parent)):
            assert word.encode() not in content, name
        assert first_folder.name.encode() not in first[name], name


def test_paths_stand_as_they_were_given_and_never_in_a_picture(place, tmp_path):
    _, without = place
    absolute = tmp_path / "absolute"
    put_layers(absolute)
    given = made(absolute, f"{absolute}/", run_batch=False)
    holding = {name for name, content in given.items() if str(absolute).encode() in content}
    assert holding == {"map.d", "report.json", "report.html", "report.txt", "jobs.json"}
    assert json.loads(given["report.json"])["command"].count(f"{absolute}/") == len(ENDINGS) + 3
    for name in given.keys() - holding:
        assert given[name] == without[name], name


@pytest.mark.parametrize("how", ["copied", "moved"])
def test_a_folder_that_was_copied_or_moved_is_up_to_date(place, tmp_path, how):
    copy = shutil.copytree(place[0], tmp_path / "copied")
    if how == "moved":
        assert hpcomp("batch", "jobs.json", cwd=copy).code == 0
        copy = copy.rename(tmp_path / "moved")
    run = hpcomp("batch", "jobs.json", "--update", cwd=copy)
    assert run.lines[-1].endswith(": 1 current")
