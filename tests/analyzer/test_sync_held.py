"""SYNC that is not missing: the master holds its nodes, the recorder bundles, its clock was set."""

import pytest

from tests.analyzer.control_runs import MS, Row
from tests.analyzer.whole_run import beats, every, found, ids, whole, write

STOP_MS = 60_000


def command(t_ms: float, specifier: int, node: int = 0) -> list[Row]:
    """An NMT command."""
    return [(round(t_ms * MS), 0, 0, 0, 2, bytes([specifier, node]))]


def nodes() -> list[Row]:
    """Heartbeats of three nodes."""
    return [
        *beats(5, 7, STOP_MS, 100.013),
        *beats(6, 11, STOP_MS, 200.021),
        *beats(7, 50, STOP_MS, 999.7),
    ]


def away(start_ms: float, stop_ms: float) -> list[Row]:
    """SYNC of 20 ms with a PDO that answers, off from one moment to another."""
    rows = [*every(0x80, 1, STOP_MS, 20.003), *every(0x185, 2, STOP_MS, 20.003, b"\1\2")]
    return [row for row in rows if not start_ms * MS <= row[0] < stop_ms * MS]


@pytest.mark.near_miss("sync.missing")
@pytest.mark.parametrize("specifier", [0x02, 0x80, 0x81, 0x82])
@pytest.mark.parametrize("began_ms", [-60, 0, 1500])
def test_sync_may_be_off_while_the_master_holds_all_nodes(specifier: int, began_ms: float) -> None:
    told = whole(
        nodes(), away(30_000 + began_ms, 40_100), command(30_000, specifier), command(39_940, 1)
    )
    assert "sync.missing" not in ids(told)
    assert told.sync[0].missing == 0


@pytest.mark.triggers("sync.missing")
@pytest.mark.parametrize(
    "commands",
    [
        [],
        [*command(30_000, 0x02, 5), *command(39_940, 1)],
        [*command(20_000, 0x02), *command(21_000, 1)],
        [*command(36_000, 0x02), *command(39_940, 1)],
        [*command(30_000, 0x02), *command(35_000, 1)],
    ],
    ids=["nobody said so", "one node stopped", "long before", "stopped later", "started long ago"],
)
def test_sync_that_stays_away_otherwise_is_missing(commands: list[Row]) -> None:
    told = whole(nodes(), away(30_000, 40_100), commands)
    assert "sync.missing" in ids(told)


@pytest.mark.near_miss("sync.missing")
@pytest.mark.parametrize("written_ms", [29_950, 30_000])
@pytest.mark.parametrize("off", [(0x1005, 0x80), (0x1006, 0)])
def test_sync_may_be_off_while_it_moves_to_another_producer(
    written_ms: float, off: tuple[int, int]
) -> None:
    produced = [*write(100, 5, 0x1006, 0, 20_000), *write(200, 5, 0x1005, 0, 0x40000080)]
    taken_over = write(30_400, 6, 0x1005, 0, 0x40000080)
    told = whole(
        nodes(), away(29_990, 30_420), produced, write(written_ms, 5, off[0], 0, off[1]), taken_over
    )
    assert "sync.missing" not in ids(told)
    assert told.sync[0].missing == 0


@pytest.mark.triggers("sync.missing")
def test_sync_that_stays_away_while_a_node_that_never_sent_it_is_set_is_missing() -> None:
    produced = [*write(100, 5, 0x1006, 0, 20_000), *write(200, 5, 0x1005, 0, 0x40000080)]
    told = whole(nodes(), away(29_990, 30_420), produced, write(30_000, 6, 0x1005, 0, 0x80))
    assert "sync.missing" in ids(told)
    late = whole(nodes(), away(29_990, 30_420), produced, write(29_000, 5, 0x1005, 0, 0x80))
    assert "sync.missing" in ids(late)


