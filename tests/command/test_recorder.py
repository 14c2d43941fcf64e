"""Reports and provenance of `stack`: what the files hold, and that they appear whole or not at all."""

from __future__ import annotations

import base64
import csv
import io
import itertools
import json
import logging
import os
import re
import signal
from pathlib import Path

import exrfile
import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pngfile
import pytest
from agreement import ENGINES, TIES
from command import OLD, Desk, shell, snapshot
from processes import assert_ended, running, temporary_of
from strategies import ORDER_NAMES

import hpcomp
from hpcomp import MismatchError, OutputError, SettingError
from hpcomp.color.quantization import Losses
from hpcomp.color.samples import encode
from hpcomp.engine import choice as engine
from hpcomp.geometry import Window
from hpcomp.layers import budget
from hpcomp.measures import labels as measures
from hpcomp.options import stack_rules
from hpcomp.report import measures as report_of_measures
from hpcomp.report import recorder
from hpcomp.report.hueformats import REPORT_FORMATS
from hpcomp.report.stackreport import PREVIEW_SIDE

WIDTH, HEIGHT = 90, 150
ORDERS = (*ORDER_NAMES, "2,0,1")
ENDINGS = [row.ending[1:] for row in REPORT_FORMATS.values()]
#: Those that need no further library.
PLAIN_ENDINGS = ["txt", "json", "csv", "html"]


def patches(seed, rgb, size=(WIDTH, HEIGHT), depth=8):
    """A PNG of one straight colour at random alphas, none at all here and there."""
    rng = np.random.default_rng(seed)
    samples = np.empty((size[1], size[0], 4), int)
    samples[..., :3] = rgb
    samples[..., 3] = rng.integers(0, 256, size[::-1]) * (rng.random(size[::-1]) > 0.2)
    return pngfile.rgba_png(samples * (257 if depth == 16 else 1), depth)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """base.png, roads.png, river.exr: a label each, of one size, the last with pixels outside."""
    folder = tmp_path_factory.mktemp("layers")
    (folder / "base.png").write_bytes(patches(1, (220, 40, 40)).encode())
    (folder / "roads.png").write_bytes(patches(2, (230, 200, 0), depth=16).encode())
    rng = np.random.default_rng(3)
    alpha = rng.random((HEIGHT, WIDTH))
    river = {
        name: (alpha * value).astype(np.float32)
        for name, value in zip("RGBA", (0.05, 0.1, 0.8, 1.0), strict=True)
    }
    exrfile.write(folder / "river.exr", river, origin=(-7, 20), display=(0, 0, WIDTH, HEIGHT))
    return folder


LAYERS = ("base.png", "roads.png::opacity=0.7,name=roads", "river.exr")
OPACITIES = 1.0, 0.7, 1.0


@pytest.fixture
def here(folder, tmp_path, monkeypatch):
    """The current directory, with links to the layers."""
    for path in folder.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def desk(folder, tmp_path):
    """The same for runs of the command, with outputs that stand."""
    desk = Desk.made(tmp_path)
    for path in folder.iterdir():
        desk.put(path.name, path.read_bytes())
    for name in ("out.png", "out.json", "out.exr"):
        os.utime(desk.put(name, OLD), ns=(10**18, 10**18))
    return desk


def arrays(here):
    """The layers (3, h, w, 4) on the canvas, before their opacities."""
    found = np.zeros((3, HEIGHT, WIDTH, 4), np.float32)
    for array, name in zip(found, LAYERS, strict=True):
        layer = hpcomp.read_layer(here / name.partition("::")[0])
        x, y = layer.data_window.x, layer.data_window.y
        part = layer.pixels[: HEIGHT - y, max(0, -x) :]
        array[y : y + part.shape[0], max(0, x) : max(0, x) + part.shape[1]] = part
    return found


def least_memory(*arguments, **options):
    """The smallest budget of this stack, which has the shortest strips."""
    with pytest.raises(MismatchError) as refusal:
        hpcomp.stack(*arguments, **options, max_memory="64K")
    return re.search(r"at least (\d+M)", str(refusal.value))[1]


def bytes_of(here, *names):
    return [(here / name).read_bytes() for name in names]


# ---- the picture ---------------------------------------------------------------------------------


@pytest.mark.singly
@pytest.mark.parametrize("ending", ["png", "exr"])
@pytest.mark.parametrize("order", ORDERS)
def test_the_picture_is_the_same_with_and_without(here, order, ending):
    out = f"out.{ending}"
    alone = hpcomp.stack(LAYERS, out, order=order)
    (plain,) = bytes_of(here, out)
    asked = {"report": ["r.json", "r.html"], "provenance": "p.exr"}
    memory = least_memory(LAYERS, out, order=order, **asked)
    for threads, max_memory in itertools.product((1, 2, 3), ("1G", memory)):
        found = hpcomp.stack(
            LAYERS, out, order=order, threads=threads, max_memory=max_memory, **asked
        )
        assert bytes_of(here, out) == [plain]
        assert found.losses == alone.losses
    assert alone.findings is None
    assert found.findings.measures.pixels == WIDTH * HEIGHT


