"""Which source reads a bus, and what is said where it is not the best one."""

import pytest

from syncline_logger.bus_options import BusOptions
from syncline_logger.sources import socketcan
from syncline_logger.sources.choice import source_of
from syncline_logger.sources.python_can import PythonCanSource
from syncline_logger.sources.socketcan import SocketCanSource
from syncline_schemas.errors import SourceError


@pytest.fixture(autouse=True)
def _as_on_linux(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socketcan, "why_unavailable", str)


def test_socketcan_is_read_natively() -> None:
    source = source_of(BusOptions("press", "socketcan", "can0", bitrate=250_000))
    assert isinstance(source, SocketCanSource)
    assert (source.facts.name, source.facts.channel) == ("press", "can0")
    assert source.fileno() == -1


def test_a_machine_without_it_falls_back_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socketcan, "why_unavailable", lambda: "this Python knows no SocketCAN")
    source = source_of(BusOptions("press", "socketcan", "can0"))
    assert isinstance(source, PythonCanSource)
    [note] = source.facts.notes
    assert note.endswith("counts no frames lost in the kernel: this Python knows no SocketCAN")


def test_options_of_python_can_are_left_to_it() -> None:
    arguments = {"ignore_rx_error_frames": True}
    source = source_of(BusOptions("press", "socketcan", "can0", arguments=arguments))
    assert isinstance(source, PythonCanSource)
    assert "ignore_rx_error_frames" in source.facts.notes[0]


def test_other_interfaces_are_python_cans() -> None:
    source = source_of(BusOptions("a", "virtual", "x"))
    assert isinstance(source, PythonCanSource)
    assert source.facts.notes == ()
    with pytest.raises(SourceError, match="no interface 'nonsense'"):
        source_of(BusOptions("a", "nonsense", "x"))
