"""What the commands share: how messages are shown, and what a wrong setting ends as."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

from ..errors import HpcompWarning, SettingError, nearest_name
from .messages import say
from .words import Choice

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

#: Where a context keeps the answer of `is_quiet`.
_QUIET = "hpcomp.quiet"

F = TypeVar("F", bound=Callable[..., Any])


class Command(click.Command):
    """A command whose wrong settings, wherever they are found, end as usage errors."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        options = long_options(self, ctx)
        for word in args[: args.index("--")] if "--" in args else args:
            # As other programs have them; -order would be -o with the value rder.
            if len(word) > 2 and f"-{word.partition('=')[0]}" in options:
                raise unknown_option(self, ctx, word)
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            raise unknown_option(self, ctx, error.option_name) from None
        except click.UsageError as error:
            error.ctx = error.ctx or ctx  # the parser does not know the command
            raise

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem[str]]:
        older = {
            name
            for param in self.get_params(ctx)
            if isinstance(param, OptionOfOlderName)
            for name in set(param.opts) - set(shown_names(param))
        }
        items = super().shell_complete(ctx, incomplete)
        return [item for item in items if item.value not in older]

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except SettingError as error:
            raise click.UsageError(str(error), ctx) from error


def long_options(command: click.Command, ctx: click.Context) -> set[str]:
    """The options that a command takes, by their long names."""
    return {
        name
        for option in command.get_params(ctx)
        for name in (*option.opts, *option.secondary_opts)
        if name.startswith("--")
    }


def unknown_option(command: click.Command, ctx: click.Context, option: str) -> click.UsageError:
    """The error of an option that a command does not take, with the one that was meant."""
    from ..layers.layerspec import LAYER_KEYS  # with tables that not all commands need

    name = option.partition("=")[0].lstrip("-")
    shown = {
        shown[2:]
        for param in command.get_params(ctx)
        if isinstance(param, click.Option) and not param.hidden
        for shown in (*shown_names(param), *param.secondary_opts)
        if shown.startswith("--")
    }
    if name in LAYER_KEYS and isinstance(command, LayerCommand) and name not in shown:
        hint = f": it is a setting of one layer: write LAYER::{name}=…"
    else:
        near = nearest_name(name, shown) if len(option) > 2 else ""
        hint = f": did you mean '--{near}'?" if near else f": see {ctx.command_path} --help"
    return click.UsageError(f"unknown option '{option.partition('=')[0]}'{hint}", ctx)


class LayerCommand(Command):
    """Takes `-::key=value`, stdin with settings, for the layer that it is and not for an option."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        rest = super().parse_args(
            ctx, [f"{STDIN_MARK}{a}" if a.startswith("-::") else a for a in args]
        )
        for name, value in ctx.params.items():
            if isinstance(value, tuple):
                ctx.params[name] = tuple(map(_as_typed, value))
            else:
                ctx.params[name] = _as_typed(value)
        return rest


#: What `-::key=value` begins with while click reads it: a character of Unicode's private use.
STDIN_MARK = "\U000f0000"


def _as_typed(value: Any) -> Any:
    return value.removeprefix(STDIN_MARK) if isinstance(value, str) else value


def _show_messages(ctx: click.Context, param: click.Parameter, value: bool) -> bool:
    if value and param.name == "verbose" and sys.stderr is not None:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("hpcomp: %(message)s"))
        logging.getLogger("hpcomp").addHandler(handler)
        logging.getLogger("hpcomp").setLevel(logging.INFO)
    if param.name == "quiet":
        ctx.meta[_QUIET] = value
        # What libraries warn of is for developers; `--debug` leaves it as it is.
        if "--debug" not in sys.argv:
            warnings.simplefilter("ignore")
        warnings.simplefilter("ignore" if value else "always", HpcompWarning)
        warnings.showwarning = _show_warning
    return value


def is_quiet(ctx: click.Context) -> bool:
    """Whether errors only are to be printed."""
    return bool(ctx.meta.get(_QUIET))


def _show_warning(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
    say(f"hpcomp: warning: {message}")


class OptionOfOlderName(click.Option):
    """An option whose first name help shows; the second is an older spelling that is accepted."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        names = self.opts
        self.opts = shown_names(self)
        try:
            return super().get_help_record(ctx)
        finally:
            self.opts = names


def shown_names(option: click.Option) -> list[str]:
    """The names of an option that help and the manual show."""
    return option.opts[:1] if isinstance(option, OptionOfOlderName) else option.opts


format_option = click.option(
    "--format",
    type=Choice(["text", "json"], "format"),
    default="text",
    show_default=True,
    help="What to print.",
)


def at_a_time(help: str) -> Callable[[F], F]:
    """`-j`, how many stacks are made at a time."""
    return click.option(
        "-j", "--jobs", "workers", type=click.IntRange(min=1), metavar="N", help=help
    )


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
