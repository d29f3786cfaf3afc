"""The words of --trigger."""

import pytest

from syncline_logger.triggers.conditions import FORMS, parse_condition, parse_conditions
from syncline_logger.triggers.event import Event
from syncline_schemas.errors import SeveralErrors, UsageError


def event(kind: str, node: int | None = 7, detail: int | str | None = None) -> Event:
    return Event(kind, 0, 0, "", 0, node, detail)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("word", "taken", "passed"),
    [
        ("emcy", event("emcy", 9, 0x8130), event("node-lost")),
        ("emcy:7", event("emcy", 7, 0x8130), event("emcy", 8, 0x8130)),
        ("emcy:7:8130", event("emcy", 7, 0x8130), event("emcy", 7, 0x8120)),
        ("emcy:*:81xx", event("emcy", 9, 0x8120), event("emcy", 9, 0x8220)),
        ("emcy:can0/7", event("emcy", 7, 0x1000), event("emcy", 8, 0x1000)),
        ("node-lost:7", event("node-lost"), event("node-lost", 8)),
        ("boot-up", event("boot-up", 3), event("nmt", 3)),
        ("nmt:7:Stopped", event("nmt", 7, "STOPPED"), event("nmt", 7, "OPERATIONAL")),
        ("sdo-abort:7", event("sdo-abort"), event("sdo-abort", 1)),
        ("bus-off", event("bus-off", None), event("gap", None)),
        ("gap", event("gap", None), event("bus-off", None)),
    ],
)
def test_what_a_word_waits_for(word: str, taken: Event, passed: Event) -> None:
    condition = parse_condition(word)
    assert condition.takes(taken, "can0")
    assert not condition.takes(passed, "can0")


def test_a_condition_of_one_bus_passes_over_the_same_node_of_another() -> None:
    condition = parse_condition("emcy:can1/7")
    assert not condition.takes(event("emcy", 7, 1), "can0")
    assert condition.takes(event("emcy", 7, 1), "can1")


def test_bounds_of_values_by_name_and_by_object() -> None:
    named = parse_condition("value:7:Position value > 350.5 deg").value
    assert named is not None
    assert (named.name, named.key, named.than, named.bound) == ("Position value", None, ">", 350.5)
    assert (named.unit, named.raw) == ("deg", False)
    numbered = parse_condition("value:7:6010h:01<=-40").value
    assert numbered is not None
    assert (numbered.key, numbered.than, numbered.bound) == ((0x6010, 1), "<=", -40)
    assert numbered.raw


@pytest.mark.parametrize(
    ("word", "why"),
    [
        ("emergency", "there is emcy[:NODE[:CODE]]"),
        ("emcy:200", "'200' is no node"),
        ("emcy:7:zz", "is no EMCY code"),
        ("nmt:7", "there is"),
        ("nmt:7:lost", "is no NMT state"),
        ("value:7:Position", "a name or an object"),
        ("gap:nowhere", "there is no bus 'nowhere', only can0"),
    ],
)
def test_what_a_wrong_word_is_told(word: str, why: str) -> None:
    with pytest.raises(UsageError, match="trigger '") as raised:
        parse_conditions([word], ["can0"])
    assert why in str(raised.value)


def test_all_wrong_words_at_once() -> None:
    with pytest.raises(SeveralErrors) as raised:
        parse_conditions(["x", "emcy", "nmt:1:y"])
    assert len(raised.value.problems) == 2
    assert all(form in raised.value.problems[0] for form in FORMS)
