"""Mutants through the command, many in one process; a crash or a hang is laid to the run that it ended.

    python mutantruns.py REPORTS FOLDER NUMBER...   is such a process

On the descriptor REPORTS it says which run it begins, and behind it what was wrong with it. If it dies or
is silent for too long, that run did it, and another process takes the mutants behind.
"""

from __future__ import annotations

import json
import os
import re
import selectors
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from mutants import Mutant, mutant, seeds

#: Far longer than any run takes.
PATIENCE_S = 120

#: What every mutant goes through, and the output that it makes.
COMMANDS = {"info": None, "stack": "out.png", "flatten": "out.exr", "hues": None}
ENGINES = ("kernel", "reference")
#: The exit codes to which a file can lead: done, it cannot be read, it does not fit.
CODES = (0, 3, 4)


def faults(
    numbers: Sequence[int], folder: Path, *, program: str = __file__, patience_s: float = PATIENCE_S
) -> list[str]:
    """What was wrong with the runs of these mutants, a line each; `program` makes them."""
    found: list[str] = []
    left = list(numbers)
    while left:
        reports, theirs = os.pipe()
        process = subprocess.Popen(
            [sys.executable, "-Walways", program, str(theirs), str(folder), *map(str, left)],
            stdin=subprocess.DEVNULL, pass_fds=[theirs],
        )  # fmt: skip
        os.close(theirs)
        at, run = left[0], None
        ending = "is not done, and its process ends with exit code {}"
        try:
            for report in _reports(reports, patience_s):
                at, run = report.get("number", at), report.get("run", run)
                found += report.get("faults", [])
        except TimeoutError:
            ending = f"is not done after {patience_s} s"
        finally:
            os.close(reports)
            process.kill()
            code = process.wait()
        assert run is not None, f"no run began, and the process ended with exit code {code}"
        if run == DONE:
            return found
        found.append(f"{run}: {ending.format(code)}")
        left = left[left.index(at) + 1 :]
    return found


#: The last report of a process.
DONE = "done"


def _reports(descriptor: int, patience_s: float) -> Iterator[dict]:
    """What a process says until it ends; TimeoutError if it says nothing for so long."""
    said = b""
    with selectors.DefaultSelector() as waiting:
        waiting.register(descriptor, selectors.EVENT_READ)
        while waiting.select(patience_s):
            data = os.read(descriptor, 1 << 16)
            if not data:
                return
            *lines, said = (said + data).split(b"\n")
            yield from map(json.loads, lines)
    raise TimeoutError


# ---- in the process -------------------------------------------------------------------------


def main(descriptor: int, folder: Path, numbers: Sequence[int]) -> None:
    def report(**what: object) -> None:
        os.write(descriptor, json.dumps(what).encode() + b"\n")

    sound = seeds(folder / "seeds")
    descriptors = None
    for number in numbers:
        one = mutant(sound, number)
        for command, output in COMMANDS.items():
            ends = []
            for by in ENGINES:
                run = f"{one.name}: {command}, {by}"
                report(number=number, run=run)
                end, wrong = _run(one, command, output, by, folder / "desk")
                report(faults=[f"{run}: {fault}" for fault in wrong])
                ends.append(end)
            if ends[0] != ends[1]:
                report(faults=[f"{one.name}: {command}: engines differ: {ends}"])
        opened = len(os.listdir("/dev/fd"))
        if descriptors not in (None, opened):
            report(faults=[f"{one.name}: {opened} open files instead of {descriptors}"])
        descriptors = opened
    report(run=DONE)


def _run(
    one: Mutant, command: str, output: str | None, by: str, desk: Path
) -> tuple[tuple[int, str], list[str]]:
    """How a run ended, but for numbers that rounding may change, and what was wrong with it."""
    from inprocess import invoke  # here, so that the test's process is not what loads hpcomp

    shutil.rmtree(desk, ignore_errors=True)
    (desk / "temporary").mkdir(parents=True)
    (desk / one.file).write_bytes(one.content)
    arguments = [command, *(["-o", output] if output else []), one.layer]
    env = {"HPCOMP_ENGINE": by, "TMPDIR": str(desk / "temporary")}
    code, stdout, stderr = invoke(arguments, cwd=desk, env=env)
    text = stderr.decode(errors="backslashreplace")
    lines = text.splitlines()
    errors = [line for line in lines if line.startswith("hpcomp: error: ")]
    warnings = [line for line in lines if line.startswith("hpcomp: warning: ")]
    expected = {one.file, "temporary"} | ({output} if output and not code else set())
    left = {str(path.relative_to(desk)) for path in desk.rglob("*")}
    checks = {
        f"exit code {code}": code in CODES,
        f"stderr {text!r}": len(errors) + len(warnings) == len(lines),
        f"exit code {code}, and errors {errors}": len(errors) == (code != 0),
        f"stderr that controls a terminal: {text!r}": all(line.isprintable() for line in lines),
        f"exit code {code}, and stdout {stdout[:200]!r}": bool(stdout) == (code == 0 and not output),
        f"files {sorted(left)}": left == expected,
        "the file itself has changed": (desk / one.file).read_bytes() == one.content,
    }
    return (code, re.sub(r"\d+", "#", text)), [what for what, right in checks.items() if not right]


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]), [int(number) for number in sys.argv[3:]])
