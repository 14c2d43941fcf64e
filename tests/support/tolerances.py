"""How near is near enough, each with its reason, and the one assertion that uses them."""

import numpy as np

# A few roundings of doubles, in units of the largest value that took part.
ROUNDING = 2e-15

# Engine and oracle order their operations differently, and inside the shoulder ⊕ turns a rounding
# of its inputs into up to 1 + 3/τ of its result: 87 at 2°, 345 at 0.5°, more where the next layer
# of a stack is in the shoulder too. Worst of 200,000 random stacks of up to six layers: 2e-14.
FLOAT64 = 1e-12

# The same in single precision, with its rounding of 6e-8. Worst of as many stacks: 2e-6.
FLOAT32 = 2e-5

# At tolerance 0 the switch is hard: where rounding is all the hue a colour has, |p| below 1e-16 of
# the colour by 1e-4 rad = 1e-12, sum or difference are both right.
HARD_SWITCH = 1e-11

# Angles in degrees, taken from results: rounding of 1e-16 seen from a |p| of 1e-6 and more.
ANGLE_DEG = 1e-6

# Below that share of the inputs' size, a result is grey and its hue is rounding.
HAS_HUE = 1e-6


def assert_near(actual, expected, tolerance, scale=1.0):
    """Finite, of one shape, and within tolerance·scale of each other on both sides."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape
    assert np.all(np.isfinite(actual))
    error = np.abs(actual.astype(np.float64) - expected.astype(np.float64))
    assert np.all(error <= tolerance * np.asarray(scale)), (
        f"off by {error.max():.3g}, allowed {np.max(tolerance * np.asarray(scale)):.3g}:\n"
        f"actual   {actual.tolist()!r}\nexpected {expected.tolist()!r}"
    )
