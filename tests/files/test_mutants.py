"""Files that went wrong in some way end every command in one line and the right exit code."""

import mutants
import pytest
from mutantruns import faults

#: Mutants in the plain run, and in all; the gate has those of the plain run and a block of more.
#: `sh tests/run.sh --all tests/files/test_mutants.py` runs all.
FEW, ALL, BLOCK = 96, 2000, 476
FIRST, *LATER = range(FEW, ALL, BLOCK)


def test_few_mutants(tmp_path):
    assert faults(range(FEW), tmp_path) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "first", [FIRST, *(pytest.param(first, marks=pytest.mark.exhaustive) for first in LATER)]
)
def test_all_mutants(tmp_path, first):
    """In each block there is every sound file, about equally often, and every way to damage it."""
    assert faults(range(first, first + BLOCK), tmp_path) == []


def test_a_block_of_mutants_has_all_kinds(tmp_path):
    sound = mutants.seeds(tmp_path)
    for first in (FIRST, *LATER):
        made = [mutants.mutant(sound, number).name for number in range(first, first + BLOCK)]
        assert {name.rpartition(", ")[2] for name in made} == {
            way.__name__ for way in (*mutants.ANY, *mutants.OF_PNG, *mutants.OF_EXR)
        }
        files = [name.partition(": ")[2].rpartition(", ")[0].partition("::")[0] for name in made]
        assert min(files.count(name) for name in sound) >= BLOCK // len(sound)


def test_mutants_differ_and_each_is_always_the_same(tmp_path):
    sound = mutants.seeds(tmp_path)
    made = [mutants.mutant(sound, number) for number in range(ALL)]
    assert [mutants.mutant(sound, number) for number in range(ALL)] == made
    assert len({one.content for one in made}) > 0.9 * ALL
    ways = {one.name.rpartition(", ")[2] for one in made}
    assert ways == {way.__name__ for way in (*mutants.ANY, *mutants.OF_PNG, *mutants.OF_EXR)}
    assert not {one.content for one in made} & set(sound.values())


BREAKING = """
import json, os, sys, time

def report(**what):
    os.write(int(sys.argv[1]), json.dumps(what).encode() + b"\\n")

for number in map(int, sys.argv[3:]):
    report(number=number, run=f"run {number}")
    if number == 2:
        os.abort()
    while number == 4:
        time.sleep(1)
    report(faults=[f"fault {number}"] if number == 5 else [])
report(run="done")
"""


def test_a_crash_and_a_hang_are_laid_to_their_mutant(tmp_path):
    program = tmp_path / "breaking.py"
    program.write_text(BREAKING)
    assert faults(range(1, 7), tmp_path, program=str(program), patience_s=3) == [
        "run 2: is not done, and its process ends with exit code -6",
        "run 4: is not done after 3 s",
        "fault 5",
    ]
