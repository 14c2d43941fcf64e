"""The figures of the paper, samples/paper: a smaller build of them, and what each of them claims."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from command import COMMAND, PATIENCE_S, snapshot
from test_memory import run as measured_run

import hpcomp

ROOT = Path(__file__).parent.parent
PAPER = ROOT / "samples" / "paper"
PAGE = (PAPER / "README.md").read_text(encoding="utf-8")

SIZE, SLICES = 128, 64

# A label's hue: peaks are means of bins of 1°, and half floats are off by up to 0.1°.
HUE_DEG = 0.7

# A half float has 11 bits; two results that are equal before rounding differ by one step.
HALF_STEP = 2.0**-10

# How far a number of the page, of 512×512×256, may be from that of the small build: edges, where
# labels mix, take up more of a small picture.
SHARE_OF_SIZE = 0.2

# The page rounds hues to whole degrees, and in Oklab what is brought into gamut may turn by 1.5°.
PAGE_HUE_DEG = 2.5


def load(name):
    """A script of the sample as a module."""
    spec = importlib.util.spec_from_file_location(name, PAPER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses and the other scripts look it up
    spec.loader.exec_module(module)
    return module


load("phantoms")
slices = load("slices")
flat = load("flat")
page = load("page")


def make(out, *words, hpcomp_command=COMMAND, size=SIZE, count=SLICES):
    return subprocess.run(
        ["make", "-C", PAPER, f"OUT={out}", f"SIZE={size}", f"SLICES={count}",
         f"HPCOMP={hpcomp_command}", f"PYTHON={sys.executable}", *words],
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "MAKEFLAGS": ""},
        capture_output=True, text=True, timeout=PATIENCE_S,
    )  # fmt: skip


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Where the small build is."""
    out = tmp_path_factory.mktemp("paper") / "out"
    done = make(out, "-j2")
    assert (done.returncode, done.stderr) == (0, "")
    return out


@pytest.fixture(scope="module")
def report(built):
    """report(NAME): that JSON document."""
    return lambda name: json.loads((built / f"{name}.json").read_text())


@pytest.fixture(scope="module")
def pixels(built):
    """pixels(NAME): RGBA of that EXR, its data window."""
    return lambda name: hpcomp.read_layer(str(built / f"{name}.exr")).pixels


# ---- what reports say ----------------------------------------------------------------------------


def foreign(document, side="result"):
    return document["measures"][side]["foreign_share"]


def lost(document, side="result"):
    return document["measures"][side]["lost_to_grey"]


def energy(document, side="result"):
    return document["measures"][side]["energy"]


def between(document, side, low, high):
    """The share of coloured pixels whose hue lies between these, in degrees, going up."""
    bins = document[side]["histogram"]
    hues, counts = np.array(bins["hue"]), np.array(bins["count"])
    return counts[(hues - low) % 360 <= (high - low) % 360].sum() / counts.sum()


def hsl_hue(color):
    """Of a linear colour, in degrees."""
    red, green, blue = (float(v) for v in color)
    most, least = max(red, green, blue), min(red, green, blue)
    spread = most - least
    if most == red:
        return 60 * ((green - blue) / spread) % 360
    if most == green:
        return 60 * ((blue - red) / spread + 2)
    return 60 * ((red - green) / spread + 4)


def assert_hues(document, colors):
    """The hue-preserving result has the hues of these linear colours, no other and no fewer."""
    expected = sorted(hsl_hue(color) for color in colors)
    apart = np.abs(
        np.subtract.outer(expected, [peak["hue"] for peak in document["result"]["peaks"]])
    )
    apart = np.minimum(apart, 360 - apart)
    assert apart.min(axis=0).max() < HUE_DEG
    assert apart.min(axis=1).max() < HUE_DEG
    assert foreign(document) == 0
    assert document["result"]["concentration"]["share"] > 0.995


def labels_of(volume):
    return [slices.linear_rgb(material.color) for material in slices.VOLUMES[volume].materials]


