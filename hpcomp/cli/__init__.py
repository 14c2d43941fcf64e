"""The `hpcomp` command: how a run begins and how it ends. Nothing is computed or parsed here."""

from __future__ import annotations

import os
import sys

from ..errors import ExitCode, HpcompError
from . import frontpage, signals
from .messages import keep_libraries_off_stderr, open_standard_streams, say
from .printing import print_data


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
        if len(arguments) == 1 and arguments[0] in frontpage.HELP_NAMES:
            print_data(frontpage.page())
            return ExitCode.DONE
        code: int = signals.load(f"{__name__}.group").main(arguments)
        return code
    except HpcompError as error:
        if debug:
            raise
        say(f"hpcomp: error: {error}")
        return error.exit_code
    except KeyboardInterrupt:
        say("hpcomp: interrupted")
        return ExitCode.INTERRUPTED
    except signals.Terminated:
        return ExitCode.TERMINATED
    except BrokenPipeError:
        raise
    except Exception as error:
        if debug:
            raise
        what = f"{type(error).__name__}: {error}"
        say(f"hpcomp: bug: {what}; please report it with what --debug prints")
        return ExitCode.BUG
