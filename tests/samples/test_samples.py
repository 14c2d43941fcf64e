"""The terrain sample: its layers, its commands, what its picture claims. Needs extra `samples`."""

import importlib.util
import os
import re
import shlex
import shutil
import stat
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from matplotlib.image import imread

import hpcomp

ROOT = Path(__file__).parents[2]
QUICKSTART = ROOT / "samples" / "quickstart.sh"
TERRAIN = ROOT / "samples" / "terrain"
LAYERS = TERRAIN / "layers"
COMMAND = Path(sys.executable).with_name("hpcomp")

CODE_VALUE = 1.001 / 255  # one step of 8 bits, and the rounding of the division that gave it

# Other releases of matplotlib set type a little differently; a missing caption is far more.
SHARE_OF_LETTERS = 0.02

# Half-float layers: their hue is off by about 2^-11 of a radian.
STORED_HUE_DEG = 0.05


def load_draw():
    spec = importlib.util.spec_from_file_location("draw", TERRAIN / "draw.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["draw"] = module  # where a dataclass looks its annotations up
    spec.loader.exec_module(module)
    return module


draw = load_draw()


def commands(text):
    """The `hpcomp` commands of a script or a page, split into words as a shell would."""
    joined = text.replace("\\\n", " ")
    return [shlex.split(line) for line in joined.splitlines() if line.startswith("hpcomp ")]


# ---- the layers ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """The layers drawn now, twice, by two processes side by side."""
    folders = [tmp_path_factory.mktemp("layers") for _ in range(2)]
    runs = [subprocess.Popen([sys.executable, TERRAIN / "draw.py", folder]) for folder in folders]
    assert [run.wait() for run in runs] == [0, 0]
    return folders


def premultiplied_png(path):
    """Encoded values times alpha (h, w, 4), 0-1: the colour of a transparent pixel says nothing."""
    pixels = imread(path).astype(np.float64)
    pixels[..., :3] *= pixels[..., 3:]
    return pixels


def test_drawing_twice_gives_the_same_bytes(drawn):
    first, second = ({p.name: p.read_bytes() for p in folder.iterdir()} for folder in drawn)
    assert first == second


def test_the_committed_layers_are_the_ones_that_the_script_draws(drawn):
    assert sorted(p.name for p in drawn[0].iterdir()) == sorted(p.name for p in LAYERS.iterdir())


@pytest.mark.parametrize("name", ["hillshade.png", "elevation.png", "streams.png", "captions.png"])
def test_png_layer_is_what_the_script_draws(drawn, name):
    now, committed = premultiplied_png(drawn[0] / name), premultiplied_png(LAYERS / name)
    assert now.shape == committed.shape
    off = (np.abs(now - committed) > CODE_VALUE).any(axis=-1)
    assert off.mean() <= (SHARE_OF_LETTERS if name == "captions.png" else 0)


@pytest.mark.parametrize("name", ["steep.exr", "summits.exr", "fault.exr"])
def test_exr_layer_is_what_the_script_draws(drawn, name):
    now, committed = (
        OpenEXR.File(str(folder / name), separate_channels=True) for folder in (drawn[0], LAYERS)
    )
    for window in ("dataWindow", "displayWindow"):
        assert np.array_equal(now.header()[window], committed.header()[window])
    assert sorted(now.channels()) == sorted(committed.channels()) == ["A", "B", "G", "R"]
    for channel, pixels in ((c, p.pixels) for c, p in committed.channels().items()):
        assert pixels.dtype == np.float16
        step = np.spacing(pixels).astype(np.float64)
        drawn_pixels = now.channels()[channel].pixels.astype(np.float64)
        assert np.all(np.abs(drawn_pixels - pixels.astype(np.float64)) <= step)


def test_one_layer_has_a_data_window_inside_its_display_window():
    header = OpenEXR.File(str(LAYERS / "fault.exr")).header()
    (left, top), (right, bottom) = header["dataWindow"]
    (outer_left, outer_top), (outer_right, outer_bottom) = header["displayWindow"]
    assert outer_left < left <= right < outer_right
    assert outer_top <= top <= bottom <= outer_bottom


@pytest.mark.parametrize("path", sorted(LAYERS.glob("*.png")), ids=lambda path: path.name)
def test_committed_png_names_no_software_and_no_date(path):
    data, at, chunks = path.read_bytes(), 8, set()
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        chunks.add(data[at + 4 : at + 8])
        at += length + 12
    assert chunks <= {b"IHDR", b"pHYs", b"IDAT", b"IEND"}


def test_the_sample_stays_small():
    sizes = [path.stat().st_size for path in [*LAYERS.iterdir(), TERRAIN / "terrain.png"]]
    assert max(sizes) <= 600_000
    assert sum(sizes) <= 1_500_000


# ---- the commands --------------------------------------------------------------------------------


def test_the_page_of_the_sample_shows_the_commands_of_quickstart():
    assert len(commands(QUICKSTART.read_text())) == 3
    assert commands((TERRAIN / "README.md").read_text()) == commands(QUICKSTART.read_text())


def test_the_readme_shows_no_other_terrain_commands():
    readme = (ROOT / "README.md").read_text()
    assert "sh samples/quickstart.sh" in readme
    shown = [words for words in commands(readme) if any("layers/" in word for word in words)]
    # The page works from the root of the checkout, the script from the folder of the sample.
    shown = [[word.replace("samples/terrain/", "") for word in words] for words in shown]
    assert [words for words in shown if words not in commands(QUICKSTART.read_text())] == []


def test_the_command_line_gives_streams_the_opacity_of_the_table():
    (layer,) = {w for c in commands(QUICKSTART.read_text()) for w in c if "streams" in w}
    assert layer == f"layers/streams.png::opacity={draw.LABELS['streams.png'].opacity}"


# An interpreter that makes a `.venv` around this one, without a network.
STAND_IN = """#!/bin/sh
case "$*" in
    "-m venv "*)
        mkdir -p "$3/bin"
        cp "$0" "$3/bin/python"
        printf '#!/bin/sh\\nexec "%s" "$@"\\n' '{command}' >"$3/bin/hpcomp"
        chmod +x "$3/bin/hpcomp" ;;
    "-m pip --version") ;;
    "-m pip install "*) [ "$PIP_USER" = 0 ] ;;
    *) exec "{python}" "$@" ;;
esac
"""


def executable(path, text):
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A checkout with a space in its path that holds the sample alone."""
    root = tmp_path_factory.mktemp("a checkout")
    shutil.copytree(TERRAIN, root / "samples" / "terrain", ignore=shutil.ignore_patterns("out"))
    shutil.copy(QUICKSTART, root / "samples")
    return root


def quickstart(checkout, python):
    return subprocess.run(
        ["sh", checkout / "samples" / "quickstart.sh"],
        cwd=checkout.parent,
        env={**os.environ, "PYTHON": str(python), "PIP_USER": "1"},
        capture_output=True,
        text=True,
    )


@pytest.fixture(scope="module")
def pictures(checkout, tmp_path_factory):
    """The folder of pictures that quickstart made, on its second run."""
    text = STAND_IN.format(command=COMMAND, python=sys.executable)
    stand_in = executable(tmp_path_factory.mktemp("bin") / "python3", text)
    for _ in range(2):
        run = quickstart(checkout, stand_in)
        assert (run.returncode, run.stderr) == (0, "")
    folder = checkout / "samples" / "terrain" / "out"
    assert str(folder) in run.stdout
    assert str(checkout / ".venv" / "bin") in run.stdout
    (command,) = re.findall(r"^ +(\.venv/bin/hpcomp .*\n)", run.stdout, re.MULTILINE)
    assert command in (ROOT / "README.md").read_text()  # where it is run
    return folder


def test_quickstart_makes_the_pictures_that_it_names(pictures):
    made = sorted(path.name for path in pictures.iterdir())
    assert made == ["hue-preserving.png", "side-by-side.png", "traditional.png"]


def test_quickstart_leaves_the_rest_of_the_checkout_alone(checkout, pictures):
    assert sorted(path.name for path in checkout.iterdir()) == [".venv", "samples"]
    assert sorted(p.name for p in (checkout / "samples").iterdir()) == ["quickstart.sh", "terrain"]


def test_the_committed_picture_is_what_hpcomp_makes(pictures):
    now, committed = imread(pictures / "side-by-side.png"), imread(TERRAIN / "terrain.png")
    assert now.shape == committed.shape
    assert np.abs(now - committed).max() <= CODE_VALUE


@pytest.mark.parametrize(
    ("python", "complaint"),
    [
        (None, "not found"),
        ('#!/bin/sh\n[ "$1" = --version ] && echo Python 3.10.1\nexit 1\n', "Python 3.10.1 is too"),
        ('#!/bin/sh\ncase "$2" in *ensurepip*) exit 1 ;; esac\n', "python3-venv"),
        ('#!/bin/sh\n[ "$2" != venv ] || { mkdir "$3"; exit 1; }\n', "could not make"),
    ],
    ids=["missing", "too old", "without venv", "half-way"],
)
def test_quickstart_says_what_to_do_about_an_unfit_python(tmp_path, python, complaint):
    (tmp_path / "samples" / "terrain").mkdir(parents=True)
    shutil.copy(QUICKSTART, tmp_path / "samples")
    stand_in = tmp_path / "python"
    if python is not None:
        executable(stand_in, python)
    run = quickstart(tmp_path, stand_in)
    assert run.returncode == 1
    assert re.fullmatch(f"quickstart: .*{complaint}.*\n", run.stderr)
    assert not (tmp_path / ".venv").exists()


# ---- the claims ----------------------------------------------------------------------------------


def hue_deg(rgb):
    """Angle of linear RGB (..., 3) around the grey axis at its luminance, in degrees."""
    weights = np.array([0.2126390058715103, 0.7151686787677559, 0.0721923153607337])
    right = np.array([1.0, 0, 0]) - weights * weights[0] / (weights @ weights)
    right /= np.linalg.norm(right)
    up = np.cross(weights / np.linalg.norm(weights), right)
    difference = rgb - (rgb @ weights)[..., None]
    return np.degrees(np.arctan2(difference @ up, difference @ right))


def on_canvas(name):
    layer = hpcomp.read_layer(str(LAYERS / name))
    canvas = np.zeros((draw.HEIGHT, draw.WIDTH, 4), np.float32)
    x, y = layer.data_window.x, layer.data_window.y
    height, width = layer.pixels.shape[:2]
    canvas[y : y + height, x : x + width] = layer.pixels
    return canvas


@pytest.fixture(scope="module")
def terrain():
    """The layers on one canvas, bottom first, the hillshade at the bottom."""
    return [on_canvas(name) for name in ("hillshade.png", *draw.LABELS)]


@pytest.fixture(scope="module")
def covers(terrain):
    """Where each label is (labels, h, w); the faintest rim of an edge does not count."""
    return np.stack([layer[..., 3] > 0.05 for layer in terrain[1:]])


@pytest.fixture(scope="module")
def distances(terrain):
    """By blending: degrees from the picture's hue to each label's (labels, h, w)."""
    opacity = [0.65 if name == "streams.png" else 1.0 for name in ("", *draw.LABELS)]
    labels = hue_deg(np.stack([draw.linear_rgb(label.color) for label in draw.LABELS.values()]))

    def distance(blending):
        picture = hpcomp.composite(terrain, opacity=opacity, blending=blending)[..., :3]
        angle = hue_deg(picture.astype(np.float64)) - labels[:, None, None]
        return np.abs((angle + 180) % 360 - 180)

    return {blending: distance(blending) for blending in ("traditional", "hue-preserving")}


def test_where_labels_overlap_hue_preserving_shows_one_of_them(covers, distances):
    overlap = covers.sum(axis=0) >= 2
    nearest = np.where(covers, distances["hue-preserving"], np.inf).min(axis=0)
    assert overlap.mean() > 0.3  # measured: 0.36 of the map
    assert nearest[overlap].max() < STORED_HUE_DEG  # measured: 0.005


def test_where_labels_overlap_traditional_shows_foreign_hues(covers, distances):
    overlap = covers.sum(axis=0) >= 2
    nearest = np.where(covers, distances["traditional"], np.inf).min(axis=0)
    assert np.mean(nearest[overlap] > 4) > 0.85  # measured: 0.90
    assert np.mean(nearest[overlap] > 8) > 0.75  # measured: 0.81


@pytest.mark.parametrize(
    ("mark", "below", "above", "kept", "mistaken"),
    [
        ("A", "elevation.png", "steep.exr", "steep.exr", "fault.exr"),
        ("B", "fault.exr", "streams.png", "streams.png", "summits.exr"),
        ("C", "steep.exr", "summits.exr", "summits.exr", None),
    ],
)
def test_the_captions_of_the_picture_are_true(
    terrain, distances, mark, below, above, kept, mistaken
):
    names = list(draw.LABELS)
    x, y = draw.MARKS[mark]
    rows, columns = np.ogrid[: draw.HEIGHT, : draw.WIDTH]
    ring = np.hypot(columns - x, rows - y) < 15
    both = ring.copy()
    for name in (below, above):  # not the smooth edges: there the label ends, and so does its hue
        alpha = terrain[1 + names.index(name)][..., 3]
        both &= alpha > 0.98 * alpha.max()
    assert both.sum() > 50
    traditional, hue_preserving = (distances[b][:, both] for b in ("traditional", "hue-preserving"))
    assert np.mean(hue_preserving[names.index(kept)] < STORED_HUE_DEG) > 0.9
    if mistaken:
        assert np.mean(traditional.argmin(axis=0) == names.index(mistaken)) > 0.9
    else:
        assert np.mean(traditional.min(axis=0) > 10) > 0.9
