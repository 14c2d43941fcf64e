"""Batches: the bytes of `hpcomp stack`, what fails and what goes on, and what a run remembers."""

import contextlib
import fcntl
import json
import os
import pty
import random
import re
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest
from batches import (
    is_making,
    is_over,
    jobs,
    noise,
    outputs,
    processes_of,
    put_jobs,
    records,
    temporaries,
    until,
)
from command import PATIENCE_S, Desk, command, loaded, sent_to

import hpcomp
from hpcomp.cli.progress import Progress
from hpcomp.errors import ExitCode, SettingError
from hpcomp.jobs.batch import SEVERITY
from hpcomp.jobs.frames import numbered, parse_frames


@pytest.fixture
def desk(tmp_path):
    desk = Desk.made(tmp_path)
    for number in range(3):
        hpcomp.write_image(desk / f"l{number}.png", noise(number))
    hpcomp.write_image(desk / "l3.exr", noise(3))
    return desk


# ---- the same bytes ------------------------------------------------------------------------------

#: Options of `stack` as a job and as a command line say them.
SAME = [
    ({"output": "out0.png"}, []),
    ({"output": "out1.png", "depth": 16, "order": [2, 0, 1], "hue_tolerance": 0.5},
     ["--depth", "16", "--order", "2,0,1", "--hue-tolerance", "0.5"]),
    ({"output": "out2.exr", "blending": "traditional", "background": "#102030", "depth": "float"},
     ["--blending", "traditional", "--background", "#102030", "--depth", "float"]),
    ({"output": "out3.png", "provenance": "out4.exr", "report": ["out5.json", "out6.csv"]},
     ["--provenance", "out4.exr", "--report", "out5.json", "--report", "out6.csv"]),
    ({"output": "out7.exr", "space": "oklab", "canvas": "union", "threads": 2, "max_memory": "64M"},
     ["--space", "oklab", "--canvas", "union"]),
]  # fmt: skip


@pytest.mark.parametrize("given", [[], ["-j", "1"], ["-j", "3", "--threads", "4"]], ids=len)
def test_the_bytes_are_those_of_stack(desk, given):
    layers = ["l0.png::name=a", "l3.exr::opacity=0.7,at=+3-2", "l1.png::op=atop"]
    put_jobs(desk, [{"layers": layers, **job} for job, _ in SAME])
    run = desk.run("batch", "jobs.json", *given)
    assert run.code == 0, run.stderr
    made = outputs(desk)
    for path in desk.folder.glob("out*"):
        path.unlink()
    for job, options in SAME:
        assert desk.run("stack", *layers, "-o", job["output"], *options).code == 0
    expected = outputs(desk)
    assert sorted(made) == sorted(expected)
    assert len(made) == 8
    for name in made:
        if name.endswith((".png", ".exr", ".csv")):  # other reports say what made them
            assert made[name] == expected[name], name
    assert temporaries(desk) == []


def test_jobs_of_python(desk, monkeypatch):
    monkeypatch.chdir(desk.folder)
    told = []
    result = hpcomp.batch(jobs(3), workers=2, on_record=lambda record, job: told.append(record))
    assert [record.status for record in result.records] == ["made"] * 3
    assert sorted(told, key=lambda record: record.job) == list(result.records)
    assert result.exit_code is ExitCode.DONE
    assert result.counts == {"made": 3}
    made = outputs(desk)
    for table in jobs(3):
        hpcomp.stack(table["layers"], table["output"])
    assert outputs(desk) == made
    assert hpcomp.batch([]).records == []


def test_stdin_and_stdout(desk):
    text = "".join(f"{json.dumps(job)}\n" for job in jobs(2))
    run = desk.run("batch", "-", "--format", "jsonl", "--log", "-", "-q", stdin=text.encode())
    assert (run.code, run.stderr) == (0, "")
    assert sorted(json.loads(line)["job"] for line in run.stdout.splitlines()) == [1, 2]
    assert [name for name in os.listdir(desk.folder) if name.startswith(".")] == []


def test_a_job_waits_for_what_it_reads(desk):
    chain = [
        {"layers": ["out2.png", "l1.png"], "output": "out3.png"},
        {"layers": ["l0.png", "l1.png"], "output": "out1.png"},
        {"layers": ["./out1.png", "l2.png"], "output": "out2.png"},
    ]
    put_jobs(desk, chain)
    assert desk.run("batch", "jobs.json", "-j", "3", "--log", "log").code == 0
    assert [record["job"] for record in records(desk)] == [2, 3, 1]


# ---- frames --------------------------------------------------------------------------------------


def put_frames(desk, numbers):
    for number in numbers:
        hpcomp.write_image(desk / f"a.{number:04d}.exr", noise(number))
        hpcomp.write_image(desk / f"b{number:02d}.png", noise(10 + number))


