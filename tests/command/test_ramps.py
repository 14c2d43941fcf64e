"""Where hues of one layer run across a hue of another, ⊕ makes a ring: what `check` says of it."""

import colorsys
import json
import re
import warnings
from pathlib import Path

import command
import numpy as np
import pngfile
import pytest
from PIL import Image, ImageDraw

import hpcomp
from hpcomp.measures import ramps

SIZE = 160, 120
BASE_HUE = 40
FROM, TO = 36, 44
#: Shadings of one label differ by rounding alone. The palest of them are named as the hardest.
LABELS = ["#9ebcda", "#d2b48c", "#ffdd00", "#0050ff", "#bebada", "#fccde5", "#ccebc5", "#e8eef4"]


def of_hue(degrees):
    """Linear RGB of HSL, of half the largest brightness."""
    return np.array(colorsys.hsv_to_rgb(degrees / 360, 1, 0.5), np.float32)


def put(path, rgb, alpha=1.0, depth=None):
    """Linear RGB, (w, 3) or (h, w, 3), as a layer of one alpha over all of the canvas."""
    pixels = np.empty((*SIZE[::-1], 4), np.float32)
    pixels[..., :3], pixels[..., 3] = alpha * np.asarray(rgb), alpha
    hpcomp.write_image(path, pixels, depth=depth)


def run_of_hues(first, last):
    return np.array([of_hue(hue) for hue in np.linspace(first, last, SIZE[0])])


@pytest.fixture
def desk(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    put("base.exr", np.broadcast_to(of_hue(BASE_HUE), (SIZE[0], 3)))
    put("base.png", np.broadcast_to(of_hue(BASE_HUE), (SIZE[0], 3)))
    put("ramp.exr", run_of_hues(FROM, TO), 0.5)
    put("ramp.png", run_of_hues(FROM, TO), 0.5)
    return tmp_path


def checked(layers, **options):
    """(the ramps that a check of the stack finds, what it warns of)."""
    hpcomp.stack(layers, "out.png", **options)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = hpcomp.check("out.png", layers, max_foreign=1, **options)
    return found.ramps, [str(w.message) for w in caught]


def vividness(**options):
    """max − min of each column of the picture that the ramp gives over the base."""
    hpcomp.stack(["base.exr", "ramp.exr"], "out.exr", depth="float", **options)
    rgb = hpcomp.read_layer("out.exr").pixels[0, :, :3]
    return rgb.max(axis=1) - rgb.min(axis=1)


#: What the manual names against the ring.
REMEDIES = {"hue_tolerance": 30.0}, {"blending": "foremost"}, {"blending": "traditional"}


def test_the_picture_has_a_ring_and_what_is_advised_has_none(desk):
    ring = vividness()
    assert ring.max() == pytest.approx(0.5, abs=0.01)
    assert ring[[0, -1]] == pytest.approx([0.01, 0.01], abs=0.01)
    for remedy in REMEDIES:
        even = vividness(**remedy)
        assert np.ptp(even) < 0.01
        assert even.min() > 0.2
    # At 0 it is grey but for the columns of exactly that hue, of which there is none here.
    assert vividness(hue_tolerance=0.0).max() < 0.02


@pytest.mark.parametrize("ending", ["exr", "png"])
@pytest.mark.parametrize("space", ["linear-rgb", "oklab", "hsl"])
@pytest.mark.parametrize("turned", [False, True], ids=["above", "below"])
def test_a_ramp_that_crosses_a_hue_is_warned_of(desk, ending, space, turned):
    layers = [f"base.{ending}", f"ramp.{ending}"]
    if turned:
        layers = [f"ramp.{ending}", f"base.{ending}::opacity=0.5"]
    (ramp,), (warning,) = checked(layers, space=space)
    assert (ramp.lower, ramp.upper, ramp.pixels) == (0, 1, SIZE[0] * SIZE[1])
    assert 0.3 < ramp.vivid_share < 0.6
    for text in (f"layer 0 ({layers[0]})", layers[1].partition("::")[0], "within 2°",
                 "--hue-tolerance 30", "foremost"):  # fmt: skip
        assert text in warning


@pytest.mark.parametrize("remedy", [*REMEDIES, {"hue_tolerance": 0.0}], ids=str)
def test_a_stack_without_the_ring_is_not_warned_of(desk, remedy):
    assert checked(["base.png", "ramp.png"], **remedy) == ((), [])


@pytest.mark.parametrize("tolerance", [1.0, 2.0, 5.0])
def test_a_ramp_of_all_hues_is_warned_of(desk, tolerance):
    wheel = run_of_hues(0, 360)
    put("wheel.png", wheel, 0.5)
    put("label.png", np.broadcast_to(of_hue(BASE_HUE), (SIZE[0], 3)))
    found, _ = checked(["label.png", "wheel.png"], hue_tolerance=tolerance)
    assert len(found) == (tolerance > 1)  # at 1° a zone is narrower than a column


def test_a_ramp_over_the_background_is_warned_of(desk):
    color = 255 * pngfile.linear_to_srgb(of_hue(BASE_HUE).astype(float))
    background = "#" + "".join(f"{round(c):02x}" for c in color)
    (ramp,), (warning,) = checked(["ramp.png"], background=background)
    assert (ramp.lower, ramp.upper) == (0, 1)
    assert "the background" in warning


def test_it_is_in_the_json_and_an_error_with_strict(desk):
    hpcomp.stack(["base.png", "ramp.png"], "out.png")
    words = ["check", "out.png", "base.png", "ramp.png", "--max-foreign", "1"]
    run = command.hpcomp(*words, "--format", "json", cwd=desk)
    assert run.code == 0
    assert run.lines[0].startswith("hpcomp: warning: hues of layer 0 (base.png)")
    (ramp,) = json.loads(run.stdout)["ramps"]
    assert ramp.keys() == {"lower", "upper", "pixels", "vivid_share"}
    assert command.hpcomp(*words, "--strict", cwd=desk).code == 4


# ---- what is no ramp -----------------------------------------------------------------------------


@pytest.mark.parametrize("label", LABELS)
def test_shadings_of_one_label_in_8_bits_are_no_ramp(desk, label):
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    light = pngfile.srgb_to_linear(np.array([int(label[n : n + 2], 16) for n in (1, 3, 5)]) / 255)
    for name, wave, alpha in (
        ("below", np.sin(x / 9) * np.cos(y / 7), 1),
        ("above", np.sin(x / 5 + 1) * np.cos(y / 11), 0.5),
    ):
        put(f"{name}.png", light * (0.575 + 0.425 * wave[..., None]), alpha)
    assert checked(["below.png", "above.png"]) == ((), [])


@pytest.mark.parametrize("apart", [1, 3, 5, 60])
@pytest.mark.parametrize("ending", ["exr", "png"])
def test_flat_labels_are_no_ramp_however_near(desk, apart, ending):
    put(f"flat.{ending}", np.broadcast_to(of_hue(BASE_HUE + apart), (SIZE[0], 3)), 0.5)
    assert checked([f"base.{ending}", f"flat.{ending}"]) == ((), [])


@pytest.mark.parametrize("over", ["#ff4d00", "#ffb000", "#e41a1c", "#7a4fa8"])
def test_smooth_edges_of_a_flattened_chart_are_no_ramp(desk, over):
    large = Image.new("RGB", tuple(4 * side for side in SIZE), "black")
    draw, random = ImageDraw.Draw(large), np.random.default_rng(0)
    colors = ["#e41a1c", "#377eb8", "#4daf4a", "#984ea3", "#ff7f00", "#ffff33"]
    for n in range(60):
        x, y = random.integers(0, large.size)
        radius = random.integers(20, 90)
        draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=colors[n % 6])
    large.resize(SIZE).save("chart.png")
    Image.new("RGB", SIZE, over).save("label.png")
    assert checked(["label.png", "chart.png::opacity=0.5"]) == ((), [])


