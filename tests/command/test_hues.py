"""`hpcomp hues` as a shell meets it: formats, terminals and pipes, bad input, what it leaves."""

import json
import os
import subprocess

import exrfile
import numpy as np
import pngfile
import pytest
from command import (
    OLD,
    PATIENCE_S,
    TERMINAL,
    Desk,
    command,
    hidden_matplotlib,
    loaded,
    on_terminal,
    shell,
    snapshot,
)

import hpcomp
from hpcomp.report.hueformats import REPORT_FORMATS

FIGURES = [name for name, row in REPORT_FORMATS.items() if row.module == ".huefigure"]


@pytest.fixture
def desk(tmp_path, monkeypatch):
    for name in TERMINAL:
        monkeypatch.delenv(name, raising=False)
    desk = Desk.made(tmp_path)
    desk.put("a.png", pngfile.bands((255, 0, 0), (0, 255, 0), (90, 90, 90)))
    desk.put("b.png", pngfile.bands((0, 0, 255), (255, 0, 0)))
    exrfile.write(desk / "c.exr", exrfile.planes("RGBA", 20, 90))
    return desk


def expected(name, *images, **look):
    """The report as the Python API makes it."""
    from hpcomp.report.look import Look

    entries = [(image.rpartition("/")[2], hpcomp.read_hues(image)) for image in map(str, images)]
    return REPORT_FORMATS[name].load()(entries, Look(**look))


# ---- formats and outputs ---------------------------------------------------------------------


@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_every_format_in_a_file_and_in_a_pipe(desk, name):
    content = expected(name, desk / "a.png", desk / "c.exr")
    ending = REPORT_FORMATS[name].ending
    run = desk.makes("hues", "a.png", "c.exr", "-o", f"report{ending}")
    assert run.stdout == b""
    assert (desk / f"report{ending}").read_bytes() == content
    assert desk.makes("hues", "a.png", "c.exr", "--format", name).stdout == content
    assert desk.makes("hues", "a.png", "c.exr", "--format", name, "-o", "-").stdout == content
    desk.makes("hues", "a.png", "c.exr", "--format", name, "-o", "report.odd")
    assert (desk / "report.odd").read_bytes() == content


def test_text_is_what_stdout_gets(desk):
    text = desk.makes("hues", "a.png").stdout.decode()
    assert text.startswith("a.png\n  96 pixels: 66.7% with a hue, 33.3% grey, 0% transparent\n")
    assert "\x1b" not in text
    assert desk.makes("hues", "a.png", "-o", "-").stdout.decode() == text


def test_looks(desk):
    look = {"weight": "chroma", "scale": "log", "axes": "polar"}
    options = [word for key, value in look.items() for word in (f"--{key}", value)]
    for name in ("text", "svg"):
        run = desk.makes("hues", "a.png", "b.png", "--format", name, *options)
        assert run.stdout == expected(name, desk / "a.png", desk / "b.png", **look)


def test_settings_reach_the_histogram(desk):
    run = desk.makes("hues", "c.exr", "--bins", 36, "--achromatic", 0.5, "--format", "json")
    found = hpcomp.read_hues(desk / "c.exr", bins=36, achromatic=0.5)
    document = json.loads(run.stdout)
    assert (document["bins"], document["achromatic"]) == (36, 0.5)
    assert document["images"][0]["histogram"]["count"] == found.count.tolist()
    assert document["images"][0]["pixels"]["grey"] == found.grey > 0


@pytest.mark.parametrize("space", hpcomp.SPACES)
def test_hue_and_chroma_are_those_of_the_space(desk, space):
    found = json.loads(desk.makes("hues", "b.png", "--space", space, "--format", "json").stdout)
    row = hpcomp.SPACES[space]
    histogram = found["images"][0]["histogram"]
    assert found["space"] == space
    for color in (np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])):  # a half each
        index = round(float(row.hue_axis.degrees(color))) % 360
        assert histogram["count"][index] == 12 * 8 / 2
        size = np.hypot(*row.forward(color[:, None])[1])[0]
        assert histogram["chroma"][index] == pytest.approx(12 * 8 / 2 * size, rel=1e-5)


@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_threads_do_not_change_a_byte(desk, name):
    one, many = (
        desk.makes("hues", "a.png", "c.exr", "--format", name, "--threads", n).stdout for n in (1, 4)
    )
    assert one == many


