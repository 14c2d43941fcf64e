"""Batches on a Dask cluster: a real scheduler and workers, each a process of its own."""

import asyncio
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass, field
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
from command import PATIENCE_S, Desk, command

import hpcomp
from hpcomp.jobs import cluster, doing, worker
from hpcomp.jobs.maker import maker
from hpcomp.jobs.schema import jobs_of

DASK = Path(sys.executable).with_name("dask")


@dataclass
class Machines:
    """A scheduler and workers, in directories of their own; `options` of both."""

    folder: Path
    options: tuple = ()
    scheduler: subprocess.Popen = None
    workers: list[subprocess.Popen] = field(default_factory=list)

    @property
    def file(self):
        return self.folder / "scheduler.json"

    @property
    def address(self):
        return json.loads(self.file.read_text())["address"]

    def add_worker(self):
        self.workers.append(self._started("worker", "--no-nanny", "--nthreads", "1"))
        return self.workers[-1]

    def await_workers(self, count):
        """Waits until so many are there."""
        with self.client() as client:
            client.wait_for_workers(count, timeout=PATIENCE_S)

    def client(self):
        import distributed

        return distributed.Client(self.address, set_as_default=False)

    def seen(self):
        """What the scheduler has seen: how many tasks there are, and how many of a prefix there were."""
        with self.client() as client:
            return client.run_on_scheduler(
                lambda dask_scheduler: (
                    len(dask_scheduler.tasks),
                    {p.name: p.state_counts["memory"] for p in dask_scheduler.task_prefixes.values()},
                )
            )

    def _started(self, *arguments, env=None):
        with open(self.folder / f"{arguments[0]}.log", "ab") as messages:
            return subprocess.Popen(
                [DASK, *arguments, *self.options, "--scheduler-file", self.file, "--no-dashboard"],
                cwd=self.folder, stdout=messages, stderr=messages, start_new_session=True,
                env={**os.environ, **(env or {})},
            )  # fmt: skip

    @contextlib.contextmanager
    def running(self, **env):
        """They run until the end of the block, the scheduler with these variables."""
        self.folder.mkdir()
        self.scheduler = self._started("scheduler", "--port", "0", "--host", "127.0.0.1", env=env)
        try:
            until(lambda: self.file.exists() and self.file.read_bytes().endswith(b"}"))
            yield self
        finally:
            for process in (*self.workers, self.scheduler):
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()


@pytest.fixture
def machines(tmp_path):
    with Machines(tmp_path / "machines").running() as found:
        yield found


@pytest.fixture
def desk(tmp_path):
    desk = Desk.made(tmp_path)
    for number in range(3):
        hpcomp.write_image(desk / f"l{number}.png", noise(number, (700, 600)))
    return desk


def small_layers(desk):
    """Layers of a few pixels: what costs is all around them."""
    for number in range(3):
        hpcomp.write_image(desk / f"l{number}.png", noise(number, (16, 16)))


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


def test_a_worker_that_is_killed_and_one_that_comes_change_no_byte(desk, machines):
    count = 16
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
    third = machines.add_worker()
    until(lambda: process.poll() is not None or processes_of(third.pid))
    assert process.poll() is None
    code, error = end_of(process)
    assert code == 0, error
    assert error.count("/16 out") == count
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


def test_a_process_that_is_killed_is_begun_again(desk, machines):
    worker = machines.add_worker()
    machines.await_workers(1)
    put_jobs(desk, jobs(3, compression="9"))
    assert desk.run("batch", "jobs.json").code == 0
    expected = outputs(desk)
    for name in expected:
        (desk / name).unlink()
    process = begun(desk, "--dask", machines.address)
    os.kill(processes_of(worker.pid)[0], signal.SIGKILL)
    code, error = end_of(process)
    assert code == 0, error
    assert sorted(record["job"] for record in records(desk)) == [1, 2, 3]
    assert [record["status"] for record in records(desk)] == ["made"] * 3
    assert outputs(desk) == expected
    assert temporaries(desk) == []


def test_a_process_that_is_killed_whenever_it_begins_fails_its_job(desk, machines):
    worker = machines.add_worker()
    machines.await_workers(1)
    put_jobs(desk, jobs(1, compression="9"))
    process = begun(desk, "--dask", machines.address)
    killed = set()
    while process.poll() is None:
        for number in processes_of(worker.pid):
            if is_making(desk):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(number, signal.SIGKILL)
                    killed.add(number)
    code, error = end_of(process)
    assert code == 1
    assert "out0.png): the process that made it was ended by SIGKILL" in error
    assert len(killed) == 1 + cluster.RETRIES
    assert outputs(desk) == {}
    assert temporaries(desk) == []


