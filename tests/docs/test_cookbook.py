"""Every recipe of samples/COOKBOOK.md, run as it is written, on small files of its names."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import command
import exrfile
import numpy as np
import pytest
from PIL import Image

import hpcomp

PAGE = (Path(__file__).parents[2] / "samples" / "COOKBOOK.md").read_text(encoding="utf-8")

#: The size that the page gives its pictures.
HEIGHT, WIDTH = 480, 640

RED, BLUE, GREY = (0.8, 0.05, 0.05), (0.05, 0.1, 0.8), (0.3, 0.3, 0.3)


# ---- the page ------------------------------------------------------------------------------------

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LANGUAGES = {"sh", "text", "make", "ninja", "python"}


def recipes():
    """{number: (title, text)} of each section."""
    parts = re.split(r"^## (\d+)\. (.*)$", PAGE, flags=re.MULTILINE)[1:]
    return {int(n): (title, text) for n, title, text in zip(*[iter(parts)] * 3, strict=True)}


RECIPES = recipes()


def steps(number):
    """(language, file name or "", text) of each block of a recipe, in order.

    What is no command and no output is a file, and the words before it end with its name.
    """
    text = RECIPES[number][1]
    found = []
    for block in BLOCK.finditer(text):
        language, content = block.groups()
        name = ""
        if language not in ("sh", "text"):
            name = re.search(r"`([\w.]+)`:\n\n$", text[: block.start()])[1]
        found.append((language, name, content))
    return found


def test_there_are_thirteen_recipes_and_the_list_at_the_top_names_them():
    listed = re.findall(r"^(\d+)\. \[(.*)\]\(#.*\)$", PAGE, re.MULTILINE)
    assert listed == [(str(number), title) for number, (title, _) in RECIPES.items()]
    assert list(RECIPES) == list(range(1, 14))


def test_every_block_of_the_page_belongs_to_a_recipe_and_is_of_a_kind_that_is_run():
    assert PAGE.count("```") == 2 * len(BLOCK.findall(PAGE))
    of_recipes = [step for number in RECIPES for step in steps(number)]
    assert [content for _, _, content in of_recipes] == [b for _, b in BLOCK.findall(PAGE)]
    assert {language for language, _, _ in of_recipes} == LANGUAGES
    for number in RECIPES:
        languages = [language for language, _, _ in steps(number)]
        assert "sh" in languages
        for before, after in zip(["", *languages], languages, strict=False):
            assert after != "text" or before == "sh"  # it is what that command prints


def test_layers_of_the_terrain_do_for_recipes(tmp_path, monkeypatch):
    layers = Path(__file__).parents[2] / "samples" / "terrain" / "layers"
    monkeypatch.chdir(shutil.copytree(layers, tmp_path / "layers"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    head = PAGE.partition("\n## 1")[0]
    (renaming,) = re.findall(r"`(cp .*?)`", head, re.DOTALL)
    numbers = re.search(r"To try recipes ([\d, and]+)\b", head)[1]
    run = sh(renaming)
    assert (run.returncode, run.stderr) == (0, "")
    for number in map(int, re.findall(r"\d+", numbers)):
        for run in cook(number, compared=False):
            assert run.stderr == ""


# ---- the kitchen ---------------------------------------------------------------------------------


def layer(color, rows=(0, HEIGHT), columns=(0, WIDTH), alpha=1.0):
    """A rectangle of one colour, transparent around it; premultiplied."""
    rgba = np.zeros((HEIGHT, WIDTH, 4), np.float32)
    rgba[slice(*rows), slice(*columns)] = [*(alpha * c for c in color), alpha]
    return rgba


def mask(rows, columns):
    """White there and black around it: what is written as a grey PNG."""
    values = np.zeros((HEIGHT, WIDTH), np.uint8)
    values[slice(*rows), slice(*columns)] = 255
    return values


def feathered(values, by=32):
    """The mask with an edge that fades over so many pixels, right and left."""
    steps = np.arange(-by, by + 1)
    return np.mean([np.roll(values, step, axis=1) for step in steps], axis=0).round().astype(np.uint8)


INPUTS = {
    "base.png": layer(GREY),
    "roads.png": layer(RED, rows=(40, 300), alpha=0.8),
    "rivers.exr": layer(BLUE, rows=(200, 440), alpha=0.6),
    "legend.png": np.full((60, 120, 4), [0.9, 0.9, 0.9, 1], np.float32),
    "scan.png": layer(GREY),
    "tumour.png": mask((100, 260), (200, 400)),
    "vessels.png": mask((180, 220), (0, WIDTH)),
    "heat.png": layer(RED, alpha=0.6),
    "region.png": feathered(mask((100, 200), (100, 300))),
    "photo.png": layer(GREY),
    "thumbnail.png": layer(GREY)[::2, ::2],
    "overlays/roads.png": layer(RED, rows=(40, 300), alpha=0.8),
    "overlays/rivers.png": layer(BLUE, rows=(200, 440), alpha=0.6),
    "overlays/roads, 1900.png": layer(RED, columns=(40, 300), alpha=0.8),
    **{f"bg.{n:04d}.exr": layer((0.3, 0.3, 0.04 * n)) for n in range(1, 7)},
    **{f"fg.{n:04d}.exr": layer(RED, rows=(40, 60 * n)) for n in (1, 3, 4, 6)},
}


@pytest.fixture(scope="module")
def pantry(tmp_path_factory):
    """The files that the page names, as they are before any recipe."""
    folder = tmp_path_factory.mktemp("pantry")
    (folder / "overlays").mkdir()
    for name, pixels in INPUTS.items():
        if pixels.ndim == 2:
            Image.fromarray(pixels).save(folder / name)
        else:
            hpcomp.write_image(folder / name, pixels)
    (folder / "fg.0002.exr").touch()  # and 5 is missing
    label = layer(BLUE, rows=(200, 440), columns=(100, 500), alpha=0.6)
    channels = dict(zip("RGB", 3 * [np.full((HEIGHT, WIDTH), 0.2)], strict=True))
    channels |= {f"labels.{c}": label[..., n] for n, c in enumerate("RGBA")}
    exrfile.write(folder / "render.exr", {n: p.astype(np.float16) for n, p in channels.items()})
    return folder


@pytest.fixture
def kitchen(pantry, tmp_path, monkeypatch):
    """A copy of them to work in, with hpcomp, ninja and oiiotool in PATH."""
    folder = tmp_path / "kitchen"
    shutil.copytree(pantry, folder)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    for variable in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS"):
        monkeypatch.delenv(variable, raising=False)
    return folder


def sh(script):
    return subprocess.run(
        ["sh", "-euc", script], capture_output=True, text=True, timeout=command.PATIENCE_S
    )


def cook(number, between=lambda: None, compared=True):
    """What each command block of a recipe gives: files are written, outputs compared.

    `between`: done before the last block of commands. `compared`: whether the layers are those that
    the page has the outputs of.
    """
    runs = []
    last = max(n for n, (language, _, _) in enumerate(steps(number)) if language == "sh")
    for n, (language, name, content) in enumerate(steps(number)):
        if language == "sh":
            if n == last:
                between()
            runs.append(sh(content))
            assert runs[-1].returncode == 0, runs[-1]
        elif language == "text":
            assert not compared or runs[-1].stdout == content
        else:
            Path(name).write_text(content)
    return runs


def quietly(run):
    assert run.stderr == ""
    return run.stdout


def pixels(path):
    return hpcomp.read_layer(path).pixels


def hues(path):
    """The hues that stand out in a picture, in whole degrees."""
    return sorted(round(peak.hue) for peak in hpcomp.read_hues(path).peaks)


def stacked(*layers, **options):
    """What `hpcomp.stack` makes of these layers."""
    hpcomp.stack(layers, "expected.png", **options)
    return pixels("expected.png")


def kinds(printed):
    """Which hpcomp commands make or ninja ran, in order."""
    return re.findall(r"hpcomp (\w+) ", printed)


# ---- the recipes ---------------------------------------------------------------------------------


def test_1_legend(kitchen):
    (run,) = cook(1)
    assert quietly(run) == ""
    found, without = pixels("map.png"), stacked("base.png", "roads.png::opacity=0.6")
    there = np.zeros((HEIGHT, WIDTH), bool)
    there[HEIGHT - 70 : HEIGHT - 10, WIDTH - 130 : WIDTH - 10] = True
    assert np.array_equal(found[there], pixels("legend.png").reshape(-1, 4))
    assert np.array_equal(found[~there], without[~there])


def test_2_masks(kitchen):
    (run,) = cook(2)
    labels = hpcomp.palette(["#ee0038", "#0050ff"]).labels
    assert hues("labelled.png") == sorted(round(label.hue) for label in labels)
    for name in ("tumour.png", "vessels.png"):
        assert name in quietly(run)
    overlap, scan = pixels("labelled.png")[200, 300], pixels("scan.png")[200, 300]
    assert np.abs(overlap - scan).max() > 0.05
    # What the page says of an EXR.
    both = {f"{name}.Y": pixels(f"{name}.png")[..., 0].astype(np.float16)
            for name in ("tumour", "vessels")}  # fmt: skip
    exrfile.write(kitchen / "masks.exr", both)
    setting = re.search(r"`(masks\.exr::.*?)`", PAGE)[1]
    assert np.allclose(
        stacked("scan.png", f"{setting},opacity=0.6"),
        stacked("scan.png", "tumour.png::tint=#ee0038,opacity=0.6"),
    )


def test_3_region(kitchen):
    (run,) = cook(3)
    assert quietly(run) == ""
    region = np.array(Image.open("region.png")) / 255
    found, scan, everywhere = (
        pixels("inside.png"),
        pixels("scan.png"),
        stacked("scan.png", "heat.png"),
    )
    assert np.array_equal(found[region == 0], scan[region == 0])
    assert np.array_equal(found[region == 1], everywhere[region == 1])
    assert np.abs(everywhere - scan).min(axis=(0, 1)).max() > 0.1
    # At its edge the stored values count, and the pipe loses nothing.
    assert np.mean((region > 0) & (region < 1)) > 0.02
    cut = pixels("heat.png") * region[..., None]
    hpcomp.write_image("expected.png", hpcomp.composite([scan, cut]))
    assert np.array_equal(Image.open("inside.png"), Image.open("expected.png"))
    # The other way round.
    ((_, _, text),) = steps(3)
    quietly(sh(text.replace("op=dst-in", re.search(r"`(op=dst-out)`", PAGE)[1])))
    outside = pixels("inside.png")
    assert np.array_equal(outside[region == 1], scan[region == 1])
    assert np.array_equal(outside[region == 0], everywhere[region == 0])


def test_4_comparison(kitchen):
    (run,) = cook(4)
    both, plain, preserving = (pixels(f"{name}.png") for name in ("both", "plain", "map"))
    assert both.shape == (HEIGHT, 2 * WIDTH, 4)
    assert np.array_equal(both, np.hstack([plain, preserving]))
    assert hues("map.png") == sorted([*hues("rivers.exr"), *hues("roads.png")])
    assert len(hues("plain.png")) == 3
    assert "plain.png" in quietly(run)
    assert 'type="range"' in Path("map.html").read_text()  # the slider


def visible(path, **options):
    """The share of both labels' pixels where a reader finds them."""
    layers = ["base.png", "roads.png::opacity=0.6", "rivers.exr"]
    return hpcomp.check(path, layers, min_visible="0%", **options).visible_share