def test_names_of_images(desk):
    run = desk.makes("hues", "a.png::name=first", "-", "c.exr::alpha=straight", "--format", "json",
                     stdin=(desk / "b.png").read_bytes())  # fmt: skip
    assert [image["name"] for image in json.loads(run.stdout)["images"]] == ["first", "stdin", "c.exr"]


def test_settings_of_stdin(desk):
    run = desk.makes("hues", "-::name=piped,colorspace=linear", stdin=(desk / "b.png").read_bytes())
    assert run.stdout.startswith(b"piped\n")


# ---- terminals -------------------------------------------------------------------------------


def test_colours_on_a_terminal(desk):
    code, sent, error = on_terminal(desk, "hues", "a.png")
    assert (code, error) == (0, "")
    assert sent.encode() == expected("text", desk / "a.png", columns=90, color=True)
    assert "\x1b[38;2;255;0;0m█" in sent


@pytest.mark.parametrize(
    "env", [{"NO_COLOR": "1"}, {"TERM": "dumb"}, {"CLICOLOR": "0"}, {"NO_COLOR": "1", "FORCE_COLOR": "1"}]
)  # fmt: skip
def test_no_colours_where_they_are_not_wanted(desk, env):
    _, sent, _ = on_terminal(desk, "hues", "a.png", **env)
    assert sent.encode() == expected("text", desk / "a.png", columns=90)


def test_an_empty_no_color_says_nothing(desk):
    assert "\x1b" in on_terminal(desk, "hues", "a.png", NO_COLOR="")[1]


@pytest.mark.parametrize("name", ["FORCE_COLOR", "CLICOLOR_FORCE"])
def test_forced_colours(desk, name):
    plain = desk.makes("hues", "a.png").stdout
    for value, colored in (("1", True), ("3", True), ("0", False), ("", False)):
        run = desk.run("hues", "a.png", env={name: value})
        assert (b"\x1b" in run.stdout) == colored
        assert colored or run.stdout == plain
    both = desk.run("hues", "a.png", env={name: "1", "NO_COLOR": "1"})
    assert both.stdout == plain


def test_a_file_has_no_colours_whatever_the_environment(desk):
    run = desk.run("hues", "a.png", "-o", "a.txt", env={"FORCE_COLOR": "1", "COLUMNS": "40"})
    assert (run.code, (desk / "a.txt").read_bytes()) == (0, expected("text", desk / "a.png"))


@pytest.mark.parametrize("width", [40, 90, 200])
def test_a_chart_is_as_wide_as_the_terminal(desk, width):
    _, sent, _ = on_terminal(desk, "hues", "a.png", width=width, NO_COLOR="1")
    assert sent.encode() == expected("text", desk / "a.png", columns=width)
    (axis,) = [line for line in sent.splitlines() if "└" in line]
    assert width / 2 < len(axis) <= width


def test_columns_of_a_pipe(desk):
    run = desk.run("hues", "a.png", env={"COLUMNS": "50"})
    assert run.stdout == expected("text", desk / "a.png", columns=50)


@pytest.mark.parametrize("name", FIGURES)
def test_no_figure_on_a_terminal_unless_asked(desk, name):
    code, sent, error = on_terminal(desk, "hues", "a.png", "--format", name)
    assert (code, sent) == (2, "")
    assert error.splitlines()[-1].startswith(f"hpcomp: error: a terminal shows no {name}")
    code, sent, error = on_terminal(desk, "hues", "a.png", "--format", name, "-o", "a.figure")
    assert (code, sent, error) == (0, "", "")


def test_svg_on_a_terminal_that_asks_for_it(desk):
    code, sent, error = on_terminal(desk, "hues", "a.png", "--format", "svg", "-o", "-")
    assert (code, error) == (0, "")
    assert sent.encode() == expected("svg", desk / "a.png")


def test_letters_that_stdout_does_not_have(desk):
    run = desk.run("hues", "a.png", env={"PYTHONIOENCODING": "ascii"})
    assert run.code == 0
    assert run.stdout == expected("text", desk / "a.png", encoding="ascii")


# ---- images that cannot be measured ----------------------------------------------------------


def test_goes_on_after_an_image_that_cannot_be_read(desk):
    desk.put("bad.png", b"hello")
    run = desk.run("hues", "a.png", "bad.png", "nowhere.exr", "b.png", "--format", "json")
    assert run.code == 3
    assert [image["name"] for image in json.loads(run.stdout)["images"]] == ["a.png", "b.png"]
    assert len(run.lines) == 2
    assert run.lines[0].startswith("hpcomp: error: bad.png is neither a PNG nor an EXR")
    assert run.lines[1].startswith("hpcomp: error: nowhere.exr: cannot be read")


