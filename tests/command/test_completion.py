"""What a shell completes: the scripts, the words that they are given, and the exit code."""

from __future__ import annotations

import os
import shutil
import subprocess

import click
import exrfile
import numpy as np
import pngfile
import pytest
from command import COMMAND, Desk, command, hpcomp

from hpcomp.blending.orders import ORDERS
from hpcomp.blending.porter_duff import OPERATOR_NAMES
from hpcomp.cli.frontpage import COMMANDS
from hpcomp.cli.group import cli
from hpcomp.cli.options import OptionOfOlderName
from hpcomp.cli.words import Choice
from hpcomp.color.css import css_names
from hpcomp.color.encodings import ALPHA_MODES, COLOR_INTEROP_IDS, COLOR_SPACES
from hpcomp.geometry import CANVASES, GRAVITIES
from hpcomp.imagefile.forms import COMPRESSIONS, DEPTHS
from hpcomp.layers.layerspec import LAYER_KEYS

SHELLS = [name for name in ("bash", "zsh", "fish") if shutil.which(name)]
#: Bash's own, between which it parts words.
WORD_BREAKS = " \t\n\"'><=;|&(:"
WITH_HPCOMP = {**os.environ, "PATH": f"{COMMAND.parent}{os.pathsep}{os.environ['PATH']}"}


@pytest.fixture
def desk(tmp_path):
    """Pictures, job files, a folder, and what is hidden: by the user, by batches, by a run."""
    desk = Desk.made(tmp_path)
    picture = pngfile.rgba_png(np.full((8, 10, 4), 128), 8).encode()
    for name in ("base.png", "top.png", "my file.png", "TOP.PNG", ".hidden.png", "notes.txt"):
        desk.put(name, picture)
    for name in ("jobs.toml", "jobs.csv", ".jobs.toml.hpcomp-state", ".jobs.csv.hpcomp-state.new"):
        desk.put(name, b"")
    desk.put(".hpcomp.0123456789abcdef", picture)
    (desk / "folder").mkdir()
    (desk / "folder" / "in.exr").touch()
    (desk / ".git").mkdir()
    planes = {f"{layer}{c}": np.full((8, 10), 0.5, np.float16) for layer in ("", "glow.") for c in "RGBA"}
    exrfile.write_parts(desk / "parts.exr", [("Fg", planes, {}), ("Bg", planes, {})])
    return desk


def offered(desk, line, shell="fish"):
    """What a shell is offered at the end of a line; fish, which quotes and parts no words itself."""
    env = {"_HPCOMP_COMPLETE": f"{shell}_complete", "COMP_LINE": f"hpcomp {line}",
           "COMP_WORDBREAKS": WORD_BREAKS}  # fmt: skip
    run = desk.run(env=env)
    assert (run.code, run.stderr) == (0, "")
    lines = run.stdout.decode().splitlines()
    if shell == "zsh":
        return lines[1::3]
    assert all(line.startswith("plain,") for line in lines if line)
    return [line.removeprefix("plain,").partition("\t")[0] for line in lines if line]


# ---- what is offered ------------------------------------------------------------------------

LAYER_VALUES = {
    "op": OPERATOR_NAMES,
    "at": GRAVITIES,
    "alpha": ALPHA_MODES,
    "colorspace": (*COLOR_SPACES, *COLOR_INTEROP_IDS),
    "tint": css_names(),
    "opacity": (),
    "name": (),
    "part": (),
    "layer": (),
}


def test_keys_of_a_layer(desk):
    keys = sorted(LAYER_KEYS)
    assert offered(desk, "stack base.png top.png::") == [f"top.png::{key}=" for key in keys]
    assert offered(desk, "stack top.png::o") == ["top.png::op=", "top.png::opacity="]
    rest = [f"top.png::op=atop,opacity=0.5,{key}=" for key in keys if key not in ("op", "opacity")]
    assert offered(desk, "stack top.png::op=atop,opacity=0.5,") == rest


@pytest.mark.parametrize("key", LAYER_KEYS)
def test_values_of_a_key(desk, key):
    for head in ("top.png::", "top.png::name=a," if key != "name" else "top.png::op=over,"):
        expected = [f"{head}{key}={value}" for value in sorted(LAYER_VALUES[key])]
        assert offered(desk, f"stack base.png {head}{key}=") == expected
        for word in expected[:1]:
            assert word in offered(desk, f"stack base.png {word[:-1]}")


def test_parts_and_layers_of_a_file(desk):
    assert offered(desk, "stack parts.exr::part=") == ["parts.exr::part=Bg", "parts.exr::part=Fg"]
    assert offered(desk, "stack parts.exr::part=Fg,layer=") == ["parts.exr::part=Fg,layer=glow"]
    for line in ("stack nowhere.exr::part=", "stack notes.txt::layer=", "stack folder::part="):
        assert offered(desk, line) == []


def test_keys_of_stdin(desk):
    assert offered(desk, "stack base.png -::al") == ["-::alpha="]
    assert offered(desk, "stack base.png -::alpha=lu") == ["-::alpha=luminance"]


