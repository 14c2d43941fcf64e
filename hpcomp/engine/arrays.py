"""Compositing and ⊕ of arrays, by either engine. No files here."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..blending.terms import color_of, sum_of, term_of
from ..color.quantization import Losses
from ..color.samples import Strip
from ..errors import MismatchError, SettingError
from ..options import RuleOptions, stack_rules
from . import choice as engine

if TYPE_CHECKING:
    from ..measures.labels import StackMeasures

Array = NDArray[np.floating[Any]]

#: Pixels that `composite` hands to an engine at a time.
STRIP_PIXELS = 1 << 18

#: The farthest pixel from the corner of a canvas.
FARTHEST_ORIGIN = 1 << 28


def _of_one_shape(layers: Sequence[ArrayLike]) -> list[NDArray[Any]]:
    """The layers as arrays (…, 4). Errors: `MismatchError`."""
    arrays = [np.asarray(layer) for layer in layers]
    shape = arrays[0].shape
    for number, array in enumerate(arrays):
        if array.ndim == 0 or array.shape[-1] != 4:
            raise MismatchError(
                f"layer {number} has shape {array.shape}: RGBA needs 4 components on the last axis"
            )
        if array.shape != shape:
            raise MismatchError(
                f"layer {number} has shape {array.shape} but layer 0 has {shape}: "
                "place all layers on one canvas first"
            )
    return arrays


def _rows(shape: tuple[int, ...]) -> tuple[int, int, int]:
    """(pictures, height, width) of arrays (…, height, width, 4); (n, 4) is one row."""
    width = shape[-2] if len(shape) > 1 else 1
    height = shape[-3] if len(shape) > 2 else 1
    return math.prod(shape[:-3]), height, width


def composite(
    layers: Sequence[ArrayLike], *, origin: tuple[int, int] = (0, 0), **rules: Any
) -> Array:
    """Composites layers, bottom first, into one array.

    `layers`: arrays (…, 4) of one shape; linear, premultiplied RGBA; colour unbounded, alpha
    clamped to [0, 1]. float64 is composited in float64, anything else in float32. The last two axes
    before the components are rows and columns of pixels, any others are further pictures.
    `origin`: (x, y) of the first pixel, counted from the corner of the canvas. It places the
    pattern of woven blending, and changes nothing else.
    `rules`, each with its default:
      `op` "over": one operator for the layers above the bottom, or one for each layer, None first;
      `opacity` 1.0: one for all layers or one for each, in [0, 1];
      `preset` None, "paper", "labels" or "woven": a set of choices, which others override;
      `blending` "hue-preserving", "traditional", "foremost" or "woven";
      `order` "bottom-up", "top-down", "balanced", "simultaneous", "2,0,1" or a sequence of ints;
      `space` "linear-rgb", "xyz", "hsl", "oklab" or "cielab";
      `hue_tolerance` 2.0, degrees between p vectors;
      `gray_bias` 0.0: how much less than in the paper hues cancel each other, in [0, 1];
      `strength` "chroma", "perceived" or "coverage": what competes where hues differ;
      `weave` "stripes" or "noise", and `weave_size` 8, pixels: the pattern of woven blending;
      `background` None, or straight linear RGB put under the result;
      `exposure` 0.0: stops, applied to the colour of the result;
      `primaries` "rec709", "display-p3", "rec2020" or "acescg": those of the layers, of the
      background and of the result, which decide luminance and hue.
    Returns: (…, 4), linear, premultiplied RGBA, alpha in [0, 1].
    Errors: `SettingError` for a rule, `MismatchError` for layers of different shapes.
    Source: Chuang et al. 2009, Eq. 1–3 and Algorithm 1; Porter and Duff 1984.
    """
    checked = stack_rules(len(layers), **rules)
    left, top = _checked_origin(origin)
    arrays = _of_one_shape(layers)
    dtype = np.result_type(np.float32, *(a.dtype for a in arrays if a.dtype == np.float64))
    shape = arrays[0].shape
    pictures = [array.reshape(*_rows(shape), 4) for array in arrays]
    result = np.empty(pictures[0].shape, dtype)
    for picture, part in _strips(result.shape[:3]):
        x, y = left + part[1].start, top + part[0].start
        of_strip = (picture, *part)
        height, width = result[of_strip].shape[:2]
        accumulator = engine.start(checked, width, height, dtype, (x, y))
        for number in checked.arrival:
            rgba = np.ascontiguousarray(pictures[number][of_strip], dtype)
            accumulator.add([number], [Strip(rgba)])
        result[of_strip] = accumulator.result("float", Losses())
    return result.reshape(shape)


def _checked_origin(origin: tuple[int, int]) -> tuple[int, int]:
    """Two whole numbers. Errors: `SettingError`."""
    try:
        x, y = (operator.index(value) for value in origin)
    except (TypeError, ValueError):
        x = y = FARTHEST_ORIGIN + 1
    if max(abs(x), abs(y)) > FARTHEST_ORIGIN:
        raise SettingError(
            f"origin {origin} is not two whole numbers, x and y, of at most {FARTHEST_ORIGIN}"
        )
    return x, y


def _strips(shape: tuple[int, ...]) -> Iterator[tuple[int, tuple[slice, slice]]]:
    """Strips of rows and columns of pictures (pictures, height, width), of `STRIP_PIXELS` each."""
    pictures, height, width = shape
    columns = min(width, STRIP_PIXELS) or 1
    rows = max(1, STRIP_PIXELS // columns)
    for picture in range(pictures):
        for y in range(0, height, rows):
            for x in range(0, width, columns):
                yield picture, (slice(y, y + rows), slice(x, x + columns))


def hue_add(
    c1: ArrayLike,
    c2: ArrayLike,
    *,
    hue_tolerance: float = RuleOptions.hue_tolerance,
    gray_bias: float = RuleOptions.gray_bias,
    space: str = RuleOptions.space,
    primaries: str = RuleOptions.primaries,
) -> Array:
    """The hue-preserving sum c1 ⊕ c2 of two premultiplied colours.

    `c1`, `c2`: (…, 3), linear RGB, unbounded; broadcast against each other.
    `hue_tolerance`: degrees between p vectors, 0 for the paper's operator.
    `gray_bias`: how much less than in the paper different hues cancel each other, in [0, 1].
    `space`: a name of `SPACES`, in which hue and chroma are measured.
    `primaries`: those of the RGB, named as in `composite`.
    Returns: (…, 3), linear RGB. float64 if either is, else float32. Where ⊕ leaves the gamut, as it
      may in hsl, oklab and cielab, every channel is brought within the sums of the largest and of
      the negative channels: unlike in `composite`, what alpha would allow beyond is not known.
    Errors: `SettingError` for a rule, `MismatchError` for a shape.
    Source: Chuang et al. 2009, Algorithm 1.
    """
    rules = stack_rules(
        1, hue_tolerance=hue_tolerance, gray_bias=gray_bias, space=space, primaries=primaries
    )
    a, b = np.broadcast_arrays(np.asarray(c1), np.asarray(c2))
    if a.ndim == 0 or a.shape[-1] != 3:
        raise MismatchError(f"colours of shape {a.shape}: RGB needs 3 components on the last axis")
    dtype = np.result_type(np.float32, *(c.dtype for c in (a, b) if c.dtype == np.float64))
    first, second = (c.reshape(-1, 3).T.astype(dtype) for c in (a, b))
    both = sum_of(rules, term_of(rules, first, 0.0), term_of(rules, second, 0.0))  # Eq. 1
    return color_of(rules.space, both).T.reshape(a.shape)


def stack_measures(
    layers: Sequence[ArrayLike], *, origin: tuple[int, int] = (0, 0), **settings: Any
) -> StackMeasures:
    """Measures what compositing does to the hues of layers, bottom first.

    `layers`: arrays (…, height, width, 4) of one shape, pictures one by one, or (n, 4), which is
    one row; linear, premultiplied RGBA; measured in float32.
    `origin`: x and y of the first pixel of a picture, counted from the canvas' corner.
    `settings`: the rules of `composite` under the same names, and
      `half_step` 0.5/65535: |p| above which a term contributes and a result has chroma;
      `achromatic` 0.02: saturation in [0, 1] below which a result is grey;
      `foreign_tolerance` twice `hue_tolerance`, and the space's `gamut_turn` more: degrees between
        p vectors.
    Returns: the `StackMeasures`, of which those of several strips can be added.
    Errors: `SettingError` for a setting, `MismatchError` for layers of different shapes.
    Source: the measures are this project's; the operator is of Chuang et al. 2009.
    """
    from ..measures import labels  # only measures need it

    own = {
        name: settings.pop(name)
        for name in ("half_step", "achromatic", "foreign_tolerance")
        if name in settings
    }
    rules = stack_rules(len(layers), **settings)
    checked = labels.measure_settings(rules, **own)
    arrays = _of_one_shape(layers)
    place_of_first = _checked_origin(origin)
    total = labels.StackMeasures.none(rules, checked)
    stacks = [array.reshape(*_rows(arrays[0].shape), 4) for array in arrays]
    for picture in zip(*stacks, strict=True):
        for place, block in labels.blocks_of(picture, place_of_first):
            rgba = np.array(block, np.float32).reshape(-1, place.height, place.width, 4)
            np.clip(rgba[..., 3], 0, 1, out=rgba[..., 3])
            total += labels.measures_of(rules, checked, rgba, (place.x, place.y))[0]
    return total
