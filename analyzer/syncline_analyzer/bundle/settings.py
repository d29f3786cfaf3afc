"""What the frames before a cut told of the nodes' objects: the cut alone would not know it."""

from collections.abc import Sequence

from syncline_analyzer.results import Analysis, ObjectHistoryRow
from syncline_schemas.capture.learned import learned_record

_TOLD = ("sdo-read", "sdo-write")
Key = tuple[str, int, int, int]


def settings_at(analysis: Analysis, start_ns: int, buses: Sequence[str]) -> dict[str, str]:
    """The record of a segment that begins at a moment, from the analysis of all that came before.

    Only values of whole SDO transfers that were seen, and that held at that moment.
    """
    wanted = {
        (row.bus, row.node, row.index, row.sub): row
        for row in analysis.object_history
        if row.source in _TOLD
        and row.seq is not None
        and row.start_ns < start_ns
        and (row.until_ns is None or row.until_ns > start_ns)
    }
    data = _data(analysis, wanted)
    numbers = {name: number for number, name in enumerate(buses)}
    found: dict[tuple[int, int], dict[tuple[int, int], tuple[bytes, bool]]] = {}
    for (bus, node, index, sub), row in wanted.items():
        value = data.get((bus, node, index, sub))
        if value and bus in numbers:
            settings = found.setdefault((numbers[bus], node), {})
            settings[index, sub] = (value, row.source == "sdo-read")
    return learned_record(found)


def _data(analysis: Analysis, wanted: dict[Key, ObjectHistoryRow]) -> dict[Key, bytes]:
    """The bytes of the transfers that told the values."""
    found: dict[Key, bytes] = {}
    for row in analysis.sdo:
        if row.index is None or row.sub is None or row.result != "ok":
            continue
        key = row.bus, row.node, row.index, row.sub
        told = wanted.get(key)
        if told is not None and told.seq in (row.seq, row.end_seq):
            found[key] = row.data
    return found
