"""Draws the layers of the terrain sample from real elevation data; hpcomp composites them.

    python samples/terrain/draw.py [DIRECTORY]      (default: layers/ beside this script)

Needs hpcomp's extra `samples` (numpy, matplotlib, OpenEXR). The elevation is matplotlib's sample
data `jacksboro_fault_dem.npz`: the Jacksboro fault in Tennessee, 36.45-36.73 N, 84.41-84.08 W, one
value every 3 arc seconds. Running twice gives the same bytes; another release of matplotlib may
rasterise an edge or a letter a little differently.
"""

from __future__ import annotations

import heapq
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.cbook
import matplotlib.pyplot as plt
import numpy as np
import OpenEXR
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.patheffects import withStroke


@dataclass(frozen=True)
class Label:
    """A nominal class: what it says, its sRGB colour, its opacity where it covers a pixel fully."""

    text: str
    color: str
    opacity: float


# The labels, bottom first, above an opaque grey hillshade (hillshade.png). Five hues that nobody
# confuses on their own, and yet: red over yellow adds up to the orange of the fault zone, and blue
# over orange to the violet of the summits.
# fmt: off
LABELS = {
    #                       label             colour     opacity  extent
    "elevation.png": Label("elevation band",  "#ffdd00", 0.60),   # 450-650 m           (yellow)
    "steep.exr":     Label("steep slope",     "#ee0038", 0.70),   # above 14 degrees    (red)
    "summits.exr":   Label("summit",          "#8428ff", 0.65),   # above 750 m         (violet)
    "fault.exr":     Label("fault zone",      "#ff7200", 0.75),   # within 1 km of it   (orange)
    "streams.png":   Label("stream",          "#0050ff", 0.65),   # draining 6 km2      (blue)
}
# fmt: on
# streams.png is drawn opaque, as translucent strokes would show twice where streams meet: its
# opacity is given to hpcomp. The data windows of the EXR files hold only what their label covers.

WIDTH, HEIGHT = 480, 510  # pixels of every layer
CELL = 62.5  # metres a pixel, both ways: 30.0 x 31.9 km
SUPERSAMPLING = 4  # sub-pixels a side where a raster mask needs a smooth edge
DPI = 100  # of matplotlib's figures; only the product with the size in inches matters

UNSIGNED = {"Software": None}  # matplotlib's version would make other bytes of the same picture

# The side-by-side picture: two maps on a white sheet, between captions.
MONTAGE = 976, 586
MAPS_LEFT, MAPS_TOP = (0, 496), 36
LEGEND_TOP = 559
TITLES = (
    ("traditional", "A reads as fault zone, B as summit, C as no label"),
    ("hue-preserving", "A is a steep slope, B a stream, C a summit"),
)
MARKS = {"A": (105, 187), "B": (199, 118), "C": (237, 407)}

# The fault as it shows on the hillshade, traced by hand: x, y in pixels, north to south.
# fmt: off
FAULT_TRACE = (
    (126, -14), (138, 14), (150, 35), (165, 58), (185, 84), (194, 102), (202, 128), (215, 160),
    (232, 192), (248, 222), (262, 245), (276, 267), (290, 295), (303, 319), (319, 350), (336, 376),
    (357, 402), (371, 430), (379, 468), (383, 520),
)
# fmt: on


# ---- elevation and what follows from it ----------------------------------------------------------


def cubic_weights(n_in: int, n_out: int) -> np.ndarray:
    """Catmull-Rom resampling as a matrix (n_out, n_in); edge values are repeated."""
    position = (np.arange(n_out) + 0.5) * n_in / n_out - 0.5
    first = np.floor(position).astype(int)
    weights = np.zeros((n_out, n_in))
    for k in range(-1, 3):
        t = np.abs(position - (first + k))
        w = np.where(t <= 1, (1.5 * t - 2.5) * t * t + 1, ((-0.5 * t + 2.5) * t - 4) * t + 2)
        np.add.at(weights, (np.arange(n_out), np.clip(first + k, 0, n_in - 1)), w)
    return weights


