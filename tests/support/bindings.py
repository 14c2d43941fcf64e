"""Arguments for the kernel's binding: right ones, of which a test changes some, and wrong ones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hpcomp.kernel import _kernel

#: What is right but for the samples.
ARGUMENTS_OF_A_LAYER = {
    "decode": None, "alpha_straight": False, "matrix": None, "left": 0, "top": 0, "opacity": 1.0,
    "factor_a": _kernel.Factor.ONE, "factor_b": _kernel.Factor.REST, "behind": False,
    "zero_nonfinite": False,
}  # fmt: skip


def make_layer(samples=None, decode=None, **changed):
    """`_kernel.layer` with arguments that are right but for those given."""
    samples = np.zeros((2, 3, 4), np.float32) if samples is None else samples
    return _kernel.layer(
        **{**ARGUMENTS_OF_A_LAYER, "samples": samples, "decode": decode, **changed}
    )


#: Coefficients of the maps of a space, by the rows that each name has.
PLANE_ROWS = {"to_p": 2, "from_p": 3}
ROWS_OF_MAPS = {
    "linear": PLANE_ROWS,
    "hsl": PLANE_ROWS,
    "oklab": {"to_lms": 3, "to_lab": 3, "to_roots": 3, "from_lms": 3},
    "cielab": {"to_xz": 2, "from_xz": 3},
}


def make_maps(kind="linear", coefficient=1.0, **changed):
    """`_kernel.linear_maps` or those of another space, with all coefficients the same."""
    arguments = {"weight_red": 0.2, "weight_blue": 0.1}
    for name, rows in ROWS_OF_MAPS[kind].items():
        arguments[name] = [[coefficient] * 2] * rows
    if kind in ("oklab", "cielab"):
        arguments |= {"inverse_largest": 0.5, "slack_lo": 0.0, "slack_hi": 0.0}
    return getattr(_kernel, f"{kind}_maps")(**{**arguments, **changed})


#: What a colour below the stack is given as.
BACKGROUND = {
    "luminance": 0.1, "p": [0.2, 0.3], "rgb": [0.4, 0.1, 0.2], "lo": 0.0, "hi": 0.0,
    "strength": 0.0,
}  # fmt: skip


def make_background(**changed):
    return _kernel.background(**{**BACKGROUND, **changed})


def make_competition(**changed):
    arguments = {
        "strength": _kernel.Strength.COVERAGE, "oklab": make_maps("oklab"), "half_chroma": 0.04,
    }  # fmt: skip
    return _kernel.competition(**{**arguments, **changed})


def make_weave(**changed):
    return _kernel.weave(**{"pattern": _kernel.Pattern.STRIPES, "size": 8, "tile": None, **changed})


def make_rules(**changed):
    """`_kernel.rules`; woven, where the order is."""
    if changed.get("order") is _kernel.Order.WOVEN:
        changed = {"blending": _kernel.Blending.WOVEN, "weave": make_weave(), **changed}
    arguments = {
        "blending": _kernel.Blending.HUE_PRESERVING, "hue_tolerance": 0.03, "rounding_angle": 1e-4,
        "gray_bias": 0.0, "order": BOTTOM_UP, "permutation": [], "layers": 2, "background": None,
        "gain": 1.0, "space": make_maps(), "competition": None, "weave": None,
    }  # fmt: skip
    return _kernel.rules(**{**arguments, **changed})


ALL_ORDERS = tuple(_kernel.Order)
#: Those whose stacks the loops measure.
MEASURED_ORDERS = tuple(order for order in ALL_ORDERS if order is not _kernel.Order.WOVEN)
BOTTOM_UP, FRONT_TO_BACK, PERMUTATION = (
    _kernel.Order.BOTTOM_UP, _kernel.Order.FRONT_TO_BACK, _kernel.Order.PERMUTATION
)  # fmt: skip


def unaligned(dtype, shape):
    """An array of zeros that begins between two multiples of every type's size."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    found = np.zeros(size + 1, np.uint8)[1:].view(dtype).reshape(shape)
    assert found.ctypes.data % 2
    return found


def refused():
    return pytest.raises((TypeError, ValueError))


WRONG_TYPES = (
    "i1", "i2", "i4", "u4", "u8", "f8", "c8", "?", ">f4", ">f2", ">u2", "O", "S4", "M8[s]",
)  # fmt: skip
STRIDED = {
    "every other pixel": lambda a: np.repeat(a, 2, axis=1)[:, ::2],
    "from right to left": lambda a: a[:, ::-1],
    "channels backwards": lambda a: a[..., ::-1],
    "every other channel": lambda a: np.repeat(a, 2, axis=2)[..., ::2],
    "planes": lambda a: np.ascontiguousarray(a.transpose(2, 0, 1)).transpose(1, 2, 0),
    "one pixel for all": lambda a: np.broadcast_to(a[:, :1], a.shape),
}