def test_settings_that_change_reports_change_no_picture(here):
    hpcomp.stack(LAYERS, "out.png")
    (plain,) = bytes_of(here, "out.png")
    hpcomp.stack(
        LAYERS, "out.png", report="r.json", bins=12, achromatic=0.5, foreign_tolerance=90,
        energy_weights="1,2,3",
    )  # fmt: skip
    assert bytes_of(here, "out.png") == [plain]
    document = json.loads((here / "r.json").read_text())
    assert (document["bins"], document["achromatic"]) == (12, 0.5)
    assert document["measures"]["foreign_tolerance"] == 90
    assert document["measures"]["energy_weights"] == [1, 2, 3]


# ---- reports -------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("order", ["bottom-up", "top-down", "simultaneous"])
def test_neither_threads_nor_strips_show(here, caplog, order):
    caplog.set_level(logging.INFO, "hpcomp")
    names = [f"r.{ending}" for ending in (ENDINGS if order == "bottom-up" else PLAIN_ENDINGS)]
    asked = {"order": order, "report": names, "provenance": "p.exr", "background": "#405060"}
    hpcomp.stack(LAYERS, "out.exr", threads=1, **asked)
    expected = bytes_of(here, *names, "p.exr")
    memory = least_memory(LAYERS, "out.exr", **asked)
    for threads in (3,) if names[-1] not in PLAIN_ENDINGS else (1, 3):  # figures take seconds each
        hpcomp.stack(LAYERS, "out.exr", threads=threads, max_memory=memory, **asked)
        assert bytes_of(here, *names, "p.exr") == expected
    strips = re.findall(r"in strips of (\d+) rows", caplog.text)
    assert len(set(strips)) > 1


