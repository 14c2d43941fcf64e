"""What a job is: `{"layers": [LAYER, …], "output": PATH}` and options of `stack`, as a table.

The names of the options, and what they take, are those of `options`. Reads no file.
"""

from __future__ import annotations

import json
import os
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from types import NoneType
from typing import Any

from ..errors import SettingError, unknown_key
from ..geometry import Window
from ..layers.layerspec import LayerSpec, layer_spec
from ..options import OPTIONS
from ..system.streams import STDIN, STDOUT

#: The version of the schema that is read and written.
SCHEMA_VERSION = 1
#: What a job has beside the options of `stack`.
_OWN_KEYS = ("version", "layers", "output")


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
        others = [self.options.get(name) for name in ("provenance", "depfile")]
        return [
            self.output,
            *([reports] if isinstance(reports, str) else reports),
            *(path for path in others if path),
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

#: Of each kind of value: what errors call it, whether a value is one, and how JSON Schema says it.
_KINDS: dict[Any, tuple[str, Callable[[Any], bool], dict[str, str]]] = {
    str: ("a text", lambda value: isinstance(value, str), {"type": "string"}),
    int: ("a whole number", lambda value: type(value) is int, {"type": "integer"}),
    float: ("a number", lambda value: type(value) in (int, float), {"type": "number"}),
    bool: ("true or false", lambda value: type(value) is bool, {"type": "boolean"}),
    NoneType: ("null", lambda value: value is None, {"type": "null"}),
}


@cache
def job_options() -> dict[str, Any]:
    """The options of a job: those of `stack`, each with the type of its value."""
    return {name: row.hint for name, row in OPTIONS.items()}


@cache
def _layer_keys() -> dict[str, Any]:
    return {**typing.get_type_hints(LayerSpec), "part": str | int | None}


def kinds_of(hint: Any) -> list[Any]:
    """The kinds of values that a type hint allows; a list is the list of its items' kinds."""
    if typing.get_origin(hint) is Sequence:
        return [kinds_of(typing.get_args(hint)[0])]
    if typing.get_args(hint) and typing.get_origin(hint) is not os.PathLike:
        return [kind for inner in typing.get_args(hint) for kind in kinds_of(inner)]
    # A path or a window is a text in a file.
    return [hint if hint in _KINDS else str]


def _is(kind: Any, value: Any) -> bool:
    if isinstance(kind, list):
        return isinstance(value, list) and all(any(_is(k, v) for k in kind) for v in value)
    return _KINDS[kind][1](value)


def in_words(kinds: Sequence[Any]) -> str:
    words = {
        f"a list, each {in_words(kind)}" if isinstance(kind, list) else _KINDS[kind][0]
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
    value, kinds = _plain(value), kinds_of(hint)
    if not any(_is(kind, value) for kind in kinds):
        raise SettingError(f"{key} is {json.dumps(value, default=str)}: it takes {in_words(kinds)}")
    return value


class MisplacedError(SettingError):
    """A wrong key or value, with the table that it stands in."""

    def __init__(self, problem: str, table: object, key: str) -> None:
        super().__init__(problem)
        self.table, self.key = table, key


def checked_table(table: Mapping[str, Any], hints: Mapping[str, Any], kind: str) -> dict[str, Any]:
    """The table with every key and the type of its value checked."""
    found = {}
    for key, value in table.items():
        try:
            if key not in hints:
                raise unknown_key(kind, key, hints)
            found[key] = _checked(key, value, hints[key])
        except SettingError as problem:
            raise MisplacedError(str(problem), table, key) from None
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
            settings = checked_table(layer, _layer_keys(), "key of a layer")
            if isinstance(settings.get("part"), int):
                settings["part"] = str(settings["part"])
            spec = LayerSpec(**settings)
        if spec.path == STDIN:
            raise SettingError("a job cannot read stdin: name a file")
        _check_path(spec.path, table, "layers")
        return spec
    except MisplacedError as problem:
        raise MisplacedError(f"layer {number}: {problem}", problem.table, problem.key) from None
    except SettingError as problem:
        raise MisplacedError(f"layer {number}: {problem}", table, "layers") from None


def checked_job(table: Any, defaults: Mapping[str, Any], where: str) -> Job:
    if not isinstance(table, Mapping):
        raise SettingError(
            f"it is no table of layers, output and options, but {json.dumps(table, default=str)}"
        )
    for key in ("layers", "output"):
        if key not in table:
            raise SettingError(f"it has no {key}")
    layers = table["layers"]
    if isinstance(layers, (str, os.PathLike)) or not isinstance(layers, Sequence) or not layers:
        raise MisplacedError("layers is not a list of at least one LAYER", table, "layers")
    hints = {"version": int, "layers": Sequence[Any], "output": str, **job_options()}
    own = {key: value for key, value in table.items() if key != "layers"}
    try:
        own = checked_table(own, hints, "key of a job")
    except MisplacedError as problem:
        raise MisplacedError(str(problem), table, problem.key) from None
    check_version(own.pop("version", SCHEMA_VERSION), table)
    output = own.pop("output")
    specs = tuple(_layer(number, layer, table) for number, layer in enumerate(layers))
    job = Job(specs, output, {**defaults, **own}, where)
    for path in job.outputs:
        if path == STDOUT:
            raise MisplacedError("a job cannot write to stdout: name a file", table, "output")
        _check_path(path, table, "output")
    return job


def _check_path(path: str, table: object, key: str) -> None:
    """Refuses what no file can be called."""
    try:
        possible = b"\0" not in os.fsencode(path)
    except UnicodeEncodeError:
        possible = False
    if not possible:
        raise MisplacedError(f"{path!a} is no name of a file", table, key)


def check_version(version: Any, table: object) -> None:
    if version != SCHEMA_VERSION or type(version) is not int:
        raise MisplacedError(
            f"version {json.dumps(version)} of the schema is not known: this hpcomp reads "
            f"version {SCHEMA_VERSION}",
            table,
            "version",
        )


def checked_defaults(document: Mapping[str, Any]) -> dict[str, Any]:
    """The options for all jobs of a document."""
    defaults = document.get("defaults", {})
    if not isinstance(defaults, Mapping):
        raise MisplacedError("defaults is not a table of options", document, "defaults")
    try:
        return checked_table(defaults, job_options(), "option for all jobs")
    except MisplacedError as problem:
        raise MisplacedError(f"defaults: {problem}", problem.table, problem.key) from None


def json_schema() -> dict[str, Any]:
    """What job files may say, as a JSON Schema (2020-12) of the whole document."""

    def table(keys: Mapping[str, Any], required: Sequence[str] = ()) -> dict[str, Any]:
        return {
            "type": "object",
            "properties": {key: _json_type(kinds_of(hint)) for key, hint in keys.items()},
            "required": list(required),
            "additionalProperties": False,
        }

    version = {"const": SCHEMA_VERSION}
    layer = {"anyOf": [{"type": "string"}, table(_layer_keys(), ["path"])]}
    job = table({"version": int, "output": str, **job_options()}, ["layers", "output"])
    job["properties"] |= {
        "version": version,
        "layers": {"type": "array", "items": {"$ref": "#/$defs/layer"}, "minItems": 1},
    }
    jobs = {"type": "array", "items": {"$ref": "#/$defs/job"}}
    document = table({})
    document["properties"] = {"version": version, "defaults": table(job_options()), "jobs": jobs}
    document["required"] = ["jobs"]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"Jobs of hpcomp batch, version {SCHEMA_VERSION}",
        "anyOf": [document, jobs, {"$ref": "#/$defs/job"}],
        "$defs": {"job": job, "layer": layer},
    }


def _json_type(kinds: Sequence[Any]) -> dict[str, Any]:
    types: list[dict[str, Any]] = []
    for kind in kinds:
        items = isinstance(kind, list)
        found = {"type": "array", "items": _json_type(kind)} if items else _KINDS[kind][2]
        if found not in types:
            types.append(found)
    return types[0] if len(types) == 1 else {"anyOf": types}


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
            found.append(checked_job(table, {}, f"job {number}"))
        except SettingError as problem:
            raise SettingError(f"job {number}: {problem}") from None
    return found


def job_of_stack(layers: Sequence[Any], output: str, options: Mapping[str, Any]) -> Job:
    """The job of a call of `stack`, with those of its options that are not as they are anyway."""
    given = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in options.items()
        if name in OPTIONS and value != OPTIONS[name].default
    }
    return checked_job({"layers": list(layers), "output": output, **given}, {}, "job")
