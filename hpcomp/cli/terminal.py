"""What stdout can show: colours, columns, letters."""

from __future__ import annotations

import os
import shutil
import sys
from dataclasses import replace
from typing import TypeVar

from ..errors import SettingError
from ..report.hueformats import ReportFormat
from ..report.look import Look

L = TypeVar("L", bound=Look)


def shows_color() -> bool:
    """Whether what is printed on stdout is to be coloured.

    NO_COLOR says no, then FORCE_COLOR and CLICOLOR_FORCE say yes, whatever stdout is; else a
    terminal shows colours unless it is a dumb one or CLICOLOR is 0. See no-color.org and
    bixense.com/clicolors; a variable that is empty says nothing.
    """
    if os.environ.get("NO_COLOR"):
        return False
    if any(
        os.environ.get(name, "0") not in ("", "0") for name in ("FORCE_COLOR", "CLICOLOR_FORCE")
    ):
        return True
    if os.environ.get("TERM") == "dumb" or os.environ.get("CLICOLOR") == "0":
        return False
    return is_terminal()


def is_terminal() -> bool:
    return sys.stdout is not None and sys.stdout.isatty()


def check_shows(format: ReportFormat, output: str | None) -> None:
    """`SettingError` where nobody asked for what a terminal cannot show."""
    if output is None and not format.on_terminal and is_terminal():
        raise SettingError(f"a terminal shows no {format.name}: name a file with -o, or a pipe")


def look(asked: L) -> L:
    """The look asked for, as stdout can show it."""
    return replace(
        asked,
        columns=shutil.get_terminal_size((80, 24)).columns,
        color=shows_color(),
        encoding=(sys.stdout is not None and sys.stdout.encoding) or "utf-8",
    )
