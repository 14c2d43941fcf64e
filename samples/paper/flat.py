"""Draws the flat layers, half-float EXR: profiles, lights, mixtures, greys, orders, a veil.

    python flat.py FIGURE SIZE DIRECTORY

A figure's layers are those of its function, for panels of SIZE pixels; nothing is composited here.
Running twice gives the same bytes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from slices import linear_rgb, save_exr

Layers = dict[str, np.ndarray]

LUMINANCE = np.array([0.2126390058715103, 0.7151686787677559, 0.0721923153607337])  # Rec. 709

# ---- Figures 2 and 4 -----------------------------------------------------------------------------

# Pairs of colours: what is above and what is below, linear RGB. The opposite of a primary is white
# without it; a colour has the hue of another if it is a part of it and grey.
ORANGE = linear_rgb("#ff8400")
PAIRS = {
    "a": (linear_rgb("#00a0a0"), ORANGE),
    "b": (linear_rgb("#ff0022"), linear_rgb("#00c800")),
    "c": (np.array([0.0, 0, 1]), np.array([1.0, 1, 0])),
    "d": (np.array([1.0, 0, 0]), np.array([0.0, 1, 1])),
    "e": (0.5 * ORANGE, 0.3 * ORANGE + 0.5),
}


def pair_width(size: int) -> int:
    """From one pair to the next: two bars beside each other, and a gap."""
    return size * 3 // 8


def bar_width(size: int) -> int:
    return size * 5 // 32


def profiles(size: int) -> Layers:
    """Bars of the upper colours, opaque, and on them the lower ones, from alpha 0 to alpha 1."""
    back = np.zeros((size, len(PAIRS) * pair_width(size), 4))
    front = back.copy()
    alpha = np.linspace(0, 1, size)[:, None, None]
    for number, (upper, lower) in enumerate(PAIRS.values()):
        left = number * pair_width(size)
        bar = np.s_[:, left : left + bar_width(size)]
        back[bar] = [*upper, 1]
        front[bar] = alpha * [*lower, 1]
    return {"back": back, "front": front}


# ---- Figure 5 and the orders ---------------------------------------------------------------------

LIGHTS = {"red": (1.0, 0, 0), "green": (0, 1.0, 0), "blue": (0, 0, 1.0)}
# Their luminance is low, so that what is left of them where all three meet can be seen.
RIVALS = {"red": (1.0, 0, 0), "magenta": (1.0, 0, 1.0), "blue": (0, 0, 1.0)}
BRIGHTNESS = 0.55  # three lights together stay in the gamut
LIGHT_RADIUS = 0.30  # of the size
LIGHT_OFFSET = 0.17  # of a light's middle from that of the picture


def spots(size: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Coverage 0-1 of three round spots, one above, two below, and the distance from the middle
    of each in radii."""
    x = (np.arange(size) + 0.5) / size - 0.5
    y = x[:, None] - 0.04
    found = []
    for angle in np.radians([-90, 150, 30]):
        away = np.hypot(x - LIGHT_OFFSET * np.cos(angle), y - LIGHT_OFFSET * np.sin(angle))
        found.append((np.clip((LIGHT_RADIUS - away) * size + 0.5, 0, 1), away / LIGHT_RADIUS))
    return found


def lights(size: int) -> Layers:
    """Three lights that fade from their middle outwards."""
    return {
        name: (edge * (1 - 0.6 * away**2))[..., None] * [*(BRIGHTNESS * np.array(color)), 1]
        for (name, color), (edge, away) in zip(LIGHTS.items(), spots(size), strict=True)
    }


def chroma(color: np.ndarray) -> float:
    """|p|: the distance from the grey of the same luminance."""
    return float(np.linalg.norm(color - LUMINANCE @ color))


def orders(size: int) -> Layers:
    """Three even lights, each as strong as the others: any two of them cancel to grey."""
    weakest = min(chroma(np.array(color)) for color in RIVALS.values())
    found = {}
    for (name, color), (edge, _) in zip(RIVALS.items(), spots(size), strict=True):
        even = np.array(color) * BRIGHTNESS * weakest / chroma(np.array(color))
        found[name] = edge[..., None] * [*even, 1]
    return found


# ---- Figure 6 ------------------------------------------------------------------------------------

# As in `hpcomp palette` of the Makefile.
LABELS = {"red": "#ff0000", "blue": "#0038ff", "yellow": "#ffd800", "green": "#00b43c"}


def mixtures(size: int) -> Layers:
    """Each label at opacities of its own, one for each pixel, spread evenly over all that is."""
    step = 1.1673039782614187  # the real root of x^5 = x + 1, whose powers fill four dimensions
    pixel = np.arange(size * size)
    return {
        name: ((0.5 + pixel / step ** (i + 1)) % 1).reshape(size, size, 1) * [*linear_rgb(color), 1]
        for i, (name, color) in enumerate(LABELS.items())
    }


# ---- Figure 15 -----------------------------------------------------------------------------------

# In each row labels fade out, from left to right, over the one below them: one alone, or three that
# share what they cover, which then is no more than three quarters.
GREY_ROWS = (
    ("#f00028", ("#00a050",), 1.0),
    ("#ff8c00", ("#0a50ff",), 1.0),
    ("#c800b4", ("#e6c800",), 1.0),
    ("#f00028", ("#00c850", "#0a50ff", "#e6c800"), 0.75),
)
GREY_HEIGHT = 0.21  # of a row, in sizes; a row begins each quarter


def grey(size: int) -> Layers:
    layers = [np.zeros((size, size, 4)) for _ in range(4)]
    fade = np.linspace(1, 0, size)[:, None]
    for number, (below, above, most) in enumerate(GREY_ROWS):
        top = number * size // 4
        row = np.s_[top : top + round(GREY_HEIGHT * size)]
        layers[0][row] = [*linear_rgb(below), 1]
        share = most * fade / len(above)  # of what is seen
        for in_front, (layer, color) in enumerate(
            zip(reversed(layers[1 : len(above) + 1]), reversed(above), strict=True)
        ):
            # What is in front hides some of what is behind it.
            layer[row] = share / (1 - in_front * share) * [*linear_rgb(color), 1]
    return dict(zip(("base", "first", "second", "third"), layers, strict=True))


# ---- beyond the paper ----------------------------------------------------------------------------

OPACITY, VEIL_OPACITY = 0.6, 0.01


def discs(size: int) -> Layers:
    """Three labels of the tooth as discs, and a faint green veil for the right half of them."""
    colors = {"yellow": "#ffd800", "red": "#f00028", "blue": "#0038ff"}
    edges = [edge for edge, _ in spots(size)]
    found = {
        name: (OPACITY * edge)[..., None] * [*linear_rgb(color), 1]
        for (name, color), edge in zip(colors.items(), edges, strict=True)
    }
    right_half = np.arange(size) >= size // 2
    veiled = VEIL_OPACITY * np.maximum.reduce(edges) * right_half
    found["veil"] = veiled[..., None] * [*linear_rgb("#00c850"), 1]
    return found


FIGURES: dict[str, Callable[[int], Layers]] = {
    "profiles": profiles,
    "lights": lights,
    "mixtures": mixtures,
    "grey": grey,
    "orders": orders,
    "discs": discs,
}


def draw(figure: str, size: int, directory: Path) -> None:
    directory.mkdir(parents=True, exist_ok=True)
    for name, rgba in FIGURES[figure](size).items():
        save_exr(directory / f"{name}.exr", rgba)


if __name__ == "__main__":
    figure, size, directory = sys.argv[1:]
    draw(figure, int(size), Path(directory))
