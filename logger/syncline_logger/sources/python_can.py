"""Frames from any interface that python-can knows."""

import contextlib
import logging
from dataclasses import replace
from typing import Any

from syncline_logger.adapter_clock import AdapterClock, Knot
from syncline_logger.batcher import FrameBuffer
from syncline_logger.bus_condition import SOCKETCAN_ERROR_FRAMES
from syncline_logger.bus_options import BusOptions, filter_words
from syncline_logger.can_message import fields_of, ns_of
from syncline_logger.clock import RecorderClock
from syncline_logger.lean_can import can
from syncline_logger.source import SourceFacts
from syncline_schemas.errors import SourceError

MESSAGES_PER_READ = 1000
"""A read returns after so many frames, so that a saturated bus cannot hold it for ever."""

FLOAT_STEP_NS = 238
"""python-can's stamps are seconds in a float: at today's date their step is 2**-22 s."""

_RELATIVE_BELOW_NS = 3_600_000_000_000
"""A first stamp further than this from UTC, or below it, counts from some start of its own."""

LISTEN_ONLY: dict[str, dict[str, Any]] = {
    "cantact": {"monitor": True},
    "kvaser": {"driver_mode": False},
    "nixnet": {"listen_only": True},
    "pcan": {"state": can.BusState.PASSIVE},
    "seeedstudio": {"operation_mode": "silent"},
    "slcan": {"listen_only": True},
    "systec": {"state": can.BusState.PASSIVE},
    "vector": {"listen_only": True},
}
"""How to ask for listen-only mode, by interface. SocketCAN sets it with `ip link`, not here."""

CLOCK_KIND: dict[str, str] = {
    "iscan": "host",
    "kvaser": "hardware",
    "neousys": "host",
    "pcan": "hardware",
    "robotell": "host",
    "slcan": "host",
    "socketcan": "kernel",
    "vector": "hardware",
    "virtual": "host",
}
"""Who stamps the frames, as far as python-can's sources tell."""