def test_frames_are_the_stacks_of_their_files(desk):
    put_frames(desk, [1, 3, 5])
    options = ["--order", "top-down", "--depth", "float", "--report", "out%d.json"]
    run = desk.run("stack", "a.%04d.exr", "b##.png::opacity=0.5", "l0.png", "-o", "out.###.exr",
                   "--frames", "1-6x2", "-j", "2", *options)  # fmt: skip
    assert run.code == 0, run.stderr
    made = outputs(desk)
    assert sorted(made) == sorted(f"out{n}" for k in (1, 3, 5) for n in (f".{k:03}.exr", f"{k}.json"))
    for number in (1, 3, 5):
        desk.makes("stack", f"a.{number:04}.exr", f"b{number:02}.png::opacity=0.5", "l0.png",
                   "-o", f"one{number}.exr", *options[:4])  # fmt: skip
        assert made[f"out.{number:03}.exr"] == (desk / f"one{number}.exr").read_bytes()


def test_a_missing_frame_is_one_line_and_the_others_are_made(desk):
    put_frames(desk, [1, 3])
    run = desk.run("stack", "a.%04d.exr", "l0.png", "-o", "out%d.png", "--frames", "1-3", "-q")
    assert run.code == 3
    assert sorted(outputs(desk)) == ["out1.png", "out3.png"]
    (line,) = run.lines
    assert line.startswith("hpcomp: error: frame 2 (out2.png): layer 0 (a.0002.exr): ")


def test_frames_can_be_saved_as_jobs(desk, monkeypatch):
    put_frames(desk, [1, 2])
    desk.makes("stack", "a.####.exr", "-o", "out%d.png", "--frames", "1-2", "--save-job", "s.jsonl")
    saved = hpcomp.read_jobs(desk / "s.jsonl")
    monkeypatch.chdir(desk.folder)
    direct = hpcomp.frame_jobs(["a.####.exr"], "out%d.png", "1,2")
    assert [job.document() for job in saved] == [job.document() for job in direct]
    assert hpcomp.batch(direct).counts == {"made": 2}


@pytest.mark.parametrize(
    ("text", "frames"),
    [("7", [7]), ("1-4", [1, 2, 3, 4]), ("1-8x3", [1, 4, 7]), ("5,1-2, 9", [5, 1, 2, 9]), ("-2-1", [-2, -1, 0, 1])],
)  # fmt: skip
def test_ranges_of_frames(text, frames):
    assert parse_frames(text) == frames


@pytest.mark.parametrize("text", ["", "a", "1-", "4-1", "1-4x0", "1-3,2", "1..3", "1-4x", "1-1000000000", "1-999999999", f"{'9' * 5000}"])
def test_what_is_no_range_of_frames(text):
    with pytest.raises(SettingError, match="frame"):
        parse_frames(text)


@pytest.mark.parametrize(
    ("path", "frame", "expected"),
    [("a.%04d.exr", 7, "a.0007.exr"), ("a%d.exr", 12, "a12.exr"), ("%03d/a.#####.exr", 7, "007/a.00007.exr"),
     ("a#.png", 123, "a123.png"), ("a.png", 1, "a.png"), ("a%s%.png", 1, "a%s%.png"),
     ("shot#2/a.%04d.png", 3, "shot#2/a.0003.png"), ("shot#2/a#.png", 3, "shot#2/a3.png"),
     ("shot#2/a.png", 3, "shot#2/a.png"), ("t#/a.##.png", 3, "t#/a.03.png"), ("a.%03i.png", 4, "a.004.png"),
     ("a.%099999d.png", 1, "a.%099999d.png")],
)  # fmt: skip
def test_names_of_frames(path, frame, expected):
    assert numbered(path, frame) == expected


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["a.%04d.exr", "-o", "o.exr"], ["a.%04d.exr", "--frames"]),
        (["l0.png", "-o", "o.####.exr", "--frames", "1-2"], ["no layer has a pattern"]),
        (["a.%04d.exr", "-o", "o.exr", "--frames", "1-2"], ["2 frames", "o.exr"]),
        (["a.%04d.exr", "-o", "o%d.exr", "--report", "r.json", "--frames", "1-2"], ["both write r.json"]),
        (["a.%04d.exr", "-o", "o%d.exr", "--frames", "2-1"], ["2-1"]),
        (["l0.png", "-o", "o.exr", "-j", "2"], ["-j"]),
    ],
)  # fmt: skip
def test_frames_that_mean_nothing(desk, arguments, says):
    put_frames(desk, [1, 2])
    desk.refuses(2, "stack", *arguments, says=says)


