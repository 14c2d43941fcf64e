"""Stacks written down as jobs: the schema, reading it from TOML, JSON, JSON Lines and CSV, writing.

A job is `{"layers": [LAYER, …], "output": PATH}` and options of `stack` under their names; the
names and what they take are those of its parameters. Nothing is composited here.
"""

from __future__ import annotations

import csv
import inspect
import io
import json
import os
import re
import sys
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from types import NoneType
from typing import Any

from .errors import InputError, OutputError, SettingError, unknown_key, unknown_name, why
from .geometry import Window
from .outputfile import whole_output
from .pipeline import stack
from .stackfile import LayerSpec, layer_spec

#: The version of the schema that is read and written.
SCHEMA_VERSION = 1
STDIN = "-"

#: What a document has beside its jobs.
_DOCUMENT_KEYS = ("version", "defaults", "jobs")
#: What a job has beside the options of `stack`.
_OWN_KEYS = ("version", "layers", "output")
#: Parameters of `stack` that are no options: what only the command line knows.
_NO_OPTIONS = ("layers", "output", "command")


@dataclass(frozen=True)
class Job:
    """One stack: its layers, bottom first, its output, and the options that were given.

    `options`: by their names in `stack`, as JSON has them. `where`: what errors call the job.
    """

    layers: tuple[LayerSpec, ...]
    output: str
    options: Mapping[str, Any]
    where: str = "job"

    @property
    def inputs(self) -> list[str]:
        """The files that it reads, each once."""
        return list(dict.fromkeys(layer.path for layer in self.layers))

    @property
    def outputs(self) -> list[str]:
        """The files that it writes, the picture first."""
        reports = self.options.get("report") or []
        provenance = self.options.get("provenance")
        return [
            self.output,
            *([reports] if isinstance(reports, str) else reports),
            *([provenance] if provenance else []),
        ]

    def document(self) -> dict[str, Any]:
        """The job as the schema has it: equal jobs give equal documents."""
        return {
            "layers": [_layer_document(layer) for layer in self.layers],
            "output": self.output,
            **self.options,
        }


def _layer_document(layer: LayerSpec) -> dict[str, Any]:
    return {
        field.name: getattr(layer, field.name)
        for field in fields(layer)
        if getattr(layer, field.name) != field.default
    }


# --- what a job can hold --------------------------------------------------------------------------

#: Of each kind of value: what errors call it, and whether a value is one.
_KINDS: dict[Any, tuple[str, Callable[[Any], bool]]] = {
    str: ("a text", lambda value: isinstance(value, str)),
    int: ("a whole number", lambda value: type(value) is int),
    float: ("a number", lambda value: type(value) in (int, float)),
    bool: ("true or false", lambda value: type(value) is bool),
    NoneType: ("null", lambda value: value is None),
}


@cache
def job_options() -> dict[str, Any]:
    """The options of a job: those of `stack`, each with the type of its parameter."""
    hints = typing.get_type_hints(stack)
    return {
        name: hints[name] for name in inspect.signature(stack).parameters if name not in _NO_OPTIONS
    }


@cache
def _layer_keys() -> dict[str, Any]:
    return {**typing.get_type_hints(LayerSpec), "part": str | int | None}


def _kinds(hint: Any) -> list[Any]:
    """The kinds of values that a type hint allows; a list is the list of its items' kinds."""
    if typing.get_origin(hint) is Sequence:
        return [_kinds(typing.get_args(hint)[0])]
    if typing.get_args(hint) and typing.get_origin(hint) is not os.PathLike:
        return [kind for inner in typing.get_args(hint) for kind in _kinds(inner)]
    # A path or a window is a text in a file.
    return [hint if hint in _KINDS else str]


def _is(kind: Any, value: Any) -> bool:
    if isinstance(kind, list):
        return isinstance(value, list) and all(any(_is(k, v) for k in kind) for v in value)
    return _KINDS[kind][1](value)


