"""What a name or a number that is spelled otherwise is answered with: the spelling that was meant."""

from __future__ import annotations

import re

import click
import exrfile
import numpy as np
import pngfile
import pytest
from command import Desk, hpcomp
from hypothesis import given
from hypothesis import strategies as st

from hpcomp.blending.orders import ORDERS
from hpcomp.blending.porter_duff import OPERATOR_NAMES
from hpcomp.cli.frontpage import COMMANDS
from hpcomp.cli.group import cli
from hpcomp.cli.options import Choice, shown_names
from hpcomp.color.css import css_color, css_names
from hpcomp.color.encodings import ALPHA_MODES, COLOR_INTEROP_IDS, COLOR_SPACES
from hpcomp.errors import SettingError, nearest_name, unknown_name
from hpcomp.geometry import CANVASES, GRAVITIES, parse_canvas, parse_placement, parse_window
from hpcomp.layers.layerspec import LAYER_KEYS, LAYER_NAMES, parse_layer
from hpcomp.measures.defaults import REPORT_ENDINGS
from hpcomp.options import OPTIONS
from hpcomp.report.hueformats import REPORT_FORMATS


@pytest.fixture
def desk(tmp_path):
    desk = Desk.made(tmp_path)
    samples = np.full((8, 10, 4), (200, 40, 40, 255))
    desk.put("base.png", pngfile.rgba_png(samples, 8).encode())
    desk.put("top.png", pngfile.rgba_png(samples, 8).encode())
    return desk


def commands():
    group = click.Context(cli)
    return {name: cli.get_command(group, name) for name in COMMANDS}


def slips(name):
    """Ways to mistype a name: a letter less, two letters the other way round, one that is wrong."""
    middle = len(name) // 2
    yield name[:middle] + name[middle + 1 :]
    yield name[: middle - 1] + name[middle] + name[middle - 1] + name[middle + 1 :]
    yield name[:-1] + "qq"


# ---- commands and options -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("stak", "stack"),
        ("Stack", "stack"),
        ("STACK", "stack"),
        ("flat", "flatten"),
        ("hue", "hues"),
    ],
)
def test_a_command_that_is_mistyped(desk, typed, meant):
    desk.refuses(
        2, typed, "base.png", says=[f"'{typed}'", f"did you mean '{meant}'?", *COMMANDS]
    )


def test_a_command_that_is_like_no_other(desk):
    line = desk.refuses(2, "zzz", says=["unknown command 'zzz': choose one of", *COMMANDS])
    assert "did you mean" not in line


def test_no_command_shows_help():
    """On stderr, with exit code 2, as groups of click do since its version 8.2."""
    run, asked = hpcomp(), hpcomp("--help")
    assert (run.code, run.stdout) == (2, b"")
    assert run.stderr == asked.stdout.decode()


OPTION_NAMES = [
    (command, name)
    for command, made in commands().items()
    for param in made.params
    if isinstance(param, click.Option) and not param.hidden
    for name in (*shown_names(param), *param.secondary_opts)
    if name.startswith("--")
]


@pytest.mark.parametrize("command", COMMANDS)
def test_options_that_are_mistyped(command):
    shown = [name[2:] for of, name in OPTION_NAMES if of == command]
    for name in shown:
        for typed in set(slips(name)) - {*shown, *LAYER_KEYS}:
            run = hpcomp(command, f"--{typed}")
            near = nearest_name(typed, shown)
            hint = f"did you mean '--{near}'?" if near else f"see hpcomp {command} --help"
            assert run.code == 2
            assert run.lines[1:] == [f"hpcomp: error: unknown option '--{typed}': {hint}"]
            assert near or len(name) < 5


@pytest.mark.parametrize(("command", "name"), OPTION_NAMES)
def test_one_dash_is_too_few(command, name):
    """-order would be -o with the value rder, and -json a number of jobs."""
    for typed in (name[1:], f"{name[1:]}=x"):
        run = hpcomp(command, "a.png", typed)
        assert run.code == 2
        assert run.lines[1] == f"hpcomp: error: unknown option '{name[1:]}': did you mean '{name}'?"


