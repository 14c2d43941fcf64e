"""What a run warns of: inputs that cannot be honoured, pixels that were lost. Counts nothing."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Protocol

from ..blending.rules import StackRules
from ..color.quantization import LARGEST_HALF, Losses
from ..errors import HpcompWarning, InputError, InputWarning, MismatchError, one_line
from ..geometry import Placement, Window
from ..imagefile.reading import LayerReader
from .layerspec import LayerSpec

if TYPE_CHECKING:  # only `flatten` needs the one, and only `check` the other
    from ..imagefile.deepreading import DeepReader
    from ..measures.ramps import Ramp


class Notices:
    """Where warnings go: Python's `warnings`, or errors where the run is strict."""

    def __init__(self, strict: bool) -> None:
        self.strict = strict

    def warn(self, message: str, category: type[HpcompWarning] = HpcompWarning) -> None:
        """Warns, or raises the error that the warning's category stands for."""
        message = one_line(message)
        if self.strict:
            error = InputError if issubclass(category, InputWarning) else MismatchError
            raise error(f"{message} (an error with --strict)")
        warnings.warn(message, category, stacklevel=3)


def warn_of_layers(rules: StackRules, readers: Sequence[LayerReader], notices: Notices) -> None:
    for operator, reader in zip(rules.operators, readers, strict=True):
        warn_of_problems(reader, notices)
        if operator is not None and operator.needs_alpha and not reader.has_alpha:
            notices.warn(
                f"{reader.label} has no alpha, so '{operator.name}' does nothing useful with it: "
                "of a grey mask, tint=white makes one of its stored values, as other tools do; "
                "alpha=luminance makes one of its light"
            )
        if reader.part.pixel_aspect != readers[0].part.pixel_aspect:
            notices.warn(
                f"{reader.label} has pixels of aspect {reader.part.pixel_aspect:g}, the bottom "
                f"layer of {readers[0].part.pixel_aspect:g}: resample it first"
            )


class Placed(Protocol):
    """A layer, flat or deep, where it lies: `window` is that of its pixels on the canvas."""

    @property
    def reader(self) -> LayerReader | DeepReader: ...
    @property
    def window(self) -> Window: ...


def warn_of_outside(
    placements: Sequence[Placement | None],
    layers: Sequence[Placed],
    canvas: Window,
    made: Window,
    notices: Notices,
) -> None:
    """Of layers of which no pixel is in the picture.

    `placements`: where each was to go. `made`: what of the canvas is made; all, or a region. What
    lies outside a region where its own file puts it is no surprise: sequences and tiles are so.
    """
    for placement, layer in zip(placements, layers, strict=True):
        window, label = layer.window, layer.reader.label
        if window.intersection(made) is not None:
            continue
        if window.intersection(canvas) is None:
            where = f"outside the canvas {canvas}: {_inside(placement)}"
        elif placement is None:
            continue
        else:
            where = f"outside the region {made}: leave it out, or choose a region that it reaches"
        notices.warn(f"{label} has its pixels at {window}, {where}")


def _inside(placement: Placement | None) -> str:
    """How to get a layer there that was to go there."""
    if placement is None or placement.gravity is None:
        return "place it with at=+X+Y, which counts from the origin of the canvas"
    turned = placement.turned_inwards()
    what = "offsets count to the right and downwards, whatever the gravity"
    return what if turned == placement else f"{what}: did you mean at={turned}?"


def warn_of_problems(reader: LayerReader | DeepReader, notices: Notices) -> None:
    for problem in reader.problems:
        notices.warn(f"{reader.label}: {problem}; read as {reader.decoding.encoding}", InputWarning)
    for omission in reader.omissions:
        notices.warn(f"{reader.label}: {omission}", InputWarning)


def warn_of_samples(readers: Sequence[LayerReader], notices: Notices) -> None:
    """Of what was not seen or not kept of the samples that were read."""
    for reader in readers:
        for words in reader.unseen.in_words():
            notices.warn(f"{reader.label}: {words}")
        if reader.zeroed_pixels:
            notices.warn(
                f"{reader.label}: {_count(reader.zeroed_pixels)} NaN or infinite "
                "and became transparent"
            )


def warn_of_ramps(
    ramps: Iterable[Ramp], specs: Sequence[LayerSpec], hue_tolerance: float, notices: Notices
) -> None:
    names = [*(spec.label(number) for number, spec in enumerate(specs)), "the background"]
    for ramp in ramps:
        notices.warn(
            f"hues of {names[ramp.lower]} or {names[ramp.upper]} run across a hue of the other: "
            f"where they are within {hue_tolerance:g}° the picture is vivid, and beside that grey. "
            "A stack with --hue-tolerance 30, or with --blending foremost or traditional, has no "
            "such ring"
        )


def warn_of_losses(label: str, losses: Losses, notices: Notices) -> None:
    for count, what in (
        (losses.out_of_gamut, "outside the gamut and lost saturation or brightness: "
                              "write EXR or wider --out-primaries to keep them, "
                              "or lower --exposure"),
        (losses.light_without_alpha, "light without alpha, which PNG cannot hold: "
                                     "put a --background under them, or write EXR"),
        (losses.not_a_number, "NaN and became transparent"),
        (losses.beyond_half, f"beyond {LARGEST_HALF:g}, the most that half-floats hold, "
                             "and became darker: write --depth float"),
    ):  # fmt: skip
        if count:
            notices.warn(f"{label}: {_count(count)} {what}")


def _count(pixels: int) -> str:
    return "1 pixel is" if pixels == 1 else f"{pixels} pixels are"