def _in_words(kinds: Sequence[Any]) -> str:
    words = {
        f"a list, each {_in_words(kind)}" if isinstance(kind, list) else _KINDS[kind][0]
        for kind in kinds
        if kind is not NoneType
    }
    return " or ".join(sorted(words, key=len))


def _plain(value: Any) -> Any:
    """A value of Python as JSON has it."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Window):
        return str(value)
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def _checked(key: str, value: Any, hint: Any) -> Any:
    value, kinds = _plain(value), _kinds(hint)
    if not any(_is(kind, value) for kind in kinds):
        raise SettingError(
            f"{key} is {json.dumps(value, default=str)}: it takes {_in_words(kinds)}"
        )
    return value


class _MisplacedError(SettingError):
    """A wrong key or value, with the table that it stands in."""

    def __init__(self, problem: str, table: object, key: str) -> None:
        super().__init__(problem)
        self.table, self.key = table, key


def _checked_table(table: Mapping[str, Any], hints: Mapping[str, Any], kind: str) -> dict[str, Any]:
    """The table with every key and the type of its value checked."""
    found = {}
    for key, value in table.items():
        try:
            if key not in hints:
                raise unknown_key(kind, key, hints)
            found[key] = _checked(key, value, hints[key])
        except SettingError as problem:
            raise _MisplacedError(str(problem), table, key) from None
    return found


def _layer(number: int, layer: Any, table: Mapping[str, Any]) -> LayerSpec:
    try:
        if not isinstance(layer, Mapping):
            if not isinstance(layer, (str, os.PathLike, LayerSpec)):
                raise SettingError("it is neither a LAYER text nor a table of settings")
            spec = layer_spec(layer)
        elif "path" not in layer:
            raise SettingError("it has no path")
        else:
            settings = _checked_table(layer, _layer_keys(), "key of a layer")
            if isinstance(settings.get("part"), int):
                settings["part"] = str(settings["part"])
            spec = LayerSpec(**settings)
        if spec.path == STDIN:
            raise SettingError("a job cannot read stdin: name a file")
        return spec
    except _MisplacedError as problem:
        raise _MisplacedError(f"layer {number}: {problem}", problem.table, problem.key) from None
    except SettingError as problem:
        raise _MisplacedError(f"layer {number}: {problem}", table, "layers") from None


def _job(table: Any, defaults: Mapping[str, Any], where: str) -> Job:
    if not isinstance(table, Mapping):
        raise SettingError(f"it is no table of layers, output and options, but {json.dumps(table)}")
    for key in ("layers", "output"):
        if key not in table:
            raise SettingError(f"it has no {key}")
    layers = table["layers"]
    if isinstance(layers, (str, os.PathLike)) or not isinstance(layers, Sequence) or not layers:
        raise _MisplacedError("layers is not a list of at least one LAYER", table, "layers")
    hints = {"version": int, "layers": Sequence[Any], "output": str, **job_options()}
    own = {key: value for key, value in table.items() if key != "layers"}
    try:
        own = _checked_table(own, hints, "key of a job")
    except _MisplacedError as problem:
        raise _MisplacedError(str(problem), table, problem.key) from None
    _check_version(own.pop("version", SCHEMA_VERSION), table)
    output = own.pop("output")
    if output == STDIN:
        raise _MisplacedError("a job cannot write to stdout: name a file", table, "output")
    specs = tuple(_layer(number, layer, table) for number, layer in enumerate(layers))
    return Job(specs, output, {**defaults, **own}, where)


def _check_version(version: Any, table: object) -> None:
    if version != SCHEMA_VERSION or type(version) is not int:
        raise _MisplacedError(
            f"version {json.dumps(version)} of the schema is not known: this hpcomp reads "
            f"version {SCHEMA_VERSION}",
            table,
            "version",
        )


def jobs_of(tables: Sequence[Mapping[str, Any] | Job]) -> list[Job]:
    """Jobs from tables such as `{"layers": [LAYER, …], "output": PATH}`, or as they are.

    Errors: `SettingError` names the job, counted from 1.
    """
    found = []
    for number, table in enumerate(tables, 1):
        if isinstance(table, Job):
            found.append(table)
            continue
        try:
            found.append(_job(table, {}, f"job {number}"))
        except SettingError as problem:
            raise SettingError(f"job {number}: {problem}") from None
    return found


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
    found = list(reader(label, text))
    if not found:
        raise SettingError(f"{label}: there are no jobs in it")
    return found


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
    label: str, document: Any, line_of: Callable[[object, str], int | None]
) -> Iterator[Job]:
    """The jobs of a whole document: a table with `jobs`, a list of jobs, or one job."""

    def refused(problem: SettingError, what: str = "") -> SettingError:
        line = line_of(problem.table, problem.key) if isinstance(problem, _MisplacedError) else None
        return SettingError(f"{label}{f':{line}' if line else ''}: {what}{problem}")

    if isinstance(document, Mapping) and ("layers" in document or "output" in document):
        document = [document]
    defaults: dict[str, Any] = {}
    if isinstance(document, Mapping):
        try:
            for key in document:
                if key not in _DOCUMENT_KEYS:
                    raise _MisplacedError(
                        str(unknown_key("key of a job file", key, _DOCUMENT_KEYS)), document, key
                    )
            _check_version(document.get("version", SCHEMA_VERSION), document)
            defaults = _defaults(document)
            tables = document.get("jobs", [])
            if not isinstance(tables, list):
                raise _MisplacedError("jobs is not a list of tables", document, "jobs")
        except SettingError as problem:
            raise refused(problem) from None
    elif isinstance(document, list):
        tables = document
    else:
        raise SettingError(f"{label}: holds neither jobs nor a job")
    for number, table in enumerate(tables, 1):
        try:
            yield _job(table, defaults, f"{label}: job {number}")
        except SettingError as problem:
            raise refused(problem, f"job {number}: ") from None


def _defaults(document: Mapping[str, Any]) -> dict[str, Any]:
    """The options for all jobs of a document."""
    defaults = document.get("defaults", {})
    if not isinstance(defaults, Mapping):
        raise _MisplacedError("defaults is not a table of options", document, "defaults")
    try:
        return _checked_table(defaults, job_options(), "option for all jobs")
    except _MisplacedError as problem:
        raise _MisplacedError(f"defaults: {problem}", problem.table, problem.key) from None


def _toml(label: str, text: str) -> Iterator[Job]:
    import tomllib

    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as reason:
        raise InputError(f"{label}: is not TOML: {reason}") from None
    yield from _document_jobs(label, document, _Lines(text, document, _toml_keys).line_of)


def _json(label: str, text: str) -> Iterator[Job]:
    document = _parsed_json(label, 1, text)
    yield from _document_jobs(label, document, _Lines(text, document, _json_keys).line_of)


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


def _no_key_twice(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise SettingError(f"key '{key}' stands twice in one table")
        found[key] = value
    return found


def _jsonl(label: str, text: str) -> Iterator[Job]:
    """A job a line; a first line without layers may give the version and defaults."""
    defaults: dict[str, Any] = {}
    number = 0
    for line_number, line in enumerate(text.split("\n"), 1):
        if not line.strip():
            continue
        table = _parsed_json(label, line_number, line)
        try:
            if number == 0 and isinstance(table, dict) and table.keys() <= {"version", "defaults"}:
                _check_version(table.get("version", SCHEMA_VERSION), table)
                defaults = _defaults(table)
                continue
            number += 1
            yield _job(table, defaults, f"{label}:{line_number}")
        except SettingError as problem:
            raise SettingError(f"{label}:{line_number}: {problem}") from None


#: The column of a layer, which may stand several times.
_LAYER_COLUMN = "layer"


def _csv(label: str, text: str) -> Iterator[Job]:
    """A job a row: columns `output`, `layer` as often as needed, options; empty: not given."""
    rows = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        head = [name.strip() for name in next(rows, [])]
        hints = {"output": str, "version": int, **job_options()}
        for name in head:
            if name not in hints and name != _LAYER_COLUMN:
                raise SettingError(
                    f"{label}:1: {unknown_key('column', name, [_LAYER_COLUMN, *hints])}"
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
                yield _job(table, {}, f"{label}:{line}")
            except SettingError as problem:
                raise SettingError(f"{label}:{line}: {problem}") from None
    except csv.Error as reason:
        raise InputError(f"{label}:{rows.line_num}: is not CSV: {reason}") from None


_TRUTHS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


def _from_text(name: str, text: str, hint: Any) -> Any:
    """What a cell of text means for an option; what takes a text is left to `stack` to parse."""
    kinds = _kinds(hint)
    if str in kinds:
        return text
    try:
        if bool in kinds:
            return _TRUTHS[text.lower()]
        return int(text) if int in kinds else float(text)
    except (KeyError, ValueError):
        raise SettingError(f"{name} is '{text}': it takes {_in_words(kinds)}") from None


#: The formats of a job file, each with its reader.
FORMATS: dict[str, Callable[[str, str], Iterator[Job]]] = {
    "toml": _toml,
    "json": _json,
    "jsonl": _jsonl,
    "csv": _csv,
}
_OTHER_ENDINGS = {"ndjson": "jsonl"}


# --- lines ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Lines:
    """Where the keys of a parsed document stand in its text, which the parsers do not tell."""

    text: str
    document: Any
    keys: Callable[[str], Iterator[tuple[str, int]]]

    def line_of(self, table: object, key: str) -> int | None:
        """The line of `key` in `table` of the document; None where the text does not show it.

        Tables are in the order of the text, so the same number of such keys comes before it.
        """
        before = 0
        for found, name in _walk(self.document):
            if name == key:
                if found is table:
                    break
                before += 1
        positions = [position for name, position in self.keys(self.text) if name == key]
        if before >= len(positions):
            return None
        return self.text.count("\n", 0, positions[before]) + 1


def _walk(value: Any) -> Iterator[tuple[object, str]]:
    """(table, key) of every key in a document, in the order of the text."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield value, key
            yield from _walk(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _walk(inner)


_JSON_TEXT = re.compile(r'("(?:\\.|[^"\\])*")(\s*:)?')


def _json_keys(text: str) -> Iterator[tuple[str, int]]:
    for match in _JSON_TEXT.finditer(text):
        if match[2]:
            yield json.loads(match[1]), match.start()


# Strings and comments are passed over whole, so that nothing in them is taken for a key.
_TOML_WORD = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|#[^\n]*'
    r'|(?P<name>"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|[\w-]+)(?P<after>[ \t]*[.=\]])?',
    re.DOTALL,
)
_TOML_HEAD = re.compile(r"\s*\[[^\]=]*")


