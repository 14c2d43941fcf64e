"""`python -m hpcomp` and the console script: the `hpcomp` command."""

import os
import signal


def run() -> None:
    """Runs the command and ends the process. Signals wait until it can clean up after itself."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
    # No linear algebra happens here: numpy's need not start a thread for every core.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from .cli import run as run_command

    try:
        run_command()
    except SystemExit as end:
        # Files are whole and streams flushed: taking the interpreter apart would only take time.
        os._exit(end.code if isinstance(end.code, int) else 1)


if __name__ == "__main__":
    run()
