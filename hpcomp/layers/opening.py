"""From a LAYER to its open file: one door for every command that reads layers."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from ..imagefile.description import describe
from ..imagefile.parts import choose
from ..imagefile.reading import LayerReader
from ..imagefile.seekable import seekable
from .layerspec import LayerSpec


@contextlib.contextmanager
def opened_layer(spec: LayerSpec, label: str, nonfinite: str) -> Iterator[LayerReader]:
    """A reader of the layer's pixels, closed at the end of the block.

    `label` names it in errors. `nonfinite`: a policy on NaN and Inf, as in `LayerReader`.
    Errors: `SettingError`, `InputError`.
    """
    with seekable(spec.path, label) as path:
        file = describe(path, label)
        part, group = choose(
            file, part=spec.part, layer=spec.layer, mask=spec.tint is not None, label=label
        )
        reader = LayerReader(
            file,
            part,
            group,
            alpha=spec.alpha,
            colorspace=spec.colorspace,
            tint=spec.tint,
            nonfinite=nonfinite,
            label=label,
        )
        try:
            yield reader
        finally:
            reader.close()