def test_words_behind_two_dashes_are_no_options(desk):
    desk.refuses(3, "stack", "-o", "out.png", "--", "-order", says=["-order", "no such file"])


@pytest.mark.parametrize(
    "key", ["opacity", "at", "alpha", "tint", "part", "layer", "colorspace", "name"]
)
def test_a_setting_of_a_layer_is_no_option(desk, key):
    desk.refuses(
        2, "stack", "base.png", "-o", "out.png", f"--{key}", "1",
        says=[f"unknown option '--{key}': it is a setting of one layer: write LAYER::{key}="],
    )  # fmt: skip


def test_what_is_an_option_and_a_setting_is_suggested_as_an_option():
    assert hpcomp("palette", "--opacitty", "1").lines[1].endswith("did you mean '--opacity'?")


CHOICES = [
    (command, param)
    for command, made in commands().items()
    for param in made.params
    if isinstance(param.type, click.Choice)
]


@pytest.mark.parametrize(("command", "param"), CHOICES)
def test_values_that_are_chosen(command, param):
    """Every choice of every command, also of what the command does not use."""
    assert isinstance(param.type, Choice)
    names = list(param.type.choices)
    typed = next(t for t in slips(max(names, key=len)) if t not in names)
    option = [param.opts[0]] if isinstance(param, click.Option) else []
    run = hpcomp(command, *option, typed)
    assert run.code == 2
    expected = unknown_name(param.type.noun, typed, names)
    assert run.lines[1].endswith(f": {expected}")
    assert ", ".join(names) in run.lines[1]
    assert "did you mean" in run.lines[1]


# ---- names ----------------------------------------------------------------------------------

TABLES = {
    "operators": OPERATOR_NAMES,
    "orders": ORDERS,
    "spaces": OPTIONS["space"].option.choices,
    "colorspaces": (*COLOR_SPACES, *COLOR_INTEROP_IDS),
    "alphas": ALPHA_MODES,
    "gravities": GRAVITIES,
    "keys": LAYER_KEYS,
    "commands": COMMANDS,
}


@pytest.mark.parametrize("table", TABLES)
def test_names_are_near_themselves(table):
    names = list(TABLES[table])
    for name in names:
        assert nearest_name(name.upper(), names) == name
        if len(name) > 5 and len({n[:5] for n in names}) == len(names):
            for typed in slips(name):
                assert nearest_name(typed, names) == name


@given(st.text(max_size=8), st.lists(st.text(min_size=1, max_size=8), min_size=1))
def test_a_lookup_lists_all_names(typed, names):
    said = str(unknown_name("thing", typed, names))
    assert said.endswith(f"hoose one of {', '.join(names)}")
    near = nearest_name(typed, names)
    assert near in ("", *names)
    assert (f"did you mean '{near}'?" in said) or not near


@pytest.mark.parametrize("number", ["10", "1", "3.5", "-1", ""])
def test_no_number_is_near_another(number):
    assert nearest_name(number, ["0", "100", "2.5", "11"]) == ""


# ---- settings of a layer --------------------------------------------------------------------


