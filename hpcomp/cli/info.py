"""`hpcomp info`: prints how files will be read, as text or JSON."""

from __future__ import annotations

import json

import click

from ..errors import InputError
from .messages import say
from .options import Command, format_option, message_options
from .printing import print_data
from .signals import load
from .words import PICTURES, File


@click.command(
    "info", cls=Command, short_help="Say what image files hold and how they will be read."
)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=File(*PICTURES))
@format_option
@click.option("--json", "format", flag_value="json", help="Short for --format json.")
@message_options
@click.pass_context
def command(ctx: click.Context, files: tuple[str, ...], format: str) -> None:
    """Say what image files hold and how they will be read.

    info prints parts, channels, windows, depth, alpha, light and primaries, and where each was read
    from, and warns of what is not in the picture that is read. FILE `-` is stdin. JSON is one
    document for all files. Files that cannot be read are named on stderr, with exit code 3.
    """
    pipeline, fileinfo = load("hpcomp.pipeline.images"), load("hpcomp.report.fileinfo")

    described, failures = [], []
    for path in files:
        try:
            described.append(pipeline.info(path))
        except InputError as error:
            failures.append(error)
    if format == "json":
        document = {
            "schema": "hpcomp.info",
            "version": fileinfo.SCHEMA_VERSION,
            "files": [fileinfo.as_data(file) for file in described],
        }
        print_data(json.dumps(document, indent=2))
    elif described:
        print_data("\n\n".join(fileinfo.as_text(file) for file in described))
    for failure in failures:
        say(f"hpcomp: error: {failure}")
    if failures:
        ctx.exit(int(InputError.exit_code))
