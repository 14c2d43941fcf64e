"""The options of `hpcomp.options` as type checkers want them: what calls may pass by keyword.

Nothing here runs. A test holds it against the table.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TypedDict

from .geometry import Window


class PictureKeywords(TypedDict, total=False):
    """What every command that makes one picture takes."""

    preset: str | None
    blending: str
    space: str
    primaries: str
    hue_tolerance: float
    gray_bias: float
    strength: str
    weave: str
    weave_size: int
    exposure: float
    background: str | Sequence[float] | None
    nonfinite: str
    strict: bool
    canvas: str | Window
    region: str | Window | None
    overscan: bool
    format: str | None
    depth: str | int | None
    compression: str | int | None
    out_primaries: str | None
    clobber: bool
    depfile: str | os.PathLike[str] | None
    depfile_target: str | Sequence[str]
    write_if_changed: bool
    threads: int | None
    max_memory: str | int
    max_pixels: str | int


class FlattenKeywords(PictureKeywords, total=False):
    """What `flatten` takes: samples have no numbers, and so no permutation."""

    order: str


class StackKeywords(PictureKeywords, total=False):
    """What `stack` takes, and all that ask about a stack."""

    op: str
    order: str | Sequence[int]
    report: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
    provenance: str | os.PathLike[str] | None
    foreign_tolerance: float | None
    achromatic: float | None
    bins: int | None
    energy_weights: str | Sequence[float] | None
