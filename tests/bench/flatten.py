"""How long `hpcomp flatten` takes, and how much memory: 2 million pixels of 8 samples.

    python tests/bench/flatten.py [--width 1920] [--height 1080] [--samples 8] [OPTION...]

Makes deep files in a temporary folder, tidy ones, unsorted ones, and ones of overlapping volumes,
and flattens each in a process of its own; what else is given goes to `hpcomp flatten`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
import deepfile

COMMAND = Path(sys.executable).with_name("hpcomp")

# A process begins with the peak of the one that starts it: a small one.
MEASURE = (
    "import os, sys\n"
    "child = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ)\n"
    "_, status, usage = os.wait4(child, 0)\n"
    "print(usage.ru_maxrss, os.waitstatus_to_exitcode(status))"
)


def image(width: int, height: int, samples: int, kind: str, compression: str) -> deepfile.Deep:
    rng = np.random.default_rng(1)
    n = width * height * samples
    alpha = rng.random(n, np.float32) * np.float32(0.6)
    planes = {name: (rng.random(n, np.float32) * alpha).astype(np.float16) for name in "RGB"}
    planes["A"] = alpha.astype(np.float16)
    depth = np.tile(np.arange(1, samples + 1, dtype=np.float32), width * height)
    if kind != "tidy":
        depth += rng.random(n, np.float32) * np.float32(3)
    planes["Z"] = depth
    if kind == "volumes":
        planes["ZBack"] = depth + np.float32(1.5)
    counts = np.full((height, width), samples)
    return deepfile.Deep(counts, planes, compression)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--width", type=int, default=1920)
    parser.add_argument("--height", type=int, default=1080)
    parser.add_argument("--samples", type=int, default=8)
    parser.add_argument("--kinds", nargs="+", default=["tidy", "unsorted", "volumes"])
    parser.add_argument("--compressions", nargs="+", default=["zips"])
    known, options = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as folder:
        for kind in known.kinds:
            for compression in known.compressions:
                path = Path(folder) / f"{kind}.exr"
                deep = image(known.width, known.height, known.samples, kind, compression)
                deepfile.write(path, deep)
                del deep
                begin = time.perf_counter()
                done = subprocess.run(
                    [sys.executable, "-ISc", MEASURE, COMMAND, "flatten", path, "-o",
                     Path(folder) / "out.exr", *options],
                    stdout=subprocess.PIPE, text=True, check=True,
                )  # fmt: skip
                seconds = time.perf_counter() - begin
                peak, code = map(int, done.stdout.split())
                assert code == 0
                print(
                    f"{kind:9} {compression:5} {path.stat().st_size / 2**20:6.0f} MiB: "
                    f"{seconds:6.2f} s, {peak / 1024:5.0f} MiB at most"
                )
                path.unlink()


if __name__ == "__main__":
    main()
