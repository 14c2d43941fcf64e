"""`python -m hpcomp` is the `hpcomp` command."""

from .cli import run

run()
