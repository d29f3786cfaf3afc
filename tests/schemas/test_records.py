"""Dataclasses whose methods are made late are those of the standard library."""

import copy
import dataclasses
import inspect
import pickle
import typing
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import pytest

from syncline_schemas.records import dataclass

Decorator = Callable[..., Any]


@dataclass(frozen=True, slots=True)
class Frozen:
    """A frozen one with slots."""

    bus: str
    node: int | None = None
    notes: list[str] = dataclasses.field(default_factory=list, compare=False)


@dataclass(slots=True)
class Open:
    """One that may change."""

    count: int = 0
    _hidden: float = dataclasses.field(default=0.5, repr=False)
    total: int = dataclasses.field(init=False, default=7)


def pair(options: dict[str, bool]) -> tuple[Any, Any]:
    """A class by the standard library, and by us."""

    def row(decorator: Decorator) -> Any:
        @decorator(**options)
        class Row:
            """A row."""

            t_ns: int
            name: str = "can0"
            seq: list[int] = dataclasses.field(default_factory=list, hash=False)
            total: int = dataclasses.field(init=False, default=7)
            seen: list[int] = dataclasses.field(init=False, default_factory=list, hash=False)
            later: int = dataclasses.field(init=False, repr=False, compare=False)
            unit: str = dataclasses.field(default="%", repr=False)
            parts: list[int] = dataclasses.field(default_factory=lambda: [1], hash=False)

            def __post_init__(self) -> None:
                if self.t_ns < 0:
                    raise ValueError(self.t_ns)

            @property
            def half(self) -> int:
                return self.t_ns // 2

        return Row

    return row(dataclasses.dataclass), row(dataclass)


OPTIONS = [
    {"frozen": frozen, "slots": slots, "eq": eq, "repr": shown}
    for frozen in (False, True)
    for slots in (False, True)
    for eq in (False, True)
    for shown in (False, True)
]


def told(ask: Callable[[], object]) -> object:
    """What is returned, or raised; addresses are cut off."""
    try:
        return str(ask()).partition(" object at ")[0]
    except Exception as error:  # noqa: BLE001
        return type(error), str(error)


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("rows", [0, 1, 100])
def test_everything_is_as_the_standard_library_does_it(options: dict[str, bool], rows: int) -> None:
    asks: list[Callable[[Any], object]] = [
        lambda row: row(1) == row(1),
        lambda row: row(1) == row(2),
        lambda row: row(1) == (1, "can0", []),
        lambda row: len({hash(each) for each in [row(1, "x"), row(1, "x", [4])]}),
        lambda row: len({hash(each) for each in [row(1), row(2)]}),
        lambda row: row(5, "y", unit="A"),
        lambda row: row(5).half,
        lambda row: row(),
        lambda row: row(1, 2, 3, 4, 5, 6),
        lambda row: row(1, t_ns=2),
        lambda row: row("1", "x", [2], "A", [3]),
        lambda row: row(name="x", t_ns=1),
        lambda row: row(1, wrong=2),
        lambda row: row(1, parts=[2]),
        lambda row: row(1).seq is row(1).seq,
        lambda row: row(1).later,
        lambda row: sorted(vars(row(1))),
        lambda row: row.__init__.__qualname__,
        lambda row: row(-1),
        lambda row: setattr(row(1), "t_ns", 2),
        # How it is refused differs by the version of Python where there are slots.
        lambda row: isinstance(told(lambda: setattr(row(1), "other", 2)), tuple),
        lambda row: delattr(row(1), "t_ns"),
        lambda row: dataclasses.replace(row(1), t_ns=3).t_ns,
        lambda row: dataclasses.asdict(row(1, seq=[2])),
        lambda row: dataclasses.astuple(row(1)),
        lambda row: [field.name for field in dataclasses.fields(row)],
        lambda row: copy.copy(row(4)).t_ns,
        lambda row: copy.deepcopy(row(4, seq=[1])).seq,
        lambda row: row.__match_args__,
        lambda row: hasattr(row(1), "__dict__"),
        lambda row: row.__hash__ is None,
    ]
    for ask in asks:
        theirs, ours = pair(options)
        for _ in range(rows):
            ours(1)
        assert told(partial(ask, ours)) == told(partial(ask, theirs))


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("rows", [0, 1, 100])
def test_what_is_told_of_a_class(options: dict[str, bool], rows: int) -> None:
    asks: list[Callable[[Any], object]] = [
        lambda row: [(each.name, each.type, each.default, each.init) for each in fields(row)],
        lambda row: fields(row) == fields(row) == fields(row(1)),
        dataclasses.is_dataclass,
        lambda row: [(each.name, each.kind) for each in shown(row)],
        lambda row: [each.annotation for each in shown(row)],
        lambda row: [each.default for each in shown(row) if each.name not in ("seq", "parts")],
        typing.get_type_hints,
        lambda row: typing.get_type_hints(row.__init__),
        lambda row: row.__dataclass_params__,
        lambda row: (row.__name__, row.__qualname__, row.__module__, row.__doc__),
        lambda row: [row.__init__.__name__, row.__eq__.__qualname__, row.__repr__.__qualname__],
    ]
    for ask in asks:
        theirs, ours = pair(options)
        for number in range(rows):
            ours(number)
        assert told(partial(ask, ours)) == told(partial(ask, theirs))


