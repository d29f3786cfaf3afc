"""Where the bit rate of a bus comes from, and what is told of it."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from syncline_analyzer.bit_rates import HOLD_FRAMES, BitRates
from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.context import Context
from syncline_analyzer.engine import analyze
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.preparing import Step
from syncline_analyzer.results import Analysis
from syncline_analyzer.session import open_session
from syncline_analyzer.shadow import Shadow
from syncline_analyzer.spacings import SPAN_FRAMES, SpacingGauge
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.description import BusDescription
from tests.analyzer.timing_builder import MS, SECOND, T0, US, frame, ordered, regular
from tests.analyzer.whole_run import found, severe
from tests.analyzer.wire_builder import Ready, arbitrated, machine, recorded

Part = FrameBatch | Gap
BUSY = machine(250_000, 0.5, 3000)


def traffic(bitrate: int = 250_000, *, start_ns: int = T0, step_ns: int = 1000) -> FrameBatch:
    """A busy bus, stamped to the microsecond."""
    ready = BUSY if bitrate == 250_000 else machine(bitrate, 0.5, 3000)
    return recorded(arbitrated(ready, bitrate), step_ns, start_ns=start_ns)


def numbered(parts: Sequence[Part]) -> Iterator[tuple[int, Part]]:
    seq = 0
    for part in parts:
        yield seq, part
        seq += len(part) if isinstance(part, FrameBatch) else 0


def told(
    *parts: Part,
    description: str = "",
    bitrate: int | None = None,
    recorded_rate: int | None = None,
    buses: tuple[str, ...] = ("can0",),
) -> Analysis:
    """The analysis of these parts with a bit rate from these places."""
    facts = CaptureFacts(Path("run.log"), "test", list(buses), resolution_ns=1000)
    if recorded_rate:
        facts.bitrates["can0"] = recorded_rate
    return analyze(
        numbered(parts),
        [facts],
        list(buses),
        description=BusDescription.loads(description),
        devices={},
        bitrate=bitrate,
    )


DESCRIBED = "[bus.can0]\nbitrate = 250000\n"


@pytest.mark.parametrize(
    ("description", "recorded_rate", "bitrate", "source"),
    [
        (DESCRIBED, 500_000, 125_000, "bus-description"),
        ("", 250_000, 125_000, "recorded"),
        ("", None, 250_000, "command-line"),
        ("", None, None, "estimated"),
    ],
)
def test_who_is_believed(
    description: str, recorded_rate: int | None, bitrate: int | None, source: str
) -> None:
    analysis = told(
        traffic(), description=description, recorded_rate=recorded_rate, bitrate=bitrate
    )
    (row,) = analysis.bus_load
    assert (row.bitrate, row.bitrate_source) == (250_000, source)
    assert row.bitrate_confidence == ("high" if source == "estimated" else "told")
    assert row.bitrate_estimate == 250_000
    assert row.mean_percent == pytest.approx(50, rel=0.2)
    estimated = [note for note in analysis.capture.notes if "estimated as 250 kbit/s" in note]
    assert bool(estimated) == (source == "estimated")


def test_an_estimate_gives_the_same_figures_as_the_told_bit_rate() -> None:
    """Nothing is measured before the bit rate is known."""
    one, other = told(traffic()), told(traffic(), bitrate=250_000)
    assert one.pdos == other.pdos
    assert one.sync == other.sync
    assert [row.load_percent for row in one.bus_shares] == [
        row.load_percent for row in other.bus_shares
    ]


@pytest.mark.parametrize(("early_bits", "told_so"), [(0, False), (1, True)])
def test_stamps_of_the_start_of_frames_are_told(early_bits: int, told_so: bool) -> None:
    sent = [
        each._replace(end_ns=each.end_ns - early_bits * (each.bits - 3) * 4000)
        for each in arbitrated(BUSY, 250_000)
    ]
    notes = told(recorded(sent, 1000, start_ns=T0), bitrate=250_000).capture.notes
    assert any("the start of its frames" in note for note in notes) == told_so


def test_a_guess_is_told_but_not_used() -> None:
    """A dozen frames back to back are too few."""
    few = recorded(arbitrated(BUSY, 250_000)[:15], 1000, start_ns=T0)
    analysis = told(few)
    (row,) = analysis.bus_load
    assert (row.bitrate, row.mean_percent) == (None, None)
    assert (row.bitrate_estimate, row.bitrate_confidence) == (250_000, "low")
    assert row.bitrate_source is None
    (note,) = (note for note in analysis.capture.notes if "bit rate" in note)
    assert "hint at 250 kbit/s" in note
    assert "--bitrate" in note


def test_frames_far_apart_tell_nothing() -> None:
    rows = [frame(t, 0x701, b"\5") for t in regular(600, 100 * MS)]
    analysis = told(ordered(rows))
    assert analysis.bus_load[0].bitrate is None
    assert analysis.bus_load[0].bitrate_confidence is None
    assert not [note for note in analysis.capture.notes if "bit rate" in note]


def test_spacings_over_gaps_and_error_frames_and_back_do_not_count() -> None:
    """The capture is torn every 100 frames: nothing that lies between the pieces is a spacing."""
    whole = traffic()
    parts: list[Part] = []
    for at in range(0, len(whole), 100):
        piece = whole[at : at + 100]
        parts.append(piece)
        parts.append(Gap(int(piece.t_ns[-1]), int(piece.t_ns[-1]) + 1, "adapter lost"))
    torn = told(*parts)
    assert torn.bus_load[0].bitrate == 250_000
    back = told(traffic(), traffic(start_ns=T0 - SECOND))
    assert back.bus_load[0].bitrate == 250_000


def test_error_frames_between_frames_do_not_count() -> None:
    """A node sends an error frame 20 us before every fourth frame: such a spacing is none."""
    good = traffic()
    flags = int(FrameFlag.ERROR)
    rows = [(int(good.t_ns[k]) - 20 * US, 0, 8, flags, 8, bytes(8)) for k in range(0, len(good), 4)]
    rows += [
        (int(good.t_ns[k]), 0, int(good.can_id[k]), 0, int(good.dlc[k]), good.payload(k))
        for k in range(len(good))
    ]
    assert told(ordered(rows)).bus_load[0].bitrate == 250_000


def test_frames_that_stand_twice_count_once() -> None:
    """A recorder that writes its own echo of every frame 30 us later."""
    good = traffic()
    twice = FrameBatch.concat(
        [
            good,
            FrameBatch(good.t_ns + 30 * US, good.bus, good.can_id, good.flags, good.dlc, good.data),
        ]
    )
    order = twice.t_ns.argsort(kind="stable")
    analysis = told(twice[order])
    assert analysis.doubled
    assert analysis.bus_load[0].bitrate in (250_000, None)


def test_each_bus_has_its_own() -> None:
    one, other = traffic(), traffic(500_000)
    second = FrameBatch(other.t_ns, other.bus + 1, other.can_id, other.flags, other.dlc, other.data)
    both = FrameBatch.concat([one, second])
    analysis = told(both[both.t_ns.argsort(kind="stable")], buses=("can0", "can1"))
    assert [row.bitrate for row in analysis.bus_load] == [250_000, 500_000]


def test_the_stream_is_held_back_no_longer_than_needed_and_complete() -> None:
    rows = FrameBatch.from_rows([frame(t, 0x701, b"\5") for t in regular(5000, 100 * MS)])
    gauge = SpacingGauge(timed=True)
    parts = [
        Step((k + 1) * 5000, [], spacings=gauge.measured(IndexedBatch(rows, k * 5000)))
        for k in range(80)
    ]
    parts.append(Step(400_000, [], last=True))
    facts = CaptureFacts(Path("x"), "test", ["can0"])
    context = Context(["can0"], Shadow(lambda bus: "can0"))
    taken = 0

    def stream() -> Iterator[Step]:
        nonlocal taken
        for part in parts:
            taken += 1
            yield part

    settled = BitRates(context, [facts], None, None).settled(stream())
    first = next(settled)
    assert taken * 5000 <= HOLD_FRAMES + 5000
    assert [first, *settled] == parts


def test_nothing_is_held_back_where_the_bit_rate_is_told() -> None:
    rows = FrameBatch.from_rows([frame(t, 0x701, b"\5") for t in regular(SPAN_FRAMES, MS)])
    facts = CaptureFacts(Path("x"), "test", ["can0"])
    context = Context(["can0"], Shadow(lambda bus: "can0"))
    gauge = SpacingGauge(timed=True)
    parts = [
        Step(at + len(rows), [], spacings=gauge.measured(IndexedBatch(rows, at)))
        for at in (0, len(rows))
    ]
    settled = BitRates(context, [facts], 500_000, None).settled(iter(parts))
    assert next(settled) is parts[0]


def test_a_bus_that_comes_too_late_is_told_but_not_measured() -> None:
    rows = FrameBatch.from_rows([frame(t, 0x701, b"\5") for t in regular(9000, 100 * MS)])
    early = [
        FrameBatch(
            rows.t_ns + k * 900 * SECOND, rows.bus, rows.can_id, rows.flags, rows.dlc, rows.data
        )
        for k in range(36)
    ]
    late = traffic(start_ns=T0 + 36 * 900 * SECOND)
    late = FrameBatch(late.t_ns, late.bus + 1, late.can_id, late.flags, late.dlc, late.data)
    analysis = told(*early, late, buses=("can0", "can1"))
    row = analysis.bus_load[1]
    assert (row.bitrate, row.bitrate_estimate) == (None, 250_000)
    assert any("came too late" in note for note in analysis.capture.notes)


@pytest.mark.triggers("bus.bitrate_contradicted")
def test_a_wrong_bit_rate_is_contradicted() -> None:
    analysis = told(traffic(), description="[bus.can0]\nbitrate = 500000\n")
    (finding,) = found(analysis, "bus.bitrate_contradicted")
    assert finding.severity == "warning"
    assert "500 kbit/s" in finding.text
    assert "250 kbit/s" in finding.text
    assert analysis.bus_load[0].bitrate == 500_000


def answered(bitrate: int, count: int = 400) -> FrameBatch:
    """A SYNC every 10 ms, and four nodes that answer it one behind the other."""
    ready = [
        Ready(k * 10e6 + late, can_id, bytes([k & 0xFF, can_id & 0xFF] * size))
        for k in range(count)
        for can_id, late, size in (
            (0x80, 0, 0), (0x181, 1e6, 4), (0x182, 1e6, 1), (0x183, 1e6, 3), (0x184, 1e6, 2),
        )
    ]  # fmt: skip
    return recorded(arbitrated(ready, bitrate), 1000, start_ns=T0)


@pytest.mark.parametrize(("bitrate", "known"), [(250_000, True), (500_000, False)])
def test_no_device_time_rests_on_a_contradicted_bit_rate(bitrate: int, known: bool) -> None:
    analysis = told(answered(250_000), bitrate=bitrate)
    assert bool(found(analysis, "bus.bitrate_contradicted")) != known
    assert len(analysis.pdos) == 4
    for row in analysis.pdos:
        assert row.response_us is not None
        assert [row.device_us_low is not None, row.device_us_high is not None] == [known, known]
    for answers in analysis.responses:
        assert np.isfinite(answers.device_low_us).all() == known
        assert np.isfinite(answers.device_high_us).all() == known
    assert bool(analysis.delays) == known


def test_it_is_told_who_goes_before_the_command_line() -> None:
    analysis = told(traffic(), description="[bus.can0]\nbitrate = 500000\n", bitrate=250_000)
    (finding,) = found(analysis, "bus.bitrate_contradicted")
    assert "bus description to 250 kbit/s" in finding.check_next
    assert (
        "the bit rate of bus can0 is taken as 500 kbit/s from the bus description, which goes"
        " before the 250 kbit/s of the command line"
    ) in analysis.capture.notes
    agreed = told(traffic(), description=DESCRIBED, bitrate=250_000)
    assert not any("command line" in note for note in agreed.capture.notes)


def coarse(load: float) -> FrameBatch:
    """Two seconds of a bus with this load at 20 kbit/s, in stamps that tell no bit rate."""
    bits = 47 + 8 * 8 + 12
    count = int(2 * load * 20_000 / bits)
    rows = [
        frame(T0 + k * 2 * SECOND // count // MS * MS, 0x181, bytes(range(8))) for k in range(count)
    ]
    return FrameBatch.from_rows(rows)


@pytest.mark.triggers("bus.bitrate_contradicted")
def test_more_than_a_bus_can_carry_contradicts_the_bit_rate() -> None:
    analysis = told(coarse(2.5), bitrate=20_000)
    (finding,) = found(analysis, "bus.bitrate_contradicted")
    assert "% of the time" in finding.text
    (row,) = analysis.bus_load
    assert row.bitrate == 20_000
    assert (
        row.mean_percent is row.peak_percent is row.peak_100ms_percent is row.burst_percent is None
    )
    assert all(share.load_percent is None for share in analysis.bus_shares)
    assert {series.unit for series in analysis.series if "rate" in series.name} == {"1/s"}
    assert not any(series.name.startswith("bus load") for series in analysis.series)


@pytest.mark.near_miss("bus.bitrate_contradicted")
def test_a_nearly_full_bus_contradicts_nothing() -> None:
    analysis = told(coarse(0.85), bitrate=20_000)
    assert not found(analysis, "bus.bitrate_contradicted")
    assert analysis.bus_load[0].mean_percent == pytest.approx(85, rel=0.1)


def test_frames_that_a_recorder_had_kept_contradict_nothing() -> None:
    """Forty frames at once, 100 ms before the only other one."""
    rows = [frame(T0 + k, 0x181, bytes(range(8))) for k in range(40)]
    analysis = told(FrameBatch.from_rows([*rows, frame(T0 + 100 * MS, 0x181)]), bitrate=20_000)
    assert not found(analysis, "bus.bitrate_contradicted")
    assert analysis.bus_load[0].mean_percent is None


@pytest.mark.near_miss("bus.bitrate_contradicted")
@pytest.mark.parametrize("bitrate", [250_000, None])
def test_the_right_bit_rate_is_not_contradicted(bitrate: int | None) -> None:
    analysis = told(traffic(), bitrate=bitrate)
    assert not found(analysis, "bus.bitrate_contradicted")
    assert not severe(analysis)


@pytest.mark.near_miss("bus.bitrate_contradicted")
def test_a_bit_rate_that_is_nearly_the_same_is_not_contradicted() -> None:
    assert not found(told(traffic(), bitrate=240_000), "bus.bitrate_contradicted")


@pytest.mark.near_miss("bus.bitrate_contradicted")
def test_a_guess_contradicts_nobody() -> None:
    few = recorded(arbitrated(BUSY, 250_000)[:15], 1000, start_ns=T0)
    assert not found(told(few, bitrate=500_000), "bus.bitrate_contradicted")


def test_what_rests_on_an_estimate_says_so() -> None:
    """A bus that is full for seconds."""
    full = recorded(arbitrated(machine(125_000, 2.0, 6000), 125_000), 1000, start_ns=T0)
    (finding,) = found(told(full), "bus.overload")
    assert finding.assumed == ["the bit rate of can0 is 125 kbit/s (estimated from the frames)"]
    (finding,) = found(told(full, bitrate=125_000), "bus.overload")
    assert finding.assumed == []


REAL = Path(__file__).parents[3] / "shared" / "captures"
ESTIMATED = {"hilch_pcan2.trc": 125_000, "sevcon_20090331.candump.log.gz": 100_000}
"""Back-to-back frames of 50 to 127 bits lie on one line through zero at these bit rates."""


@pytest.mark.parametrize(
    "name",
    [
        *ESTIMATED, "hilch_ixxat1.trc", "deltaq_can1_log.csv", "lely_stm32_candump_td.txt",
        "bg_can0_20260113_193431.log", "canopendemo_sdo_block_fragment.txt",
        "sevcon_20090330_preop.asc", "neg_j1939_bresilla_can_log.txt", "roboteq_ros2_candump.txt",
    ],
)  # fmt: skip
def test_real_captures_are_estimated_or_left_alone(name: str) -> None:
    """Steps of 10 ms, stamps of a busy host, a handful of answers, no times: no estimate there."""
    if not (REAL / name).exists():
        pytest.skip("the captures are not here")
    analysis = open_session(REAL / name).analyze()
    (row,) = analysis.bus_load
    recorded_rate = 500_000 if name == "hilch_ixxat1.trc" else None
    assert row.bitrate == ESTIMATED.get(name, recorded_rate)
    assert row.bitrate_source == (
        "estimated" if name in ESTIMATED else "recorded" if recorded_rate else None
    )
    assert not found(analysis, "bus.bitrate_contradicted")
