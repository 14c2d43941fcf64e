"""The `hpcomp` command as click has it: which command its words name, or what is wrong in them."""

from __future__ import annotations

import os

import click

from ..errors import ExitCode, SettingError, unknown_name
from ..version import __version__
from . import frontpage, signals
from .frontpage import COMMANDS
from .messages import say

#: What a shell sets in the environment to have a command line completed.
COMPLETING = "_HPCOMP_COMPLETE"


class LazyGroup(click.Group):
    """A group whose commands are imported when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        command: click.Command = signals.load(f"{__package__}.{COMMANDS[name][0]}").command
        return command

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            # As click's own groups since its version 8.2, whichever version this is.
            click.echo(ctx.get_help(), err=True)
            ctx.exit(int(ExitCode.USAGE))
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            raise signals.load(f"{__package__}.options").unknown_option(
                self, ctx, error.option_name
            ) from None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in COMMANDS and not ctx.resilient_parsing:
            raise click.UsageError(str(unknown_name("command", args[0], COMMANDS)), ctx)
        return super().resolve_command(ctx, args)

    def get_help(self, ctx: click.Context) -> str:
        return frontpage.page()


def _print_version(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        engine = signals.load("hpcomp.engine.choice")
        try:
            name = engine.chosen().name
        except SettingError as error:
            raise click.UsageError(str(error), ctx) from error
        click.echo(f"hpcomp {__version__} (engine: {name})")
        ctx.exit()


@click.group(
    cls=LazyGroup,
    no_args_is_help=False,
    help=frontpage.INTRODUCTION,
    context_settings={
        "help_option_names": list(frontpage.HELP_NAMES),
        "max_content_width": frontpage.WIDEST,
    },
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help=frontpage.VERSION_HELP,
)
def cli() -> None:
    """What the command does without a subcommand: nothing."""


def main(arguments: list[str]) -> int:
    """Runs the command that the arguments name; its exit code.

    What click finds wrong with them is printed here; all other errors are the caller's.
    """
    try:
        if os.environ.get(COMPLETING):
            signals.load(f"{__package__}.completion")  # how each shell wants its words
        # A command that calls ctx.exit() makes its code the result of main().
        code = cli.main(
            arguments, prog_name="hpcomp", complete_var=COMPLETING, standalone_mode=False
        )
        return code if isinstance(code, int) else ExitCode.DONE
    except click.UsageError as error:
        if error.ctx is not None:
            say(error.ctx.get_usage())
        say(f"hpcomp: error: {error.format_message()}")
        return ExitCode.USAGE
    except click.Abort:
        raise KeyboardInterrupt from None
    except SystemExit as end:  # click's own answer: to a shell that completes, or to a closed pipe
        if not os.environ.get(COMPLETING):
            raise BrokenPipeError from None
        if end.code:
            say(f"hpcomp: error: {COMPLETING} is not bash, zsh or fish, then _complete or _source")
            return ExitCode.USAGE
        return ExitCode.DONE
