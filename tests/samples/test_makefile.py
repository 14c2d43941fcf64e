"""hpcomp in make and ninja: samples/Makefile, and outputs that are left alone where they are equal.

What depfiles hold, and how names are written in them, is in test_depfile.py.
"""

import itertools
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import command
import numpy as np
import pytest

import hpcomp

SAMPLES = Path(__file__).parents[2] / "samples"

PICTURES = {"traditional.png", "hue-preserving.png"}
#: What is made of the pictures, or beside one.
FROM_PICTURES = {"side-by-side.png", "hues.png"}
OF_ALL_LAYERS = {*PICTURES, *FROM_PICTURES, "report.html", "woven.png"}
FIGURES = {*OF_ALL_LAYERS, "palette.png", "palette.txt"}

#: Which figures a layer has a part in.
DEPENDENTS = {
    "hillshade.png": OF_ALL_LAYERS,
    "elevation.png": OF_ALL_LAYERS | {"palette.txt"},
    "steep.exr": OF_ALL_LAYERS | {"palette.txt"},
    "summits.exr": OF_ALL_LAYERS | {"palette.txt"},
    "fault.exr": OF_ALL_LAYERS | {"palette.txt"},
    "streams.png": OF_ALL_LAYERS | {"palette.txt"},
    "captions.png": {"side-by-side.png"},
}

#: A command a figure, but for the report, which is made beside its picture.
COMMANDS = len(FIGURES) - 1


