"""Draws the sheet that a figure's panels lie on: black or white places for them, titles, a legend.

    python sheets.py OUTPUT --frame "WIDTH HEIGHT" --columns N [--legend VOLUME] ... TITLE...

A title stands above each panel, row by row; what comes after a | is set smaller, at the right. The
panels themselves are put there by hpcomp. Running twice gives the same bytes; another release of
matplotlib may rasterise a letter a little differently.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from slices import RAMP, VOLUMES, fields

DPI = 100  # only the product with the size in inches matters
UNSIGNED = {"Software": None}  # matplotlib's version would make other bytes of the same picture
TITLE_BAND = 34  # pixels above each row of panels, as in the Makefile
FOOT = 34  # pixels of the legend or the note
PLOT_WIDTH = 330  # pixels of the transfer function beside the panels


def draw_transfer_function(axes: Axes, name: str) -> None:
    """The histogram of the data, and over it the opacity that each value has, in its colour."""
    volume = VOLUMES[name]
    values = np.concatenate([field.ravel() for field in fields(volume, 96, 64)])
    counts, edges = np.histogram(values[values > 0.02], bins=98, range=(0.02, 1))
    axes.fill_between(edges[:-1], np.sqrt(counts / counts.max()), step="post", color="#b8b8b8")
    strongest = max(m.extinction for m in volume.materials)
    for material in volume.materials:
        opacity = (material.extinction / strongest) ** (1 / 3)
        ends = [material.low, material.low + RAMP, material.high - RAMP, material.high]
        axes.fill(ends, [0, opacity, opacity, 0], color=material.color, alpha=0.45, lw=0)
        axes.plot(ends, [0, opacity, opacity, 0], color=material.color, lw=2)
        axes.text((material.low + material.high) / 2, opacity + 0.02, material.name, size=9,
                  ha="center")  # fmt: skip
    axes.set(xlim=(0, 1), ylim=(0, 1.12), yticks=[], xticks=np.linspace(0, 1, 6))
    axes.tick_params(labelsize=8)
    axes.set_xlabel("data value", size=9)
    axes.set_title("how often a value occurs (grey),\ncolour and opacity it is given", size=9.5)
    for side in ("top", "left", "right"):
        axes.spines[side].set_visible(False)


def draw_sheet(chosen: argparse.Namespace) -> None:
    plt.style.use("default")  # whatever the user's matplotlibrc says
    width, height = (int(word) for word in chosen.frame.split())
    rows = -(-len(chosen.titles) // chosen.columns)
    panels_width = chosen.columns * (width + chosen.gap) - chosen.gap
    plot = PLOT_WIDTH if chosen.transfer else 0
    foot = FOOT if chosen.legend or chosen.note else 0
    full = panels_width + plot, rows * (TITLE_BAND + height) + foot
    figure = plt.figure(figsize=(full[0] / DPI, full[1] / DPI), dpi=DPI, facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, full[0]), ylim=(full[1], 0))
    axes.axis("off")
    for number, title in enumerate(chosen.titles):
        row, column = divmod(number, chosen.columns)
        left, top = column * (width + chosen.gap), row * (height + TITLE_BAND) + TITLE_BAND
        if not chosen.paper:
            axes.add_patch(Rectangle((left, top), width, height, fc="black", ec="none", lw=0,
                                     antialiased=False))  # fmt: skip
        bold, _, small = title.partition("|")
        axes.text(left + 2, top - 15, bold, size=10.5, weight="bold", va="center")
        at = (left + width - 2, "right") if bold else (left + 2, "left")
        axes.text(at[0], top - 15, small, size=9, va="center", ha=at[1])
    left = 2.0
    for material in VOLUMES[chosen.legend].materials if chosen.legend else ():
        axes.add_patch(Rectangle((left, full[1] - 24), 30, 16, fc=material.color, ec="none"))
        axes.text(left + 38, full[1] - 16, material.name, size=10, va="center_baseline")
        left += 130
    axes.text(left, full[1] - 16, chosen.note, size=9.5, va="center_baseline")
    if chosen.transfer:
        place = ((panels_width + 34) / full[0], 0.22, (plot - 44) / full[0], 0.56)
        draw_transfer_function(figure.add_axes(place), chosen.transfer)
    # Under its name a file is whole, whenever this is interrupted.
    half_made = chosen.output.with_name(f".{chosen.output.name}")
    figure.savefig(half_made, dpi=DPI, format="png", metadata=UNSIGNED)
    plt.close(figure)
    os.replace(half_made, chosen.output)


if __name__ == "__main__":
    words = argparse.ArgumentParser(allow_abbrev=False)
    words.add_argument("output", type=Path)
    words.add_argument("titles", nargs="+")
    words.add_argument("--frame", required=True, help="pixels of a panel: WIDTH HEIGHT")
    words.add_argument("--columns", type=int, required=True)
    words.add_argument("--gap", type=int, default=16, help="pixels between two columns")
    words.add_argument("--paper", action="store_true", help="white places instead of black ones")
    words.add_argument("--legend", help="volume whose labels are named below")
    words.add_argument("--note", default="", help="what else is said below")
    words.add_argument("--transfer", help="volume whose transfer function is drawn at the right")
    draw_sheet(words.parse_args())