@pytest.mark.slow
def test_jobs_of_a_task_that_killed_its_worker_are_tried_one_by_one(desk, tmp_path):
    small_layers(desk)
    put_jobs(desk, jobs(400))
    found = Machines(tmp_path / "machines")
    with found.running(DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0"):
        first, _ = found.add_worker(), found.add_worker()
        found.await_workers(2)
        process = subprocess.Popen(
            command("batch", "jobs.json", "--dask", found.address, "--log", "log"),
            cwd=desk.folder, stderr=subprocess.PIPE,
        )  # fmt: skip
        until(lambda: len(outputs(desk)) > 60)  # they go together by now
        first.kill()
        code, error = end_of(process)
        assert code == 0, error
        assert sorted(record["job"] for record in records(desk)) == list(range(1, 401))
        assert len(outputs(desk)) == 400


# ---- as Dask wants it ----------------------------------------------------------------------------


@pytest.mark.parametrize("threads", [1, 2, 16])
@pytest.mark.parametrize("job_s", [0.001, 0.01, 0.07, 0.3, 5.0])
@pytest.mark.parametrize("jobs_left", [1, 2, 11, 400, 5000])
def test_tasks_shrink_to_the_end_and_none_has_hardly_anything(threads, job_s, jobs_left):
    crew = object.__new__(cluster.Cluster)
    crew._threads, crew._at_a_time, crew._job_s = threads, None, job_s
    sizes, left = [], jobs_left
    while left:
        sizes.append(min(left, crew._wanted_size(left)))
        left -= sizes[-1]
    per_task = max(job_s, cluster.TASK_S / cluster.JOBS_OF_A_TASK)
    assert min(sizes) * per_task >= min(cluster.SHORTEST_TASK_S, jobs_left * per_task) - 1e-9
    assert max(sizes) == 1 or max(sizes) * per_task <= cluster.TASK_S + cluster.SHORTEST_TASK_S
    if jobs_left == 5000 and job_s < cluster.SHORTEST_TASK_S:
        assert sizes[-2] < sizes[0]


def test_every_job_that_is_blamed_is_tried_once_more_alone():
    """Also one that had a task by itself: it may have waited where something else killed the worker."""
    crew = object.__new__(cluster.Cluster)
    crew._alone = set()
    reason = type("KilledWorker", (Exception,), {})()
    for numbers in ([7], [1, 2, 3]):
        again = list(crew._results(numbers, "error", (None, reason)))
        assert again == [(number, None) for number in reversed(numbers)]
    for number in (7, 1, 2, 3):
        ((told, result),) = crew._results([number], "error", (None, reason))
        assert told == number
        assert "every worker that was given it died" in result["error"]


def test_small_jobs_go_together_and_leave_nothing_on_the_scheduler(desk, machines):
    machines.add_worker()
    small_layers(desk)
    put_jobs(desk, jobs(300))
    for more in (0, 1):
        run = desk.run("batch", "jobs.json", "--dask", machines.address, "--log", "log")
        assert run.code == 0, run.stderr
        assert run.stderr.count("/300 out") == 300
        assert len(records(desk)) == 300
        tasks, prefixes = machines.seen()
        assert tasks == 0
        assert list(prefixes) == ["hpcomp-stack"]
        assert 12 < prefixes["hpcomp-stack"] < 60 * (1 + more)


def test_jobs_that_cannot_be_done_twice_are_tasks_of_their_own(desk, machines):
    machines.add_worker()
    small_layers(desk)
    tables = [*jobs(60, clobber=False), {"layers": ["l0.png", "l1.png"], "output": "l0.png"}]
    put_jobs(desk, tables)
    run = desk.run("batch", "jobs.json", "--dask", machines.address)
    assert run.code == 0, run.stderr
    assert machines.seen()[1] == {"hpcomp-stack": 61}


@pytest.mark.slow
def test_an_adaptive_cluster_grows(desk):
    put_jobs(desk, jobs(120, compression="9"))
    script = (
        "import distributed, sys\n"
        "if __name__ == '__main__':\n"
        "    cluster = distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None)\n"
        "    cluster.adapt(minimum=1, maximum=4)\n"
        "    print(cluster.scheduler_address, flush=True)\n"
        "    for _ in sys.stdin:\n"
        "        print(len(cluster.scheduler_info['workers']), flush=True)\n"
        "    cluster.close()\n"
    )
    there = subprocess.Popen(
        [sys.executable, "-Wignore", desk.put("adaptive.py", script.encode())], text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    process = begun(desk, "--dask", there.stdout.readline().strip())

    def count():
        there.stdin.write("\n")
        there.stdin.flush()
        return int(there.stdout.readline())

    until(lambda: process.poll() is not None or count() > 1)
    assert process.poll() is None
    code, error = end_of(process)
    assert code == 0, error
    assert len(outputs(desk)) == 120
    there.stdin.close()
    there.wait()
    there.stdout.close()


def test_fail_fast_begins_no_more(desk, machines):
    machines.add_worker()
    machines.await_workers(1)
    tables = jobs(40, compression="9")
    tables[0]["layers"] = ["gone.png"]
    put_jobs(desk, tables)
    run = desk.run("batch", "jobs.json", "--dask", machines.address, "--fail-fast", "--log", "log")
    assert run.code == 3
    told = [record["status"] for record in records(desk)]
    assert len(told) == 40
    assert told.count("failed") == 1
    assert told.count("made") == len(outputs(desk)) <= 4
    assert told.count("not run") >= 35


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openssl") is None, reason="makes certificates with openssl")
def test_tls_by_the_settings_of_dask(desk, tmp_path):
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=here",
         "-keyout", key, "-out", certificate],
        check=True, capture_output=True,
    )  # fmt: skip
    tls = ("--tls-ca-file", certificate, "--tls-cert", certificate, "--tls-key", key)
    settings = {
        "DASK_DISTRIBUTED__COMM__TLS__CA_FILE": str(certificate),
        "DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT": str(certificate),
        "DASK_DISTRIBUTED__COMM__TLS__CLIENT__KEY": str(key),
    }
    put_jobs(desk, jobs(2))
    found = Machines(tmp_path / "machines", (*tls, "--protocol", "tls"))
    with found.running():
        found.add_worker()
        assert found.address.startswith("tls://")
        refused = desk.run("batch", "jobs.json", "--dask", found.address)
        assert (refused.code, len(refused.lines)) == (3, 1)
        assert "no Dask scheduler answers there (TLS" in refused.stderr
        for where in (found.address, found.file):
            run = desk.run("batch", "jobs.json", "--dask", where, env=settings)
            assert run.code == 0, run.stderr
    assert len(outputs(desk)) == 2
    # A cluster within the process has nobody to hide anything from.
    everywhere = {"DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "true"}
    run = desk.run("batch", "jobs.json", "--dask", "local:1", env=everywhere)
    assert run.code == 0, run.stderr


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
    [("local:x", 2, "local:x"), ("local:0", 2, "local:0"),
     ("nowhere", 3, "no such file: nowhere: "), ("sched.json", 3, "no such file: sched.json: "),
     ("tcp://127.0.0.1:9", 3, "tcp://127.0.0.1:9: no Dask scheduler answers there ("),
     ("foo://127.0.0.1:9", 3, "(unknown address scheme 'foo'"), ("tls://127.0.0.1:9", 3, "(TLS "),
     ("jobs.json", 3, "jobs.json is no scheduler file"), ("l0.png", 3, "l0.png is no scheduler file")],
)  # fmt: skip
def test_what_is_no_cluster(desk, address, code, says):
    put_jobs(desk, jobs(1))
    run = desk.run("batch", "jobs.json", "--dask", address)
    assert run.code == code
    assert run.lines[-1].startswith("hpcomp: error: ")
    assert says in run.lines[-1]
    assert outputs(desk) == {}
    if "no Dask scheduler answers" in says:
        # On a machine that is very busy, Dask may have begun one more try when its time ends.
        assert any(f"({reason})" in run.stderr for reason in ("connection refused", "no answer in 10 s"))


