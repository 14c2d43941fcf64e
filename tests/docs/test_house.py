"""The house: which folder may import which, who imports an outside library, how large a function is."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import pytest

import hpcomp

PACKAGE = Path(hpcomp.__file__).parent

#: The folders and modules of the package from the top: imports point downwards only. Options stand
#: above `imagefile`, whose tables of forms they show, and below `engine`, whose arrays take them.
FLOORS = (
    ("__main__",),
    ("cli",),
    ("jobs",),
    ("pipeline",),
    ("report",),
    ("analysis",),
    ("layers",),
    ("engine",),
    ("options", "keywords"),
    ("imagefile",),
    ("kernel",),
    ("measures",),
    ("blending",),
    ("color",),
    ("system",),
    ("geometry",),
    ("errors", "records", "version"),
)
FLOOR_OF = {name: number for number, names in enumerate(FLOORS) for name in names}

#: The only folders or modules that import an outside library; numpy is everywhere.
IMPORTERS = {
    "OpenImageIO": {"imagefile.openimageio"},
    "click": {"cli"},
    "colour": {"color.primaries"},
    "distributed": {"jobs.cluster"},
    "htpy": {"report.markup"},
    "isal": {"imagefile.deflate"},
    "markupsafe": {"report.markup"},
    "matplotlib": {"report.drawing"},
    "msgspec": {"jobs.jobfile", "jobs.schema"},  # what a job may hold, and its text
    "tqdm": {"cli.progress"},
    "webcolors": {"color.css"},
    "zlib_ng": {"imagefile.deflate"},
}


def modules():
    """(name, tree) of every module, the package itself being the empty name."""
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        yield name, path.name == "__init__.py", ast.parse(path.read_text(encoding="utf-8"))


MODULES = list(modules())
NAMES = {name for name, _, _ in MODULES}


def imported(name, is_package, tree):
    """The modules that a module imports anywhere in it: those of hpcomp without that name."""
    package = name.split(".") if is_package and name else name.split(".")[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package[: len(package) - (node.level - 1)]
                base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                whole = f"{base}.{alias.name}" if base else alias.name
                yield whole if not node.level or whole in NAMES else base


def test_every_module_has_its_floor():
    assert {name.split(".")[0] for name in NAMES} - {""} == set(FLOOR_OF)


@pytest.mark.parametrize("floor", [name for names in FLOORS for name in names])
def test_imports_point_downwards(floor):
    wrong = []
    for name, is_package, tree in MODULES:
        if name.split(".")[0] != floor:
            continue
        for other in imported(name, is_package, tree):
            target = other.split(".")[0]
            if target in FLOOR_OF and target != floor and FLOOR_OF[target] <= FLOOR_OF[floor]:
                wrong.append((name, other))
    assert wrong == []


@pytest.mark.parametrize("library", IMPORTERS)
def test_an_outside_library_has_one_importer(library):
    found = set()
    for name, is_package, tree in MODULES:
        if any(other.split(".")[0] == library for other in imported(name, is_package, tree)):
            found.add(name)
    allowed = IMPORTERS[library]
    assert {name for name in found if not any(f"{name}.".startswith(f"{a}.") for a in allowed)} == set()
    assert bool(found) == bool(allowed)


def test_codecs_do_not_import_the_engine():
    for name, is_package, tree in MODULES:
        if name.startswith("imagefile"):
            others = set(imported(name, is_package, tree))
            assert not {o for o in others if o.startswith(("engine", "kernel.fused"))}, name


def test_no_module_bears_the_name_of_a_public_name():
    directly = {name for name in NAMES if "." not in name}
    assert directly & set(hpcomp.__all__) == set()


def functions():
    for name, _, tree in MODULES:
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                yield f"{name}.{node.name}", node


def test_no_function_has_more_than_eight_positional_parameters():
    counts = defaultdict(int)
    for name, node in functions():
        positional = [a for a in (*node.args.posonlyargs, *node.args.args) if a.arg not in ("self", "cls")]
        counts[name] = max(counts[name], len(positional))
    assert {name: count for name, count in counts.items() if count > 8} == {}


@pytest.mark.parametrize(
    "name",
    ["pipeline.stack.stack", "pipeline.stack._planned", "pipeline.stack._made", "pipeline.strips.composite_strips",
     "pipeline.flatten.flatten", "pipeline.flatten._planned", "pipeline.flatten._made"],
)
def test_a_picture_is_made_in_short_steps(name):
    (node,) = [node for found, node in functions() if found == name]
    assert node.body[-1].end_lineno - node.lineno + 1 <= 40
