"""HTML and inline SVG from elements: whatever is not markup already is escaped."""

from __future__ import annotations

import html

from ..errors import printable


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


Content = str | Markup

#: Elements that have no content and no end.
_VOID = frozenset({"img", "input", "link", "meta"})


def escaped(text: str) -> Markup:
    """Text for content and attributes; what cannot be seen or would turn letters is spelt out."""
    if isinstance(text, Markup):
        return text
    return Markup(html.escape(printable(text)))


def element(
    name: str, /, *content: Content, by: str = "", **attributes: str | float | bool | None
) -> Markup:
    """An element; the content, joined by `by`, is escaped unless it is `Markup`.

    An underscore in the name of an attribute stands for a hyphen, at its end for nothing. One that
    is None or False is left out, one that is True has no value.
    """
    words = [name]
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        word = key.rstrip("_").replace("_", "-")
        if value is not True:
            text = value if isinstance(value, str) else number(value)
            word = f'{word}="{escaped(text)}"'
        words.append(word)
    start = f"<{' '.join(words)}>"
    if name in _VOID:
        assert not content, name
        return Markup(start)
    return Markup(f"{start}{joined(*content, by=by)}</{name}>")


def isolated(text: str) -> Markup:
    """A name from outside: letters that run to the left turn nothing around but themselves."""
    return element("bdi", text, dir="ltr")


def joined(*content: Content, by: str = "") -> Markup:
    """Content one after the other; what is empty is left out."""
    return Markup(by.join(escaped(part) for part in content if part))


def number(value: float) -> str:
    """A number with two digits behind the point at most, which is finer than a screen."""
    return f"{value:.2f}".rstrip("0").rstrip(".") if value % 1 else f"{value:.0f}"
