"""Bus options mean what they mean in python-can's own tools."""

import argparse

import pytest
from can.cli import add_bus_arguments

from syncline_logger.bus_options import (
    BusOptions,
    parse_arguments,
    parse_bus,
    parse_filter,
    parse_timing,
    with_unique_names,
)
from syncline_logger.record_plan import choose_buses
from syncline_schemas.errors import UsageError


def python_can(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_bus_arguments(parser, filter_arg=True)
    return parser.parse_args(words)


@pytest.mark.parametrize(
    "words",
    [
        ["app_name=MyCanApp", "serial=1234"],
        ["state=PASSIVE", "fd=true", "x=-1.5", "path=/dev/ttyUSB0", "empty="],
        ["a_b=1", "c=0x10", "d=.5"],
    ],
)
def test_arguments_are_read_as_python_can_reads_them(words: list[str]) -> None:
    expected = python_can("--bus-kwargs", *words).bus_kwargs
    assert parse_arguments(words, "--bus-kwargs") == expected


def test_a_filter_is_read_as_python_can_reads_it() -> None:
    expected = python_can("--filter", "100:7FC", "200:7F0").can_filters
    assert [parse_filter("100:7FC"), parse_filter("200:7F0")] == expected


def test_an_inverted_filter_keeps_its_mask() -> None:
    """python-can's own tool loses the mask here: it takes `mask & CAN_ERR_FLAG`."""
    assert parse_filter("123~7FF") == {"can_id": 0x2000_0123, "can_mask": 0x7FF}


@pytest.mark.parametrize("word", ["", "100", "100:", "xyz:7FF", "100;7FF"])
def test_a_wrong_filter_is_named(word: str) -> None:
    with pytest.raises(UsageError, match="--filter"):
        parse_filter(word)


@pytest.mark.parametrize("word", ["brp", "brp=fast", "=1"])
def test_wrong_timing_is_named(word: str) -> None:
    with pytest.raises(UsageError, match="--timing"):
        parse_timing([word])


@pytest.mark.parametrize(
    ("word", "name", "interface", "channel"),
    [
        ("socketcan:can0", "can0", "socketcan", "can0"),
        ("press=socketcan:can0", "press", "socketcan", "can0"),
        ("slcan:/dev/ttyUSB0@115200", "ttyUSB0", "slcan", "/dev/ttyUSB0@115200"),
        ("vector:0", "0", "vector", 0),
        ("a=virtual:x y", "a", "virtual", "x y"),
    ],
)
def test_a_bus_in_one_word(word: str, name: str, interface: str, channel: str | int) -> None:
    bus = parse_bus(word, BusOptions("", bitrate=500_000))
    assert (bus.name, bus.interface, bus.channel) == (name, interface, channel)
    assert bus.bitrate == 500_000


def test_a_bus_has_options_of_its_own() -> None:
    bus = parse_bus("vector:1,bitrate=250000,fd=true,app_name=x", BusOptions("", bitrate=500_000))
    assert (bus.bitrate, bus.fd, bus.arguments) == (250_000, True, {"app_name": "x"})


@pytest.mark.parametrize("word", ["can0", "socketcan:", "=socketcan:can0", "a=:can0", "a b=v:c"])
def test_a_wrong_bus_is_named(word: str) -> None:
    with pytest.raises(UsageError, match="--bus"):
        parse_bus(word, BusOptions(""))


def test_channels_share_the_options() -> None:
    buses = choose_buses(BusOptions("", interface="socketcan", bitrate=1), ["can0", "can1"], [])
    assert [(bus.name, bus.interface, bus.channel, bus.bitrate) for bus in buses] == [
        ("can0", "socketcan", "can0", 1),
        ("can1", "socketcan", "can1", 1),
    ]


def test_two_buses_cannot_have_one_name() -> None:
    with pytest.raises(UsageError, match="two buses are called 'can0'"):
        with_unique_names([BusOptions("can0"), BusOptions("can0")])
