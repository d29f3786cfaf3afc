"""From options to what is recorded, with everything that is wrong with them at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from syncline_logger.bus_devices import load_description, split_device
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
from syncline_logger.config_checks import (
    contradictions,
    wrong_with_bus,
    wrong_with_buses,
    wrong_with_paths,
    wrong_with_source,
)
from syncline_logger.record_options import RecordOptions
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
    wanted: "Wanted",
    config: LoadedConfig | None = None,
    given: frozenset[str] = frozenset(),
    *,
    check: bool = False,
) -> RecordPlan:
    """What the options come to.

    Args:
        given: names of the options that the command line gives, which go before a file's.
        check: look also whether what is to be written can be written now.
    """
    problems = _Problems(config, given)
    common = _common(wanted, problems)
    none: list[BusOptions] = []
    buses = problems.attempt("bus", lambda: _buses(wanted, config, given, common), none)
    from_file = config is not None and _reads_buses_of(config, given)
    known = _description(wanted, buses, problems)
    buses = [_with_bit_rates(bus, known) for bus in buses]
    # Without an interface in a file that is told already.
    unread = config is not None and bool(config.problems) and not config.values
    told = unread or (config is not None and config.names_buses)
    sources: list[Source] = []
    for number, bus in enumerate(buses):
        problems.number = number if from_file else None
        if bus.interface or not told:
            source = problems.attempt("interface", partial(source_of, bus), None)
            sources += [source] if source else []
            for key, text in wrong_with_source(source) if source else ():
                problems.add(key, text)
        for key, text in wrong_with_bus(bus):
            problems.add(key, text)
    for number, key, text in wrong_with_buses(buses):
        problems.number = number if from_file else None
        problems.add(key, text)
    problems.number = None
    options = RecordOptions(
        flush_ns=wanted.flush_ns,
        decode=wanted.decode,
        description=known,
        wait_for_bus=wanted.wait_for_bus,
        compression=wanted.compression[0],
        zstd_level=wanted.compression[1],
        split=Split(wanted.split_size, wanted.split_time),
        keep=_keep(wanted),
        triggers=problems.attempt("trigger", lambda: _triggers(wanted, buses), TriggerPlan()),
    )
    for key, text in (*contradictions(wanted), *(wrong_with_paths(wanted) if check else ())):
        problems.add(key, text)
    return RecordPlan(wanted, tuple(buses), tuple(sources), options, problems.told())


class _Problems:
    """Everything that is wrong, each with where it stands: file and key, or option.

    `number`: which [[bus]] it is about.
    """

    def __init__(self, config: LoadedConfig | None, given: frozenset[str]) -> None:
        self.number: int | None = None
        self._config = config
        self._given = given
        self._problems = list(config.problems) if config else []

    def attempt(self, key: str, make: Callable[[], T], otherwise: T) -> T:
        """What is made; `otherwise` where the user's mistake does not let it."""
        try:
            return make()
        except SynclineError as error:
            for line in str(error).splitlines():
                self.add(key, line)
            return otherwise

    def add(self, key: str, text: str) -> None:
        """Something is wrong with an option, by its key in a file."""
        option = f"--{key.replace('_', '-')}"
        on_command_line = bool({key, f"{key}s", f"{key}es"} & self._given)
        if self._config is None or on_command_line:
            where = "" if text.startswith("--") else f"{option}: "
        else:
            where = self._config.place(key, self.number)
            text = text.removeprefix(option).lstrip(": ")
        self._problems.append(where + text.removeprefix(f"{key} "))

    def told(self) -> tuple[str, ...]:
        """Each once."""
        return tuple(dict.fromkeys(self._problems))


def _description(
    wanted: "Wanted", buses: Sequence[BusOptions], problems: _Problems
) -> BusDescription:
    """What is known of the nodes; what is wrong with each device is told."""
    path, good = wanted.description, list[str]()
    known = problems.attempt("description", lambda: load_description(path, ()), None)
    if known is None:
        path, known = None, BusDescription()
    for word in wanted.devices:
        more = problems.attempt("device", partial(load_description, path, [*good, word]), None)
        if more is None:
            continue
        good.append(word)
        known = more
        bus = split_device(word)[0]
        if bus is not None and buses and bus not in {each.name for each in buses}:
            names = ", ".join(each.name for each in buses)
            problems.add("device", f"'{word}': there is no bus '{bus}', only {names}")
    return known


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


def _common(wanted: "Wanted", problems: _Problems) -> BusOptions:
    filters = [
        problems.attempt("filter", partial(parse_filter, word), None) for word in wanted.filters
    ]
    return BusOptions(
        name="",
        interface=wanted.interface,
        bitrate=wanted.bitrate,
        fd=wanted.fd,
        data_bitrate=wanted.data_bitrate,
        timing=problems.attempt("timing", lambda: parse_timing(wanted.timing), {}),
        filters=tuple(filter(None, filters)),
        arguments=problems.attempt(
            "bus_kwargs", lambda: parse_arguments(wanted.bus_kwargs, "--bus-kwargs"), {}
        ),
        acknowledge=wanted.acknowledge,
    )


def _reads_buses_of(config: LoadedConfig, given: frozenset[str]) -> bool:
    """Whether the buses are those of the file: the command line names none."""
    return bool(config.buses) and not given & {"buses", "channels"}


def _buses(
    wanted: "Wanted", config: LoadedConfig | None, given: frozenset[str], common: BusOptions
) -> list[BusOptions]:
    """Those of the command line, else those of the file."""
    if config is None or not _reads_buses_of(config, given):
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
