"""`python -m hpcomp` and the console script: the `hpcomp` command."""

import signal


def run() -> None:
    """Runs the command. Signals wait until it can clean up after itself."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
    from .cli import run as run_command

    run_command()


if __name__ == "__main__":
    run()