def test_a_file_with_the_name_of_a_pattern_is_itself(desk):
    put_frames(desk, [1, 2])
    for name in ("x##.png", "50%d.png"):
        hpcomp.write_image(desk / name, noise(8))
        desk.makes("stack", name, "-o", "out.png")
    desk.makes("stack", "l0.png", "-o", "out#1.png")
    run = desk.run("stack", "a.%04d.exr", "x##.png", "-o", "out%d.png", "--frames", "1,2", "-q")
    assert (run.code, run.stderr) == (0, "")


# ---- what fails ----------------------------------------------------------------------------------


def test_a_failure_does_not_stop_the_others(desk):
    desk.put("broken.png", b"no picture")
    tables = jobs(4)
    tables[1]["layers"][1] = "broken.png"
    tables[2]["layers"][0] = "out1.png"
    put_jobs(desk, tables)
    run = desk.run("batch", "jobs.json", "--log", "log", "-j", "2")
    assert run.code == ExitCode.INPUT
    assert sorted(outputs(desk)) == ["out0.png", "out3.png"]
    errors = [line for line in run.lines if line.startswith("hpcomp: error: ")]
    assert len(errors) == 2
    assert errors[0].startswith("hpcomp: error: jobs.json: job 2 (out1.png): layer 1 (broken.png)")
    assert "out1.png is made by job 2, which failed" in errors[1]
    assert run.lines[-1].endswith(": 2 made, 2 failed") or "2 failed, 2 made" in run.lines[-1]
    by_job = {record["job"]: record for record in records(desk)}
    assert [by_job[n]["status"] for n in (1, 2, 3, 4)] == ["made", "failed", "failed", "made"]
    assert by_job[2]["exit_code"] == 3
    assert by_job[2]["inputs"] == ["l0.png", "broken.png", "l2.png"]
    assert by_job[1]["outputs"] == ["out0.png"]
    assert by_job[1]["error"] is None
    assert 0 < by_job[1]["seconds"] < PATIENCE_S
    assert 10 << 20 < by_job[1]["peak_memory"] < 1 << 30
    quiet = desk.run("batch", "jobs.json", "-q")
    assert sorted(quiet.lines) == sorted(errors)


def test_the_exit_code_is_that_of_the_worst_failure(desk):
    tables = jobs(3)
    tables[0]["layers"][0] = f"{tables[0]['layers'][0]}::op=over"  # 2: the bottom layer has no operator
    tables[1]["layers"][0] = "gone.png"  # 3
    tables[2]["output"] = "gone/out.png"  # 5
    for count, code in ((1, 2), (2, 3), (3, 5)):
        put_jobs(desk, tables[:count])
        assert desk.run("batch", "jobs.json").code == code
    failures = [ExitCode.BUG, ExitCode.OUTPUT, ExitCode.INPUT, ExitCode.MISMATCH, ExitCode.USAGE]
    assert list(SEVERITY) == [*failures, ExitCode.DONE]


@pytest.mark.parametrize("option", [{"space": "oklb"}, {"report": "x.xyz"}, {"order": "0,2"}, {"depth": "half"}])
def test_a_value_that_no_job_can_have_is_said_before_any_is_made(desk, option):
    tables = jobs(3)
    tables[2] |= option
    put_jobs(desk, tables)
    (key,) = option
    desk.refuses(2, "batch", "jobs.json", says=["jobs.json:", "job 3", key.split("_")[0]])


def test_fail_fast_begins_no_more(desk):
    tables = jobs(6)
    tables[1]["layers"][0] = "gone.png"
    put_jobs(desk, tables)
    run = desk.run("batch", "jobs.json", "--fail-fast", "-j", "1", "--log", "log")
    assert run.code == 3
    assert [r["status"] for r in records(desk)] == ["made", "failed", *["not run"] * 4]
    assert sorted(outputs(desk)) == ["out0.png"]


def test_warnings_name_the_job_and_are_in_the_log(desk):
    hpcomp.write_image(desk / "wide.exr", noise(1) * 4 - 1)
    put_jobs(desk, [{"layers": ["wide.exr"], "output": "out0.png"}])
    run = desk.run("batch", "jobs.json", "--log", "log")
    assert run.code == 0
    (record,) = records(desk)
    assert record["warnings"]
    for warning in record["warnings"]:
        assert f"hpcomp: warning: jobs.json: job 1 (out0.png): {warning}" in run.lines
    assert desk.run("batch", "jobs.json", "-q").stderr == ""


