"""A second opinion on the mathematics, scalar and literal, in doubles; no hpcomp and no numpy.

Colours are (R, G, B), linear and premultiplied; layers are (R, G, B, alpha). It is written to be
held beside the paper (Chuang, Weiskopf, Möller: Hue-Preserving Color Blending, 2009), not to be
fast: it works on difference vectors in RGB and finds the dominant colour by trying both.
"""

import itertools
import math
from typing import NamedTuple

# Rec. ITU-R BT.709-6, item 1.3: chromaticities (x, y) of R, G, B, and of the white point D65.
BT709_PRIMARIES = ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060))
D65 = (0.3127, 0.3290)

# Difference vectors at a smaller angle, in radians, are of one hue even at tolerance 0: the paper's
# "positive multiple" has to survive rounding.
ROUNDING_ANGLE = 1e-4


def xyz_of(chromaticity):
    """XYZ at Y = 1 of a chromaticity (x, y)."""
    x, y = chromaticity
    return (x / y, 1.0, (1 - x - y) / y)


def determinant(a, b, c):
    """Of the 3×3 matrix with the columns a, b, c."""
    return (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        - b[0] * (a[1] * c[2] - a[2] * c[1])
        + c[0] * (a[1] * b[2] - a[2] * b[1])
    )


def luminance_weights(primaries=BT709_PRIMARIES, white=D65):
    """The Y row of RGB→XYZ: how much of each primary makes the white, by Cramer's rule.

    0.21263900587151, 0.71516867876776, 0.07219231536073 for BT.709 and D65, usually printed as
    0.2126, 0.7152, 0.0722 (BT.709-6, item 3.2).
    """
    red, green, blue = (xyz_of(primary) for primary in primaries)
    w = xyz_of(white)
    whole = determinant(red, green, blue)
    return (
        determinant(w, green, blue) / whole,
        determinant(red, w, blue) / whole,
        determinant(red, green, w) / whole,
    )


WEIGHTS = luminance_weights()


# --- colours ------------------------------------------------------------------------------------


def luminance(c):
    return WEIGHTS[0] * c[0] + WEIGHTS[1] * c[1] + WEIGHTS[2] * c[2]


def difference(c):
    """The difference vector to the grey axis at the same luminance: its length is the chroma |p|.

    Written with differences of the components, so that a grey gives zero exactly.
    """
    red, green, blue = c
    w_red, w_green, w_blue = WEIGHTS
    return (
        w_green * (red - green) + w_blue * (red - blue),
        w_red * (green - red) + w_blue * (green - blue),
        w_red * (blue - red) + w_green * (blue - green),
    )


def color(y, d):
    """The colour of luminance y with the difference vector d."""
    return (y + d[0], y + d[1], y + d[2])


def length(v):
    return math.hypot(v[0], v[1], v[2])


def scaled(k, v):
    return tuple(k * component for component in v)


def unit(v):
    """v at length 1; component by component, so that no product of small ones underflows."""
    whole = length(v)
    return tuple(component / whole for component in v)


def added(a, b):
    return tuple(x + y for x, y in zip(a, b, strict=True))


def angle(d1, d2):
    """Between two vectors, in radians; 0 where one of them is zero."""
    if length(d1) == 0 or length(d2) == 0:
        return 0.0
    u, v = unit(d1), unit(d2)
    cross = (
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    )
    return math.atan2(length(cross), u[0] * v[0] + u[1] * v[1] + u[2] * v[2])


# --- blending spaces ----------------------------------------------------------------------------
#
# ⊕ sees a colour as a luminance and a vector in a plane. A space is another such vector, so a stack
# is blended there by blending colours of linear RGB that have these vectors as difference vectors.


