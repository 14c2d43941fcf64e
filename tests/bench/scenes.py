"""The scenes that the observer looks at: where real labels lie, and in which colours they are drawn.

A label is a coverage in [0, 1] and a colour. The data come with packages from PyPI, and the terrain
with this repository; nothing is downloaded. What is made of a scene's layers lives in `observer.py`.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float64]

#: Pixels of a scene along its longer side, about.
SIZE = 512

#: How opaque a label is where it covers all of a pixel: what lies below shows through.
OPACITY = 0.75

#: The colours of qualitative palettes, as they come, but for greys and black: these are no labels.
PALETTES = {
    "tab10": "#1f77b4 #ff7f0e #2ca02c #d62728 #9467bd #8c564b #e377c2 #bcbd22 #17becf",
    "Set1": "#e41a1c #377eb8 #4daf4a #984ea3 #ff7f00 #ffff33 #a65628 #f781bf",
    "Dark2": "#1b9e77 #d95f02 #7570b3 #e7298a #66a61e #e6ab02 #a6761d",
    "Okabe-Ito": "#e69f00 #56b4e9 #009e73 #f0e442 #0072b2 #d55e00 #cc79a7",
}

#: At which colour of a palette the first label of an assignment begins; the others follow it.
ASSIGNMENTS = (0, 2, 4)

TERRAIN = Path(__file__).resolve().parents[2] / "samples" / "terrain" / "layers"
#: The labels of the terrain sample, bottom first: file, colour and opacity, as it stacks them.
TERRAIN_LABELS = (
    ("elevation.png", "#ffdd00", 1.0),
    ("steep.exr", "#ee0038", 1.0),
    ("summits.exr", "#8428ff", 1.0),
    ("fault.exr", "#ff7200", 1.0),
    ("streams.png", "#0050ff", 0.65),
)


@dataclass(frozen=True)
class Scene:
    """Labels of one subject on a grey ground.

    `alpha` (n, height, width) in [0, 1]: what each label covers, bottom first, its opacity
    included. `ground` (height, width): linear, opaque; paper is 1. `colors`: those of the labels,
    where they are not assigned.
    """

    name: str
    alpha: Plane
    ground: Plane
    colors: tuple[str, ...] = ()

    def layers(self, colors: Sequence[str]) -> list[Plane]:
        """The ground, and each label in its colour: (height, width, 4), linear, premultiplied."""
        ground = np.stack([*[self.ground] * 3, np.ones_like(self.ground)], axis=-1)
        straight = [np.array([*linear(color), 1.0]) for color in colors]
        return [ground, *(a[..., None] * c for a, c in zip(self.alpha, straight, strict=True))]


def _on_paper(name: str, coverage: Sequence[Plane]) -> Scene:
    alpha = OPACITY * np.clip(coverage, 0, 1)
    return Scene(name, alpha, np.ones(alpha.shape[1:]))


def linear(color: str) -> Plane:
    """#rrggbb as linear RGB (3)."""
    return decoded(np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255)


