"""Compares two installations of hpcomp byte by byte: so that a change can be shown to change nothing.

    python same_bytes.py BEFORE AFTER                     paths of two `hpcomp` commands
    python same_bytes.py BEFORE AFTER --only random --random 1000 --seed 2
    python same_bytes.py BEFORE AFTER --without help schema
    python same_bytes.py BEFORE AFTER --only reports/003 --keep /tmp/differing

Each case is a script of a shell that runs with one command and then with the other, in a folder of
the same path and content. Its exit code, what it prints and all files that it leaves must be equal;
only seconds, peaks of memory and the times of files are not compared. The interpreter needs numpy,
OpenEXR and matplotlib, and need not have hpcomp. Exit code 1: something differs.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from casefiles import Case
from commandcases import command_cases
from randomcases import random_flats, random_stacks

#: What a run came to, in bytes: its exit code, stdout, stderr, and each file.
Outcome = dict[str, bytes]


@dataclass(frozen=True)
class Compared:
    """A case, its exit code before, and a line for each thing that differs."""

    case: Case
    code: str
    differences: list[str]


#: What no two runs have in common, and what stands for it.
MEASURED = (
    (rb"\b\d+(\.\d+)?(?= s\b)", b"#"),
    (rb'(?<="seconds": )[\d.e-]+', b"#"),
    (rb'(?<="peak_memory": )\d+', b"#"),
    (rb'(?<="stat": )\[[\d, ]+\]', b"#"),
    (rb'(?<="at": )\d+', b"#"),
    (rb'(?<="prefix": )"hpcomp\.\w+\."', b"#"),
)
#: Where such figures are: nowhere else are they looked for.
MEASURED_IN = re.compile(r"stdout|stderr|.*\.log|.*\.hpcomp-state")

PATIENCE_S = 600
AT_A_TIME = 2


# ---- running -------------------------------------------------------------------------------------


def stand_in(command: Path, folder: Path) -> Path:
    """A folder for PATH in which `hpcomp` is that command, whatever its name."""
    folder.mkdir()
    script = folder / "hpcomp"
    script.write_text(f"#!/bin/sh\nexec '{command}' \"$@\"\n")
    script.chmod(0o755)
    return folder


def outcome(case: Case, work: Path, commands: Path) -> Outcome:
    """Runs a case in `work`, with the commands of that folder."""
    env = {
        **os.environ,
        "PATH": f"{commands}{os.pathsep}{os.environ['PATH']}",
        "PYTHON": sys.executable,  # what make draws with
        "PYTHONDONTWRITEBYTECODE": "1",
        "COLUMNS": "100",
        "LC_ALL": "C.UTF-8",
    }
    for name in ("HPCOMP_ENGINE", "SOURCE_DATE_EPOCH", "MAKEFLAGS"):
        env.pop(name, None)
    try:
        done = subprocess.run(
            ["sh", "-c", case.script], cwd=work, env=env, stdin=subprocess.DEVNULL,
            capture_output=True, timeout=PATIENCE_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"exit code": b"none within %d s" % PATIENCE_S}
    out = {"exit code": b"%d" % done.returncode, "stdout": done.stdout, "stderr": done.stderr}
    for path in sorted(work.rglob("*")):
        if path.is_file():
            out[str(path.relative_to(work))] = path.read_bytes()
    return {
        name: without_measures(name, content) if MEASURED_IN.fullmatch(name) else content
        for name, content in out.items()
    }


def without_measures(name: str, content: bytes) -> bytes:
    for pattern, mark in MEASURED:
        content = re.sub(pattern, mark, content)
    if name.endswith("-state"):  # jobs are written down in the order in which they end
        content = b"".join(sorted(content.splitlines(keepends=True)))
    return content


def compared(folder: Path, sides: Sequence[Path], keep: Path | None, case: Case) -> Compared:
    """Runs it with one and then the other, because both must have the same working directory."""
    place = folder / case.name.replace("/", "-")
    inputs, work = place / "inputs", place / "work"
    inputs.mkdir(parents=True)
    case.put_inputs(inputs)
    found = []
    for side in sides:
        shutil.copytree(inputs, work)  # with their times, which make looks at
        found.append(outcome(case, work, side))
        work.rename(place / side.name)
    lines = differences(*found)
    if keep is not None and lines:
        shutil.copytree(place, keep / place.name, dirs_exist_ok=True)
    shutil.rmtree(place)
    return Compared(case, found[0]["exit code"].decode(), lines)


# ---- comparing -----------------------------------------------------------------------------------


def differences(before: Outcome, after: Outcome) -> list[str]:
    """A line for each thing that differs."""
    lines = []
    for name in sorted(before.keys() | after.keys()):
        if name not in after or name not in before:
            lines.append(f"{name}: only {'before' if name in before else 'after'}")
        elif name == "exit code" and before[name] != after[name]:
            lines.append(f"{name}: {before[name].decode()}, then {after[name].decode()}")
        elif before[name] != after[name]:
            lines.append(f"{name}: {first_difference(before[name], after[name])}")
    return lines


def first_difference(before: bytes, after: bytes) -> str:
    pairs = zip(before, after, strict=False)
    at = next((i for i, (a, b) in enumerate(pairs) if a != b), min(len(before), len(after)))
    around = slice(max(0, at - 20), at + 20)
    return (
        f"byte {at} of {len(before)} and {len(after)}: {before[around]!r}, then {after[around]!r}"
    )


def version(command: Path) -> str:
    done = subprocess.run([command, "--version"], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"same_bytes: {command} --version ends with {done.returncode}: {done.stderr}")
    return done.stdout.strip()


def is_meant(case: Case, names: Sequence[str]) -> bool:
    return case.group in names or case.name in names


def show(results: Sequence[Compared]) -> int:
    """A table of the groups; the number of cases that differ."""
    # A group of which all fails compares error lines alone: its exit codes tell.
    print(f"\n{'group':10}{'cases':>6}{'differ':>8}   exit codes before")
    for group in dict.fromkeys(result.case.group for result in results):
        of_it = [result for result in results if result.case.group == group]
        codes = Counter(result.code for result in of_it)
        told = ", ".join(f"{code}: {codes[code]}" for code in sorted(codes))
        differ = sum(bool(result.differences) for result in of_it)
        print(f"{group:10}{len(of_it):6}{differ:8}   {told}")
    differ = sum(bool(result.differences) for result in results)
    print(f"{differ} of {len(results)} cases differ")
    return differ


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("before", type=Path)
    add("after", type=Path)
    add("--random", type=int, default=200, help="random stacks; a quarter as many deep images")
    add("--seed", type=int, default=1)
    add("--only", nargs="+", metavar="NAME", help="a group, or a case such as reports/003")
    add("--without", nargs="+", metavar="NAME", default=[], help="leaves these out")
    add("--keep", type=Path, metavar="FOLDER", help="copies files of cases that differ to here")
    asked = parser.parse_args()
    commands = [Path(os.path.abspath(command)) for command in (asked.before, asked.after)]
    for side, command in zip(("before", "after"), commands, strict=True):
        print(f"{side:8}{command}: {version(command)}", flush=True)

    cases = [
        case
        for case in (
            *command_cases(),
            *random_stacks(asked.random, asked.seed),
            *random_flats(asked.random // 4, asked.seed),
        )
        if (not asked.only or is_meant(case, asked.only)) and not is_meant(case, asked.without)
    ]
    if not cases:
        parser.error("no case has such a name")
    results = []
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(AT_A_TIME) as pool:
        folder = Path(temporary)
        sides = [
            stand_in(command, folder / side)
            for side, command in zip(("before", "after"), commands, strict=True)
        ]
        doing = [pool.submit(compared, folder, sides, asked.keep, case) for case in cases]
        try:
            for future in as_completed(doing):
                result = future.result()
                results.append(result)
                for line in result.differences:
                    print(f"{result.case.name}: {line}", flush=True)
                if result.differences:
                    print(textwrap.indent(result.case.script, "    "), flush=True)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)  # Ctrl-C ends it, with the cases at hand
            raise
    return int(show(results) > 0)


if __name__ == "__main__":
    sys.exit(main())
