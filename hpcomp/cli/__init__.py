"""The `hpcomp` command: its subcommands by name, and how a run ends. Nothing is computed here."""

from __future__ import annotations

import os
import sys

import click

from ..errors import EXIT_CODE_MEANINGS, ExitCode, HpcompError, SettingError, unknown_name
from ..version import __version__
from . import signals
from .messages import keep_libraries_off_stderr, open_standard_streams, say

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


#: What a shell sets in the environment to have a command line completed.
COMPLETING = "_HPCOMP_COMPLETE"


class LazyGroup(click.Group):
    """A group whose commands are imported when they are called: `--help` imports click alone."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        command: click.Command = signals.load(f"{__name__}.{COMMANDS[name][0]}").command
        return command

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            # As click's own groups since its version 8.2, whichever version this is.
            click.echo(ctx.get_help(), err=True)
            ctx.exit(int(ExitCode.USAGE))
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            raise signals.load(f"{__name__}.options").unknown_option(
                self, ctx, error.option_name
            ) from None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in COMMANDS and not ctx.resilient_parsing:
            raise click.UsageError(str(unknown_name("command", args[0], COMMANDS)), ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, help_line) for name, (_, help_line) in COMMANDS.items()])

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Exit codes"):
            formatter.write_dl([(str(int(k)), v) for k, v in EXIT_CODE_MEANINGS.items()])


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
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version and the active engine, and exit.",
)
def cli() -> None:
    """Composite translucent label layers so that every hue that appears is one that went in.

    Layers are PNG or EXR files. Where they overlap, colours are added with the hue-preserving ⊕
    of Chuang, Weiskopf and Möller (2009), in linear light, for any Porter–Duff operator.
    `hpcomp COMMAND --help` explains a command. HPCOMP_ENGINE=kernel or =reference in the
    environment chooses the engine.
    """


def run(arguments: list[str] | None = None) -> None:
    """The console script: runs one command and ends the process with its exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in arguments
    open_standard_streams()
    if not debug:
        keep_libraries_off_stderr()
    try:
        code = _exit_code(arguments, debug)
        if sys.stdout is not None:  # it may have been closed from the start
            sys.stdout.flush()
    except BrokenPipeError:
        # Python flushes stdout once more at exit, into a pipe that nobody reads.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        code = ExitCode.PIPE_CLOSED
    sys.exit(int(code))


def _exit_code(arguments: list[str], debug: bool) -> int:
    """Runs the command; what goes wrong becomes one line and an exit code."""
    try:
        signals.install()
        if os.environ.get(COMPLETING):
            signals.load(f"{__name__}.completion")  # how each shell wants its words
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
    except HpcompError as error:
        if debug:
            raise
        say(f"hpcomp: error: {error}")
        return error.exit_code
    except (KeyboardInterrupt, click.Abort):
        say("hpcomp: interrupted")
        return ExitCode.INTERRUPTED
    except signals.Terminated:
        return ExitCode.TERMINATED
    except SystemExit as end:  # click's own answer: to a shell that completes, or to a closed pipe
        if not os.environ.get(COMPLETING):
            raise BrokenPipeError from None
        if end.code:
            say(f"hpcomp: error: {COMPLETING} is not bash, zsh or fish, then _complete or _source")
            return ExitCode.USAGE
        return ExitCode.DONE
    except BrokenPipeError:
        raise
    except Exception as error:
        if debug:
            raise
        what = f"{type(error).__name__}: {error}"
        say(f"hpcomp: bug: {what}; please report it with what --debug prints")
        return ExitCode.BUG