def _toml_keys(text: str) -> Iterator[tuple[str, int]]:
    for match in _TOML_WORD.finditer(text):
        if not match["after"]:
            continue
        head = _TOML_HEAD.fullmatch(text, text.rfind("\n", 0, match.start()) + 1, match.start())
        if head or match["after"].strip() == "=":
            yield match["name"].strip("\"'"), match.start()


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
    try:
        if ending == ".json":
            document = {"version": SCHEMA_VERSION, "jobs": [job.document() for job in jobs]}
            with whole_output(path, clobber=clobber) as target, open(target, "w") as file:
                file.write(json.dumps(document, indent=2) + "\n")
            return
        lines = [json.dumps({"version": SCHEMA_VERSION, **job.document()}) for job in jobs]
        with open(path, "ab", buffering=0) as log:
            # At once, so that lines of several commands do not mix.
            log.write("".join(f"{line}\n" for line in lines).encode())
    except OSError as reason:
        raise OutputError(f"{path}: cannot be written: {why(reason)}") from None


def job_of_stack(layers: Sequence[Any], output: str, options: Mapping[str, Any]) -> Job:
    """The job of a call of `stack`, with those of its options that are not as they are anyway."""
    defaults = inspect.signature(stack).parameters
    given = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in options.items()
        if name in job_options() and value != defaults[name].default
    }
    return _job({"layers": list(layers), "output": output, **given}, {}, "job")
