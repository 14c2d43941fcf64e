"""What README, man pages, the reference, docstrings and types say is true of the installed package."""

import ast
import importlib.metadata
import importlib.util
import inspect
import itertools
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import typing
from pathlib import Path

import click
import command
import deepfile
import exrfile
import numpy as np
import pytest

import hpcomp
from hpcomp.blending.blendings import BLENDINGS
from hpcomp.blending.orders import ORDERS
from hpcomp.blending.porter_duff import OPERATOR_NAMES, OPERATORS
from hpcomp.blending.strength import STRENGTHS
from hpcomp.blending.weaving import PATTERNS
from hpcomp.cli.frontpage import COMMANDS
from hpcomp.cli.group import cli
from hpcomp.cli.options import shown_names
from hpcomp.color.encodings import ALPHA_MODES, COLOR_INTEROP_IDS, COLOR_SPACES
from hpcomp.color.spaces import SPACES
from hpcomp.errors import EXIT_CODE_MEANINGS, ExitCode
from hpcomp.geometry import CANVASES, GRAVITIES
from hpcomp.imagefile.forms import COMPRESSIONS, DEPTHS, NONFINITE_POLICIES
from hpcomp.keywords import FlattenKeywords, StackKeywords
from hpcomp.layers.layerspec import LAYER_KEYS
from hpcomp.options import ARRAY_RULES, PRESETS
from hpcomp.options import OPTIONS as STACK_OPTIONS
from hpcomp.pipeline.flatten import FLATTEN_OPTIONS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
MAN = ROOT / "man"
REFERENCE = (MAN / "REFERENCE.md").read_text(encoding="utf-8")

#: The pages of the manual that are written in Markdown, by name and section.
WRITTEN = {path.name.removesuffix(".md"): path for path in sorted(MAN.glob("hpcomp-*.md"))}
ROFF = sorted(MAN.glob("man[0-9]/*"))


def load_generate():
    spec = importlib.util.spec_from_file_location("generate", ROOT / "man" / "generate.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["generate"] = module  # where a dataclass looks its annotations up
    spec.loader.exec_module(module)
    return module


generate = load_generate()


def click_commands():
    """(name, command, context) of the command and of each subcommand, straight from click."""
    context = click.Context(cli, info_name="hpcomp", help_option_names=["-h", "--help"])
    yield "hpcomp", cli, context
    for name in COMMANDS:
        command = cli.get_command(context, name)
        yield f"hpcomp {name}", command, click.Context(command, info_name=name, parent=context)


TREE = {name: (command, context) for name, command, context in click_commands()}
OPTIONS = [
    (name, parameter)
    for name, (command, context) in TREE.items()
    for parameter in command.get_params(context)
    if isinstance(parameter, click.Option)
]


def words(text):
    """The text with its lines joined, to be searched whatever its wrapping."""
    return " ".join(text.split())


def written(name):
    """The Markdown of a page such as hpcomp-files.7."""
    return WRITTEN[name].read_text(encoding="utf-8")


def reference_section(name):
    """What REFERENCE.md says of one command, without Markdown's escapes."""
    found = re.search(rf"^## {name}\n(.*?)^## ", REFERENCE, re.MULTILINE | re.DOTALL)
    assert found, f"REFERENCE.md has no section '{name}'"
    return words(re.sub(r"\\([\\*_<])", r"\1", found[1]))


ESCAPES = {r"\-": "-", r"\e": "\\", r"\&": "",
           r"\(aq": "'", r"\(ga": "`", r"\(ha": "^", r"\(ti": "~"}  # fmt: skip
ESCAPE = re.compile(r"\\(?:f[BIR]|\(..|.)")


def man_source(name):
    """The roff of the page of a command, or of another such as hpcomp-files.7."""
    page = name if name in WRITTEN else f"{name.replace(' ', '-')}.1"
    return (MAN / f"man{page[-1]}" / page).read_text(encoding="utf-8")


def man_text(source):
    """What a page reads as, on one line: requests dropped, escapes undone."""
    lines = [line for line in source.splitlines() if not line.startswith(".")]
    return words(ESCAPE.sub(lambda m: ESCAPES.get(m[0], ""), "\n".join(lines)))


def man_sections(name):
    parts = re.split(r'^\.SH "(.*)"\n', man_source(name), flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


# ---- the generated pages -------------------------------------------------------------------------


def test_reference_and_man_pages_are_what_the_command_says_now():
    stale = [path.name for path in generate.stale(generate.generated())]
    assert stale == [], "run: python man/generate.py"


@pytest.fixture
def copied(tmp_path):
    """A copy of what `generate.py` reads and writes."""
    shutil.copytree(MAN, tmp_path / "man", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def run_generate(root, *arguments, **environment):
    return subprocess.run(
        [sys.executable, root / "man" / "generate.py", *arguments],
        cwd=root.parent,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )


def test_neither_terminal_nor_locale_nor_directory_changes_the_pages(copied):
    run = run_generate(copied, "--check", COLUMNS="40", LC_ALL="C", TERM="dumb", TZ="Asia/Tokyo")
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")


def edit(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), encoding="utf-8")


DAMAGES = {
    "man/REFERENCE.md": lambda path: edit(path, "## hpcomp info", "## info"),
    "man/man1/hpcomp.1": lambda path: path.unlink(),
    "man/man1/hpcomp-stack.1": lambda path: path.write_text("old"),
    "man/man1/hpcomp-gone.1": lambda path: path.touch(),
    "man/man7/hpcomp-files.7": lambda path: edit(path, "WHAT IS NOT READ", "WHAT IS READ"),
    "man/man5/hpcomp-gone.5": lambda path: path.touch(),
    "man/hpcomp-blending.7.md": lambda path: edit(path, "| `xor` |", "| `XOR` |"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_check_names_what_is_stale_and_writing_mends_it(copied, name):
    DAMAGES[name](copied / name)
    check = run_generate(copied, "--check")
    assert (check.returncode, check.stdout) == (1, "")
    assert re.fullmatch(rf"{re.escape(name)} is stale: .*\n", check.stderr)
    assert run_generate(copied).returncode == 0
    assert run_generate(copied, "--check").returncode == 0
    for path in [MAN / "REFERENCE.md", *WRITTEN.values(), *ROFF]:
        assert (copied / path.relative_to(ROOT)).read_bytes() == path.read_bytes()
    assert not (copied / "man/man1/hpcomp-gone.1").exists()


def test_a_page_without_its_roff_gets_it_in_a_folder_that_may_be_new(copied):
    shutil.rmtree(copied / "man" / "man5")
    assert run_generate(copied).returncode == 0
    page = copied / "man" / "man5" / "hpcomp-jobs.5"
    assert page.read_text(encoding="utf-8") == man_source("hpcomp-jobs.5")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<!-- end generated: operators -->", "", "operators"),
        ("<!-- begin generated: operators -->", "", "operators"),
        ("# hpcomp-blending(7): how", "# hpcomp-blending(1): how", "hpcomp-blending(7)"),
    ],
)
def test_a_page_without_a_marker_or_a_title_is_an_error(copied, old, new, message):
    edit(copied / "man" / "hpcomp-blending.7.md", old, new)
    run = run_generate(copied)
    assert run.returncode == 1
    assert message in run.stderr


def test_a_marker_with_an_unknown_name_is_an_error():
    with pytest.raises(ValueError, match=r"'colours'.*operators"):
        generate.with_parts("<!-- begin generated: colours -->\n<!-- end generated: colours -->\n")


def test_a_help_text_that_no_page_could_show_is_refused():
    with pytest.raises(ValueError, match="neither commands nor definitions"):
        generate.help_blocks("Does it.\n\n\b\n  hpcomp stack\n  one-space only")


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        (r"a\b-c", r"a\eb\-c"),
        ("~/x^2", r"\(ti/x\(ha2"),
        ("say `it's -x` twice", r"say \fBit\(aqs \-x\fR twice"),
    ],
)
def test_text_is_escaped_for_roff(text, escaped):
    assert generate.prose(text) == [escaped]


