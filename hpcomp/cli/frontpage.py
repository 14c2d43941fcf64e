"""What `hpcomp --help` says: the commands by name, and a page that is made without click.

Click's import takes longer than all else that this page needs.
"""

from __future__ import annotations

import os
import textwrap

from ..errors import EXIT_CODE_MEANINGS

#: The subcommands: the module of each, which is imported when it is called, and its one-line help.
COMMANDS: dict[str, tuple[str, str]] = {
    "stack": ("stack", "Composite layers, bottom first, into one picture."),
    "batch": ("batch", "Make many stacks, several at a time."),
    "flatten": ("flatten", "Composite the samples of deep EXR files into one flat picture."),
    "explain": ("explain", "Say step by step how one pixel of a stack comes about."),
    "check": ("check", "Fail if a picture has lost the hues of its layers."),
    "info": ("info", "Say what image files hold and how they will be read."),
    "hues": ("hues", "Count the hues of images: how much of each, and which stand out."),
    "palette": ("palette", "Say what the colours of labels blend to, and what may go wrong."),
    "completion": ("completion", "Print the completion script of a shell."),
}

#: The options of `hpcomp` itself: how they are written, their sentences. Click parses them.
HELP_NAMES = ("-h", "--help")
VERSION_HELP = "Show the version and the active engine, and exit."
_OPTIONS = {"--version": VERSION_HELP, ", ".join(HELP_NAMES): "Show this message and exit."}

INTRODUCTION = """\
Composite translucent label layers so that every hue that appears is one that went in.

Layers are PNG or EXR files. Where they overlap, colours are added with the hue-preserving ⊕
of Chuang, Weiskopf and Möller (2009), in linear light, for any Porter–Duff operator.
`hpcomp COMMAND --help` explains a command. HPCOMP_ENGINE=kernel or =reference in the
environment chooses the engine.
"""

#: As wide as the pages of the commands, which click makes: two columns of a terminal stay free.
NARROWEST, WIDEST = 50, 100


def page() -> str:
    """The page, as wide as the terminal."""
    width = max(NARROWEST, min(_columns(), WIDEST) - 2)
    paragraphs = (_wrapped(text, width, "  ") for text in INTRODUCTION.split("\n\n"))
    sections = {
        "Options": _OPTIONS,
        "Commands": {name: help_line for name, (_, help_line) in COMMANDS.items()},
        "Exit codes": {str(int(code)): text for code, text in EXIT_CODE_MEANINGS.items()},
    }
    return "\n\n".join(
        [
            "Usage: hpcomp [OPTIONS] COMMAND [ARGS]...",
            *paragraphs,
            *(f"{title}:\n{_rows(rows, width)}" for title, rows in sections.items()),
        ]
    )


def _rows(rows: dict[str, str], width: int) -> str:
    """A line or more for each row: a name, and what is said of it in a column of its own."""
    column = max(map(len, rows)) + 4
    return "\n".join(
        _wrapped(text, width, " " * column, f"  {name}".ljust(column))
        for name, text in rows.items()
    )


def _wrapped(text: str, width: int, indent: str, first: str | None = None) -> str:
    return textwrap.fill(
        text,
        width,
        initial_indent=indent if first is None else first,
        subsequent_indent=indent,
    )


def _columns() -> int:
    """Those of the terminal, unless the environment says how many; 80 where there is none."""
    given = os.environ.get("COLUMNS", "")
    if given.isdecimal() and int(given) > 0:
        return int(given)
    try:
        return os.get_terminal_size(1).columns or 80
    except OSError:
        return 80