@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_a_report_that_would_lack_an_image_is_not_written(desk, name):
    output = f"report{REPORT_FORMATS[name].ending}"
    desk.put(output, OLD)
    desk.refuses(3, "hues", "a.png", "nowhere.png", "-o", output, says=["nowhere.png"])
    os.remove(desk / output)
    desk.refuses(3, "hues", "nowhere.png", "a.png", "-o", output, says=["nowhere.png"])


def test_nothing_is_printed_where_no_image_can_be_read(desk):
    desk.refuses(3, "hues", "nowhere.png", says=["nowhere.png", "no such file"])


def test_pixels_that_are_not_finite(desk):
    planes = exrfile.planes("RGBA", 10, 10)
    planes["G"][4, 7] = np.nan
    exrfile.write(desk / "nan.exr", planes)
    desk.refuses(4, "hues", "nan.exr", says=["nan.exr: 1 pixel is NaN", "at 7,4", "--nonfinite"])
    run = desk.makes("hues", "nan.exr", "--nonfinite", "keep")
    assert b"1.0% NaN or infinite" in run.stdout
    run = desk.run("hues", "nan.exr", "--nonfinite", "zero")
    assert run.code == 0
    assert run.lines == ["hpcomp: warning: nan.exr: 1 pixel is NaN or infinite and became transparent"]
    desk.refuses(4, "hues", "nan.exr", "--nonfinite", "zero", "--strict", says=["--strict"])
    assert desk.run("hues", "nan.exr", "--nonfinite", "zero", "-q").stderr == ""


def test_the_first_failure_decides_the_code(desk):
    planes = exrfile.planes("RGBA", 4, 4)
    planes["R"][0, 0] = np.inf
    exrfile.write(desk / "inf.exr", planes)
    assert desk.run("hues", "inf.exr", "nowhere.png").code == 4
    assert desk.run("hues", "nowhere.png", "inf.exr").code == 3


# ---- wrong settings --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["IMAGE..."]),
        (["a.png", "-o", "report.gif"], ["report.gif", ".svg", "--format"]),
        (["a.png", "-o", "report"], ["its ending names no format"]),
        (["a.png", "-o", ""], ["its ending names no format"]),
        (["a.png", "--format", "gif"], ["gif", "svg"]),
        (["a.png", "--bins", "5"], ["bins 5 is outside 6 to 3600"]),
        (["a.png", "--bins", "many"], ["many"]),
        (["a.png", "--achromatic", "1.5"], ["achromatic 1.5 is outside 0 to 1"]),
        (["a.png", "--achromatic", "nan"], ["achromatic nan"]),
        (["a.png", "--space", "rgb"], ["rgb", "linear-rgb"]),
        (["a.png", "--weight", "size"], ["size", "chroma"]),
        (["a.png", "--scale", "cubic"], ["cubic", "sqrt"]),
        (["a.png", "--axes", "none"], ["none", "polar"]),
        (["a.png", "--threads", "0"], ["0"]),
        (["a.png::opacity=0.5"], ["'opacity' says nothing of a single picture"]),
        (["a.png", "b.png::op=in"], ["b.png::op=in", "'op'"]),
        (["a.png::colour=red"], ["unknown layer key 'colour'"]),
        (["-", "-"], ["stdin can be only one of the images"]),
        (["a.png", "b.png", "-o", "b.png"], ["b.png is also an image to be measured"]),
        (["a.png", "-o", "./a.png"], ["is also an image"]),
    ],
    ids=" ".join,
)
def test_setting_that_does_not_exist_or_is_out_of_range(desk, arguments, words):
    desk.refuses(2, "hues", *arguments, says=words)


def test_link_to_an_image_as_output(desk):
    (desk / "link.png").symlink_to("a.png")
    desk.refuses(2, "hues", "a.png", "-o", "link.png", says=["link.png is also an image"])


# ---- outputs that cannot be written ----------------------------------------------------------


def test_output_in_a_missing_directory(desk):
    """It is noticed before the images are read."""
    desk.refuses(5, "hues", "nowhere.png", "-o", "no/report.svg", says=["there is no directory no"])


