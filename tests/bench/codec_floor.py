"""The codec floor: OpenImageIO decodes the layers and encodes the result, and nothing between.

python codec_floor.py samples RESULT RAW               RESULT's samples as stored, as .npy
python codec_floor.py run THREADS RAW OUTPUT LAYER...  prints the seconds of the codecs alone
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import OpenImageIO as oiio

STRIP_ROWS = 64


def checked(result: Any, source: Any) -> Any:
    if result is None or result is False:
        raise SystemExit(f"codec floor: {source.geterror()}")
    return result


def strips(path: str) -> Iterator[Any]:
    """The samples of a file as stored, strip by strip."""
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)  # no arithmetic on PNG
    reader = checked(oiio.ImageInput.open(path, config), oiio)
    spec = reader.spec()
    for begin in range(spec.y, spec.y + spec.height, STRIP_ROWS):
        end = min(begin + STRIP_ROWS, spec.y + spec.height)
        rows = reader.read_scanlines(0, 0, begin, end, 0, 0, spec.nchannels, spec.format)
        yield checked(rows, reader)
    reader.close()


def decode(path: str) -> None:
    for _ in strips(path):
        pass


def encode(samples: Any, path: str) -> None:
    height, width, channels = samples.shape
    kind = {"uint8": "uint8", "float16": "half"}[samples.dtype.name]
    spec = oiio.ImageSpec(width, height, channels, oiio.TypeDesc(kind))
    spec.attribute("oiio:UnassociatedAlpha", 1)
    if kind == "half":
        spec.attribute("compression", "zip")
    writer = checked(oiio.ImageOutput.create(path), oiio)
    checked(writer.open(path, spec), writer)
    for begin in range(0, height, STRIP_ROWS):
        rows = samples[begin : begin + STRIP_ROWS]
        checked(writer.write_scanlines(begin, begin + len(rows), 0, rows), writer)
    checked(writer.close(), writer)


def run(threads: int, raw: str, output: str, layers: list[str]) -> None:
    oiio.attribute("threads", 1)
    oiio.attribute("exr_threads", threads)
    samples = np.load(raw, mmap_mode="r")
    begin = time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(decode, layers))
    encode(samples, output)
    print(time.perf_counter() - begin)


def main() -> None:
    task, *arguments = sys.argv[1:]
    if task == "samples":
        np.save(arguments[1], np.concatenate(list(strips(arguments[0]))))
    else:
        run(int(arguments[0]), arguments[1], arguments[2], arguments[3:])


if __name__ == "__main__":
    main()