def refusal(settings):
    with pytest.raises(SettingError) as refused:
        parse_layer(f"top.png::{settings}")
    return str(refused.value)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ("at=10,20", "'10,20' is not a place: write +10+20"),
        ("at=10,20,opacity=0.5", "'10,20' is not a place: write +10+20"),
        ("opacity=0.5,at=-10, 20", "'-10, 20' is not a place: write -10+20"),
        ("at=10x20", "'10x20' is not a place: write +10+20"),
        ("at=center,10,20", "'center,10,20' is not a place: write center+10+20"),
        ("at=100x50+10+20", "write +10+20"),
        ("at=top-left", "did you mean 'north-west'?"),
        ("at=NorthWest", "write north-west"),
        ("at=centre", "did you mean 'center'?"),
        ("at=bottom right", "write south-east"),
        ("opacity=50%", "opacity '50%' is not a number from 0 to 1: write 0.5"),
        ("opacity=0,5", "opacity '0,5' is not a number from 0 to 1: write 0.5"),
        ("opacity=150%", "opacity '150%' is not a number from 0 to 1"),
        ("tint=255,0,0", "'255,0,0' is not a colour: write #ff0000"),
        ("tint=rgb(255, 128, 0)", "write #ff8000"),
        ("tint=0xFF8000", "write #ff8000"),
        ("tint=dark blue", "or darkblue"),
        ("tint=rde", "or red"),
        ("tint=300,0,0", "write a CSS colour such as #ff8800"),
        ("colorspace=sRGB", "did you mean 'srgb'?"),
        ("alpha=Straight", "did you mean 'straight'?"),
        ("op=ovr", "did you mean 'over'?"),
        ("opactiy=0.5", "unknown layer key 'opactiy': did you mean 'opacity'?"),
        ("atop", "did you mean op=atop?"),
        ("straight", "did you mean alpha=straight?"),
        ("center", "did you mean at=center?"),
        ("op:atop", "write op=atop"),
        (
            "blending=traditional",
            "'blending' is an option of the stack: write --blending traditional",
        ),
        ("hue-tolerance=3", "'hue-tolerance' is an option of the stack: write --hue-tolerance 3"),
    ],
)
def test_settings_that_are_spelled_otherwise(settings, said):
    assert said in refusal(settings)


def test_an_unknown_colorspace_is_told_all_names():
    said = refusal("colorspace=cmyk")
    for name in (*COLOR_SPACES, *COLOR_INTEROP_IDS):
        assert f" {name}" in said


def test_every_name_of_a_table_is_a_value():
    for key, names in LAYER_NAMES.items():
        for name in names:
            assert getattr(parse_layer(f"top.png::{key}={name}"), key) == name


def test_a_name_of_css_is_a_colour_wherever_its_digits_are(desk):
    assert (
        css_color("red", "tint") == css_color("#ff0000", "background") == css_color("f00", "label")
    )
    desk.put("mask.png", pngfile.random_png(pngfile.GREY, 8, width=10, height=8).encode())
    for option in ("tint", "background"):
        made = []
        for color in ("red", "#ff0000", "RED", "ff0000"):
            if option == "tint":
                desk.makes("stack", "base.png", f"mask.png::tint={color}", "-o", "out.png")
            else:
                desk.makes("stack", "base.png", "-o", "out.png", "--background", color)
            made.append((desk / "out.png").read_bytes())
        assert len(set(made)) == 1
    for name in css_names():
        assert parse_layer(f"mask.png::tint={name}").tint == name


@pytest.mark.parametrize("command", ["stack", "check", "explain", "flatten", "hues"])
def test_all_commands_that_take_layers_suggest_alike(desk, command):
    more = {"stack": ["-o", "o.png"], "flatten": ["-o", "o.png"], "explain": ["--at", "1,1"],
            "check": ["base.png", "--max-foreign", "0"]}.get(command, [])  # fmt: skip
    desk.refuses(
        2, command, "base.png", "top.png::colorspace=sRGB", *more, says=["did you mean 'srgb'?"]
    )


# ---- windows, places, orders, pixels --------------------------------------------------------


@pytest.mark.parametrize("read", [parse_window, parse_canvas])
@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("10,20,30,40", "30x40+10+20 for the corner 10,20 and the size 30x40"),
        ("10 20 30 40", "30x40+10+20 for the corner"),
        ("640x480", "640x480+0+0"),
        ("640X480+1+2", "640x480+1+2"),
        ("640x480,1,2", "640x480+1+2"),
        ("+1+2+640x480", "640x480+1+2"),
        ("0,0,-5,6", "640x480+0+0"),
        ("all", "640x480+0+0"),
    ],
)
def test_windows_that_are_spelled_otherwise(read, typed, meant):
    with pytest.raises(SettingError, match=re.escape(f"such as {meant}")):
        read(typed)


@pytest.mark.parametrize("name", CANVASES)
def test_canvases_that_are_mistyped(name):
    for typed in {name.capitalize(), *slips(name)} - {name}:
        with pytest.raises(SettingError, match=f"did you mean '{name}'"):
            parse_canvas(typed)


def test_a_canvas_that_is_a_window_is_told_what_is_wrong_with_it():
    with pytest.raises(SettingError, match="holds no pixel"):
        parse_canvas("0x5+0+0")


