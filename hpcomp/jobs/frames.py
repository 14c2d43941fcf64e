"""Numbered files: frame ranges, names with a pattern, and the jobs of a sequence. Reads no file."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ..errors import SettingError
from ..layers.layerspec import LayerSpec
from ..layers.placing import Layer, layer_specs
from .schema import Job, job_of_stack

_RANGE = re.compile(r"(-?\d{1,9})(?:-(-?\d{1,9})(?:x(\d{1,9}))?)?", re.ASCII)
#: `%d`, `%04d`, or as many # as there are digits.
_PATTERN = re.compile(r"%(?P<width>0?\d{0,2})[di]|(?P<hashes>##+)", re.ASCII)
#: A # alone, in a name that has no other pattern and no folder behind it.
_LONE = re.compile(r"(?P<hashes>#)(?=[^/]*\Z)")
#: More frames than any sequence has.
MOST_FRAMES = 10**6


def parse_frames(text: str) -> list[int]:
    """Frame numbers from `1-240x2`: first, last, and a step; ranges and numbers between commas.

    Errors: `SettingError`.
    """
    frames: list[int] = []
    for part in text.split(","):
        match = _RANGE.fullmatch(part.strip())
        if not match:
            raise SettingError(f"'{part}' is no range of frames: write 7, 1-240, or 1-240x2")
        first, last, step = int(match[1]), int(match[2] or match[1]), int(match[3] or 1)
        if last < first or step == 0:
            raise SettingError(f"frames {part} are none: write first-last, and a step from 1")
        if len(frames) + (last - first) // step >= MOST_FRAMES:
            raise SettingError(f"frames {text} are more than {MOST_FRAMES}: make them in parts")
        frames += range(first, last + 1, step)
    if len(set(frames)) < len(frames):
        raise SettingError(f"frames {text} name one frame twice")
    return frames


def has_pattern(path: str) -> bool:
    """Whether the path is that of many frames: it has %04d or ####, and no such file exists."""
    return is_numbered(path) and not os.path.lexists(path)


def is_numbered(path: str) -> bool:
    """Whether the path has a place for the number of a frame."""
    return bool(_pattern_of(path).search(path))


def _pattern_of(path: str) -> re.Pattern[str]:
    """What stands for the number in this path."""
    return _PATTERN if _PATTERN.search(path) else _LONE


def numbered(path: str, frame: int) -> str:
    """The path of one frame: its number in the place of each pattern."""

    def number(match: re.Match[str]) -> str:
        if match["hashes"]:
            return f"{frame:0{len(match['hashes'])}d}"
        return f"%{match['width']}d" % frame

    return _pattern_of(path).sub(number, path)


def frame_jobs(
    layers: Sequence[Layer],
    output: str | os.PathLike[str],
    frames: str | Sequence[int],
    **options: Any,
) -> list[Job]:
    """The jobs of a sequence, one for each frame, for `batch`.

    `layers`, `output`, `options`: as in `stack`, with %04d or #### for the number of the frame in
    paths; a layer without it is the same in every frame. `frames`: `1-240x2`, or numbers.
    Errors: `SettingError`, also where no layer has a pattern, or several frames one output.
    """
    numbers = parse_frames(frames) if isinstance(frames, str) else list(frames)
    specs = layer_specs(layers)
    output = os.fspath(output)
    if not any(has_pattern(spec.path) for spec in specs):
        raise SettingError(
            "no layer has a pattern of frames, such as base.%04d.exr or base.####.exr"
        )
    if len(numbers) > 1 and not is_numbered(output):
        raise SettingError(
            f"{len(numbers)} frames cannot all be written to {output}: put %04d or #### into it"
        )
    return [_frame(specs, output, options, frame) for frame in numbers]


def _frame(specs: Sequence[LayerSpec], output: str, options: Mapping[str, Any], frame: int) -> Job:
    written = {
        name: _numbered_output(options[name], frame)
        for name in ("report", "provenance", "depfile", "depfile_target")
        if options.get(name)
    }
    job = job_of_stack(
        [
            replace(spec, path=numbered(spec.path, frame)) if has_pattern(spec.path) else spec
            for spec in specs
        ],
        _numbered_output(output, frame),
        {**options, **written},
    )
    return replace(job, where=f"frame {frame}")


def _numbered_output(paths: Any, frame: int) -> Any:
    """An output's path, or each of several."""
    if isinstance(paths, (list, tuple)):
        return [_numbered_output(path, frame) for path in paths]
    return numbered(os.fspath(paths), frame)


def check_no_frames(layers: Sequence[Layer]) -> None:
    """`SettingError` where a layer is a pattern of frames, and frames were not asked for."""
    for spec in layer_specs(layers):
        # One # may well be a part of a name.
        if has_pattern(spec.path) and _PATTERN.search(spec.path):
            raise SettingError(f"{spec.path} is a pattern of frames: say which with --frames")