def test_5_woven(kitchen):
    woven, _, grains = cook(5)
    assert quietly(woven).count("passed") == 2
    assert quietly(grains) == ""
    labels = sorted([*hues("rivers.exr"), *hues("roads.png")])
    overlap = pixels("woven.png")[200:300], pixels("grains.png")[200:300]
    for part in overlap:
        found = hpcomp.hue_histogram(part).peaks
        assert sorted(round(peak.hue) for peak in found) == labels
        assert min(peak.share for peak in found) > 0.2
    assert visible("woven.png", preset="woven") == visible("grains.png", preset="woven") == 1
    assert visible("map.png") < 0.9
    # Where a label is alone nothing changes; the pattern shows in the luminance of no pixel.
    same, other = pixels("woven.png"), pixels("map.png")
    assert np.abs(same[:200] - other[:200]).max() < 0.01
    weights = np.array([0.2126, 0.7152, 0.0722])
    assert np.abs((same - other)[..., :3] @ weights).max() < 0.01
    assert np.ptp(same[200:300, :, :3] @ weights) < 0.01
    each = re.search(r"`(--min-visible layer:roads=90%)`", PAGE)[1]
    quietly(sh(f"hpcomp check woven.png base.png 'roads.png::opacity=0.6' rivers.exr {each}"))


