"""Job files: reading jobs from TOML, JSON, JSON Lines and CSV, and writing them."""

from __future__ import annotations

import csv
import io
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import msgspec

from ..errors import InputError, SettingError, unknown_name, why
from ..system.outputs import whole_output, write_bytes, writing
from ..system.streams import STDIN
from .lines import Lines, json_keys, toml_keys
from .schema import (
    JOB_OPTIONS,
    SCHEMA_VERSION,
    Job,
    MisplacedError,
    check_version,
    checked_defaults,
    checked_job,
    decoded_document,
    decoded_job,
    in_words,
    takes_text,
)

#: What a document has beside its jobs.
_DOCUMENT_KEYS = ("version", "defaults", "jobs")

# --- reading --------------------------------------------------------------------------------------


def read_jobs(path: str | os.PathLike[str], *, format: str | None = None) -> list[Job]:
    """The jobs of a file, each checked as far as no layer has to be read.

    `path`: ends in .toml, .json, .jsonl (or .ndjson) or .csv, unless `format` says which of `toml`,
    `json`, `jsonl`, `csv` it is; `-` reads stdin, with `format`. Paths in it are relative to the
    working directory, as on the command line.
    Errors: `InputError` for a file that cannot be read or parsed, `SettingError` for what it says:
    both name file and line.
    """
    path = os.fspath(path)
    reader = FORMATS[_format(path, format)]
    label = "stdin" if path == STDIN else path
    try:
        if path == STDIN:
            if sys.stdin is None:
                raise InputError("stdin is closed: give it jobs, or name a file")
            data = sys.stdin.buffer.read()
        else:
            with open(path, "rb") as file:
                data = file.read()
    except OSError as reason:
        raise InputError(f"{label}: cannot be read: {why(reason)}") from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        line = data.count(b"\n", 0, reason.start) + 1
        raise InputError(f"{label}:{line}: is not text in UTF-8") from None
    jobs = list(reader(label, text))
    if not jobs:
        raise SettingError(f"{label}: there are no jobs in it")
    return jobs


def _format(path: str, format: str | None) -> str:
    if format is not None:
        if format not in FORMATS:
            raise unknown_name("format of jobs", format, FORMATS)
        return format
    if path == STDIN:
        raise SettingError(f"jobs from stdin need a format: {', '.join(FORMATS)}")
    ending = os.path.splitext(path)[1].lower().removeprefix(".")
    ending = _OTHER_ENDINGS.get(ending, ending)
    if ending not in FORMATS:
        raise SettingError(
            f"{path} ends in none of .{', .'.join(FORMATS)}: say its format, one of "
            f"{', '.join(FORMATS)}"
        )
    return ending


def _document_jobs(
    label: str,
    document: Any,
    line_of: Callable[[object, str], int | None],
    typed: bool = False,
) -> Iterator[Job]:
    """The jobs of a whole document: a table with `jobs`, a list of jobs, or one job.

    `typed`: keys and types are checked already.
    """

    def refused(problem: SettingError, what: str = "") -> SettingError:
        line = line_of(problem.table, problem.key) if isinstance(problem, MisplacedError) else None
        return SettingError(f"{label}{f':{line}' if line else ''}: {what}{problem}")

    if isinstance(document, Mapping) and ("layers" in document or "output" in document):
        document = [document]
    defaults: dict[str, Any] = {}
    if isinstance(document, Mapping):
        try:
            for key in document:
                if key not in _DOCUMENT_KEYS:
                    raise MisplacedError(
                        str(unknown_name("key of a job file", key, _DOCUMENT_KEYS)), document, key
                    )
            check_version(document.get("version", SCHEMA_VERSION), document)
            defaults = checked_defaults(document)
            tables = document.get("jobs", [])
            if not isinstance(tables, list):
                raise MisplacedError("jobs is not a list of tables", document, "jobs")
        except SettingError as problem:
            raise refused(problem) from None
    elif isinstance(document, list):
        tables = document
    else:
        raise SettingError(f"{label}: holds neither jobs nor a job")
    for number, table in enumerate(tables, 1):
        try:
            yield checked_job(table, defaults, f"{label}: job {number}", typed=typed)
        except SettingError as problem:
            raise refused(problem, f"job {number}: ") from None


def _toml(label: str, text: str) -> Iterator[Job]:
    import tomllib

    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as reason:
        raise InputError(f"{label}: is not TOML: {reason}") from None
    yield from _document_jobs(
        label, document, Lines(text, document, toml_keys, by_table=True).line_of
    )


def _json(label: str, text: str) -> Iterator[Job]:
    document = decoded_document(text)
    typed = document is not None
    if not typed:
        document = _parsed_json(label, 1, text)
    yield from _document_jobs(label, document, Lines(text, document, json_keys).line_of, typed)


