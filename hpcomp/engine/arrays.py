"""Compositing and ⊕ of arrays, by either engine. No files here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..blending import addition
from ..blending.terms import color_of, sum_of_terms, term_of
from ..color import spaces
from ..color.primaries import to_xyz, working_primaries
from ..color.quantization import Losses
from ..color.samples import Strip
from ..errors import MismatchError
from ..measures.labels import StackMeasures, blocks_of, measure_settings, measures_of
from ..options import RuleOptions, stack_rules
from . import choice as engine

Array = NDArray[np.floating[Any]]

#: Pixels that `composite` hands to an engine at a time.
STRIP_PIXELS = 1 << 18


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


def composite(layers: Sequence[ArrayLike], **rules: Any) -> Array:
    """Composites layers, bottom first, into one array.

    `layers`: arrays (…, 4) of one shape; linear, premultiplied RGBA; colour unbounded, alpha
    clamped to [0, 1]. float64 is composited in float64, anything else in float32.
    `rules`, each with its default:
      `op` "over": one operator for the layers above the bottom, or one for each layer, None first;
      `opacity` 1.0: one for all layers or one for each, in [0, 1];
      `blending` "hue-preserving", "traditional", or "foremost";
      `order` "bottom-up", "top-down", "balanced", "simultaneous", "2,0,1" or a sequence of ints;
      `space` "linear-rgb", "xyz", "hsl", "oklab" or "cielab";
      `hue_tolerance` 2.0, degrees between p vectors;
      `gray_bias` 0.0: how much less than in the paper hues cancel each other, in [0, 1];
      `background` None, or straight linear RGB put under the result;
      `exposure` 0.0: stops, applied to the colour of the result;
      `primaries` "rec709", "display-p3", "rec2020" or "acescg": those of the layers, of the
      background and of the result, which decide luminance and hue.
    Returns: (…, 4), linear, premultiplied RGBA, alpha in [0, 1].
    Errors: `SettingError` for a rule, `MismatchError` for layers of different shapes.
    Source: Chuang et al. 2009, Eq. 1–3 and Algorithm 1; Porter and Duff 1984.
    """
    checked = stack_rules(len(layers), **rules)
    arrays = _of_one_shape(layers)
    dtype = np.result_type(np.float32, *(a.dtype for a in arrays if a.dtype == np.float64))
    shape = arrays[0].shape
    flat = [array.reshape(-1, 4) for array in arrays]
    result = np.empty((len(flat[0]), 4), dtype)
    for begin in range(0, len(result), STRIP_PIXELS):
        end = min(begin + STRIP_PIXELS, len(result))
        accumulator = engine.start(checked, end - begin, 1, dtype)
        for number in checked.arrival:
            rgba = np.ascontiguousarray(flat[number][begin:end], dtype)
            accumulator.add([number], [Strip(rgba[None])])
        result[begin:end] = accumulator.result("float", Losses())[0]
    return result.reshape(shape)


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
    tolerance = addition.check_hue_tolerance(hue_tolerance)
    blending_space = spaces.space(space, to_xyz(working_primaries(primaries)))
    bias = addition.check_gray_bias(gray_bias)
    a, b = np.broadcast_arrays(np.asarray(c1), np.asarray(c2))
    if a.ndim == 0 or a.shape[-1] != 3:
        raise MismatchError(f"colours of shape {a.shape}: RGB needs 3 components on the last axis")
    dtype = np.result_type(np.float32, *(c.dtype for c in (a, b) if c.dtype == np.float64))
    first, second = (c.reshape(-1, 3).T.astype(dtype) for c in (a, b))
    terms = [term_of(blending_space, colors, 0.0) for colors in (first, second)]
    kept = addition.keep_hue(terms[0].p, terms[1].p, tolerance, bias)
    both = sum_of_terms(terms, kept, blending_space)  # Eq. 1
    return color_of(blending_space, both).T.reshape(a.shape)


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
    own = {
        name: settings.pop(name)
        for name in ("half_step", "achromatic", "foreign_tolerance")
        if name in settings
    }
    rules = stack_rules(len(layers), **settings)
    checked = measure_settings(rules, **own)
    arrays = _of_one_shape(layers)
    *pictures, height, width, _ = (1, 1, *arrays[0].shape)
    total = StackMeasures.none(rules, checked)
    stacks = [array.reshape(math.prod(pictures), height, width, 4) for array in arrays]
    for picture in zip(*stacks, strict=True):
        for place, block in blocks_of(picture, origin):
            rgba = np.array(block, np.float32).reshape(-1, place.height, place.width, 4)
            np.clip(rgba[..., 3], 0, 1, out=rgba[..., 3])
            total += measures_of(rules, checked, rgba, (place.x, place.y))[0]
    return total