@pytest.fixture
def sparse(tmp_path, monkeypatch):
    """A label that shines through another here and there; its canvas begins away from the origin."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(6)
    canvas = (5, -9, WIDTH, HEIGHT)
    for name, color in (("strong", (0.6, 0, 0, 0.6)), ("weak", (0, 0.05, 0, 0.2))):
        there = rng.random((HEIGHT, WIDTH)) > (0.004 if name == "strong" else 0.1)
        values = {c: (there * v).astype(np.float32) for c, v in zip("RGBA", color, strict=True)}
        exrfile.write(tmp_path / f"{name}.exr", values, origin=canvas[:2], display=canvas)
    # It reaches over the canvas' left and upper borders.
    exrfile.write(
        tmp_path / "over.exr",
        {c: np.full((20, 30), v, np.float32) for c, v in zip("RGBA", (0, 0, 0.05, 0.1), strict=True)},
        origin=(-8, -20),
        display=canvas,
    )
    return ["strong.exr", "weak.exr", "over.exr"]


@pytest.mark.singly
@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize(
    "part",
    [
        {},
        {"region": "61x77+12+4"},
        {"region": "7x5+30+0"},
        {"region": "1x1+94+140"},
        {"overscan": True},
        {"overscan": True, "region": "50x140-6-17"},
    ],
    ids=str,
)
def test_cells_lie_on_the_canvas_whatever_the_strips(sparse, monkeypatch, name, part):
    """Of the part that is made, cells are those of the whole canvas."""
    monkeypatch.setenv(engine.VARIABLE, name)
    asked = {"op": "plus", "report": ["r.json", "r.txt"], **part}
    wanted = hpcomp.stack(sparse, "out.exr", threads=1, **asked).data_window
    expected = bytes_of(Path(), "r.json", "r.txt")
    memory = least_memory(sparse, "out.exr", **asked)
    for threads, max_memory, rows in itertools.product((1, 3), ("1G", memory), (1, 40)):
        monkeypatch.setattr(budget, "STRIP_ROWS", rows)
        hpcomp.stack(sparse, "out.exr", threads=threads, max_memory=max_memory, **asked)
        assert bytes_of(Path(), "r.json", "r.txt") == expected
    # The same pixels as arrays.
    layers = np.zeros((3, wanted.height, wanted.width, 4), np.float32)
    for array, path in zip(layers, sparse, strict=True):
        layer = hpcomp.read_layer(path)
        common = layer.data_window.intersection(wanted)
        if common is None:
            continue
        there, here = (
            common.moved(-of.x, -of.y).slices for of in (layer.data_window, wanted)
        )
        array[here] = layer.pixels[there]
    found = hpcomp.stack_measures(
        layers, op="plus", half_step=measures.HALF_STEP_FINE, origin=(wanted.x - 5, wanted.y + 9)
    )
    document = json.loads(Path("r.json").read_text())["measures"]
    for which in ("result", "traditional"):
        for layer, expected_layer in zip(
            document[which]["layers"], getattr(found, which).layers, strict=True
        ):
            assert layer["visible_pixels"] == expected_layer.visible
            assert layer["visible_share"] == expected_layer.visible_share
        assert document[which]["visible_share"] == getattr(found, which).visible_share
    if wanted.pixels > 1000:
        assert 0.2 < found.result.layers[1].visible_share < 0.9


@pytest.mark.parametrize("out", ["out.png", "out.exr"])
@pytest.mark.parametrize("name", ENGINES)
def test_json_is_what_arrays_measure(here, monkeypatch, name, out):
    monkeypatch.setenv(engine.VARIABLE, name)
    hpcomp.stack(LAYERS, out, background="#203040", exposure=-1.0, report="r.json")
    document = json.loads((here / "r.json").read_text())
    expected = hpcomp.stack_measures(
        arrays(here),
        opacity=OPACITIES,
        background=hpcomp.color.css.css_color("#203040", "background"),
        half_step=measures.half_step("uint8" if out == "out.png" else "float"),
    )
    assert document["engine"] == name
    labels = [layer["label"] for layer in document["layers"]]
    assert labels == ["base.png", "roads", "river.exr"]
    expected = report_of_measures.as_data(expected, labels)
    if name == "reference":
        assert document["measures"] == expected
    else:
        pixels = WIDTH * HEIGHT
        for result in ("result", "traditional"):
            mine, other = document["measures"].pop(result), expected.pop(result)
            for key in ("foreign_share", "lost_to_grey", "energy"):
                assert mine[key] == pytest.approx(other[key], abs=2 * TIES / pixels, rel=1e-5)
            for one, two in zip(mine["layers"], other["layers"], strict=True):
                assert (one["label"], one["pixels"]) == (two["label"], two["pixels"])
                assert one["lost_to_grey"] == pytest.approx(two["lost_to_grey"], abs=1e-5)
        assert document["measures"].pop("order_sensitivity") == pytest.approx(
            expected.pop("order_sensitivity"), abs=2 * TIES / pixels
        )
        one, two = (data.pop("order_sensitive_pixels") for data in (document["measures"], expected))
        assert abs(one - two) <= TIES
        assert document["measures"] == expected


def test_histograms_of_layers_do_not_depend_on_the_engine(here, monkeypatch):
    documents = []
    for name in ENGINES:
        monkeypatch.setenv(engine.VARIABLE, name)
        hpcomp.stack(LAYERS, "out.png", report="r.json")
        documents.append(json.loads((here / "r.json").read_text()))
    one, two = documents
    assert one["layers"] == two["layers"]
    for number, (layer, opacity) in enumerate(zip(arrays(here), OPACITIES, strict=True)):
        histogram = hpcomp.hue_histogram(layer * np.float32(opacity))
        counts = one["layers"][number]["pixels"]
        assert counts["chromatic"] == histogram.chromatic
        assert counts["transparent"] == histogram.transparent


def test_result_is_what_hues_counts_of_an_exact_file(here):
    """The histogram of the result is that of the file, where the file rounds nothing."""
    found = hpcomp.stack(LAYERS, "out.exr", depth="float", report="r.csv").findings
    counted = hpcomp.read_hues("out.exr")
    assert abs(found.result.count - counted.count).sum() <= 2 * TIES
    hpcomp.stack(LAYERS, "plain.exr", depth="float", blending="traditional")
    counted = hpcomp.read_hues("plain.exr")
    assert abs(found.traditional.count - counted.count).sum() <= 2 * TIES
    rows = list(csv.DictReader(io.StringIO((here / "r.csv").read_text(), newline="")))
    counts = [int(r["count"]) for r in rows if (r["image"], r["kind"]) == ("result", "hue")]
    assert counts == found.result.count.tolist()


@pytest.mark.parametrize("blending", ["hue-preserving", "traditional", "foremost"])
def test_the_page_says_which_picture_is_the_files(here, blending):
    hpcomp.stack(LAYERS, "out.png", blending=blending, report="r.html")
    page = Path("r.html").read_text()
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", page.partition('id="hues"')[0])
    names = dict.fromkeys(["traditional", "hue-preserving", "woven", blending])
    expected = [f"{name} (the file)" if name == blending else name for name in names]
    assert [re.sub("<.*?>", "", caption) for caption in captions] == expected


@pytest.mark.parametrize("order", ORDERS)
def test_three_labels_stay_three_hues(here, order):
    """The paper's claim, through files: three lines with ⊕, a smear with +."""
    hpcomp.stack(LAYERS, "out.png", order=order, report="r.json")
    document = json.loads((here / "r.json").read_text())
    result, traditional = document["measures"]["result"], document["measures"]["traditional"]
    assert (result["foreign_share"], result["foreign_chroma_share"]) == (0, 0)
    assert traditional["foreign_share"] > 0.3

    def occupied(data):
        return [k for k, count in enumerate(data["histogram"]["count"]) if count]

    lines = [occupied(layer) for layer in document["layers"]]
    assert [len(line) for line in lines] == [1, 1, 1]
    assert occupied(document["result"]) == sorted(itertools.chain(*lines))
    assert document["result"]["pixels"]["grey"] > 0
    assert len(occupied(document["traditional"])) > 150