NUMBERS = st.integers(-9999, 9999)
BETWEEN = st.sampled_from([",", ", ", " ", ";", ":", "x"])


@given(NUMBERS, NUMBERS, BETWEEN)
def test_a_suggested_place_is_one(x, y, between):
    with pytest.raises(SettingError) as refused:
        parse_placement(f"{x}{between}{y}")
    place = parse_placement(str(refused.value).partition("write ")[2])
    assert (place.gravity, place.x, place.y) == (None, x, y)


@given(st.text(max_size=12))
def test_whatever_is_typed_is_refused_in_words(text):
    for read in (parse_window, parse_canvas, parse_placement):
        try:
            read(text)
        except SettingError as refused:
            suggested = re.search(r"such as (\d+x\d+[+-]\d+[+-]\d+)", str(refused))
            assert suggested is None or parse_window(suggested[1])


@pytest.mark.parametrize("read", [parse_window, parse_canvas, parse_placement])
def test_numbers_of_more_digits_than_python_reads(read):
    for text in ("9" * 5000, f"{'9' * 5000}x1+0+0", f"+{'9' * 5000}+0"):
        with pytest.raises(SettingError):
            read(text)


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("Bottom-Up", ["did you mean 'bottom-up'?"]),
        ("bottomup", ["did you mean 'bottom-up'?"]),
        ("1,2", ["not a permutation", "0 being the bottom", "write 0,1"]),
        ("2,1", ["write 1,0"]),
        ("1 0", ["such as 1,0"]),
        ("1-0", ["such as 1,0"]),
        ("[1, 0]", ["such as 1,0"]),
        ("sideways", [*ORDERS, "such as 2,0,1"]),
    ],
)
def test_orders_that_are_spelled_otherwise(desk, typed, words):
    desk.refuses(2, "stack", "base.png", "top.png", "-o", "o.png", "--order", typed, says=words)


@pytest.mark.parametrize("typed", ["+3+4", "3x4", "3 4", "3;4"])
def test_pixels_that_are_spelled_otherwise(desk, typed):
    desk.refuses(2, "explain", "base.png", "--at", typed, says=["write X,Y, such as 3,4"])


def test_forms_of_the_other_format(desk):
    for option, value, of in (("--compression", "zip", "EXR"), ("--depth", "half", "EXR")):
        desk.refuses(
            2, "stack", "base.png", "-o", "o.png", option, value, says=[f"; {value} is for {of}"]
        )
    desk.refuses(2, "stack", "base.png", "-o", "o.exr", "--depth", "16", says=["; 16 is for PNG"])


REFUSED_BY_ALL = [
    ("--report", "x.xyz", "report x.xyz: its ending names no format: end it in .txt, .json"),
    ("--provenance", "x.png", "provenance x.png is an EXR"),
    ("--compression", "zipp", "'zipp': did you mean 'zip"),
    ("--order", "upwards", "unknown order 'upwards'"),
    ("--energy-weights", "1,2", "energy weights 1,2 are not three numbers"),
    ("--out-primaries", "rec709x", "did you mean 'rec709'?"),
]


@pytest.mark.parametrize(("option", "value", "said"), REFUSED_BY_ALL)
@pytest.mark.parametrize("command", ["stack", "check", "explain", "save-job"])
def test_options_that_change_nothing_are_checked_too(desk, command, option, value, said):
    """One list of options is given to all of these: what is wrong in it is wrong everywhere.

    The layer is missing: it is said before anything is read.
    """
    arguments = {
        "stack": ["stack", "gone.png", "-o", "o.exr"],
        "save-job": ["stack", "gone.png", "-o", "o.exr", "--save-job", "j.json"],
        "check": ["check", "gone.png", "gone.png", "--max-foreign", "0"],
        "explain": ["explain", "gone.png", "--at", "1,1"],
    }[command]
    desk.refuses(2, *arguments, option, value, says=[said])


def test_endings_of_reports_are_those_of_the_formats():
    assert tuple(row.ending for row in REPORT_FORMATS.values()) == REPORT_ENDINGS