@pytest.mark.parametrize("start", [".png is an ending", "'quoted' at the start"])
def test_a_line_never_becomes_a_request(start):
    lines = generate.prose(f"{start} {'x' * 76} {start}")
    assert lines[0].startswith(rf"\&{start[0]}")
    assert lines[-1].startswith(rf"\&{start[0]}")
    assert len(lines) > 1


# ---- every command, option, key and value is documented ------------------------------------------


def test_every_command_has_a_page_and_a_section():
    pages = {path.name for path in ROFF}
    assert pages == {f"{n.replace(' ', '-')}.1" for n in TREE} | set(WRITTEN)
    headings = re.findall(r"^## (.*)$", REFERENCE, re.MULTILINE)
    assert headings == [*TREE, "Exit codes"]


@pytest.mark.parametrize("name", COMMANDS)
def test_the_main_page_lists_the_command_and_the_summaries_agree(name):
    help_line = COMMANDS[name][1]
    command, _ = TREE[f"hpcomp {name}"]
    assert command.short_help == help_line
    assert words(inspect.cleandoc(command.help)).startswith(help_line)
    assert f"hpcomp-{name}(1) {help_line}" in man_text(man_sections("hpcomp")["COMMANDS"])
    assert help_line in reference_section(f"hpcomp {name}")
    purpose = f"{help_line[0].lower()}{help_line[1:].rstrip('.')}"
    assert man_text(man_sections(f"hpcomp {name}")["NAME"]) == f"hpcomp-{name} - {purpose}"


@pytest.mark.parametrize(("name", "option"), OPTIONS, ids=lambda v: v if type(v) is str else v.name)
def test_every_option_is_in_the_reference_and_in_its_man_page(name, option):
    section, page = reference_section(name), man_text(man_sections(name)["OPTIONS"])
    for spelling in (*shown_names(option), *option.secondary_opts):
        assert re.search(rf"- `[^`]*(?<![\w-]){spelling}\b(?!-)", section)
        assert re.search(rf"(?<![\w-]){spelling}\b(?!-)", page)
        assert f"\\fB{spelling.replace('-', chr(92) + '-')}\\fR" in man_source(name)
    value = option.metavar or ("" if option.is_flag else "|".join(option.type.choices))
    term = f"{sorted(shown_names(option), key=len)[-1]} {value}".strip()
    for text in (section, page):
        assert term in text
        assert words(option.help) in text
    if option.show_default and not option.secondary_opts:
        assert f"(default `{option.default}`): {words(option.help)}" in section
        assert f"{words(option.help)} Default {option.default}." in page
    if option.required:
        assert f"(required): {words(option.help)}" in section
        assert f"{words(option.help)} Required." in page


def test_every_layer_key_is_documented():
    for key in LAYER_KEYS:
        assert f"- `{key}=" in reference_section("hpcomp stack")
        assert f".TP\n\\fB{key}=\\fR\\fI" in man_sections("hpcomp stack")["DESCRIPTION"]


@pytest.mark.parametrize(
    "names",
    [OPERATOR_NAMES, ORDERS, BLENDINGS, STRENGTHS, PATTERNS, PRESETS, SPACES, CANVASES, ALPHA_MODES, NONFINITE_POLICIES,
     COLOR_SPACES, COLOR_INTEROP_IDS, DEPTHS["png"] + DEPTHS["exr"], COMPRESSIONS["exr"],
     COMPRESSIONS["png"][:2]],
    ids=lambda names: next(iter(names)),
)  # fmt: skip
def test_every_value_is_documented(names):
    page = man_text(man_source("hpcomp stack"))
    explained = words(" ".join([REFERENCE, *map(written, WRITTEN)]))
    for name in names:
        for text in (explained, page):
            assert re.search(rf"(?<![\w-]){name}(?![\w-])", text), name


def test_gravities_are_named_by_the_words_of_the_table():
    shown = re.findall(r"\b(?:center|(?:north|south|east|west)(?:-east|-west)?)\b", REFERENCE)
    assert set(shown) <= set(GRAVITIES)
    assert len(set(shown)) >= 3


def table(text):
    """The rows of a table as lists of cells, its two head lines left out."""
    rows = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows[2:]]


def generated_table(page, name):
    part = written(page).partition(f"<!-- begin generated: {name} -->")[2]
    return table(part.partition(f"<!-- end generated: {name} -->")[0])


def test_the_operators_of_the_page_are_those_of_the_table():
    rows = generated_table("hpcomp-blending.7", "operators")
    assert [row[0].strip("`") for row in rows] == list(OPERATORS)
    for name, aliases, factor_a, factor_b in rows:
        operator = OPERATORS[name.strip("`")]
        assert tuple(re.findall(r"`(.*?)`", aliases)) == operator.aliases
        for alpha_a, alpha_b in ((0.3, 0.6), (0.0, 1.0), (1.0, 0.25)):
            values = {"α_A": alpha_a, "α_B": alpha_b}
            shown = [eval(f.replace("−", "-"), values) for f in (factor_a, factor_b)]
            assert shown == pytest.approx([float(f) for f in operator.factors(alpha_a, alpha_b)])


