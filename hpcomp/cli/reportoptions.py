"""The options of commands that print or write one report, beside `options` for its tables."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence

import click

from ..report.hueformats import ReportFormat
from ..system.depfile import Depfile
from ..system.outputs import check_places, whole_output
from ..system.streams import STDOUT
from .options import F
from .words import Choice, File


def report_options(formats: Mapping[str, ReportFormat]) -> Callable[[F], F]:
    """`-o` and `--format` of a report in one of these formats."""

    def decorate(function: F) -> F:
        function = click.option(
            "--format",
            type=Choice(formats, "format"),
            help="Format of the report, whatever the ending; text on stdout if not given.",
        )(function)
        return click.option(
            "-o",
            "--output",
            metavar="PATH",
            type=File(*(row.ending for row in formats.values())),
            help="Write here, in the format of the ending: "
            f"{', '.join(row.ending for row in formats.values())}. Stdout if not given, or -.",
        )(function)

    return decorate


#: The parameters of `opened_report` that are options of a command.
WRITING = ("clobber", "depfile", "depfile_target", "write_if_changed")


@contextlib.contextmanager
def opened_report(
    target: str,
    inputs: Sequence[str],
    *,
    clobber: bool,
    depfile: str | None,
    depfile_target: Sequence[str],
    write_if_changed: bool,
) -> Iterator[str]:
    """Where to write a report for `target`, nowhere if that is stdout, and its depfile beside it.

    `inputs`: the files that it is made from.
    """
    deps = Depfile.asked(depfile, depfile_target, [target])
    check_places([target, *([deps.path] if deps else ())])
    with contextlib.ExitStack() as opened:
        place = ""
        if target != STDOUT:
            place = opened.enter_context(
                whole_output(target, clobber=clobber, if_changed=write_if_changed)
            )
        if deps is not None:
            opened.enter_context(deps.written(inputs, write_if_changed))
        yield place
