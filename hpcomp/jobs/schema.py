"""What a job is: `{"layers": [LAYER, …], "output": PATH}` and options of `stack`, as a table.

The names of the options, and what they take, are those of `options`. Reads no file.
"""

from __future__ import annotations

import json
import os
import re
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from types import NoneType, UnionType
from typing import Annotated, Any, Required, TypedDict

import msgspec

from ..blending.orders import order
from ..blending.porter_duff import OPERATOR_NAMES
from ..color.encodings import ALPHA_MODES, COLOR_INTEROP_IDS, COLOR_SPACES
from ..errors import SettingError, unknown_name
from ..geometry import Window
from ..imagefile.writing import OutputForm, format_of_output
from ..layers.layerspec import LayerSpec, layer_spec
from ..options import OPTIONS, PRESET_OPTIONS, NamedOption, StackOptions
from ..system.streams import STDIN, STDOUT

#: The version of the schema that is read and written.
SCHEMA_VERSION = 1


@dataclass(frozen=True, slots=True)  # there may be 100,000
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

#: Of each kind of value what errors call it.
_WORDS = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    NoneType: "null",
}


def _written(hint: Any) -> Any:
    """The type of a value as JSON has it: a path or a window is a text, a sequence is a list."""
    inner = typing.get_args(hint)
    if typing.get_origin(hint) is Sequence:
        return list[_written(inner[0])]  # type: ignore[misc]
    if inner and typing.get_origin(hint) is not os.PathLike:
        return typing.Union[tuple(map(_written, inner))]  # noqa: UP007
    return hint if hint in _WORDS else str


def _kinds(written: Any) -> tuple[Any, ...]:
    """The types that a union has, or the one type."""
    is_union = typing.get_origin(written) in (typing.Union, UnionType)
    return typing.get_args(written) if is_union else (written,)


def takes_text(written: Any) -> bool:
    """Whether a value of that type may be any text."""
    return str in _kinds(written)


def in_words(written: Any) -> str:
    """What errors say of a type."""
    words = {
        f"a list, each {in_words(typing.get_args(kind)[0])}"
        if typing.get_origin(kind) is list
        else _WORDS[kind]
        for kind in _kinds(written)
        if kind is not NoneType
    }
    return " or ".join(sorted(words, key=len))


def _option_schema(row: NamedOption) -> dict[str, Any]:
    """What editors show of an option, and the values that they complete."""
    default = list(row.default) if isinstance(row.default, tuple) else row.default
    shown: dict[str, Any] = {"description": row.option.help, "default": default}
    if row.option.choices:
        written = _written(row.hint)
        numbers = [int(n) for n in row.option.choices if n.isdecimal() and int in _kinds(written)]
        null = [None] if NoneType in _kinds(written) else []
        shown["enum"] = [*row.option.choices, *numbers, *null]
    if row.option.least is not None:
        shown["minimum"] = row.option.least
    return shown


#: The options of a job: each with the type of its value as JSON has it.
JOB_OPTIONS: dict[str, Any] = {name: _written(row.hint) for name, row in OPTIONS.items()}

#: The keys of a layer: the type of each, what it does, and what else the schema shows.
_LAYER_ROWS: dict[str, tuple[Any, str, dict[str, Any]]] = {
    "path": (str, "The file.", {}),
    "op": (str | None, "Operator of a layer above the bottom one; that of the stack if not given.",
           {"enum": [*OPERATOR_NAMES, None]}),
    "opacity": (float, "Scales the layer's colour and alpha.",
                {"minimum": 0, "maximum": 1, "default": LayerSpec.opacity}),
    "at": (str | None, "Its place: +X+Y, or a gravity such as center or south+0-10.", {}),
    "alpha": (str | None, "What the alpha says of the colours; luminance makes it from them.",
              {"enum": [*ALPHA_MODES, None]}),
    "colorspace": (str | None, "The encoding, instead of what the file says.",
                   {"enum": [*COLOR_SPACES, *COLOR_INTEROP_IDS, None]}),
    "tint": (str | None, "The CSS colour of a grey mask, whose values become the alpha.", {}),
    "part": (str | int | None, "A part of a multi-part EXR, by name or index.", {}),
    "layer": (str | None, "Channels NAME.R, NAME.G, NAME.B, NAME.A of an EXR.", {}),
    "name": (str | None, "What messages call the layer.", {}),
}  # fmt: skip
_LAYER_KEYS = {key: written for key, (written, *_) in _LAYER_ROWS.items()}


