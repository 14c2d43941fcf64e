"""Made-up scans: scalar fields that stand for the paper's tomato, tooth, chest, frog, fish and pig.

A phantom takes object coordinates x (right), y (down), z (away), arrays of one shape with the body
within some 0.95 of the origin, and gives the data value of each point: 0 is air, and every material
has a value of its own, of -1 to 1. Edges are blurred as by a scanner, and pass through all values
between two materials. Where a third one would be among them, a material has a negative value: else
the roots of the tooth would wear enamel, and coins a coat of china. What colour and how opaque a
value is, and from where it is looked at, stands in slices.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

Field = np.ndarray
Point = tuple[float, float, float]

BLUR = 0.022  # width of the edge between two materials
PEEL = 0.016  # that of the tomato; a thick peel would be all that is seen along its rim


# ---- distances: negative inside ------------------------------------------------------------------


def ellipsoid(x: Field, y: Field, z: Field, center: Point, radii: Point) -> Field:
    """Nearly the distance to it: exact on the surface."""
    a, b, c = ((v - v0) / r for v, v0, r in zip((x, y, z), center, radii, strict=True))
    return (np.sqrt(a * a + b * b + c * c) - 1) * min(radii)


def capsule(
    x: Field, y: Field, z: Field, start: Point, end: Point, first: float, last: float
) -> Field:
    """A rod with round ends whose radius goes from `first` to `last`."""
    along = [e - s for s, e in zip(start, end, strict=True)]
    from_start = [v - s for v, s in zip((x, y, z), start, strict=True)]
    t = sum(p * a for p, a in zip(from_start, along, strict=True)) / sum(a * a for a in along)
    t = np.clip(t, 0, 1)
    a, b, c = (p - t * d for p, d in zip(from_start, along, strict=True))
    return np.sqrt(a * a + b * b + c * c) - (first + t * (last - first))


def both(*distances: Field) -> Field:
    return np.maximum.reduce(distances)


def joined(distances: Sequence[Field], rounding: float) -> Field:
    """The union, with fillets of about that size."""
    first, *others = distances
    for other in others:
        h = np.maximum(rounding - np.abs(first - other), 0) / rounding
        first = np.minimum(first, other) - h * h * rounding / 4
    return first


def step(low: float, high: float, value: Field) -> Field:
    """0 below `low`, 1 above `high`, smooth between; falls if they are the other way round."""
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def put(values: Field, distance: Field, value: float, blur: float = BLUR) -> Field:
    """The values with `value` where the distance is negative."""
    return values + (value - values) * step(blur / 2, -blur / 2, distance)


def repeated(value: Field, period: float) -> Field:
    """The distance to the nearest multiple of the period."""
    return np.abs((value + period / 2) % period - period / 2)


# ---- the phantoms --------------------------------------------------------------------------------


def tomato(x: Field, y: Field, z: Field) -> Field:
    """Flesh 0.55, a jelly of 0.34 in six chambers, and in it seeds of 0.85; the peel is the edge of
    the flesh, with the values below 0.34."""
    out = np.hypot(x, z)
    around = np.arctan2(z, x)
    ribbed = 1 + 0.03 * np.cos(6 * around) * out**2 / (out**2 + 0.05)
    body = np.sqrt(x * x + z * z + (1.18 * y) ** 2) - 0.82 * ribbed
    body = body + 0.20 * np.exp(-((out / 0.20) ** 2)) * step(0.1, -0.5, y)
    sector = repeated(around, np.pi / 3)  # 0 in the middle of a chamber
    middle, side = out * np.cos(sector), out * np.sin(sector)
    wall = out * np.sin(np.pi / 6 - sector)
    chamber = both(body + 0.19, 0.17 - out, 0.045 - wall)
    values = put(np.zeros_like(x), body, 0.55, PEEL)
    values = put(values, chamber, 0.34)
    for far, height, beside in (
        (0.30, -0.22, 0.05), (0.45, -0.12, 0.09), (0.29, 0.00, 0.05), (0.47, 0.10, 0.10),
        (0.32, 0.20, 0.06), (0.40, 0.32, 0.04),
    ):  # fmt: skip
        seed = ellipsoid(middle, y, side, (far, height, beside), (0.068, 0.045, 0.038))
        values = put(values, seed, 0.85)
    return values


def tooth(x: Field, y: Field, z: Field) -> Field:
    """Enamel -0.35 on the crown, dentine 0.45 below it and in the roots, pulp 0.85."""
    cusps = 0.07 * np.cos(8.2 * x) * np.cos(8.2 * z) * step(-0.45, -0.75, y)
    corner = [np.maximum(np.abs(v) - r, 0) for v, r in ((x, 0.30), (y + 0.38, 0.16), (z, 0.26))]
    crown = np.sqrt(sum(c * c for c in corner)) - 0.24 + cusps
    roots = [
        capsule(x, y, z, (0.22 * side, -0.1, 0.0), (0.30 * side, 0.80, 0.05 * side), 0.26, 0.07)
        for side in (-1, 1)
    ]
    body = joined([crown, *roots], 0.16)
    cap = 0.15 * step(0.12, -0.22, y + 0.05 * np.cos(6 * np.arctan2(z, x)))
    chamber = ellipsoid(x, y, z, (0, -0.20, 0), (0.25, 0.15, 0.19))
    horns = [
        capsule(x, y, z, (0.13 * side, -0.22, 0), (0.21 * side, -0.42, 0), 0.07, 0.03)
        for side in (-1, 1)
    ]
    canals = [
        capsule(x, y, z, (0.19 * side, -0.12, 0), (0.295 * side, 0.72, 0.04 * side), 0.085, 0.02)
        for side in (-1, 1)
    ]
    pulp = joined([chamber, *horns, *canals], 0.10)
    values = put(np.zeros_like(x), body, np.where(cap > 0, -0.35, 0.45))
    values = put(values, body + cap, 0.45)
    return put(values, pulp, 0.85)


def fish(x: Field, y: Field, z: Field) -> Field:
    """Flesh 0.35, bones 0.80: skull, backbone, ribs and the rays of the fins."""
    x, y, z = 0.87 * x - 0.08, 0.87 * y - 0.04, 0.87 * z  # as large as fits into the picture
    s = np.clip((x + 0.88) / 1.45, 0.001, 1)
    tall = 0.045 + 0.86 * np.sqrt(s) * (1 - s) ** 1.1
    wide = 0.38 * tall
    flank = (np.sqrt((y / tall) ** 2 + (z / wide) ** 2) - 1) * wide
    body = both(flank, -0.88 - x, x - 0.57)
    fork = 0.05 + 0.80 * np.maximum(x - 0.48, 0)
    notch = 0.68 + 0.35 * np.abs(y) + 0.25 * y * y
    tail = both(np.abs(y) - fork, 0.48 - x, x - notch, np.abs(z) - 0.022)
    along = (x + 0.24) / 0.38
    back = both(-y - 0.16 - 0.34 * np.sqrt(np.clip(1 - along * along, 0, 1)) * (1 - 0.25 * along),
                y + 0.16, np.abs(along) - 1, np.abs(z) - 0.022)  # fmt: skip
    along = (x - 0.12) / 0.17
    belly = both(y - 0.10 - 0.26 * np.sqrt(np.clip(1 - along * along, 0, 1)), 0.10 - y,
                 np.abs(along) - 1, np.abs(z) - 0.022)  # fmt: skip
    whole = np.minimum.reduce([body, tail, back, belly])
    spine_y = -0.03 * np.sin(3 * s)
    vertebrae = 0.030 + 0.010 * np.cos(2 * np.pi * x / 0.062)
    spine = both(np.hypot(y - spine_y, z) - vertebrae, -0.52 - x, x - 0.60)
    slant = repeated(x - 0.30 * np.abs(y), 0.062)
    shell = np.abs(np.sqrt((y / tall) ** 2 + (z / wide) ** 2) - 0.72) * wide - 0.014
    ribs = both(shell, slant - 0.011, -0.45 - x, x - 0.02, -0.02 - y)
    thorns = both(np.abs(z) - 0.014, slant - 0.010, np.abs(y) - 0.80 * tall, -0.45 - x, x - 0.50)
    thorns = both(thorns, np.where(x < 0.02, y, -1))  # below the ribs there are none
    head = ellipsoid(x, y, z, (-0.64, -0.02, 0), (0.20, 0.17, 0.08))
    skull = np.abs(head + 0.012) - 0.016
    eye = np.hypot(x + 0.72, y + 0.07) - 0.045
    skull = both(skull, -eye)
    rays = both(np.minimum.reduce([tail, back, belly]) + 0.004,
                np.where(x > 0.48, repeated(np.arctan2(y, x - 0.30), 0.11) * 0.30,
                         repeated(x + 0.35 * y, 0.062)) - 0.008)  # fmt: skip
    values = put(np.zeros_like(x), whole, 0.35)
    for bone in (spine, ribs, thorns, skull, rays):
        values = put(values, bone, 0.80, BLUR / 2)
    return values


def piggy_bank(x: Field, y: Field, z: Field) -> Field:
    """A hollow pig of 0.35, its nose to the left, with coins of -0.50."""
    legs = [
        capsule(x, y, z, (px, 0.30, pz), (px, 0.66, 1.1 * pz), 0.13, 0.11)
        for px in (-0.34, 0.34) for pz in (-0.24, 0.24)
    ]  # fmt: skip
    ears = [ellipsoid(x, y, z, (-0.50, -0.47, pz), (0.07, 0.19, 0.10)) for pz in (-0.20, 0.20)]
    snout = capsule(x, y, z, (-0.66, 0.02, 0), (-0.90, 0.06, 0), 0.14, 0.14)
    head = ellipsoid(x, y, z, (-0.52, -0.10, 0), (0.31, 0.30, 0.30))
    trunk = ellipsoid(x, y, z, (0.06, 0.02, 0), (0.70, 0.48, 0.46))
    pig = joined([trunk, head, snout, *legs, *ears], 0.09)
    curl = np.abs(np.hypot(x - 0.80, y + 0.08) - 0.075)
    pig = joined([pig, np.hypot(curl, z + 0.2 * (x - 0.8)) - 0.028], 0.04)
    slot = both(np.abs(x - 0.05) - 0.17, np.abs(z) - 0.035, y + 0.35)
    china = both(np.abs(pig + 0.022) - 0.026, -slot)
    coins = np.full_like(x, 1.0)
    for place, tilt, turn in COINS:
        away = [v - v0 for v, v0 in zip((x, y, z), place, strict=True)]
        near = sum(a * a for a in away) < 0.18**2
        a, b, c = (v[near] for v in away)
        a, c = a * np.cos(turn) + c * np.sin(turn), c * np.cos(turn) - a * np.sin(turn)
        b, a = b * np.cos(tilt) + a * np.sin(tilt), a * np.cos(tilt) - b * np.sin(tilt)
        coin = both(np.hypot(a, c) - 0.155, np.abs(b) - 0.020)
        coins[near] = np.minimum(coins[near], coin)
    values = put(np.zeros_like(x), china, 0.35)
    return put(values, coins, -0.50)


# Where a coin is, how it is tilted and which way, in radians.
COINS = (
    ((-0.25, 0.24, 0.05), 0.10, 0.3), ((0.02, 0.30, -0.08), 0.05, 1.0),
    ((0.30, 0.25, 0.06), -0.15, 0.2), ((-0.12, 0.18, -0.14), 0.25, 0.9),
    ((0.16, 0.20, 0.10), -0.20, 2.0), ((0.40, 0.14, -0.08), -0.45, 0.4),
    ((-0.36, 0.12, -0.05), 0.55, 0.2), ((0.04, 0.10, -0.02), 0.30, 0.1),
    ((0.24, 0.06, -0.12), 1.25, 0.5), ((-0.16, 0.02, 0.08), 1.10, -0.6),
    ((0.06, -0.08, -0.05), 1.45, 0.15),
)  # fmt: skip


def chest(x: Field, y: Field, z: Field) -> Field:
    """Flesh 0.35 around two lungs of air, bones 0.80: ribs, breastbone, collarbones, backbone."""
    shoulders = 1 - 0.45 * step(-0.35, -0.85, y) - 0.10 * step(0.2, 0.9, y)
    trunk = both((np.sqrt((x / 0.80) ** 2 + (z / 0.50) ** 2) - shoulders) * 0.5, np.abs(y) - 0.90)
    neck = capsule(x, y, z, (0, -0.95, 0.06), (0, -0.6, 0.06), 0.20, 0.30)
    arms = [
        capsule(x, y, z, (0.62 * s, -0.44, 0.06), (0.80 * s, 0.0, 0.06), 0.18, 0.13)
        for s in (-1, 1)
    ]
    body = both(joined([trunk, neck, *arms], 0.12), np.abs(y) - 0.90, np.abs(x) - 0.93)
    lungs = [ellipsoid(x, y, z, (0.31 * s, -0.08, 0.0), (0.23, 0.46, 0.27)) for s in (-1, 1)]
    cage = np.sqrt((x / 0.60) ** 2 + (z / 0.37) ** 2) - (1 - 0.40 * step(-0.2, -0.72, y))
    shell = np.abs(cage) * 0.40 - 0.024
    level = y + 0.42 * z + 0.06 * np.abs(x)  # ribs come down towards the front
    open_front = 0.10 + 0.8 * np.maximum(y - 0.12, 0)
    ribs = both(shell, repeated(level, 0.155) - 0.034, np.abs(level + 0.02) - 0.55,
                np.where(z < 0, open_front - np.abs(x), -1.0))  # fmt: skip
    breastbone = ellipsoid(x, y, z, (0, -0.22, -0.33), (0.085, 0.34, 0.040))
    collar = [
        capsule(x, y, z, (0.06 * s, -0.56, -0.26), (0.58 * s, -0.62, 0.02), 0.034, 0.030)
        for s in (-1, 1)
    ]
    vertebrae = 0.085 + 0.02 * np.cos(2 * np.pi * y / 0.13)
    backbone = both(np.hypot(x, z - 0.33) - vertebrae, np.abs(y) - 0.95)
    upper_arms = [
        capsule(x, y, z, (0.62 * s, -0.46, 0.06), (0.80 * s, 0.02, 0.06), 0.065, 0.045)
        for s in (-1, 1)
    ]
    bones = np.minimum.reduce([ribs, breastbone, *collar, backbone, *upper_arms])
    values = put(np.zeros_like(x), body, 0.35)
    for lung in lungs:
        values = put(values, lung, 0.0)
    return put(values, both(bones, np.abs(y) - 0.89, np.abs(x) - 0.92), 0.80)


def frog(x: Field, y: Field, z: Field) -> Field:
    """Flesh 0.35, seen from above with its nose up; brain 0.80, larger than in life."""
    mirrored = np.abs(x)
    head = ellipsoid(x, y, z, (0, -0.45, 0), (0.34, 0.38, 0.26))
    trunk = ellipsoid(x, y, z, (0, 0.08, 0.03), (0.38, 0.52, 0.28))
    eye = ellipsoid(mirrored, y, z, (0.24, -0.55, -0.17), (0.11, 0.11, 0.11))
    limbs = [
        ((0.20, 0.45, 0.08), (0.66, 0.16, 0.10), 0.17, 0.12),  # thigh
        ((0.66, 0.16, 0.10), (0.50, 0.72, 0.14), 0.12, 0.06),  # shank
        ((0.50, 0.72, 0.14), (0.82, 0.84, 0.18), 0.06, 0.035),  # foot
        ((0.28, -0.18, 0.10), (0.60, -0.26, 0.12), 0.10, 0.07),  # arm
        ((0.60, -0.26, 0.12), (0.66, -0.60, 0.18), 0.07, 0.04),  # hand
    ]
    body = joined([head, trunk, eye, *(capsule(mirrored, y, z, *limb) for limb in limbs)], 0.09)
    brain = joined(
        [
            ellipsoid(mirrored, y, z, (0.075, -0.56, -0.02), (0.075, 0.13, 0.08)),  # hemispheres
            ellipsoid(mirrored, y, z, (0.11, -0.32, -0.02), (0.12, 0.12, 0.10)),  # optic lobes
            ellipsoid(x, y, z, (0, -0.17, -0.01), (0.15, 0.05, 0.07)),  # cerebellum
            capsule(x, y, z, (0, -0.16, 0), (0, 0.42, 0.06), 0.075, 0.03),  # cord
        ],
        0.025,
    )
    values = put(np.zeros_like(x), body, 0.35)
    return put(values, brain, 0.80)


PHANTOMS: dict[str, Callable[[Field, Field, Field], Field]] = {
    "tomato": tomato,
    "tooth": tooth,
    "fish": fish,
    "piggy-bank": piggy_bank,
    "chest": chest,
    "frog": frog,
}
