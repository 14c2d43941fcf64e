"""What decides over the bytes of a stack beside its job: hpcomp, its engine, and its packers."""

from __future__ import annotations

from functools import cache

from ..engine import choice as engine
from ..version import __version__

#: Libraries of which another version may pack the same pixels into other bytes, as installed.
_PACKERS = ("isal", "OpenImageIO", "zlib-ng")

#: The names of these things, each with what it is here: two that are equal make the same bytes.
Maker = dict[str, str]


def maker() -> Maker:
    """What makes stacks in this process."""
    return {"hpcomp": __version__, "engine": engine.active().name, **_packers()}


@cache
def _packers() -> Maker:
    from importlib.metadata import PackageNotFoundError, version  # a batch asks once

    found = {}
    for name in _PACKERS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # installed without saying its version
            found[name] = "of no known version"
    return found


def difference(there: Maker, here: Maker) -> str:
    """How a maker elsewhere differs from the one here, in words; empty where it does not."""
    names = [name for name in (here | there) if here.get(name) != there.get(name)]

    def words(maker: Maker) -> str:
        return ", ".join(f"{name} {maker.get(name, 'of no known version')}" for name in names)

    return f"the worker has {words(there)} and the batch {words(here)}" if names else ""
