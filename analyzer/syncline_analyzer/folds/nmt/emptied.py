"""Heartbeats that a remote frame has emptied, and the restarts that alone end that."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence

from syncline_analyzer.context import Context
from syncline_analyzer.folds.bus.clock import ClockTable
from syncline_analyzer.folds.nmt.events import Beat
from syncline_analyzer.folds.nmt.quiet import OFF_NS
from syncline_analyzer.folds.nmt.timeout import PRODUCER_TIME
from syncline_schemas.devices import quirks

RUN = 3
"""So many bytes 00h in a row, and nothing else, may be empty heartbeats."""
ON_TIME = 0.1
"""Part of its period by which a heartbeat may come early or late."""
NO_BOOT_NS = 20_000_000
"""No device starts anew within so short a time after another frame of its own [ns]."""
SOON = 2
"""So many of them show that none of an even run is a boot-up."""
START_NS = 3_000_000_000
"""Nodes of a machine that is switched on start within this time of one another [ns]."""
RESUMED_PERIODS = 2
"""States that last so many periods are told again; between the empty ones of another device they
do not."""


def never_booted(
    beats: Sequence[Beat],
    gaps: Sequence[int],
    resets: Sequence[int],
    period_ns: int | None,
    writes: Sequence[int] = (),
) -> list[Beat]:
    """The empty heartbeats of a node among its messages that look like boot-ups.

    The remote frame that emptied them may lie in a gap, or before the first frame; some recorders
    hold no remote frames at all. They keep the period of its heartbeat then, or come too soon after
    another frame of the node for it to have started in between.

    Args:
        beats: messages in order of `seq`: each change, and every byte 00h taken for a boot-up.
        gaps: `seq` of the first frame, and of the first ones after gaps, ascending.
        resets: `seq` of reset commands, ascending.
        period_ns: of its heartbeat, None where it is not known.
        writes: times of writes of 1017h, ascending, from which on it counts the period anew.
    """
    found: list[Beat] = []
    before = -1
    for run in _runs(beats, resets):
        first = run[0].seq
        if not (found and found[-1].seq == _seq_before(beats, first)):
            before = _seq_before(beats, first)
        at = bisect_right(gaps, first)
        hidden = at > 0 and gaps[at - 1] > before
        write = bisect_left(writes, run[1].t_ns) - 1
        begin_ns = max(run[0].t_ns, writes[write]) if write >= 0 else run[0].t_ns
        passed = run[1].t_ns - begin_ns
        usual = period_ns is not None and abs(passed - period_ns) <= ON_TIME * period_ns
        soon = sum(0 <= beat.t_ns - beat.previous_ns <= NO_BOOT_NS for beat in run[1:])
        if (hidden and usual) or soon >= SOON:
            found.extend(beat._replace(kind="empty") for beat in run)
    return found


def _seq_before(beats: Sequence[Beat], seq: int) -> int:
    """The `seq` of the last message before another one, -1 without any."""
    at = bisect_left(beats, seq, key=lambda beat: beat.seq)
    return beats[at - 1].seq if at else -1


def _runs(beats: Sequence[Beat], resets: Sequence[int]) -> Iterator[list[Beat]]:
    """Bytes 00h in a row at even intervals, without a reset command between them."""
    run: list[Beat] = []
    for beat in [*beats, None]:
        if beat is not None and _goes_on(run, beat, resets):
            run.append(beat)
            continue
        if len(run) >= RUN:
            yield run
        run = [beat] if beat is not None and _is_zero(beat) else []


def _goes_on(run: Sequence[Beat], beat: Beat, resets: Sequence[int]) -> bool:
    if not run or not _is_zero(beat):
        return False
    if bisect_left(resets, run[-1].seq) != bisect_left(resets, beat.seq):
        return False
    usual = run[1].t_ns - run[0].t_ns if len(run) > 1 else beat.t_ns - run[0].t_ns
    return abs(beat.t_ns - run[-1].t_ns - usual) <= ON_TIME * usual


def _is_zero(beat: Beat) -> bool:
    return beat.kind == "boot-up" and not beat.state


def restarted(
    context: Context,
    place: tuple[int, int],
    beats: Sequence[Beat],
    breaks: Sequence[tuple[int, int]],
    period_ns: int,
    end_ns: int,
    *,
    zeros: bool,
) -> list[Beat]:
    """The boot-ups of a node among its messages that look like empty heartbeats, or like states.

    A heartbeat that a remote frame has emptied stays so until the device starts anew (sheet
    skbis-lir-canopen.md): where states come again, the last byte 00h before them was the boot-up,
    or, of a device that boots with a state, the first of them.

    Args:
        place: bus number and node.
        beats: messages in order of `seq`: each change, and the last empty one before a state.
        breaks: (seq, t_ns) of gaps and reset commands, which may hide or explain a restart.
        period_ns: of its heartbeat.
        end_ns: of the capture.
        zeros: whether its empty heartbeats carry a byte 00h.
    """
    found: list[Beat] = []
    booted: Beat | None = None
    for at, beat in enumerate(beats):
        if beat.kind == "boot-up":
            booted = beat
        following = beats[at + 1] if at + 1 < len(beats) else None
        if beat.kind != "empty" or following is None or following.kind != "heartbeat":
            continue
        if not _stays(beats[at + 1 :], breaks, beat.seq, RESUMED_PERIODS * period_ns, end_ns):
            continue
        boot_bytes = quirks(context.shadow.device(*place)).bootup_bytes
        plain = not any(boot_bytes) or (
            booted is not None and boots_with_00h(context, place, booted.seq, booted.state)
        )
        if plain and zeros:
            booted = beat._replace(kind="boot-up")
        elif not plain and following.state in boot_bytes:
            booted = following._replace(kind="boot-up")
        else:
            continue
        found.append(booted)
    return found


def powered_on(
    context: Context,
    place: tuple[int, int],
    beats: Sequence[Beat],
    others_anew: Sequence[int],
    clock: ClockTable,
) -> list[Beat]:
    """The boot-ups among the empty heartbeats of a node that was off with the whole machine.

    Nobody was heard for long enough before them, and another node tells its start as well.

    Args:
        place: bus number and node.
        beats: messages in order of `seq`.
        others_anew: times of the boot-ups of the other nodes, ascending [ns].
        clock: silences of the buses.
    """
    found: list[Beat] = []
    boots = [beat for beat in beats if beat.kind == "boot-up"]
    for beat in beats:
        if beat.kind != "empty" or beat.t_ns - beat.previous_ns < OFF_NS:
            continue
        at = bisect_left(others_anew, beat.previous_ns)
        if at == len(others_anew) or others_anew[at] > beat.t_ns + START_NS:
            continue
        silence = clock.silence_within(place[0], beat.previous_ns, beat.t_ns)
        booted = next((each for each in reversed(boots) if each.seq < beat.seq), None)
        plain = not any(quirks(context.shadow.device(*place)).bootup_bytes) or (
            booted is not None and boots_with_00h(context, place, booted.seq, booted.state)
        )
        if plain and silence is not None and silence.end_ns - silence.start_ns >= OFF_NS:
            found.append(beat._replace(kind="boot-up"))
    return found


def _stays(
    states: Sequence[Beat],
    breaks: Sequence[tuple[int, int]],
    empty_seq: int,
    least_ns: int,
    end_ns: int,
) -> bool:
    """Whether the node goes on to tell states, with nothing between the last empty one and them."""
    first = states[0]
    at = bisect_right(breaks, (empty_seq, 1 << 63))
    if at < len(breaks) and breaks[at][0] <= first.seq:
        return False
    again = next((beat.t_ns for beat in states if beat.kind == "empty"), end_ns)
    until_ns = min(again, breaks[at][1]) if at < len(breaks) else again
    return until_ns - first.t_ns >= least_ns


def boots_with_00h(context: Context, place: tuple[int, int], boot_seq: int, byte: int) -> bool:
    """Whether a node that booted so once still boots with 00h: 1017h was not stored since.

    LIR protocol manual, sheet skbis-lir-canopen.md trap 1.
    """
    if byte:
        return False
    objects = dict(context.shadow.history(*place))
    known = objects.get((PRODUCER_TIME, 0))
    saved = known.saved if known is not None else None
    return not (saved is not None and saved.value and (saved.seq or 0) > boot_seq)
