"""Where the keys of a TOML or JSON document stand in its text, which the parsers do not tell."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

#: A key in a text: its name, where it stands, and the table of the document that it is in.
Key = tuple[str, int, str]


@dataclass(frozen=True)
class Lines:
    """Where the keys of a parsed document stand in its text.

    `by_table`: only within each table of the document are keys in the order of the text, as in
    TOML, where tables of one list may stand apart.
    """

    text: str
    document: Any
    keys: Callable[[str], Iterator[Key]]
    by_table: bool = False

    def line_of(self, table: object, key: str) -> int | None:
        """The line of `key` in `table` of the document; None where the text does not show it.

        Before it the text has as many such keys as the document.
        """
        wanted, before = None, 0
        for top, holder, name in _walk(self.document):
            if holder is table and name == key:
                wanted = top if self.by_table else ""
                break
        for top, holder, name in _walk(self.document):
            if name == key and (not self.by_table or top == wanted):
                if holder is table:
                    break
                before += 1
        positions = [
            position
            for name, position, top in self.keys(self.text)
            if name == key and (not self.by_table or top == wanted)
        ]
        if wanted is None or before >= len(positions):
            return None
        return self.text.count("\n", 0, positions[before]) + 1


def _walk(value: Any, top: str | None = None) -> Iterator[tuple[str, object, str]]:
    """(table of the document, table, key) of every key, in the order of the text but for tables."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield key if top is None else top, value, key
            yield from _walk(inner, key if top is None else top)
    elif isinstance(value, list):
        for inner in value:
            yield from _walk(inner, "" if top is None else top)


_JSON_TEXT = re.compile(r'("(?:\\.|[^"\\])*")(\s*:)?')


def json_keys(text: str) -> Iterator[Key]:
    for match in _JSON_TEXT.finditer(text):
        if match[2]:
            yield json.loads(match[1]), match.start(), ""


# Strings and comments are passed over whole, so that nothing in them is taken for a key.
_TOML_WORD = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|#[^\n]*'
    r'|(?P<name>"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|[\w-]+)(?P<after>[ \t]*[.=\]])?',
    re.DOTALL,
)
_TOML_HEAD = re.compile(r"\s*\[[^\]=]*")


def toml_keys(text: str) -> Iterator[Key]:
    top, in_head = "", False
    for match in _TOML_WORD.finditer(text):
        if not match["after"]:
            continue
        name = match["name"].strip("\"'")
        before = text[text.rfind("\n", 0, match.start()) + 1 : match.start()]
        head = _TOML_HEAD.fullmatch(before)
        if head and not before.strip(" \t["):
            top, in_head = name, True
        elif not in_head and not before.strip():
            top = name  # a key before all tables is a table of its own, for what is in it
        if head or match["after"].strip() == "=":
            yield name, match.start(), top
