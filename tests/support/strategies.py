"""What Hypothesis draws for the tests of the mathematics: colours, pairs, stacks; asserts nothing.

Everything is drawn as plain floats, so that a failing example can be pasted into a test.
"""

import math

import oracle
from hypothesis import strategies as st

OPERATOR_NAMES = (
    "clear",
    "src",
    "dst",
    "over",
    "dst-over",
    "in",
    "dst-in",
    "out",
    "dst-out",
    "atop",
    "dst-atop",
    "xor",
    "plus",
)
BLENDING_NAMES = ("hue-preserving", "traditional", "foremost")
ORDER_NAMES = ("bottom-up", "top-down", "balanced", "simultaneous")
SPACE_NAMES = ("linear-rgb", *oracle.SPACES)
STRENGTH_NAMES = ("chroma", *oracle.STRENGTHS)
WEAVE_NAMES = ("stripes", "noise")

#: The default, the paper's 0, and one to either side.
HUE_TOLERANCES = (2.0, 0.0, 0.5, 10.0)

#: The paper's 0, a little, and the most.
GRAY_BIASES = (0.0, 0.3, 1.0)

# Two axes at right angles in the plane of the difference vectors, the first towards red.
_RED_AXIS = oracle.unit(oracle.difference((1.0, 0.0, 0.0)))
_NORMAL = oracle.unit(oracle.WEIGHTS)
_SIDE_AXIS = (
    _NORMAL[1] * _RED_AXIS[2] - _NORMAL[2] * _RED_AXIS[1],
    _NORMAL[2] * _RED_AXIS[0] - _NORMAL[0] * _RED_AXIS[2],
    _NORMAL[0] * _RED_AXIS[1] - _NORMAL[1] * _RED_AXIS[0],
)


def hue_direction(hue_deg):
    """The unit difference vector of a hue; 0° is red's."""
    angle = math.radians(hue_deg)
    return oracle.added(
        oracle.scaled(math.cos(angle), _RED_AXIS), oracle.scaled(math.sin(angle), _SIDE_AXIS)
    )


def color_of(hue_deg, chroma, luminance):
    """The linear colour with that hue, |p| and Y, inside the gamut or not."""
    return oracle.color(luminance, oracle.scaled(chroma, hue_direction(hue_deg)))


def valid_color(hue_deg, saturation, luminance, alpha=1.0):
    """A premultiplied colour in gamut; saturation and luminance are shares of what alpha allows."""
    direction = hue_direction(hue_deg)
    most = min(
        (1 - luminance) / part if part > 0 else luminance / -part for part in direction if part
    )
    c = oracle.color(luminance, oracle.scaled(saturation * most, direction))
    return tuple(alpha * min(1.0, max(0.0, component)) for component in c)


shares = st.one_of(st.sampled_from((0.0, 1.0, 0.5)), st.floats(0, 1))
alphas = st.one_of(st.sampled_from((0.0, 1.0, 1 / 255)), st.floats(0, 1))
hues = st.floats(0, 360)
hue_tolerances = st.sampled_from(HUE_TOLERANCES)
gray_biases = st.one_of(st.sampled_from(GRAY_BIASES), st.floats(0, 1))
orders = st.sampled_from(ORDER_NAMES)
operators = st.sampled_from(OPERATOR_NAMES)


@st.composite
def valid_colors(draw, alpha=None):
    """(R, G, B, alpha), 0 ≤ c ≤ alpha: corners, greys, 8-bit colours, anything."""
    alpha = draw(alphas) if alpha is None else alpha
    straight = draw(
        st.one_of(
            st.tuples(*[st.sampled_from((0.0, 1.0))] * 3),
            shares.map(lambda grey: (grey,) * 3),
            st.tuples(*[st.integers(0, 255).map(lambda code: code / 255)] * 3),
            st.tuples(shares, shares, shares),
            st.builds(valid_color, hues, shares, st.floats(0.05, 0.95)),
        )
    )
    return (*oracle.scaled(alpha, straight), alpha)


