"""From options to what is recorded, with everything that is wrong with them at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

from syncline_logger.bus_devices import load_description
from syncline_logger.bus_options import (
    BusOptions,
    bus_name,
    parse_arguments,
    parse_bus,
    parse_filter,
    parse_timing,
    parse_value,
    with_unique_names,
)
from syncline_logger.config import LoadedConfig, configured_buses
from syncline_logger.config_checks import contradictions
from syncline_logger.recording import RecordOptions
from syncline_logger.retention import Keep
from syncline_logger.segments import Split
from syncline_logger.source import Source
from syncline_logger.sources.choice import source_of
from syncline_logger.triggers.conditions import parse_conditions
from syncline_logger.triggers.plan import TriggerPlan
from syncline_schemas.description import BusDescription
from syncline_schemas.errors import SynclineError

if TYPE_CHECKING:
    from syncline_logger.record_command import Wanted

T = TypeVar("T")

_FIELD_OF_OPTION = {
    "interface": "interface",
    "bitrate": "bitrate",
    "fd": "fd",
    "data_bitrate": "data_bitrate",
    "timing": "timing",
    "filters": "filters",
    "acknowledge": "acknowledge",
}
"""Options of `record` that the command line puts over those of each [[bus]] of a file."""


@dataclass(frozen=True, slots=True)
class RecordPlan:
    """What will be recorded; only to be used when there are no problems."""

    wanted: "Wanted"
    buses: tuple[BusOptions, ...]
    sources: tuple[Source, ...]
    options: RecordOptions
    problems: tuple[str, ...]

    def summary(self) -> str:
        """What the options come to, in words."""
        lines = [f"fine; to {self.wanted.output} will be recorded:"]
        for bus in self.buses:
            rate = f", {bus.bitrate} bit/s" if bus.bitrate else ""
            lines.append(f"  {bus.name}: {bus.interface} {bus.channel}{rate}")
        return "\n".join(lines)


def plan_recording(
    wanted: "Wanted", config: LoadedConfig | None = None, given: frozenset[str] = frozenset()
) -> RecordPlan:
    """What the options come to.

    Args:
        given: names of the options that the command line gives, which go before a file's.
    """
    problems = list(config.problems) if config else []

    def attempt(make: Callable[[], T], otherwise: T) -> T:
        try:
            return make()
        except SynclineError as error:
            problems.extend(str(error).splitlines())
            return otherwise

    common = attempt(lambda: _common(wanted), BusOptions(""))
    buses: list[BusOptions] = attempt(lambda: _buses(wanted, config, given, common), [])
    known = attempt(lambda: load_description(wanted.description, wanted.devices), BusDescription())
    buses = [_with_bit_rates(bus, known) for bus in buses]
    # Without an interface in a file that is told already.
    unread = config is not None and bool(config.problems) and not config.values
    told = unread or (config is not None and bool(config.buses))
    named = [bus for bus in buses if bus.interface or not told]
    sources = [attempt(lambda bus=bus: source_of(bus), None) for bus in named]  # type: ignore[misc]
    options = RecordOptions(
        flush_ns=wanted.flush_ns,
        decode=wanted.decode,
        description=known,
        wait_for_bus=wanted.wait_for_bus,
        compression=wanted.compression[0],
        zstd_level=wanted.compression[1],
        split=Split(wanted.split_size, wanted.split_time),
        keep=_keep(wanted),
        triggers=attempt(lambda: _triggers(wanted, buses), TriggerPlan()),
    )
    place = f"{config.path}: " if config else ""
    problems += [f"{place}{text}" for text in contradictions(wanted, buses)]
    opened = tuple(source for source in sources if source is not None)
    return RecordPlan(wanted, tuple(buses), opened, options, tuple(dict.fromkeys(problems)))


def _triggers(wanted: "Wanted", buses: Sequence[BusOptions]) -> TriggerPlan:
    return TriggerPlan(
        parse_conditions(wanted.triggers, [bus.name for bus in buses]),
        wanted.triggered_only,
        wanted.before_ns,
        wanted.after_ns,
        wanted.ring_size,
    )


def _keep(wanted: "Wanted") -> Keep:
    """The strictest of the limits that are given."""

    def least(unit: str) -> int | None:
        return min((value for kind, value in wanted.keep if kind == unit), default=None)

    return Keep(least("bytes"), least("ns"), wanted.reserve)


def choose_buses(
    common: BusOptions, channels: Sequence[str], buses: Sequence[str]
) -> list[BusOptions]:
    """The buses that the options name; one bus of python-can's configuration when none does."""
    chosen = []
    for word in channels:
        value = parse_value(word)
        channel = value if isinstance(value, int) else word
        chosen.append(replace(common, name=bus_name(channel), channel=channel))
    chosen += [parse_bus(word, common) for word in buses]
    if not chosen:
        chosen = [replace(common, name=common.interface or "can")]
    return with_unique_names(chosen)


def _common(wanted: "Wanted") -> BusOptions:
    return BusOptions(
        name="",
        interface=wanted.interface,
        bitrate=wanted.bitrate,
        fd=wanted.fd,
        data_bitrate=wanted.data_bitrate,
        timing=parse_timing(wanted.timing),
        filters=tuple(parse_filter(word) for word in wanted.filters),
        arguments=parse_arguments(wanted.bus_kwargs, "--bus-kwargs"),
        acknowledge=wanted.acknowledge,
    )


def _buses(
    wanted: "Wanted", config: LoadedConfig | None, given: frozenset[str], common: BusOptions
) -> list[BusOptions]:
    """Those of the command line, else those of the file."""
    if config is None or not config.buses or given & {"buses", "channels"}:
        return choose_buses(common, wanted.channels, wanted.buses)
    overrides: dict[str, Any] = {
        field: getattr(common, field)
        for option, field in _FIELD_OF_OPTION.items()
        if option in given
    }
    return configured_buses(config, common, overrides)


def _with_bit_rates(bus: BusOptions, known: BusDescription) -> BusOptions:
    """The bus with the bit rates of the description, where the options give none."""
    data_bitrate = known.data_bitrate(bus.name) if bus.fd else None
    return replace(
        bus,
        bitrate=bus.bitrate or known.bitrate(bus.name),
        data_bitrate=bus.data_bitrate or data_bitrate,
    )