def test_no_clobber_keeps_a_report(desk):
    desk.put("report.json", OLD)
    desk.refuses(5, "hues", "a.png", "-o", "report.json", "--no-clobber", says=["--no-clobber"])
    desk.makes("hues", "a.png", "-o", "new.json", "--no-clobber")
    assert json.loads((desk / "new.json").read_bytes())["schema"] == "hpcomp.hues"


@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_full_disk_behind_stdout(desk, name):
    desk.refuses(
        5, "hues", "a.png", "--format", name, through=shell('exec "$@" > /dev/full'),
        says=["stdout", "no space left"],
    )  # fmt: skip


@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_full_disk(desk, name):
    """No file may hold more than two blocks of 512 bytes."""
    ending = REPORT_FORMATS[name].ending
    desk.put(f"report{ending}", OLD)
    images = ["a.png"] * 3
    desk.refuses(
        5, "hues", *images, "-o", f"report{ending}",
        through=shell('trap "" XFSZ; ulimit -f 2; exec "$@"'), says=["file too large"],
    )  # fmt: skip


def test_closed_stdout(desk):
    desk.refuses(5, "hues", "a.png", through=shell('exec "$@" >&-'), says=["stdout is closed"])


@pytest.mark.parametrize("name", REPORT_FORMATS)
def test_closed_pipe(desk, name):
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            command("hues", "a.png", "--format", name),
            cwd=desk.folder, stdout=writing, stderr=subprocess.PIPE, timeout=PATIENCE_S,
        )  # fmt: skip
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (141, b"")


# ---- libraries -------------------------------------------------------------------------------


@pytest.fixture
def without_matplotlib(desk):
    return hidden_matplotlib(desk)


@pytest.mark.parametrize("name", FIGURES)
def test_figures_without_matplotlib_say_what_to_install(desk, without_matplotlib, name):
    says = ["matplotlib", "pip install 'hpcomp[plot]'"]
    for arguments in (["--format", name], ["-o", f"report{REPORT_FORMATS[name].ending}"]):
        desk.refuses(5, "hues", "a.png", *arguments, says=says, through=without_matplotlib)


@pytest.mark.parametrize("name", [name for name in REPORT_FORMATS if name not in FIGURES])
def test_the_rest_does_without_matplotlib(desk, without_matplotlib, name):
    run = desk.makes("hues", "a.png", "--format", name, through=without_matplotlib)
    assert run.stdout == expected(name, desk / "a.png")


def test_what_is_loaded(desk):
    assert not loaded(desk, "hues", "--help") & {"OpenImageIO", "OpenEXR", "colour", "matplotlib"}
    assert not loaded(desk, "hues", "a.png") & {"OpenEXR", "colour", "matplotlib"}
    figure = loaded(desk, "hues", "a.png", "-o", "a.svg")
    assert "matplotlib.figure" in figure
    assert not figure & {"OpenEXR", "colour", "matplotlib.pyplot", "scipy"}


# ---- messages --------------------------------------------------------------------------------


def test_verbose_tells_how_an_image_was_read(desk):
    run = desk.run("hues", "a.png", "c.exr", "-v")
    assert run.code == 0
    assert run.lines[0].startswith("hpcomp: a.png: 12x8+0+0, sRGB, rec709, alpha straight: ")
    assert run.lines[1].startswith("hpcomp: c.exr: 20x90+0+0, linear, rec709, alpha premultiplied")
    assert run.stdout == desk.makes("hues", "a.png", "c.exr").stdout


def test_images_are_left_alone(desk):
    before = snapshot(desk.folder)
    desk.makes("hues", "a.png", "b.png", "c.exr")
    assert snapshot(desk.folder) == before


def test_what_blending_did_is_seen(desk):
    """Red over green, both ways: a third hue or two."""
    rgba = np.zeros((8, 16, 4), np.uint8)
    rgba[:, :12] = (255, 0, 0, 120)
    desk.put("red.png", pngfile.rgba_png(rgba).encode())
    rgba[:] = (0, 255, 0, 255)
    desk.put("green.png", pngfile.rgba_png(rgba).encode())
    hues = {}
    for blending in ("traditional", "hue-preserving"):
        desk.makes("stack", "green.png", "red.png", "--blending", blending, "-o", "out.exr")
        run = desk.makes("hues", "out.exr", "--format", "json")
        peaks = json.loads(run.stdout)["images"][0]["peaks"]
        hues[blending] = sorted(round(peak["hue"]) for peak in peaks)
    assert hues["hue-preserving"] == [120]
    assert hues["traditional"] not in ([120], [0, 120])