@pytest.mark.parametrize(
    ("page", "heading", "names"),
    [
        ("hpcomp-blending.7", "Orders", ORDERS),
        ("hpcomp-blending.7", "Blending spaces", SPACES),
        ("hpcomp-blending.7", "Strength", STRENGTHS),
        ("hpcomp-blending.7", "Presets", PRESETS),
        ("hpcomp-blending.7", "Woven blending", PATTERNS),
        ("hpcomp-files.7", "Colour spaces", COLOR_SPACES),
        ("hpcomp-reports.7", "Provenance", ["layer", "grey", "margin"]),
    ],
)
def test_a_section_explains_every_name_of_its_table(page, heading, names):
    section = re.search(rf"^## {heading}\n(.*?)(?=^## )", written(page) + "## ", re.M | re.S)[1]
    explained = re.findall(r"^(?:- |\| )`(.*?)`(?::| \|)", section, re.MULTILINE)
    assert set(names) <= set(explained)


# ---- exit codes ----------------------------------------------------------------------------------


def test_the_exit_codes_of_the_reference_are_those_of_the_enum():
    assert table(REFERENCE.partition("## Exit codes")[2]) == [
        [str(code.value), EXIT_CODE_MEANINGS[code]] for code in ExitCode
    ]


@pytest.mark.parametrize("name", TREE)
def test_the_exit_codes_of_the_man_page_are_those_of_the_enum(name):
    rows = man_sections(name)["EXIT STATUS"].split(".TP\n")[1:]
    shown = [man_text(row) for row in rows]
    meanings = {int(code): EXIT_CODE_MEANINGS[code] for code in ExitCode}
    assert shown == [f"{c} {text[0].upper()}{text[1:]}." for c, text in meanings.items()]


# ---- man pages -----------------------------------------------------------------------------------

REQUESTS = {".TH", ".SH", ".PP", ".TP", ".IP", ".RS", ".RE", ".nf", ".fi", ".sp", ".nh", ".ad",
            ".TS", ".TE"}  # fmt: skip
SECTIONS = {"1": "User Commands", "5": "File Formats", "7": "Concepts"}


@pytest.mark.parametrize("name", [*TREE, *WRITTEN])
def test_man_page_is_sound_roff(name):
    comment, title, *lines = man_source(name).splitlines()
    if ".TS" in lines:  # tables are set by tbl: man looks for this line
        assert comment == "'\\\" t"
        comment, title, *lines = title, *lines
    assert comment.startswith('.\\" ')
    page, section = name.split(".") if name in WRITTEN else (name.replace(" ", "-"), "1")
    page = page.replace("-", "\\-").upper()
    version = f"hpcomp {hpcomp.__version__}"
    assert title == f'.TH {page} {section} "" "{version}" "{SECTIONS[section]}"'
    for line in lines:
        if line.startswith("."):
            assert line.split()[0] in REQUESTS
            continue
        assert line.strip()
        assert not line.startswith("'")
        assert {m[0] for m in ESCAPE.finditer(line)} <= {*ESCAPES, r"\fB", r"\fI", r"\fR"}
        assert "-" not in line.replace(r"\-", "")
    # A paragraph, whose lines may break between the words of one literal, ends in the usual font.
    for paragraph in re.split(r"^\..*\n", "\n".join(lines) + "\n", flags=re.MULTILINE):
        fonts = re.findall(r"\\f([BIR])", paragraph)
        assert all(font in "BI" for font in fonts[::2])
        assert all(font == "R" for font in fonts[1::2])
        assert len(fonts) % 2 == 0
    for begin, end in ((".nf", ".fi"), (".RS 4", ".RE"), (".TS", ".TE")):
        assert lines.count(begin) == lines.count(end)


@pytest.mark.parametrize("name", TREE)
def test_man_page_has_its_sections_in_the_usual_order(name):
    usual = ["NAME", "SYNOPSIS", "DESCRIPTION", "COMMANDS", "OPTIONS", "ENVIRONMENT", "FILES",
             "OPERATORS", "COLOUR SPACES", "PROVENANCE", "JSON", "CSV", "EXIT STATUS", "EXAMPLES",
             "SEE ALSO"]  # fmt: skip
    sections = list(man_sections(name))
    assert sections == [section for section in usual if section in sections]
    for section in ("NAME", "SYNOPSIS", "DESCRIPTION", "OPTIONS", "EXIT STATUS", "SEE ALSO"):
        assert section in sections


@pytest.mark.parametrize("name", [*TREE, *WRITTEN])
def test_man_page_names_all_other_pages(name):
    pages = {n: f"{n.replace(' ', '-')}(1)" for n in TREE}
    pages |= {n: "{}({})".format(*n.split(".")) for n in WRITTEN}
    del pages[name]
    shown = re.findall(r"hpcomp[\w-]*\(\d\)", man_text(man_sections(name)["SEE ALSO"]))
    assert sorted(shown) == sorted(pages.values())


@pytest.mark.parametrize("name", WRITTEN)
def test_man_page_says_what_its_markdown_says(name):
    text = re.sub(r"<!--.*?-->|^!\[.*$", "", written(name), flags=re.MULTILINE)
    title, _, text = text.partition("\n")
    purpose = title.partition(": ")[2]
    sections = man_sections(name)
    assert man_text(sections["NAME"]) == f"{name.split('.')[0]} - {purpose}"
    headings = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert list(sections) == ["NAME", "DESCRIPTION", *map(str.upper, headings), "SEE ALSO"]
    # What is markup in either, and not a word.
    text = re.sub(r"^## .*$|^```\w*$|^\|[-| ]+\|$|^(?:- |\d\. )", "", text, flags=re.MULTILINE)
    text = re.sub(r"\[([^\]]*)\]\((.*?)\)", r"\1 <\2>", text).replace("`: ", " ")
    page = man_source(name).partition('.SH "DESCRIPTION"')[2].partition('.SH "SEE ALSO"')[0]
    page = re.sub(r"^tab\(\|\);\n.*\n.*\.$|^_$|T\{$|^T\}", "", page, flags=re.MULTILINE)
    marks = str.maketrans("|", " ", "`*")
    assert man_text(page).translate(marks).split() == text.translate(marks).split()


@pytest.mark.skipif(shutil.which("groff") is None, reason="no groff here")
@pytest.mark.parametrize("page", ROFF, ids=lambda page: page.name)
def test_groff_sets_a_page_without_a_warning(page):
    run = subprocess.run(
        ["groff", "-K", "utf8", "-t", "-man", "-Tutf8", "-rLL=100n", "-ww", page],
        env={**os.environ, "GROFF_NO_SGR": "1"},
        capture_output=True,
    )
    assert (run.returncode, run.stderr) == (0, b"")
    shown = re.sub(".\b", "", run.stdout.decode())
    assert re.search("^SEE ALSO$", shown, re.MULTILINE)
    assert "T{" not in shown  # no cell of a table was left as it is


