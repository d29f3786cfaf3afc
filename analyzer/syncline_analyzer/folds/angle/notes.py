"""Moments of a trace that a reader must know of, besides jumps and cuts."""

from dataclasses import replace
from itertools import pairwise
from math import ceil

import numpy as np

from syncline_analyzer.folds.angle.samples import Samples
from syncline_analyzer.folds.angle.state import Fast, TraceState
from syncline_analyzer.folds.angle.trace import AMBIGUOUS, Derived, Encoder, Tilt
from syncline_analyzer.folds.angle.untold import Apart
from syncline_analyzer.results import Trace
from syncline_schemas.devices import Device
from syncline_schemas.measurement import ambiguous_rpm

APART_NS = 1_000_000_000
"""Stretches no further apart are one."""
_AMBIGUOUS_BIT = AMBIGUOUS.bit_length() - 1


def note_frozen(state: TraceState, piece: Samples) -> None:
    """The first sample of each stretch in which a sibling moves and this one does not."""
    if piece.frozen is None:
        state.frozen = False
        return
    starts = np.flatnonzero(np.diff(piece.frozen.astype(np.int8), prepend=int(state.frozen)) > 0)
    state.frozen = bool(piece.frozen[-1])
    for row in starts.tolist():
        later = piece.frozen[row:] & (piece.source[row:] == piece.source[row])
        last = row + int(np.flatnonzero(later)[-1])
        lasted = (int(piece.t_ns[last]) - int(piece.t_ns[row])) / 1e9
        value = float(piece.raw[row])
        text = f"{int(later.sum())} equal values in {piece.source[row]:03X}h over {lasted:.4g} s"
        state.note("frozen", int(piece.seq[row]), int(piece.t_ns[row]), value, value, text)


def follow_fast(state: TraceState, piece: Samples, derived: Derived, limit_rpm: float) -> None:
    """Follow the stretches in which it turns faster than it may."""
    assert derived.speeds is not None
    rows, speed = derived.speeds.fast, derived.speeds.fast_rpm
    t_ns = piece.t_ns[rows]
    before_ns = -APART_NS - 1 if state.fast is None else state.fast.end_ns
    starts = np.flatnonzero(np.diff(t_ns, prepend=before_ns) > APART_NS).tolist()
    for begin, stop in pairwise([*sorted({0, *starts}), len(t_ns)]):
        if begin in starts:
            note_fast(state)
            row = int(rows[begin])
            state.fast = Fast(int(piece.seq[row]), int(t_ns[begin]), 0, 0.0, limit_rpm)
        assert state.fast is not None
        known = speed[begin:stop][np.isfinite(speed[begin:stop])]
        top_rpm = max(state.fast.top_rpm, float(known.max()) if len(known) else 0.0)
        state.fast = replace(state.fast, end_ns=int(t_ns[stop - 1]), top_rpm=top_rpm)


def note_fast(state: TraceState) -> None:
    """A stretch in which it turned faster than it may, once it is over."""
    fast = state.fast
    if fast is None:
        return
    state.fast = None
    text = (
        f"up to {fast.top_rpm:.4g} rpm within {(fast.end_ns - fast.start_ns) / 1e9:.4g} s; it may"
        f" turn {fast.limit_rpm:g} rpm"
    )
    state.note("too fast", fast.seq, fast.start_ns, None, fast.top_rpm, text)


def note_alarms(state: TraceState, piece: Samples, device: Device | None) -> None:
    """Bits that came up in an alarm or warning object."""
    raw = piece.raw[piece.valid]
    before = np.concatenate(([state.alarm_bits], raw[:-1]))
    seqs, stamps = piece.seq[piece.valid], piece.t_ns[piece.valid]
    for row in np.flatnonzero(raw & ~before).tolist():
        words = device.object(state.object >> 8, state.object & 0xFF) if device else None
        value = int(raw[row])
        text = words.describe(value) if words else ""
        state.note(
            "alarm", int(seqs[row]), int(stamps[row]), float(before[row]), float(value), text
        )
    if len(raw):
        state.alarm_bits = int(raw[-1])


def note_ambiguous(state: TraceState) -> None:
    """What the samples cannot tell, once per trace, where most of them cannot."""
    count = int(state.flag_counts[_AMBIGUOUS_BIT])
    if 2 * count < state.samples or not count or state.first_ns is None:
        return
    converter = state.converter
    text, untold = "", None
    if isinstance(converter, Encoder):
        untold = state.untold.most()
        text = _too_seldom(state, converter, untold)
    elif isinstance(converter, Tilt):
        text = _repeating(converter, state.last_value or 0.0)
    seq, t_ns = (untold.seq, untold.t_ns) if untold else (state.first_seq, state.first_ns)
    if text:
        state.note("ambiguous", seq, t_ns, None, state.last_value, text)


def _repeating(converter: Tilt, value: float) -> str:
    """What a 16-bit angle may be besides what it reads."""
    span = 65536 * converter.scale.deg_per_count
    low, high = converter.axis.low_deg, converter.axis.high_deg
    first = ceil((low - value) / span)
    same = [value + k * span for k in range(first, first + int((high - low) / span) + 1)]
    listed = ", ".join(f"{angle:.10g}" for angle in np.round(same, 6) if angle < high)
    return (
        f"16 bits at {converter.scale.deg_per_count:g} deg repeat every {span:g} deg, the last"
        f" value may be {listed} deg"
    )


def _too_seldom(state: TraceState, converter: Encoder, untold: Apart | None) -> str:
    scale, reach = converter.scale, converter.reach_counts
    usual_ns = min(state.link.spacing_ns.values(), default=0.0)
    spacing_ns = untold.spacing_ns if untold else usual_ns
    if not scale.counts_per_turn or not reach or not spacing_ns:
        return ""
    limit = ambiguous_rpm(reach, scale.counts_per_turn, spacing_ns / 1e9)
    state.told_below_rpm = limit
    return (
        f"samples every {spacing_ns / 1e6:.4g} ms tell direction and speed only below"
        f" {limit:.4g} rpm, the device may turn {scale.max_rpm:g} rpm"
    )


def cut_where_lost(state: TraceState, trace: Trace, start_ns: int, end_ns: int) -> None:
    """A line is not drawn through a stretch in which the node was LOST."""
    after = int(np.searchsorted(trace.t_ns, start_ns, side="right"))
    if not 0 < after < len(trace.t_ns) or trace.segment[after - 1] != trace.segment[after]:
        return
    trace.segment[after:] += 1
    state.segment += 1
    text = f"node lost for {(end_ns - start_ns) / 1e9:.4g} s"
    state.note("cut", int(trace.seq[after]), start_ns, None, None, text)


def note_gray(state: TraceState) -> None:
    """That the counts are in the wrong code, once per trace."""
    mismatch = state.gray.mismatch
    if mismatch is None or state.first_ns is None:
        return
    text = (
        "Gray code is read as binary counts"
        if mismatch == "gray"
        else "binary counts are converted as if they were Gray code"
    )
    state.note("gray code", state.first_seq, state.first_ns, None, None, text)
