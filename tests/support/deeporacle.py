"""A second opinion on deep samples, scalar and literal, in doubles; no hpcomp and no numpy.

Samples are (R, G, B, alpha, front, back), linear and premultiplied, as in OpenEXR's document
"Interpreting OpenEXR Deep Pixels", which this is written to be held beside: split until nothing
partly overlaps, merge what coincides, sort, composite. Colours are added as `oracle` adds them.
"""

import itertools
import math

import oracle

INFINITY = math.inf


def alpha_of_share(alpha, x):
    """alpha(z) of a volume, where x is the share of its length up to z."""
    if x <= 0:
        return 0.0
    if alpha >= 1:
        return 1.0
    return -math.expm1(x * math.log1p(-alpha))


def color_of_share(c, alpha, x):
    """c(z) of a volume: c · alpha(z) / alpha, and its limit where alpha is 0."""
    if x <= 0:
        return 0.0
    if alpha > 0:
        return c * alpha_of_share(alpha, x) / alpha
    return c * x


def share(sample, near, far):
    """What share of its length a volume has from near to far."""
    front, back = sample[4:]
    return (far - near) / (back - front)


def part(sample, near, far):
    """The part of a volume from near to far."""
    x = share(sample, near, far)
    alpha = sample[3]
    colors = tuple(color_of_share(c, alpha, x) for c in sample[:3])
    return (*colors, alpha_of_share(alpha, x), near, far)


def is_volume(sample):
    return sample[5] > sample[4]


def split(samples):
    """(number, piece) of samples: volumes split at every depth where a sample begins or ends inside them."""
    marks = sorted({depth for s in samples for depth in (s[4], max(s[4], s[5]))})
    found = []
    for number, sample in enumerate(samples):
        if not is_volume(sample):
            found.append((number, (*sample[:4], sample[4], sample[4])))
            continue
        inside = [z for z in marks if sample[4] <= z <= sample[5]]
        for near, far in itertools.pairwise(inside):
            found.append((number, part(sample, near, far)))
    return found


def merge_weights(samples):
    """What the colours of coincident samples are scaled by before they are added, and the alpha.

    The document's pair of formulas, for any number of samples: w (c_i v_i + c_j v_j) with
    v = u / alpha, u = -log(1 - alpha) and w = alpha_new / (u_i + u_j); the mean of opaque ones.
    """
    opaque = [s[3] >= 1 for s in samples]
    if any(opaque):
        return [o / sum(opaque) for o in opaque], 1.0
    u = [-math.log1p(-s[3]) for s in samples]
    v = [u_k / s[3] if s[3] > 0 else 1.0 for u_k, s in zip(u, samples, strict=True)]
    alpha = -math.expm1(-sum(u))
    w = alpha / sum(u) if sum(u) != 0 else 1.0
    return [w * v_k for v_k in v], alpha


def weighted(samples):
    """Coincident samples (R, G, B, alpha) scaled so that their merged sample is what they add up to."""
    weights, alpha = merge_weights(samples)
    return [oracle.scaled(w, s[:4]) for w, s in zip(weights, samples, strict=True)], alpha


def by_place(samples):
    """The pieces of samples in lists of those that coincide, from the front: (numbers, pieces)."""
    places = {}
    for number, piece in split(samples):
        places.setdefault(piece[4:], []).append((number, piece))
    return [zip(*together, strict=True) for _, together in sorted(places.items())]


def tidy(samples, add_all):
    """Sorted and apart, front first: (R, G, B, alpha) each; `add_all` adds coincident ones' colours."""
    found = []
    for _, together in by_place(samples):
        terms, alpha = weighted(together)
        found.append((*(terms[0][:3] if len(terms) == 1 else add_all(terms)), alpha))
    return found


def plain_sum(terms):
    total = (0.0, 0.0, 0.0)
    for term in terms:
        total = oracle.added(total, term[:3])
    return total


def clamped(samples):
    return [(*s[:3], min(max(s[3], 0.0), 1.0), *s[4:]) for s in samples]


def seen(samples):
    """(R, G, B, alpha) of what is seen of each sample, all its pieces together."""
    samples = clamped(samples)
    totals = [(0.0,) * 4 for _ in samples]
    transmittance = 1.0
    for numbers, together in by_place(samples):
        terms, alpha = weighted(together)
        for number, term in zip(numbers, terms, strict=True):
            totals[number] = oracle.added(totals[number], oracle.scaled(transmittance, term))
        transmittance *= 1 - alpha
    return totals


def woven(samples, u, background=None, strength="chroma"):
    """The woven pixel, as `oracle.woven` gives it: its terms are the samples, as far as they are seen."""
    terms = seen(samples) or [(0.0,) * 4]
    return oracle.woven(
        "linear-rgb", terms, u, ["plus"] * len(terms), background=background, strength=strength
    )


def flat(
    samples, blending="hue-preserving", order="bottom-up", hue_tolerance=2.0, strength="chroma"
):
    """(R, G, B, alpha) of one pixel. A merged sample is as strong as its own colour and alpha are."""
    samples = clamped(samples)

    def add_all(terms):
        if blending == "traditional":
            return plain_sum(terms)
        if strength == "chroma":
            return oracle.simultaneous([term[:3] for term in terms], hue_tolerance)
        strong = [
            oracle.with_strength(term[:3], oracle.strength_of(strength, term[:3], term[3]))
            for term in terms
        ]
        return oracle.simultaneous(strong, hue_tolerance)[:3]

    layers = []
    for sample in tidy(samples, add_all):
        layers.append(sample)
        if sample[3] >= 1:
            break  # what is behind cannot be seen
    if not layers:
        return (0.0, 0.0, 0.0, 0.0)
    layers = layers[::-1]
    n = len(layers)
    return oracle.composite_in(
        "linear-rgb", layers, strength=strength, ops=[None] + ["over"] * (n - 1),
        blending=blending, order=order, hue_tolerance=hue_tolerance,
    )  # fmt: skip
