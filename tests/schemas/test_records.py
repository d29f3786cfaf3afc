"""Dataclasses whose methods are made late are those of the standard library."""

import copy
import dataclasses
import inspect
import pickle
from collections.abc import Callable
from typing import Any

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
            _: dataclasses.KW_ONLY
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
def test_everything_is_as_the_standard_library_does_it(options: dict[str, bool]) -> None:
    def answers(row: Any) -> list[object]:
        asks: list[Callable[[], object]] = [
            lambda: row(1) == row(1),
            lambda: row(1) == row(2),
            lambda: row(1) == (1, "can0", []),
            lambda: hash(row(1, "x")) == hash(row(1, "x", [4])),
            lambda: hash(row(1)) == hash(row(2)),
            lambda: row(5, "y", unit="A"),
            lambda: row(5).half,
            row,
            lambda: row(1, 2, 3, 4),
            lambda: row(1, wrong=2),
            lambda: row(1, parts=[2]),
            lambda: row(1).seq is row(1).seq,
            lambda: row(1).later,
            lambda: sorted(vars(row(1))),
            lambda: row.__init__.__qualname__,
            lambda: row(-1),
            lambda: setattr(row(1), "t_ns", 2),
            # How it is refused differs by the version of Python where there are slots.
            lambda: isinstance(told(lambda: setattr(row(1), "other", 2)), tuple),
            lambda: delattr(row(1), "t_ns"),
            lambda: dataclasses.replace(row(1), t_ns=3).t_ns,
            lambda: dataclasses.asdict(row(1, seq=[2])),
            lambda: dataclasses.astuple(row(1)),
            lambda: [field.name for field in dataclasses.fields(row)],
            lambda: copy.copy(row(4)).t_ns,
            lambda: copy.deepcopy(row(4, seq=[1])).seq,
            lambda: row.__match_args__,
            lambda: hasattr(row(1), "__dict__"),
            lambda: row.__hash__ is None,
        ]
        return [told(ask) for ask in asks]

    theirs, ours = pair(options)
    assert answers(ours) == answers(theirs)
    # Once more: by now every method is in its place.
    assert answers(ours) == answers(theirs)


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