def test_noise_of_a_grey_picture_is_no_ramp(desk):
    random = np.random.default_rng(0)
    grey = random.normal(128, 30, (*SIZE[::-1], 1)) + random.normal(0, 6, (*SIZE[::-1], 3))
    Image.fromarray(np.clip(grey, 0, 255).astype(np.uint8)).save("noisy.png")
    assert checked(["base.png", "noisy.png::opacity=0.5"]) == ((), [])


# ---- what is counted -----------------------------------------------------------------------------


def test_only_pairs_that_are_in_every_zone_are_ramps():
    def found(*zones, beyond=0):
        counts = dict(enumerate((*zones, beyond)))
        return list(ramps.ramps(ramps.Meetings({(0, 1, n): c for n, c in counts.items()}), 2.0))

    assert found(200, 100, 100) == [ramps.Ramp(0, 1, 400, 200)]
    assert found(200, 100, 0) == found(0, 100, 100) == found(200, 0, 100) == []
    assert found(2000, 150, 150) == []  # tails
    assert found(15, 15, 15) == []
    assert found(100, 100, 100, beyond=10**5) == []
    assert len(found(100, 100, 100, beyond=20000)) == 1


def test_the_manual_says_what_is_advised():
    page = (Path(__file__).parents[2] / "man" / "hpcomp-blending.7.md").read_text(encoding="utf-8")
    section = re.search(r"^## Photographs and colormaps\n(.*?)^## ", page, re.M | re.S)[1]
    for words in ("--hue-tolerance 30", "--hue-tolerance 0", "--blending foremost", "`hpcomp check`"):
        assert words in section
