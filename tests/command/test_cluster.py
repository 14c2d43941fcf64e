"""Batches on a Dask cluster: a real scheduler and workers, each a process of its own."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from batches import (
    is_making,
    jobs,
    noise,
    outputs,
    processes_of,
    put_jobs,
    records,
    temporaries,
    until,
)
from command import PATIENCE_S, Desk, command

import hpcomp
from hpcomp.jobs import cluster, doing
from hpcomp.jobs.schema import jobs_of

DASK = Path(sys.executable).with_name("dask")


@dataclass
class Machines:
    """A scheduler and workers, in directories of their own."""

    folder: Path
    scheduler: subprocess.Popen
    workers: list[subprocess.Popen] = field(default_factory=list)

    @property
    def file(self):
        return self.folder / "scheduler.json"

    @property
    def address(self):
        return json.loads(self.file.read_text())["address"]

    def add_worker(self):
        self.workers.append(_started(self.folder, "worker", "--no-nanny", "--nthreads", "1"))
        return self.workers[-1]

    def await_workers(self, count):
        """Waits until so many are there."""
        import distributed

        with distributed.Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=PATIENCE_S)


def _started(folder, *arguments):
    with open(folder / f"{arguments[0]}.log", "ab") as messages:
        return subprocess.Popen(
            [DASK, *arguments, "--scheduler-file", folder / "scheduler.json", "--no-dashboard"],
            cwd=folder, stdout=messages, stderr=messages, start_new_session=True,
        )  # fmt: skip


@pytest.fixture
def machines(tmp_path):
    folder = tmp_path / "machines"
    folder.mkdir()
    found = Machines(folder, _started(folder, "scheduler", "--port", "0", "--host", "127.0.0.1"))
    until(lambda: found.file.exists() and found.file.read_bytes().endswith(b"}"))
    yield found
    for process in (*found.workers, found.scheduler):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.fixture
def desk(tmp_path):
    desk = Desk.made(tmp_path)
    for number in range(3):
        hpcomp.write_image(desk / f"l{number}.png", noise(number, (700, 600)))
    return desk


def begun(desk, *options):
    """A batch that is running: some of its jobs are being done."""
    process = subprocess.Popen(
        command("batch", "jobs.json", "--log", "log", *options),
        cwd=desk.folder, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    until(lambda: process.poll() is not None or is_making(desk))
    assert process.poll() is None, process.stderr.read()
    return process


def is_alive(group):
    """Whether any process of a group is."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def end_of(process):
    """(exit code, stderr)."""
    error = process.communicate(timeout=PATIENCE_S)[1].decode()
    return process.returncode, error


# ---- the same bytes ------------------------------------------------------------------------------


def test_a_worker_that_is_killed_loses_no_frame_and_changes_no_byte(desk, machines):
    count = 8
    put_jobs(desk, jobs(count, compression="9", report="out{}.json"))
    assert desk.run("batch", "jobs.json").code == 0
    expected = outputs(desk)
    assert len(expected) == 2 * count
    for name in expected:
        (desk / name).unlink()
    first, _ = machines.add_worker(), machines.add_worker()
    machines.await_workers(2)
    process = begun(desk, "--dask", machines.address)
    until(lambda: processes_of(first.pid))
    # The only process of the worker, which is given a job as soon as it ends one.
    first.kill()
    code, error = end_of(process)
    assert code == 0, error
    assert error.count("/8 out") == count
    assert outputs(desk).keys() == expected.keys()
    for name, data in outputs(desk).items():
        if name.endswith(".png"):  # a report says what command made it
            assert data == expected[name], name
    assert [record["status"] for record in records(desk)] == ["made"] * count
    assert temporaries(desk) == []
    assert machines.scheduler.poll() is None


def test_the_log_and_the_exit_code_are_those_of_a_local_run(desk, machines):
    """A scheduler file names the cluster as well; jobs see the directory of the batch."""
    machines.add_worker()
    hpcomp.write_image(desk / "wide.exr", noise(1) * 4 - 1)
    tables = jobs(4)
    tables[1]["layers"][1] = "gone.png"
    tables[2]["layers"] = ["wide.exr"]
    tables[3]["layers"][0] = "out0.png"
    put_jobs(desk, tables)
    runs = []
    for where in ([], ["--dask", machines.file, "-j", "3"]):
        run = desk.run("batch", "jobs.json", "--log", "log", *where)
        assert (run.code, run.stdout) == (3, b"")
        told = sorted(records(desk), key=lambda record: record["job"])
        for record in told:
            assert record.pop("seconds") > 0
            assert record.pop("peak_memory") > 10 << 20
        messages = sorted(line for line in run.lines if " in " not in line)
        runs.append((told, messages, outputs(desk)))
    assert runs[0] == runs[1]
    assert [record["status"] for record in runs[0][0]] == ["made", "failed", "made", "made"]
    assert runs[0][0][2]["warnings"]


@pytest.mark.slow
def test_a_cluster_of_ones_own_and_what_is_remembered(desk):
    put_jobs(desk, jobs(3))
    for status in ("made", "current"):
        run = desk.run("batch", "jobs.json", "--dask", "local:2", "--update")
        assert run.code == 0, run.stderr
        assert run.lines[-1].endswith(f": 3 {status}")
    made = outputs(desk)
    assert desk.run("batch", "jobs.json", "-q").stderr == ""
    assert outputs(desk) == made
    assert temporaries(desk) == []


def test_the_environment_of_the_batch_decides_over_the_bytes(desk, machines):
    machines.add_worker()
    put_jobs(desk, jobs(1, output="out.png"))
    env = {"SOURCE_DATE_EPOCH": "0"}
    assert desk.run("batch", "jobs.json", "--dask", machines.address, env=env).code == 0
    far = outputs(desk)
    assert desk.run("batch", "jobs.json", env=env).code == 0
    assert outputs(desk) == far
    assert b"tIME" in far["out.png"]


