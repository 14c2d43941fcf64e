"""Random stacks and deep images for same_bytes.py: the same for the same seed."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from casefiles import (
    COMPRESSIONS,
    PNG_KINDS,
    PNG_LIGHT,
    PRIMARIES,
    Case,
    Planes,
    Rng,
    deep_planes,
    exr_part,
    planes,
    straight,
    write_exr,
    write_png,
)

#: Writes a file to a path.
Write = Callable[[Path], None]

OPERATORS = ("clear", "src", "dst", "over", "dst-over", "in", "dst-in", "out", "dst-out", "atop", "dst-atop", "xor", "plus")  # fmt: skip
PLACES = ("+0+0", "+3+2", "-4-1", "center", "north-west", "south+0-2", "east-3+1")
ALPHAS = ("straight", "premultiplied", "premultiplied-encoded", "luminance")
ORDERS = ("bottom-up", "top-down", "balanced", "simultaneous")
#: Of one stack's pictures most have this size, and so fit.
SIZES = ((37, 29), (64, 48), (5, 70), (150, 90))
REPORTS = ("txt", "json", "csv", "html")
#: How often a stack has an option, and what it may be.
RULES = {
    "blending": (0.3, ("traditional", "foremost", "hue-preserving")),
    "space": (0.5, ("linear-rgb", "xyz", "hsl", "oklab", "cielab")),
    "primaries": (0.3, ("rec709", "display-p3", "rec2020", "acescg", "bottom")),
    "hue-tolerance": (0.3, ("0", "0.5", "10", "45")),
    "gray-bias": (0.3, ("0.3", "1")),
    "exposure": (0.2, ("-1.5", "0.25", "2")),
    "background": (0.3, ("#ffffff", "#203040", "#f80")),
    "region": (0.15, ("20x10+3+4", "5x5+0+0", "4x20+1+1")),
    "nonfinite": (0.3, ("error", "zero", "keep")),
    "threads": (0.5, ("1", "2", "3")),
    "max-memory": (0.2, ("64M", "32M", "8M")),
}
PNG_RULES = {
    "depth": (0.4, ("8", "16")),
    "compression": (0.3, ("fast", "small", "0", "1", "6", "9")),
    "out-primaries": (0.2, ("rec709", "display-p3", "rec2020")),
}
EXR_RULES = {
    "depth": (0.4, ("half", "float")),
    "compression": (
        0.5,
        ("none", "rle", "zips", "zip", "piz", "pxr24", "b44a", "dwaa", "htj2k256"),
    ),
}
#: A canvas that any layers fit, and one that needs them to have one size.
CANVASES = ("union", "intersection", "50x40+0+0", "30x70-5-3", "bottom")


def chosen(rng: Rng, rules: dict[str, tuple[float, Sequence[str]]]) -> list[str]:
    return [
        f"--{name}={rng.choice(values)}"
        for name, (chance, values) in rules.items()
        if rng.random() < chance
    ]


def in_both_engines(command: str) -> str:
    """A script that runs it with either engine, for which $E stands; the code is the kernel's."""
    return (
        f"mkdir kernel reference\n"
        f"E=kernel HPCOMP_ENGINE=kernel; export HPCOMP_ENGINE; hpcomp {command}; code=$?\n"
        f"E=reference HPCOMP_ENGINE=reference; hpcomp {command}; echo $?\n"
        "exit $code"
    )


def random_layer(rng: Rng, size: tuple[int, int]) -> tuple[str, bool, Write]:
    """A file's ending, whether it can be a mask, and what writes it to a path."""
    pixels = straight(rng, *size)
    kind = str(rng.choice(list(PNG_KINDS), p=[0.2, 0.2, 0.1, 0.5]))
    if rng.random() < 0.5:
        light = str(rng.choice(list(PNG_LIGHT)))
        bits = int(rng.choice([8, 16]))
        write = partial(write_png, pixels=pixels, kind=kind, bits=bits, light=light)
        return "png", kind.startswith("grey"), write
    channels = planes(pixels, dtype=rng.choice([np.float16, np.float32]))
    kept = {"rgb": "RGB", "rgba": "RGBA"}.get(kind)
    if kept is None:
        channels["Y"], kept = channels["R"], "YA" if kind == "grey-alpha" else "Y"
    channels = {name: channels[name].copy() for name in kept}
    if rng.random() < 0.05:
        channels[kept[0]][0, -1] = rng.choice([np.nan, np.inf])
    options: dict[str, Any] = {"compression": str(rng.choice(list(COMPRESSIONS)))}
    if rng.random() < 0.4:  # the data lie beside, within or around what is shown
        options |= {"origin": tuple(map(int, rng.integers(-8, 9, 2))), "display": (0, 0, *size)}
    if rng.random() < 0.2:
        options["tile"] = int(rng.choice([16, 64]))
    if rng.random() < 0.3:
        options["chromaticities"] = PRIMARIES[str(rng.choice(list(PRIMARIES)))]
    return "exr", False, lambda path: write_exr(path, exr_part(channels, **options))