def test_what_is_no_file_is_not_asked(desk):
    """A pipe that nobody writes to would be waited for, and a terminal."""
    os.mkfifo(desk / "pipe.exr")
    for path in ("-", "pipe.exr", "/dev/zero", "folder"):
        assert offered(desk, f"stack {path}::layer=") == []


def test_names_that_are_no_text_are_left_out(desk):
    """A shell reads lines, and a LAYER has no commas in a value."""
    planes = {f"{layer}{c}": np.zeros((2, 3), np.float16) for layer in ("a,b.", "c.") for c in "RGBA"}
    exrfile.write(desk / "commas.exr", planes)
    assert offered(desk, "stack commas.exr::layer=") == ["commas.exr::layer=c"]
    for name in (b"new\nline.png", b"latin\xe9.png", b"tab\t.png"):
        with open(os.path.join(os.fsencode(desk.folder), name), "wb"):
            pass
    assert offered(desk, "stack ") == ["TOP.PNG", "base.png", "commas.exr", "folder/", "my file.png", "parts.exr", "top.png"]


@pytest.mark.parametrize(
    ("line", "without"),
    [
        ("hues top.png::", {"op", "opacity", "at"}),
        ("palette --from top.png::", {"op", "opacity", "at"}),
        ("flatten top.png::", {"op", "opacity", "tint"}),
        ("check top.png::", {"op", "opacity"}),
        ("check base.png top.png::", set()),
        ("explain base.png top.png::", set()),
    ],
)
def test_keys_that_mean_something_to_a_command(desk, line, without):
    keys = sorted(LAYER_KEYS.keys() - without)
    assert offered(desk, line) == [f"top.png::{key}=" for key in keys]


PICTURES = ["TOP.PNG", "base.png", "folder/", "my file.png", "parts.exr", "top.png"]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        *((f"{line} ", PICTURES) for line in ("stack", "stack base.png", "info", "hues", "check",
                                             "flatten", "explain", "palette --from", "stack -o")),
        ("batch ", ["folder/", "jobs.csv", "jobs.toml"]),
        ("stack ba", ["base.png"]),
        ("stack folder/", ["folder/in.exr"]),
        ("stack ./fold", ["./folder/"]),
        ("stack nowhere/", []),
        ("stack .", [".git/", ".hidden.png"]),
        ("batch .j", []),
        ("hues base.png -o ", ["TOP.PNG", "base.png", "folder/", "jobs.csv", "my file.png", "notes.txt", "top.png"]),
        ("stack base.png --depfile n", ["notes.txt"]),
    ],
)  # fmt: skip
def test_files(desk, line, expected):
    """Those that a command reads, and none that is hidden unless a dot was typed."""
    assert offered(desk, line) == expected


def test_files_of_home(desk):
    env = {"_HPCOMP_COMPLETE": "bash_complete", "COMP_LINE": "hpcomp stack ~/ba", "HOME": str(desk.folder),
           "COMP_WORDBREAKS": WORD_BREAKS}  # fmt: skip
    assert desk.run(env=env, process=True).stdout == b"plain,~/base.png\n"


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("stack a.png --order ", ORDERS),
        ("stack a.png --canvas ", CANVASES),
        ("stack a.png --background ", css_names()),
        ("palette ", css_names()),
        ("palette --background ", css_names()),
        *(
            (f"stack a.png {output} --{option} ", table[of])
            for option, table in (("compression", COMPRESSIONS), ("depth", DEPTHS))
            for output, of in (
                ("-o out.png", "png"), ("-o out.exr", "exr"), ("-o - --format exr", "exr"),
                ("--output=out.png", "png"),
            )
        ),
        *(
            (f"stack a.png {output} --{option} ", {name for names in table.values() for name in names})
            for option, table in (("compression", COMPRESSIONS), ("depth", DEPTHS))
            for output in ("", "-o out.jpg", "-o -")
        ),
    ],
)  # fmt: skip
def test_values_of_options(desk, line, names):
    assert offered(desk, line) == sorted(names)


def test_values_behind_an_equals_sign(desk):
    assert offered(desk, "stack a.png --order=b") == ["--order=balanced", "--order=bottom-up"]
    assert offered(desk, "stack a.png --order=b", "bash") == ["balanced", "bottom-up"]


def commands():
    group = click.Context(cli)
    return {name: cli.get_command(group, name) for name in COMMANDS}


CHOSEN = [
    (f"{name} {param.opts[0]}" if isinstance(param, click.Option) else name, param)
    for name, made in commands().items()
    for param in made.params
    if isinstance(param.type, click.Choice)
]


@pytest.mark.parametrize(("option", "param"), CHOSEN, ids=lambda value: value if isinstance(value, str) else "")
def test_every_choice_is_offered(desk, option, param):
    assert isinstance(param.type, Choice)
    assert offered(desk, f"{option} ") == sorted(param.type.choices)