def handed_over(rows: list[Row], every_ms: float, apart_us: float) -> list[Row]:
    """The rows with the stamps of a recorder that hands over what it has once in a while."""
    last, told = -1, []
    for t_ns, *rest in sorted(rows, key=lambda row: row[0]):
        last = max(
            last + round(apart_us * 1000), (t_ns // round(every_ms * MS) + 1) * round(every_ms * MS)
        )
        told.append((last, *rest))
    return told  # type: ignore[return-value]


@pytest.mark.near_miss("sync.missing")
@pytest.mark.near_miss("sync.jitter")
@pytest.mark.parametrize(
    ("every_ms", "apart_us"), [(16, 20), (16, 0), (50, 20), (50, 1), (100, 20)]
)
def test_a_recorder_that_bundles_loses_no_sync(every_ms: float, apart_us: float) -> None:
    rows = [*nodes(), *away(0, 0), *every(0x186, 2.3, STOP_MS, 20.003, b"\1")]
    told = whole(handed_over(rows, every_ms, apart_us), in_order=False)
    assert ids(told) & {"sync.missing", "sync.jitter", "sync.two_producers"} == set()


def test_a_long_hole_is_found_in_bundles_too() -> None:
    rows = [*nodes(), *away(30_000, 34_000), *every(0x186, 2.3, STOP_MS, 20.003, b"\1")]
    (finding,) = found(whole(handed_over(rows, 16, 20), in_order=False), "sync.missing")
    assert finding.end_ns - finding.start_ns == pytest.approx(4000 * MS, rel=0.02)


def test_sync_that_the_host_kept_for_a_while_is_not_missing() -> None:
    """A stall of 130 ms, then everything at once: no frame is missing."""
    rows: list[Row] = []
    last = 0
    for t_ns, *rest in sorted([*nodes(), *away(0, 0)], key=lambda row: row[0]):
        stalled = (t_ns // (7000 * MS)) * 7000 * MS
        at = stalled + 130 * MS if stalled and t_ns - stalled < 130 * MS else t_ns
        last = max(last + 30_000, at)
        rows.append((last, *rest))  # type: ignore[arg-type]
    assert "sync.missing" not in ids(whole(rows, in_order=False))


@pytest.mark.triggers("clock.step_forward")
def test_a_small_step_of_the_clock_blames_nobody() -> None:
    rows = sorted([*nodes(), *away(0, 0), *every(0x186, 2.3, STOP_MS, 20.003, b"\1")])
    shifted = [(t + 120 * MS * (t >= 30_000 * MS), *rest) for t, *rest in rows]
    told = whole(shifted, in_order=False)  # type: ignore[arg-type]
    assert ids(told) == {"clock.step_forward"}


@pytest.mark.near_miss("clock.step_forward")
def test_a_short_silence_of_the_sync_producer_is_no_step() -> None:
    told = whole(nodes(), away(30_000, 30_130), every(0x186, 2.3, STOP_MS, 20.003, b"\1"))
    assert "clock.step_forward" not in ids(told)
    assert "sync.missing" in ids(told)


@pytest.mark.near_miss("bus.silent")
@pytest.mark.parametrize("syncs", [True, False])
def test_a_host_that_stalls_and_delivers_all_of_it_is_no_silence(syncs: bool) -> None:
    """Frames 30 us apart: no wire carries them so fast, the recorder had kept them."""
    rows: list[Row] = []
    last = 0
    for t_ns, *rest in sorted([*nodes(), *(away(0, 0) if syncs else [])], key=lambda row: row[0]):
        stalled = (t_ns // (7000 * MS)) * 7000 * MS
        at = stalled + 450 * MS if stalled and t_ns - stalled < 450 * MS else t_ns
        last = max(last + 30_000, at)
        rows.append((last, *rest))  # type: ignore[arg-type]
    assert ids(whole(rows, in_order=False)) & {"bus.silent", "clock.step_forward"} == set()


@pytest.mark.triggers("bus.silent")
def test_a_bus_that_goes_on_where_it_is_was_silent() -> None:
    rows = [*nodes(), *away(0, 0)]
    told = whole([row for row in rows if not 30_000 * MS <= row[0] < 31_530 * MS])
    assert "bus.silent" in ids(told)
