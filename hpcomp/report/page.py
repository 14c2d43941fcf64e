"""The frame of every page: one file that needs no other, and that no browser lets reach out.

What stands in it is made elsewhere. `page.css` and `page.js` are put into the page, and its policy
names them by their hashes: nothing else in it can run, however it came there.
"""

from __future__ import annotations

import hashlib
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from ..version import __version__
from .markup import Content, Markup, element, isolated


@dataclass(frozen=True)
class Section:
    """A part of a page: its anchor, its heading, and what stands below."""

    anchor: str
    title: str
    content: Markup


def page(kind: str, name: str, lead: Content, sections: Sequence[Section]) -> bytes:
    """A whole page, UTF-8. `kind`: of report; `name`: of what it is about; `lead`: one sentence."""
    style, script = _text("page.css"), _text("page.js")
    policy = (
        f"default-src 'none'; img-src data:; style-src '{_hash(style)}'; "
        f"script-src '{_hash(script)}'; base-uri 'none'; form-action 'none'"
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("meta", name="referrer", content="no-referrer"),
        element("title", f"{name} · {kind}"),
        # Without it a browser would ask for one.
        element("link", rel="icon", href="data:,"),
        element("style", style),
        element("script", script),
        by="\n",
    )
    links = [
        element("li", element("a", section.title, href=f"#{section.anchor}"))
        for section in sections
    ]
    header = element(
        "header",
        element("p", kind, class_="kind"),
        element("h1", isolated(name)),
        element("p", lead, class_="lead"),
        element("nav", element("ul", *links), aria_label="Sections") if len(links) > 1 else "",
        by="\n",
    )
    main = element("main", *map(_section, sections), id="main", tabindex="-1", by="\n")
    body = element(
        "body",
        element("a", "Skip to the report", class_="skip", href="#main"),
        header,
        main,
        element("footer", element("p", f"Made by hpcomp {__version__}.")),
        by="\n",
    )
    document = element("html", head, body, lang="en", by="\n")
    return f"<!doctype html>\n{document}\n".encode()


def _section(section: Section) -> Markup:
    heading = f"{section.anchor}-heading"
    return element(
        "section",
        element("h2", section.title, id=heading),
        section.content,
        id=section.anchor,
        aria_labelledby=heading,
        by="\n",
    )


@cache
def _text(name: str) -> Markup:
    return Markup(Path(__file__).with_name(name).read_text(encoding="utf-8"))


def _hash(text: str) -> str:
    """How a content security policy names an inline style or script."""
    return f"sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