@pytest.mark.parametrize(
    ("tables", "code", "says"),
    [
        ([*jobs(2), {"layers": ["l0.png"], "output": "./out1.png"}], 2,
         ["job 3", "job 2", "both write ./out1.png"]),
        ([{"layers": ["out1.png"], "output": "out0.png"},
          {"layers": ["out0.png"], "output": "out1.png"}], 2, ["wait for each other"]),
        ([{"layers": ["l0.png"], "output": "o.png", "spcae": 1}], 2, ["jobs.json:1", "did you mean"]),
    ],
)  # fmt: skip
def test_jobs_that_make_no_sense_together_are_not_begun(desk, tables, code, says):
    put_jobs(desk, tables)
    run = desk.run("batch", "jobs.json")
    assert run.code == code
    assert run.lines[-1].startswith("hpcomp: error: ")
    for words in says:
        assert words in run.lines[-1]
    assert outputs(desk) == {}


@pytest.mark.parametrize("option", ["--update", "--resume"])
def test_what_remembers_needs_a_file_for_it(desk, option):
    text = json.dumps(jobs(1)).encode()
    run = desk.run("batch", "-", "--format", "json", option, stdin=text)
    assert run.code == 2
    assert "--state" in run.lines[-1]
    for status in ("made", "current"):
        run = desk.run("batch", "-", "--format", "json", option, "--state", "kept", stdin=text)
        assert (run.code, run.lines[-1].rpartition(": 1 ")[2]) == (0, status)


