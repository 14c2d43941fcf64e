"""Where the keys of a TOML or JSON document stand in its text, which the parsers do not tell."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Lines:
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


def json_keys(text: str) -> Iterator[tuple[str, int]]:
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


def toml_keys(text: str) -> Iterator[tuple[str, int]]:
    for match in _TOML_WORD.finditer(text):
        if not match["after"]:
            continue
        head = _TOML_HEAD.fullmatch(text, text.rfind("\n", 0, match.start()) + 1, match.start())
        if head or match["after"].strip() == "=":
            yield match["name"].strip("\"'"), match.start()
