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

from ..errors import printable
from ..version import __version__
from .markup import Markup, Node, h, isolated, lines, rendered


@dataclass(frozen=True)
class Section:
    """A part of a page: its anchor, its heading, and what stands below."""

    anchor: str
    title: str
    content: Node


def page(kind: str, name: str, lead: Node, sections: Sequence[Section]) -> bytes:
    """A whole page, UTF-8. `kind`: of report; `name`: of what it is about; `lead`: one sentence."""
    style, script = _text("page.css"), _text("page.js")
    policy = (
        f"default-src 'none'; img-src data:; style-src '{_hash(style)}'; "
        f"script-src '{_hash(script)}'; base-uri 'none'; form-action 'none'"
    )
    head = h.head[
        lines(
            h.meta(charset="utf-8"),
            h.meta(http_equiv="Content-Security-Policy", content=policy),
            h.meta(name="viewport", content="width=device-width, initial-scale=1"),
            h.meta(name="color-scheme", content="light dark"),
            h.meta(name="referrer", content="no-referrer"),
            h.title[printable(f"{name} · {kind}")],
            # Without it a browser would ask for one.
            h.link(rel="icon", href="data:,"),
            h.style[Markup(style)],
            h.script[Markup(script)],
        )
    ]
    links = [h.li[h.a(href=f"#{section.anchor}")[section.title]] for section in sections]
    header = h.header[
        lines(
            h.p(class_="kind")[kind],
            h.h1[isolated(name)],
            h.p(class_="lead")[lead],
            h.nav(aria_label="Sections")[h.ul[links]] if len(links) > 1 else "",
        )
    ]
    main = h.main(id="main", tabindex="-1")[lines(*map(_section, sections))]
    body = h.body[
        lines(
            h.a(class_="skip", href="#main")["Skip to the report"],
            header,
            main,
            h.footer[h.p[f"Made by hpcomp {__version__}."]],
        )
    ]
    return rendered(h.html(lang="en")[lines(head, body)])


def _section(section: Section) -> Node:
    heading = f"{section.anchor}-heading"
    return h.section(id=section.anchor, aria_labelledby=heading)[
        lines(h.h2(id=heading)[section.title], section.content)
    ]


@cache
def _text(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """How a content security policy names an inline style or script."""
    return f"sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