def fields(row: Any) -> Any:
    return dataclasses.fields(row)


def shown(row: Any) -> list[inspect.Parameter]:
    return list(inspect.signature(row).parameters.values())


BODIES: dict[str, Callable[[], dict[str, Any]]] = {
    "a list for all rows": lambda: {"a": [], "__annotations__": {"a": list}},
    "a field with a dict for all rows": lambda: {
        "a": dataclasses.field(default={}),
        "__annotations__": {"a": dict},
    },
    "needed after not needed": lambda: {"a": 1, "__annotations__": {"a": int, "b": int}},
    "needed after a field that is not": lambda: {
        "a": dataclasses.field(default=1),
        "__annotations__": {"a": int, "b": int},
    },
    "no kind": lambda: {"a": dataclasses.field(), "__annotations__": {"b": int}},
    "slots of its own": lambda: {"__slots__": ("a",), "__annotations__": {"a": int}},
    "hash of its own": lambda: {"__hash__": lambda row: 5, "__annotations__": {"a": int}},
    "own way to assign": lambda: {
        "__setattr__": lambda row, name, value: None,
        "__annotations__": {"a": int},
    },
}


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_mistakes_are_told_where_the_class_is_written(body: Callable[[], dict[str, Any]]) -> None:
    def made(decorate: Decorator) -> object:
        return decorate(frozen=True, slots=True)(type("Row", (), body()))

    theirs, ours = (told(partial(made, each)) for each in (dataclasses.dataclass, dataclass))
    assert theirs == ours


@dataclasses.dataclass
class Annotated:
    """What may stand in a class and is no attribute, or none that is given by place."""

    text: str
    kinds: dict[str, Any]
    values: dict[str, Any]


NO_FIELDS = [
    Annotated("class variable", {"a": ClassVar[int]}, {"a": 4}),
    Annotated("bare class variable", {"a": ClassVar}, {"a": 4}),
    Annotated("class variable as text", {"a": "ClassVar[int]"}, {"a": 4}),
    Annotated("argument", {"a": dataclasses.InitVar[int]}, {"a": 4}),
    Annotated("bare argument", {"a": dataclasses.InitVar}, {"a": 4}),
    Annotated("by name from here", {"a": int, "_": dataclasses.KW_ONLY, "b": int}, {"a": 4}),
    Annotated("by name", {"a": int}, {"a": dataclasses.field(default=4, kw_only=True)}),
]


