"""Where the layers of a stack lie on one canvas: windows only, no pixels."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

from ..errors import MismatchError
from ..geometry import Placement, Window
from ..options import CanvasOptions
from ..records import record
from ..system.memory import parse_pixels


@record
class LayerWindows:
    """The windows of one layer in its file's coordinates, and where it is to go."""

    label: str
    display: Window
    data: Window
    placement: Placement | None


@record
class Canvas:
    """The canvas of a stack, and how far each layer's file coordinates move to it."""

    window: Window
    offsets: tuple[tuple[int, int], ...]


def lay_out(layers: Sequence[LayerWindows], canvas: str | Window) -> Canvas:
    """Places the layers, bottom first, and finds the canvas.

    A gravity refers to the canvas where that is a window, else to the bottom layer.
    Errors: `MismatchError` for a layer that fits no canvas.
    """
    bottom = layers[0].display
    if isinstance(canvas, Window):
        reference = canvas
    else:
        placement = layers[0].placement
        reference = placement.place(bottom, bottom) if placement else bottom
    displays = [
        layer.placement.place(layer.display, reference) if layer.placement else layer.display
        for layer in layers
    ]
    offsets = tuple(
        (display.x - layer.display.x, display.y - layer.display.y)
        for layer, display in zip(layers, displays, strict=True)
    )
    return Canvas(_window(layers, displays, canvas), offsets)


def _window(
    layers: Sequence[LayerWindows], displays: Sequence[Window], canvas: str | Window
) -> Window:
    if isinstance(canvas, Window):
        return canvas
    if canvas == "union":
        return reduce(Window.union, displays)
    if canvas == "intersection":
        common: Window | None = displays[0]
        for layer, display in zip(layers, displays, strict=True):
            common = common and common.intersection(display)
            if common is None:
                raise MismatchError(
                    f"{layer.label} is {display} and shares no pixel with the layers below: "
                    "move it with at=+X+Y, or choose another --canvas"
                )
        assert common is not None
        return common
    for layer, display in zip(layers, displays, strict=True):
        if layer.placement is None and display != displays[0]:
            raise MismatchError(
                f"{layer.label} is {_shown(display)} but the canvas is {_shown(displays[0])}: "
                "place it with at=+X+Y, or choose --canvas"
            )
    return displays[0]


def _shown(window: Window) -> str:
    at_origin = window.x == window.y == 0
    return f"{window.width}x{window.height}" if at_origin else str(window)


def output_window(
    canvas: Window,
    data: Sequence[Window],
    wanted: CanvasOptions,
    max_pixels: str | int | None = None,
) -> Window:
    """The data window of the output: the canvas, with all overscan if wanted, or a region of it.

    `data`: the layers' data windows, placed. `max_pixels`: how many it may have, where they are all
    made. Errors: `MismatchError` for a region outside, and for more pixels.
    """
    window = reduce(Window.union, data, canvas) if wanted.overscan else canvas
    region = wanted.region
    if region is not None:
        assert isinstance(region, Window)  # as its check leaves it
        if not window.contains(region):
            raise MismatchError(
                f"region {region} is not inside the canvas {window}: choose a window within it"
            )
        window = region
    if max_pixels is not None and window.pixels > parse_pixels(max_pixels):
        raise MismatchError(
            f"the picture would be {window.width}x{window.height}, which is {window.pixels:,} "
            f"pixels and more than {parse_pixels(max_pixels):,}: raise --max-pixels if that is "
            "right, or choose another --canvas or a --region"
        )
    return window
