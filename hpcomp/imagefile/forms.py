"""What may be asked of files in and out, as light tables of names. No codec, no pixels."""

from __future__ import annotations

#: What is done with NaN and Inf in a layer.
NONFINITE_POLICIES = ("error", "zero", "keep")

#: The sample types of each format that is written, its default first.
DEPTHS: dict[str, tuple[str, ...]] = {"png": ("8", "16"), "exr": ("half", "float")}

#: The formats that are written: the endings of their files, without the dot.
FORMATS = tuple(DEPTHS)

#: The compressions of EXR, the default first: how many rows each packs together.
EXR_COMPRESSIONS: dict[str, int] = {
    "zip": 16,
    "none": 1,
    "rle": 1,
    "zips": 1,
    "piz": 32,
    "pxr24": 16,
    "b44": 32,
    "b44a": 32,
    "dwaa": 32,
    "dwab": 256,
    "htj2k256": 256,
    "htj2k32": 32,
}

#: Those of PNG: a level of zlib, the smaller of the best levels, or what is fast for the picture.
PNG_COMPRESSIONS = ("fast", "small", *map(str, range(10)))

#: The compressions of each format, its default first.
COMPRESSIONS: dict[str, tuple[str, ...]] = {
    "png": PNG_COMPRESSIONS,
    "exr": tuple(EXR_COMPRESSIONS),
}