# ---- the figures ---------------------------------------------------------------------------------


@pytest.mark.parametrize("pair", ["a", "b"])
def test_figures_2_and_4_between_two_hues(report, pair):
    found = report(f"profiles-{pair}")
    assert foreign(found, "traditional") > 0.5
    assert_hues(found, flat.PAIRS[pair])


def test_figure_2_has_yellow_between_teal_and_orange_only_in_traditional_blending(report):
    found = report("profiles-a")
    assert between(found, "traditional", 25, 90) > 0.1
    assert between(found, "result", 25, 90) == 0


@pytest.mark.parametrize("pair", ["c", "d", "e"])
def test_figure_4_opposite_and_equal_hues_blend_as_in_traditional_blending(report, pixels, pair):
    found = report(f"profiles-{pair}")
    assert foreign(found) == foreign(found, "traditional") == 0
    left = list(flat.PAIRS).index(pair) * flat.pair_width(SIZE)
    bar = np.s_[:, left : left + flat.bar_width(SIZE)]
    both = [pixels(name)[bar] for name in ("profiles", "profiles-traditional")]
    assert np.abs(both[0] - both[1]).max() <= HALF_STEP


def test_figure_5_lights(report):
    found = report("lights")
    assert_hues(found, flat.LIGHTS.values())
    for mixed in (60, 180, 300):  # yellow, cyan, magenta
        assert between(found, "traditional", mixed - 20, mixed + 20) > 0.03
    assert foreign(found, "traditional") > 0.3


@pytest.mark.parametrize("count", [2, 3, 4])
def test_figure_6_what_can_be_reached(report, count):
    found = report(f"mixtures-{count}")
    assert_hues(found, [slices.linear_rgb(color) for color in list(flat.LABELS.values())[:count]])
    assert foreign(found, "traditional") > 0.7
    assert found["traditional"]["peaks"] == []


def test_figure_6_more_labels_reach_more_hues_in_traditional_blending(report):
    taken = [report(f"mixtures-{n}")["traditional"]["concentration"]["occupied"] for n in (2, 3, 4)]
    assert taken[0] < taken[1]
    assert taken[1:] == [360, 360] or taken[1] < taken[2]


@pytest.mark.parametrize(
    ("volume", "least_foreign"),
    [("tomato", 0.35), ("tooth", 0.5), ("fish", 0.3), ("piggy-bank", 0.08)],
)
def test_volumes_keep_the_hues_of_their_labels(report, volume, least_foreign):
    found = report(volume)
    assert_hues(found, labels_of(volume))
    assert foreign(found, "traditional") > least_foreign


def test_figure_1_peel_and_flesh_are_one_red_orange_in_traditional_blending(report):
    peel, flesh, _ = (hsl_hue(color) for color in labels_of("tomato"))
    found = report("tomato")
    assert between(found, "traditional", peel + 3, flesh - 1) > 0.4
    assert between(found, "result", peel + 3, flesh - 1) == 0


def test_figure_7_orange_and_purple_are_in_the_traditional_tooth_alone(report):
    yellow, red, blue = (hsl_hue(color) for color in labels_of("tooth"))
    found = report("tooth")
    for low, high in ((red + 4, yellow - 4), (blue + 4, red - 4)):
        assert between(found, "traditional", low, high) > 0.15
        assert between(found, "result", low, high) == 0


def test_figure_11_coins_are_violet_in_traditional_blending(report):
    purple, blue = (hsl_hue(color) for color in labels_of("piggy-bank"))
    found = report("piggy-bank")
    assert between(found, "traditional", blue + 3, purple - 3) > 0.08
    assert between(found, "result", blue + 3, purple - 3) == 0
    assert between(found, "traditional", blue - 2, blue + 2) < 0.02
    assert between(found, "result", blue - 2, blue + 2) > 0.1


def test_figure_8_opposite_colours_are_the_same_in_both(report, pixels):
    found = report("chest-opposite")
    assert_hues(found, labels_of("chest-opposite"))
    assert foreign(found, "traditional") == 0
    both = [pixels(name) for name in ("chest-opposite", "chest-opposite-traditional")]
    assert np.abs(both[0] - both[1]).max() <= HALF_STEP


