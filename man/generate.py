"""Generates the man pages and man/REFERENCE.md.

    python man/generate.py           writes them
    python man/generate.py --check   names those that are stale; exit code 1

The pages of commands (section 1) and REFERENCE.md are made from the click tree and the tables of
hpcomp. The pages on concepts and files (sections 5 and 7) are written by hand as man/*.md; their
tables are generated. The date, the terminal and click's own layout of a help text have no part in
it: the same hpcomp gives the same bytes everywhere.
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
from hpcomp.cli.group import cli
from hpcomp.cli.options import shown_names
from hpcomp.color.encodings import COLOR_INTEROP_IDS, COLOR_SPACES
from hpcomp.errors import EXIT_CODE_MEANINGS
from hpcomp.report import explanation, huedata, palettedata, stackdata

ROOT = Path(__file__).resolve().parent.parent
MAN = ROOT / "man"
REFERENCE = MAN / "REFERENCE.md"

#: The sections of the manual that hpcomp has pages in, and what man calls them.
SECTIONS = {"1": "User Commands", "5": "File Formats", "7": "Concepts"}

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
    shown = sorted(shown_names(option), key=lambda name: name.startswith("--"))
    names = (*shown, *option.secondary_opts)
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


# --- Markdown -------------------------------------------------------------------------------------


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


def _markdown_table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


#: What holds for all exit codes and messages.
EXIT_CODE_RULE = (
    "The exit code says how a run ended, and will not change its meaning. Each error is one line "
    "on stderr, which says what is wrong, where, and what to do next. stdout carries data only."
)


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


def reference() -> str:
    """REFERENCE.md: every command with its options, and the exit codes."""
    parts = [
        "# Command reference",
        "<!-- Generated by man/generate.py: change the help text of the command instead. -->",
        "This page says what `hpcomp COMMAND --help` says. The man pages say the same.",
    ]
    for command in commands():
        usage = " ".join([command.name, *command.synopsis])
        parts += [
            f"## {command.name}",
            f"```text\n{usage}\n```",
            *(_markdown_block(block) for block in command.blocks),
            "Options:",
            "\n".join(_markdown_option(option) for option in command.options),
        ]
    parts += ["## Exit codes", _wrapped(EXIT_CODE_RULE), exit_codes()]
    return "\n\n".join(parts) + "\n"


#: The generated parts of the pages in Markdown, by the name in their markers.
PAGE_PARTS: dict[str, Callable[[], str]] = {
    "operators": operators,
    "colour spaces": color_spaces,
}

_MARKERS = re.compile(
    r"<!-- begin generated: (?P<name>.+?) -->\n.*?<!-- end generated: (?P=name) -->", re.DOTALL
)


def with_parts(text: str) -> str:
    """A page in Markdown with its generated parts made anew.

    Errors: ValueError for a marker without its other half or with an unknown name.
    """

    def made(found: re.Match[str]) -> str:
        name = found["name"]
        if name not in PAGE_PARTS:
            raise ValueError(f"no part is called '{name}': {', '.join(PAGE_PARTS)}")
        return (
            f"<!-- begin generated: {name} -->\n\n{PAGE_PARTS[name]()}\n\n"
            f"<!-- end generated: {name} -->"
        )

    lost = re.search(r"<!-- (?:begin|end) generated: .*?-->", _MARKERS.sub("", text))
    if lost:
        raise ValueError(f"this marker has no other half: {lost[0]}")
    return _MARKERS.sub(made, text)


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


def plain(text: str) -> str:
    """Prose between literals."""
    return roff(text)


def marked(text: str) -> str:
    """Prose between literals in Markdown: emphasis becomes italic, and a link shows its address."""
    text = re.sub(r"\[(.*?)\]\((.*?)\)", r"\1 <\2>", text)
    return re.sub(r"\*([^ *][^*]*)\*", r"\\fI\1\\fR", roff(text))


def literal(text: str) -> str:
    """What stands between backticks: a page of the manual, or what is typed."""
    page = re.fullmatch(r"([\w-]+)(\(\d\))", text)
    return bold(page[1]) + page[2] if page else bold(text)


def prose(text: str, between: Callable[[str], str] = plain) -> list[str]:
    """Running text as lines of roff, each sentence on its own; `literal` becomes bold."""
    parts = text.split("`")
    parts[::2] = [between(part) for part in parts[::2]]
    parts[1::2] = [literal(part) for part in parts[1::2]]
    sentences = re.split(r"(?<=[.!?]) (?=[A-Z\\])", "".join(parts))
    return [
        line(row)
        for sentence in sentences
        for row in _wrapped(sentence, width=ROFF_WIDTH).splitlines()
    ]


def definition(term: str, text: str, between: Callable[[str], str] = plain) -> list[str]:
    """A tagged paragraph; `term` is roff already."""
    return [".TP", line(term), *prose(text, between)]


def typed(lines: Iterable[str]) -> list[str]:
    """Lines that stay as they are."""
    rows = [line(roff(row.expandtabs(8), _ROFF_LITERAL)) or ".sp" for row in lines]
    return [".RS 4", ".nf", *rows, ".fi", ".RE"]


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
        ".PP",
        *prose(EXIT_CODE_RULE),
        *(
            row
            for code, meaning in EXIT_CODE_MEANINGS.items()
            for row in definition(bold(str(int(code))), f"{meaning[0].upper()}{meaning[1:]}.")
        ),
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
        "layer": "A whole number: the number of the layer whose hue survived, plus 1. Of several "
        "layers of that hue it is the strongest. 0 is none: the pixel is grey or transparent, or "
        "its hue is the background's or nobody's.",
        "grey": "The share of the layers' chroma that blending cancelled, 0 to 1.",
        "margin": "How far ahead the surviving layer was of the strongest of another hue, as a "
        "share of its own strength. It is 1 without a rival, and near 0 where the two were almost "
        "equal. It is below 0 where a stronger layer was cancelled by others before the two met, "
        "or with `foremost` lies behind. It is 0 where no hue survived.",
    }
    rows = [
        ".PP",
        *prose(
            "The file of `--provenance` has the data window of the picture, and three channels "
            "that say for each pixel where its hue comes from. `hpcomp-reports(7)` says more."
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
            "Set to anything but 0: text has colours in a pipe, too. NO_COLOR overrules it.",
        ),
        *definition(bold("COLUMNS"), "How wide text is, where it is not the terminal's width."),
    ]


def _environment() -> list[str]:
    return [
        *definition(
            bold("HPCOMP_ENGINE"),
            "`kernel` or `reference`: the engine that composites. `hpcomp-blending(7)` says more.",
        ),
        *definition(
            bold("SOURCE_DATE_EPOCH"),
            "Seconds since 1970: the date that is written into files. Without it, none is.",
        ),
        *definition(
            bold("TMPDIR"),
            "Where layers from stdin and pictures for stdout are kept while the command runs.",
        ),
    ]


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
    "hpcomp explain": [("JSON", lambda: _json_section(explanation.JSON_KEYS))],
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
    also = [(c.page, "1") for c in everything if c is not command]
    also += [(page.name, page.section) for page in pages()]
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
            typed(examples) if examples else [],
        ),
        ("SEE ALSO", _see_also(also)),
    ]
    note = "Generated by man/generate.py: change the help text of the command instead."
    return _roff_page(note, command.page, "1", sections)


def _see_also(names: Iterable[tuple[str, str]]) -> list[str]:
    """Pages of the manual by (name, section), and the paper."""
    return [
        ",\n".join(f"{bold(name)}({section})" for name, section in names),
        ".PP",
        *prose(
            "Johnson Chuang, Daniel Weiskopf, Torsten Möller: Hue-Preserving Color Blending, IEEE "
            "Transactions on Visualization and Computer Graphics 15(6), 2009."
        ),
    ]


def _roff_page(
    note: str, name: str, section: str, sections: Iterable[tuple[str, list[str]]]
) -> str:
    """A page of sections, each a title and lines of roff; one without lines is left out."""
    title = f'{roff(name).upper()} {section} "" "hpcomp {hpcomp.__version__}"'
    rows = [
        f'.\\" {note}',
        f'.TH {title} "{SECTIONS[section]}"',
        # Neither words broken at line ends nor stretched lines: options can be searched for.
        ".nh",
        ".ad l",
    ]
    for title, body in sections:
        if body:
            # A paragraph right after its heading is one already.
            rows += [f'.SH "{title}"', *(body[1:] if body[0] == ".PP" else body)]
    if ".TS" in rows:
        rows.insert(0, "'\\\" t")  # man has tables set by tbl
    return "\n".join(rows) + "\n"


# --- man pages written in Markdown ----------------------------------------------------------------


@dataclass(frozen=True)
class Page:
    """A page that is written in Markdown, `hpcomp-files.7.md`: its first line is its title."""

    source: Path

    @property
    def name(self) -> str:
        return self.source.name.split(".")[0]

    @property
    def section(self) -> str:
        return self.source.name.split(".")[1]

    @property
    def text(self) -> str:
        return with_parts(self.source.read_text(encoding="utf-8"))


def pages() -> list[Page]:
    """The pages that are written in Markdown, by section and name."""
    sources = MAN.glob("hpcomp-*.[0-9].md")
    return sorted((Page(path) for path in sources), key=lambda page: (page.section, page.name))


#: What begins a block of Markdown, each with what makes lines of roff of such a block.
_FENCE = re.compile(r"```\w*")
_ITEM = re.compile(r"(- |\d+\. )(?:`([^`]+)`: )?(.*)", re.DOTALL)


def markdown_sections(page: Page) -> Iterator[tuple[str, list[str]]]:
    """(title, lines of roff) of a page in Markdown, NAME first.

    Errors: ValueError for a first line that is not `# name(section): purpose`.
    """
    title, _, body = page.text.partition("\n")
    found = re.fullmatch(rf"# {re.escape(page.name)}\({page.section}\): (.*)", title)
    if not found:
        raise ValueError(f"{page.source.name} begins with '# {page.name}({page.section}): …'")
    yield "NAME", [rf"{roff(page.name)} \- {roff(found[1])}"]
    name = "DESCRIPTION"
    for part in re.split(r"^(?=## )", body, flags=re.MULTILINE):
        if part.startswith("## "):
            heading, _, part = part.partition("\n")
            name = heading.removeprefix("## ").upper()
        yield name, [row for block in markdown_blocks(part) for row in _roff_block(block)]


def markdown_blocks(text: str) -> Iterator[list[str]]:
    """The blocks of Markdown as lists of lines: paragraphs, items, tables, what is fenced."""
    block: list[str] = []
    fenced = False
    for row in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL).splitlines():
        if fenced:
            block.append(row)
            fenced = row != "```"
            continue
        if block and (not row.strip() or _FENCE.fullmatch(row) or _ITEM.match(row)):
            yield block
            block = []
        if row.strip():
            block.append(row)
            fenced = bool(_FENCE.fullmatch(row))
    if block:
        yield block


def _roff_block(block: list[str]) -> list[str]:
    if block[0].startswith("!["):
        return []  # man shows no pictures
    if _FENCE.fullmatch(block[0]):
        return [".PP", *typed(block[1:-1])]
    if block[0].startswith("|"):
        return _roff_table([[c.strip() for c in row.strip("|").split("|")] for row in block])
    text = " ".join(row.strip() for row in block)
    item = _ITEM.match(text)
    if not item:
        return [".PP", *prose(text, marked)]
    bullet, term, rest = item.groups()
    if term:
        return definition(bold(term), rest, marked)
    tag = r"\(bu 2" if bullet == "- " else f'"{bullet.strip()}" 4'
    return [f".IP {tag}", *prose(rest, marked)]


#: Cells of a table that are longer than this may be broken into lines.
LONG_CELL = 24


def _roff_table(rows: list[list[str]]) -> list[str]:
    """A table for tbl: a bold head, a rule, and the rest, long cells as blocks of text."""
    head, _, *body = rows
    wide = [max(map(len, column)) > LONG_CELL for column in zip(*body, strict=True)]
    columns = " ".join("lx" if is_wide else "l" for is_wide in wide)
    lines = [".TS", "tab(|);", " ".join(["lb"] * len(head)), f"{columns}."]
    lines += ["|".join(" ".join(prose(cell, marked)) for cell in head), "_"]
    for row in body:
        cells = [
            "\n".join(["T{", *prose(cell, marked), "T}"])
            if is_wide and cell
            else " ".join(prose(cell, marked))
            for cell, is_wide in zip(row, wide, strict=True)
        ]
        lines += "|".join(cells).splitlines()
    return [*lines, ".TE"]


def written_page(page: Page, everything: list[Command]) -> str:
    """A page that is written in Markdown, as roff for the man macros."""
    names = [(p.name, p.section) for p in pages() if p != page]
    also = [(c.page, "1") for c in everything] + names
    sections = [*markdown_sections(page), ("SEE ALSO", _see_also(also))]
    note = f"Generated by man/generate.py: change man/{page.source.name} instead."
    return _roff_page(note, page.name, page.section, sections)


# --- files ----------------------------------------------------------------------------------------


def generated() -> dict[Path, str]:
    """Every generated file and what it has to hold."""
    everything = commands()
    return {
        **{MAN / "man1" / f"{c.page}.1": man_page(c, everything) for c in everything},
        **{page.source: page.text for page in pages()},
        **{
            MAN / f"man{page.section}" / f"{page.name}.{page.section}": written_page(
                page, everything
            )
            for page in pages()
        },
        REFERENCE: reference(),
    }


def stale(files: dict[Path, str]) -> list[Path]:
    """Files that hold something else or are missing, and pages of roff that are not generated."""
    wrong = [
        path
        for path, text in files.items()
        if not path.is_file() or path.read_bytes() != text.encode()
    ]
    return wrong + sorted(set(MAN.glob("man[0-9]/*")) - set(files))


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
    for path in wrong:
        if path in files:
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(files[path].encode())
            print(f"wrote {path.relative_to(ROOT)}")
        else:
            path.unlink()
            print(f"removed {path.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
