"""The options of commands that print or write one report, beside `options` for its tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import click

from ..report.formats import ReportFormat
from .options import F


def report_options(formats: Mapping[str, ReportFormat]) -> Callable[[F], F]:
    """`-o` and `--format` of a report in one of these formats."""

    def decorate(function: F) -> F:
        function = click.option(
            "--format",
            type=click.Choice(list(formats)),
            help="Format of the report, whatever the ending; text on stdout if not given.",
        )(function)
        return click.option(
            "-o",
            "--output",
            metavar="PATH",
            type=click.Path(readable=False),
            help="Write here, in the format of the ending: "
            f"{', '.join(row.ending for row in formats.values())}. Stdout if not given, or -.",
        )(function)

    return decorate


clobber_option = click.option(
    "--clobber/--no-clobber",
    default=True,
    show_default=True,
    help="Replace an existing output.",
)