class PythonCanSource:
    """A bus behind python-can; it is only ever read."""

    def __init__(self, options: BusOptions) -> None:
        options = configured(options)
        self._options = options
        self._bus: can.BusABC | None = None
        self._owned = True
        self._clock = RecorderClock()
        self._adapter: AdapterClock | None = None
        self._is_utc: bool | None = None
        interface = options.interface or ""
        bitrate, data_bitrate = _bit_rates(options)
        self.facts = SourceFacts(
            name=options.name,
            interface=interface,
            channel="" if options.channel is None else str(options.channel),
            bitrate=bitrate,
            data_bitrate=data_bitrate,
            fd=options.fd,
            clock=CLOCK_KIND.get(interface, "unknown"),
            resolution_ns=FLOAT_STEP_NS,
            listen_only=not options.acknowledge and interface in LISTEN_ONLY,
            filters=filter_words(options.filters),
            loss_counters=("controller",) if interface in SOCKETCAN_ERROR_FRAMES else (),
        )

    @classmethod
    def of_bus(cls, bus: can.BusABC, options: BusOptions) -> "PythonCanSource":
        """A source that reads a bus which the caller opened and will shut down."""
        source = cls(options)
        source._bus = bus
        source._owned = False
        return source

    def open(self) -> None:
        """Open the bus. Raises SourceError."""
        if self._bus is not None:
            return
        self.check_interface()
        try:
            self._bus = can.Bus(**self._bus_arguments())
        except Exception as error:  # drivers raise whatever they like
            raise SourceError(self._what_failed("cannot open", error)) from error

    @property
    def bus(self) -> can.BusABC | None:
        """python-can's bus while it is open; `syncline probe` alone sends on it."""
        return self._bus

    def check_interface(self) -> None:
        """Raise SourceError when python-can has no such interface."""
        if self.facts.interface not in can.VALID_INTERFACES:
            raise SourceError(self._what_interface())

    def _bus_arguments(self) -> dict[str, Any]:
        options = self._options
        arguments: dict[str, Any] = {"single_handle": True}
        if not options.acknowledge:
            arguments |= LISTEN_ONLY.get(self.facts.interface, {})
        arguments |= {
            key: value
            for key, value in (
                ("interface", options.interface),
                ("channel", options.channel),
                ("bitrate", options.bitrate),
                ("data_bitrate", options.data_bitrate),
                ("fd", options.fd or None),
                ("can_filters", list(options.filters) or None),
            )
            if value is not None
        }
        if options.timing:
            arguments["timing"] = bit_timing(options.timing)
        return arguments | {"receive_own_messages": False} | options.arguments

    def read(self, buffer: FrameBuffer, bus: int, timeout_s: float) -> int:
        """Put what has come into the buffer. Raises SourceError when the adapter is gone."""
        if self._bus is None:
            raise SourceError(f"bus '{self.facts.name}' is not open")
        receive, append, t_ns = self._bus.recv, buffer.append, self._t_ns
        count = 0
        try:
            message = receive(timeout_s)
            while message is not None:
                append(t_ns(message.timestamp), bus, *fields_of(message))
                count += 1
                message = receive(0) if count < MESSAGES_PER_READ else None
        except Exception as error:
            raise SourceError(self._what_failed("lost", error)) from error
        return count

    def _t_ns(self, timestamp: float) -> int:
        """t of a stamp, 0 when there is none."""
        if not timestamp:
            return 0
        stamp_ns = ns_of(timestamp)
        if self._is_utc is None:
            self._is_utc = self._tells_utc(stamp_ns)
        if self._is_utc:
            return stamp_ns
        if self._adapter is None:
            self._adapter = AdapterClock(self._clock, FLOAT_STEP_NS)
        return self._adapter.one_t_ns(stamp_ns, self._clock.elapsed_ns())

    def _tells_utc(self, stamp_ns: int) -> bool:
        """Whether the stamps are UTC of this machine, by who makes them and by the first.

        Drivers that stamp by an adapter's clock add an offset to UTC once at most; it drifts.
        """
        near = abs(stamp_ns - self._clock.now_ns()) <= _RELATIVE_BELOW_NS
        if self.facts.clock == "unknown":
            return near and stamp_ns > _RELATIVE_BELOW_NS
        return near and self.facts.clock != "hardware"

    def use_clock(self, clock: RecorderClock) -> None:
        """Map the stamps of adapters onto this clock; before the source is opened."""
        self._clock = clock

    def clock_knots(self) -> list[Knot]:
        """How the adapter's stamps became t since the last call."""
        return self._adapter.take_knots() if self._adapter else []

    def fileno(self) -> None:
        """None: python-can waits for frames itself."""

    def close(self) -> None:
        """Shut the bus down, if it was opened here."""
        bus, self._bus, self._is_utc, self._adapter = self._bus, None, None, None
        if bus is not None and self._owned:
            with contextlib.suppress(Exception):
                bus.shutdown()

    def _what_interface(self) -> str:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        if not self.facts.interface:
            return (
                "no bus is given: name it with -i INTERFACE -c CHANNEL or --bus, or in python-can's"
                f" configuration file; interfaces: {known}"
            )
        return f"there is no interface '{self.facts.interface}'; python-can knows {known}"

    def _what_failed(self, what: str, error: Exception) -> str:
        place = f"{self.facts.interface or 'interface'} {self.facts.channel}".strip()
        reason = str(error).strip() or type(error).__name__
        return f"bus '{self.facts.name}' ({place}): {what}: {reason}"


def configured(options: BusOptions) -> BusOptions:
    """With interface and channel from python-can's configuration, where the options leave them."""
    if options.interface:
        return options
    try:
        found = can.util.load_config()
    except Exception:  # noqa: BLE001 - without a usable configuration `open` says what is missing
        return options
    channel = options.channel if options.channel is not None else found.get("channel")
    return replace(options, interface=found["interface"], channel=channel)


def bit_timing(parameters: dict[str, int]) -> can.BitTiming | can.BitTimingFd:
    """Bit timing by python-can's names. Raises ValueError or TypeError where it is none."""
    kind: Any = can.BitTimingFd if "nom_brp" in parameters else can.BitTiming
    timing: can.BitTiming | can.BitTimingFd = kind(**parameters)
    return timing


def _bit_rates(options: BusOptions) -> tuple[int | None, int | None]:
    """Bit rate and data bit rate of the options, else those that their bit timing makes."""
    bitrate, data_bitrate = options.bitrate, options.data_bitrate
    if options.timing:
        # A wrong timing is told of when the bus is opened.
        with contextlib.suppress(ValueError, TypeError):
            timing = bit_timing(options.timing)
            if isinstance(timing, can.BitTimingFd):
                return timing.nom_bitrate, timing.data_bitrate
            return timing.bitrate, data_bitrate
    return bitrate, data_bitrate


def quiet_python_can() -> None:
    """Keep python-can's own warnings off the status line; what matters is raised."""
    logging.getLogger("can").setLevel(logging.ERROR)