def test_broken_pixels_are_counted(here):
    values = exrfile.planes("RGBA", WIDTH, HEIGHT, np.float32)
    values["R"][3, :5] = np.nan
    values["G"][140, 7] = np.inf
    exrfile.write(here / "odd.exr", values)
    with pytest.warns(hpcomp.HpcompWarning):
        found = hpcomp.stack(
            ["base.png", "odd.exr"], "out.png", nonfinite="keep", report="r.json"
        ).findings
    assert found.measures.unmeasured == found.layers[1].nonfinite == 6
    with pytest.warns(hpcomp.HpcompWarning):
        found = hpcomp.stack(
            ["base.png", "odd.exr"], "out.png", nonfinite="zero", report="r.json"
        ).findings
    assert (found.measures.unmeasured, found.layers[1].nonfinite) == (0, 0)
    assert found.layers[1].transparent >= 6
    before = snapshot(here)
    with pytest.raises(hpcomp.HpcompError, match="NaN"):
        hpcomp.stack(["base.png", "odd.exr"], "out.png", report="r.json", provenance="new.exr")
    assert snapshot(here) == before


def test_one_layer_and_one_pixel(here):
    (here / "dot.png").write_bytes(patches(5, (10, 200, 30), (1, 1)).encode())
    for names in (["dot.png"], ["dot.png", "dot.png"]):
        found = hpcomp.stack(names, "out.png", report="r.html", provenance="p.exr").findings
        assert found.measures.pixels == 1
        assert found.result.count.tolist() == found.traditional.count.tolist()


def test_more_layers_than_are_composited_at_once(here):
    layers = list(itertools.islice(itertools.cycle(LAYERS), 20))
    for order in ("bottom-up", "top-down"):
        hpcomp.stack(layers, "plain.exr", order=order)
        found = hpcomp.stack(layers, "out.exr", order=order, report="r.json").findings
        assert bytes_of(here, "out.exr") == bytes_of(here, "plain.exr")
        assert len(found.layers) == 20
        assert found.layers[0] == found.layers[18]
        assert found.layers[0] != found.layers[1]


# ---- the page ------------------------------------------------------------------------------------


def pictures(here, name="r.html"):
    """The pictures of a page by their names, (h, w, 4)."""
    page = (here / name).read_text()
    found = re.findall(r'<img src="data:image/png;base64,([^"]+)"[^>]* alt="The (\S+) picture', page)
    return {name: pngfile.decode(base64.b64decode(data)) for data, name in found}


@pytest.mark.parametrize("order", ["bottom-up", "top-down"])
@pytest.mark.parametrize("blending", ["hue-preserving", "woven", "foremost"])
def test_page_shows_what_each_blending_makes(here, blending, order):
    rules = {"order": order, "strength": "perceived", "weave": "noise", "weave_size": 3}
    hpcomp.stack(LAYERS, "out.png", blending=blending, report="r.html", **rules)
    shown = pictures(here)
    assert list(shown) == list(dict.fromkeys(["traditional", "hue-preserving", "woven", blending]))
    for name, page in shown.items():
        hpcomp.stack(LAYERS, "one.png", blending=name, **rules)
        picture = pngfile.decode((here / "one.png").read_bytes())
        # The page's are rounded from means of one pixel, the files' from what they are.
        assert abs(page.astype(int) - picture).max() <= 1, name
        assert (page == picture).mean() > 0.999, name
    assert len({page.tobytes() for page in shown.values()}) == len(shown)


def test_page_shows_the_same_where_all_blendings_are_one(here):
    hpcomp.stack(LAYERS[:1], "out.png", report="r.html")
    assert len({page.tobytes() for page in pictures(here).values()}) == 1


def test_the_weave_of_a_page_grows_with_its_scale(here):
    """What is three times smaller shows stripes of the same width."""
    width = 2 * PREVIEW_SIDE + 3
    for name, hue in (("a", (0.5, 0, 0)), ("b", (0, 0.5, 0.5))):
        flat = np.broadcast_to(np.array((*hue, 1.0), np.float32), (24, width, 4))
        hpcomp.write_image(f"{name}.exr", flat)
    hpcomp.stack(["a.exr", "b.exr::opacity=0.5"], "out.exr", blending="woven", report="r.html")
    row = pictures(here)["woven"][4, :, 0].astype(int)
    stripes = np.count_nonzero(np.diff((row > row.mean()).astype(int)))
    assert abs(stripes - 2 * len(row) / 8) <= 2
    assert "a woven pattern is seen: it is 3 times as coarse as in a file" in (here / "r.html").read_text()


