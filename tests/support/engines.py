"""Arrays and strips through an engine, and layers on which engines could part."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from strategies import ORDER_NAMES, hue_direction

from hpcomp.color.primaries import PRIMARIES
from hpcomp.color.quantization import Losses
from hpcomp.color.samples import Strip
from hpcomp.color.transfer import LINEAR, REC709_CAMERA, SRGB, gamma
from hpcomp.engine import arrays
from hpcomp.engine import choice as engine

ORDERS = (*ORDER_NAMES, "2,0,3,1")


def composite_by(name, *arguments, **rules):
    """`hpcomp.composite` by the engine of that name."""
    before = os.environ.get(engine.VARIABLE)
    os.environ[engine.VARIABLE] = name
    try:
        return arrays.composite(*arguments, **rules)
    finally:
        if before is None:
            del os.environ[engine.VARIABLE]
        else:
            os.environ[engine.VARIABLE] = before


@dataclass(frozen=True)
class Result:
    """What an engine gave for a strip."""

    samples: np.ndarray
    losses: Losses
    nonfinite: list[int]

    @property
    def everything(self):
        """To be compared with `==`: bytes, counts."""
        return self.samples.tobytes(), self.samples.dtype, vars(self.losses), self.nonfinite


def run(by, rules, strips, width, height, kind="float", *, at_once=1, dtype=np.float32):
    """The strips, layer 0 first, through `kernel` or `reference`, `at_once` of them at a time."""
    accumulator = by.ENGINE.start(rules, width, height, dtype)
    losses, numbers = Losses(), list(rules.arrival)
    # The reference's NaN and Inf are the same with and without numpy's warnings.
    with np.errstate(all="ignore"):
        for begin in range(0, len(numbers), at_once):
            group = numbers[begin : begin + at_once]
            accumulator.add(group, [strips[number] for number in group])
        samples = accumulator.result(kind, losses)
    assert samples.shape == (height, width, 4)
    return Result(samples, losses, list(accumulator.nonfinite))


def run_arrays(by, rules, arrays, kind="float", **how):
    """The same with premultiplied arrays (height, width, 4) that fill the strip."""
    height, width = arrays[0].shape[:2]
    return run(by, rules, [Strip(array) for array in arrays], width, height, kind, **how)


def layers_of_labels(n_layers, height, width, seed=1):
    """(n, h, w, 4) float32, premultiplied: hues equal, in, on and beyond the shoulder of 2° or
    unrelated; the gamut's boundary, greys, HDR, negative colour, glow, nothing."""
    rng = np.random.default_rng([seed, n_layers, height, width])
    pixels = height * width
    toward_red, aside = np.array(hue_direction(0)), np.array(hue_direction(90))
    layers = np.empty((n_layers, pixels, 4))
    hue_deg = rng.uniform(0, 360, pixels)
    for layer in layers:
        steps = [0, 0.8, 1.6, 2.5, 3, 3.9, 4.5, 12, 30, 120, 180, -70]
        hue_deg = hue_deg + rng.choice(steps, pixels)
        angle = np.radians(hue_deg)[:, None]
        direction = np.cos(angle) * toward_red + np.sin(angle) * aside
        luminance = rng.uniform(0.05, 0.95, (pixels, 1))
        room = np.where(direction > 0, (1 - luminance) / direction, luminance / -direction)
        share = np.where(rng.random((pixels, 1)) < 0.5, 1, rng.random((pixels, 1)))
        c = np.clip(luminance + share * room.min(axis=1, keepdims=True) * direction, 0, 1)
        alpha = rng.choice([0, 1, 0.5, 1 / 255, *rng.random(6)], (pixels, 1))
        c *= alpha
        kind = rng.integers(0, 12, pixels)
        c[kind == 0] = c[kind == 0].mean(axis=1, keepdims=True)
        c[kind == 1] = rng.uniform(-0.5, 20, (pixels, 3))[kind == 1]
        c[kind == 2] = 0
        layer[:] = np.concatenate([c, alpha], axis=1)
    return layers.reshape(n_layers, height, width, 4).astype(np.float32)


def broken(layers, seed=2):
    """A copy with NaN of either sign and any payload, Inf and huge numbers strewn in."""
    rng = np.random.default_rng(seed)
    layers = layers.copy()
    some = rng.random(layers.shape) < 0.05
    layers[some] = rng.choice([np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-45], some.sum())
    some = rng.random(layers.shape) < 0.01
    payloads = rng.integers(0x7F800001, 0x80000000, some.sum(), dtype=np.uint32)
    signs = rng.integers(0, 2, some.sum(), dtype=np.uint32) << np.uint32(31)
    layers.view(np.uint32)[some] = payloads | signs
    return layers


MODES = ("straight", "premultiplied", "premultiplied-encoded", "luminance")
CURVES = (SRGB, LINEAR, gamma(2.2), REC709_CAMERA)
# Of custom primaries, the binding sees only the matrix: one with another white, one with the same.
SOME_PRIMARIES = [PRIMARIES[name] for name in ("rec709", "display-p3", "acescg")]


def strips_of(layers):
    return [Strip(layer) for layer in layers]