def resample(field: np.ndarray, height: int, width: int) -> np.ndarray:
    return cubic_weights(field.shape[0], height) @ field @ cubic_weights(field.shape[1], width).T


def smooth(field: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian of `sigma` pixels."""

    def weights(n: int) -> np.ndarray:
        i = np.arange(n)
        w = np.exp(-0.5 * ((i[:, None] - i) / sigma) ** 2)
        return w / w.sum(axis=1, keepdims=True)

    return weights(field.shape[0]) @ field @ weights(field.shape[1]).T


def read_elevation() -> np.ndarray:
    """Metres above the sea (HEIGHT, WIDTH), north up, square pixels."""
    grid = matplotlib.cbook.get_sample_data("jacksboro_fault_dem.npz")["elevation"]
    # Whole metres on a coarse grid leave terraces: smooth them away before they look like relief.
    elevation = smooth(resample(grid.astype(float), HEIGHT, WIDTH), 1.1)
    # The last bits depend on the machine's matrix product; no stream may turn on them.
    return np.round(elevation, 3)


def hillshade(elevation: np.ndarray) -> np.ndarray:
    """Light reflected towards the viewer, 0-1, sun in the north-west, heights exaggerated."""
    down, right = np.gradient(1.6 * elevation, CELL)
    azimuth, altitude = np.radians(315), np.radians(42)
    sun_east, sun_north = np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude)
    shade = (np.sin(altitude) - right * sun_east + down * sun_north) / np.sqrt(
        1 + right**2 + down**2
    )
    return np.clip(shade, 0, 1)


def slope_degrees(elevation: np.ndarray, sigma: float) -> np.ndarray:
    down, right = np.gradient(elevation, CELL)
    return np.degrees(np.arctan(smooth(np.hypot(down, right), sigma)))


def drainage(elevation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Receiver of every cell (flat index; itself on the rim) and number of cells draining through.

    Pits are filled from the rim inwards, lowest first; each cell then drains to the neighbour with
    the steepest fall on the filled surface (D8), and cells are counted from the highest one down.
    """
    height, width = elevation.shape
    filled = np.pad(elevation, 1, constant_values=np.inf).ravel().tolist()
    stride = width + 2
    around = [(step_y * stride + step_x, (step_x**2 + step_y**2) ** 0.5)
              for step_y in (-1, 0, 1) for step_x in (-1, 0, 1) if step_x or step_y]  # fmt: skip
    cells = [(y + 1) * stride + x + 1 for y in range(height) for x in range(width)]
    rim = {c for c in cells if any(filled[c + step] == np.inf for step, _ in around)}
    reached = bytearray(len(filled))
    for c in rim:
        reached[c] = 1
    queue = sorted((filled[c], c) for c in rim)
    upwards = []
    while queue:
        level, c = heapq.heappop(queue)
        upwards.append(c)
        for step, _ in around:
            n = c + step
            if filled[n] != np.inf and not reached[n]:
                reached[n] = 1
                filled[n] = max(filled[n], level + 1e-6)  # a filled pit still slopes to its outlet
                heapq.heappush(queue, (filled[n], n))
    receiver = list(range(len(filled)))
    through = [1] * len(filled)
    for c in reversed(upwards):
        if c not in rim:
            _, step = max(((filled[c] - filled[c + s]) / far, s) for s, far in around)
            receiver[c] = c + step
            through[c + step] += through[c]

    def unpadded(values: list[int]) -> np.ndarray:
        return np.array(values).reshape(height + 2, stride)[1:-1, 1:-1]

    rows, columns = np.divmod(unpadded(receiver), stride)
    return (rows - 1) * width + columns - 1, unpadded(through)


def stream_lines(elevation: np.ndarray, least_area: float) -> list[tuple[np.ndarray, float]]:
    """Streams, cut at junctions: x, y in pixels (n, 2) and square km drained at the lower end."""
    receiver, cells = (field.ravel() for field in drainage(elevation))
    square_km = cells * (CELL / 1000) ** 2
    stream = square_km >= least_area
    flowing = stream & (receiver != np.arange(receiver.size))
    inflows = np.bincount(receiver[flowing], minlength=receiver.size)
    lines = []
    for start in np.flatnonzero(stream & (inflows != 1)):
        line = [start]
        while receiver[line[-1]] != line[-1] and (len(line) == 1 or inflows[line[-1]] == 1):
            line.append(receiver[line[-1]])
        if len(line) > 1:
            y, x = np.divmod(np.array(line), elevation.shape[1])
            above_junction = square_km[line[-2]]
            lines.append((rounded(np.stack([x, y], axis=1) + 0.5), float(above_junction)))
    return lines


def rounded(line: np.ndarray) -> np.ndarray:
    """The line without the staircase of the eight directions; its ends stay."""
    line = line.copy()
    for _ in range(6):
        line[1:-1] = (line[:-2] + 2 * line[1:-1] + line[2:]) / 4
    return line


# ---- coverage of a pixel by a mask, 0-1 ----------------------------------------------------------


def coverage(inside: np.ndarray) -> np.ndarray:
    """Share of each pixel that a supersampled mask covers."""
    n = SUPERSAMPLING
    return inside.reshape(inside.shape[0] // n, n, inside.shape[1] // n, n).mean(axis=(1, 3))


def coverage_above(field: np.ndarray, threshold: float) -> np.ndarray:
    return coverage(resample(field, HEIGHT * SUPERSAMPLING, WIDTH * SUPERSAMPLING) > threshold)


def coverage_near(line: Sequence[tuple[float, float]], distance: float) -> np.ndarray:
    """Of the swath within `distance` pixels of a polyline of points x, y in pixels."""
    x = (np.arange(WIDTH * SUPERSAMPLING) + 0.5) / SUPERSAMPLING
    y = (np.arange(HEIGHT * SUPERSAMPLING)[:, None] + 0.5) / SUPERSAMPLING
    inside = np.zeros((y.size, x.size), dtype=bool)
    for (x0, y0), (x1, y1) in pairwise(line):
        dx, dy = x1 - x0, y1 - y0
        along = np.clip(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0, 1)
        inside |= np.hypot(x - x0 - along * dx, y - y0 - along * dy) < distance
    return coverage(inside)


# ---- files ---------------------------------------------------------------------------------------


def linear_rgb(color: str) -> np.ndarray:
    """A CSS colour, #rrggbb, as linear light 0-1 (3,). IEC 61966-2-1."""
    encoded = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def encoded_rgb(linear: np.ndarray) -> np.ndarray:
    """Linear light 0-1 (3,) as sRGB 0-1."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def save_exr(path: Path, label: Label, cover: np.ndarray) -> None:
    """Half-float, linear, premultiplied; the data window holds only what is not transparent."""
    rows, columns = np.flatnonzero(cover.any(axis=1)), np.flatnonzero(cover.any(axis=0))
    top, bottom, left, right = rows[0], rows[-1], columns[0], columns[-1]
    alpha = label.opacity * cover[top : bottom + 1, left : right + 1]
    channels = {
        name: np.ascontiguousarray(alpha * value, dtype=np.float16)
        for name, value in zip("RGBA", [*linear_rgb(label.color), 1.0], strict=True)
    }
    window = (np.array([left, top], np.int32), np.array([right, bottom], np.int32))
    display = (np.array([0, 0], np.int32), np.array([WIDTH - 1, HEIGHT - 1], np.int32))
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": window,
        "displayWindow": display,
    }
    OpenEXR.File(header, channels).write(str(path))


def transparent_figure(width: int, height: int) -> tuple[Figure, Axes]:
    """A figure of exactly that many pixels whose axes count them from the top left corner."""
    figure = plt.figure(figsize=(width / DPI, height / DPI), dpi=DPI)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.axis("off")
    return figure, axes


def save_figure(path: Path, figure: Figure) -> None:
    figure.savefig(path, dpi=DPI, transparent=True, metadata=UNSIGNED)
    plt.close(figure)


# ---- the layers ----------------------------------------------------------------------------------


def draw_hillshade(path: Path, elevation: np.ndarray) -> None:
    # Thirty-two greys look the same as all of them and make much smaller files.
    greys = np.round(32 * hillshade(elevation)) / 32
    plt.imsave(path, 0.14 + 0.80 * greys, cmap="gray", vmin=0, vmax=1, metadata=UNSIGNED)


def draw_elevation_band(path: Path, elevation: np.ndarray) -> None:
    label = LABELS[path.name]
    figure, axes = transparent_figure(WIDTH, HEIGHT)
    x, y = np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5
    axes.contourf(x, y, elevation, levels=[450, 650], colors=[label.color], alpha=label.opacity,
                  antialiased=True)  # fmt: skip
    save_figure(path, figure)


def draw_streams(path: Path, elevation: np.ndarray) -> None:
    label = LABELS[path.name]
    figure, axes = transparent_figure(WIDTH, HEIGHT)
    for line, square_km in stream_lines(elevation, least_area=6):
        pixels = min(2.5 + 0.6 * square_km**0.5, 8)
        axes.plot(*line.T, color=label.color, linewidth=pixels * 72 / DPI,
                  solid_capstyle="round", solid_joinstyle="round")  # fmt: skip
    save_figure(path, figure)


def draw_captions(path: Path) -> None:
    """Titles, rings and legend of the side-by-side picture; transparent elsewhere."""
    figure, axes = transparent_figure(*MONTAGE)
    halo = [withStroke(linewidth=3, foreground="black")]
    for left, (title, remark) in zip(MAPS_LEFT, TITLES, strict=True):
        axes.text(left + 2, 17, title, size=11.5, weight="bold", va="center")
        axes.text(left + WIDTH - 2, 17, remark, size=8.5, va="center", ha="right")
        for name, (x, y) in MARKS.items():
            center = left + x, MAPS_TOP + y
            for color, width in (("black", 3.4), ("white", 1.6)):
                axes.add_patch(Circle(center, 15, fill=False, ec=color, lw=width))
            axes.text(center[0] - 24, center[1] - 14, name, size=13, weight="bold", color="white",
                      ha="center", va="center", path_effects=halo)  # fmt: skip
    for i, label in enumerate(LABELS.values()):
        left = 2 + i * MONTAGE[0] / len(LABELS)
        over_grey = label.opacity * linear_rgb(label.color) + (1 - label.opacity) * 0.35
        axes.add_patch(Rectangle((left, LEGEND_TOP), 34, 18, fc=encoded_rgb(over_grey), ec="none"))
        axes.text(left + 42, LEGEND_TOP + 9, label.text, size=10, va="center_baseline")
    save_figure(path, figure)


def draw(directory: Path) -> None:
    directory.mkdir(parents=True, exist_ok=True)
    plt.style.use("default")  # whatever the user's matplotlibrc says
    elevation = read_elevation()
    draw_hillshade(directory / "hillshade.png", elevation)
    draw_elevation_band(directory / "elevation.png", elevation)
    for name, cover in {
        "steep.exr": coverage_above(slope_degrees(elevation, 3.5), 14),
        "summits.exr": coverage_above(smooth(elevation, 1.5), 750),
        "fault.exr": coverage_near(FAULT_TRACE, 1000 / CELL),
    }.items():
        save_exr(directory / name, LABELS[name], cover)
    draw_streams(directory / "streams.png", elevation)
    draw_captions(directory / "captions.png")


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "layers")