def _parsed_json(label: str, first_line: int, text: str) -> Any:
    try:
        return json.loads(text, object_pairs_hook=_no_key_twice)
    except json.JSONDecodeError as reason:
        line = first_line + reason.lineno - 1
        raise InputError(f"{label}:{line}: is not JSON: {reason.msg} at {reason.colno}") from None
    except SettingError as problem:
        raise SettingError(
            f"{label}{f':{first_line}' if first_line > 1 else ''}: {problem}"
        ) from None
    except (ValueError, RecursionError) as reason:  # a number too long, brackets too deep
        raise InputError(f"{label}: is not JSON that can be read: {reason}") from None


def _no_key_twice(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for key, value in pairs:
        if key in table:
            raise SettingError(f"key '{key}' stands twice in one table")
        table[key] = value
    return table


def _jsonl(label: str, text: str) -> Iterator[Job]:
    """A job a line; a first line without layers may give the version and defaults."""
    defaults: dict[str, Any] = {}
    number = 0
    for line_number, line in enumerate(text.split("\n"), 1):
        if not line.strip():
            continue
        table = decoded_job(line)
        typed = table is not None
        if not typed:
            table = _parsed_json(label, line_number, line)
        try:
            if number == 0 and isinstance(table, dict) and table.keys() <= {"version", "defaults"}:
                check_version(table.get("version", SCHEMA_VERSION), table)
                defaults = checked_defaults(table)
                continue
            number += 1
            yield checked_job(table, defaults, f"{label}:{line_number}", typed=typed)
        except SettingError as problem:
            raise SettingError(f"{label}:{line_number}: {problem}") from None


#: The column of a layer, which may stand several times.
_LAYER_COLUMN = "layer"


def _csv(label: str, text: str) -> Iterator[Job]:
    """A job a row: columns `output`, `layer` as often as needed, options; empty: not given."""
    rows = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        head = [name.strip() for name in next(rows, [])]
        hints = {"output": str, "version": int, **JOB_OPTIONS}
        for name in head:
            if name not in hints and name != _LAYER_COLUMN:
                raise SettingError(
                    f"{label}:1: {unknown_name('column', name, [_LAYER_COLUMN, *hints])}"
                )
            if name != _LAYER_COLUMN and head.count(name) > 1:
                raise SettingError(f"{label}:1: column '{name}' stands twice")
        begin = rows.line_num + 1
        for row in rows:
            line, begin = begin, rows.line_num + 1
            if not any(cell.strip() for cell in row):
                continue
            try:
                if len(row) > len(head):
                    raise SettingError(f"{len(row)} cells, but {len(head)} columns have a name")
                cells = [
                    (name, cell) for name, cell in zip(head, row, strict=False) if cell.strip()
                ]
                table: dict[str, Any] = {
                    name: _from_text(name, cell.strip(), hints[name])
                    for name, cell in cells
                    if name != _LAYER_COLUMN
                }
                if layers := [cell.strip() for name, cell in cells if name == _LAYER_COLUMN]:
                    table["layers"] = layers
                yield checked_job(table, {}, f"{label}:{line}")
            except SettingError as problem:
                raise SettingError(f"{label}:{line}: {problem}") from None
    except csv.Error as reason:
        raise InputError(f"{label}:{rows.line_num}: is not CSV: {reason}") from None


_TRUTHS = {"yes": "true", "no": "false"}


def _from_text(name: str, text: str, written: Any) -> Any:
    """What a cell of text means for an option; what takes a text is left to `stack` to parse."""
    if takes_text(written):
        return text
    try:
        return msgspec.convert(_TRUTHS.get(text.lower(), text), written, strict=False)
    except msgspec.ValidationError:
        raise SettingError(f"{name} is '{text}': it takes {in_words(written)}") from None


#: The formats of a job file, each with its reader.
FORMATS: dict[str, Callable[[str, str], Iterator[Job]]] = {
    "toml": _toml,
    "json": _json,
    "jsonl": _jsonl,
    "csv": _csv,
}
_OTHER_ENDINGS = {"ndjson": "jsonl"}


# --- writing --------------------------------------------------------------------------------------


#: Formats that jobs are written in.
WRITTEN = (".json", ".jsonl", ".ndjson")


def save_jobs(jobs: Sequence[Job], path: str | os.PathLike[str], *, clobber: bool = True) -> None:
    """Writes jobs to a file that `read_jobs` reads.

    `path`: ends in .json, which is written anew, or in .jsonl, to which a line a job is added.
    Errors: `SettingError` for another ending, `OutputError`.
    """
    path = os.fspath(path)
    ending = os.path.splitext(path)[1].lower()
    if ending not in WRITTEN:
        raise SettingError(
            f"{path} ends in none of {', '.join(WRITTEN)}: jobs are written as these"
        )
    with writing(path):
        if ending == ".json":
            document = {"version": SCHEMA_VERSION, "jobs": [job.document() for job in jobs]}
            with whole_output(path, clobber=clobber) as target:
                write_bytes(target, f"{json.dumps(document, indent=2)}\n".encode(), path)
            return
        lines = [json.dumps({"version": SCHEMA_VERSION, **job.document()}) for job in jobs]
        with open(path, "ab", buffering=0) as log:
            # At once, so that lines of several commands do not mix.
            log.write("".join(f"{line}\n" for line in lines).encode())