def test_the_examples_of_a_help_text_are_in_its_man_page_as_they_are():
    help_text = TREE["hpcomp stack"][0].help
    examples = [line.strip() for line in help_text.splitlines() if "hpcomp stack " in line]
    assert len(examples) >= 3
    for example in examples:
        assert words(example) in man_text(man_sections("hpcomp stack")["EXAMPLES"])


def test_man_pages_are_installed_where_man_looks():
    installed = {
        Path(file.locate()).resolve()
        for file in importlib.metadata.files("hpcomp")
        if file.match("share/man/man*/*")
    }
    # Beside the command: there man finds it when the environment's bin is in PATH.
    place = (Path(sys.prefix) / "share" / "man").resolve()
    assert {path.relative_to(place) for path in installed} == {p.relative_to(MAN) for p in ROFF}
    for path in installed:
        assert path.is_file()


# ---- the examples of the manual -------------------------------------------------------------------

SIZE = (48, 64)

MANUAL = "\n".join([REFERENCE, *map(written, WRITTEN)])


def code_blocks(language, text=MANUAL):
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def shell_lines():
    joined = "".join(code_blocks("sh")).replace("\\\n", " ")
    return list(dict.fromkeys(line for line in joined.splitlines() if line.strip()))


HPCOMP_LINES = [line for line in shell_lines() if re.match(r"(.* \| )?hpcomp ", line)]


