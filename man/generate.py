"""Generates the man pages and the generated parts of README.md from the command itself.

    python man/generate.py           writes them
    python man/generate.py --check   names those that are stale; exit code 1

The sources are the click tree and the tables of hpcomp. The date, the terminal and click's own
layout of a help text have no part in it: the same hpcomp gives the same bytes everywhere.
"""

from __future__ import annotations

import argparse
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import click

import hpcomp
from hpcomp.blending.porter_duff import OPERATORS, Operator
from hpcomp.cli import cli
from hpcomp.color.encoding import COLOR_INTEROP_IDS, COLOR_SPACES
from hpcomp.errors import EXIT_CODE_MEANINGS
from hpcomp.report import huedata, palettedata, stackdata

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
MAN1 = ROOT / "man" / "man1"

#: Columns of what is generated, for whoever reads a diff of it.
MARKDOWN_WIDTH = 99
ROFF_WIDTH = 80


# --- what a help text says ------------------------------------------------------------------------


@dataclass(frozen=True)
class Paragraph:
    """Running text; `literal text` stands between backticks."""

    text: str


@dataclass(frozen=True)
class Definitions:
    """Literal terms and what each means."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Examples:
    """Command lines that can be typed as they are."""

    lines: tuple[str, ...]


Block = Paragraph | Definitions | Examples


def help_blocks(help_text: str) -> list[Block]:
    """The blocks of a click help text; one that begins with \\b keeps its lines.

    Such a block holds command lines, or terms two spaces apart from their meaning. Errors:
    ValueError for one that holds neither.
    """
    blocks: list[Block] = []
    for chunk in inspect.cleandoc(help_text).partition("\f")[0].strip().split("\n\n"):
        if not chunk.startswith("\b"):
            blocks.append(Paragraph(" ".join(chunk.split())))
            continue
        lines = [line.strip() for line in chunk.removeprefix("\b").strip("\n").splitlines()]
        if all(re.match(r"(.* \| )?hpcomp ", line) for line in lines):
            blocks.append(Examples(tuple(lines)))
            continue
        rows = [re.split(r" {2,}", line, maxsplit=1) for line in lines]
        if any(len(row) != 2 for row in rows):
            raise ValueError(f"neither commands nor definitions: {chunk!r}")
        blocks.append(Definitions(tuple((term, meaning) for term, meaning in rows)))
    return blocks


# --- what the click tree says ---------------------------------------------------------------------


@dataclass(frozen=True)
class Option:
    """One option: its names, the name of its value, and what it does."""

    names: tuple[str, ...]
    value: str
    choices: tuple[str, ...]
    text: str
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Command:
    """One command as every page shows it. `value` of an argument has its dots and brackets."""

    name: str
    summary: str
    blocks: tuple[Block, ...]
    arguments: tuple[str, ...]
    options: tuple[Option, ...]

    @property
    def page(self) -> str:
        """The name of its man page, without the section."""
        return self.name.replace(" ", "-")

    @property
    def synopsis(self) -> list[str]:
        """The words of its usage line."""
        required = [o for o in self.options if "required" in o.notes]
        words = [f"{o.names[0]} {o.value}" for o in required]
        return ["[OPTION...]", *words, *self.arguments]


def commands() -> list[Command]:
    """The command itself, then its subcommands in their order."""
    context = click.Context(cli, info_name="hpcomp", **cli.context_settings)
    found = [_command("hpcomp", cli, context, ("COMMAND", "[ARG...]"))]
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        inner = click.Context(command, info_name=name, parent=context)
        arguments = tuple(
            _argument(p) for p in command.get_params(inner) if isinstance(p, click.Argument)
        )
        found.append(_command(f"hpcomp {name}", command, inner, arguments))
    return found


def _command(
    name: str, command: click.Command, context: click.Context, arguments: tuple[str, ...]
) -> Command:
    blocks = help_blocks(command.help or "")
    assert isinstance(blocks[0], Paragraph), f"{name}: the help begins with a sentence"
    options = [_option(p) for p in command.get_params(context) if isinstance(p, click.Option)]
    return Command(name, blocks[0].text, tuple(blocks), arguments, tuple(options))


def _argument(argument: click.Argument) -> str:
    if argument.metavar:
        return argument.metavar
    if isinstance(argument.type, click.Choice):
        return "|".join(argument.type.choices)
    return (argument.name or "").upper()


def _option(option: click.Option) -> Option:
    # Short names first, as in click's own help.
    names = (*sorted(option.opts, key=lambda name: name.startswith("--")), *option.secondary_opts)
    choices: tuple[str, ...] = ()
    value = option.metavar or ""
    if not (value or option.is_flag):
        if isinstance(option.type, click.Choice):
            choices = tuple(option.type.choices)
            value = "|".join(choices)
        else:
            value = option.type.name.upper()
    assert option.help, f"{names[0]} has no help"
    return Option(names, value, choices, option.help, tuple(_notes(option)))


def _notes(option: click.Option) -> Iterator[str]:
    if option.required:
        yield "required"
    if isinstance(option.type, click.IntRange) and option.type.min is not None:
        yield f"at least {option.type.min}"
    if option.show_default:
        default = str(option.default)
        if option.secondary_opts:
            names = option.opts if option.default else option.secondary_opts
            default = names[0].removeprefix("--")
        yield f"default `{default}`"


# --- the tables -----------------------------------------------------------------------------------


def factor_text(factor: Callable[..., object], alpha: str) -> str:
    """A factor of an operator as a formula in `alpha`, found by trying it."""
    formulas = {0.0: "0", 1.0: "1", 0.25: alpha, 0.75: f"1 − {alpha}"}
    return formulas[float(factor(0.25))]  # type: ignore[arg-type]


def operator_row(operator: Operator) -> tuple[str, str, str]:
    """(aliases, F_A, F_B) as text."""
    return (
        ", ".join(f"`{alias}`" for alias in operator.aliases),
        factor_text(operator.factor_a, "α_B"),
        factor_text(operator.factor_b, "α_A"),
    )


# --- README ---------------------------------------------------------------------------------------


def markdown(text: str) -> str:
    """Prose for Markdown: what stands between backticks stays, else nothing is markup."""
    parts = text.split("`")
    parts[::2] = [re.sub(r"([\\*_<])", r"\\\1", part) for part in parts[::2]]
    return "`".join(parts)


def _wrapped(text: str, bullet: str = "", width: int = MARKDOWN_WIDTH) -> str:
    return textwrap.fill(
        text,
        width,
        initial_indent=bullet,
        subsequent_indent=" " * len(bullet),
        break_long_words=False,
        break_on_hyphens=False,
    )


def _markdown_block(block: Block) -> str:
    if isinstance(block, Paragraph):
        return _wrapped(markdown(block.text))
    if isinstance(block, Examples):
        return "\n".join(["```sh", *block.lines, "```"])
    return "\n".join(_wrapped(f"`{t}`: {markdown(m)}", "- ") for t, m in block.rows)


def _markdown_option(option: Option) -> str:
    term = ", ".join(option.names) + (f" {option.value}" if option.value else "")
    notes = f" ({', '.join(option.notes)})" if option.notes else ""
    return _wrapped(f"`{term}`{notes}: {markdown(option.text)}", "- ")


def reference() -> str:
    """The command reference of README.md."""
    sections = []
    for command in commands():
        usage = " ".join([command.name, *command.synopsis])
        sections += [
            f"### {command.name}",
            f"```text\n{usage}\n```",
            *(_markdown_block(block) for block in command.blocks),
            "Options:",
            "\n".join(_markdown_option(option) for option in command.options),
        ]
    return "\n\n".join(sections)


def _markdown_table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def exit_codes() -> str:
    rows = ((str(int(code)), meaning) for code, meaning in EXIT_CODE_MEANINGS.items())
    return _markdown_table(("code", "meaning"), rows)


def operators() -> str:
    rows = ((f"`{row.name}`", *operator_row(row)) for row in OPERATORS.values())
    return _markdown_table(("operator", "aliases", "F_A", "F_B"), rows)


def color_spaces() -> str:
    rows = (
        (f"`{name}`", encoding.transfer.name, encoding.primaries.name)
        for name, encoding in COLOR_SPACES.items()
    )
    ids = ", ".join(f"`{name}`" for name in COLOR_INTEROP_IDS)
    return (
        _markdown_table(("`colorspace=`", "curve", "primaries"), rows)
        + "\n\n"
        + _wrapped(f"The IDs of the Color Interop Forum are names too: {ids}.")
    )


#: The generated parts of README.md, by the name in their markers.
README_PARTS: dict[str, Callable[[], str]] = {
    "operators": operators,
    "colour spaces": color_spaces,
    "exit codes": exit_codes,
    "reference": reference,
}


def readme(text: str) -> str:
    """README.md with its generated parts made anew. Errors: ValueError for a missing marker."""
    for name, make in README_PARTS.items():
        begin, end = f"<!-- begin generated: {name} -->", f"<!-- end generated: {name} -->"
        if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
            raise ValueError(f"README.md needs one pair of markers {begin} … {end}")
        before, _, rest = text.partition(begin)
        after = rest.partition(end)[2]
        text = f"{before}{begin}\n\n{make()}\n\n{end}{after}"
    return text


# --- man pages ------------------------------------------------------------------------------------

#: In running text a hyphen is typed as a minus: what looks like an option can be copied as one.
_ROFF_PROSE = {"\\": r"\e", "-": r"\-", "^": r"\(ha", "~": r"\(ti"}
_ROFF_LITERAL = {**_ROFF_PROSE, "'": r"\(aq", "`": r"\(ga"}


def roff(text: str, table: dict[str, str] = _ROFF_PROSE) -> str:
    """Text with what roff would take for itself escaped, but for the start of a line."""
    return "".join(table.get(character, character) for character in text)


def bold(text: str) -> str:
    return rf"\fB{roff(text, _ROFF_LITERAL)}\fR"


def italic(text: str) -> str:
    return rf"\fI{roff(text, _ROFF_LITERAL)}\fR"


def line(text: str) -> str:
    """A line of escaped text that roff does not take for a request."""
    return rf"\&{text}" if text[:1] in (".", "'") else text


def prose(text: str) -> list[str]:
    """Running text as lines of roff, each sentence on its own; `literal` becomes bold."""
    parts = text.split("`")
    parts[::2] = [roff(part) for part in parts[::2]]
    parts[1::2] = [bold(part) for part in parts[1::2]]
    sentences = re.split(r"(?<=[.!?]) (?=[A-Z\\])", "".join(parts))
    return [
        line(row)
        for sentence in sentences
        for row in _wrapped(sentence, width=ROFF_WIDTH).splitlines()
    ]


def definition(term: str, text: str) -> list[str]:
    """A tagged paragraph; `term` is roff already."""
    return [".TP", line(term), *prose(text)]


def _man_block(block: Paragraph | Definitions) -> list[str]:
    if isinstance(block, Paragraph):
        return [".PP", *prose(block.text)]
    rows = []
    for term, meaning in block.rows:
        key, equals, value = term.partition("=")
        rows += definition(bold(key + equals) + (italic(value) if value else ""), meaning)
    return rows


def _man_option(option: Option) -> list[str]:
    names = ", ".join(map(bold, option.names))
    if option.choices:
        names += " " + "|".join(map(bold, option.choices))
    elif option.value:
        names += " " + italic(option.value)
    text = option.text
    for note in option.notes:
        text += f" {note[0].upper()}{note[1:]}."
    return definition(names, text)


def _man_synopsis(command: Command) -> list[str]:
    """Bold for what is typed as it stands, italic for what is put in its place."""
    words = []
    for word in " ".join(command.synopsis).split():
        choices = word.split("|")
        if len(choices) > 1:
            words.append("|".join(map(bold, choices)))
        elif word.startswith("-"):
            words.append(bold(word))
        else:
            name = word.strip("[].")
            words.append(roff(word).replace(name, italic(name)))
    return [f"{bold(command.name)} {' '.join(words)}"]


def _exit_status() -> list[str]:
    return [
        row
        for code, meaning in EXIT_CODE_MEANINGS.items()
        for row in definition(bold(str(int(code))), f"{meaning[0].upper()}{meaning[1:]}.")
    ]


def _operator_section() -> list[str]:
    rows = [
        ".PP",
        *prose(
            "A is the layer and B the stack below it. An operator is a factor for each: the "
            "colour becomes F_A c_A ⊕ F_B c_B and the alpha F_A α_A + F_B α_B, at most 1."
        ),
    ]
    for operator in OPERATORS.values():
        names = ", ".join(map(bold, (operator.name, *operator.aliases)))
        _, factor_a, factor_b = operator_row(operator)
        rows += definition(names, f"F_A = {factor_a}, F_B = {factor_b}")
    return rows


def _color_space_section() -> list[str]:
    rows = [".PP", *prose("The names that `colorspace=` takes, each with its curve and primaries.")]
    for name, encoding in COLOR_SPACES.items():
        rows += definition(bold(name), str(encoding))
    ids = ", ".join(f"`{name}`" for name in COLOR_INTEROP_IDS)
    return [*rows, ".PP", *prose(f"The IDs of the Color Interop Forum are names too: {ids}.")]


def _json_section(keys: dict[str, str], document: str = "The document") -> list[str]:
    rows = [
        ".PP",
        *prose(
            f"{document} is ASCII. A later version of hpcomp may add keys without a new version "
            "of the schema."
        ),
    ]
    for key, meaning in keys.items():
        rows += definition(bold(key), meaning)
    return rows


def _csv_section() -> list[str]:
    columns = ", ".join(f"`{name}`" for name in huedata.CSV_COLUMNS)
    return prose(
        f"The columns are {columns}. For each image there is a row of the kind `hue` for each bin, "
        "and one each of the kinds `grey`, `transparent` and `nonfinite`, which have a count "
        "alone. Columns mean the same as the keys of the JSON document."
    )


def _provenance_section() -> list[str]:
    channels = {
        "layer": "A whole number: that of the layer whose hue survived, plus 1. Of several layers "
        "of that hue it is the strongest. 0 is none: the pixel is grey or transparent, or its hue "
        "is the background's or nobody's.",
        "grey": "The share of the layers' chroma that blending cancelled, 0 to 1.",
        "margin": "How far ahead the surviving layer was of the strongest of another hue, as a "
        "share of its own strength: 1 without a rival, near 0 where a hair decided, below 0 where "
        "a stronger one was cancelled by others before they met, or with `foremost` lies behind; 0 "
        "where none survived.",
    }
    rows = [
        ".PP",
        *prose(
            "The file of `--provenance` has the data window of the picture, and three channels "
            "that say of each pixel where its hue comes from."
        ),
    ]
    for name, meaning in channels.items():
        rows += definition(bold(name), meaning)
    return rows


def _hues_environment() -> list[str]:
    return [
        *definition(bold("NO_COLOR"), "Set to anything: text on the terminal has no colours."),
        *definition(
            f"{bold('FORCE_COLOR')}, {bold('CLICOLOR_FORCE')}",
            "Set to anything but 0: text has colours in a pipe, too. NO_COLOR goes before.",
        ),
        *definition(bold("COLUMNS"), "How wide text is, where it is not the terminal's width."),
    ]


def _environment() -> list[str]:
    return definition(
        bold("TMPDIR"),
        "Where layers from stdin and pictures for stdout are kept while the command runs.",
    )


def _files() -> list[str]:
    return [
        *definition(
            italic("*.png"),
            "Read with straight alpha, as sRGB unless a cICP, iCCP, sRGB, gAMA or cHRM chunk says "
            "otherwise, the first of them in this order. Written in 8 or 16 bits with straight "
            "alpha, as sRGB or on its curve in the primaries of --out-primaries.",
        ),
        *definition(
            italic("*.exr"),
            "Read as premultiplied and linear, unless colorInteropID says otherwise, in the "
            "primaries that it or chromaticities name, else those of Rec. 709. Written in half "
            "or float, linear and premultiplied, in the working primaries.",
        ),
        ".PP",
        *prose(
            "An output is written to a hidden file beside it and renamed when it is whole. There "
            "is no configuration file."
        ),
    ]


#: Sections that only one page has, before EXIT STATUS.
EXTRA_SECTIONS: dict[str, list[tuple[str, Callable[[], list[str]]]]] = {
    "hpcomp": [("ENVIRONMENT", _environment), ("FILES", _files)],
    "hpcomp hues": [
        ("ENVIRONMENT", _hues_environment),
        ("JSON", lambda: _json_section(huedata.JSON_KEYS)),
        ("CSV", _csv_section),
    ],
    "hpcomp palette": [
        ("ENVIRONMENT", _hues_environment),
        ("JSON", lambda: _json_section(palettedata.JSON_KEYS)),
    ],
    "hpcomp stack": [
        ("OPERATORS", _operator_section),
        ("COLOUR SPACES", _color_space_section),
        ("PROVENANCE", _provenance_section),
        (
            "JSON",
            lambda: _json_section(stackdata.JSON_KEYS, "The document of a report in JSON"),
        ),
    ],
}


def man_page(command: Command, everything: list[Command]) -> str:
    """One page in section 1, as roff for the man macros."""
    main, *subcommands = everything
    purpose = command.summary.rstrip(".")
    # NAME has said the summary, unless there is nothing else to say.
    described = [b for b in command.blocks if not isinstance(b, Examples)]
    described = described[1:] or described
    examples = [row for b in command.blocks if isinstance(b, Examples) for row in b.lines]
    also = [c for c in everything if c is not command] if command is main else [main, *subcommands]
    sections: list[tuple[str, list[str]]] = [
        ("NAME", [rf"{roff(command.page)} \- {roff(purpose[0].lower() + purpose[1:])}"]),
        ("SYNOPSIS", _man_synopsis(command)),
        ("DESCRIPTION", [row for block in described for row in _man_block(block)]),
        (
            "COMMANDS",
            [
                row
                for sub in subcommands
                for row in definition(f"{bold(sub.page)}(1)", sub.summary)
                if command is main
            ],
        ),
        ("OPTIONS", [row for option in command.options for row in _man_option(option)]),
        *((title, make()) for title, make in EXTRA_SECTIONS.get(command.name, [])),
        ("EXIT STATUS", _exit_status()),
        (
            "EXAMPLES",
            [".RS 4", ".nf", *(line(roff(row, _ROFF_LITERAL)) for row in examples), ".fi", ".RE"]
            if examples
            else [],
        ),
        (
            "SEE ALSO",
            [
                ",\n".join(f"{bold(c.page)}(1)" for c in also if c is not command),
                ".PP",
                *prose(
                    "Johnson Chuang, Daniel Weiskopf, Torsten Möller: Hue-Preserving Color "
                    "Blending, IEEE Transactions on Visualization and Computer Graphics 15(6), "
                    "2009."
                ),
            ],
        ),
    ]
    head = [
        '.\\" Generated by man/generate.py: change the help text of the command instead.',
        f'.TH {roff(command.page).upper()} 1 "" "hpcomp {hpcomp.__version__}" "User Commands"',
        # Neither words broken at line ends nor stretched lines: options can be searched for.
        ".nh",
        ".ad l",
    ]
    rows = [*head]
    for title, body in sections:
        if body:
            # A paragraph right after its heading is one already.
            rows += [f'.SH "{title}"', *(body[1:] if body[0] == ".PP" else body)]
    return "\n".join(rows) + "\n"


# --- files ----------------------------------------------------------------------------------------


def generated() -> dict[Path, str]:
    """Every generated file and what it has to hold."""
    everything = commands()
    pages = {MAN1 / f"{c.page}.1": man_page(c, everything) for c in everything}
    return {**pages, README: readme(README.read_text(encoding="utf-8"))}


def stale(files: dict[Path, str]) -> list[Path]:
    """The files that hold something else, are missing, or stand in man1 and are not generated."""
    wrong = [
        path
        for path, text in files.items()
        if not path.is_file() or path.read_bytes() != text.encode()
    ]
    return wrong + sorted(set(MAN1.iterdir() if MAN1.is_dir() else ()) - set(files))


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing, name stale files")
    check = parser.parse_args().check
    files = generated()
    wrong = stale(files)
    if check:
        for path in wrong:
            print(f"{path.relative_to(ROOT)} is stale: run python man/generate.py", file=sys.stderr)
        return 1 if wrong else 0
    MAN1.mkdir(exist_ok=True)
    for path in wrong:
        if path in files:
            path.write_bytes(files[path].encode())
            print(f"wrote {path.relative_to(ROOT)}")
        else:
            path.unlink()
            print(f"removed {path.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
