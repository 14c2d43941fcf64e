"""What the commands share: how messages are shown, and what a wrong setting ends as."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

import click

from ..errors import HpcompWarning, OutputError, SettingError, one_line

F = TypeVar("F", bound=Callable[..., Any])


class Command(click.Command):
    """A command whose wrong settings, wherever they are found, end as usage errors."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except SettingError as error:
            raise click.UsageError(str(error), ctx) from error


def _show_messages(ctx: click.Context, param: click.Parameter, value: bool) -> bool:
    if value and param.name == "verbose":
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("hpcomp: %(message)s"))
        logging.getLogger("hpcomp").addHandler(handler)
        logging.getLogger("hpcomp").setLevel(logging.INFO)
    if param.name == "quiet":
        warnings.simplefilter("ignore" if value else "always", HpcompWarning)
        warnings.showwarning = _show_warning
    return value


def _show_warning(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
    print(one_line(f"hpcomp: warning: {message}"), file=sys.stderr)


def print_data(text: str) -> None:
    """Prints on stdout, which carries data only; `OutputError` where it takes none."""
    if sys.stdout is None:
        raise OutputError("stdout is closed: give it a reader")
    try:
        click.echo(text)
    except BrokenPipeError:
        raise
    except OSError as reason:
        raise OutputError(f"stdout: cannot be written: {reason.strerror}") from None


def message_options(function: F) -> F:
    """`-v`, `-q` and `--debug`, which every command that does work has."""
    for option in (
        click.option("--debug", is_flag=True, expose_value=False, help="Show tracebacks."),
        click.option(
            "-q", "--quiet", is_flag=True, expose_value=False, callback=_show_messages,
            help="Print errors only.",
        ),
        click.option(
            "-v", "--verbose", is_flag=True, expose_value=False, callback=_show_messages,
            help="Print decisions and timings.",
        ),
    ):  # fmt: skip
        function = option(function)
    return function