def layer(color, rows=slice(0, SIZE[0]), columns=slice(0, SIZE[1]), alpha=1.0):
    """A rectangle of one premultiplied colour, transparent around it."""
    rgba = np.zeros((*SIZE, 4), np.float32)
    rgba[rows, columns] = [*(alpha * c for c in color), alpha]
    return rgba


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """A directory with small layers of the names that the manual uses, and hpcomp in PATH."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    above, below = slice(4, 30), slice(20, 44)
    layers = {
        "base.png": layer((0.3, 0.3, 0.3)),
        "roads.png": layer((0.8, 0.1, 0.1), rows=above, alpha=0.8),
        "rivers.exr": layer((0.1, 0.2, 0.8), rows=below, alpha=0.6),
        "labels.png": layer((0.8, 0.6, 0.1), columns=above, alpha=0.7),
        "mask.png": layer((0.5, 0.5, 0.5)),
        "legend.png": layer((0.9, 0.9, 0.9))[:10, :20],
        "a.png": layer((0.8, 0.1, 0.1), rows=above, alpha=0.5),
        "b.exr": layer((0.2, 0.5, 0.2)),
        **{f"bg.{n:04d}.exr": layer((0.3, 0.3, 0.1 * n)) for n in (1, 2, 3)},
        **{f"fg.{n:04d}.exr": layer((0.8, 0.1, 0.1), rows=above, alpha=0.3 * n) for n in (1, 2, 3)},
        # What earlier examples make, for later ones.
        "map.png": layer((0.6, 0.2, 0.1)),
        "plain.png": layer((0.6, 0.4, 0.1)),
    }
    for name, pixels in layers.items():
        hpcomp.write_image(name, pixels)
    channels = ["R", "G", "B", "diffuse.R", "diffuse.G", "diffuse.B"]
    exrfile.write(tmp_path / "render.exr", exrfile.planes(channels, SIZE[1], SIZE[0]))
    smoke, bones = (deepfile.noise(SIZE[1], SIZE[0], tidy=False, seed=seed) for seed in (1, 2))
    glow = {f"glow.{name}": smoke.planes[name] for name in "RGB"}
    deepfile.write(tmp_path / "smoke.exr", smoke)
    deepfile.write(tmp_path / "shot.exr", deepfile.Deep(smoke.counts, {**smoke.planes, **glow}))
    deepfile.write(tmp_path / "bones.exr", bones)
    return tmp_path


def test_every_shell_line_of_the_manual_is_a_command_of_hpcomp():
    assert len(HPCOMP_LINES) >= 40
    assert shell_lines() == HPCOMP_LINES
    languages = set(re.findall(r"^```(\w+)$", MANUAL, re.MULTILINE))
    assert languages == {"sh", "python", "toml", "make", "text"}  # text: usage lines


#: Lines that make many files, or write jobs: their messages and outputs are not those of others.
BATCH_LINES = [
    line for line in HPCOMP_LINES if re.search(r"hpcomp batch|--frames|--save-job", line)
]


def test_the_batches_of_the_manual_run_in_their_order(workplace):
    (jobs,) = code_blocks("toml")
    (workplace / "jobs.toml").write_text(jobs)
    assert len(BATCH_LINES) >= 8
    # Those that write jobs first: the reference shows a use of theirs, too.
    for line in sorted(BATCH_LINES, key=lambda line: "--save-job" not in line):
        run = subprocess.run(["sh", "-c", line], capture_output=True, text=True)
        assert (run.returncode, run.stdout) == (0, ""), run.stderr
        assert ("jobs in" in run.stderr) == ("--save-job" not in line)
    assert hpcomp.read_jobs("jobs.toml")[0].options["depth"] == 16
    for name in ("overview.png", "flooded.png", *(f"out.{n:04d}.exr" for n in (1, 2, 3))):
        assert hpcomp.read_layer(name).pixels.any()
    (record, _) = map(json.loads, (workplace / "jobs.log").read_text().splitlines())
    keys = written("hpcomp-jobs.5").partition("## Log")[2].partition("## ")[0]
    shown = re.findall(r"`(\w+)`", " ".join(re.findall(r"^\| (`.*?) \|", keys, re.MULTILINE)))
    assert sorted(shown) == sorted(record)


@pytest.mark.parametrize("line", [line for line in HPCOMP_LINES if line not in BATCH_LINES])
def test_the_commands_of_the_manual_run(workplace, line):
    outputs = re.findall(r"(?:-o|>|--report|--provenance|--depfile) ([\w.]+)", line)
    for name in outputs:
        (workplace / name).unlink(missing_ok=True)
    if line.startswith("hpcomp check map.png"):  # that of the first example
        hpcomp.stack(["base.png", "roads.png::opacity=0.6", "rivers.exr"], "map.png")
    inputs = set(workplace.iterdir())
    run = subprocess.run(["sh", "-c", line], capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
    assert {path.name for path in set(workplace.iterdir()) - inputs} == set(outputs)
    for name in outputs:
        if name.endswith((".png", ".exr")) and f"--provenance {name}" not in line:
            assert hpcomp.read_layer(name).pixels.any()
        else:
            assert (workplace / name).stat().st_size > (20 if name.endswith(".d") else 100)
    assert bool(run.stdout) == (not outputs)


def stack_examples(lines):
    """(line, the arguments of its `hpcomp stack`) of each line that makes pictures by that alone."""
    for line in lines:
        program, command, *arguments = shlex.split(line)
        if (program, command) == ("hpcomp", "stack") and "--save-job" not in arguments:
            yield line, arguments


def layers_of(arguments):
    with click.Context(cli) as parent:
        return (
            cli.get_command(parent, "stack")
            .make_context("stack", list(arguments), parent)
            .params["layers"]
        )


def outputs_of(folder, arguments):
    """{name: pixels} of what the stack makes there; None where it refuses."""
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    if command.hpcomp("stack", *arguments, "-q", cwd=folder).code:
        return None
    made = [path for path in folder.iterdir() if before.get(path) != path.stat().st_mtime_ns]
    (ending,) = {Path(a).suffix for o, a in itertools.pairwise(arguments) if o == "-o"}
    return {path.name: hpcomp.read_layer(path).pixels for path in made if path.suffix == ending}


def assert_every_layer_counts(folder, arguments):
    """Without any of its layers the stack gives another picture, or none."""
    layers, whole = layers_of(arguments), outputs_of(folder, arguments)
    assert whole
    for layer in layers if len(layers) > 1 else ():
        rest = [argument for argument in arguments if argument != layer]
        less = outputs_of(folder, rest)
        for name in whole if less is not None else ():
            assert not np.array_equal(less[name], whole[name]), f"{layer} changes nothing in {name}"


@pytest.mark.parametrize("line", dict(stack_examples(HPCOMP_LINES)))
def test_every_layer_of_an_example_of_the_manual_counts(workplace, line):
    ((_, arguments),) = stack_examples([line])
    assert_every_layer_counts(workplace, arguments)


def test_frames_of_the_manual_differ_by_their_numbered_layer_alone(workplace):
    examples = [arguments for line, arguments in stack_examples(BATCH_LINES) if "--frames" in line]
    assert examples
    for arguments in examples:
        made = outputs_of(workplace, arguments)
        assert len(made) >= 2
        for name, pixels in made.items():
            frame = re.search(r"\d+", name)[0]
            layers = [re.sub("%04d|####", frame, layer) for layer in layers_of(arguments)]
            assert frame in "".join(layers)
            hpcomp.stack(layers, "expected.exr")
            assert np.array_equal(pixels, hpcomp.read_layer("expected.exr").pixels)
        first, *others = made.values()
        assert not any(np.array_equal(first, other) for other in others)


def test_the_pictures_of_both_blendings_differ(workplace):
    commands = [
        "hpcomp stack base.png 'roads.png::opacity=0.6' rivers.exr -o map.png",
        "hpcomp stack base.png 'roads.png::opacity=0.6' rivers.exr --blending traditional -o plain.png",
    ]
    for line in commands:
        assert line in HPCOMP_LINES
        assert subprocess.run(["sh", "-c", line]).returncode == 0
    hue_preserving, plain = (hpcomp.read_layer(name).pixels for name in ("map.png", "plain.png"))
    assert np.abs(hue_preserving - plain).max() > 0.05


def test_the_makefile_of_the_manual_makes_its_target(workplace):
    (makefile,) = code_blocks("make")
    rule, *recipe = makefile.splitlines()
    target, _, sources = rule.partition(": ")
    assert recipe
    for line in recipe:
        assert line.startswith("\t")
        command = line.strip().replace("$@", target).replace("$^", sources)
        assert "$" not in command
        run = subprocess.run(["sh", "-c", command], capture_output=True, text=True)
        assert (run.returncode, run.stdout, run.stderr) == (0, "", "")
    assert (workplace / target).is_file()


@pytest.mark.parametrize("number", range(len(code_blocks("python"))))
def test_the_python_examples_of_the_manual_print_what_they_say(workplace, capsys, number):
    code = code_blocks("python")[number]
    expected = printed(code)
    assert expected
    exec(compile(code, "manual", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out.splitlines() == expected


def printed(code):
    """What an example says that it prints: the comments behind its print calls."""
    return re.findall(r"^\s*print\(.*\)  # (.*)$", code, re.MULTILINE)


@pytest.mark.parametrize("shell", TREE["hpcomp completion"][0].params[0].type.choices)
def test_the_completion_commands_of_the_reference_print_a_script(workplace, shell):
    assert f"hpcomp completion {shell}" in reference_section("hpcomp completion")
    run = subprocess.run(["hpcomp", "completion", shell], capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
    assert "_HPCOMP_COMPLETE" in run.stdout


# ---- the examples of README ----------------------------------------------------------------------

#: What a reader types before the examples; other tests run it.
SETUP = {"sh samples/quickstart.sh\nsh tests/run.sh\n", "pip install .\n"}

README_BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
EXAMPLES = [(language, code) for language, code in README_BLOCKS if code not in SETUP]
#: The command at the end of the quick start, for the root of the checkout; and what begins the examples
#: that run in the folder of its pictures.
(FIRST,) = re.findall(r"^\.venv/bin/hpcomp stack .*\n", README, re.MULTILINE)
(BEGIN,) = re.findall(r"^\. \.venv/bin/activate\n(?:c[dp] .*\n)+", README, re.MULTILINE)


def test_every_block_of_readme_is_run():
    assert README.count("```") == 2 * len(README_BLOCKS)
    assert {code for _, code in README_BLOCKS} >= SETUP
    assert {language for language, _ in EXAMPLES} == {"sh", "python"}
    assert EXAMPLES[0] == ("sh", FIRST)
    assert EXAMPLES[1][1] == BEGIN
    for code in SETUP:
        for line in code.splitlines():
            assert (ROOT / line.split()[-1]).exists()


@pytest.fixture(scope="module")
def readme_runs(tmp_path_factory):
    """(folder of the examples, what running each example of README in order gave).

    As after the quick start: an environment without matplotlib and the layers of the sample, and
    with a deep image that a reader would bring.
    """
    root = tmp_path_factory.mktemp("checkout")
    (root / ".venv" / "bin").mkdir(parents=True)
    activate = f"PATH='{Path(sys.executable).parent}':$PATH\nexport PATH\n"
    (root / ".venv" / "bin" / "activate").write_text(activate)
    (root / ".venv" / "bin" / "hpcomp").symlink_to(command.COMMAND)
    shutil.copytree(ROOT / "samples" / "terrain" / "layers", root / "samples/terrain/layers")
    folder = root / "samples" / "terrain" / "out"
    folder.mkdir()
    deepfile.write(folder / "smoke.exr", deepfile.noise(SIZE[1], SIZE[0], tidy=True, seed=1))
    (root / "without").mkdir()
    (root / "without" / "matplotlib.py").write_text("raise ImportError('not installed')\n")
    environment = {**os.environ, "PYTHONPATH": str(root / "without")}
    again = BEGIN.replace("cp ../layers/* .\n", "")
    runs = []
    for language, code in EXAMPLES:
        if code in (FIRST, BEGIN):
            script = code
        elif language == "sh":
            script = again + code
        else:
            (folder / "example.py").write_text(code)
            script = again + "python example.py\n"
        runs.append(
            subprocess.run(
                ["sh", "-euc", script], cwd=root, env=environment, capture_output=True, text=True
            )
        )
    return folder, runs


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_an_example_of_readme_runs_as_it_is_typed(readme_runs, number):
    (language, code), (folder, runs) = EXAMPLES[number], readme_runs
    assert runs[number].returncode == 0, runs[number].stderr
    if "hpcomp batch" in code:
        assert re.search(r": 2 made\n$", runs[number].stderr)
    else:
        assert runs[number].stderr == ""
    if language == "python":
        assert runs[number].stdout.splitlines() == printed(code) != []
        return
    outputs = re.findall(r"(?:-o|>|--report|--depfile|--log) ([\w.]+)", code)
    place = folder.parents[2] if code == FIRST else folder
    for name in outputs:
        assert (place / name).stat().st_size > 20
    shows = re.search(r"hpcomp (hues|explain|check|palette) ", code)
    assert bool(runs[number].stdout) == bool(shows)


README_LINES = "".join(code for language, code in EXAMPLES if language == "sh").splitlines()


@pytest.mark.parametrize(
    "line",
    # Those that read a pipe have their layers from elsewhere.
    dict(stack_examples(n for n in README_LINES if n.startswith("hpcomp ") and " - " not in n)),
)
def test_every_layer_of_an_example_of_readme_counts(tmp_path, line):
    folder = shutil.copytree(ROOT / "samples" / "terrain" / "layers", tmp_path / "out")
    ((_, arguments),) = stack_examples([line])
    assert_every_layer_counts(folder, arguments)


def test_the_examples_of_readme_show_what_it_says(readme_runs):
    folder, runs = readme_runs
    shown = {code: run.stdout for (_, code), run in zip(EXAMPLES, runs, strict=True)}
    (explained,) = (text for code, text in shown.items() if "hpcomp explain" in code)
    assert "layer 2 (steep.exr) keeps its hue" in explained  # of two labels that meet there
    assert re.search(r"chroma 0\.[1-9]\d* and 0\.[1-9]", explained)
    (checked,) = (text for code, text in shown.items() if "hpcomp check" in code)
    assert checked.count("passed") == 2
    assert {path.name for path in folder.iterdir()} >= {"steep.png", "summits.png", "map.html"}


def test_readme_has_an_example_of_every_task():
    commands = set(re.findall(r"hpcomp (\w+) ", "".join(code for _, code in EXAMPLES)))
    assert commands == set(COMMANDS) - {"completion", "info"}
    assert "hpcomp info FILE" in README
    text = "".join(code for language, code in EXAMPLES if language == "python")
    for name in ("composite", "stack"):
        assert f"hpcomp.{name}" in text


def test_the_python_pages_use_the_functions_on_arrays_and_on_files():
    cookbook = (ROOT / "samples" / "COOKBOOK.md").read_text(encoding="utf-8")
    both = "".join([*code_blocks("python"), *code_blocks("python", README + cookbook)])
    for name in ("composite", "stack", "read_layer", "write_image", "InputError", "hue_histogram",
                 "stack_measures", "read_hues", "palette"):  # fmt: skip
        assert f"hpcomp.{name}" in both


# ---- links ---------------------------------------------------------------------------------------

PAGES = ["README.md", "CHANGELOG.md", "samples/COOKBOOK.md", "samples/terrain/README.md",
         "samples/paper/README.md", *(str(path.relative_to(ROOT)) for path in WRITTEN.values())]  # fmt: skip

#: Where README, which is also read outside of the repository, finds the other files.
BASE = "https://github.com/hpcomp/hpcomp/blob/main/"


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_links_to_exists(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)\s]+)\)|^\[.*\]: (\S+)$|<img src=\"(.*?)\"", text, re.MULTILINE)
    slugs = {
        re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-")
        for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    }
    assert links or page.startswith("man/")
    for link in map("".join, links):
        if link.startswith("#"):
            assert link[1:] in slugs
        elif link.startswith(BASE):
            path = link.removeprefix(BASE)
            assert path.endswith("?raw=true") == path.removesuffix("?raw=true").endswith(".png")
            assert (ROOT / path.removesuffix("?raw=true")).exists(), link
        elif not link.startswith("https://"):
            assert page != "README.md"
            assert ((ROOT / page).parent / link).exists(), link


def test_every_reference_of_readme_is_defined_and_used():
    text, defined = README, dict(re.findall(r"^\[(.*)\]: (\S+)$", README, re.MULTILINE))
    for name, url in defined.items():
        text = text.replace(f"[{name}]: {url}\n", "")
        assert f"[{name}]" in text
    code_free = re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL)
    used = re.findall(r"\[[^\]]*\]\[([^\]]+)\]|\[(\w+)\](?![\[(:])", code_free)
    assert {"".join(names) for names in used} <= set(defined)
    assert len(used) >= 12


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "SECURITY.md"])
def test_the_scripts_that_contributors_are_told_of_exist(page):
    text = (ROOT / ".github" / page).read_text(encoding="utf-8")
    for script in re.findall(r"\b(?:samples|tests|man)/[\w/]+\.\w+", text):
        assert (ROOT / script).is_file(), script
    assert page != "CONTRIBUTING.md" or "man/generate.py" in text


@pytest.mark.parametrize("script", ["samples/quickstart.sh", "tests/run.sh"])
def test_the_scripts_that_readme_names_exist(script):
    assert script in README
    assert (ROOT / script).is_file()


STEPS = {
    "": ["Making", "python -m venv", "Installing", "python -m pip install", "Running the tests",
         "pytest --numprocesses 2", "Slow tests"],
    "--gate": ["Making", "python -m venv", "Installing", "python -m pip install", "Running the tests",
               "pytest --numprocesses 2"],
    "--all": ["Making", "python -m venv", "Installing", "python -m pip install", "Running all tests",
              "pytest --numprocesses 2"],
    "tests/docs": ["Making", "python -m venv", "Installing", "python -m pip install", "pytest tests/docs"],
}  # fmt: skip


@pytest.mark.parametrize("argument", STEPS)
def test_the_script_of_the_tests_says_each_step_before_it_takes_it(tmp_path, argument):
    said = """#!/bin/sh
