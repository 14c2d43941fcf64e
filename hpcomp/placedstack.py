"""The layers of a stack, opened and placed, for commands that look at it and write no picture."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from .canvas import parse_canvas
from .compositing import StackRules
from .errors import SettingError, unknown_name
from .geometry import Window
from .imagefile import NONFINITE_POLICIES, STDIN
from .layerfile import opened_layer
from .notices import Notices, warn_of_layers
from .pipeline import Layer, PlacedLayer, _allow_open_files, _numbered, _placed
from .stackfile import LayerSpec


@dataclass(frozen=True)
class PlacedStack:
    """Open layers, bottom first, on their canvas."""

    canvas: Window
    layers: tuple[PlacedLayer, ...]


def layer_specs(layers: Sequence[Layer]) -> list[LayerSpec]:
    """Every layer's settings, in the order given; `SettingError` names the layer."""
    return [_numbered(number, layer) for number, layer in enumerate(layers)]


@contextlib.contextmanager
def opened_stack(
    specs: Sequence[LayerSpec],
    rules: StackRules,
    *,
    canvas: str | Window,
    nonfinite: str,
    notices: Notices,
) -> Iterator[PlacedStack]:
    """The layers opened and placed as `stack` does, with its warnings; closed at the end.

    Errors: `SettingError`, `InputError`, `MismatchError`.
    """
    wanted = parse_canvas(canvas)
    if nonfinite not in NONFINITE_POLICIES:
        raise unknown_name("nonfinite policy", nonfinite, NONFINITE_POLICIES)
    if [spec.path for spec in specs].count(STDIN) > 1:
        raise SettingError("stdin can be only one of the layers")
    with contextlib.ExitStack() as opened:
        _allow_open_files(len(specs))
        readers = [
            opened.enter_context(opened_layer(spec, spec.label(number), nonfinite))
            for number, spec in enumerate(specs)
        ]
        warn_of_layers(rules, readers, notices)
        window, placed = _placed(specs, readers, wanted)
        yield PlacedStack(window, tuple(placed))
