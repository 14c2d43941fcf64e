"""Frozen records: dataclasses whose methods are not generated, class by class, at every start.

The standard library writes and compiles `__init__`, `__eq__` and their kin anew in every process:
0.6 ms a class, a sixth of a run that makes a small picture. Here they are the same few functions
for all classes. A record is a dataclass for `fields`, `replace` and type checkers. Modules that are
imported only where work takes longer, such as those of reports, have dataclasses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, Field, FrozenInstanceError, dataclass, field, fields
from typing import TYPE_CHECKING, Any, TypeVar, dataclass_transform

if TYPE_CHECKING:
    from inspect import Signature

T = TypeVar("T")


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def record(cls: type[T]) -> type[T]:
    """The class as a frozen dataclass with the methods of all records, and those of its own.

    Two records are equal if they are of one class and have equal fields. Not of use here, and so
    not supported: class variables, and fields that are not in `__init__`, `repr` apart.
    """
    return _made(cls, {**_METHODS, **_COMPARISON})


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
def unique_record(cls: type[T]) -> type[T]:
    """As `record`, but equal to itself alone: for arrays, and what else does not compare."""
    return _made(cls, _METHODS)


def _made(cls: type[T], methods: dict[str, Any]) -> type[T]:
    own = vars(cls)
    made = dataclass(init=False, repr=False, eq=False)(cls)  # what it has in fields
    made.__record_fields__ = {item.name: item for item in fields(made)}  # type: ignore[attr-defined, arg-type]
    for name, method in methods.items():
        if own.get(name) is None:
            setattr(made, name, method)
    return made


def _init(self: Any, *values: Any, **named: Any) -> None:
    of_class: dict[str, Field[Any]] = self.__record_fields__
    given = dict(zip(of_class, values, strict=False)) | named
    if len(given) < len(values) + len(named) or not given.keys() <= of_class.keys():
        raise TypeError(f"{type(self).__name__} takes each of {', '.join(of_class)} once")
    for name, item in of_class.items():
        self.__dict__[name] = given[name] if name in given else _default(self, item)
    if hasattr(self, "__post_init__"):
        self.__post_init__()


def _default(self: Any, item: Field[Any]) -> Any:
    if item.default is not MISSING:
        return item.default
    if item.default_factory is not MISSING:
        return item.default_factory()
    raise TypeError(f"{type(self).__name__} needs {item.name}")


def _values(self: Any) -> tuple[Any, ...]:
    return tuple([self.__dict__[name] for name in self.__record_fields__])


def _eq(self: Any, other: Any) -> bool:
    return _values(self) == _values(other) if type(other) is type(self) else NotImplemented


def _hash(self: Any) -> int:
    return hash(_values(self))


def _repr(self: Any) -> str:
    shown = (item.name for item in self.__record_fields__.values() if item.repr)
    return f"{type(self).__name__}({', '.join(f'{n}={getattr(self, n)!r}' for n in shown)})"


def _setattr(self: Any, name: str, value: Any) -> None:
    raise FrozenInstanceError(f"cannot assign to field '{name}'")


def _delattr(self: Any, name: str) -> None:
    raise FrozenInstanceError(f"cannot delete field '{name}'")


class _SignatureOfFields:
    """What `help` and `inspect` show of a record: its fields. Made when it is asked for."""

    def __get__(self, instance: object, cls: Any) -> Signature:
        from inspect import Parameter, Signature

        return Signature(
            [
                Parameter(
                    item.name,
                    Parameter.POSITIONAL_OR_KEYWORD,
                    default=next(
                        (d for d in (item.default, item.default_factory) if d is not MISSING),
                        Parameter.empty,
                    ),
                    annotation=item.type,
                )
                for item in fields(cls)
            ]
        )


_METHODS: dict[str, Callable[..., Any] | _SignatureOfFields] = {
    "__init__": _init,
    "__repr__": _repr,
    "__setattr__": _setattr,
    "__delattr__": _delattr,
    "__signature__": _SignatureOfFields(),
}
_COMPARISON: dict[str, Callable[..., Any]] = {"__eq__": _eq, "__hash__": _hash}