def decoded(encoded: Plane) -> Plane:
    """sRGB in [0, 1] as linear light. IEC 61966-2-1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def colors_of(palette: str, assignment: int, labels: int) -> list[str]:
    """So many colours of a palette, from the one that an assignment begins with, and round."""
    colors = PALETTES[palette].split()
    return [colors[(assignment + number) % len(colors)] for number in range(labels)]


def tissues() -> Scene:
    """Fluid, grey and white matter of a brain from above, on its T1 picture: shares of each voxel.

    The ICBM 152 atlas (Fonov et al. 2011), in nilearn. The fluid is what the other two leave of the
    brain: the shares add up to 1.
    """
    import nibabel
    from scipy import ndimage

    level, shown = 82, (slice(20, 210), slice(20, 176))

    def slice_of(kind: str) -> Plane:
        name = f"datasets/data/mni_icbm152_{kind}_tal_nlin_sym_09a_converted.nii.gz"
        volume = nibabel.load(_package("nilearn") / name).get_fdata()
        return np.rot90(volume[:, :, level])[shown] / 255

    picture, grey, white = (slice_of(kind) for kind in ("t1", "gm", "wm"))
    fluid = (picture > 0) * np.clip(1 - grey - white, 0, 1)
    larger = [
        np.clip(ndimage.zoom(plane, SIZE / len(plane), order=1), 0, 1)
        for plane in (fluid, grey, white, picture)
    ]
    return Scene("tissues", OPACITY * np.stack(larger[:3]), decoded(larger[3]))


def regions() -> Scene:
    """Five countries around the Alps and what is within some 150 km of them, with a soft border.

    Natural Earth, 1:110m, in geopandas 0.14.
    """
    import shapefile
    from PIL import Image, ImageDraw
    from scipy import ndimage

    names = ("France", "Germany", "Switzerland", "Austria", "Italy")
    west, north, degrees = -3.0, 54.5, 18.5
    scale = SIZE / degrees  # of a degree of latitude; 1 degree is 111 km
    narrow = np.cos(np.radians(47))
    reach, border = 150 / 111 * scale, 60 / 111 * scale
    path = _package("geopandas") / "datasets/naturalearth_lowres/naturalearth_lowres.shp"
    with shapefile.Reader(str(path)) as reader:
        shapes = {item.record["name"]: item.shape for item in reader.iterShapeRecords()}
    coverage = []
    for name in names:
        canvas = Image.new("1", (SIZE, SIZE))
        shape = shapes[name]
        ends = [*shape.parts[1:], len(shape.points)]
        for begin, end in zip(shape.parts, ends, strict=True):
            ring = [
                ((x - west) * narrow * scale, (north - y) * scale)
                for x, y in shape.points[begin:end]
            ]
            ImageDraw.Draw(canvas).polygon(ring, fill=1)
        away = ndimage.distance_transform_edt(~np.asarray(canvas))
        coverage.append(np.clip((reach - away) / border + 0.5, 0, 1))
    return _on_paper("regions", coverage)


def densities() -> Scene:
    """How three wines lie in alcohol and colour: kernel densities, each 1 at its peak.

    UCI wine data, in scikit-learn.
    """
    from scipy.stats import gaussian_kde
    from sklearn.datasets import load_wine

    data, target = load_wine(return_X_y=True)
    places = _to_canvas(data[:, [0, 9]], margin=0.12)
    y, x = np.mgrid[0:SIZE:2, 0:SIZE:2]
    coverage = []
    for label in range(3):
        density = gaussian_kde(places[target == label].T)(np.stack([x.ravel(), y.ravel()]))
        density = density.reshape(x.shape) / density.max()
        coverage.append(density.repeat(2, axis=0).repeat(2, axis=1))
    return _on_paper("densities", coverage)


def points() -> Scene:
    """Six handwritten digits on their first two principal axes: discs of 15 pixels, half covering.

    UCI digits, in scikit-learn.
    """
    from sklearn.datasets import load_digits
    from sklearn.decomposition import PCA

    data, target = load_digits(n_class=6, return_X_y=True)
    places = _to_canvas(PCA(2, svd_solver="full").fit_transform(data))
    y, x = np.mgrid[0:SIZE, 0:SIZE]
    radius = 7.5
    coverage = np.ones((6, SIZE, SIZE))
    for (at_x, at_y), label in zip(places, target, strict=True):
        near = np.clip(radius + 0.5 - np.hypot(x - at_x, y - at_y), 0, 1)  # one pixel of soft edge
        coverage[label] *= 1 - 0.5 * near
    return _on_paper("points", list(1 - coverage))


def terrain() -> Scene:
    """The terrain sample of this repository, on its hillshade, in its own colours."""
    import hpcomp

    ground = hpcomp.read_layer(TERRAIN / "hillshade.png")
    height, width = ground.pixels.shape[:2]
    alpha = np.zeros((len(TERRAIN_LABELS), height, width))
    for number, (name, _, opacity) in enumerate(TERRAIN_LABELS):
        layer = hpcomp.read_layer(TERRAIN / name)
        window = layer.data_window
        rows = slice(window.y, window.y + window.height)
        alpha[number, rows, window.x : window.x + window.width] = opacity * layer.pixels[..., 3]
    colors = tuple(color for _, color, _ in TERRAIN_LABELS)
    return Scene("terrain", alpha, ground.pixels[..., 0].astype(float), colors)


def _to_canvas(data: Plane, margin: float = 0.04) -> Plane:
    """Points (n, 2) as pixels of the canvas, with a margin on each side."""
    low, high = data.min(axis=0), data.max(axis=0)
    return (margin + (1 - 2 * margin) * (data - low) / (high - low)) * SIZE


@cache
def _package(name: str) -> Path:
    """The folder of an installed package, which is not imported. Errors: `SystemExit`."""
    spec = importlib.util.find_spec(name)
    if spec is None or spec.origin is None:
        raise SystemExit(
            f"{name} is missing, whose data a scene shows: see the first lines of observer.py"
        )
    return Path(spec.origin).parent


SCENES: tuple[Callable[[], Scene], ...] = (terrain, tissues, regions, densities, points)