# ---- what ends it --------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["int", "term"])
def test_a_signal_ends_the_jobs_on_the_workers(desk, machines, number):
    worker = machines.add_worker()
    machines.await_workers(1)
    put_jobs(desk, jobs(6, compression="9"))
    process = begun(desk, "--dask", machines.address)
    process.send_signal(number)
    code, error = end_of(process)
    assert code == {2: 130, 15: 143}[number]
    assert len(outputs(desk)) < 6
    assert "of 6 jobs have ended" in error
    assert temporaries(desk) == []
    until(lambda: not processes_of(worker.pid))
    assert worker.poll() is None
    assert desk.run("batch", "jobs.json", "--resume", "--dask", machines.address).code == 0
    assert len(outputs(desk)) == 6


@pytest.mark.slow
def test_ctrl_c_ends_a_cluster_of_ones_own(desk):
    put_jobs(desk, jobs(8, compression="9"))
    process = begun(desk, "--dask", "local:2")
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to all of the group
    code, error = end_of(process)
    assert code == 130
    assert "Traceback" not in error
    assert temporaries(desk) == []
    until(lambda: not is_alive(process.pid))


def test_a_batch_that_is_killed_leaves_whole_files_and_no_process_for_long(desk, machines, monkeypatch):
    worker = machines.add_worker()
    machines.await_workers(1)
    put_jobs(desk, jobs(6, compression="9"))
    process = begun(desk, "--dask", machines.address)
    process.kill()
    end_of(process)
    until(lambda: not temporaries(desk))
    for name in outputs(desk):
        assert hpcomp.read_layer(desk / name).pixels.any()
    assert desk.run("batch", "jobs.json", "--resume", "--dask", machines.address).code == 0
    assert len(outputs(desk)) == 6
    assert worker.poll() is None


def test_a_scheduler_that_dies_fails_the_jobs(desk, machines):
    machines.add_worker()
    machines.await_workers(1)
    put_jobs(desk, jobs(6, compression="9"))
    process = begun(desk, "--dask", machines.address)
    machines.scheduler.kill()
    code, error = end_of(process)
    assert code == 5, error
    assert "the scheduler is gone" in error
    assert "bug" not in error
    assert temporaries(desk) == []


def test_a_cluster_without_workers_waits_for_one_and_says_so(desk, machines):
    put_jobs(desk, jobs(2))
    process = subprocess.Popen(
        command("batch", "jobs.json", "--dask", machines.address),
        cwd=desk.folder, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert "has no workers: the jobs wait for one" in process.stderr.readline()
    machines.add_worker()
    assert process.communicate(timeout=PATIENCE_S)[1].splitlines()[-1].endswith(": 2 made")
    assert process.returncode == 0


# ---- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("address", "code", "says"),
    [("local:x", 2, "local:x"), ("local:0", 2, "local:0"), ("nowhere", 3, "nowhere: no Dask scheduler"),
     ("tcp://127.0.0.1:9", 3, "tcp://127.0.0.1:9: no Dask scheduler"), ("jobs.json", 3, "jobs.json")],
)  # fmt: skip
def test_what_is_no_cluster(desk, address, code, says):
    put_jobs(desk, jobs(1))
    run = desk.run("batch", "jobs.json", "--dask", address)
    assert run.code == code
    assert run.lines[-1].startswith("hpcomp: error: ")
    assert says in run.lines[-1]
    assert outputs(desk) == {}


def test_without_distributed_the_extra_is_named(desk):
    put_jobs(desk, jobs(1))
    shadow = desk.temporary.parent / "shadow"
    shadow.mkdir()
    (shadow / "distributed.py").write_text("raise ImportError('no distributed')")
    run = desk.run("batch", "jobs.json", "--dask", "local:1", env={"PYTHONPATH": str(shadow)})
    assert run.code == 5
    assert "hpcomp[dask]" in run.lines[-1]


def task_of(table, **more):
    (job,) = jobs_of([table])
    task = {"job": job.document(), "granted": {}, "entry": None, "remembered": False,
            "maker": doing.maker()}  # fmt: skip
    return task | more


def test_a_worker_of_another_version_makes_nothing(desk, monkeypatch):
    monkeypatch.chdir(desk.folder)
    result = doing.do_job(task_of(jobs(1)[0], maker=["0.0.1", "reference"]))
    assert (result["status"], result["exit_code"]) == ("failed", 4)
    assert "hpcomp 0.0.1 (engine: reference)" in result["error"]
    assert outputs(desk) == {}


def test_a_worker_without_the_directory_says_so(desk):
    result = cluster.do_there(task_of(jobs(1)[0]), "hpcomp.a.", str(desk / "none"), {})
    assert (result["status"], result["exit_code"]) == ("failed", 3)
    assert str(desk / "none") in result["error"]


def test_a_process_that_has_waited_too_long_is_replaced(desk, monkeypatch):
    monkeypatch.setattr(cluster, "IDLE_S", 2.0)
    there = ("hpcomp.b.", str(desk.folder), {})
    before = processes_of(os.getpid())
    for table in jobs(2):
        result = cluster.do_there(task_of(table), *there)
        assert result["status"] == "made", result
        (process,) = set(processes_of(os.getpid())) - set(before)
        with open(f"/proc/{process}/stat") as stat:
            until(lambda file=stat: file.seek(0) or file.read().split(") ")[1][0] == "Z")
    cluster.end_there("hpcomp.b.")
    assert processes_of(os.getpid()) == before
    assert len(outputs(desk)) == 2
