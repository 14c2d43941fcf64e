"""Both engines keep the contract, and the kernel's binding is what its stub says."""

from __future__ import annotations

import ast
import inspect
import os
import re
import subprocess
import sys
from enum import Enum
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from engines import composite_by

import hpcomp
from hpcomp.engine import reference
from hpcomp.engine.contract import Accumulator, Engine
from hpcomp.kernel import _kernel, fused
from hpcomp.options import stack_rules

ENGINES = {"kernel": fused.ENGINE, "reference": reference.ENGINE}
#: One of each way in which an engine reduces a stack.
ORDERS = ("bottom-up", "top-down", "balanced", "simultaneous")


def members(protocol):
    """The names of a protocol: of its functions, and of its attributes."""
    functions = {name for name, value in vars(protocol).items() if inspect.isfunction(value) and not name.startswith("_")}
    return functions, set(protocol.__annotations__)


def parameters(function):
    """(name, kind, default) of each: what a caller can pass, and how."""
    return [(p.name, p.kind, p.default) for p in inspect.signature(function).parameters.values()]


def assert_kept(protocol, made):
    functions, attributes = members(protocol)
    assert functions
    assert attributes
    for name in functions:
        expected = parameters(getattr(protocol, name))
        assert parameters(getattr(type(made), name)) == expected, name
    for name in attributes:
        assert hasattr(made, name), name


@pytest.mark.parametrize("name", ENGINES)
def test_an_engine_has_all_that_the_contract_names(name):
    by = ENGINES[name]
    assert_kept(Engine, by)
    assert by.name == name
    assert type(by.decodes_in_numpy) is bool
    assert by.pairs_at_once > 0
    for space in ("linear-rgb", "xyz", "hsl", "oklab", "cielab"):
        rules = stack_rules(3, space=space)
        assert by.measures(rules) is (name == "reference" or rules.space.linear)
        for other in ({"strength": "perceived"}, {"blending": "woven"}):
            assert by.measures(stack_rules(3, space=space, **other)) is (name == "reference")
        assert type(by.bytes_to_reduce(rules, 3)) is int


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", ENGINES)
def test_an_accumulator_has_all_that_the_contract_names(name, order):
    made = ENGINES[name].start(stack_rules(3, order=order), 5, 4)
    assert_kept(Accumulator, made)
    assert made.nonfinite == [0] * 3


def test_compositing_alone_loads_nothing_that_measures(tmp_path):
    """Only reports need it, and it takes its time."""
    code = """
import sys
import numpy as np
import hpcomp
hpcomp.composite([np.zeros((2, 3, 4), np.float32)] * 2)
print(sorted({"hpcomp.measures.summary", "hpcomp.kernel.measuring"} & set(sys.modules)))
"""
    for name in ENGINES:
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, env={**os.environ, "HPCOMP_ENGINE": name},
            capture_output=True, text=True,
        )  # fmt: skip
        assert (done.stdout, done.stderr) == ("[]\n", ""), name


# ---- the stub of the binding -------------------------------------------------------------------


STUB = ast.parse((Path(hpcomp.__file__).parent / "kernel" / "_kernel.pyi").read_text())


def names_of(function):
    """The keywords of a function of the stub; `self` is none."""
    given = function.args
    assert not given.posonlyargs
    assert [argument.arg for argument in given.args] in ([], ["self"]), function.name
    return [argument.arg for argument in given.kwonlyargs]


def bound_names(function):
    """The keywords of a function of the binding, of which there is one way to call it."""
    ((signature, *_),) = function.__nb_signature__
    found = re.match(r"def \w+\((?:self(?:: \S+)?(?:, |\)))?(?:/, )?(?:\*, )?(.*)\)? ->", signature)
    return re.findall(r"(?:^|, )(\w+): ", re.sub(r"\[[^]]*\]", "", found[1]))


def assert_stub_holds(body, bound):
    for node in body:
        if isinstance(node, ast.FunctionDef):
            function = getattr(bound, node.name)
            assert bound_names(function) == names_of(node), node.name
        elif isinstance(node, (ast.AnnAssign, ast.Assign)):
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            assert hasattr(bound, target.id), target.id


def test_the_stub_is_what_was_built():
    classes = {node.name: node for node in STUB.body if isinstance(node, ast.ClassDef)}
    functions = [node for node in STUB.body if isinstance(node, ast.FunctionDef)]
    public = {name for name in vars(_kernel) if not name.startswith("_")}
    declared = {*classes, *(node.name for node in functions)} - {"_Packing"} | {"packing"}
    assert public == declared
    assert_stub_holds(functions, _kernel)
    for name, node in classes.items():
        bound = _kernel.packing if name == "_Packing" else getattr(_kernel, name)
        assert_stub_holds(node.body, bound)
        own = {n for n in vars(bound) if not n.startswith("_")}
        if isinstance(bound, ModuleType) or not issubclass(bound, Enum):
            said = {n.name for n in node.body if isinstance(n, ast.FunctionDef)}
            said |= {n.target.id for n in node.body if isinstance(n, ast.AnnAssign)}
            assert own == said - {"__init__"}, name
        else:
            assert [member.name for member in bound] == [n.targets[0].id for n in node.body], name


@pytest.mark.parametrize("rules", [{}, {"order": "simultaneous", "space": "oklab"}, {"blending": "woven"}])
def test_doubles_are_the_references_with_any_engine(rules):
    """So tests of doubles run once, see `conftest`."""
    layers = [np.random.default_rng(number).random((5, 7, 4)) for number in range(3)]
    made = [composite_by(name, layers, **rules) for name in ENGINES]
    assert made[0].dtype == np.float64
    assert made[0].tobytes() == made[1].tobytes()