def crossed(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


#: Two unit vectors at right angles in the plane of the difference vectors.
AXIS_1 = unit(difference((1.0, 0.0, 0.0)))
AXIS_2 = unit(crossed(WEIGHTS, AXIS_1))

#: X, Y, Z of each primary at the strength that it has in white.
PRIMARIES_XYZ = tuple(
    scaled(weight, xyz_of(primary))
    for weight, primary in zip(WEIGHTS, BT709_PRIMARIES, strict=True)
)


def chroma_of_xyz(c):
    """By how much X and Z differ from those of the grey at the same luminance."""
    x, y, z = (math.fsum(c[i] * PRIMARIES_XYZ[i][row] for i in range(3)) for row in range(3))
    white = xyz_of(D65)
    return (x - white[0] * y, z - white[2] * y)


def color_of_xyz(y, p):
    """The colour of luminance y with the chroma p: Cramer's rule on X, Y, Z."""
    white = xyz_of(D65)
    red, green, blue = PRIMARIES_XYZ
    wanted = (p[0] + white[0] * y, y, p[1] + white[2] * y)
    whole = determinant(red, green, blue)
    return (
        determinant(wanted, green, blue) / whole,
        determinant(red, wanted, blue) / whole,
        determinant(red, green, wanted) / whole,
    )


def chroma_of_hsl(c):
    """Along the difference vector, with the length max − min."""
    d = difference(c)
    if length(d) == 0:
        return (0.0, 0.0)
    u = scaled(max(c) - min(c), unit(d))
    return tuple(sum(a * b for a, b in zip(u, axis, strict=True)) for axis in (AXIS_1, AXIS_2))


def color_of_hsl(y, p):
    if p == (0, 0):
        return (y, y, y)
    d = in_plane(p)
    return color(y, scaled(math.hypot(*p) / (max(d) - min(d)), d))


def solved(rows, wanted):
    """x of rows · x = wanted, by Cramer's rule."""
    columns = list(zip(*rows, strict=True))
    whole = determinant(*columns)
    return tuple(
        determinant(*(wanted if i == j else column for j, column in enumerate(columns))) / whole
        for i in range(3)
    )


def xyz_of_color(c):
    return tuple(math.fsum(c[i] * PRIMARIES_XYZ[i][row] for i in range(3)) for row in range(3))


def color_of_tristimulus(xyz):
    return solved(list(zip(*PRIMARIES_XYZ, strict=True)), xyz)


def applied(rows, v):
    return tuple(math.fsum(a * b for a, b in zip(row, v, strict=True)) for row in rows)


# W3C, CSS Color Module Level 4, sample code for color conversions: Oklab after Ottosson.
XYZ_TO_LMS = (
    (0.8190224379967030, 0.3619062600528904, -0.1288737815209879),
    (0.0329836539323885, 0.9292868615863434, 0.0361446663506424),
    (0.0481771893596242, 0.2642395317527308, 0.6335478284694309),
)
LMS_TO_OKLAB = (
    (0.2104542683093140, 0.7936177747023054, -0.0040720430116193),
    (1.9779985324311684, -2.4285922420485799, 0.4505937096174110),
    (0.0259040424655478, 0.7827717124575296, -0.8086757549230774),
)


def cube_root(x):
    return math.copysign(math.cbrt(abs(x)), x)


def oklab_of_xyz(xyz):
    return applied(LMS_TO_OKLAB, [cube_root(cone) for cone in applied(XYZ_TO_LMS, xyz)])


def xyz_of_oklab(lab):
    return solved(XYZ_TO_LMS, [root**3 for root in solved(LMS_TO_OKLAB, lab)])


def cielab_of_xyz(xyz):
    """CIE 15:2018, 8.2.1, the white being D65."""

    def f(t):
        return math.cbrt(t) if t > (6 / 29) ** 3 else t / 3 * (29 / 6) ** 2 + 4 / 29

    x, y, z = (f(value / of_white) for value, of_white in zip(xyz, xyz_of(D65), strict=True))
    return (116 * y - 16, 500 * (x - y), 200 * (y - z))


def xyz_of_cielab(lab):
    """CIE 15:2018, annex D."""

    def cubed(root):
        return root**3 if root > 6 / 29 else 3 * (6 / 29) ** 2 * (root - 4 / 29)

    y = (lab[0] + 16) / 116
    roots = (y + lab[1] / 500, y, y - lab[2] / 200)
    return tuple(
        cubed(root) * of_white for root, of_white in zip(roots, xyz_of(D65), strict=True)
    )


def chromaticity(lab_of, c):
    """(a, b)/L of c scaled to Y = 1; in steps, as 1/Y may not be a number."""
    small = tuple(component / max(c) for component in c)
    lab = lab_of(xyz_of_color(tuple(component / luminance(small) for component in small)))
    # Where L is not positive the length is beyond every bound.
    size, across = math.hypot(lab[1], lab[2]), max(lab[0], 1e-300)
    return (0.0, 0.0) if size == 0 else tuple(x / size * (size / across) for x in lab[1:])


def no_longer_than(most, v):
    return scaled(min(1.0, most / math.hypot(*v)), v) if any(v) else v


#: L of white, and how far |p|/Y may go: twice as far as in blue, which has most, but in Oklab only
#: as far as (1, a/L, b/L) has a quarter of white's luminance in every direction, half a degree apart.
WHITE_L = {"oklab": 1.0, "cielab": 100.0}


def least_luminance(most):
    angles = [math.radians(step / 2) for step in range(720)]
    return min(
        xyz_of_oklab((1.0, most * math.cos(angle), most * math.sin(angle)))[1] for angle in angles
    )


def farthest_in_oklab():
    near, far = 0.0, 2 * math.hypot(*chromaticity(oklab_of_xyz, (0.0, 0.0, 1.0)))
    for _ in range(40):
        middle = (near + far) / 2
        near, far = (middle, far) if least_luminance(middle) >= 1 / 4 else (near, middle)
    return near


MOST = {
    "oklab": farthest_in_oklab(),
    "cielab": 2 * math.hypot(*chromaticity(cielab_of_xyz, (0.0, 0.0, 1.0))),
}


def uniform(name, lab_of, xyz_of_lab):
    """p = Y·(a, b)/L of the colour at Y = 1, and the way back."""

    def chroma_of(c):
        y = luminance(c)
        if y <= 0:
            return (0.0, 0.0)
        return scaled(y, no_longer_than(MOST[name], chromaticity(lab_of, c)))

    def color_of(y, p):
        if y <= 0:
            return (y, y, y)
        a, b = no_longer_than(MOST[name], tuple(component / y for component in p))
        most = WHITE_L[name]
        c = color_of_tristimulus(xyz_of_lab((most, most * a, most * b)))
        return scaled(y / luminance(c), c)

    return chroma_of, color_of


#: By name: p of a colour, and the colour of a luminance and p.
SPACES = {
    "xyz": (chroma_of_xyz, color_of_xyz),
    "hsl": (chroma_of_hsl, color_of_hsl),
    "oklab": uniform("oklab", oklab_of_xyz, xyz_of_oklab),
    "cielab": uniform("cielab", cielab_of_xyz, xyz_of_cielab),
}

#: Those in which (+) may leave the gamut.
OPEN = ("hsl", "oklab", "cielab")


#: By how many luminances curves of one hue go below black and above white before they end inside.
SLACK = {"hsl": (0, 0), "oklab": (0.01, 0), "cielab": (0, 0.035)}


def within(space, y, p, lo, hi):
    """The colour of y and p with its channels in [lo, hi].

    It is that of t·p with the largest t in [0, 1] up to which all are in that range and the slack;
    from there it goes straight towards its grey.
    """
    _, color_of = SPACES[space]
    lo, hi = min(lo, y), max(hi, y)  # of a grey, y may round to them or beyond them
    below, above = SLACK[space]

    def fits(t):
        color = color_of(y, scaled(t, p))
        return all(lo - below * y <= channel <= hi + above * y for channel in color)

    inside, outside = (1, 1) if fits(1) else (0, 1)
    for _ in range(60 if inside < outside else 0):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if fits(middle) else (inside, middle)
    return straight_within(y, color_of(y, scaled(inside, p)), lo, hi)


def straight_within(y, c, lo, hi):
    """c, of luminance y, on the straight way to its grey as far as its channels are in [lo, hi]."""
    t = 1.0
    for channel in c:
        if channel > hi:
            t = min(t, (hi - y) / (channel - y))
        if channel < lo:
            t = min(t, (y - lo) / (y - channel))
    return tuple(y + t * (channel - y) for channel in c)


def disguised(space, c):
    """The colour of linear RGB that ⊕ takes for c in that space; greys are greys exactly."""
    if c[0] == c[1] == c[2]:
        return c
    chroma_of, _ = SPACES[space]
    p = chroma_of(c)
    return color(luminance(c), in_plane(p))


def undisguised(c):
    """The luminance and p of the colour whose disguise is c."""
    d = difference(c)
    p = tuple(sum(a * b for a, b in zip(d, axis, strict=True)) for axis in (AXIS_1, AXIS_2))
    return luminance(c), p


def in_plane(p):
    """The difference vector of p."""
    return added(scaled(p[0], AXIS_1), scaled(p[1], AXIS_2))


def revealed(space, c):
    """The colour whose disguise is c."""
    _, color_of = SPACES[space]
    return color_of(*undisguised(c))


# --- Algorithm 1 --------------------------------------------------------------------------------


def equal_hue(c1, c2):
    """Whether one difference vector is a positive multiple of the other; a grey is of any hue."""
    return angle(difference(c1), difference(c2)) <= ROUNDING_ANGLE


def opposite_color(c1, c2):
    """The colour opposite to c1, with the luminance and saturation of c2."""
    d1, d2 = difference(c1), difference(c2)
    return color(luminance(c2), scaled(-length(d2), unit(d1)))


def opposite_hue(c1, c2):
    """Whether two colours on one line through the grey axis lie on different sides of it.

    All that Algorithm 1 asks of its tentative colour; unlike `equal_hue` it is sure near grey,
    where the direction is rounding.
    """
    return angle(difference(c1), difference(c2)) > math.pi / 2


def add_different_hues(c1, c2):
    """The else branch of Algorithm 1: c1 is tried as the dominant colour first."""
    if length(difference(c1)) == 0 or length(difference(c2)) == 0:
        return added(c1, c2)
    c_new = added(c1, opposite_color(c1, c2))
    if opposite_hue(c1, c_new):
        c_new = added(opposite_color(c2, c1), c2)
    return c_new


def algorithm_1(c1, c2):
    """c1 ⊕ c2 as the paper has it."""
    if equal_hue(c1, c2):
        return added(c1, c2)
    return add_different_hues(c1, c2)


def shoulder(theta, hue_tolerance):
    """How equal two hues `theta` radians apart count, 1 to 0; the tolerance is in degrees."""
    if hue_tolerance == 0:
        return 1.0 if theta <= ROUNDING_ANGLE else 0.0
    tau = math.radians(hue_tolerance)
    if theta <= tau:
        return 1.0
    if theta >= 2 * tau:
        return 0.0
    t = (2 * tau - theta) / tau
    return t * t * (3 - 2 * t)


def add_biased(c1, c2, gray_bias):
    """Two colours of different hue: of the stronger one remains 1 − (small/big)^(1 + 3b)."""
    d_big, d_small = sorted((difference(c1), difference(c2)), key=length, reverse=True)
    if length(d_small) == 0:
        return added(c1, c2)
    cancelled = math.pow(length(d_small) / length(d_big), 1 + 3 * gray_bias)
    return color(luminance(c1) + luminance(c2), scaled(1 - cancelled, d_big))


def hue_add(c1, c2, hue_tolerance=2.0, gray_bias=0.0):
    """c1 ⊕ c2 with a tolerance in degrees and a bias against grey."""
    different = add_biased(c1, c2, gray_bias) if gray_bias else add_different_hues(c1, c2)
    if hue_tolerance == 0:
        return added(c1, c2) if equal_hue(c1, c2) else different
    e = shoulder(angle(difference(c1), difference(c2)), hue_tolerance)
    return added(scaled(e, added(c1, c2)), scaled(1 - e, different))


def simultaneous(terms, hue_tolerance=2.0, gray_bias=0.0):
    """All terms at once: each is scaled by its strongest rival of another hue.

    A fourth component is a strength, that of the result comes back with it; without one |p| is it.
    """
    y = math.fsum(luminance(c) for c in terms)
    colored = [c for c in terms if length(difference(c[:3])) > 0]
    p = [difference(c[:3]) for c in colored]
    strengths = [c[3:] for c in colored]
    n = len(p)
    m = [of_term[0] for of_term in strengths if of_term]
    if not any(m):
        m = [length(v) for v in p]
    e = [[shoulder(angle(p[i], p[j]), hue_tolerance) for j in range(n)] for i in range(n)]
    backers = [[k for k in range(n) if e[i][k] > 0] for i in range(n)]
    total = (0.0,) * max(map(len, terms))
    for i in range(n):
        strongest = 0.0
        for j in range(n):
            if j == i:
                continue
            support_i = sum(e[i][k] * m[k] * (1 - e[j][k]) for k in backers[i])
            support_j = sum(e[j][k] * m[k] * (1 - e[i][k]) for k in backers[j])
            # What j's own hue can hold at most. It vanishes with m_j and counts no terms: n·m_j
            # would let a term of no chroma change the others by changing n.
            cap = sum(min(m[j], m[k]) for k in range(n))
            rival = min(support_j, cap)
            # Of two that have none it is no rival, beside some it takes all that has none.
            if rival == 0:
                q = 0.0
            elif rival >= support_i:
                q = 1.0
            else:
                q = rival / support_i
            strongest = max(strongest, (1 - e[i][j]) * math.pow(q, 1 + 3 * gray_bias))
        total = added(total, scaled(1 - strongest, p[i] + strengths[i]))
    return (*color(y, total), *total[3:])


# --- strength -----------------------------------------------------------------------------------
#
# Who wins need not be who has most |p|: a term may carry a strength m as its fourth component, which
# is scaled and added as the others are.

#: The Oklab chroma of a colour that is half as strong as it covers.
HALF_STRENGTH = 0.04

#: By name: the strength of a layer of that alpha whose straight colour has that Oklab chroma.
STRENGTHS = {
    "perceived": lambda alpha, chroma: alpha * chroma,
    "coverage": lambda alpha, chroma: alpha * chroma / (chroma + HALF_STRENGTH),
}


def oklab_chroma(c):
    return math.hypot(*oklab_of_xyz(xyz_of_color(c))[1:])


def strength_of(name, c, alpha):
    """The strength of a premultiplied colour at weight 1; greys and light at alpha 0 have none."""
    if alpha == 0 or c[0] == c[1] == c[2]:
        return 0.0
    # C of c/alpha; Oklab is of degree 1/3, and 1/alpha may not be a number.
    return STRENGTHS[name](alpha, oklab_chroma(c) / math.cbrt(alpha))


def with_strength(c, m):
    """A colour and its strength as one term; without p there is none."""
    return (*c, m if length(difference(c)) > 0 else 0.0)


def add_by_strength(c1, c2, hue_tolerance=2.0, gray_bias=0.0):
    """(R, G, B, m) of two terms (R, G, B, m): ⊕ where the greater m wins, or |p| where neither has any."""
    d1, d2 = difference(c1[:3]), difference(c2[:3])
    e = shoulder(angle(d1, d2), hue_tolerance)  # 1 where one is grey
    strength_1, strength_2 = (c1[3], c2[3]) if c1[3] or c2[3] else (length(d1), length(d2))
    first_wins = strength_1 >= strength_2
    big, small = (strength_1, strength_2) if first_wins else (strength_2, strength_1)
    winner, d = (c1, d1) if first_wins else (c2, d2)
    kept = 1 - math.pow(small / big, 1 + 3 * gray_bias) if big else 0.0
    different = (
        *color(luminance(c1) + luminance(c2), scaled(kept, d)),
        kept * winner[3],
    )
    return added(scaled(e, added(c1, c2)), scaled(1 - e, different))


# --- operators and stacks -----------------------------------------------------------------------


def factors(op, alpha_a, alpha_b):
    """(F_A, F_B) of an operator; A is the layer, B the stack below it."""
    if op == "clear":
        return 0.0, 0.0
    if op in ("src", "copy"):
        return 1.0, 0.0
    if op == "dst":
        return 0.0, 1.0
    if op in ("over", "src-over"):
        return 1.0, 1 - alpha_a
    if op in ("dst-over", "under"):
        return 1 - alpha_b, 1.0
    if op in ("in", "src-in"):
        return alpha_b, 0.0
    if op in ("dst-in", "mask"):
        return 0.0, alpha_a
    if op in ("out", "src-out"):
        return 1 - alpha_b, 0.0
    if op in ("dst-out", "stencil"):
        return 0.0, 1 - alpha_a
    if op in ("atop", "src-atop"):
        return alpha_b, 1 - alpha_a
    if op == "dst-atop":
        return 1 - alpha_b, alpha_a
    if op == "xor":
        return 1 - alpha_b, 1 - alpha_a
    if op in ("plus", "add", "lighter"):
        return 1.0, 1.0
    raise ValueError(op)


def alpha_of(op, alpha_a, alpha_b):
    f_a, f_b = factors(op, alpha_a, alpha_b)
    return min(1.0, f_a * alpha_a + f_b * alpha_b)


def as_read(layers, opacities):
    """The layers with alpha clamped to [0, 1], colour not, both scaled by the opacity."""
    result = []
    for layer, opacity in zip(layers, opacities, strict=True):
        c = tuple(float(component) for component in layer[:3])
        alpha = min(1.0, max(0.0, float(layer[3])))
        result.append((scaled(opacity, c), opacity * alpha))
    return result


def weights(alphas, ops):
    """(w, alpha): w_i of the term w_i c_i of each layer, and the alpha of the stack."""
    f_a, f_b = [1.0], [0.0]
    alpha = alphas[0]
    for i in range(1, len(alphas)):
        a, b = factors(ops[i], alphas[i], alpha)
        f_a.append(a)
        f_b.append(b)
        alpha = alpha_of(ops[i], alphas[i], alpha)
    w = []
    for i in range(len(alphas)):
        weight = f_a[i]
        for j in range(i + 1, len(alphas)):
            weight *= f_b[j]
        w.append(weight)
    return w, alpha


def foremost(terms, ops):
    """The chroma of the term in front that has any, the luminances of all; ops[0] is not looked at.

    Terms bottom first. `dst-over` and `dst-atop` put theirs behind all others.
    """
    from_front = []
    for i, term in enumerate(terms):
        if i > 0 and ops[i] in ("dst-over", "under", "dst-atop"):
            from_front.append(term)
        else:
            from_front.insert(0, term)
    y = math.fsum(luminance(term) for term in terms)
    for term in from_front:
        if length(difference(term)) > 0:
            return color(y, difference(term))
    return color(y, (0.0, 0.0, 0.0))


def plus(c1, c2, hue_tolerance):
    return added(c1, c2)


def fold(add, terms, hue_tolerance):
    result = terms[0]
    for term in terms[1:]:
        result = add(result, term, hue_tolerance)
    return result


def balanced(add, terms, hue_tolerance):
    """A tree of pairs of neighbours, from the bottom; the odd one goes up as it is."""
    while len(terms) > 1:
        level = []
        for i in range(0, len(terms) - 1, 2):
            level.append(add(terms[i], terms[i + 1], hue_tolerance))
        if len(terms) % 2 == 1:
            level.append(terms[-1])
        terms = level
    return terms[0]


def composite(
    layers,
    ops=None,
    opacities=None,
    blending="hue-preserving",
    order="bottom-up",
    hue_tolerance=2.0,
    gray_bias=0.0,
    background=None,
    strengths=None,
):
    """(R, G, B, alpha) of a stack, bottom first; ops[0] is not looked at.

    `bottom-up` nests the operators as they are read, c ← F_A c_i ⊕ F_B c; the other orders reduce
    the weighted terms. `order` is a name or a sequence of layer numbers; `foremost` has none.
    `strengths`: of the layers and then of the background, at weight 1, for ⊕; None for |p|.
    """
    n = len(layers)
    ops = ["over"] * n if ops is None else ops
    read = as_read(layers, [1.0] * n if opacities is None else opacities)
    if blending == "hue-preserving" and strengths is not None:
        *of_layers, of_background = strengths
        read = [
            (with_strength(c, m), alpha) for (c, alpha), m in zip(read, of_layers, strict=True)
        ]
        if background is not None:
            background = with_strength(background, of_background)

        def add(c1, c2, hue_tolerance):
            return add_by_strength(c1, c2, hue_tolerance, gray_bias)

    elif blending == "hue-preserving":

        def add(c1, c2, hue_tolerance):
            return hue_add(c1, c2, hue_tolerance, gray_bias)

    elif blending == "traditional":
        add = plus
    elif blending == "foremost":
        w, alpha = weights([alpha_i for _, alpha_i in read], ops)
        terms = [scaled(w[i], read[i][0]) for i in range(n)]
        if background is not None:
            terms.append(scaled(1 - alpha, background))
            ops = [*ops, "dst-over"]
            alpha = alpha + (1 - alpha)
        return (*foremost(terms, ops), alpha)
    else:
        raise ValueError(blending)
    if order == "bottom-up":
        c, alpha = read[0]
        for i in range(1, n):
            c_i, alpha_i = read[i]
            f_a, f_b = factors(ops[i], alpha_i, alpha)
            c = add(scaled(f_a, c_i), scaled(f_b, c), hue_tolerance)
            alpha = alpha_of(ops[i], alpha_i, alpha)
    else:
        w, alpha = weights([alpha_i for _, alpha_i in read], ops)
        terms = [scaled(w[i], read[i][0]) for i in range(n)]
        if order == "top-down":
            c = fold(add, terms[::-1], hue_tolerance)
        elif order == "balanced":
            c = balanced(add, terms, hue_tolerance)
        elif order == "simultaneous" and blending == "traditional":
            c = fold(plus, terms, hue_tolerance)
        elif order == "simultaneous":
            c = simultaneous(terms, hue_tolerance, gray_bias)
        elif not isinstance(order, str) and sorted(order) == list(range(n)):
            c = fold(add, [terms[i] for i in order], hue_tolerance)
        else:
            raise ValueError(order)
    if background is not None:
        c = add(c, scaled(1 - alpha, background), hue_tolerance)
        alpha = alpha + (1 - alpha)
    return (*c[:3], alpha)


def weighted_terms(layers, ops=None, opacities=None, background=None):
    """(w, terms, alpha): the weights of (colour, alpha) of the layers, the background being the last."""
    n = len(layers)
    terms = as_read(layers, [1.0] * n if opacities is None else opacities)
    w, alpha = weights([alpha_i for _, alpha_i in terms], ["over"] * n if ops is None else ops)
    if background is not None:
        terms.append((tuple(background), 1.0))
        w.append(1 - alpha)
        alpha = 1.0
    return w, terms, alpha


def composite_in(space, layers, background=None, strength="chroma", **job):
    """`composite` in any space and by any strength; + is the same in all."""
    job = {"layers": layers, "background": background, **job}
    if job.get("blending") == "traditional":
        return composite(**job)
    stack = {name: job.get(name) for name in ("layers", "ops", "opacities", "background")}
    w, terms, _ = weighted_terms(**stack)
    if strength != "chroma":
        strengths = [strength_of(strength, *term) for term in terms]
        job["strengths"] = strengths if background is not None else [*strengths, 0.0]
    if space == "linear-rgb":
        return composite(**job)
    job["layers"] = [(*disguised(space, layer[:3]), layer[3]) for layer in layers]
    job["background"] = None if background is None else disguised(space, background)
    result = composite(**job)
    c = revealed(space, result[:3])
    if space in OPEN:
        y, p = undisguised(result[:3])
        c = of_terms(space, y, p, w, terms)
    return (*c, result[3])


def bounds(w, terms):
    """(lo, hi): between what channels a stack of these terms stays."""
    lo = sum(w_i * min(0, *c_i) for w_i, (c_i, _) in zip(w, terms, strict=True))
    hi = sum(w_i * max(a_i, *c_i) for w_i, (c_i, a_i) in zip(w, terms, strict=True))
    return lo, hi


def of_terms(space, y, p, w, terms):
    """The colour of y and p, in an open space, that a stack of these terms may have."""
    c = within(space, y, p, *bounds(w, terms))
    # Where (+) did nothing but +, the colour is the sum of colours.
    plain = color(0, (0.0, 0.0, 0.0))
    for w_i, (c_i, _) in zip(w, terms, strict=True):
        plain = added(plain, scaled(w_i, c_i))
    of_plain = undisguised(disguised(space, plain))[1]
    room = 4e-15 * (abs(y) + max(map(abs, p)))
    if all(abs(a - b) <= room for a, b in zip(p, of_plain, strict=True)):
        c = plain
    return c


# --- woven --------------------------------------------------------------------------------------


def stripes(x, y, size):
    """u of a pixel, in [0, 1): a sawtooth across the diagonals, each tooth shifted by the golden ratio."""
    diagonal = x + y
    shift = 0.618034 * (diagonal // size) + 0.5
    return (diagonal % size + shift - math.floor(shift)) / size


def noise(x, y, size, tile):
    """u of a pixel, in (0, 1): ranks of a square tile, each for size×size pixels."""
    n = len(tile)
    return (tile[(y // size) % n][(x // size) % n] + 0.5) / n**2


class Woven(NamedTuple):
    """A woven pixel, and what a test has to know of it."""

    rgba: tuple
    #: How far u is from where another hue begins, as a share; 0 where rounding decides on hues.
    margin: float
    #: By how much roundings of the chosen term's colour are enlarged, in units of the result.
    gain: float


class Thread(NamedTuple):
    """Sorted by the angle of p, equal ones by the layer's number."""

    angle: float
    number: int
    p: tuple
    m: float
    size: float


def plane_angle(p1, p2):
    return angle((*p1, 0.0), (*p2, 0.0))


def woven(space, layers, u, ops=None, opacities=None, background=None, strength="chroma"):
    """The pixel of a woven stack where the pattern is u."""
    w, terms, alpha = weighted_terms(layers, ops, opacities, background)
    y = math.fsum(w_i * luminance(c) for w_i, (c, _) in zip(w, terms, strict=True))  # [R1]
    colored = []
    for number, (w_i, (c, alpha_i)) in enumerate(zip(w, terms, strict=True)):
        p = scaled(w_i, weaving_chroma(space, c))
        if any(p):
            m = math.hypot(*p) if strength == "chroma" else w_i * strength_of(strength, c, alpha_i)
            size = w_i * max(map(abs, c))
            colored.append(Thread(math.atan2(p[1], p[0]), number, p, m, size))
    if not any(term.m for term in colored):
        colored = [term._replace(m=math.hypot(*term.p)) for term in colored]
    threads = sorted(term for term in colored if term.m > 0)
    if not threads:
        return Woven((*woven_color(space, y, (0.0, 0.0), w, terms), alpha), 1.0, 1.0)

    whole = math.fsum(thread.m for thread in threads)
    reached = 0.0
    for chosen in threads:
        reached += chosen.m
        if reached > u * whole:
            break

    own = [term for term in colored if plane_angle(term.p, chosen.p) <= ROUNDING_ANGLE]
    share = math.fsum(term.m for term in own) / whole
    if len(own) == len(colored):
        p = tuple(math.fsum(axis) for axis in zip(*(term.p for term in own), strict=True))
    else:
        wanted = math.fsum(math.hypot(*term.p) for term in own) / share
        p = tuple(wanted * axis for axis in scaled(1 / math.hypot(*chosen.p), chosen.p))  # [R2]
    c = woven_color(space, y, p, w, terms)
    gain = max(term.size / math.hypot(*term.p) for term in own) / share
    return Woven((*c, alpha), margin_of(threads, colored, u), gain)


def weaving_chroma(space, c):
    if space in SPACES:
        return (0.0, 0.0) if c[0] == c[1] == c[2] else SPACES[space][0](c)
    return undisguised(c)[1]


def woven_color(space, y, p, w, terms):
    """The colour of y and p, p as long as the bounds let it be."""
    if space in OPEN:
        return of_terms(space, y, p, w, terms)
    c = color_of_xyz(y, p) if space == "xyz" else color(y, in_plane(p))
    lo, hi = bounds(w, terms)
    return straight_within(y, c, min(lo, y), max(hi, y))


#: Of single precision, with room for a few operations; seen from a small p it is an angle.
SINGLE = 1e-6


def margin_of(threads, colored, u):
    """How far u is from the next boundary between two hues, 0 where single precision decides on them."""
    whole = math.fsum(thread.m for thread in threads)
    if any(term.m < 1e-3 * whole and term.m <= SINGLE for term in colored) and len(threads) < len(
        colored
    ):
        return 0.0  # a little strength beside none
    for i, one in enumerate(colored):
        unsure = SINGLE * one.size / math.hypot(*one.p)
        if math.pi - abs(one.angle) <= unsure + ROUNDING_ANGLE and len(colored) > 1:
            return 0.0  # the first or the last
        for other in colored[:i]:
            theta = plane_angle(one.p, other.p)
            both = unsure + SINGLE * other.size / math.hypot(*other.p)
            if theta + both > ROUNDING_ANGLE / 2 and theta - both < 2 * ROUNDING_ANGLE:
                return 0.0
    reached, margin = 0.0, 1.0
    for before, after in itertools.pairwise(threads):
        reached += before.m
        if plane_angle(before.p, after.p) > ROUNDING_ANGLE:
            margin = min(margin, abs(reached / whole - u))
    return margin
