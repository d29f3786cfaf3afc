"""What is wrong with options though each can be read: contradictions, values without sense, paths."""

import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from syncline_logger.bus_options import BusOptions
from syncline_schemas.wording import counted

if TYPE_CHECKING:
    from syncline_logger.record_command import Wanted
    from syncline_logger.source import Source

Problem = tuple[str, str]
"""Key of an option, as `logger.toml` has it, and what is wrong with it."""

LEAST_BIT_RATE = 5_000
MOST_BIT_RATE = {"bitrate": 1_000_000, "data_bitrate": 20_000_000}
LEAST_BYTES = {"ring_size": 1_000_000, "split_size": 10_000, "log_size": 1_000}
"""Less is a slip of the pen: a unit that was forgotten."""
LEAST_KEEP_BYTES = 1_000_000
LEAST_FLUSH_NS = 10_000_000
MOST_FLUSH_NS = 60_000_000_000
CLASSIC_TIMING = ("f_clock", "brp", "tseg1", "tseg2", "sjw")
FD_TIMING = (
    "f_clock",
    "nom_brp",
    "nom_tseg1",
    "nom_tseg2",
    "nom_sjw",
    "data_brp",
    "data_tseg1",
    "data_tseg2",
    "data_sjw",
)
OTHER_TIMING = frozenset({"nof_samples", "strict"})


def contradictions(wanted: "Wanted") -> Iterator[Problem]:
    """Of the options that are not about buses; what is no value at all is told where it is read."""
    yield from _of_files(wanted)
    yield from _of_sizes(wanted)
    yield from _of_room(wanted)
    yield from _of_triggers(wanted)


def wrong_with_bus(bus: BusOptions) -> Iterator[Problem]:
    """Of one bus."""
    if bus.data_bitrate and not bus.fd:
        yield (
            "data_bitrate",
            f"bus '{bus.name}': a data bit rate is for CAN FD alone; say fd too, or leave it out",
        )
    for key, rate in (("bitrate", bus.bitrate), ("data_bitrate", bus.data_bitrate)):
        if rate is not None and not _is_rate(key, rate):
            example = rate * 1000 if _is_rate(key, rate * 1000) else 500_000
            yield key, f"{rate} is no bit rate in bit/s; write {example}"
    if bus.timing:
        yield from (("timing", text) for text in _of_timing(bus))


def wrong_with_source(source: "Source") -> Iterator[Problem]:
    """Of a bus that no adapter of its kind can do."""
    from syncline_logger.sources.slcan import SlcanSource, unknown_rates

    if isinstance(source, SlcanSource):
        for key, rate, text in unknown_rates(source.facts):
            if _is_rate(key, rate):
                yield key, f"{text}; write one of them"


def wrong_with_buses(buses: Sequence[BusOptions]) -> Iterator[tuple[int, str, str]]:
    """Number of a bus, key and words where several are in each other's way."""
    names = Counter(bus.name for bus in buses)
    places: dict[tuple[str | None, str], str] = {}
    told: set[str] = set()
    for number, bus in enumerate(buses):
        if names[bus.name] > 1 and bus.name not in told:
            told.add(bus.name)
            count = names[bus.name]
            yield (
                number,
                "name",
                f"{count} buses are called '{bus.name}'; give each [[bus]] a name of its own",
            )
        if bus.channel is None:
            continue
        place = (bus.interface, str(bus.channel))
        other = places.setdefault(place, bus.name)
        if other != bus.name:
            text = f"buses '{other}' and '{bus.name}' are both {bus.interface} {bus.channel}"
            yield number, "channel", f"{text}; record each once"


def wrong_with_paths(wanted: "Wanted") -> Iterator[Problem]:
    """Of what cannot be written as things are now; a folder that is not there yet can be made."""
    output = wanted.output
    is_file = output.suffix == ".mcap" and not output.is_dir()
    if is_file and output.exists():
        yield "output", f"{output} exists; recordings never overwrite a file, name another"
    folders = {
        "output": output.parent if is_file else output,
        "status_file": wanted.status_file and wanted.status_file.parent,
        "prometheus": wanted.prometheus and wanted.prometheus.parent,
        "log": wanted.log and wanted.log.parent,
    }
    for key, folder in folders.items():
        reason = folder and _why_not_writable(folder)
        if reason:
            yield key, f"{reason}; name a folder that can be written"


