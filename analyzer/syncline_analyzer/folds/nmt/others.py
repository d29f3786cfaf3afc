"""What the error control of the other nodes of a bus tells of one node's silence."""

from collections.abc import Mapping
from itertools import chain

from syncline_analyzer.folds.nmt.error_control import ErrorControl
from syncline_analyzer.folds.nmt.pace import ENOUGH
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.folds.nmt.witness import Heartbeat, Witnesses
from syncline_schemas.canopen.nmt import STATE_OF_BYTE, NmtState


def witnesses_of(controls: Mapping[NodeKey, ErrorControl], number: int) -> Witnesses:
    """The heartbeats of a bus whose period is known."""
    found = {}
    for (bus, node), control in controls.items():
        period_ns, last_ns = control.median_ns(), control.last_beat_ns
        if bus != number or period_ns is None or last_ns is None or not control.beats:
            continue
        if control.counts.heartbeats > ENOUGH and not control.counts.guard_answers:
            silent = [(each.start_ns, each.end_ns) for each in control.silences]
            first_ns, late = control.beats[0].t_ns, control.paces.late
            found[node] = Heartbeat(period_ns, first_ns, last_ns, late, silent)
    return Witnesses(found)


def starts_of(controls: Mapping[NodeKey, ErrorControl]) -> dict[NodeKey, list[int]]:
    """When each node may have started: a boot-up may look like a heartbeat [ns]."""
    return {
        key: [
            beat.t_ns
            for beat in control.beats
            if beat.kind == "boot-up" or STATE_OF_BYTE.get(beat.state) is NmtState.PRE_OPERATIONAL
        ]
        for key, control in controls.items()
    }


def others_anew(starts: Mapping[NodeKey, list[int]], key: NodeKey) -> list[int]:
    """When other nodes of the bus may have started, of the `starts_of` all nodes [ns]."""
    others = (found for other, found in starts.items() if other[0] == key[0] and other != key)
    return sorted(chain.from_iterable(others))


def others_beat(controls: Mapping[NodeKey, ErrorControl], key: NodeKey) -> list[tuple[int, int]]:
    """When each other node of the bus that sends heartbeats told a state first and last [ns]."""
    return [
        (control.beats[0].t_ns, control.last_beat_ns)
        for other, control in controls.items()
        if other[0] == key[0] and other != key and control.counts.heartbeats > ENOUGH
        if control.beats and control.last_beat_ns is not None
    ]


def booted_with(controls: Mapping[NodeKey, ErrorControl], key: NodeKey) -> list[int]:
    """When other nodes of the bus told that they started [ns]."""
    return sorted(
        beat.t_ns
        for other, control in controls.items()
        if other[0] == key[0] and other != key
        for beat in control.beats
        if beat.kind == "boot-up"
    )