# --- its types, for msgspec -----------------------------------------------------------------------


def _shown(written: Any, schema: Mapping[str, Any]) -> Any:
    return Annotated[written, msgspec.Meta(extra_json_schema=dict(schema))]


def _table(name: str, keys: Mapping[str, Any], *required: str) -> Any:
    typed: Any = TypedDict  # type checkers know only what is written out
    kinds = {key: Required[kind] if key in required else kind for key, kind in keys.items()}
    return typed(name, kinds, total=False)


_OPTION_KINDS = {
    name: _shown(JOB_OPTIONS[name], _option_schema(row)) for name, row in OPTIONS.items()
}
_VERSION_KIND = {"version": _shown(int, {"const": SCHEMA_VERSION})}
_LAYER = _table(
    "layer",
    {
        key: _shown(written, {"description": text, **more})
        for key, (written, text, more) in _LAYER_ROWS.items()
    },
    "path",
)
_LAYERS: Any = list[str | _LAYER]  # type: ignore[valid-type]
_JOB = _table(
    "job",
    {
        **_VERSION_KIND,
        "layers": Annotated[_LAYERS, msgspec.Meta(min_length=1)],
        "output": _shown(str, {"description": "The picture to write."}),
        **_OPTION_KINDS,
    },
    "layers",
    "output",
)
_DEFAULTS = _table("defaults", _OPTION_KINDS)
_JOBS: Any = list[_JOB]  # type: ignore[valid-type]
_DOCUMENT = _table("document", {**_VERSION_KIND, "defaults": _DEFAULTS, "jobs": _JOBS}, "jobs")
_DOCUMENTS = (_DOCUMENT, _JOBS, _JOB)

_decode_job = msgspec.json.Decoder(_JOB).decode
_decode_documents = [msgspec.json.Decoder(kind).decode for kind in _DOCUMENTS]
#: At least every key of a JSON text.
_JSON_KEY = re.compile(r'"\s*:')


def decoded_job(text: str) -> Any:
    """A job in JSON, with the types of its values checked; None where it says something else."""
    return _decoded(text, [_decode_job])


def decoded_document(text: str) -> Any:
    """Likewise a document of jobs."""
    return _decoded(text, _decode_documents)


def _decoded(text: str, decoders: Sequence[Callable[[str], Any]]) -> Any:
    for decode in decoders:
        try:
            document = decode(text)
        except (msgspec.MsgspecError, RecursionError):
            continue
        # Keys that are not known, and all but the last that stand twice, are left out unsaid.
        return document if _n_keys(document) == len(_JSON_KEY.findall(text)) else None
    return None


def _n_keys(value: Any) -> int:
    if isinstance(value, dict):
        return len(value) + sum(map(_n_keys, value.values()))
    return sum(map(_n_keys, value)) if isinstance(value, list) else 0


# --- checking it ----------------------------------------------------------------------------------