def environment(**more):
    """That of a shell with the installed hpcomp in PATH, which no make has begun."""
    plain = {k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")}
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return {**plain, "PATH": path, **more}


def run(*arguments, cwd, **more):
    return subprocess.run(
        arguments,
        cwd=cwd,
        env=environment(**more),
        capture_output=True,
        text=True,
        timeout=command.PATIENCE_S,
    )


def makes(folder, *arguments):
    """What make prints, which ends well and without a word on stderr."""
    done = run("make", "--no-print-directory", *arguments, cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def commands(printed):
    """The hpcomp commands in what make printed, each in words."""
    joined = printed.replace("\\\n", " ")
    return [shlex.split(line) for line in joined.splitlines() if line.startswith("hpcomp ")]


def made_by(words):
    """The names of what a command writes, depfiles aside."""
    options = [b for a, b in itertools.pairwise(words) if a in ("-o", "--report")]
    return [Path(path).name for path in options]


def copied(folder):
    """The samples but for the paper, which has a Makefile of its own, and nothing built."""
    copy = folder / "samples"
    shutil.copytree(SAMPLES, copy, ignore=shutil.ignore_patterns("out", "paper"))
    return copy


def built(folder):
    """The bytes of each figure that is there; depfiles and hidden leftovers are none."""
    files = (folder / "terrain" / "out").glob("[!.]*")
    return {path.name: path.read_bytes() for path in files if path.suffix != ".d"}


def times(folder):
    return {p.name: p.stat().st_mtime_ns for p in (folder / "terrain" / "out").glob("*")}


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """The samples as the first make leaves them, and what it printed."""
    folder = copied(tmp_path_factory.mktemp("first"))
    return folder, makes(folder)


@pytest.fixture
def ours(samples, tmp_path):
    """A copy of them, with all its times, to change."""
    folder = tmp_path / "samples"
    shutil.copytree(samples[0], folder)
    return folder


# ---- the samples ---------------------------------------------------------------------------------


def test_the_first_make_makes_every_figure_with_a_command_each(samples):
    folder, printed = samples
    assert set(built(folder)) == FIGURES
    run_for = [name for words in commands(printed) for name in made_by(words)]
    assert sorted(run_for) == sorted(FIGURES)
    assert len(commands(printed)) == COMMANDS


def test_the_woven_picture_of_the_page_is_the_one_that_is_made(samples):
    made, shown = (
        hpcomp.read_layer(folder / "woven.png").pixels
        for folder in (samples[0] / "terrain" / "out", SAMPLES / "terrain")
    )
    assert made.shape == shown.shape
    differs = np.abs(made - shown).max(axis=-1) > 0.01
    assert differs.mean() < 0.001  # another processor may round a pixel to the other thread


def test_a_second_make_makes_nothing(samples):
    folder, _ = samples
    before = times(folder)
    assert makes(folder) == "make: Nothing to be done for 'all'.\n"
    assert times(folder) == before


def test_the_table_names_every_layer():
    assert set(DEPENDENTS) == {path.name for path in (SAMPLES / "terrain" / "layers").iterdir()}


@pytest.mark.parametrize("layer", DEPENDENTS)
def test_a_layer_that_was_touched_asks_for_what_depends_on_it_and_no_more(ours, layer):
    os.utime(ours / "terrain" / "layers" / layer)
    planned = [name for words in commands(makes(ours, "--dry-run")) for name in made_by(words)]
    assert sorted(planned) == sorted(DEPENDENTS[layer])


@pytest.mark.parametrize("layer", ["captions.png", "fault.exr"])
def test_and_just_that_is_made_again(ours, layer):
    before, contents = times(ours), built(ours)
    os.utime(ours / "terrain" / "layers" / layer)
    printed = makes(ours)
    assert len(commands(printed)) == len(DEPENDENTS[layer] - {"report.html"})
    changed = {name for name, at in times(ours).items() if at != before[name]}
    assert {name for name in changed if not name.endswith(".d")} == DEPENDENTS[layer]
    assert built(ours) == contents
    assert "Nothing to be done" in makes(ours)


@pytest.mark.parametrize("figure", sorted(FIGURES))
def test_a_figure_that_was_removed_is_made_again(ours, figure):
    (ours / "terrain" / "out" / figure).unlink()
    first = commands(makes(ours, "--dry-run"))[0]
    assert figure in made_by(first)


def test_two_jobs_at_a_time_give_the_same_bytes(samples, tmp_path):
    folder = copied(tmp_path)
    assert len(commands(makes(folder, "-j2"))) == COMMANDS
    assert built(folder) == built(samples[0])
    assert "Nothing to be done" in makes(folder, "-j2")


def test_a_layer_that_is_no_longer_used_may_go(ours):
    makefile = ours / "Makefile"
    text = makefile.read_text()
    makefile.write_text(
        text.replace("    terrain/layers/steep.exr ", "    ").replace(
            "--from terrain/layers/steep.exr ", ""
        )
    )
    assert text.count("steep.exr") == 2
    assert "steep.exr" not in makefile.read_text()
    os.utime(makefile)
    (ours / "terrain" / "layers" / "steep.exr").unlink()
    before = built(ours)
    assert len(commands(makes(ours))) == COMMANDS  # a command may have changed: all are run
    now = built(ours)
    assert {n for n in FIGURES if now[n] != before[n]} == FIGURES - {"palette.png"}
    assert "Nothing to be done" in makes(ours)


def test_a_layer_that_is_used_and_missing_is_said_to_be_and_no_figure_is_lost(ours):
    before = built(ours)
    (ours / "terrain" / "layers" / "streams.png").unlink()
    done = run("make", "--keep-going", cwd=ours)
    assert done.returncode == 2
    errors = [line for line in done.stderr.splitlines() if line.startswith("hpcomp: ")]
    assert len(errors) == 4  # three pictures and the palette
    assert all("layers/streams.png" in line and "no such file" in line for line in errors)
    assert built(ours) == before


def test_another_folder_and_another_command(tmp_path):
    folder = copied(tmp_path)
    printed = makes(folder, "--dry-run", "OUT=/tmp/other", "HPCOMP=../bin/hpcomp")
    words = [line.split() for line in printed.splitlines() if line.startswith("../bin/hpcomp")]
    assert len(words) == COMMANDS
    assert printed.startswith("mkdir -p /tmp/other\n")
    assert "terrain/out" not in printed


def test_clean_removes_what_was_built_and_the_leftovers_of_killed_runs(ours):
    (ours / "terrain" / "out" / ".hpcomp.0123456789abcdef").touch()
    makes(ours, "clean")
    assert not (ours / "terrain" / "out").exists()
    assert {p.name for p in ours.rglob("*") if p.is_file()} == {
        p.name for p in copied(ours.parent / "plain").rglob("*") if p.is_file()
    }


def test_clean_leaves_what_is_not_its_own(ours):
    (ours / "terrain" / "out" / "mine.png").touch()
    makes(ours, "clean")
    assert [p.name for p in (ours / "terrain" / "out").iterdir()] == ["mine.png"]


def test_help_is_the_head_of_the_makefile(ours):
    printed = makes(ours, "help")
    assert "make -C samples HPCOMP=../.venv/bin/hpcomp" in printed
    assert len(printed.splitlines()) < 12
    for line in printed.splitlines():
        assert f"# {line}".rstrip() in (SAMPLES / "Makefile").read_text()


def test_the_makefile_runs_the_commands_that_the_page_shows(samples):
    def plain(words):
        """A command of either as in the folder of the pictures, without what is for make alone."""
        left = iter(words)
        kept = [w for w in left if w not in ("--depfile", "--depfile-target") or not next(left)]
        return [w.replace("terrain/", "").replace("out/", "") for w in kept]

    page = (SAMPLES / "terrain" / "README.md").read_text().replace("\\\n", " ")
    lines = [line.strip() for line in page.splitlines() if re.match(r" *hpcomp ", line)]
    shown = [plain(shlex.split(line)) for line in lines]
    ran = [plain(words) for words in commands(samples[1])]
    # The page also makes the picture without its report, and prints the second palette.
    (with_report,) = (words for words in ran if "--report" in words)
    at = with_report.index("--report")
    ran.append(with_report[:at] + with_report[at + 2 :])
    (text,) = (words for words in ran if words[-1] == "palette.txt")
    del text[-2:]
    assert sorted(ran) == sorted(shown)


# ---- the paper, which may be beside the terrain --------------------------------------------------

PAPER = """
HPCOMP ?= hpcomp
PYTHON ?= python3
OUT ?= out
all:
	@mkdir -p $(OUT)
	@echo "$(HPCOMP) $(PYTHON)" >$(OUT)/figure
clean:
	rm -rf $(OUT)
"""


@pytest.mark.parametrize(
    ("given", "hpcomp_there", "python_there", "out"),
    [
        ([], "hpcomp", "python3", "paper/out"),
        (["HPCOMP=../bin/hpcomp", "PYTHON=../bin/python"], "{}/bin/hpcomp", "{}/bin/python",
         "paper/out"),
        (["OUT=figures"], "hpcomp", "python3", "figures/paper"),
    ],
    ids=["as it is", "relative commands", "another folder"],
)  # fmt: skip
def test_the_paper_is_built_and_cleaned_with_the_rest(
    tmp_path, given, hpcomp_there, python_there, out
):
    folder = copied(tmp_path)
    (folder / "paper").mkdir()
    assert "-C paper" not in makes(folder, "--dry-run", *given)
    (folder / "paper" / "Makefile").write_text(PAPER)
    assert "make -C paper" in makes(folder, "--dry-run", *given)
    makes(folder, "paper", *given)
    seen = (folder / out / "figure").read_text().split()
    assert seen == [name.format(tmp_path) for name in (hpcomp_there, python_there)]
    kept = folder / "figures" / "mine.png" if given == ["OUT=figures"] else folder / "mine.png"
    kept.touch()
    makes(folder, "clean", *given)
    assert not (folder / out).exists()
    assert kept.exists()


# ---- interrupted ---------------------------------------------------------------------------------

#: When a run is stopped: as soon as a file like this in the folder of figures is new or changes.
MOMENTS = (".hpcomp.*", "*.png.d", "*.png", "report.html", "hues.png.d")


def stopped(folder, pattern, signal_number):
    """A make whose whole process group gets a signal at that moment; whether it came in time."""
    out = folder / "terrain" / "out"

    def seen():
        return {(p.name, p.lstat().st_ino, p.lstat().st_mtime_ns) for p in out.glob(pattern)}

    before = seen() if out.exists() else set()
    process = subprocess.Popen(
        ["make", "-j2"],
        cwd=folder,
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    while process.poll() is None:
        try:
            if seen() - before:
                break
        except FileNotFoundError:
            pass  # renamed between the two looks
        time.sleep(0.001)
    if process.poll() is None:
        os.killpg(process.pid, signal_number)
    return process.wait(command.PATIENCE_S) != 0


@pytest.mark.slow
@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_first_make_leaves_whole_figures_or_none(samples, tmp_path, signal_number):
    whole = built(samples[0])
    folder = copied(tmp_path)
    in_time = 0
    for moment in MOMENTS:
        in_time += stopped(folder, moment, signal_number)
        for name, content in built(folder).items():
            assert content == whole[name], (moment, name)
    assert in_time >= 3
    makes(folder)
    assert built(folder) == whole
    assert "Nothing to be done" in makes(folder)


def test_a_make_that_is_killed_while_it_replaces_figures_leaves_old_or_new_ones(ours):
    old = built(ours)
    layers = ours / "terrain" / "layers"
    shutil.copy(layers / "steep.exr", layers / "fault.exr")  # other bytes in every figure
    left = []
    for moment in MOMENTS:
        stopped(ours, moment, signal.SIGKILL)
        left.append(built(ours))
    makes(ours)
    new = built(ours)
    assert {name for name in FIGURES if new[name] != old[name]} == DEPENDENTS["fault.exr"]
    for figures in left:
        assert set(figures) == FIGURES
        assert all(figures[name] in (old[name], new[name]) for name in FIGURES)
    assert left[0] != new
    assert "Nothing to be done" in makes(ours)


# ---- equal outputs are left alone ----------------------------------------------------------------


def write_layer(path, red, alpha):
    hpcomp.write_image(path, np.full((8, 8, 4), [red, 0.1, 0.1, alpha], np.float32))


@pytest.fixture
def desk(tmp_path):
    write_layer(tmp_path / "base.png", 0.1, 1)
    write_layer(tmp_path / "roads.png", 0.5, 0.5)
    return tmp_path


STAMPED = """
hues.json: map.png
	hpcomp hues map.png -o hues.json

map.png: map.stamp ;
map.stamp:
	hpcomp stack base.png roads.png -o map.png --write-if-changed --depfile map.d --depfile-target map.stamp
	touch map.stamp
-include map.d
"""


def assert_goes_no_further_than_what_has_changed(desk, run_of):
    """`run_of()`: builds, and gives the commands that this took."""
    assert run_of() == ["stack", "hues"]
    assert run_of() == []
    before = (desk / "map.png").stat()
    os.utime(desk / "roads.png")
    assert run_of() == ["stack"]
    assert run_of() == []
    after = (desk / "map.png").stat()
    assert (after.st_mtime_ns, after.st_ino) == (before.st_mtime_ns, before.st_ino)
    write_layer(desk / "roads.png", 0.25, 0.5)
    assert run_of() == ["stack", "hues"]
    assert run_of() == []


def test_make_with_a_stamp_goes_no_further_than_what_has_changed(desk):
    (desk / "Makefile").write_text(STAMPED)

    def run_of():
        return [words[1] for words in commands(makes(desk))]

    assert_goes_no_further_than_what_has_changed(desk, run_of)


NINJA = """
rule stack
  command = hpcomp stack $layers -o $out --write-if-changed --depfile $out.d
  depfile = $out.d
  deps = gcc
  restat = 1
rule hues
  command = hpcomp hues $in -o $out
build map.png: stack
  layers = base.png roads.png::opacity=0.5
build hues.json: hues map.png
"""


def test_ninja_takes_the_depfile_and_goes_no_further_than_what_has_changed(desk):
    (desk / "build.ninja").write_text(NINJA)

    def run_of():
        done = run(Path(sys.executable).with_name("ninja"), "--verbose", cwd=desk)
        assert (done.returncode, done.stderr) == (0, "")
        return re.findall(r"hpcomp (\w+)", done.stdout)

    assert_goes_no_further_than_what_has_changed(desk, run_of)
