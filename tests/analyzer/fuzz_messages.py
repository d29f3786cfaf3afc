"""EMCY, errors, SDO transfers and PDOs: the tables against the truth."""

from collections import Counter
from collections.abc import Iterator

from syncline_analyzer.results import SdoRow
from syncline_samples.faults import (
    ExtraPdos,
    MoveSync,
    PdoOutsideOperational,
    SecondSyncProducer,
)
from syncline_samples.truth import BootUpTruth, EmcyTruth, PdoTruth
from syncline_schemas.batch import FrameFlag
from tests.analyzer.fuzz_case import MS, Case
from tests.analyzer.fuzz_rows import Row, Timed, clear, differences, twins


def emcys(case: Case) -> Iterator[str]:
    """Every EMCY is a row with its code, register, bits and transition."""
    true = [(t_ns, row) for t_ns, row in _emcy_rows(case) if case.heard(t_ns)]
    told = [
        (row.t_ns, (row.node, row.code, row.error_register, row.transition))
        for row in case.analysis.emcy
    ]
    yield from differences("EMCY", case, true, told)


def _emcy_rows(case: Case) -> Iterator[Timed]:
    """The error state machine of CiA 301 7.2.7.2, fed with what the recorder heard."""
    active: dict[int, set[int]] = {}
    for event in _error_events(case):
        errors = active.setdefault(event.node, set())
        if isinstance(event, BootUpTruth):
            if errors:
                yield event.t_ns, (event.node, None, None, "reset")
            errors.clear()
            continue
        if event.dlc < 8:
            code = event.code if event.dlc >= 2 else None
            yield event.t_ns, (event.node, code, None, "malformed")
            continue
        if event.code:
            transition = "further" if errors else "raised"
            errors.add(event.code)
        else:
            left = event.register or event.alarms or event.warnings
            transition = "partly cleared" if left else "all cleared"
            errors.intersection_update(event.active)
        yield event.t_ns, (event.node, event.code, event.register, transition)


def _error_events(case: Case) -> list[EmcyTruth | BootUpTruth]:
    events: list[EmcyTruth | BootUpTruth] = [*case.truth.emcy, *case.truth.boot_ups]
    heard = [event for event in events if case.heard(event.t_ns)]
    return sorted(heard, key=lambda event: event.t_ns)


def errors(case: Case) -> Iterator[str]:
    """Every error is a row with when it was raised and how it ended.

    Of nodes with errors that share their bits, where a clear does not tell which it ends, only those
    that are left must be told.
    """
    rows = case.analysis.errors
    open_ = {row.node for row in rows if not row.certain}
    true = [entry for entry in _error_rows(case) if entry[1][0] not in open_]
    told = [(r.raised_ns, (r.node, r.code, r.status)) for r in rows if r.node not in open_]
    yield from differences("error", case, true, told)
    active = {(row.node, row.code) for row in rows if row.status == "still active"}
    for _, (node, code, status) in _error_rows(case) if not case.deaf else ():
        if status == "still active" and node in open_ and (node, code) not in active:
            yield f"error {code} of node {node} is not told to be active"


def _error_rows(case: Case) -> Iterator[Timed]:
    active: dict[int, dict[int, int]] = {}
    for event in _error_events(case):
        errors = active.setdefault(event.node, {})
        if isinstance(event, BootUpTruth):
            gone, status = list(errors), "lost at reset"
        elif event.dlc < 8:
            continue
        elif event.code:
            errors.setdefault(event.code, event.t_ns)
            continue
        else:
            gone, status = [code for code in errors if code not in event.active], "cleared"
        for code in gone:
            yield errors.pop(code), (event.node, code, status)
    for node, left in active.items():
        for code, raised_ns in left.items():
            yield raised_ns, (node, code, "still active")


def sdo(case: Case) -> Iterator[str]:
    """Every transfer that was heard whole is a row; those around a gap are not looked at."""
    if case.deaf and case.steps:
        return
    true = [
        (
            each.start_ns,
            _sdo_row(
                each.node,
                each.index,
                each.sub,
                each.direction,
                each.kind,
                each.result,
                each.abort_code,
                each.data,
            ),
        )
        for each in case.truth.sdo
        if clear(case, each.start_ns, each.end_ns) and each.node not in twins(case)
    ]
    told = [
        (
            row.start_ns,
            _sdo_row(
                row.node,
                row.index,
                row.sub,
                row.direction,
                row.kind,
                row.result,
                row.abort_code,
                row.data,
            ),
        )
        for row in case.analysis.sdo
        if _clear_told(case, row.start_ns, row.end_ns)
        and not _unfinished(case, row)
        and row.node not in twins(case)
    ]
    yield from differences("SDO", case, true, told)


def _unfinished(case: Case, row: SdoRow) -> bool:
    """Whether a transfer runs at the end of the run: the client has not given it up."""
    waited_ns = case.stamp(case.at(case.scenario.seconds)) - row.start_ns
    return row.result not in ("ok", "abort") and waited_ns < 600 * MS