@pytest.mark.parametrize("size", [(2 * PREVIEW_SIDE + 5, 7), (4, 2 * PREVIEW_SIDE + 2)])
def test_pictures_of_a_page_are_means_of_squares(here, size):
    width, height = size
    rng = np.random.default_rng(4)
    values = rng.random((height, width, 4)).astype(np.float32)
    values[..., :3] *= values[..., 3:]
    hpcomp.write_image("large.exr", values, depth="float")
    memory = least_memory(["large.exr"], "out.exr", report="r.html")
    seen = set()
    for max_memory in ("1G", memory):
        hpcomp.stack(["large.exr"], "out.exr", report="r.html", max_memory=max_memory)
        seen.add((here / "r.html").read_bytes())
    assert len(seen) == 1
    shown = pictures(here)["hue-preserving"]
    scale = 3
    assert shown.shape == (-(-height // scale), -(-width // scale), 4)
    for y, x in itertools.product((0, shown.shape[0] - 1), (0, shown.shape[1] - 1)):
        square = values[y * scale : (y + 1) * scale, x * scale : (x + 1) * scale]
        mean = square.mean(axis=(0, 1), dtype=np.float64).astype(np.float32)
        assert abs(encode(mean[None], "uint8", Losses())[0].astype(int) - shown[y, x]).max() <= 1


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize(
    "rules",
    [{}, {"blending": "woven", "weave_size": 3}, {"blending": "traditional", "exposure": 1.0},
     {"space": "oklab", "order": "simultaneous", "background": "#204060"}],
    ids=["paper", "woven", "traditional", "oklab"],
)  # fmt: skip
def test_small_pictures_are_those_of_the_large_ones(here, monkeypatch, name, rules):
    """Measured ones are their means, to the code; others are blended from means of the layers."""
    monkeypatch.setenv(engine.VARIABLE, name)
    width, height, scale = 2 * PREVIEW_SIDE + 1, 50, 3
    rng = np.random.default_rng(8)
    layers = []
    for number in range(3):
        values = rng.random((height, width, 4)).astype(np.float32)
        values[..., :3] *= values[..., 3:] * np.float32(np.eye(3)[number] * 0.8 + 0.1)
        values *= rng.random((height, width, 1)) > 0.4
        hpcomp.write_image(f"l{number}.exr", values, depth="float")
        layers.append(values)
    opacities = 1.0, 0.8, 0.5
    names = [f"l{number}.exr::opacity={opacity}" for number, opacity in enumerate(opacities)]
    pages = set()
    for memory in ("1G", least_memory(names, "out.exr", report="r.html", **rules)):
        hpcomp.stack(names, "out.exr", report="r.html", max_memory=memory, **rules)
        pages.add((here / "r.html").read_bytes())
    assert len(pages) == 1

    def small(values):
        """Means of squares, those at the right and the lower edge of fewer pixels."""
        begins = [np.arange(0, length, scale) for length in (height, width)]
        sums = np.add.reduceat(np.add.reduceat(values.astype(float), begins[0], axis=0), begins[1], axis=1)
        counts = [np.diff(np.append(begin, length)) for begin, length in zip(begins, (height, width), strict=True)]
        return (sums / (counts[0][:, None] * counts[1])[..., None]).astype(np.float32)

    own = rules.get("blending", "hue-preserving")
    measured = {"traditional", own if own != "woven" else "hue-preserving"}
    shown = pictures(here)
    assert set(shown) == {"traditional", "hue-preserving", "woven"}
    for picture, codes in shown.items():
        blended = {**rules, "blending": picture}
        if picture in measured:
            expected = small(hpcomp.composite(layers, opacity=opacities, **blended))
        else:
            expected = hpcomp.composite([small(layer) for layer in layers], opacity=opacities, **blended)
        error = abs(encode(expected, "uint8", Losses()).astype(int) - codes)
        assert (error > 1).mean() < 1e-3, picture
        assert (error > 0).mean() < 0.01, picture
    assert f"mean of {scale} × {scale} of the picture" in (here / "r.html").read_text()


# ---- provenance ----------------------------------------------------------------------------------


def expected_provenance(here, half_step, **rules):
    """(h, w) planes of the reference on arrays."""
    checked = stack_rules(3, opacity=OPACITIES, **rules)
    settings = measures.measure_settings(checked, half_step=half_step)
    _, found = measures.measures_of(checked, settings, arrays(here))
    return vars(found)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", ENGINES)
def test_provenance_holds_what_is_measured(here, monkeypatch, name, order):
    monkeypatch.setenv(engine.VARIABLE, name)
    hpcomp.stack(LAYERS, "out.png", order=order, provenance="p.exr")
    expected = expected_provenance(here, measures.HALF_STEP_8_BIT, order=order)
    with OpenEXR.File("p.exr", separate_channels=True) as file:
        assert sorted(file.channels()) == ["grey", "layer", "margin"]
        found = {channel: file.channels()[channel].pixels for channel in file.channels()}
    assert found["layer"].dtype == np.uint32
    assert found["grey"].dtype == found["margin"].dtype == np.float32
    assert set(np.unique(found["layer"])) == {0, 1, 2, 3}
    if name == "reference":
        for channel, plane in expected.items():
            assert np.array_equal(found[channel], plane), channel
    else:
        same = found["layer"] == expected["layer"]
        assert np.count_nonzero(~same) <= TIES
        for channel in ("grey", "margin"):
            assert np.allclose(found[channel][same], expected[channel][same], atol=1e-4), channel


def test_provenance_in_another_library(here):
    hpcomp.stack(LAYERS, "out.exr", provenance="p.exr")
    file = oiio.ImageInput.open("p.exr")
    spec = file.spec()
    assert spec.channelnames == ("grey", "layer", "margin")
    assert [str(kind) for kind in spec.channelformats] == ["float", "uint", "float"]
    assert spec.getattribute("compression") == "zip"
    assert spec.getattribute("chromaticities") is None
    assert file.read_image(1, 2, "uint").max() == 3
    file.close()
    with OpenEXR.File("p.exr", separate_channels=True) as read:
        assert set(read.header()) >= {"dataWindow", "displayWindow", "pixelAspectRatio"}


def provenance_windows(path="p.exr"):
    with OpenEXR.File(path) as file:
        return [np.array(file.header()[name]).tolist() for name in ("dataWindow", "displayWindow")]


@pytest.mark.parametrize(
    "options",
    [
        {"region": "40x30+11+25"},
        {"overscan": True},
        {"canvas": "200x180-30-20"},
        {"canvas": "union", "region": "20x20+1+1"},
    ],
    ids=str,
)
def test_provenance_lies_where_the_picture_does(here, options):
    hpcomp.stack(LAYERS, "out.exr", provenance="p.exr", report="r.json", **options)
    assert provenance_windows() == provenance_windows("out.exr")
    document = json.loads((here / "r.json").read_text())
    with OpenEXR.File("p.exr", separate_channels=True) as file:
        layer = file.channels()["layer"].pixels
    assert layer.size == document["measures"]["pixels"]
    whole = expected_provenance(here, measures.HALF_STEP_FINE)["layer"]
    (left, top), (right, bottom) = provenance_windows()[0]
    common = Window(left, top, right - left + 1, bottom - top + 1).intersection(
        Window(0, 0, WIDTH, HEIGHT)
    )
    inside = layer[common.y - top : common.bottom - top, common.x - left : common.right - left]
    expected = whole[common.y : common.bottom, common.x : common.right]
    assert np.count_nonzero(inside != expected) <= TIES


def test_pixel_aspect_is_that_of_the_picture(here):
    values = exrfile.planes("RGBA", 20, 10)
    exrfile.write(here / "wide.exr", values, pixel_aspect=2.0)
    hpcomp.stack(["wide.exr"], "out.exr", provenance="p.exr")
    with OpenEXR.File("p.exr") as file:
        assert file.header()["pixelAspectRatio"] == 2.0


def test_provenance_alone_has_findings_too(here):
    found = hpcomp.stack(LAYERS, "out.png", provenance=here / "p.exr").findings
    assert found == hpcomp.stack(LAYERS, "out.png", report=here / "r.txt").findings


# ---- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--report", "r.gif"], ["r.gif", "names no format", ".html"]),
        (["--report", "r"], ["r:", "names no format"]),
        (["--report", ""], ["names no format"]),
        (["--provenance", "p.png"], ["p.png", ".exr"]),
        (["--provenance", ""], [".exr"]),
        (["--provenance", "-"], [".exr"]),
        (["--report", "r.json", "--report", "r.json"], ["r.json", "two outputs"]),
        (["--report", "r.json", "--report", "./r.json"], ["./r.json", "two outputs"]),
        (["--report", "out.png"], ["out.png", "two outputs"]),
        (["--report", "sub/../out.png"], ["out.png", "two outputs"]),
        (["--report", "-", "--report", "-"], ["stdout", "two outputs"]),
        (["--report", "r.json", "--bins", "5"], ["bins 5", "6 to 3600"]),
        (["--report", "r.json", "--bins", "3601"], ["bins 3601", "6 to 3600"]),
        (["--report", "r.json", "--achromatic", "1.5"], ["achromatic", "1.5", "0 to 1"]),
        (["--report", "r.json", "--achromatic", "nan"], ["achromatic", "nan", "0 to 1"]),
        (["--report", "r.json", "--foreign-tolerance", "181"], ["foreign", "181", "0 to 180"]),
        (["--report", "r.json", "--energy-weights", "1,2"], ["energy weights 1,2", "three"]),
        (["--report", "r.json", "--energy-weights", "1,2,x"], ["energy weights", "1,2,x"]),
        (["--report", "r.json", "--energy-weights", "1,2,-1"], ["energy weights 1,2,-1"]),
        (["--report", "r.json", "--energy-weights", "inf,2,1"], ["energy weights inf,2,1"]),
        (["--bins", "12"], ["bins 12", "--report"]),
        (["--achromatic", "0.1"], ["achromatic 0.1", "--report"]),
        (["--foreign-tolerance", "1"], ["foreign tolerance 1", "--report"]),
        (["--energy-weights", "1,2,3"], ["energy weights 1,2,3", "--report"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)  # fmt: skip
def test_usage(desk, options, words):
    (desk / "sub").mkdir()
    desk.refuses(2, "stack", "base.png", "-o", "out.png", *options, says=words)


def test_provenance_where_the_picture_goes(desk):
    (desk / "link.exr").symlink_to("out.exr")
    for name in ("out.exr", "link.exr"):
        desk.refuses(
            2, "stack", "base.png", "-o", "out.exr", "--provenance", name, says=["two outputs"]
        )


def test_picture_and_report_cannot_both_go_to_stdout(desk):
    desk.refuses(
        2, "stack", "base.png", "-o", "-", "--format", "png", "--report", "-",
        says=["stdout", "two outputs"],
    )  # fmt: skip


@pytest.mark.parametrize("option", ["--report", "--provenance"])
def test_missing_directory(desk, option):
    name = "nowhere/x.json" if option == "--report" else "nowhere/x.exr"
    desk.refuses(
        5, "stack", "base.png", "-o", "out.png", option, name, says=[name, "no directory nowhere"]
    )


@pytest.mark.parametrize("option", ["--report", "--provenance"])
def test_no_clobber_keeps_a_report(desk, option):
    name = "out.json" if option == "--report" else "out.exr"
    desk.refuses(
        5, "stack", "base.png", "-o", "new.png", option, name, "--no-clobber",
        says=[name, "exists", "--no-clobber"],
    )  # fmt: skip


def test_no_clobber_makes_reports_that_do_not_stand(desk):
    desk.makes(
        "stack", *LAYERS, "-o", "new.png", "--report", "new.json", "--provenance", "new.exr",
        "--no-clobber",
    )  # fmt: skip
    assert json.loads((desk / "new.json").read_bytes())["output"] == "new.png"


@pytest.mark.parametrize("name", ["r.svg", "r.png", "r.pdf"])
def test_figures_without_matplotlib_are_refused_before_any_work(desk, name):
    (desk.temporary.parent / "shadow").mkdir()
    (desk.temporary.parent / "shadow" / "matplotlib.py").write_text(
        "raise ModuleNotFoundError(\"No module named 'matplotlib'\", name='matplotlib')"
    )
    without = shell(f'PYTHONPATH="{desk.temporary.parent}/shadow" exec "$@"')
    # Not even the layers are looked at.
    desk.refuses(
        5, "stack", "missing.png", "-o", "out.png", "--report", "out.json", "--report", name,
        says=["matplotlib", "pip install 'hpcomp[plot]'"], through=without,
    )  # fmt: skip
    desk.makes("stack", *LAYERS, "-o", "out.png", "--report", "out.json", through=without)


def test_warnings_that_are_errors_leave_nothing(desk):
    values = {name: np.full((HEIGHT, WIDTH), 0.5, np.float32) for name in "RGBA"}
    values["A"][:] = 0
    exrfile.write(desk / "glow.exr", values)
    desk.refuses(
        4, "stack", "glow.exr", "-o", "out.png", "--report", "out.json", "--provenance",
        "out.exr", "--strict", says=["alpha"],
    )  # fmt: skip


# ---- whole or not at all -------------------------------------------------------------------------


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(
    ("option", "name"),
    [("--report", "out.json"), ("--report", "r.html"), ("--provenance", "out.exr")],
)
def test_full_disk(desk, option, name, threads):
    """The picture alone would fit; what is told of it does not."""
    desk.put("red.png", patches(1, (220, 40, 40), (40, 40)).encode())
    limit = shell('ulimit -f 12; exec "$@"')
    desk.makes("stack", "red.png", "-o", "fits.png", through=limit)
    arguments = "stack", "red.png", *(["river.exr"] if name == "out.exr" else [])
    options = ["--canvas", "union", "--threads", threads]
    desk.refuses(5, *arguments, "-o", "out.png", option, name, *options, says=[name], through=limit)


def test_full_device_behind_a_report(desk):
    (desk / "full.json").symlink_to("/dev/full")
    desk.refuses(
        5, "stack", *LAYERS, "-o", "out.png", "--report", "full.json",
        says=["full.json", "no space"],
    )  # fmt: skip


@pytest.mark.parametrize("name", ["pictures", "report"])
def test_failing_report_leaves_nothing(here, monkeypatch, name):
    """Whatever fails after the picture is done, and before it has its name."""
    hpcomp.stack(LAYERS, "out.png", report="r.html", provenance="p.exr")
    before = snapshot(here)

    def fail(*arguments):
        raise OutputError("it fails")

    if name == "pictures":
        monkeypatch.setattr(recorder.SmallPictures, "result", fail)
    else:
        monkeypatch.setattr(recorder, "render_stack_report", fail)
    with pytest.raises(OutputError, match="it fails"):
        hpcomp.stack(LAYERS[:2], "out.png", report=["r.html", "new.json"], provenance="p.exr")
    assert snapshot(here) == before


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
@pytest.mark.parametrize("threads", [1, 2])
def test_signal_while_compositing(desk, number, threads):
    large = {name: np.full((2000, 1000), 0.5, np.float16) for name in "RGBA"}
    exrfile.write(desk / "large.exr", large)
    before = snapshot(desk.folder.parent)
    known = set(desk.folder.iterdir())
    with running(
        desk, "stack", *["large.exr"] * 60, "-o", "out.png", "--compression", "0", "--report",
        "out.json", "--report", "new.html", "--provenance", "out.exr", "--threads", threads,
        "--max-memory", "256M",
    ) as process:  # fmt: skip
        temporary_of(process, desk.folder, known, at_least=100_000)
        process.send_signal(number)
        assert_ended(process, number)
    assert snapshot(desk.folder.parent) == before


# ---- the command ---------------------------------------------------------------------------------


def test_every_format_at_once(desk):
    reports = [word for ending in ENDINGS for word in ("--report", f"r.{ending}")]
    desk.makes("stack", *LAYERS, "-o", "out.png", *reports, "--provenance", "p.exr")
    heads = {"svg": b"<?xml", "png": b"\x89PNG", "pdf": b"%PDF", "html": b"<!doctype html>",
             "json": b"{", "txt": b"out.png\n", "csv": b"image,"}  # fmt: skip
    assert set(heads) == set(ENDINGS)
    for ending, head in heads.items():
        assert (desk / f"r.{ending}").read_bytes().startswith(head), ending


def test_report_says_the_command_and_what_was_chosen(desk):
    arguments = ["stack", *LAYERS, "-o", "out.png", "--report", "out.json", "--order", "top-down"]
    desk.makes(*arguments)
    document = json.loads((desk / "out.json").read_bytes())
    assert document["command"] == (
        "hpcomp stack base.png roads.png::opacity=0.7,name=roads river.exr -o out.png "
        "--report out.json --order top-down"
    )
    assert document["settings"]["order"] == "top-down"
    assert document["settings"]["blending"] == "hue-preserving"
    assert document["settings"]["output"] == "PNG, 8, fast"
    assert (document["hpcomp"], document["engine"]) == (hpcomp.__version__, engine.active().name)
    assert str(desk.folder) not in (desk / "out.json").read_text()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ([], {"strength": "chroma", "gray bias": "0", "weave": None}),
        (["--preset", "labels"], {"strength": "coverage", "gray bias": "1", "weave": None}),
        (["--preset", "woven"], {"strength": "coverage", "weave": "stripes of 8 pixels"}),
        (
            ["--blending", "woven", "--weave", "noise", "--weave-size", "3"],
            {"blending": "woven", "strength": "chroma", "weave": "noise of 3 pixels"},
        ),
    ],
)
def test_strength_and_weave_are_said_where_they_matter(desk, options, says):
    reports = ["--report", "out.json", "--report", "out.html"]
    run = desk.run("stack", *LAYERS, "-o", "out.png", *reports, "-v", *options)
    assert run.code == 0
    settings = json.loads((desk / "out.json").read_bytes())["settings"]
    assert {name: settings.get(name) for name in says} == says
    page = (desk / "out.html").read_text()
    assert all(value in page for value in says.values() if value is not None)
    (line,) = [line for line in run.lines if "canvas" in line and "space" in line]
    assert f"strength {says['strength']}" in line
    how = says["weave"] or f"order {settings['order']}"
    assert f"{settings['blending']}, {how}, space {settings['space']}" in line


def test_report_on_stdout_is_text(desk):
    run = desk.makes("stack", *LAYERS, "-o", "out.png", "--report", "-")
    assert run.stdout.decode().startswith("out.png\n\n")
    assert b"\x1b" not in run.stdout
    assert "foreign hue" in run.stdout.decode()


def test_report_of_a_picture_on_stdout(desk):
    run = desk.makes("stack", *LAYERS, "-o", "-", "--format", "png", "--report", "r.json")
    assert run.stdout.startswith(b"\x89PNG")
    assert json.loads((desk / "r.json").read_bytes())["output"] == "stdout"


def test_layer_from_stdin(desk):
    run = desk.makes(
        "stack", "base.png", "-", "-o", "out.png", "--report", "r.json",
        stdin=(desk / "roads.png").read_bytes(),
    )  # fmt: skip
    assert run.stdout == b""
    labels = [layer["label"] for layer in json.loads((desk / "r.json").read_bytes())["layers"]]
    assert labels == ["base.png", "stdin"]


@pytest.mark.parametrize("report", ["r.json", ["r.json"], ("r.json",)], ids=repr)
def test_reports_can_be_one_path_or_several(here, report):
    assert hpcomp.stack(LAYERS, "out.png", report=report).findings is not None
    assert json.loads((here / "r.json").read_text())["command"] == ""


def test_settings_without_a_report_are_refused_in_python_too(here):
    with pytest.raises(SettingError, match="bins 12 changes reports alone: name one"):
        hpcomp.stack(LAYERS, "out.png", bins=12)
    assert not (here / "out.png").exists()