def _plain(value: Any) -> Any:
    """A value of Python as JSON has it."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Window):
        return str(value)
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def _checked(key: str, value: Any, written: Any) -> Any:
    value = _plain(value)
    try:
        return msgspec.convert(value, written)
    except msgspec.ValidationError:
        raise SettingError(
            f"{key} is {json.dumps(value, default=str)}: it takes {in_words(written)}"
        ) from None


class MisplacedError(SettingError):
    """A wrong key or value, with the table that it stands in."""

    def __init__(self, problem: str, table: object, key: str) -> None:
        super().__init__(problem)
        self.table, self.key = table, key


def checked_table(table: Mapping[str, Any], keys: Mapping[str, Any], kind: str) -> dict[str, Any]:
    """The table with every key and the type of its value checked."""
    checked = {}
    for key, value in table.items():
        try:
            if key not in keys:
                raise unknown_name(kind, key, keys)
            checked[key] = _checked(key, value, keys[key])
        except SettingError as problem:
            raise MisplacedError(str(problem), table, key) from None
    return checked


def _layer(number: int, layer: Any, table: Mapping[str, Any], typed: bool) -> LayerSpec:
    try:
        if not isinstance(layer, Mapping):
            if not isinstance(layer, (str, os.PathLike, LayerSpec)):
                raise SettingError("it is neither a LAYER text nor a table of settings")
            spec = _text_layer(layer) if isinstance(layer, str) else layer_spec(layer)
        elif "path" not in layer:
            raise SettingError("it has no path")
        else:
            settings = dict(layer) if typed else checked_table(layer, _LAYER_KEYS, "key of a layer")
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


@lru_cache(maxsize=1024)  # jobs share layers, and then one object
def _text_layer(text: str) -> LayerSpec:
    return layer_spec(text)


def checked_job(table: Any, defaults: Mapping[str, Any], where: str, *, typed: bool = False) -> Job:
    """The job of a table; `typed`: its keys and the types of their values are checked already.

    Errors: `SettingError`, as a `MisplacedError` where it has a place in the table.
    """
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
    own = {key: value for key, value in table.items() if key != "layers"}
    if not typed:
        keys = {"version": int, "layers": list[Any], "output": str, **JOB_OPTIONS}
        try:
            own = checked_table(own, keys, "key of a job")
        except MisplacedError as problem:
            raise MisplacedError(str(problem), table, problem.key) from None
    check_version(own.pop("version", SCHEMA_VERSION), table)
    output = own.pop("output")
    _check_values(own, table)
    specs = tuple(_layer(number, layer, table, typed) for number, layer in enumerate(layers))
    job = Job(specs, output, {**defaults, **own}, where)
    _check_together(job, table)
    for path in job.outputs:
        if path == STDOUT:
            raise MisplacedError("a job cannot write to stdout: name a file", table, "output")
        _check_path(path, table, "output")
    return job


def _check_values(options: Mapping[str, Any], table: Mapping[str, Any]) -> None:
    """Refuses what an option does not take, before any job is begun."""
    for name, value in options.items():
        try:
            _check_value(name, tuple(value) if isinstance(value, list) else value)
        except SettingError as problem:
            raise MisplacedError(_with_key(name, problem), table, name) from None


def _with_key(name: str, problem: SettingError) -> str:
    """What is wrong with an option, whose name stands in it."""
    said = str(problem)
    return said if name.replace("_", " ") in said else f"{name}: {said}"


@lru_cache(maxsize=1024, typed=True)  # jobs by the thousand have the same few
def _check_value(name: str, value: Any) -> None:
    StackOptions.of({name: value})


def _check_together(job: Job, table: Mapping[str, Any]) -> None:
    """Refuses an output of no format, what its format has not, and an order of other layers."""
    options, key = job.options, "output"
    try:
        form = format_of_output(job.output, options.get("format"))
        for key in ("depth", "compression", "out_primaries"):
            if options.get(key) is not None:
                OutputForm.checked(form, **{key: options[key]})
        key = "order"
        if options.get(key) is not None:
            order(options[key], len(job.layers))
    except SettingError as problem:
        raise MisplacedError(_with_key(key, problem), table, key) from None


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
        checked = checked_table(defaults, JOB_OPTIONS, "option for all jobs")
        _check_values(checked, defaults)
        return checked
    except MisplacedError as problem:
        raise MisplacedError(f"defaults: {problem}", problem.table, problem.key) from None


def json_schema() -> dict[str, Any]:
    """What job files may say, as a JSON Schema (2020-12) of the whole document."""
    kinds, parts = msgspec.json.schema_components(_DOCUMENTS, ref_template="#/$defs/{name}")
    for table in parts.values():
        table["additionalProperties"] = False
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"Jobs of hpcomp batch, version {SCHEMA_VERSION}",
        "anyOf": list(kinds),
        "$defs": parts,
    }


def jobs_of(tables: Sequence[Mapping[str, Any] | Job]) -> list[Job]:
    """Jobs from tables such as `{"layers": [LAYER, …], "output": PATH}`, or as they are.

    Errors: `SettingError` names the job, counted from 1.
    """
    jobs = []
    for number, table in enumerate(tables, 1):
        if isinstance(table, Job):
            jobs.append(table)
            continue
        try:
            jobs.append(checked_job(table, {}, f"job {number}"))
        except SettingError as problem:
            raise SettingError(f"job {number}: {problem}") from None
    return jobs


def job_of_stack(layers: Sequence[Any], output: str, options: Mapping[str, Any]) -> Job:
    """The job of a call of `stack`, with those of its options that are not as they are anyway."""
    beside_preset = PRESET_OPTIONS if options.get("preset") is not None else ()
    given = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in options.items()
        if name in beside_preset or (name in OPTIONS and value != OPTIONS[name].default)
    }
    return checked_job({"layers": list(layers), "output": output, **given}, {}, "job")