@pytest.mark.parametrize("error", [TimeoutError(), asyncio.CancelledError()], ids=repr)
def test_a_try_that_was_given_up_is_told_in_words(error):
    outer = OSError("Timed out trying to connect")
    outer.__cause__ = error
    assert cluster._root(outer) == "no answer in 10 s"


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
            "maker": maker(), "elsewhere": True}  # fmt: skip
    return task | more


@pytest.mark.parametrize("name", ["hpcomp", "engine", "isal", "OpenImageIO", "zlib-ng"])
def test_a_worker_of_another_version_makes_nothing(desk, monkeypatch, name):
    """Of hpcomp, or of a library that packs pixels."""
    monkeypatch.chdir(desk.folder)
    result = doing.do_job(task_of(jobs(1)[0], maker={**maker(), name: "0.0.1"}))
    assert (result["status"], result["exit_code"]) == ("failed", 4)
    here = maker()[name]
    assert f"the worker has {name} {here} and the batch {name} 0.0.1, whose bytes" in result["error"]
    assert outputs(desk) == {}


def test_a_worker_without_the_directory_says_so(desk):
    (result,) = worker.do_there([task_of(jobs(1)[0])], "hpcomp.a.", str(desk / "none"), {})
    assert (result["status"], result["exit_code"]) == ("failed", 3)
    assert f"no directory {desk / 'none'}" in result["error"]


def test_a_process_that_has_waited_too_long_is_replaced(desk, monkeypatch):
    monkeypatch.setattr(worker, "IDLE_S", 2.0)
    there = ("hpcomp.b.", str(desk.folder), {})
    before = processes_of(os.getpid())
    for table in jobs(2):
        (result,) = worker.do_there([task_of(table)], *there)
        assert result["status"] == "made", result
        (process,) = set(processes_of(os.getpid())) - set(before)
        until(lambda number=process: is_over(number))
    worker.end_there("hpcomp.b.")
    assert processes_of(os.getpid()) == before
    assert len(outputs(desk)) == 2
