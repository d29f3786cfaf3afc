"""Heartbeats on a full bus: kept waiting by other frames, or really missing."""

from collections.abc import Iterator

import pytest

from syncline_analyzer.results import Analysis
from syncline_samples.wire import wire_bits
from tests.analyzer.control_runs import MS, Row, frame, remote
from tests.analyzer.whole_run import beats, every, found, ids, severe, whole

BIT_MS = 1000 / 500_000
NODE = 5
WAITED, LOST = "nmt.heartbeat_waited", "nmt.node_lost"


def burst(start_ms: float, stop_ms: float, *, idle_every: int = 0) -> Iterator[Row]:
    """Frames back to back, stamped at their ends; every so many of them 40 bits of pause."""
    t_ms, number = start_ms, 0
    while t_ms < stop_ms:
        data = bytes([number & 0xFF, 1, 2, 3, 4, 5, 6, 7])
        number += 1
        t_ms += wire_bits(0x183, data) * BIT_MS
        yield (round(t_ms * MS), 0, 0x183, 0, 8, data)
        if idle_every and number % idle_every == 0:
            t_ms += 40 * BIT_MS


def behind(rows: list[Row]) -> float:
    """When the heartbeat that stands ready behind some frames has passed."""
    return rows[-1][0] / MS + wire_bits(0x700 + NODE, b"\x05") * BIT_MS


def bus(
    *further: Row, back_ms: float | None = None, since_ms: float = 1050, **how: object
) -> Analysis:
    """Node 5 falls silent at 1.0 s and comes back; node 3 sends a PDO now and then."""
    back_ms = behind(list(further)) if back_ms is None else back_ms
    rows = [
        *beats(NODE, 0, 1010),
        *beats(NODE, back_ms, 4000),
        *every(0x183, 3, since_ms - 1, 9.7, bytes(8)),
        *every(0x183, 1705, 4000, 9.7, bytes(8)),
        *further,
    ]
    return whole(rows, **how)  # type: ignore[arg-type]


@pytest.mark.triggers("nmt.heartbeat_waited")
@pytest.mark.near_miss("nmt.node_lost")
def test_a_heartbeat_that_waits_on_a_full_bus_accuses_the_bus() -> None:
    analysis = bus(*burst(1050, 1600))
    (finding,) = found(analysis, WAITED)
    assert (finding.severity, finding.node, finding.assumed) == ("warning", NODE, [])
    assert "up to 600.2 ms without one" in finding.text
    assert "100% busy" in finding.text
    assert "183h" in finding.cause
    assert "not the node" in finding.cause
    assert LOST not in ids(analysis)
    (row,) = [row for row in analysis.nmt_states if row.state == "LOST"]
    assert "its heartbeat had to wait" in row.cause


@pytest.mark.near_miss("nmt.heartbeat_waited")
@pytest.mark.triggers("nmt.node_lost")
@pytest.mark.parametrize(
    ("start_ms", "stop_ms", "back_ms", "idle_every"),
    [
        pytest.param(1050, 1600, 2400.1, 0, id="dead-on-a-full-bus-and-after-it"),
        pytest.param(1050, 1600, None, 12, id="bus-nearly-full"),
        pytest.param(1500, 1600, None, 0, id="lost-long-before-the-burst"),
        pytest.param(1050, 1250, 1600.1, 0, id="lost-on-after-the-burst"),
    ],
)
def test_a_node_that_had_the_bus_for_itself_was_lost(
    start_ms: float, stop_ms: float, back_ms: float | None, idle_every: int
) -> None:
    full = burst(start_ms, stop_ms, idle_every=idle_every)
    analysis = bus(*full, back_ms=back_ms, since_ms=start_ms)
    assert LOST in ids(analysis)
    assert WAITED not in ids(analysis)
    assert not any("had to wait" in row.cause for row in analysis.nmt_states)


def _half_full(start_ms: float, stop_ms: float) -> Iterator[Row]:
    """Pairs of frames back to back, the second one of any length, and 120 bits of pause."""
    t_ms, number = start_ms, 0
    while t_ms < stop_ms:
        number += 1
        first = bytes([number & 0xFF, number >> 8 & 0xFF, 2, 3, 4, 5, 6, 7])
        for can_id, data in ((0x183, first), (0x184, bytes([number * 7 & 0xFF] * (number % 5)))):
            t_ms += wire_bits(can_id, data) * BIT_MS
            yield (round(t_ms * MS), 0, can_id, 0, len(data), data)
        t_ms += 120 * BIT_MS


@pytest.mark.near_miss("nmt.heartbeat_waited")
@pytest.mark.parametrize("end_ms", [4_000, 25_000], ids=["in-one-block", "in-several"])
def test_a_bit_rate_that_is_told_too_low_excuses_no_node(end_ms: int) -> None:
    rows = [
        *beats(NODE, 0, 1010),
        *beats(NODE, 1600.1, end_ms),
        *_half_full(20, end_ms - 100),
    ]
    analysis = whole(rows, bitrate=250_000)
    assert {LOST, "bus.bitrate_contradicted"} <= set(ids(analysis))
    assert WAITED not in ids(analysis)
    assert not any("had to wait" in row.cause for row in analysis.nmt_states)