@pytest.mark.parametrize("more", NO_FIELDS, ids=lambda more: more.text)
def test_what_is_no_field_is_none_here_either(more: Annotated) -> None:
    def made(decorate: Decorator) -> Any:
        def __post_init__(row: object, *args: object) -> None:
            told_.append(args)

        body = {"__annotations__": {"t_ns": int} | more.kinds, "__post_init__": __post_init__}
        told_: list[object] = []
        row = decorate(slots=True)(type("Row", (), body | more.values | {"__module__": __name__}))
        return row, told_

    asks: list[Callable[[Any], object]] = [
        lambda row: row(3),
        lambda row: row(3, 2),
        lambda row: row(3, a=2),
        lambda row: row(3, b=2),
        lambda row: row(3, a=2, b=2),
        lambda row: row.a,
        lambda row: (row.__slots__, row.__match_args__),
        lambda row: [field.name for field in dataclasses.fields(row)],
    ]
    for ask in asks:
        (theirs, their_args), (ours, our_args) = made(dataclasses.dataclass), made(dataclass)
        assert told(partial(ask, ours)) == told(partial(ask, theirs))
        assert our_args == their_args


@pytest.mark.skipif(not hasattr(copy, "replace"), reason="needs Python 3.13")
def test_rows_are_copied_with_changes() -> None:
    assert copy.replace(Frozen("can0", 3), node=4) == Frozen("can0", 4)  # type: ignore[attr-defined,unused-ignore]


def test_a_class_below_a_frozen_one_may_have_attributes_of_its_own() -> None:
    class Below(Frozen):
        pass

    one = Below("can0")
    one.seen = True  # type: ignore[attr-defined]
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.bus = "can1"  # type: ignore[misc]
    assert (one.bus, one.seen, repr(one)) == ("can0", True, told(lambda: Below("can0")))  # type: ignore[attr-defined]


@pytest.mark.parametrize("first", ["eq", "hash", "repr"])
def test_any_method_may_be_the_first(first: str) -> None:
    _, row = pair({"frozen": True, "slots": True, "eq": True, "repr": True})
    one = row(1)
    ask: dict[str, Callable[[], object]] = {
        "eq": lambda: one == row(1),
        "hash": lambda: hash(one),
        "repr": lambda: repr(one),
    }
    assert ask[first]()
    assert one == row(1)
    assert hash(one) == hash(row(1))
    assert "t_ns=1" in repr(one)


@pytest.mark.parametrize("one", [Frozen("can0", 3, ["x"]), Open(4)], ids=["frozen", "open"])
def test_rows_survive_pickling(one: object) -> None:
    again = pickle.loads(pickle.dumps(one))
    assert again == one
    assert repr(again) == repr(one)


def test_a_spy_on_a_method_stays() -> None:
    _, row = pair({"frozen": True, "slots": True, "eq": True, "repr": True})
    made, calls = row.__init__, []

    def spy(self: object, *args: object) -> None:
        calls.append(args)
        made(self, *args)

    row.__init__ = spy
    assert (row(1), row(2)) == (row(1), row(2))
    assert len(calls) == 4


def test_state_of_its_own_is_kept() -> None:
    @dataclass(frozen=True, slots=True)
    class Kept:
        t_ns: int

        def __getstate__(self) -> str:
            return "mine"

    assert Kept(1).__getstate__() == "mine"


def test_what_is_not_plain_is_left_to_the_standard_library() -> None:
    @dataclass(frozen=True)
    class Named(Frozen):
        name: str = "x"

    assert Named("can1") == Named("can1")
    assert repr(Named("can1")).endswith("name='x')")
    with pytest.raises(dataclasses.FrozenInstanceError):
        Named("can1").bus = "other"  # type: ignore[misc]

    @dataclass(slots=True)
    class Own:
        value: int

        def __repr__(self) -> str:
            return "own"

    assert repr(Own(1)) == "own"
    assert Own(1) == Own(1)


def test_fields_of_any_name_and_what_is_told_of_them() -> None:
    def made(decorate: Callable[..., Any]) -> Any:
        @decorate(slots=True)
        class Named:
            self: int
            _UNSET: list[int] = dataclasses.field(default_factory=list)
            _default_self: str = "x"

        return Named

    theirs, ours = made(dataclasses.dataclass), made(dataclass)
    for row in (theirs, ours):
        one = row(1, [2])
        assert (one.self, one._UNSET, one._default_self) == (1, [2], "x")
        assert row(1)._UNSET == []
    shown = [inspect.signature(row.__init__).parameters.values() for row in (theirs, ours)]
    told = [[(each.name, each.annotation) for each in list(names)[1:]] for names in shown]
    assert told[0] == told[1]
