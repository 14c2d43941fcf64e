"""What is left beside an output when its run is killed, and who removes it."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import signal
import subprocess
import zlib

import numpy as np
import pytest
from batches import is_over, processes_of, temporaries, until
from command import PATIENCE_S, Desk, command

import hpcomp
from hpcomp.system.outputs import whole_output

#: Takes seconds to write, where pixels are tossed coins.
SLOW = ["--compression", "9"]


@pytest.fixture
def desk(tmp_path):
    """a.exr and two frames that take long to pack, and a job file for two pictures of them."""
    desk = Desk.made(tmp_path)
    pixels = np.random.default_rng(1).integers(0, 2, (1200, 1200, 4)).astype(np.float32)
    pixels[..., 3] = 1
    hpcomp.write_image(desk / "a.exr", pixels, compression="none")
    for number in (1, 2):
        os.link(desk / "a.exr", desk / f"f.{number}.exr")
    jobs = [{"layers": ["a.exr"], "output": f"o.{n}.png", "compression": 9} for n in (1, 2)]
    desk.put("jobs.json", json.dumps(jobs).encode())
    return desk


def killed(desk, arguments, stdin=b"", at_least=1):
    """A run that is killed, with all processes that it has started, while it writes."""
    before = set(temporaries(desk))
    process = subprocess.Popen(
        command(*arguments), cwd=desk.folder, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    process.stdin.write(stdin)
    process.stdin.close()
    until(lambda: len(set(temporaries(desk)) - before) >= at_least)
    pids = [process.pid, *processes_of(process.pid)]
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)  # none tidies up after another
    for pid in pids:
        os.kill(pid, signal.SIGKILL)
    process.wait()
    until(lambda: all(is_over(pid) for pid in pids))
    assert temporaries(desk), "it was killed too late, and the test shows nothing"


RUNS = {
    "stack": (["stack", "a.exr", "-o", "o.1.png", *SLOW], b""),
    "frames": (["stack", "f.%d.exr", "-o", "o.%d.png", "--frames", "1-2", *SLOW], b""),
    "job file": (["batch", "jobs.json"], b""),
    "stdin": (["batch", "-", "--format", "json"], None),
}


@pytest.mark.slow
@pytest.mark.parametrize("run", RUNS)
def test_the_same_run_removes_what_a_killed_one_left(desk, run):
    arguments, stdin = RUNS[run]
    stdin = (desk / "jobs.json").read_bytes() if stdin is None else stdin
    killed(desk, arguments, stdin)
    fast = [a if a != "9" else "fast" for a in arguments]
    ended = desk.run(*fast, stdin=stdin.replace(b": 9", b': "fast"'))
    assert ended.code == 0
    assert temporaries(desk) == []


@pytest.mark.slow
def test_a_batch_without_its_state_removes_it_too(desk):
    """And one of another job file that makes the same pictures, and each picture by itself."""
    killed(desk, ["batch", "jobs.json"], at_least=2)
    for name in os.listdir(desk.folder):
        if "hpcomp-state" in name:
            os.remove(desk / name)
    left = temporaries(desk)
    assert desk.run("stack", "a.exr", "-o", "o.1.png").code == 0
    assert len(temporaries(desk)) == len(left) - 1
    assert desk.run("stack", "a.exr", "-o", "other.png").code == 0
    assert len(temporaries(desk)) == len(left) - 1
    desk.put("two.jsonl", b'{"layers": ["a.exr"], "output": "o.2.png"}')
    assert desk.run("batch", "two.jsonl").code == 0
    assert temporaries(desk) == []


@pytest.mark.slow
def test_what_a_living_run_writes_is_left_alone(desk):
    process = subprocess.Popen(command("stack", "a.exr", "-o", "o.1.png", *SLOW), cwd=desk.folder)
    try:
        until(lambda: temporaries(desk))
        process.send_signal(signal.SIGSTOP)
        (theirs,) = temporaries(desk)
        desk.put("one.jsonl", b'{"layers": ["a.exr"], "output": "o.1.png"}')
        for arguments in (["stack", "a.exr", "-o", "o.1.png"], ["batch", "one.jsonl"]):
            assert desk.run(*arguments).code == 0
            assert temporaries(desk) == [theirs]
        process.send_signal(signal.SIGCONT)
        assert process.wait(PATIENCE_S) == 0
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait()
    assert temporaries(desk) == []


def tag(name, machine=None):
    return f"{zlib.crc32(f'{machine or os.uname().nodename}/{name}'.encode()):08x}"


def test_only_its_own_are_removed(desk):
    """No file of the user's, of another output, of another machine, nor what is no plain file."""
    desk.put(f".hpcomp.{tag('o.png')}.0123456789abcdef", b"abandoned")
    desk.put(f".hpcomp.a1b2c3d4e5f6.a1b2c3d4.{tag('o.png')}.0123456789abcdef", b"of a job")
    keep = [
        ".hpcomp.notes", ".hpcomp", ".hpcomp.", f"hpcomp.{tag('o.png')}.0123456789abcdef",
        f".hpcomp.{tag('p.png')}.0123456789abcdef", f".hpcomp.{tag('o.png', 'elsewhere')}.0123456789abcdef",
        f".hpcomp.{tag('o.png')}", ".hpcomp.0123456789abcdef",
    ]  # fmt: skip
    for name in keep:
        desk.put(name, b"kept")
    keep.append(f".hpcomp.{tag('o.png')}.link")
    (desk / keep[-1]).symlink_to("a.exr")
    keep.append(f".hpcomp.{tag('o.png')}.folder")
    (desk / keep[-1]).mkdir()
    keep.append(f".hpcomp.{tag('o.png')}.pipe")
    os.mkfifo(desk / keep[-1])
    before = set(os.listdir(desk.folder))
    assert desk.run("stack", "a.exr", "-o", "o.png").code == 0
    gone = before - set(os.listdir(desk.folder))
    assert len(gone) == 2
    assert not gone & set(keep)


def test_a_file_that_is_taken_for_abandoned_before_it_is_locked(desk, monkeypatch):
    """Whoever made it makes another one: as often as that happens, and whichever way."""
    real, taken = fcntl.flock, []

    def flock(file, how):
        path = os.readlink(f"/proc/self/fd/{file}")
        if len(taken) < 4 and path not in taken and "/.hpcomp." in path:
            taken.append(path)
            other = os.open(path, os.O_RDONLY)
            real(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if len(taken) % 2:
                with pytest.raises(BlockingIOError):
                    real(file, how)
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(path)
                os.close(other)
                raise BlockingIOError
            os.unlink(path)
            os.close(other)
        real(file, how)

    monkeypatch.setattr(fcntl, "flock", flock)
    with whole_output(str(desk / "o.bin")) as place:
        with open(place, "wb") as file:
            file.write(b"whole")
        assert place not in taken
    assert len(taken) == 4
    assert (desk / "o.bin").read_bytes() == b"whole"
    assert temporaries(desk) == []


def test_a_file_system_without_locks(desk, monkeypatch):
    """Outputs are written as ever, and nothing is removed."""

    def flock(file, how):
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    left = desk.put(f".hpcomp.{tag('o.bin')}.0123456789abcdef", b"abandoned")
    with whole_output(str(desk / "o.bin")) as place, open(place, "wb") as file:
        file.write(b"whole")
    assert (desk / "o.bin").read_bytes() == b"whole"
    assert temporaries(desk) == [left.name]