def _sdo_row(
    node: int,
    index: int | None,
    sub: int | None,
    direction: str,
    kind: str,
    result: str,
    code: int | None,
    data: bytes,
) -> Row:
    ended = "not answered" if result in ("no answer", "interrupted") else result
    return node, index, sub, direction, kind, ended, code, data if ended == "ok" else b""


def _clear_told(case: Case, start_ns: int, end_ns: int) -> bool:
    near = 600 * MS
    return not any(
        start_ns < case.stamp(end) + near and end_ns > case.stamp(start) - near
        for start, end in case.deaf
    )


def answer_times(case: Case) -> Iterator[str]:
    """From the end of the first request to the end of the first answer."""
    if case.steps:
        return
    told = {
        (row.node, row.index, row.sub, row.start_ns): row.answer_us for row in case.analysis.sdo
    }
    for each in case.truth.sdo:
        if each.answer_ns is None or not clear(case, each.start_ns, each.end_ns):
            continue
        took_us = (each.answer_ns - each.start_ns) / 1000
        near = [
            answer_us
            for (node, index, sub, start_ns), answer_us in told.items()
            if (node, index, sub) == (each.node, each.index, each.sub)
            and abs(start_ns - each.start_ns) <= case.slack_ns
        ]
        off = [us for us in near if us is None or abs(us - took_us) > 2 * case.slack_ns / 1000]
        if off and each.node not in twins(case):
            yield f"SDO answer of node {each.node} took {took_us} us, not {off}"


def responses(case: Case) -> Iterator[str]:
    """Shortest and longest time from a SYNC to the PDO that answers it.

    A PDO that the bus held back past the next SYNC is paired with that one: its frame does not tell
    which of the two it answers (analysis.md section 5).
    """
    if case.steps or case.deaf or any(isinstance(f, _UNCLEAR_SYNCS) for f in case.scenario.faults):
        return
    for row in case.analysis.pdos:
        true = [
            (pdo.end_ns - pdo.sync_ns) / 1000
            for pdo in case.truth.pdos
            if pdo.cob_id == row.cob_id and not _asked_for(case, pdo)
            if pdo.sync_ns is not None
        ]
        if row.response_us is None or not true or row.node in twins(case):
            continue
        if any(_past_next_sync(case, pdo) for pdo in case.truth.pdos if pdo.cob_id == row.cob_id):
            continue
        told = (row.response_us.min, row.response_us.max)
        slack_us = 2 * case.slack_ns / 1000 + 0.01
        if abs(told[0] - min(true)) > slack_us or abs(told[1] - max(true)) > slack_us:
            yield f"PDO {row.cob_id:03X}h answers in {told}, not {(min(true), max(true))} us"


def _past_next_sync(case: Case, pdo: PdoTruth) -> bool:
    """Whether another SYNC was on the bus between the one that a PDO answers and the PDO."""
    if pdo.sync_ns is None:
        return False
    syncs = case.frames.t_ns[case.frames.can_id == 0x80]
    after_ns = pdo.sync_ns + case.slack_ns
    return bool(((syncs > after_ns) & (syncs < pdo.end_ns - case.slack_ns)).any())


def _asked_for(case: Case, pdo: PdoTruth) -> bool:
    """Whether a PDO came on a request since its SYNC, or may have: nobody sees which one did."""
    frames = case.frames
    requests = frames.t_ns[(frames.can_id == pdo.cob_id) & ((frames.flags & FrameFlag.REMOTE) != 0)]
    if not len(requests):
        return False
    others = [
        each for each in case.truth.pdos if each.cob_id == pdo.cob_id and each.end_ns < pdo.end_ns
    ]
    before_ns = max((each.end_ns for each in others), default=0)
    waiting = bool(((requests > before_ns) & (requests < pdo.end_ns)).any())
    since_ns = pdo.sync_ns if pdo.sync_ns is not None else pdo.end_ns
    return waiting or any(each.sync_ns is None and each.end_ns > since_ns for each in others)


_UNCLEAR_SYNCS = (ExtraPdos, MoveSync, PdoOutsideOperational, SecondSyncProducer)
"""Faults by which a PDO may follow another SYNC, or the move of it, than the one it answers."""


def pdos(case: Case) -> Iterator[str]:
    """Frames of every PDO are counted under its identifier and node."""
    true = Counter((pdo.cob_id, pdo.node) for pdo in case.truth.pdos if case.heard(pdo.end_ns))
    outputs = 0x200 + case.scenario.rpdo_node
    told = {
        (row.cob_id, row.node): row.frames
        for row in case.analysis.pdos
        if not (case.scenario.rpdo_node and row.cob_id == outputs)
    }
    if dict(true) != told:
        yield f"PDO frames by identifier and node: {told} instead of {dict(true)}"