def _why_not_writable(folder: Path) -> str:
    """Why no file can be made there; empty where one can."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():
        return f"{folder} is no folder"
    try:
        # Rights alone do not tell: the file system may be read-only, or none for files.
        with tempfile.TemporaryFile(dir=folder):
            return ""
    except OSError as error:
        return f"nothing can be written in {folder}: {error.strerror or error}"


def _is_rate(key: str, rate: int) -> bool:
    return LEAST_BIT_RATE <= rate <= MOST_BIT_RATE[key]


def _of_timing(bus: BusOptions) -> Iterator[str]:
    keys = set(bus.timing)
    needed = FD_TIMING if keys & set(FD_TIMING[1:]) else CLASSIC_TIMING
    missing = [key for key in needed if key not in keys]
    unknown = sorted(keys - set(needed) - OTHER_TIMING)
    if missing:
        yield f"{', '.join(missing)} missing; write all of {', '.join(needed)}"
    if unknown:
        yield f"there is no {', '.join(unknown)}; write {', '.join(needed)}"
    if not missing and not unknown:
        from syncline_logger.sources.python_can import bit_timing

        try:
            bit_timing(bus.timing)
        except (ValueError, TypeError) as error:
            yield f"{str(error).rstrip('.')}; see the data sheet of the controller"


def _of_sizes(wanted: "Wanted") -> Iterator[Problem]:
    for key, least in LEAST_BYTES.items():
        size = getattr(wanted, key)
        if size is not None and size < least:
            yield (
                key,
                f"{counted(size, 'byte')}: at least {least} are needed; write a unit, like 100MB",
            )
    if any(unit == "bytes" and size < LEAST_KEEP_BYTES for unit, size in wanted.keep):
        yield "keep", f"less than {LEAST_KEEP_BYTES} bytes; write a unit, like 8GB"
    if wanted.flush_ns < LEAST_FLUSH_NS:
        yield "flush", "less than 10ms wears out the disk for nothing; write 1s"
    if wanted.flush_ns > MOST_FLUSH_NS:
        yield "flush", "more than 1m: all of it is lost when the power goes; write 1s or 10s"


def _of_room(wanted: "Wanted") -> Iterator[Problem]:
    split = wanted.split_size or wanted.split_time
    sizes = [value for unit, value in wanted.keep if unit == "bytes"]
    if wanted.split_size and sizes and 2 * wanted.split_size > min(sizes):
        yield (
            "keep",
            "less than two files of split_size: only whole files are deleted; make them smaller",
        )
    if (wanted.keep or wanted.reserve) and wanted.output.suffix == ".mcap" and not split:
        yield "output", f"keep and reserve are for folders, and {wanted.output} is one file"


def _of_triggers(wanted: "Wanted") -> Iterator[Problem]:
    if wanted.triggered_only and wanted.output.suffix == ".mcap" and not wanted.output.is_dir():
        text = f"triggered_only writes a file for each event, and {wanted.output} is one file"
        yield "output", f"{text}; name a folder"
    if not wanted.decode and any(word.strip().startswith("value:") for word in wanted.triggers):
        yield "trigger", "a trigger on a value needs decoding; leave out --no-decode"


def _of_files(wanted: "Wanted") -> Iterator[Problem]:
    files: dict[Path, str] = {}
    for option, path in (
        ("status_file", wanted.status_file),
        ("prometheus", wanted.prometheus),
        ("log", wanted.log),
        ("output", wanted.output if wanted.output.suffix == ".mcap" else None),
    ):
        if path is None:
            continue
        other = files.setdefault(path, option)
        if other != option:
            yield option, f"{other} and {option} are the same file {path}"
    if wanted.prometheus is not None and wanted.prometheus.suffix != ".prom":
        yield (
            "prometheus",
            f"{wanted.prometheus} does not end in .prom; node_exporter reads no other files",
        )
