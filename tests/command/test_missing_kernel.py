"""Commands where the kernel was not built: the reference engine does the work, and that is said once."""

import os
import shutil
from pathlib import Path

import pytest
from batches import jobs, noise, outputs, put_jobs, records
from command import Desk

import hpcomp
from hpcomp.engine.choice import VARIABLE

SAID = "hpcomp: warning: the kernel was not built, and the reference engine"


@pytest.fixture(scope="module")
def without_kernel(tmp_path_factory):
    """The environment of a command whose package has no module of the kernel."""
    folder = tmp_path_factory.mktemp("without")
    shutil.copytree(
        Path(hpcomp.__file__).parent,
        folder / "hpcomp",
        ignore=shutil.ignore_patterns("_kernel*", "__pycache__"),
    )
    return {"PYTHONPATH": str(folder), VARIABLE: ""}


@pytest.fixture
def desk(tmp_path):
    desk = Desk.made(tmp_path)
    for number in range(3):
        hpcomp.write_image(desk / f"l{number}.png", noise(number))
    return desk


@pytest.mark.parametrize("options", [[], ["--strict"], ["--order", "balanced", "--report", "out.json"]])
def test_it_is_said_once_and_is_no_error(desk, without_kernel, options):
    arguments = ["stack", "l0.png", "l1.png", "l2.png", "-o", "out.png", *options]
    run = desk.run(*arguments, env=without_kernel)
    (line,) = run.lines
    assert run.code == 0
    assert line.startswith(SAID)
    assert f"{VARIABLE}=reference" in line
    picture = (desk / "out.png").read_bytes()
    desk.makes(*arguments, env={VARIABLE: "reference"})
    assert (desk / "out.png").read_bytes() == picture


@pytest.mark.parametrize(
    ("options", "chosen"), [(["-q"], ""), ([], "reference")], ids=["quiet", "chosen"]
)
def test_it_is_not_said_to_who_asked_for_it_or_for_silence(desk, without_kernel, options, chosen):
    env = {**without_kernel, VARIABLE: chosen}
    desk.makes("stack", "l0.png", "l1.png", "-o", "out.png", *options, env=env)


def test_a_batch_says_it_once_for_all_its_processes(desk, without_kernel):
    put_jobs(desk, jobs(4))
    run = desk.run("batch", "jobs.json", "-j", "2", "--log", "log", env=without_kernel)
    assert run.code == 0
    assert [line.startswith(SAID) for line in run.lines].count(True) == 1
    assert [record["warnings"] for record in records(desk)] == [[]] * 4
    assert len(outputs(desk)) == 4
    assert desk.run("batch", "jobs.json", "-j", "2", "-q", env=without_kernel).stderr == ""


def test_the_version_is_the_answer_and_needs_no_warning(desk, without_kernel):
    run = desk.makes("--version", env=without_kernel)
    assert run.stdout.endswith(b"(engine: reference)\n")


def test_a_command_that_composites_nothing_does_not_say_it(desk, without_kernel):
    desk.makes("info", "l0.png", env=without_kernel)


def test_who_asked_for_the_kernel_is_told_what_to_do(desk, without_kernel):
    env = {**without_kernel, VARIABLE: "kernel"}
    says = ["not built", "C++ compiler"]
    desk.refuses(2, "stack", "l0.png", "-o", "out.png", says=says, env=env)
    assert not os.path.exists(desk / "out.png")
