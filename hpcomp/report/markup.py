"""What pages are made of: the elements of htpy, which escapes all that is no markup, and lines."""

from __future__ import annotations

import htpy as h
from htpy import Node
from markupsafe import Markup

from ..errors import printable

__all__ = ["Markup", "Node", "digits", "h", "isolated", "lines", "rendered"]


def rendered(document: h.HTMLElement) -> bytes:
    """A page, UTF-8; what cannot be seen or would turn letters is spelt out, however it came in."""
    # As plain text: markupsafe before 3.0 escapes what is looked for in markup.
    doctype, html, rest = str.partition(str(document), "<html")
    text = f"{doctype}\n{html}{rest}\n"
    return "\n".join(map(printable, text.split("\n"))).encode()


def isolated(text: str) -> h.Element:
    """A name from outside: letters that run to the left turn nothing around but themselves."""
    return h.bdi(dir="ltr")[printable(text)]


def lines(*content: Node, by: str = "\n") -> Node:
    """Content each on a line of its own, or with `by` between; what is empty is left out."""
    parts = [part for part in content if part not in (None, "")]
    return [part if n % 2 else by for part in parts for n in (0, 1)][1:]


def digits(value: float) -> str:
    """A number with two digits behind the point at most, which is finer than a screen."""
    return f"{value:.2f}".rstrip("0").rstrip(".") if value % 1 else f"{value:.0f}"
