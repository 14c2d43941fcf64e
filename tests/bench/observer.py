"""An observer who sees the written 8-bit PNG alone, and says which labels can be read in it.

    pip install nibabel scikit-learn scipy pillow pyshp
    pip install --no-deps nilearn geopandas==0.14.4
    python tests/bench/observer.py [--only METHOD]... [--scene SCENE]... [--pictures DIRECTORY]

The scenes are real data, from `scenes.py`; of nilearn and geopandas only the data are used. Every
scene but the terrain is drawn in four palettes and three assignments of their colours. Each method
is a row of `METHODS`: options of `hpcomp stack`.

(a) Through a window of 11 × 11 pixels it names every hue that it finds there. A label is *found* at
those of its pixels where it is named, and a hue is *foreign* that no label at its pixel has.
(b) In overlaps it names, pixel by pixel, the label of the nearest hue: right, if that label covers
most there, or wrong; or it sees grey.
What is right comes from the layers, with code of its own: nothing but the picture is hpcomp's.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections import defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scenes import ASSIGNMENTS, PALETTES, SCENES, Scene, colors_of, decoded, linear

Plane = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: The methods by name, as options of `hpcomp stack`.
METHODS: dict[str, dict[str, Any]] = {
    "ordinary blending": {"blending": "traditional"},
    "foremost": {"blending": "foremost"},
    "⊕ as published": {"preset": "paper"},
    "⊕ simultaneous": {"order": "simultaneous"},
    "labels": {"preset": "labels"},
    "labels, bias 0": {"preset": "labels", "gray_bias": 0.0},
    "labels, bias 0.5": {"preset": "labels", "gray_bias": 0.5},
    "labels, perceived": {"preset": "labels", "strength": "perceived"},
    "labels, chroma": {"preset": "labels", "strength": "chroma"},
    "labels, bottom-up": {"preset": "labels", "order": "bottom-up"},
    "labels, cielab": {"preset": "labels", "space": "cielab"},
    "labels, linear-rgb": {"preset": "labels", "space": "linear-rgb"},
    "woven": {"preset": "woven"},
    "woven, chroma": {"preset": "woven", "strength": "chroma"},
    "woven, perceived": {"preset": "woven", "strength": "perceived"},
    "woven, oklab": {"preset": "woven", "space": "oklab"},
    "woven, size 4": {"preset": "woven", "weave_size": 4},
    "woven, size 16": {"preset": "woven", "weave_size": 16},
    "woven, noise 2": {"preset": "woven", "weave": "noise", "weave_size": 2},
    "woven, noise 4": {"preset": "woven", "weave": "noise", "weave_size": 4},
    "woven, noise 8": {"preset": "woven", "weave": "noise", "weave_size": 8},
}
ORDINARY = "ordinary blending"
#: What no rule that shows one hue at a pixel can surpass: only the label that covers most is in
#: colour, the others are greys of their luminance, in Oklab.
BEST = "only what covers most"
#: The rows of the short table.
SHORT = (ORDINARY, "foremost", "⊕ as published", "labels", "woven", BEST)

#: The weighted chroma of a label in linear RGB from which on it is there to be seen.
PRESENT = 0.02
#: The weight times alpha of a label from which on there is anything of it.
TRACE = 1e-4
#: The Oklab chroma below which a colour is grey.
GREY = 0.02
#: How far from a label's hue a hue still is this label's, in degrees.
SAME_HUE = 4.0
#: Where 8 bits turn a hue by more than this, in degrees, no hue is read.
MOST_TURN = 20.0
WINDOW = 11

# Oklab: Ottosson 2020. Luminance: Rec. 709.
LMS = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def oklab(rgb: Plane) -> Plane:
    """Linear RGB (…, 3) as L, a, b."""
    return np.cbrt(rgb @ LMS.T) @ LAB.T


def hue(rgb: Plane) -> Plane:
    """The Oklab hue (…) of linear RGB (…, 3), in degrees."""
    lab = oklab(rgb)
    return np.degrees(np.arctan2(lab[..., 2], lab[..., 1]))


def apart(first: Plane, second: Plane | float) -> Plane:
    """The angle between hues, 0 to 180 degrees."""
    return np.abs((first - second + 180) % 360 - 180)


@dataclass(frozen=True)
class Seen:
    """What is seen of a picture: its distinct colours, and which of them each pixel has.

    `codes` (n, 3) 8-bit; `rgb` (n, 3) linear; `hue` (n) in degrees; `chroma` (n) in Oklab; `turn`
    (n): by how many degrees the rounding to codes may have turned the hue. `at` (height, width).
    """

    codes: NDArray[np.int64]
    rgb: Plane
    hue: Plane
    chroma: Plane
    turn: Plane
    at: NDArray[np.intp]


def seen(path: Path) -> Seen:
    """Reads a picture; where it is transparent it is seen on white, as viewers show it."""
    from PIL import Image

    with Image.open(path) as image:
        picture = image.convert("RGBA")
        white = Image.new("RGBA", image.size, "white")
    pixels = np.asarray(Image.alpha_composite(white, picture).convert("RGB")).astype(np.int64)
    packed = (pixels[..., 0] << 16) | (pixels[..., 1] << 8) | pixels[..., 2]
    distinct, at = np.unique(packed, return_inverse=True)
    codes = np.stack([distinct >> 16, (distinct >> 8) & 255, distinct & 255], axis=-1)
    rgb = decoded(codes / 255)
    lab = oklab(rgb)
    hues = hue(rgb)
    turn = np.zeros(len(codes))
    for channel in range(3):
        step = 0.5 * (np.arange(3) == channel)
        turn += np.maximum(*(apart(hue(decoded((codes + s * step) / 255)), hues) for s in (-1, 1)))
    chroma = np.hypot(lab[:, 1], lab[:, 2])
    return Seen(codes, rgb, hues, chroma, turn, at.reshape(pixels.shape[:2]))


@dataclass(frozen=True)
class Labels:
    """What the layers say: (n, height, width) each, of n labels.

    `present`: where the label is there to be seen; `touched`: where there is anything of it.
    `covering` (height, width): the present label that covers most. `overlap`: where two are present.
    `colors` (n, 3): linear.
    """

    present: Mask
    touched: Mask
    covering: NDArray[np.intp]
    overlap: Mask
    colors: Plane


def labels_of(scene: Scene, colors: Sequence[str]) -> Labels:
    """The labels of a scene in these colours, stacked with `over`."""
    rgb = np.stack([linear(color) for color in colors])
    covers = np.empty_like(scene.alpha)
    above = np.ones_like(scene.ground)
    for number in reversed(range(len(covers))):
        covers[number] = above * scene.alpha[number]
        above = above * (1 - scene.alpha[number])
    chroma = covers * np.linalg.norm(rgb - (rgb @ LUMINANCE)[:, None], axis=1)[:, None, None]
    present = chroma > PRESENT
    return Labels(
        present,
        covers > TRACE,
        np.where(present, covers, 0).argmax(axis=0),
        present.sum(axis=0) >= 2,
        rgb,
    )


def hues_of(labels: Labels, picture: Seen) -> Mask:
    """(n, colours): whether a colour has the hue of a label, 8 bits allowed for.

    That is its Oklab hue, or the one that its light takes when just so much grey light is added
    that it is as saturated as the colour: what the label looks like alone, as ink on paper does.
    """
    luminance = picture.rgb @ LUMINANCE
    saturation = np.linalg.norm(picture.rgb - luminance[:, None], axis=1)
    saturation /= np.maximum(luminance, 1e-9)
    near = np.empty((len(labels.colors), len(luminance)), bool)
    for number, color in enumerate(labels.colors):
        direction = color - color @ LUMINANCE
        paled = 1 + saturation[:, None] * direction / np.linalg.norm(direction)
        distance = np.minimum(apart(picture.hue, hue(color)), apart(picture.hue, hue(paled)))
        near[number] = distance <= SAME_HUE + picture.turn
    return near


def through_window(labels: Labels, picture: Seen) -> tuple[Plane, Plane, float]:
    """(a): of each label the pixels where it is found, and all of its pixels; the foreign share."""
    from scipy.ndimage import maximum_filter

    has_hue, readable = hues_of(labels, picture), picture.turn <= MOST_TURN
    named = has_hue & readable
    found, pixels = np.zeros(len(named)), np.zeros(len(named))
    for number, present in enumerate(labels.present):
        in_window = maximum_filter(named[number][picture.at], size=WINDOW)
        found[number], pixels[number] = (present & in_window).sum(), present.sum()
    own = (has_hue[:, picture.at] & labels.touched).any(axis=0)
    colored = ((picture.chroma >= GREY) & readable)[picture.at]
    return found, pixels, float((colored & ~own).sum() / max(colored.sum(), 1))


def pixel_by_pixel(labels: Labels, picture: Seen) -> Plane:
    """(b): the shares of the overlaps that are named right, wrong, or seen as grey."""
    nearest = np.argmin([apart(picture.hue, hue(color)) for color in labels.colors], axis=0)
    at = picture.at[labels.overlap]
    grey = (picture.chroma < GREY)[at]
    right = (nearest[at] == labels.covering[labels.overlap]) & ~grey
    return np.array([right.mean(), (~right & ~grey).mean(), grey.mean()])


def luminance_differs(picture: Seen, other: Seen) -> float:
    """The share of pixels whose luminances differ by more than the rounding to codes explains."""

    def luminance_and_room(of: Seen) -> tuple[Plane, Plane]:
        low, high = (decoded(np.clip(of.codes + step, 0, 255) / 255) for step in (-0.5, 0.5))
        room = np.maximum(high - of.rgb, of.rgb - low) @ LUMINANCE
        return (of.rgb @ LUMINANCE)[of.at], room[of.at]

    (first, of_first), (second, of_second) = map(luminance_and_room, (picture, other))
    return float((np.abs(first - second) > 1.001 * (of_first + of_second) + 1e-6).mean())


@dataclass(frozen=True)
class Reading:
    """What was read in one picture.

    `found`: the share of all labels' pixels where they are found, and `least`: that of the label
    with the smallest. `foreign`: as a share of coloured pixels. `overlaps`: right, wrong, grey.
    `differs`: where luminance is not that of ordinary blending.
    """

    found: float
    least: float
    foreign: float
    overlaps: Plane
    differs: float


#: Of which scene, in which palette and assignment.
Case = tuple[str, str, int]


def cases(scenes: Sequence[str]) -> list[Case]:
    """All pictures of these scenes; one that has its own colours is drawn once."""
    assigned = [(palette, first) for palette in PALETTES for first in ASSIGNMENTS]
    return [
        (name, *how)
        for name in scenes
        for how in (assigned if not _scene(name).colors else [("its own", 0)])
    ]


@cache
def _scene(name: str) -> Scene:
    return next(make for make in SCENES if make.__name__ == name)()


def read_case(case: Case, methods: Sequence[str], keep: str | None) -> dict[str, Reading]:
    """Draws one case by each method, and reads the pictures. `keep`: a folder for contact sheets."""
    import hpcomp

    name, palette, first = case
    scene = _scene(name)
    colors = scene.colors or colors_of(palette, first, len(scene.alpha))
    labels, layers = labels_of(scene, colors), scene.layers(colors)
    with tempfile.TemporaryDirectory() as folder:
        files = _written(layers, folder, "layer")
        pictures = {}
        for method in dict.fromkeys((ORDINARY, *methods)):
            pictures[method] = Path(folder, f"{method}.png")
            if method == BEST:
                grey = _written(_only_covering(layers, labels), folder, "grey")
                hpcomp.stack(grey, pictures[method], threads=1, space="oklab")
            else:
                hpcomp.stack(files, pictures[method], threads=1, **METHODS[method])
        views = {method: seen(path) for method, path in pictures.items()}
        if keep and first == 0:
            _contact_sheet(Path(keep, f"{name} {palette}.png"), [pictures[m] for m in methods])
    readings = {}
    for method in methods:
        found, pixels, foreign = through_window(labels, views[method])
        readings[method] = Reading(
            float(found.sum() / pixels.sum()),
            float((found / np.maximum(pixels, 1))[pixels > 0].min()),
            foreign,
            pixel_by_pixel(labels, views[method]),
            luminance_differs(views[method], views[ORDINARY]),
        )
    return readings


def _written(layers: Sequence[Plane], folder: str, name: str) -> list[str]:
    import hpcomp

    paths = [os.path.join(folder, f"{name}{number}.exr") for number in range(len(layers))]
    for path, layer in zip(paths, layers, strict=True):
        hpcomp.write_image(path, layer, depth="float", compression="none")
    return paths


def _only_covering(layers: Sequence[Plane], labels: Labels) -> list[Plane]:
    """The layers, the ground first, with each label in colour only where it covers most."""
    drawn = [layers[0]]
    for number, layer in enumerate(layers[1:]):
        grey = layer.copy()
        grey[..., :3] = (layer[..., :3] @ LUMINANCE)[..., None]
        drawn.append(np.where((labels.covering == number)[..., None], layer, grey))
    return drawn


def _contact_sheet(path: Path, pictures: Sequence[Path]) -> None:
    """The pictures side by side, four in a row, each with its name above it."""
    from PIL import Image, ImageDraw

    images = []
    for picture in pictures:
        with Image.open(picture) as image:
            images.append(image.convert("RGB"))
    (width, height), line, columns = images[0].size, 14, 4
    rows = -(-len(images) // columns)
    sheet = Image.new("RGB", (columns * width, rows * (height + line)), "white")
    for number, (picture, image) in enumerate(zip(pictures, images, strict=True)):
        at = (number % columns * width, number // columns * (height + line))
        ImageDraw.Draw(sheet).text(at, picture.stem.replace("⊕", "(+)"), fill="black")
        sheet.paste(image, (at[0], at[1] + line))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)


def percent(value: float) -> str:
    """A share in percent with one decimal; what is not all is never shown as 100."""
    shown = 100 * value
    return f"{min(shown, 99.9) if value < 1 else shown:.1f}"


def whole_table(readings: Mapping[str, Mapping[str, Sequence[Reading]]]) -> str:
    """Markdown: a row for each scene and method; `readings` by method and scene."""
    lines = [
        "| scene | method | found | least label | foreign | right / wrong / grey | other luminance |",
        "|---|---|---|---|---|---|---|",
    ]
    for scene in next(iter(readings.values())):
        for method, of_scene in readings.items():
            own = of_scene[scene]
            overlaps = np.mean([reading.overlaps for reading in own], axis=0)
            cells = [
                percent(float(np.mean([reading.found for reading in own]))),
                percent(min(reading.least for reading in own)),
                f"{100 * np.mean([reading.foreign for reading in own]):.2f}",
                " / ".join(f"{100 * share:.1f}" for share in overlaps),
                f"{100 * max(reading.differs for reading in own):.2f}",
            ]
            lines.append(f"| {scene} | {method} | {' | '.join(cells)} |")
    return "\n".join(lines)


def short_table(readings: Mapping[str, Mapping[str, Sequence[Reading]]]) -> str:
    """Markdown: a row for each method; the pictures of a scene count as one, and scenes alike."""
    lines = ["| method | found | foreign | right / wrong / grey |", "|---|---|---|---|"]
    for method in (name for name in SHORT if name in readings):
        found, foreign, *overlaps = np.mean(
            [
                np.mean([(r.found, r.foreign, *r.overlaps) for r in own], axis=0)
                for own in readings[method].values()
            ],
            axis=0,
        )
        shares = " / ".join(f"{100 * share:.0f}" for share in overlaps)
        lines.append(f"| {method} | {percent(found)} | {100 * foreign:.1f} | {shares} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    names = [make.__name__ for make in SCENES]
    parser.add_argument("--only", action="append", choices=[*METHODS, BEST], metavar="METHOD")
    parser.add_argument("--scene", action="append", choices=names)
    parser.add_argument("--pictures", metavar="DIRECTORY", help="save contact sheets there")
    given = parser.parse_args()
    methods, all_cases = given.only or [*METHODS, BEST], cases(given.scene or names)
    readings: dict[str, dict[str, list[Reading]]] = {m: defaultdict(list) for m in methods}
    with ProcessPoolExecutor() as processes:
        jobs = [processes.submit(read_case, case, methods, given.pictures) for case in all_cases]
        for case, job in zip(all_cases, jobs, strict=True):
            for method, reading in job.result().items():
                readings[method][case[0]].append(reading)
    print(short_table(readings), whole_table(readings), sep="\n\n")


if __name__ == "__main__":
    main()
