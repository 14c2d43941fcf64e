"""Figures that the pages state, measured again."""

import itertools
import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from engines import composite_by
from pngfile import srgb_to_linear

import hpcomp
from hpcomp.color.planes import cross_and_dot, length
from hpcomp.color.spaces import SPACES

MAN = Path(__file__).parents[2] / "man"

#: Palettes of matplotlib that label classes.
PALETTES = ("Set1", "Set2", "Set3", "Dark2", "Paired", "Accent", "Pastel1", "tab10", "tab20")
FIRST_OF_PALETTE, PIXELS = 7, 2000


def said(page, pattern):
    """The figures in the words of a page that fit the pattern, as numbers."""
    text = " ".join((MAN / f"{page}.md").read_text(encoding="utf-8").split())
    (found,) = re.findall(pattern, text)
    return [float(number) for number in ([found] if isinstance(found, str) else found)]


def angle(p1, p2):
    return np.degrees(np.arctan2(*cross_and_dot(p1, p2)))


def test_how_often_the_colour_that_survives_is_not_the_nearer_to_ordinary_blending():
    shares = said(
        "hpcomp-blending.7", r"(\d+)% of random pairs in hsl, (\d+)% in oklab and (\d+)% in cielab"
    )
    c1, c2 = np.random.default_rng(1).random((2, 3, 400_000))
    for name, space in SPACES.items():
        p1, p2, plain = (space.forward(c)[1] for c in (c1, c2, c1 + c2))
        another_hue = angle(p1, p2) > 4
        nearer = angle(p1, plain) <= angle(p2, plain)
        share = np.mean(((length(p1) >= length(p2)) != nearer)[another_hue])
        expected = dict(zip(("hsl", "oklab", "cielab"), shares, strict=True)).get(name, 0)
        assert 100 * share == pytest.approx(expected, abs=0.6 if expected else 1e-3), name


def foreign_share(colors, alphas):
    layers = [
        np.concatenate([alpha * color, alpha], axis=-1)[None].astype(np.float32)
        for alpha, color in zip(alphas, colors, strict=True)
    ]
    return hpcomp.stack_measures(layers).traditional.foreign_share


def test_the_foreign_share_of_traditional_blending():
    low, high, least, most = said(
        "hpcomp-reports.7",
        r"scores (\d+) to (\d+)% on average of the triples of a palette, and (\d+) to (\d+)% for",
    )
    random = np.random.default_rng(1)
    alphas = random.random((3, PIXELS, 1))
    means, every = [], []
    for name in PALETTES:
        colors = srgb_to_linear(np.array(matplotlib.colormaps[name].colors[:FIRST_OF_PALETTE]))
        shares = [foreign_share(three, alphas) for three in itertools.combinations(colors, 3)]
        means.append(100 * np.mean(shares))
        every += shares
    assert low - 1 <= min(means)
    assert max(means) <= high + 1
    assert 100 * min(every) == pytest.approx(least, abs=1)
    assert 100 * max(every) == pytest.approx(most, abs=3)


def random_stack(random):
    """Two to six layers in gamut, half of them with one channel that is 0 or full."""
    for _ in range(random.integers(2, 7)):
        alpha = random.random((64, 128, 1)) ** random.choice([0.3, 1, 3])
        color = random.random((64, 128, 3)) ** random.choice([0.3, 1, 3])
        if random.random() < 0.5:
            color[..., random.integers(3)] = random.integers(2)
        yield np.concatenate([alpha * color, alpha], axis=-1).astype(np.float32)


def hues_near_the_shoulder(random, space):
    """Two layers in gamut whose hues are apart by hardly more than the tolerance, which is 2°.

    There ⊕ does next to nothing but add, and one engine may take the plain sum where the other does not.
    """
    color = random.random((3, 64 * 1024))
    luminance, p = space.forward(color)
    turn = np.radians(2 + 0.02 * random.random(luminance.shape) ** 2)
    (x, y), (cosine, sine) = p, (np.cos(turn), np.sin(turn))
    other = space.inverse(luminance, random.random() * np.stack([cosine * x - sine * y, sine * x + cosine * y]))
    alphas = random.random((2, luminance.size))
    return [
        np.concatenate([alpha * np.clip(c, 0, 1), alpha[None]]).T[None].astype(np.float32)
        for c, alpha in zip((color, other), alphas, strict=True)
    ]


def test_how_far_the_engines_differ():
    planes, hsl, oklab, cielab = said(
        "hpcomp-blending.7",
        r"agree to ([\d.]+) in linear-rgb and xyz, to ([\d.]+) in hsl, to ([\d.]+) in oklab, and to "
        r"([\d.]+) in cielab",
    )
    random = np.random.default_rng(3)
    stacks = [list(random_stack(random)) for _ in range(12)]
    for name, space in SPACES.items():
        limit = {"hsl": hsl, "oklab": oklab, "cielab": cielab}.get(name, planes)
        near = [hues_near_the_shoulder(random, space) for _ in range(4)]
        differences = [
            np.abs(
                composite_by("kernel", layers, space=name)
                - composite_by("reference", layers, space=name)
            ).max()
            for layers in (*stacks, *near)
        ]
        assert max(differences) <= limit, name
        assert max(differences) > limit / 20, name  # else the page says too much


def test_how_far_the_way_into_gamut_turns_a_hue():
    turns = said("hpcomp-blending.7", r"by up to ([\d.]+)° in oklab and ([\d.]+)° in cielab")
    assert turns == [SPACES[name].gamut_turn for name in ("oklab", "cielab")]