def keys(rng: Rng, number: int, is_mask: bool) -> str:
    """The keys of a layer, or nothing."""
    found = []
    if number and rng.random() < 0.4:
        found.append(f"op={rng.choice(OPERATORS)}")
    if rng.random() < 0.5:
        found.append(f"opacity={rng.choice(['0', '0.25', '0.6', '1'])}")
    if number and rng.random() < 0.3:
        found.append(f"at={rng.choice(PLACES)}")
    if is_mask and rng.random() < 0.6:
        found.append(f"tint=#{rng.integers(0, 1 << 24):06x}")
    elif rng.random() < 0.15:
        found.append(f"alpha={rng.choice(ALPHAS)}")
    elif rng.random() < 0.1:
        found.append(f"colorspace={rng.choice(['srgb', 'linear', 'acescg'])}")
    return "::" + ",".join(found) if found else ""


def put_deep(samples: Planes, options: dict[str, Any], path: Path) -> None:
    write_exr(path, exr_part(samples, deep=True, **options))


def put_files(files: Mapping[str, Write], folder: Path) -> None:
    for name, write in files.items():
        write(folder / name)


def random_stacks(count: int, seed: int) -> Iterator[Case]:
    """Stacks of 1 to 6 layers, of which some are refused."""
    for number in range(count):
        rng = np.random.default_rng([seed, 0, number])
        size = SIZES[rng.integers(len(SIZES))]
        same_size = rng.random() < 0.7
        files: dict[str, Write] = {}
        layers, reports = [], []
        for n in range(int(rng.integers(1, 7))):
            width, height = size if same_size else map(int, rng.integers(1, 60, 2))
            ending, is_mask, write = random_layer(rng, (width, height))
            files[f"layer{n}.{ending}"] = write
            layers.append(f"layer{n}.{ending}{keys(rng, n, is_mask)}")
        output = str(rng.choice(["out.png", "out.exr"]))
        options = chosen(rng, RULES | (PNG_RULES if output.endswith("png") else EXR_RULES))
        canvases = CANVASES if same_size else CANVASES[:4]
        if not same_size or rng.random() < 0.4:
            options.append(f"--canvas={rng.choice(canvases)}")
        if rng.random() < 0.3:
            options.append(f"--op={rng.choice(OPERATORS)}")
        order = ",".join(map(str, rng.permutation(len(layers))))
        if rng.random() < 0.6:
            options.append(f"--order={rng.choice([*ORDERS, order])}")
        if output.endswith("exr") and rng.random() < 0.3:
            options.append("--overscan")
        if rng.random() < 0.05:
            options.append("--strict")
        if rng.random() < 0.2:
            reports.append(f"--report=$E/report.{rng.choice(REPORTS)}")
        if rng.random() < 0.2:
            reports.append("--provenance=$E/origin.exr")
        command = " ".join([shlex.join(["stack", *layers, *options]), f"-o $E/{output}", *reports])
        yield Case("random", number, in_both_engines(command), partial(put_files, files))


def random_flats(count: int, seed: int) -> Iterator[Case]:
    """Deep images, one or two, of points or volumes, flattened."""
    for number in range(count):
        rng = np.random.default_rng([seed, 1, number])
        files: dict[str, Write] = {}
        images = []
        for n in range(int(rng.integers(1, 3))):
            width, height = map(int, rng.integers(1, 24, 2))
            samples = deep_planes(rng, width, height, int(rng.integers(1, 9)), rng.random() < 0.5)
            origin = tuple(map(int, rng.integers(-4, 5, 2)))
            compression = str(rng.choice(["none", "rle", "zips"]))
            options = {"origin": origin, "display": (0, 0, 20, 20), "compression": compression}
            files[f"deep{n}.exr"] = partial(put_deep, samples, options)
            images.append(f"deep{n}.exr" + ("::at=+2+1" if n and rng.random() < 0.2 else ""))
        output = str(rng.choice(["out.png", "out.exr"]))
        words = chosen(rng, RULES | (PNG_RULES if output.endswith("png") else EXR_RULES))
        if rng.random() < 0.6:
            words.append(f"--order={rng.choice(ORDERS)}")
        if rng.random() < 0.3:
            words.append(f"--canvas={rng.choice(CANVASES)}")
        command = f"{shlex.join(['flatten', *images, *words])} -o $E/{output}"
        yield Case("deep", number, in_both_engines(command), partial(put_files, files))