@pytest.mark.parametrize("name", COMMANDS)
def test_options_of_a_command(desk, name):
    """Sorted, without older spellings and without those that change nothing there."""
    given = offered(desk, f"{name} -")
    assert given == sorted(given)
    for param in commands()[name].params:
        if isinstance(param, click.Option):
            shown = [] if param.hidden else param.opts[:1]
            older = param.opts[1:] if isinstance(param, OptionOfOlderName) else []
            assert set(shown) <= set(given)
            assert not set(older) & set(given)
            assert param.hidden is False or not set(param.opts) & set(given)
    assert "--help" in given


def test_commands(desk):
    assert offered(desk, "") == sorted(COMMANDS)
    assert offered(desk, "st") == ["stack"]


# ---- what each shell does with it -----------------------------------------------------------


def test_bash_is_here():
    """Elsewhere the tests of completion run with the shells that are installed."""
    assert "bash" in SHELLS


@pytest.mark.parametrize("name", ["bash", "zsh", "fish"])
def test_completion_script_is_printed(name):
    run = hpcomp("completion", name)
    assert (run.code, run.stderr) == (0, "")
    assert b"_HPCOMP_COMPLETE" in run.stdout


@pytest.mark.parametrize("name", SHELLS)
def test_completion_script_is_parsed_by_its_shell(tmp_path, name):
    script = tmp_path / "script"
    script.write_bytes(hpcomp("completion", name).stdout)
    done = subprocess.run([name, "-n", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


#: What is typed, and what stands on the line after the tab key.
TYPED = [
    ("st", "stack "),
    ("stack --bl", "stack --blending "),
    ("stack --blending tra", "stack --blending traditional "),
    ("stack a.png --order", "stack a.png --order "),
    ("info --js", "info --json "),
    ("completion f", "completion fish "),
    ("stack top.png::al", "stack top.png::alpha="),
    ("stack top.png::op=ato", "stack top.png::op=atop "),
    ("stack top.png::op=atop,opa", "stack top.png::op=atop,opacity="),
    ("stack 'top.png::op=atop,opa", "stack 'top.png::op=atop,opacity="),
    ("stack fold", "stack folder/"),
    ("stack folder/", "stack folder/in.exr "),
    ("stack my", "stack my\\ file.png "),
    ("stack my\\ file.png::til", "stack my\\ file.png::til"),
    ("stack my\\ file.png::ti", "stack my\\ file.png::tint="),
    ("batch jobs.t", "batch jobs.toml "),
    ("stack a.png --compression=dwaa", "stack a.png --compression=dwaa "),
    ('stack "my file.png::la', 'stack "my file.png::layer='),
]


@pytest.mark.parametrize(("typed", "expected"), TYPED)
def test_the_tab_key_in_bash(desk, typed, expected):
    assert in_bash(desk, typed) == expected


def in_bash(desk, typed):
    """What bash makes of a line: its function is called as bash does, its reply put in place."""
    line = f"hpcomp {typed}"
    script = (
        'eval "$(hpcomp completion bash)"\n'
        "spec=$(complete -p hpcomp); function=${spec##*-F }; function=${function%% *}\n"
        "compopt() { nospace=1; }\n"
        'COMP_LINE=$1; COMP_POINT=${#1}; COMP_WORDBREAKS=$2; $function hpcomp "" ""\n'
        'printf "%s\\n" "${nospace:-0}" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ["bash", "--norc", "-c", script, "bash", line, WORD_BREAKS],
        cwd=desk.folder, capture_output=True, text=True, env=WITH_HPCOMP,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    nospace, *replies = done.stdout.splitlines()
    if len(replies) != 1 or not replies[0]:
        return typed
    begin = 0
    for place, character in enumerate(line):
        if character in WORD_BREAKS and line[place - 1] != "\\":
            begin = place + 1
        if quotes := [line.index(quote) for quote in "'\"" if quote in line]:
            begin = quotes[0] + 1
    return f"{line[:begin]}{replies[0]}{'' if nospace == '1' else ' '}".removeprefix("hpcomp ")

@pytest.mark.parametrize("name", ["bash", "zsh", "fish"])
@pytest.mark.parametrize("asked", ["complete", "source"])
def test_a_shell_that_completes_is_told_that_all_is_well(desk, name, asked):
    env = {"_HPCOMP_COMPLETE": f"{name}_{asked}", "COMP_WORDS": "hpcomp st", "COMP_CWORD": "1"}
    run = desk.run(env=env, process=True)
    assert (run.code, run.stderr) == (0, "")
    assert run.stdout
    reading, writing = os.pipe()
    os.close(reading)
    closed = subprocess.run(
        command(), stdout=writing, stderr=subprocess.PIPE, env={**os.environ, **env}
    )
    os.close(writing)
    assert (closed.returncode, closed.stderr) == (141, b"")


@pytest.mark.parametrize("asked", ["tcsh_complete", "bash_words", "1"])
def test_a_shell_that_is_not_known(desk, asked):
    run = desk.run(env={"_HPCOMP_COMPLETE": asked}, process=True)
    assert (run.code, run.stdout) == (2, b"")
    assert len(run.lines) == 1
    for word in ("hpcomp: error: ", "_HPCOMP_COMPLETE", "bash", "zsh", "fish"):
        assert word in run.stderr