# ---- parts, layers, labels ------------------------------------------------------------------


def planes(*layers):
    names = [f"{layer}{c}" for layer in layers for c in "RGBA"]
    return {name: np.full((8, 10), 0.5, np.float16) for name in names}


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ("layer=Fg", ["no colour layer 'Fg'", "a part of that name: write part=Fg"]),
        ("part=glow", ["no part 'glow'", "a layer of that name: write layer=glow"]),
        ("part=fg", ["did you mean 'Fg'?", "part= one of Fg, Bg"]),
        ("part=Fgg", ["did you mean 'Fg'?"]),
        ("part=Bg,layer=glow", ["part Fg has it: write part=Fg,layer=glow"]),
        ("part=Fg,layer=Glow", ["did you mean 'glow'?"]),
        ("part=Fg,layer=glow.R", ["'glow.R' is a channel: write layer=glow"]),
        ("layer=zzzz", ["no colour layer 'zzzz'", "(default), glow"]),
    ],
)
def test_parts_and_layers_that_are_mistaken(desk, settings, words):
    exrfile.write_parts(
        desk / "parts.exr", [("Fg", planes("", "glow."), {}), ("Bg", planes(""), {})]
    )
    desk.refuses(3, "stack", f"parts.exr::{settings}", "-o", "o.exr", says=words)
    if "write " in words[-1]:
        meant = words[-1].partition("write ")[2]
        part = "" if "part=" in meant else ",part=Fg"
        desk.makes("stack", f"parts.exr::{meant}{part}", "-o", "o.exr")


def test_labels_that_are_mistyped(desk):
    desk.refuses(
        2, "check", "base.png", "base.png", "top.png::name=roads", "--require-hue", "layer:rods",
        says=["'layer:rods' is not one of the layers", "did you mean 'roads'?"],
    )  # fmt: skip


# ---- jobs -----------------------------------------------------------------------------------


def test_keys_and_names_of_jobs_are_suggested_too(desk):
    for job, words in (
        (
            '{"layers": ["base.png"], "output": "o.png", "blendign": "x"}',
            ["did you mean 'blending'?"],
        ),
        ('{"layers": [{"path": "base.png", "opactiy": 1}], "output": "o.png"}', ["'opacity'"]),
        ('{"layers": ["base.png::op=ovr"], "output": "o.png"}', ["did you mean 'over'?"]),
        ('{"layers": [{"path": "base.png", "colorspace": "sRGB"}], "output": "o.png"}', ["'srgb'"]),
    ):
        (desk / "jobs.json").write_text(job)
        desk.refuses(2, "batch", "jobs.json", says=["jobs.json:1", *words])


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("top.png:opacity=0.5", "top.png::opacity=0.5"),
        ("top.png:::opacity=0.5", "top.png::opacity=0.5"),
        ("top.png,opacity=0.5", "top.png::opacity=0.5"),
        ("top.png, opacity=0.5,op=atop", "top.png::opacity=0.5,op=atop"),
        ("top.png?at=+1+2", "top.png::at=+1+2"),
        ("top.png::name=x::opacity=0.5", "top.png::name=x,opacity=0.5"),
    ],
)
def test_settings_behind_another_sign(desk, typed, meant):
    run = desk.run("stack", "base.png", typed, "-o", "out.png")
    assert run.code == 2
    assert run.lines[-1].endswith(f"'{typed}' names no file: did you mean '{meant}'?")
    assert desk.run("stack", "base.png", meant, "-o", "out.png").code == 0


@pytest.mark.parametrize("name", ["top.png:opacity=1", "top.png::name=x", "a,op=over.png"])
def test_a_file_whose_name_looks_like_settings_is_read(desk, name):
    desk.put(name, (desk / "top.png").read_bytes())
    assert desk.run("stack", "base.png", name, "-o", "out.png").code == 0
    assert desk.run("stack", "base.png", f"{name}::opacity=0.5", "-o", "out.png").code == 0


def test_stdout_has_no_ending(desk):
    run = desk.run("stack", "base.png", "-o", "-")
    assert run.code == 2
    assert run.lines[-1].endswith(
        "stdout does not say its format: give --format png or --format exr"
    )