echo "${0##*/} $*"
[ "$2" != venv ] || { mkdir -p "$3/bin" && cp "$0" "$3/bin/python" && cp "$0" "$3/bin/pytest"; }
"""
    (tmp_path / "python").write_text(said)
    (tmp_path / "python").chmod(0o755)
    run = subprocess.run(
        ["sh", ROOT / "tests" / "run.sh", *filter(None, [argument])],
        env={"PATH": os.environ["PATH"], "PYTHON": tmp_path / "python", "VENV": tmp_path / "venv"},
        capture_output=True, text=True,
    )  # fmt: skip
    assert (run.returncode, run.stderr) == (0, "")
    lines = run.stdout.splitlines()
    assert len(lines) == len(STEPS[argument])
    for line, begin in zip(lines, STEPS[argument], strict=True):
        assert line.startswith(begin)


def test_readme_shows_the_picture_and_both_commands_before_the_rest():
    start = README.partition("## Install")[0]
    assert "samples/terrain/terrain.png" in start
    assert "sh samples/quickstart.sh\nsh tests/run.sh\n" in start
    assert FIRST in start


def test_readme_is_short():
    assert len(README.encode()) <= 10 * 1024


def test_the_version_is_one():
    assert importlib.metadata.version("hpcomp") == hpcomp.__version__
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^## (\S+?),? ", changelog, re.MULTILINE)[1] == hpcomp.__version__


# ---- the public names ----------------------------------------------------------------------------

PUBLIC = [name for name in hpcomp.__all__ if name != "__version__"]
FUNCTIONS = [name for name in PUBLIC if inspect.isfunction(getattr(hpcomp, name))]
CLASSES = [name for name in PUBLIC if inspect.isclass(getattr(hpcomp, name))]
TABLES = [name for name in PUBLIC if isinstance(getattr(hpcomp, name), dict)]

#: What the docstring of a function has to state: shapes, units, ranges, errors, source.
STATEMENTS = {
    "composite": ["(…, 4)", "linear", "premultiplied", "[0, 1]", "degrees", "stops",
                  "Returns:", "Errors:", "SettingError", "MismatchError", "Chuang et al. 2009"],
    "hue_add": ["(…, 3)", "linear", "premultiplied", "degrees", "Returns:", "Chuang et al. 2009"],
    "stack": ["`layers`", "`output`", "hpcomp stack", "Errors:", "SettingError", "InputError",
              "MismatchError", "OutputError", "Warnings:", "Returns:", "`report`", "`provenance`",
              "`foreign_tolerance`", "degrees", "`achromatic`", "[0, 1]", "`energy_weights`", "`bins`",
              "Chuang et al. 2009", "Porter and Duff 1984"],
    "flatten": ["`images`", "`output`", "deep EXR", "`canvas`", "`order`", "`nonfinite`", "Returns:",
                "Errors:", "SettingError", "InputError", "MismatchError", "OutputError", "Warnings:",
                "Chuang et al. 2009", "Interpreting Deep Pixels"],
    "read_layer": ["`path`", "`nonfinite`", "(height, width, 4)", "float32", "linear Rec. 709",
                   "premultiplied", "Returns:", "Errors:", "Warnings:"],
    "write_image": ["`pixels`", "(height, width, 4)", "linear Rec. 709", "premultiplied",
                    "alpha in [0, 1]", "`data_window`", "`display_window`", "Returns:", "Errors:",
                    "Warnings:"],
    "batch": ["`jobs`", "`workers`", "`threads`", "`max_memory`", "`fail_fast`", "`skip_existing`",
              "`update`", "`resume`", "`state`", "`log_to`", "`on_record`", "Returns:", "Errors:",
              "SettingError", "InputError", "OutputError"],
    "frame_jobs": ["`layers`", "`output`", "`frames`", "%04d", "####", "Errors:", "SettingError"],
    "read_jobs": ["`path`", "`format`", "working directory", "Errors:", "InputError", "SettingError"],
    "save_jobs": ["`path`", "Errors:", "SettingError", "OutputError"],
    "info": ["how it will be read", "Errors:", "InputError"],
    "hue_histogram": ["`pixels`", "(…, 4)", "linear Rec. 709", "premultiplied", "float32", "degrees",
                      "6 to 3600", "[0, 1]", "Returns:", "Errors:", "SettingError", "MismatchError"],
    "read_hues": ["`path`", "hpcomp hues", "`nonfinite`", "`threads`", "Returns:", "Errors:",
                  "SettingError", "InputError", "MismatchError", "Warnings:"],
    "write_hue_report": ["`histograms`", "`output`", "`format`", "`weight`", "`scale`", "`axes`",
                         "`clobber`", "hpcomp hues", "Errors:", "SettingError", "OutputError"],
    "stack_measures": ["(…, height, width, 4)", "(n, 4)", "`origin`", "linear", "premultiplied", "degrees", "Returns:", "Errors:",
                       "SettingError", "MismatchError", "Chuang et al. 2009"],
    "explain": ["`layers`", "`at`", "canvas", "degrees", "linear", "premultiplied", "Returns:",
                "Errors:", "SettingError", "InputError", "MismatchError", "Warnings:"],
    "check": ["`image`", "`layers`", "`hues`", "`max_foreign`", "`max_gray`", "`require_hue`",
              "[0, 1]", "degrees", "Returns:", "Errors:", "SettingError", "Warnings:"],
    "palette": ["`colors`", "`layers`", "`background`", "`opacity`", "`rules`", "`close_hues`",
                "`least_difference`", "`gray_opacity`", "`achromatic`", "linear", "degrees",
                "0 to 1", "Returns:", "Errors:", "SettingError", "InputError", "MismatchError",
                "Chuang et al. 2009"],
    "write_palette_report": ["`palette`", "`output`", "`format`", "`figure`", "`clobber`",
                             "hpcomp palette", "Errors:", "SettingError", "OutputError"],
}  # fmt: skip


def test_every_public_name_is_a_function_a_class_or_a_table():
    assert sorted([*FUNCTIONS, *CLASSES, *TABLES]) == sorted(PUBLIC)
    assert sorted(STATEMENTS) == sorted(FUNCTIONS)
    assert set(PUBLIC) <= set(dir(hpcomp))
    with pytest.raises(AttributeError, match="nothing"):
        hpcomp.nothing  # noqa: B018


@pytest.mark.parametrize("name", FUNCTIONS)
def test_docstring_of_a_function_states_what_it_must(name):
    documentation = inspect.getdoc(getattr(hpcomp, name))
    assert re.match(r"[A-Z].*\.", documentation)
    for statement in STATEMENTS[name]:
        assert statement in words(documentation)


def test_docstring_of_composite_gives_every_rule_its_default():
    documentation = words(inspect.getdoc(hpcomp.composite))
    defaults = {
        "opacity": 1.0,
        **{name: STACK_OPTIONS[name].default for name in ("op", *ARRAY_RULES)},
    }
    for name, value in defaults.items():
        default = f'"{value}"' if isinstance(value, str) else str(value)
        assert f"`{name}` {default}" in documentation


def test_type_checkers_know_the_options_of_the_table():
    hints = typing.get_type_hints(StackKeywords)
    assert hints == {name: row.hint for name, row in STACK_OPTIONS.items()}
    assert set(typing.get_type_hints(FlattenKeywords)) == set(FLATTEN_OPTIONS)


def test_stack_takes_the_options_of_the_command_under_their_names():
    command, _ = TREE["hpcomp stack"]
    options = {p.name: p for p in command.params if isinstance(p, click.Option) and p.expose_value}
    parameters = inspect.signature(hpcomp.stack).parameters
    for name in ("frames", "workers", "save_job"):  # what makes several stacks, or none
        del options[name]
    # The command line is what only the command knows.
    assert set(options) == set(parameters) - {"layers", "asked", "command"}
    for name, shown in options.items():
        parameter = parameters[name]
        if shown.show_default:
            assert shown.default == parameter.default, name
        elif shown.is_flag:
            assert parameter.default is False, name
            assert shown.default is not True, name
        elif shown.multiple:
            assert parameter.default == (), name
        elif not shown.required:
            assert parameter.default is None, name


def test_flatten_takes_the_options_of_its_command_and_defaults_of_stack():
    command, _ = TREE["hpcomp flatten"]
    options = {p.name for p in command.params if isinstance(p, click.Option) and p.expose_value}
    parameters = inspect.signature(hpcomp.flatten).parameters
    assert options == set(parameters) - {"images", "asked"}
    of_stack = inspect.signature(hpcomp.stack).parameters
    for name in options:
        assert parameters[name].default == of_stack[name].default, name


@pytest.mark.parametrize("name", CLASSES)
def test_docstring_of_a_class_is_its_own_sentence(name):
    documentation = vars(getattr(hpcomp, name)).get("__doc__") or ""
    assert re.match(r"[A-Z][^\n]*[.:]", documentation)
    assert not documentation.startswith(f"{name}(")  # what dataclasses say where nothing stands


def test_docstring_of_layer_spec_names_every_setting():
    documentation = inspect.getdoc(hpcomp.LayerSpec)
    for key in ("path", *LAYER_KEYS):
        assert f"`{key}`" in documentation


@pytest.mark.parametrize("name", TABLES)
def test_rows_of_a_table_are_documented_and_bear_their_names(name):
    table = getattr(hpcomp, name)
    assert table
    for key, row in table.items():
        assert key == row.name
        assert not type(row).__doc__.startswith(f"{type(row).__name__}(")


def type_checking_imports():
    """{name: module} that `hpcomp/__init__.py` tells type checkers."""
    tree = ast.parse(inspect.getsource(hpcomp))
    (block,) = [
        node
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    found = {}
    for statement in block.body:
        for alias in statement.names:
            assert alias.asname == alias.name  # only so is it exported
            found[alias.name] = "." * statement.level + statement.module
    return found


def test_type_checkers_and_python_see_the_same_names():
    assert type_checking_imports() == hpcomp._HOME
    assert hpcomp.__all__ == ["__version__", *hpcomp._HOME]


def test_the_docstring_of_the_package_names_what_matters():
    listed = re.findall(r"^    (\w+)  ", hpcomp.__doc__, re.MULTILINE)
    assert sorted(listed) == sorted([*FUNCTIONS, "StackOptions"])


# ---- types ---------------------------------------------------------------------------------------

USER_SCRIPT = '''
"""Someone's own script."""

