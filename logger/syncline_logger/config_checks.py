"""Options of `record` that contradict each other."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from syncline_logger.bus_options import BusOptions

if TYPE_CHECKING:
    from syncline_logger.record_command import Wanted


def contradictions(wanted: "Wanted", buses: Sequence[BusOptions]) -> list[str]:
    """Words for each; what is wrong with one option alone is told where it is read."""
    return [*_of_files(wanted), *_of_room(wanted), *_of_triggers(wanted), *_of_buses(buses)]


def _of_buses(buses: Sequence[BusOptions]) -> Iterator[str]:
    for name, count in Counter(bus.name for bus in buses).items():
        if count > 1:
            yield f"{count} buses are called '{name}'; give each [[bus]] a name of its own"
    places: dict[tuple[str | None, str], str] = {}
    for bus in buses:
        if bus.data_bitrate and not bus.fd:
            yield f"bus '{bus.name}': a data bit rate is for CAN FD alone; say fd too, or leave it out"
        if bus.channel is None:
            continue
        place = (bus.interface, str(bus.channel))
        other = places.setdefault(place, bus.name)
        if other != bus.name:
            yield f"buses '{other}' and '{bus.name}' are both {bus.interface} {bus.channel}"


def _of_room(wanted: "Wanted") -> Iterator[str]:
    split = wanted.split_size or wanted.split_time
    sizes = [value for unit, value in wanted.keep if unit == "bytes"]
    if wanted.split_size and sizes and 2 * wanted.split_size > min(sizes):
        yield (
            "keep is less than two files of split_size: only whole files are deleted;"
            " make the files smaller"
        )
    if (wanted.keep or wanted.reserve) and wanted.output.suffix == ".mcap" and not split:
        yield f"keep and reserve are for folders, and {wanted.output} is one file"


def _of_triggers(wanted: "Wanted") -> Iterator[str]:
    if wanted.triggered_only and wanted.output.suffix == ".mcap" and not wanted.output.is_dir():
        yield (
            f"triggered_only writes a file for each event, and {wanted.output} is one file;"
            " name a folder"
        )
    if not wanted.decode and any(word.strip().startswith("value:") for word in wanted.triggers):
        yield "a trigger on a value needs decoding; leave out --no-decode"


def _of_files(wanted: "Wanted") -> Iterator[str]:
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
            yield f"{other} and {option} are the same file {path}"
    if wanted.prometheus is not None and wanted.prometheus.suffix != ".prom":
        yield (
            f"prometheus: {wanted.prometheus} does not end in .prom;"
            " node_exporter reads no other files"
        )
