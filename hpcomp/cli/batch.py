"""`hpcomp batch`: parses, calls `jobs.batch.batch`, tells how it goes."""

from __future__ import annotations

import json
import shlex
import sys
from typing import Any

import click

from ..errors import ExitCode, HpcompError
from .messages import say
from .options import Command, at_a_time, is_quiet, message_options
from .printing import print_data
from .progress import Progress
from .signals import load
from .stackoptions import make_options, stack_options
from .words import JOBS, Choice, File

HELP = """Make many stacks, several at a time.

JOBS is a file in TOML, JSON, JSON Lines or CSV, or `-` for stdin with --format. A job has layers,
bottom first, an output, and options of stack under their names, with _ for -. A layer is a LAYER
text or a table of its path and keys. Paths are relative to the working directory. The option
--save-job of stack writes such files.

In TOML and JSON, the list `jobs` holds the jobs, `defaults` holds options for all of them, and
`version` is 1. In JSON Lines, each line is a job; a first line without layers may hold version and
defaults. In CSV, each row is a job, with the columns output, layer (as many as needed) and options.

A job that needs the output of another one waits for it. A failure does not stop the other jobs. The
exit code is that of the worst failure: 1 is worse than 5, then 3, 4 and 2. A hidden file beside
JOBS remembers what was done, for --update and --resume. Only one batch at a time may use it.

\b
  hpcomp batch jobs.toml
  hpcomp batch jobs.toml --update --log jobs.log
  hpcomp batch - --format jsonl -j 2 < jobs.jsonl
"""


def _print_schema(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        print_data(json.dumps(load("hpcomp.jobs.schema").json_schema(), indent=2))
        ctx.exit()


@click.command("batch", cls=Command, help=HELP, short_help=HELP.partition("\n")[0])
@click.argument("jobs", metavar="JOBS", type=File(*JOBS))
@click.option(
    "--format",
    type=Choice(["toml", "json", "jsonl", "csv"], "format of jobs"),
    help="Format of JOBS, whatever its ending.",
)
@at_a_time("Jobs at a time, each on a core: all cores if not given, but so that each job has 128M.")
@stack_options(
    *("threads", "max_memory", "max_pixels"),
    help={
        "threads": "Threads of all jobs together: as many as cores are used if not given.",
        "max_memory": "Memory for pixels and codecs of all jobs together, such as 512M.",
    },
)
@click.option("--fail-fast", is_flag=True, help="Begin no more jobs after one that failed.")
@click.option("--skip-existing", is_flag=True, help="Leave out jobs whose outputs all exist.")
@click.option(
    "--update",
    is_flag=True,
    help="Leave out jobs whose options, inputs (by content) and outputs are as they were.",
)
@click.option(
    "--resume", is_flag=True, help="Carry on an interrupted run: leave out what it has done."
)
@click.option(
    "--state",
    metavar="PATH",
    type=File(),
    help="Keep here what was done, instead of beside JOBS.",
)
@click.option(
    "--log",
    "log_to",
    metavar="PATH",
    type=File(),
    help="Write a line of JSON for each job; - for stdout. With --resume they are added.",
)
@click.option(
    "--dask",
    metavar="ADDRESS",
    help="Let the workers of a Dask cluster do the jobs, on the same paths: a scheduler's address "
    "or scheduler file, or local:N to start one here. -j is then how many jobs run at a time, "
    "and --threads (1 if not given) and --max-memory are of each job.",
)
@click.option(
    "--schema",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_schema,
    help="Print what job files may say, as a JSON Schema, and exit.",
)
@make_options
@message_options
@click.pass_context
def command(ctx: click.Context, /, jobs: str, **options: Any) -> None:
    run(ctx, jobs, **options)


def run(ctx: click.Context, jobs: Any, **options: Any) -> None:
    """Runs jobs and tells how it goes; the exit code is that of the worst failure."""
    batching = load("hpcomp.jobs.batch")
    quiet = is_quiet(ctx)
    progress = Progress(quiet)

    def ended(record: Any, job: Any) -> None:
        name = f"{job.where} ({job.output})"
        if not quiet:
            for warning in record.warnings:
                progress.message(f"hpcomp: warning: {name}: {warning}")
        if record.error:
            progress.message(f"hpcomp: error: {name}: {record.error}")
        worked = record.status in ("made", "failed")
        text = f"{job.output} in {record.seconds:.2f} s"
        progress.count(worked, record.status == "failed", text)

    try:
        result = batching.batch(
            jobs,
            command=shlex.join(["hpcomp", *sys.argv[1:]]),
            on_begin=lambda todo: progress.begin(len(todo)),
            on_record=ended,
            on_wait=progress.draw,
            **options,
        )
    except BaseException as end:
        progress.clear()
        if progress.total and not (quiet or isinstance(end, HpcompError)):
            say(f"hpcomp: {progress.ended} of {progress.total} jobs have ended")
        raise
    progress.clear()
    if not quiet:
        counts = ", ".join(f"{count} {status}" for status, count in result.counts.items())
        say(f"hpcomp: {progress.total} jobs in {result.seconds:.1f} s: {counts}")
    if result.exit_code != ExitCode.DONE:
        ctx.exit(int(result.exit_code))
