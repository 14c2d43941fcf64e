"""A layer as a LAYER names it, from its settings to a reader. Places nothing, warns of nothing."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING

from ..errors import InputError
from ..imagefile.description import describe
from ..imagefile.interpretation import Interpretation
from ..imagefile.parts import Part, choose
from ..imagefile.reading import LayerReader
from ..imagefile.seekable import seekable
from ..system.memory import parse_pixels
from .layerspec import LAYER_KEYS, LayerSpec

if TYPE_CHECKING:
    from ..imagefile.deepreading import DeepReader


def _interpretation(
    spec: LayerSpec, nonfinite: str, answered: Iterable[str] = ()
) -> Interpretation:
    """`answered`: settings whose question does not arise."""
    given = {key for key in LAYER_KEYS if getattr(spec, key) != getattr(LayerSpec, key)}
    return Interpretation(
        spec.alpha, spec.colorspace, spec.tint, nonfinite, frozenset(given.union(answered))
    )


def _check_size(part: Part, max_pixels: str | int, label: str) -> None:
    """`InputError` where it claims more pixels, before memory is taken for any of them."""
    excess = part.excess(parse_pixels(max_pixels))
    if excess:
        raise InputError(f"{label}: {excess}")


@contextlib.contextmanager
def opened_layer(
    spec: LayerSpec,
    label: str,
    nonfinite: str,
    max_pixels: str | int,
    *,
    placed: bool = True,
) -> Iterator[LayerReader]:
    """A reader of the layer's pixels, closed at the end of the block.

    `label` names it in errors. `nonfinite`: a policy on NaN and Inf, as in `Interpretation`.
    `max_pixels`: how many it may claim. `placed`: whether it matters where it lies.
    Errors: `SettingError`, `InputError`.
    """
    with seekable(spec.path, label) as path:
        file = describe(path, label)
        part, group = choose(
            file, part=spec.part, layer=spec.layer, mask=spec.tint is not None, label=label
        )
        _check_size(part, max_pixels, label)
        meant = _interpretation(spec, nonfinite, () if placed else ("at",))
        reader = LayerReader(file, part, group, meant, label)
        with contextlib.closing(reader):
            yield reader


@contextlib.contextmanager
def opened_deep_layer(
    spec: LayerSpec, label: str, nonfinite: str, max_pixels: str | int
) -> Iterator[DeepReader]:
    """A reader of the layer's deep samples, closed at the end of the block; as `opened_layer`."""
    from ..imagefile.deepreading import open_deep  # of which a stack has no use

    with (
        seekable(spec.path, label) as path,
        open_deep(
            path,
            part=spec.part,
            layer=spec.layer,
            interpretation=_interpretation(spec, nonfinite),
            check=partial(_check_size, max_pixels=max_pixels, label=label),
            label=label,
        ) as reader,
    ):
        yield reader