def test_6_labels(kitchen):
    (run,) = cook(6)
    assert quietly(run) == ""
    report = json.loads(Path("vivid.json").read_text())["measures"]
    lost = {"vivid": report["result"]["lost_to_grey"]}
    layers = ["base.png", "roads.png::opacity=0.6", "rivers.exr"]
    for name, options in {"softer": {"preset": "labels", "gray_bias": 0.5}, "paper": {}}.items():
        found = hpcomp.stack(layers, f"{name}.png", report=f"{name}.json", **options)
        lost[name] = found.findings.measures.result.lost
    assert lost["vivid"] < lost["softer"] < lost["paper"]
    # The page names what the preset chooses, all of it.
    named = dict(re.findall(r"^- `--([\w-]+) ([\w.]+)`:", RECIPES[6][1], re.MULTILINE))
    chosen = hpcomp.options.PRESETS["labels"]
    assert {name.replace("-", "_"): value for name, value in named.items()} == {
        name: f"{value:g}" if isinstance(value, float) else value for name, value in chosen.items()
    }


def test_7_multilayer(kitchen):
    runs = cook(7)
    assert [run.stderr for run in runs] == ["", ""]
    (hue,) = hues("render.exr::layer=labels")
    assert hues("shaded.png") == [hue]
    small = pixels("small.png")
    assert small.shape == (HEIGHT // 2, WIDTH // 2, 4)
    # Not one pixel has another hue, as the usual filter of oiiotool would leave some.
    assert hues("labels.exr") == [hue]
    assert hpcomp.read_hues("labels.exr").occupied == 1
    scaling = steps(7)[-1][2].partition("hpcomp")[0]
    quietly(sh(scaling.replace(":filter=triangle", "")))
    with pytest.warns(hpcomp.HpcompWarning, match="filters that sharpen leave such values"):
        assert hpcomp.read_hues("labels.exr").occupied > 1


def test_8_hundreds(kitchen):
    first, cluster = cook(8)
    assert first.stdout == cluster.stdout == ""
    names = sorted(path.name for path in Path("overlays").iterdir())
    assert sorted(os.listdir("maps")) == names
    for run in (first, cluster):
        assert run.stderr.splitlines()[-1].endswith(f": {len(names)} made")
    for name in names:
        expected = stacked("base.png", f"overlays/{name}::opacity=0.6", depth=16)
        assert np.array_equal(pixels(f"maps/{name}"), expected)
    # What the page says of another run.
    shutil.copy("overlays/rivers.png", "overlays/roads.png")
    again = sh("hpcomp batch jobs.csv --update")
    assert again.stderr.splitlines()[-1].endswith(": 2 current, 1 made")


def test_9_frames(kitchen):
    def rendered_again():
        assert sorted(os.listdir()) == sorted({*before, ".shot.json.hpcomp-state", "shot.json",
                                               "shot.log", *(f"comp.000{n}.exr" for n in (1, 3, 4, 6))})  # fmt: skip
        for frame in (2, 5):
            shutil.copy("fg.0001.exr", f"fg.{frame:04d}.exr")

    before = os.listdir()
    first, again = cook(9, between=rendered_again)
    records = [json.loads(line) for line in Path("shot.log").read_text().splitlines()]
    assert {r["job"]: r["status"] for r in records} == {
        1: "made", 2: "failed", 3: "made", 4: "made", 5: "failed", 6: "made",
    }  # fmt: skip
    assert first.stderr.count("hpcomp: error: ") == 2
    assert again.stderr.splitlines()[-1].endswith(": 4 current, 2 made")
    for frame in range(1, 7):
        name = f"{frame:04d}.exr"
        hpcomp.stack([f"bg.{name}", f"fg.{name}::opacity=0.5"], "expected.exr")
        assert Path(f"comp.{name}").read_bytes() == Path("expected.exr").read_bytes()
    resumed = sh(re.search(r"`(hpcomp batch shot.json --resume)`", PAGE)[1])
    assert resumed.stderr.splitlines()[-1].endswith(": 6 current")


def test_10_make(kitchen):
    plain, stamped = cook(10, between=lambda: Path("map.png").unlink())
    assert kinds(quietly(plain)) == ["stack", "stack"]
    assert kinds(quietly(stamped)) == ["stack", "hues", "stack"]
    assert "hpcomp" in Path("map.html").read_text()
    assert np.array_equal(
        pixels("map.png"), stacked("base.png", "roads.png::opacity=0.6", "rivers.exr")
    )
    # Nothing was left to do; a picture that went is made again, a changed one goes on.
    assert kinds(quietly(sh("make -f stamp.mk"))) == []
    Path("map.png").unlink()
    assert kinds(quietly(sh("make -f stamp.mk"))) == ["stack", "hues"]
    shutil.copy("overlays/roads, 1900.png", "roads.png")
    os.utime("roads.png")
    assert kinds(quietly(sh("make -f stamp.mk"))) == ["stack", "hues"]
    assert kinds(quietly(sh("make -f stamp.mk"))) == []
    # A layer that is no longer in the command may go.
    quietly(sh("make"))
    text = Path("Makefile").read_text()
    Path("Makefile").write_text(text.replace(" rivers.exr", ""))
    assert "rivers" in text
    Path("rivers.exr").unlink()
    assert kinds(quietly(sh("make"))) == ["stack"]
    assert kinds(quietly(sh("make"))) == []
    assert hues("map.png") == hues("roads.png")


def test_11_ninja(kitchen):
    (run,) = cook(11)
    assert kinds(quietly(run)) == ["stack", "hues", "stack"]
    assert run.stdout.endswith("ninja: no work to do.\n")
    assert run.stdout.count("no work to do") == 1
    assert np.array_equal(
        pixels("map.png"), stacked("base.png", "roads.png::opacity=0.6", "rivers.exr")
    )
    shutil.copy("overlays/roads, 1900.png", "roads.png")
    os.utime("roads.png")
    assert kinds(quietly(sh("ninja"))) == ["stack", "hues"]


def test_12_failing(kitchen):
    first, _ = cook(12)
    assert kinds(quietly(first)) == ["stack", "palette", "check"]
    assert Path("map.ok").exists()
    assert kinds(quietly(sh("make"))) == []
    hpcomp.write_image("rivers.exr", layer(BLUE))  # over all roads
    for _ in range(2):  # and it stays so
        failed = sh("make")
        assert failed.returncode == 2
        assert "check failed: map.png: --require-hue: layer 1 (roads.png)" in failed.stderr
        assert "Error 6" in failed.stderr
    hpcomp.write_image("rivers.exr", INPUTS["rivers.exr"])
    quietly(sh("make"))
    # Ordinary blending does not pass.
    text = Path("Makefile").read_text()
    Path("Makefile").write_text(text.replace("-o $@", "-o $@ --blending traditional"))
    failed = sh("make")
    assert failed.returncode == 2
    assert "--max-foreign" in failed.stderr


def test_13_python(kitchen):
    (run,) = cook(13)
    assert run.stderr == ""
    assert pixels("half.exr") == pytest.approx(pixels("rivers.exr") / 2)
    assert json.loads(Path("hues.json").read_text())["schema"] == "hpcomp.hues"
    assert "<svg" in Path("palette.svg").read_text()
    assert 'type="range"' in Path("map.html").read_text()