def test_figure_8_flesh_towards_cyan_turns_green_in_traditional_blending_alone(report):
    found = report("chest-cyan")
    assert_hues(found, labels_of("chest-cyan"))
    assert between(found, "traditional", 64, 195) > 0.3
    assert between(found, "result", 64, 195) == 0


def test_figure_9_from_red_to_green_through_grey_not_through_yellow(report):
    found = [report(f"brain-{opacity}") for opacity in page.OPACITIES]
    assert [foreign(document) for document in found] == [0] * 5
    for document in found:
        assert between(document, "result", 2, 118) == 0
        assert between(document, "result", 122, 358) == 0
    assert between(found[0], "result", 358, 2) == 1
    assert between(found[-1], "result", 118, 122) == 1
    # Grey in between: what is lost rises, then falls.
    losses = [lost(document) for document in found]
    turn = losses.index(max(losses))
    assert 0 < turn < 4
    assert losses == sorted(losses[:turn]) + sorted(losses[turn:], reverse=True)
    assert losses[turn] > 0.7
    # The same opacities pass orange, yellow and yellow-green in traditional blending.
    hues = [
        np.average(d["traditional"]["histogram"]["hue"], weights=d["traditional"]["histogram"]["count"])
        for d in found
    ]
    assert hues == sorted(hues)
    assert hues[0] < 20
    assert hues[-1] > 75
    assert any(30 < hue < 75 for hue in hues)
    assert all(between(document, "traditional", 5, 115) > 0.9 for document in found[1:])


def test_figure_14_an_energy_aware_palette(report, pixels):
    found = report("tooth-energy")
    assert_hues(found, labels_of("tooth-energy"))
    assert foreign(found, "traditional") > 0.4
    assert energy(found) < energy(found, "traditional") < energy(report("tooth"), "traditional")
    weights = found["measures"]["energy_weights"]
    assert weights == [0.3, 0.25, 0.45]
    for name, side in (("tooth-energy", "result"), ("tooth-energy-traditional", "traditional")):
        by_hand = (pixels(name)[..., :3].astype(float) @ weights).sum()
        assert by_hand == pytest.approx(energy(found, side), rel=1e-3)


def test_figure_14_the_palette_is_of_one_luminance():
    luminances = [flat.LUMINANCE @ color for color in labels_of("tooth-energy")]
    assert max(luminances) / min(luminances) < 1.02


def test_figure_15_what_is_done_about_grey(report):
    plain, bias, together = (
        [lost(report(f"{name}-{part}")) for part in ("two", "four")]
        for name in ("grey", "grey-bias", "grey-simultaneous")
    )
    assert bias[0] < 0.7 * plain[0]
    assert bias[1] < 0.7 * plain[1]
    assert together[0] == pytest.approx(plain[0], abs=1e-6)
    assert together[1] < 0.9 * plain[1]
    for name in ("grey", "grey-bias", "grey-simultaneous"):
        assert foreign(report(name)) == 0