from pathlib import Path

import numpy as np

import hpcomp


def overlay(base: Path, labels: Path, output: Path) -> hpcomp.Window:
    layers: list[hpcomp.LayerSpec | str | Path] = [base, hpcomp.LayerSpec(str(labels), opacity=0.5)]
    result: hpcomp.StackResult = hpcomp.stack(layers, output, order=[1, 0], depth=16)
    if result.losses.out_of_gamut:
        raise hpcomp.MismatchError("too bright")
    return result.canvas


def flat(path: Path) -> hpcomp.Window:
    return hpcomp.flatten([path, "b.exr"], Path("out.exr"), order="top-down").canvas


def darker(path: str) -> hpcomp.Losses:
    layer = hpcomp.read_layer(path, part=0)
    return hpcomp.write_image("darker.exr", layer.pixels / 2, data_window=layer.data_window)


def describe(path: str) -> list[str]:
    file: hpcomp.ImageFile = hpcomp.info(path)
    return [part.name for part in file.parts]


red = np.array([0.5, 0.0, 0.0, 0.5])
mixed: np.ndarray = hpcomp.composite([red, red[::-1]], blending="traditional")
summed: np.ndarray = hpcomp.hue_add(red[:3], [0.0, 0.1, 0.2], hue_tolerance=0)
names: list[str] = [*hpcomp.OPERATORS, *hpcomp.ORDERS, *hpcomp.SPACES]
code: int = hpcomp.InputError.exit_code
hues: hpcomp.HueHistogram = hpcomp.hue_histogram([red]) + hpcomp.read_hues("a.png", bins=360)
places: list[float] = [peak.hue for peak in sum([hues, hues], hues).peaks]
hpcomp.write_hue_report({"a": hues}, Path("hues.svg"), axes="polar")
palette: hpcomp.Palette = hpcomp.palette(["#f00", (0.0, 0.5, 1.0)], layers=["a.png"], space="xyz")
apart: list[float | None] = [pair.angle for pair in palette.soonest]
hpcomp.write_palette_report(palette, Path("palette.svg"), figure="discs")

# Each of these is wrong, and a checker that saw no types would call the comment unused.
hpcomp.stack([red], "out.png")  # type: ignore[list-item]
hpcomp.flatten("a.exr", "b.exr", order=[1, 0])  # type: ignore[arg-type]
hpcomp.read_layer(3)  # type: ignore[arg-type]
hpcomp.hue_add(red, red, tolerance=1)  # type: ignore[call-arg]
hpcomp.missing  # type: ignore[attr-defined]
'''


def test_py_typed_is_in_the_installed_package():
    assert (Path(hpcomp.__file__).parent / "py.typed").is_file()


@pytest.mark.slow
def test_a_typed_script_passes_mypy_strict_against_the_installed_package(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(USER_SCRIPT)
    run = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--cache-dir", tmp_path / "cache", script],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert run.stderr == ""
    assert run.stdout == "Success: no issues found in 1 source file\n"
    assert run.returncode == 0