def test_a_process_that_dies_fails_its_job_alone(desk):
    hpcomp.write_image(desk / "l0.png", noise(0, (3000, 2000)))
    tables = [{"layers": ["l0.png"], "output": f"out{n}.png", "compression": "9"} for n in range(2)]
    put_jobs(desk, tables)
    with subprocess.Popen(
        command("batch", "jobs.json", "-j", "1", "--log", "log"),
        cwd=desk.folder, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        until(lambda: is_making(desk))
        os.kill(processes_of(process.pid)[0], signal.SIGKILL)
        error = process.communicate(timeout=PATIENCE_S)[1].decode()
    assert process.returncode == ExitCode.BUG
    assert "out0.png): the process that made it was ended by SIGKILL" in error
    assert sorted(outputs(desk)) == ["out1.png"]
    assert temporaries(desk) == []


# ---- how it goes ---------------------------------------------------------------------------------


def test_a_line_for_each_job_and_a_summary(desk):
    put_jobs(desk, jobs(3))
    run = desk.run("batch", "jobs.json")
    assert run.stdout == b""
    assert len(run.lines) == 4
    for number, line in enumerate(run.lines[:3], 1):
        assert line.startswith(f"hpcomp: {number}/3 out")
    assert run.lines[3].startswith("hpcomp: 3 jobs in ")


def on_a_terminal(desk, *arguments, columns=90, term="xterm"):
    """(exit code, what stderr, a terminal of that kind and width, is sent)."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    process = subprocess.Popen(
        command(*arguments), cwd=desk.folder, stderr=theirs, env={**os.environ, "TERM": term}
    )
    os.close(theirs)
    text = sent_to(ours).decode().replace("\r\n", "\n")
    return process.wait(PATIENCE_S), text


@pytest.mark.parametrize("columns", [30, 90, 0])
def test_a_terminal_has_a_bar_with_rate_and_time_left(desk, columns):
    tables = jobs(3)
    tables[0]["layers"][0] = "gone.png"
    put_jobs(desk, tables)
    code, text = on_a_terminal(desk, "batch", "jobs.json", columns=columns)
    assert code == 3
    parts = [line for line in re.split("[\r\n]", text) if line.strip()]
    bars = [part for part in parts if part.startswith("[")]
    assert bars[0].startswith("[-")
    assert " 0/3 ?/s ? left" in bars[0]
    assert all(len(bar) <= (columns or 79) for bar in bars)  # a recorder's terminal tells no width
    assert len([part for part in parts if "hpcomp: error: " in part]) == 1
    assert parts[-1].startswith("hpcomp: 3 jobs in ")


def test_a_bar_counts_jobs_and_failures(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("tqdm.std._screen_shape_wrapper", lambda: lambda file: (40, 24))
    progress = Progress(quiet=False)
    progress.begin(4)
    progress.message("hpcomp: warning: a line of its own")
    for failed in (False, True, False):
        time.sleep(0.11)  # longer than between two drawings
        progress.count(True, failed, "no line of its own")
    time.sleep(0.11)
    progress.draw()
    progress.clear()
    sent = capsys.readouterr().err
    lines = [part for part in re.split("[\r\n]", sent) if part.strip()]
    assert lines[1] == "hpcomp: warning: a line of its own"
    bars = [line for line in lines if line.startswith("[")]
    assert [re.search(r"(\d)/4(, \d failed)?", bar)[0] for bar in bars] == [
        "0/4", "1/4", "2/4, 1 failed", "3/4, 1 failed", "3/4, 1 failed",
    ]  # fmt: skip
    assert bars[-1].endswith(" left")
    assert "/s " in bars[-1]
    assert "no line of its own" not in sent
    assert sent.endswith("\r")


@pytest.mark.parametrize("quiet", [False, True])
def test_a_dumb_terminal_has_lines(desk, quiet):
    put_jobs(desk, jobs(2))
    options = ["-q"] if quiet else []
    code, text = on_a_terminal(desk, "batch", "jobs.json", "-j", "1", *options, term="dumb")
    assert code == 0
    assert "\r" not in text
    assert "\x1b" not in text
    found = [line.rpartition(" in ")[0] for line in text.splitlines()]
    wanted = ["hpcomp: 1/2 out0.png", "hpcomp: 2/2 out1.png", "hpcomp: 2 jobs"]
    assert found == ([] if quiet else wanted)


def test_what_is_loaded(desk):
    assert not {"numpy", "tomllib", "tqdm", "graphlib", "hpcomp.jobs.batch"} & loaded(desk, "--help")
    assert "colour" not in loaded(desk, "batch", "--help")


# ---- what is left out ----------------------------------------------------------------------------


def statuses(desk, *options):
    run = desk.run("batch", "jobs.json", "--log", "log", *options)
    assert run.code == 0, run.stderr
    found = sorted(records(desk), key=lambda record: record["job"])
    return " ".join(record["status"] for record in found)


def test_skip_existing(desk):
    put_jobs(desk, [*jobs(2), {"layers": ["l0.png"], "output": "out9.png", "report": "out9.json"}])
    desk.put("out1.png", b"old")
    desk.put("out9.png", b"old")
    assert statuses(desk, "--skip-existing") == "made skipped made"
    assert (desk / "out1.png").read_bytes() == b"old"
    assert statuses(desk, "--skip-existing") == "skipped skipped skipped"


def rewrite(path, data):
    """Other content, but size and times as they were."""
    before = path.stat()
    path.write_bytes(data)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


@pytest.mark.slow
@pytest.mark.parametrize("first", [[], ["--update"]], ids=["plain", "update"])
def test_update_makes_what_changed_and_nothing_else(desk, first):
    for path in desk.folder.iterdir():
        os.utime(path, ns=(10**18, 10**18))  # not so young that nobody would trust their times
    tables = jobs(3)
    tables[2]["layers"] = ["l0.png", "l3.exr"]
    put_jobs(desk, tables)
    assert statuses(desk, *first) == "made made made"
    made = outputs(desk)
    assert statuses(desk, "--update") == "current current current"
    os.utime(desk / "l0.png")  # touched: all the same
    assert statuses(desk, "--update") == "current current current"
    tables[0]["depth"] = 16  # an option
    put_jobs(desk, tables)
    assert statuses(desk, "--update", "-j", "1") == "made current current"
    hpcomp.write_image(desk / "l3.exr", noise(7))
    assert statuses(desk, "--update") == "current current made"
    assert outputs(desk)["out2.png"] != made["out2.png"]
    (desk / "out1.png").unlink()  # an output
    assert statuses(desk, "--update") == "current made current"
    (desk / "out1.png").write_bytes(b"another's")
    assert statuses(desk, "--update", "--max-memory", "512M") == "current made current"
    assert outputs(desk)["out1.png"] == made["out1.png"]
    os.utime(desk / "out1.png")  # an output that was touched
    assert statuses(desk, "--update") == "current current current"
    rewrite(desk / "out1.png", made["out1.png"][:-1] + b"x")  # one that was damaged
    assert statuses(desk, "--update") == "current made current"
    assert statuses(desk) == "made made made"


def test_update_looks_at_content_where_size_and_time_are_the_same(desk):
    tables = [{"layers": ["raw.exr"], "output": "out0.exr"}]
    put_jobs(desk, tables)
    hpcomp.write_image(desk / "raw.exr", noise(1), compression="none")
    assert statuses(desk, "--update") == "made"
    hpcomp.write_image(desk / "other.exr", noise(2), compression="none")
    rewrite(desk / "raw.exr", (desk / "other.exr").read_bytes())
    assert statuses(desk, "--update") == "made"
    assert statuses(desk, "--update") == "current"


def test_failed_jobs_are_done_again(desk):
    put_jobs(desk, [{"layers": ["l0.png", "late.png"], "output": "out0.png"}])
    assert desk.run("batch", "jobs.json", "--update").code == 3
    hpcomp.write_image(desk / "late.png", noise(5))
    assert statuses(desk, "--update") == "made"
    hpcomp.write_image(desk / "late.png", noise(6))
    desk.put("late.png", b"broken")
    assert desk.run("batch", "jobs.json", "--update").code == 3
    assert desk.run("batch", "jobs.json", "--resume").code == 3


def test_resume_leaves_out_what_its_run_did_and_no_more(desk):
    put_jobs(desk, jobs(2))
    assert statuses(desk) == "made made"
    assert statuses(desk, "--resume") == "made current made current"  # the log grows
    put_jobs(desk, jobs(3))
    desk.put("log", b"")
    assert statuses(desk, "--resume") == "current current made"
    assert statuses(desk, "--update") == "current current current"
    put_jobs(desk, jobs(1))
    assert statuses(desk) == "made"  # a new run, of which the others are no part
    put_jobs(desk, jobs(3))
    desk.put("log", b"")
    assert statuses(desk, "--resume") == "current made made"


def test_a_damaged_state_is_a_job_more_to_do(desk):
    put_jobs(desk, jobs(2))
    assert statuses(desk, "-j", "1") == "made made"
    state = desk / ".jobs.json.hpcomp-state"
    state.write_bytes(state.read_bytes()[:-40] + b"\xff")
    assert statuses(desk, "--update") == "current made"
    state.write_bytes(b"\0" * 100)
    assert statuses(desk, "--update") == "made made"


def test_a_depfile_that_is_missing_is_made_again(desk):
    put_jobs(desk, jobs(1, depfile="out.d"))
    assert statuses(desk) == "made"
    (desk / "out.d").unlink()
    assert statuses(desk, "--update") == "made"
    assert (desk / "out.d").exists()
    assert statuses(desk, "--update") == "current"


def test_an_output_that_is_a_dangling_link_is_not_there(desk):
    put_jobs(desk, jobs(1))
    (desk / "out0.png").symlink_to("real.png")
    assert statuses(desk, "--skip-existing") == "made"
    assert (desk / "real.png").exists()


@pytest.mark.parametrize("lines", [b'{"run": "a", "prefix": 3}\n{"output": ["x"], "key": 1}\n',
                                   b'{"output": "%s", "key": "k"}\n[]\n"x"\n{}\n', b"[" * 100000])  # fmt: skip
def test_a_state_of_another_making_is_a_job_more_to_do(desk, lines):
    put_jobs(desk, jobs(1))
    (desk / ".jobs.json.hpcomp-state").write_bytes(lines.replace(b"%s", os.fsencode(desk / "out0.png")))
    assert statuses(desk, "--update") == "made"
    assert statuses(desk, "--update") == "current"


@pytest.mark.slow
def test_one_batch_at_a_time_has_a_state(desk):
    slow_jobs(desk)
    first = subprocess.Popen(command("batch", "jobs.json"), cwd=desk.folder, stderr=subprocess.PIPE)
    until(lambda: is_making(desk))
    second = desk.run("batch", "jobs.json")
    assert second.code == ExitCode.OUTPUT
    assert ".jobs.json.hpcomp-state is in use" in second.lines[-1]
    assert first.wait(PATIENCE_S) == 0
    first.communicate()
    assert len(outputs(desk)) == 4


@pytest.mark.slow
def test_what_is_left_goes_though_the_number_of_the_process_is_another_s(desk):
    """In containers a new run may well have the number of the old one."""
    slow_jobs(desk)
    first = subprocess.Popen(command("batch", "jobs.json"), cwd=desk.folder, stderr=subprocess.DEVNULL)
    until(lambda: is_making(desk))
    for pid in (*processes_of(first.pid), first.pid):
        os.kill(pid, signal.SIGKILL)
    first.wait()
    assert temporaries(desk)
    assert desk.run("batch", "jobs.json", "--resume").code == 0
    assert temporaries(desk) == []


def test_a_pipe_has_no_state_beside_it(desk):
    text = json.dumps(jobs(1)).encode()
    before = os.listdir("/dev")
    substituted = ["bash", "-c", 'exec "$@" 3< <(cat)', "bash"]
    for path, through in (("/dev/stdin", ()), ("/dev/fd/3", substituted)):
        batch = ("batch", path, "--format", "json")
        run = desk.run(*batch, "-q", stdin=text, through=through)
        assert (run.code, run.stderr) == (0, "")
        run = desk.run(*batch, "--update", stdin=text, through=through)
        assert (run.code, "--state" in run.lines[-1]) == (2, True)
    assert os.listdir("/dev") == before


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--log", "jobs.json"], "jobs.json"),
        (["--depfile", "jobs.json"], "jobs.json"),
        (["--state", "jobs.json"], "jobs.json"),
        (["--state", "l0.png"], "l0.png is read by"),
        (["--log", "l1.png"], "l1.png is read by"),
        (["--depfile", "l2.png"], "l2.png is read by"),
        (["--log", "out1.png"], "out1.png"),
        (["--depfile", "out0.png"], "out0.png"),
        (["--log", "x", "--depfile", "./x"], "two outputs"),
        (["--state", "l3.exr"], "l3.exr is no state"),
    ],
)  # fmt: skip
def test_files_of_the_batch_replace_nothing(desk, options, says):
    put_jobs(desk, jobs(2))
    line = desk.refuses(2, "batch", "jobs.json", *options, says=[])
    assert says in line


def test_jobs_do_not_share_a_depfile(desk):
    put_jobs(desk, jobs(2, depfile="all.d"))
    desk.refuses(2, "batch", "jobs.json", says=["both write all.d"])


def test_a_log_goes_on_after_a_line_that_was_cut(desk):
    put_jobs(desk, jobs(2))
    assert desk.run("batch", "jobs.json", "--log", "log").code == 0
    with open(desk / "log", "rb+") as file:
        file.truncate(file.seek(0, os.SEEK_END) - 30)
    assert desk.run("batch", "jobs.json", "--log", "log", "--resume").code == 0
    lines = (desk / "log").read_text().splitlines()
    assert [json.loads(line)["status"] for line in (lines[0], *lines[2:])] == ["made", "current", "current"]


def test_a_log_without_stdout_is_refused(desk):
    put_jobs(desk, jobs(1))
    run = desk.run("batch", "jobs.json", "--log", "-", through=["sh", "-c", 'exec "$@" >&-', "sh"])
    assert run.code == ExitCode.OUTPUT
    assert run.lines[-1] == "hpcomp: error: stdout is closed: give it a reader"


def test_a_folder_that_keeps_no_state(desk):
    state = desk / ".jobs.json.hpcomp-state"
    state.mkdir()
    put_jobs(desk, jobs(1))
    run = desk.run("batch", "jobs.json", "--update")
    assert run.code == 5
    assert state.name in run.lines[-1]


# ---- what ends it --------------------------------------------------------------------------------


def slow_jobs(desk, count=4):
    """Jobs that take long enough to be interrupted in."""
    hpcomp.write_image(desk / "big.png", noise(0, (1500, 1200)))
    put_jobs(
        desk,
        [{"layers": ["big.png", f"big.png::at=+{n}+0"], "output": f"out{n}.png", "compression": "9"}
         for n in range(count)],
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_it_in_the_midst_of_its_jobs_and_leaves_nothing(desk, number, code):
    slow_jobs(desk)
    process = subprocess.Popen(command("batch", "jobs.json"), cwd=desk.folder, stderr=subprocess.PIPE)
    until(lambda: processes_of(process.pid) and temporaries(desk))
    process.send_signal(number)
    error = process.communicate(timeout=PATIENCE_S)[1].decode()
    assert process.returncode == code
    assert temporaries(desk) == []
    assert "of 4 jobs have ended" in error
    assert outputs(desk).keys() < {f"out{n}.png" for n in range(4)}


@pytest.mark.slow
def test_killed_at_any_moment_it_is_resumed_to_the_same_bytes(desk):
    count = 12
    put_jobs(desk, jobs(count, compression="9"))
    begin = time.monotonic()
    assert desk.run("batch", "jobs.json").code == 0
    took = time.monotonic() - begin
    expected = outputs(desk)
    rng = random.Random(1)
    in_the_midst = 0
    for round_ in range(8):
        for name in expected:
            (desk / name).write_bytes(b"old") if round_ % 2 else (desk / name).unlink()
        process = subprocess.Popen(
            command("batch", "jobs.json"), cwd=desk.folder, stderr=subprocess.DEVNULL
        )
        time.sleep(rng.uniform(0.1, took))
        # In every other pair of rounds those that it has started as well, so that nobody is left
        # who could tidy up; else they do when they see that they are alone.
        with_it = processes_of(process.pid)
        in_the_midst += process.poll() is None
        for pid in (process.pid, *(with_it if round_ % 4 < 2 else ())):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.wait()
        until(lambda gone=with_it: all(is_over(pid) for pid in gone))
        for name, data in outputs(desk).items():
            assert data in (expected[name], b"old"), name
        run = desk.run("batch", "jobs.json", "--resume")
        assert run.code == 0, run.stderr
        assert outputs(desk) == expected
        assert temporaries(desk) == []
    assert in_the_midst >= 4


# ---- disks ---------------------------------------------------------------------------------------


def on_a_disk(options, then=""):
    """For `through`: a small file system of its own at disk/, which only the command sees.

    Afterwards what it holds is copied to kept/.
    """
    script = f'mkdir disk kept; mount -t tmpfs {options} tmpfs disk; "$@"; code=$?; cp -a disk/. kept; exit $code'
    return ["unshare", "--map-root-user", "--mount", "sh", "-c", script, "sh"]


def test_a_full_disk_fails_the_jobs_that_it_does_not_hold(desk):
    for number in range(3):
        hpcomp.write_image(desk / f"l{number}.png", noise(number, (300, 300)))
    tables = jobs(6, compression="0")
    for job in tables:
        job["output"] = f"disk/{job['output']}"
    put_jobs(desk, tables)
    run = desk.run("batch", "jobs.json", "-j", "2", "--log", "log", through=on_a_disk("-o size=1m"))
    assert run.code == ExitCode.OUTPUT
    told = records(desk)
    made = {Path(r["outputs"][0]).name for r in told if r["status"] == "made"}
    failed = [r for r in told if r["status"] == "failed"]
    assert 1 <= len(made) <= 2  # of 360 kB each, and one is being written beside them
    assert len(made) + len(failed) == 6
    for record in failed:
        assert "no space left on device" in record["error"]
        assert record["exit_code"] == ExitCode.OUTPUT
    assert {path.name for path in (desk / "kept").iterdir()} == made
    # What is there is whole, and the next run makes the rest.
    kept = {path.name: path.read_bytes() for path in (desk / "kept").iterdir()}
    (desk / "disk").rmdir()
    (desk / "kept").rename(desk / "disk")
    assert desk.run("batch", "jobs.json", "--resume").code == 0
    for name, data in kept.items():
        assert (desk / "disk" / name).read_bytes() == data
    assert len(list((desk / "disk").iterdir())) == 6


def test_a_directory_that_is_read_only(desk):
    tables = jobs(3)
    tables[1]["output"] = "disk/out1.png"
    put_jobs(desk, tables)
    run = desk.run("batch", "jobs.json", "--log", "log", through=on_a_disk("-o ro"))
    assert run.code == ExitCode.OUTPUT
    (line,) = [line for line in run.lines if "error" in line]
    assert "job 2 (disk/out1.png): disk/out1.png: cannot write in the directory disk: read-only" in line
    assert sorted(outputs(desk)) == ["out0.png", "out2.png"]
    run = desk.run("batch", "jobs.json", "--log", "disk/log", through=["sh", "-c", 'rm -r disk kept; exec "$@"', "sh", *on_a_disk("-o ro")])
    assert run.code == ExitCode.OUTPUT
    assert run.lines[-1].startswith("hpcomp: error: disk/log: ")


def test_job_files_on_a_read_only_disk_are_done_without_a_state(desk):
    script = 'mkdir disk; mount -t tmpfs tmpfs disk; cp jobs.json disk; mount -o remount,ro disk; exec "$@"'
    through = ["unshare", "--map-root-user", "--mount", "sh", "-c", script, "sh"]
    put_jobs(desk, jobs(1))
    assert desk.run("batch", "disk/jobs.json", through=through).code == 0
    assert list(outputs(desk)) == ["out0.png"]
    (desk / "disk").rmdir()
    run = desk.run("batch", "disk/jobs.json", "--update", through=through)
    assert run.code == ExitCode.OUTPUT
    assert "disk/.jobs.json.hpcomp-state" in run.lines[-1]


@pytest.mark.slow
def test_an_input_that_is_replaced_in_mid_run_is_never_mixed(desk):
    """Each picture is of the old layer or of the new one, or its job failed; --update mends it."""
    slow_jobs(desk, 6)
    hpcomp.write_image(desk / "new.png", noise(9, (1500, 1200)))
    pure = {}
    for name in ("big.png", "new.png"):
        os.link(desk / name, desk / "keep")
        pure[name] = (desk / "keep").read_bytes()
        (desk / "keep").unlink()
    process = subprocess.Popen(
        command("batch", "jobs.json", "--update", "--log", "log"), cwd=desk.folder, stderr=subprocess.PIPE
    )
    until(lambda: is_making(desk))
    os.replace(desk / "new.png", desk / "big.png")
    error = process.communicate(timeout=PATIENCE_S)[1].decode()
    made = outputs(desk)
    failed = [r for r in records(desk) if r["status"] == "failed"]
    assert process.returncode == (3 if failed else 0), error
    for record in failed:
        assert "changed while it was read" in record["error"]
    expected = {}
    for state in ("big.png", "new.png"):
        (desk / "big.png").write_bytes(pure[state])
        assert desk.run("batch", "jobs.json", "-q", "--state", "other").code == 0
        expected[state] = outputs(desk)
    kinds = [state for name in made for state in expected if made[name] == expected[state][name]]
    assert len(kinds) == len(made)
    assert "new.png" in kinds  # it did happen in the midst of them
    for name, data in made.items():
        (desk / name).write_bytes(data)
    run = desk.run("batch", "jobs.json", "--update")
    assert run.code == 0, run.stderr
    assert outputs(desk) == expected["new.png"]
