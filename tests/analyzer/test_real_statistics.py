"""Periods, answers and worst cases of real captures against counts by a few plain lines."""

import csv
import gzip
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np
import pytest

from syncline_analyzer import open_session
from syncline_analyzer.results import Analysis

CAPTURES = Path(__file__).parents[3] / "shared" / "captures"
SEVCON = CAPTURES / "sevcon_20090331.candump.log.gz"
DELTAQ = CAPTURES / "deltaq_can1_log.csv"

Line = tuple[int, int, bytes]
"""(stamp [us], identifier, data) of a frame; its place in the list is its `seq`."""

_CANDUMP = re.compile(r"\((\d+)\.(\d{6})\) \S+ ([0-9A-F]{3})#([0-9A-F]*)")


def candump(path: Path) -> Iterator[Line]:
    with gzip.open(path, "rt", encoding="ascii") as lines:
        for line in lines:
            found = _CANDUMP.match(line)
            assert found is not None
            seconds, micros, can_id, data = found.groups()
            yield int(seconds) * 1_000_000 + int(micros), int(can_id, 16), bytes.fromhex(data)


def deltaq(path: Path) -> Iterator[Line]:
    with path.open(encoding="ascii", newline="") as file:
        for _, stamp, _, can_id, _, length, *data in csv.reader(file):
            seconds, micros = stamp.split(".")
            whole = bytes.fromhex(" ".join(data))
            assert len(whole) == int(length)
            yield int(seconds) * 1_000_000 + int(micros), int(can_id, 16), whole


def periods(lines: list[Line], can_id: int) -> list[tuple[int, int]]:
    """(period [us], `seq` of the frame that ends it)."""
    found, before = [], None
    for seq, (t_us, each, _) in enumerate(lines):
        if each == can_id:
            if before is not None:
                found.append((t_us - before, seq))
            before = t_us
    return found


@pytest.fixture(scope="module")
def sevcon() -> tuple[list[Line], Analysis]:
    if not SEVCON.exists():
        pytest.skip("the captures are not here")
    return list(candump(SEVCON)), open_session(SEVCON).analysis


@pytest.fixture(scope="module")
def charger() -> tuple[list[Line], Analysis]:
    if not DELTAQ.exists():
        pytest.skip("the captures are not here")
    return list(deltaq(DELTAQ)), open_session(DELTAQ).analysis


def test_every_pdo_of_a_drive(sevcon: tuple[list[Line], Analysis]) -> None:
    """38,000 periods each: the histograms, and the worst ones with their lines."""
    lines, analysis = sevcon
    assert len(analysis.pdos) == 5
    for row in analysis.pdos:
        every = periods(lines, row.cob_id)
        lengths = [length for length, _ in every]
        assert row.frames == len(lengths) + 1
        assert row.period_us is not None
        assert row.period_us.max == max(lengths)
        assert 0 < row.quantile_error <= 0.01
        assert row.period_us.median == pytest.approx(median(lengths), rel=row.quantile_error)
        assert row.period_us.p99 == pytest.approx(np.quantile(lengths, 0.99), rel=0.01)
        longest = [
            (each.value_us, each.seq)
            for each in analysis.worst
            if (each.cob_id, each.quantity, each.extreme) == (row.cob_id, "period", "longest")
        ]
        assert longest == sorted(every, key=lambda pair: (-pair[0], pair[1]))[:10]


def test_answers_of_a_drive_to_its_sync(sevcon: tuple[list[Line], Analysis]) -> None:
    """An answer is the first PDO after a SYNC.

    The first SYNCs of the log came from a backlog, and in its pauses both start again: what comes
    later than one and a half SYNC periods answers a SYNC that is not in the log.
    """
    lines, analysis = sevcon
    syncs = next(row for row in analysis.sync if row.cob_id == 0x80)
    assert syncs.count == sum(can_id == 0x80 for _, can_id, _ in lines)
    for row in analysis.pdos:
        waits: list[int] = []
        sync_us: int | None = None
        for t_us, can_id, _ in lines[200:]:
            if can_id == 0x80:
                sync_us = t_us
            elif can_id == row.cob_id and sync_us is not None:
                if t_us - sync_us < 30_000:
                    waits.append(t_us - sync_us)
                sync_us = None
        assert row.response_us is not None
        assert row.jitter_us is not None
        assert row.response_us.median == pytest.approx(median(waits), rel=0.01)
        low, high = np.quantile(waits, (0.01, 0.99))
        assert row.jitter_us.p99_p1 == pytest.approx(high - low, abs=0.01 * high)
        std = float(np.std(waits))
        if std < 100:
            assert row.jitter_us.std is None
        else:
            assert row.jitter_us.std == pytest.approx(std, rel=0.01)


def test_repeats_of_a_drive(sevcon: tuple[list[Line], Analysis]) -> None:
    lines, analysis = sevcon
    for row in analysis.pdos:
        data = [each for _, can_id, each in lines if can_id == row.cob_id]
        same = [a == b for a, b in pairwise(data)]
        runs = "".join("x" if each else " " for each in same).split()
        assert row.repeats == sum(same)
        assert row.longest_repeat == 1 + max(map(len, runs), default=0)


def test_heartbeats_and_cyclic_pdos_of_a_charger(charger: tuple[list[Line], Analysis]) -> None:
    lines, analysis = charger
    assert [row.node for row in analysis.error_control_periods] == [1, 10]
    for row in analysis.error_control_periods:
        every = periods(lines, 0x700 + row.node)
        lengths = np.array([length for length, _ in every])
        assert (row.kind, row.count, row.missing) == ("heartbeat", len(every) + 1, 0)
        assert row.period_us is not None
        assert row.jitter_us is not None
        assert (row.period_us.min, row.period_us.max) == (lengths.min(), lengths.max())
        assert row.period_us.median == pytest.approx(np.median(lengths))
        assert row.jitter_us.std == pytest.approx(lengths.std())
        assert row.jitter_us.max_min == pytest.approx(np.ptp(lengths))
        assert (row.worst_us, row.worst_seq) == max(every, key=lambda pair: (pair[0], -pair[1]))
    for pdo in analysis.pdos:
        lengths = np.array([length for length, _ in periods(lines, pdo.cob_id)])
        assert pdo.period_jitter_us is not None
        assert pdo.period_jitter_us.std == pytest.approx(lengths.std())
