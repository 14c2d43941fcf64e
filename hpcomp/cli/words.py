"""What a shell is offered for values: files of a kind, keys and values of a LAYER, names of tables.

What it takes to know them is imported while a shell completes, and not where a command runs.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from ..errors import HpcompError, unknown_name
from .signals import load

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    _Choice = click.Choice[str]
else:
    _Choice = click.Choice  # which click before 8.2 cannot be asked what it is of

#: What a command offers for a value, knowing what stands on the line already.
Offer = Callable[[click.Context], Iterable[str]]

#: The endings of files that commands read and write.
PICTURES = (".png", ".exr")
JOBS = (".toml", ".json", ".jsonl", ".ndjson", ".csv")


def _items(words: Iterable[str], begin: str) -> list[CompletionItem[str]]:
    from click.shell_completion import CompletionItem

    return [CompletionItem(word) for word in words if word.startswith(begin)]


class Choice(_Choice):
    """Names to choose from, one of which is asked for where another was given.

    `noun`: what errors call what is chosen. `offered`: which of them a shell is offered, if
    not all.
    """

    def __init__(self, names: Iterable[str], noun: str, offered: Offer | None = None) -> None:
        super().__init__(tuple(names))
        self.noun, self.offered = noun, offered

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if value not in self.choices:
            self.fail(str(unknown_name(self.noun, value, self.choices)), param, ctx)
        return str(value)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem[str]]:
        return _items(self.offered(ctx) if self.offered else self.choices, incomplete)


class Text(click.types.StringParamType):
    """Any text, for which a shell is offered names."""

    def __init__(self, offered: Offer) -> None:
        self.offered = offered

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem[str]]:
        return _items(self.offered(ctx), incomplete)


class File(click.Path):
    """The name of a file, of which a shell is offered those with one of these endings."""

    def __init__(self, *endings: str) -> None:
        super().__init__(readable=False)
        self.endings = endings

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem[str]]:
        return _items(files(incomplete, self.endings), "")


class Layer(File):
    """A LAYER, of which a shell is offered files, and behind `::` keys and their values.

    `without`: keys that mean nothing here.
    """

    def __init__(self, *without: str) -> None:
        super().__init__(*PICTURES)
        self.without = without

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem[str]]:
        path, separator, settings = incomplete.rpartition("::")
        if not separator:
            return super().shell_complete(ctx, param, incomplete)
        return _items(_settings(path, settings, self.without), incomplete)


def files(begin: str, endings: Sequence[str] = ()) -> list[str]:
    """Folders and files whose names begin so; hidden ones where that begins with a dot.

    The files that hpcomp hides itself are never among them.
    """
    folder, name = os.path.split(begin)
    found = []
    with contextlib.suppress(OSError), os.scandir(os.path.expanduser(folder) or ".") as entries:
        for entry in entries:
            if not entry.name.startswith(name) or (entry.name.startswith(".") and not name):
                continue
            if entry.name.startswith(".hpcomp.") or ".hpcomp-state" in entry.name:
                continue
            if not entry.name.isprintable():  # a shell reads lines of text
                continue
            if entry.is_dir():
                found.append(f"{os.path.join(folder, entry.name)}/")
            elif not endings or entry.name.lower().endswith(tuple(endings)):
                found.append(os.path.join(folder, entry.name))
    return found


def _settings(path: str, settings: str, without: Sequence[str]) -> Iterator[str]:
    """Whole LAYERs that go on from the last key or value."""
    layers = load("hpcomp.layers.layerspec")
    done, comma, last = settings.rpartition(",")
    key, equals, _ = last.partition("=")
    if equals:
        for value in _values(path, key):
            yield f"{path}::{done}{comma}{key}={value}"
        return
    given = [setting.partition("=")[0] for setting in done.split(",")]
    for key in layers.LAYER_KEYS:
        if key not in given and key not in without:
            yield f"{path}::{done}{comma}{key}="


def _values(path: str, key: str) -> Iterable[str]:
    """The values of a key that have names: of a table, or in the file."""
    if key == "tint":
        return color_names()
    if key in ("part", "layer"):
        return [name for name in _in_file(path, key) if name.isprintable() and "," not in name]
    names: Iterable[str] = load("hpcomp.layers.layerspec").LAYER_NAMES.get(key, ())
    return names


def _in_file(path: str, key: str) -> Iterable[str]:
    """The parts or layers that a file has; of a pipe or a terminal nothing is asked."""
    if not os.path.isfile(path):
        return ()
    try:
        parts = load("hpcomp.imagefile.description").describe(path).parts
    except HpcompError:
        return ()
    if key == "part":
        return [part.name or str(part.index) for part in parts] if len(parts) > 1 else ()
    return {group.layer for part in parts for group in part.groups if group.layer}


def color_names(ctx: click.Context | None = None) -> Iterable[str]:
    """The names of CSS colours."""
    names: Iterable[str] = load("hpcomp.color.css").css_names()
    return names


def of_output(table: Mapping[str, Iterable[str]]) -> Offer:
    """What a table has for the format of the output, if that is known, else for all formats."""

    def offer(ctx: click.Context) -> Iterable[str]:
        try:
            given = ctx.params.get("output") or "", ctx.params.get("format")
            return table[load("hpcomp.imagefile.writing").format_of_output(*given)]
        except HpcompError:
            return {name for names in table.values() for name in names}

    return offer
