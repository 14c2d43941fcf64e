"""Records behave as the frozen dataclasses of the standard library, method by method."""

from __future__ import annotations

import copy
import inspect
import pickle
from dataclasses import FrozenInstanceError, dataclass, field, fields, is_dataclass, replace

import pytest

from hpcomp.records import record, unique_record


class _Content:
    def __post_init__(self):
        object.__setattr__(self, "total", sum(self.numbers))


def of_the_same_fields(decorator, name):
    """A class of this module with that name, made by the decorator."""

    class Made(_Content):
        name: str
        size: int = 3
        numbers: list[int] = field(default_factory=list)
        hidden: str = field(default="secret", repr=False)

    Made.__name__ = Made.__qualname__ = name
    return decorator(Made)


Standard = of_the_same_fields(dataclass(frozen=True), "Standard")
Record = of_the_same_fields(record, "Record")


@record
class More(Record):
    """With a field of its own, and another default."""

    size: int = 4
    added: float = 0.5


@record
class Named:
    """With a method that all records have."""

    name: str

    def __repr__(self):
        return f"<{self.name}>"


@unique_record
class Unique:
    """Equal to itself alone."""

    values: list[float]


GIVEN = [
    (("a",), {}),
    (("a", 5), {"hidden": "no"}),
    ((), {"name": "a", "numbers": [1, 2]}),
    (("a", 1, [4], "x"), {}),
]
WRONG = [
    ((), {}),
    ((), {"size": 1}),
    (("a",), {"name": "b"}),
    (("a",), {"colour": "red"}),
    (("a", 1, [], "x", 2), {}),
]


@pytest.mark.parametrize(("values", "named"), GIVEN)
def test_a_record_is_what_the_dataclass_is(values, named):
    made, expected = Record(*values, **named), Standard(*values, **named)
    assert vars(made) == vars(expected)
    assert list(vars(made)) == list(vars(expected))
    assert repr(made) == repr(expected).replace("Standard", "Record")
    assert made == Record(*values, **named)
    assert made != Record("other")
    assert made != expected
    assert vars(replace(made, name="z")) == vars(replace(expected, name="z"))
    for again in (copy.copy(made), copy.deepcopy(made), pickle.loads(pickle.dumps(made))):
        assert again == made
        assert vars(again) == vars(made)


@pytest.mark.parametrize("of_class", [Record, Standard])
@pytest.mark.parametrize(("values", "named"), WRONG)
def test_wrong_arguments_are_type_errors(of_class, values, named):
    with pytest.raises(TypeError):
        of_class(*values, **named)


@pytest.mark.parametrize("of_class", [Record, Standard, Unique])
def test_it_is_frozen(of_class):
    made = of_class([])
    with pytest.raises(FrozenInstanceError):
        made.name = "b"
    with pytest.raises(FrozenInstanceError):
        del made.name
    assert vars(made) == vars(of_class([]))


def test_defaults_are_made_anew():
    assert Record("a").numbers is not Record("a").numbers
    assert Record.size == Standard.size == 3


def test_hashes():
    assert hash(Named("a")) == hash(Named("a")) != hash(Named("b"))
    assert len({Named("a"), Named("a"), Named("b")}) == 2
    for of_class in (Record, Standard):
        with pytest.raises(TypeError):
            hash(of_class("a"))  # a list has none
    assert len({Unique([1.0]), Unique([1.0])}) == 2


def test_a_unique_record_is_equal_to_itself_alone():
    made = Unique([1.0])
    assert made == made
    assert made != Unique([1.0])


def test_a_method_of_its_own_stays():
    assert repr(Named("a")) == "<a>"


def test_fields_are_inherited():
    assert vars(More("a", added=2.0)) == {**vars(Record("a", 4)), "added": 2.0}
    assert More("a") != Record("a", 4)
    assert [item.name for item in fields(More)] == ["name", "size", "numbers", "hidden", "added"]


def test_what_tools_see_of_it():
    assert is_dataclass(Record)
    assert Record.__match_args__ == Standard.__match_args__
    found, expected = inspect.signature(Record), inspect.signature(Standard)
    assert list(found.parameters) == list(expected.parameters)
    assert found.parameters["size"] == expected.parameters["size"]
    assert found.parameters["name"] == expected.parameters["name"]