def test_figure_15_the_middle_of_every_row_of_two_has_the_same_grey(pixels):
    found = pixels("grey")[..., :3].astype(float)
    for row in range(3):
        line = found[row * SIZE // 8 + SIZE // 32]
        saturation = np.ptp(line, axis=-1) / line.max(axis=-1)
        assert saturation.min() < 4 / line.shape[0]  # a step of the bar or two from grey


def test_the_order_decides_among_three(report, pixels):
    found = {order: pixels(f"orders-{order}") for order in page.LAST}
    middle = {order: hsl_hue(p[SIZE // 4 + 1, SIZE // 4, :3]) for order, p in found.items()}
    for order, last in page.LAST.items():
        light = hsl_hue(flat.RIVALS[last])
        assert abs((middle[order] - light + 180) % 360 - 180) < HUE_DEG
        assert_hues(report(f"orders-{order}"), flat.RIVALS.values())
        assert report(f"orders-{order}")["measures"]["order_sensitivity"] > 0.1
    for one, other in (("0-1-2", "1-0-2"), ("0-2-1", "2-0-1"), ("1-2-0", "2-1-0")):
        assert np.array_equal(found[one], found[other])


def test_simultaneous_prefers_no_order(built, report, pixels, tmp_path):
    document = report("orders-simultaneous")
    assert_hues(document, flat.RIVALS.values())
    middle = pixels("orders-simultaneous")[SIZE // 4 + 1, SIZE // 4, :3].astype(float)
    assert np.ptp(middle) < 0.01
    layers = [built / "layers" / "orders" / f"{name}.exr" for name in reversed(flat.RIVALS)]
    hpcomp.stack(layers, tmp_path / "turned.exr", op="plus", order="simultaneous")
    turned = hpcomp.read_layer(str(tmp_path / "turned.exr")).pixels
    assert np.abs(turned - pixels("orders-simultaneous")).max() <= HALF_STEP


def test_the_tooth_in_oklab(report):
    found = report("tooth-oklab")
    assert found["space"] == "oklab"
    assert foreign(found) == 0
    assert foreign(found, "traditional") > 0.4
    # The hues of the labels in Oklab, as hpcomp measures them.
    alone = [
        hpcomp.hue_histogram(np.append(color, 1.0)[None], space="oklab").peaks[0].hue
        for color in labels_of("tooth")
    ]
    assert sorted(peak["hue"] for peak in found["result"]["peaks"]) == pytest.approx(
        sorted(alone), abs=1.5
    )


def test_foremost_is_not_stable(report, pixels):
    green = hsl_hue(slices.linear_rgb("#00c850"))
    without, behind, kept = (report(name) for name in ("foremost", "foremost-veil", "veil"))
    assert between(without, "result", green - 5, green + 5) == 0
    assert between(behind, "result", green - 5, green + 5) > 0.3
    assert between(kept, "result", green - 5, green + 5) == 0
    # A hundredth of opacity takes the right half's colours away, and nothing else does.
    before, after = pixels("foremost").astype(float), pixels("foremost-veil").astype(float)
    right = np.s_[:, SIZE // 4 :]
    assert np.ptp(before[right][..., :3], axis=-1).max() > 0.5
    assert np.ptp(after[right][..., :3], axis=-1).max() < 0.02
    assert np.array_equal(before[:, : SIZE // 4], after[:, : SIZE // 4])


def test_foremost_turns_a_volume_grey(report):
    assert lost(report("tooth-foremost")) > 0.9


# ---- layers --------------------------------------------------------------------------------------


@pytest.mark.parametrize("volume", ["tomato", "tooth", "fish", "piggy-bank"])
def test_slices_have_the_hues_of_their_labels_alone(built, report, volume):
    expected = [hsl_hue(color) for color in labels_of(volume)]
    peaks = [peak["hue"] for layer in report(volume)["layers"] for peak in layer["peaks"]]
    assert len(report(volume)["layers"]) == SLICES
    for hue in peaks:
        assert min(abs((hue - label + 180) % 360 - 180) for label in expected) < HUE_DEG


def test_slices_are_half_float_and_premultiplied(built):
    for path in sorted((built / "layers" / "tooth").iterdir())[:: SLICES // 4]:
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
        assert sorted(channels) == ["A", "B", "G", "R"]
        assert {channel.pixels.dtype for channel in channels.values()} == {np.dtype("float16")}
        alpha = channels["A"].pixels
        assert all((channels[name].pixels <= alpha).all() for name in "RGB")


def test_drawing_twice_gives_the_same_bytes(built, tmp_path):
    names = [f"layers/tomato/{SLICES // 2:03}.exr", "layers/frog-brain/010.exr",
             "layers/sheet-tomato.png", "layers/sheet-grey.png",
             *(f"layers/{f}/{n}.exr" for f, n in (
                 ("profiles", "front"), ("lights", "red"), ("mixtures", "blue"), ("grey", "first"),
                 ("orders", "red"), ("discs", "veil")))]  # fmt: skip
    out = tmp_path / "again"
    done = make(out, *(out / name for name in names))
    assert (done.returncode, done.stderr) == (0, "")
    drawn = [path for path in sorted(out.rglob("*")) if path.suffix in (".exr", ".png")]
    assert len(drawn) > SLICES
    for path in drawn:
        assert path.read_bytes() == (built / path.relative_to(out)).read_bytes(), path


def test_palette_and_layers_of_figure_6_have_the_same_labels():
    (line,) = re.findall(r"^LABELS := (.*)$", (PAPER / "Makefile").read_text(), re.MULTILINE)
    assert dict(word.split("=") for word in line.split()) == {
        name: color[1:] for name, color in flat.LABELS.items()
    }


# ---- make ----------------------------------------------------------------------------------------


def test_a_second_make_does_nothing(built):
    before = snapshot(built)
    done = make(built)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Nothing to be done for 'all'" in done.stdout
    assert snapshot(built) == before


def outputs(done, out):
    """What a run with -n would write with hpcomp, as names below `out`."""
    assert (done.returncode, done.stderr) == (0, "")
    commands = [line for line in done.stdout.replace("\\\n", " ").splitlines()
                if not line.startswith("echo ") or "; " in line]  # fmt: skip
    found = re.findall(rf"-o {re.escape(str(out))}/(\S+)", "\n".join(commands))
    return {name.rstrip("';") for name in found}


def test_a_touched_layer_makes_what_depends_on_it_again(built):
    done = make(built, "-n", "-W", built / "layers" / "orders" / "red.exr")
    orders = [*page.LAST, "simultaneous"]
    assert outputs(done, built) == {
        "orders.exr", "orders-traditional.exr", "orders.png", *(f"orders-{o}.exr" for o in orders)
    }  # fmt: skip
    done = make(built, "-n", "-W", built / "layers" / "fish" / "003.exr")
    assert outputs(done, built) == {
        "fish.exr", "fish-traditional.exr", "fish.png", "fish-hues.png"
    }  # fmt: skip
    assert "slices.py" not in done.stdout


def test_a_build_of_another_size_is_another_build(tmp_path):
    target = tmp_path / "layers" / "orders" / "red.exr"
    for size in (32, 48):
        assert make(tmp_path, target, size=size).returncode == 0
        (_, (right, _)) = OpenEXR.File(str(target)).header()["displayWindow"]
        assert right == size // 2 - 1


def test_a_failed_command_leaves_no_figure(tmp_path):
    stand_in = tmp_path / "hpcomp"
    stand_in.write_text('#!/bin/sh\necho half >"$(echo "$*" | sed "s/.*-o \\([^ ]*\\).*/\\1/")"\nexit 1\n')
    stand_in.chmod(stand_in.stat().st_mode | stat.S_IXUSR)
    out = tmp_path / "out"
    done = make(out, out / "lights.exr", out / "orders.exr", "-k", hpcomp_command=stand_in)
    assert done.returncode == 2
    assert not list(out.glob("*.exr"))
    assert len(list((out / "layers").rglob("*.exr"))) == 6


def test_an_interrupted_drawing_leaves_whole_slices(tmp_path):
    """By SIGKILL, after which nothing can be tidied."""
    folder = tmp_path / "slices"
    drawing = subprocess.Popen([sys.executable, PAPER / "slices.py", "fish", "256", "400", folder])
    until = time.monotonic() + PATIENCE_S
    while not (folder / "003.exr").exists():
        assert time.monotonic() < until
        assert drawing.poll() is None
        time.sleep(0.01)
    drawing.send_signal(signal.SIGKILL)
    drawing.wait()
    found = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    assert 4 <= len(found) < 400
    for path in found:
        assert sorted(OpenEXR.File(str(path)).channels()) == ["RGBA"]


# ---- memory --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wide_slices(tmp_path_factory):
    """16 slices of 512×512, and 16 tiny ones."""
    folder = tmp_path_factory.mktemp("wide")
    for size in (512, 16):
        slices.write_slices("tooth", size, 16, folder / str(size))
    return {size: sorted((folder / str(size)).iterdir(), reverse=True) for size in (512, 16)}


@pytest.mark.parametrize(("report", "budget"), [(False, 64), (True, 224)], ids=["picture", "report"])
def test_256_slices_stream_within_the_budget(wide_slices, tmp_path, report, budget):
    """Whole, 256 layers of 512×512 are 1 GiB as floats; a report holds a strip of each."""
    options = ["--report", tmp_path / "told.json"] if report else []
    peaks = []
    for size in (16, 512):
        peak, code, stderr = measured_run(
            wide_slices[size] * 16, tmp_path / "out.exr", "--order", "top-down", "--threads", 2,
            "--max-memory", f"{budget}M", *options,
        )  # fmt: skip
        assert (code, stderr) == (0, "")
        peaks.append(peak)
    assert peaks[1] - peaks[0] <= budget


def test_more_slices_take_no_more_memory(wide_slices, tmp_path):
    """But for what an open file takes."""
    few, many = (
        measured_run(wide_slices[512] * times, tmp_path / "out.exr", "--order", "top-down",
                     "--threads", 2, "--max-memory", "64M")
        for times in (2, 16)
    )  # fmt: skip
    assert few[1:] == many[1:] == (0, "")
    assert many[0] - few[0] <= 224 * 0.25


# ---- the page ------------------------------------------------------------------------------------


def tables(text):
    """{name: rows of cells} of the page's generated blocks."""
    found = {}
    for name, block in re.findall(r"<!-- begin generated: ([\w-]+) -->(.*?)<!-- end", text, re.DOTALL):
        lines = [line for line in block.splitlines() if line.startswith("| ")]
        found[name] = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return found


def test_the_numbers_of_the_page_are_those_of_such_a_build(built):
    now, shown = tables(page.with_tables(PAGE, built)), tables(PAGE)
    assert sorted(now) == sorted(shown) == sorted(page.TABLES)
    for name, rows in shown.items():
        assert [row[0] for row in rows] == [row[0] for row in now[name]], name
        assert rows[0] == now[name][0]
        for row, small in zip(rows[1:], now[name][1:], strict=True):
            for title, here, there in zip(rows[0][1:], row[1:], small[1:], strict=True):
                if title in ("foreign hue", "lost to grey"):
                    share, other = (float(cell.rstrip("%")) / 100 for cell in (here, there))
                    assert abs(share - other) <= SHARE_OF_SIZE, (name, row)
                if title == "foreign hue" and "traditional" not in row[0]:
                    assert here == "0.0%"
                if title == "peaks" and "hue-preserving" in row[0]:
                    assert hues(here) == pytest.approx(hues(there), abs=PAGE_HUE_DEG), (name, row)


def hues(cell):
    return sorted((int(hue) + 90) % 360 for hue in re.findall(r"(\d+)°", cell))


def test_stale_numbers_are_found(built, tmp_path, capsys):
    path = tmp_path / "README.md"
    path.write_text(PAGE, encoding="utf-8")
    assert page.main(["--check", str(built), str(path)]) == 1
    assert "make page" in capsys.readouterr().err
    assert page.main([str(built), str(path)]) == 0
    assert page.main(["--check", str(built), str(path)]) == 0


def test_the_page_shows_every_figure_and_its_picture_is_small(built):
    shown = re.findall(r"\]\(([\w-]+\.png)\)", PAGE)
    made = {path.name for path in built.glob("*.png") if not path.name.startswith("labels-")}
    assert sorted(shown) == sorted(made)
    assert sorted(path.name for path in PAPER.glob("*.png")) == sorted(made)
    sizes = [(PAPER / name).stat().st_size for name in shown]
    assert max(sizes) <= 400_000
    assert sum(sizes) <= 3_000_000