@st.composite
def hue_offsets(draw, hue_tolerance):
    """Degrees from one hue to another: equal, in and around the shoulder, opposite, anywhere."""
    tau = hue_tolerance or math.degrees(oracle.ROUNDING_ANGLE)
    return draw(
        st.one_of(
            st.sampled_from((0.0, 0.8 * tau, 3 * tau, 180.0, 120.0)),
            # Not a hair from the ends, where at tolerance 0 rounding alone decides.
            st.floats(1.001 * tau, 1.999 * tau),
            st.floats(3 * tau, 360 - 3 * tau),
        )
    ) * draw(st.sampled_from((1, -1)))


@st.composite
def valid_pairs(draw, hue_tolerance=2.0):
    """Two of `valid_colors`, every other time with hues that have to do with each other."""
    if draw(st.booleans()):
        return draw(valid_colors()), draw(valid_colors())
    hue = draw(hues)
    hue_2 = hue + draw(hue_offsets(hue_tolerance))
    pair = []
    for h in (hue, hue_2):
        alpha = draw(alphas)
        c = valid_color(h, draw(shares), draw(st.floats(0.05, 0.95)), alpha)
        pair.append((*c, alpha))
    return tuple(pair)


#: Scene-linear layers: bright, a little negative, glow at alpha 0.
hdr_layers = st.tuples(*[st.one_of(st.floats(-1, 1), st.floats(-100, 1e4))] * 3, alphas)
any_pairs = st.one_of(valid_pairs(), st.tuples(hdr_layers, hdr_layers))


@st.composite
def stacks(draw, hue_tolerance=2.0, min_size=1, max_size=6, hdr=True):
    """Layers, bottom first: unrelated ones, or labels whose hues are near one another."""
    size = draw(st.integers(min_size, max_size))
    kind = draw(st.sampled_from(("any", "labels", "hdr") if hdr else ("any", "labels")))
    if kind == "any":
        return [draw(valid_colors()) for _ in range(size)]
    if kind == "hdr":
        return [draw(hdr_layers) for _ in range(size)]
    hue = draw(hues)
    layers = []
    for _ in range(size):
        alpha = draw(alphas)
        c = valid_color(hue, draw(shares), draw(st.floats(0.05, 0.95)), alpha)
        layers.append((*c, alpha))
        hue += draw(hue_offsets(hue_tolerance))
    return layers


@st.composite
def jobs(draw, tolerances=hue_tolerances, hdr=True):
    """Arguments of `oracle.composite`: a stack and everything that can be asked of it."""
    hue_tolerance = draw(tolerances)
    layers = draw(stacks(hue_tolerance, hdr=hdr))
    n = len(layers)
    return {
        "layers": layers,
        "ops": [None, *(draw(operators) for _ in range(n - 1))],
        "opacities": [draw(alphas) for _ in range(n)] if draw(st.booleans()) else [1.0] * n,
        "blending": draw(st.sampled_from(BLENDING_NAMES)),
        "order": draw(st.one_of(orders, st.permutations(range(n)))),
        "hue_tolerance": hue_tolerance,
        "gray_bias": draw(st.sampled_from(GRAY_BIASES)),
        "background": draw(st.one_of(st.none(), st.tuples(shares, shares, shares))),
    }


def rules_of(job):
    """What is asked of the stack of a job, by the names of `hpcomp.composite`."""
    names = {"ops": "op", "opacities": "opacity"}
    return {names.get(name, name): value for name, value in job.items() if name != "layers"}


def is_decided(layers, ops, opacities=None, blending="foremost", background=None, **more):
    """Whether rounding cannot decide who is foremost: no term has next to no chroma.

    Nor does one that 1 − α_B keeps out: α_B of 1 is a little less in another precision.
    """
    if blending != "foremost":
        return True
    read = oracle.as_read(layers, opacities or [1.0] * len(layers))
    w, alpha = oracle.weights([a for _, a in read], ops)
    terms = [oracle.scaled(w_i, c) for w_i, (c, _) in zip(w, read, strict=True)]
    if background is not None:
        terms.append(oracle.scaled(1 - alpha, background))
    below = 0.0
    for op, (_, alpha_layer) in zip(ops, read, strict=True):
        if op == "xor" and below > 1 - 1e-6:
            return False
        below = alpha_layer if op is None else oracle.alpha_of(op, alpha_layer, below)
    chromas = [oracle.length(oracle.difference(term)) for term in terms]
    return all(chroma == 0 or chroma > 1e-5 for chroma in chromas)
