"""Frames that a recorder wrote down twice count once; equal frames of a bus stay what they are."""

import pytest

from syncline_schemas.batch import FrameFlag
from tests.analyzer.control_runs import MS, Row
from tests.analyzer.whole_run import beats, every, found, severe, whole

STOP_MS = 20_000


def machine() -> list[Row]:
    """Three nodes, SYNC of 20 ms, PDOs that answer it, a guard request and SDO reads."""
    reads: list[Row] = []
    for at in range(2000, STOP_MS, 1000):
        reads += [
            (at * MS, 0, 0x605, 0, 8, bytes.fromhex("4041600000000000")),
            ((at + 2) * MS, 0, 0x585, 0, 8, bytes.fromhex("4B41600037020000")),
        ]
    emcy = (15_000 * MS, 0, 0x86, 0, 8, bytes.fromhex("1042090000000000"))
    return sorted(
        [
            *every(0x80, 1, STOP_MS, 20.003),
            *every(0x185, 2, STOP_MS, 20.003, b"\1\2"),
            *every(0x186, 2.4, STOP_MS, 20.003, b"\3\4"),
            *beats(5, 7, STOP_MS, 100.013),
            *beats(6, 11, STOP_MS, 200.021),
            *beats(7, 50, STOP_MS, 999.7),
            *reads,
            emcy,
        ],
        key=lambda row: row[0],
    )


def doubled(rows: list[Row], by_us: float, *cob_ids: int) -> list[Row]:
    """The rows with a copy of those of these identifiers (of all without any) right behind."""
    told: list[Row] = []
    for row in rows:
        told.append(row)
        if not cob_ids or row[2] in cob_ids:
            told.append((row[0] + round(by_us * 1000), *row[1:]))
    return told


@pytest.mark.triggers("capture.doubled")
@pytest.mark.parametrize("batch", [333, 100_000])
@pytest.mark.parametrize("by_us", [0, 20, 250])
def test_a_recording_in_which_every_frame_stands_twice_is_told_once(
    by_us: float, batch: int
) -> None:
    once, told = whole(machine()), whole(doubled(machine(), by_us), batch=batch)
    (finding,) = found(told, "capture.doubled")
    assert finding.text.startswith("Every frame of can0 stands twice")
    assert finding.severity == "warning"
    assert finding.evidence[:2] == [1, 3]
    assert told.capture.frames == 2 * once.capture.frames
    assert told.capture.extended_frames == 0
    assert [f.id for f in told.findings if f.id != "capture.doubled"] == [
        f.id for f in once.findings
    ]
    assert [row.count for row in told.sync] == [row.count for row in once.sync]
    assert [row.frames for row in told.pdos] == [row.frames for row in once.pdos]
    assert [(row.code, row.t_ns) for row in told.emcy] == [
        (row.code, row.t_ns) for row in once.emcy
    ]
    assert [row.result for row in told.sdo] == [row.result for row in once.sdo]
    assert told.bus_load[0].mean_percent == pytest.approx(once.bus_load[0].mean_percent, rel=1e-3)


@pytest.mark.parametrize(
    ("by_us", "cob_ids"), [(40, (0x80,)), (50, (0x605,)), (150, (0x80, 0x605))]
)
def test_an_echo_of_own_frames_is_a_note_and_accuses_nobody(
    by_us: float, cob_ids: tuple[int, ...]
) -> None:
    told = whole(doubled(machine(), by_us, *cob_ids))
    (finding,) = found(told, "capture.doubled")
    assert finding.severity == "info"
    assert [row.cob_ids for row in told.doubled] == [list(cob_ids)]
    assert severe(told) == severe(whole(machine()))


@pytest.mark.near_miss("capture.doubled")
@pytest.mark.parametrize("step_us", [300, 500, 900])
def test_equal_frames_of_a_fast_producer_are_no_copies(step_us: float) -> None:
    fast = every(0x285, 3000, 5000, step_us / 1000, b"\7\7\7")
    told = whole(machine(), fast)
    assert told.doubled == []
    assert next(row for row in told.pdos if row.cob_id == 0x285).frames == len(fast)


@pytest.mark.near_miss("capture.doubled")
def test_two_devices_with_one_node_id_that_answer_alike_are_no_copies() -> None:
    """The second answer follows the first on the wire: 8 bytes at 500 kbit/s take 222 us and more."""
    told = whole(doubled(machine(), 240, 0x585, 0x185, 0x705))
    assert told.doubled == []


def test_repeated_equal_frames_at_the_cycle_time_are_no_copies() -> None:
    """LIR-DA158 2800h: the same value k times, a cycle apart; and a request that is asked again."""
    repeated = [
        (round((start + 20.0 * k) * MS), 0, 0x287, 0, 2, bytes([n % 250, 1]))
        for n, start in enumerate(range(1000, STOP_MS, 100))
        for k in range(3)
    ]
    retries = [
        (round((start + 500 * k) * MS), 0, 0x607, 0, 8, bytes.fromhex("4000100000000000"))
        for start in range(1000, STOP_MS - 2000, 2000)
        for k in range(2)
    ]
    assert whole(machine(), repeated, retries).doubled == []


def test_stamps_of_bundles_tell_of_no_copies() -> None:
    """A recorder that hands over frames every 16 ms: two of an 8 ms SYNC come at once."""
    rows = sorted([*every(0x80, 1, 9000, 8), *every(0x185, 2, 9000, 8, b"\1")])
    at, bundled = 0, []
    for t_ns, *rest in rows:
        at = max(at + 30_000, -(-t_ns // (16 * MS)) * 16 * MS)
        bundled.append((at, *rest))
    assert whole(bundled, in_order=False).doubled == []  # type: ignore[arg-type]


def test_an_echo_marked_as_sent_counts_once() -> None:
    sent = int(FrameFlag.TX)
    rows = [
        (t, bus, can_id, sent if copy and can_id in (0x80, 0x605) else flags, dlc, data)
        for copy, (t, bus, can_id, flags, dlc, data) in enumerate(
            doubled(machine(), 40, 0x80, 0x605)
        )
    ]
    assert whole(rows).sync[0].count == whole(machine()).sync[0].count
