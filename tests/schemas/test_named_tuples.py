"""Named tuples that are made quickly are those of the standard library."""

import copy
import inspect
import pickle
import types
import typing
from collections.abc import Callable
from functools import partial
from typing import Any, Generic, TypeVar

import pytest

from syncline_schemas.named_tuples import NamedTuple
from tests.schemas.test_records import told

T = TypeVar("T")


class Place(NamedTuple):
    """Where something is."""

    bus: str
    node: int | None = None

    @property
    def known(self) -> bool:
        """Whether the node is known."""
        return self.node is not None

    def __str__(self) -> str:
        return f"{self.bus}:{self.node}"


class One(NamedTuple):
    value: "Place"


def pair() -> tuple[Any, Any]:
    """A class by the standard library, and by us."""

    def row(base: Any) -> Any:
        class Row(base):  # type: ignore[misc]
            """A row."""

            t_ns: int
            name: str = "can0"
            seq: tuple[int, ...] = ()
            cls: "Place | None" = None

            SHOWN = 4

            @property
            def half(self) -> int:
                return self.t_ns // 2

            @classmethod
            def zero(cls) -> Any:
                return cls(0)

        return Row

    return row(typing.NamedTuple), row(NamedTuple)


def parameters(row: Any) -> list[inspect.Parameter]:
    return list(inspect.signature(row).parameters.values())


ASKS: list[Callable[[Any], object]] = [
    lambda row: row(5, "y"),
    lambda row: row(5, cls="y", name="x"),
    lambda row: row(),
    lambda row: row(1, 2, 3, 4, 5),
    lambda row: row(1, t_ns=2),
    lambda row: row(1, wrong=2),
    lambda row: (row(5).half, row.zero(), row.SHOWN),
    lambda row: row(1) == (1, "can0", (), None),
    lambda row: hash(row(1)) == hash((1, "can0", (), None)),
    lambda row: sorted([row(2), row(1)]),
    lambda row: row(3, "x")[1:],
    lambda row: row(1)._replace(name="x"),
    lambda row: row(1)._replace(wrong="x"),
    lambda row: row(1)._asdict(),
    lambda row: row._make([1, 2, 3, 4]),
    lambda row: row._make([1, 2, 3]),
    lambda row: (row._fields, row._field_defaults, row.__match_args__, row.__slots__),
    lambda row: (row.__name__, row.__qualname__, row.__module__, row.__doc__, row.__bases__),
    lambda row: [(each.name, each.default) for each in parameters(row)],
    typing.get_type_hints,
    lambda row: (row.name.__doc__, row.half.fget.__name__),
    lambda row: setattr(row(1), "name", "x"),
    lambda row: setattr(row(1), "other", "x"),
    lambda row: hasattr(row(1), "__dict__"),
    lambda row: copy.copy(row(1, "x")),
    lambda row: copy.deepcopy(row(1, "x")),
    lambda row: row(1).__getnewargs__(),
    lambda row: repr(type("Below", (row,), {})(1)),
]


@pytest.mark.parametrize("number", range(len(ASKS)))
def test_everything_is_as_the_standard_library_does_it(number: int) -> None:
    theirs, ours = pair()
    assert told(partial(ASKS[number], ours)) == told(partial(ASKS[number], theirs))


@pytest.mark.parametrize("one", [Place("can0", 3), One(Place("can1"))], ids=["place", "one"])
def test_rows_survive_pickling(one: Any) -> None:
    again = pickle.loads(pickle.dumps(one))
    assert again == one
    assert type(again) is type(one)


def test_methods_of_their_own() -> None:
    assert str(Place("can0", 3)) == "can0:3"
    assert repr(Place("can0", 3)) == "Place(bus='can0', node=3)"
    assert Place("can0", 3).known
    match Place("can0", 3):
        case Place(bus, node):
            assert (bus, node) == ("can0", 3)


BODIES: dict[str, Callable[[], dict[str, Any]]] = {
    "needed after not needed": lambda: {"a": 1, "__annotations__": {"a": int, "b": int}},
    "hidden": lambda: {"__annotations__": {"_a": int}},
    "keyword": lambda: {"__annotations__": {"class": int}},
    "own way to make": lambda: {"__new__": None, "__annotations__": {"a": int}},
    "reserved": lambda: {"_fields": (), "__annotations__": {"a": int}},
    "none": dict,
    "own repr": lambda: {"__repr__": lambda row: "own", "__annotations__": {"a": int}},
}


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_mistakes_are_told_as_there(body: Callable[[], dict[str, Any]]) -> None:
    def made(base: Any) -> object:
        own = {"__module__": __name__} | body()
        row: Any = types.new_class("Row", (base,), {}, lambda space: space.update(own))
        return row(1) if row._fields else row()

    theirs, ours = (told(partial(made, each)) for each in (typing.NamedTuple, NamedTuple))
    assert ours == theirs


def test_those_of_a_kind() -> None:
    class Pair(NamedTuple, Generic[T]):
        one: T
        two: T

    assert Pair[int](1, 2) == (1, 2)
    assert Pair(1, 2).two == 2