@pytest.mark.near_miss("nmt.heartbeat_waited")
def test_a_weaker_frame_that_gets_through_proves_the_node_silent() -> None:
    gap_ms = wire_bits(0x706, b"\x05") * BIT_MS
    first = list(burst(1050, 1500))
    end_ms = first[-1][0] / MS
    other = frame(end_ms + gap_ms, 0x706, "05")
    analysis = bus(*first, other, *burst(end_ms + gap_ms, 1600))
    assert LOST in ids(analysis)
    assert WAITED not in ids(analysis)


@pytest.mark.near_miss("nmt.heartbeat_waited")
def test_a_node_that_boots_after_a_full_bus_was_not_kept_waiting() -> None:
    full = list(burst(1050, 1600))
    boot = frame(behind(full), 0x700 + NODE, "00")
    analysis = bus(*full, boot, back_ms=1700.1)
    assert WAITED not in ids(analysis)
    assert severe(analysis)


@pytest.mark.triggers("nmt.heartbeat_waited")
def test_a_bus_that_is_full_up_to_the_end_leaves_open_whether_the_node_is_there() -> None:
    rows = [*beats(NODE, 0, 1010), *every(0x183, 3, 1049, 9.7, bytes(8)), *burst(1050, 2000)]
    analysis = whole(rows)
    (finding,) = found(analysis, WAITED)
    assert "is not known" in finding.text
    assert LOST not in ids(analysis)


@pytest.mark.triggers("nmt.heartbeat_waited")
def test_an_estimated_bit_rate_is_said_to_be_one() -> None:
    analysis = bus(*burst(1050, 1600), bitrate=None)
    assert analysis.bus_load[0].bitrate_source == "estimated"
    (finding,) = found(analysis, WAITED)
    assert any("500 kbit/s (estimated" in line for line in finding.assumed)


@pytest.mark.triggers("nmt.heartbeat_waited")
@pytest.mark.parametrize("batch", [100, 777, 10_000])
def test_it_holds_across_batches_and_coarse_stamps(batch: int) -> None:
    rows = [(t_ns // MS * MS, *rest) for t_ns, *rest in burst(1050, 1600)]
    analysis = bus(*rows, back_ms=1600, batch=batch, resolution_ns=MS)  # type: ignore[arg-type]
    assert WAITED in ids(analysis)
    assert LOST not in ids(analysis)


@pytest.mark.near_miss("nmt.heartbeat_waited")
def test_coarse_stamps_do_not_hide_a_node_that_was_lost() -> None:
    rows = [(t_ns // MS * MS, *rest) for t_ns, *rest in burst(1050, 1600, idle_every=12)]
    analysis = bus(*rows, back_ms=1600, resolution_ns=MS)  # type: ignore[arg-type]
    assert LOST in ids(analysis)
    assert WAITED not in ids(analysis)


@pytest.mark.near_miss("nmt.heartbeat_waited")
def test_a_guarded_node_must_answer_before_the_next_request() -> None:
    """A request loses against the answer, so the second one proves that none stood ready."""
    answers = [
        row
        for k in range(40)
        for row in (
            remote(k * 100, 0x700 + NODE),
            *(
                [frame(k * 100 + 1, 0x700 + NODE, "05" if k % 2 else "85")]
                if k < 11 or k > 16
                else []
            ),
        )
    ]
    filler = [row for row in burst(1150, 1600) if (row[0] / MS) % 100 > 1]
    analysis = whole([*answers, *every(0x183, 3, 4000, 9.7, bytes(8)), *filler])
    assert WAITED not in ids(analysis)
    assert LOST in ids(analysis)


@pytest.mark.near_miss("nmt.heartbeat_waited")
def test_without_a_bit_rate_nothing_is_said_of_waiting() -> None:
    rows = [(t_ns // (20 * MS) * 20 * MS, *rest) for t_ns, *rest in burst(1050, 1600)]
    analysis = bus(*rows, bitrate=None, resolution_ns=20 * MS)  # type: ignore[arg-type]
    assert WAITED not in ids(analysis)


def test_a_consumer_that_misses_such_a_node_is_told_of_the_bus() -> None:
    full = list(burst(1050, 1600))
    watch = [
        frame(20, 0x609, "23161001960005 00".replace(" ", "")),
        frame(21, 0x589, "6016100100000000"),
    ]
    error = frame(1600.9, 0x89, "3081110000000000")
    analysis = bus(*watch, error, *full)
    told = [f for f in analysis.findings if "nmt.guarding_lost" in (f.id, *(c.id for c in f.chain))]
    assert told
    assert not any("supply, cable" in f.check_next + f.cause for f in told)


@pytest.mark.near_miss("nmt.node_lost")
def test_heartbeats_that_stood_in_line_are_no_period() -> None:
    """A controller with a queue sends what it kept at once: 50 ms is the period, not 0.5 ms."""
    rows: list[Row] = []
    for start_ms in range(0, 4000, 1000):
        rows += [frame(start_ms + 0.5 * k, 0x700 + NODE, "05") for k in range(12)]
        rows += beats(NODE, start_ms + 50, start_ms + 450, 50)
    analysis = whole(rows, every(0x183, 3, 4000, 9.7, bytes(8)))
    (node,) = [row for row in analysis.nodes if row.node == NODE]
    assert node.heartbeat_period_ms == pytest.approx(50, abs=1)
    losses = [row for row in analysis.nmt_states if (row.node, row.state) == (NODE, "LOST")]
    assert all(row.end_ns - row.start_ns > 400 * MS for row in losses)
