"""The EMCY machines of the devices against their sheets and CiA 301 7.2.7."""

from itertools import pairwise

import numpy as np
import pytest

from syncline_samples.faults import (
    EmcyInhibitTime,
    EmcyMalformed,
    ErrorHistory,
    Errors,
    MasterSilent,
    PowerLoss,
    SdoAccess,
)
from syncline_samples.machine import DeviceSpec, Fault, Run, Scenario
from syncline_samples.sdo_client import read, write
from syncline_schemas.batch import FrameBatch

MS = 1_000_000


def run(device: str, *faults: Fault, seconds: float = 10.0) -> Run:
    spec = DeviceSpec(5, device, "device", stored_heartbeat_ms=200)
    return Scenario("emcy", seconds, (spec,), faults, sync_us=0).run()


def told(run: Run) -> list[tuple[int, int, int, int]]:
    return [(row.code, row.register, row.alarms, row.warnings) for row in run.truth.emcy]


TWO = ((0.0, "+", 0x1000), (0.1, "+", 0x5000), (0.2, "-", 0x1000), (0.3, "-", 0x5000))


def test_partial_clears_of_a_lir_follow_its_sheet() -> None:
    """Transitions 1, 3, 2, 2 and 4 of the sheet's error states; LA20 and LA21 are the clears."""
    steps = ((0, "+", 0x7320), (0.1, "+", 0x5530), (0.2, "+", 0x6010), (0.3, "-", 0x7320))
    more = ((0.4, "-", 0x6010), (0.5, "-", 0x5530))
    assert told(run("lir-da158", Errors(5, 6.0, (*steps, *more)))) == [
        (0x7320, 0x01, 1, 0),
        (0x5530, 0x81, 1, 0),
        (0x6010, 0x81, 1, 4),
        (0x0000, 0x81, 0, 4),
        (0x0000, 0x80, 0, 0),
        (0x0000, 0x00, 0, 0),
    ]


def test_codes_of_a_jn2100_carry_its_register_bits() -> None:
    steps = ((0, "+", 0x4200), (0.1, "+", 0x3100), (0.2, "-", 0x4200))
    result = run("jn2100", Errors(5, 6.0, steps))
    assert told(result) == [(0x4200, 0x09, 0, 0), (0x3100, 0x0D, 0, 0), (0x0000, 0x05, 0, 0)]
    assert [(row.code, row.status, row.count) for row in result.truth.errors] == [
        (0x4200, "cleared", 1),
        (0x3100, "still active", 1),
    ]


def test_a_haomiao_has_no_maker_bytes() -> None:
    result = run("haomiao-38", Errors(5, 6.0, TWO))
    batches = [batch for batch in result.batches if isinstance(batch, FrameBatch)]
    frames = np.concatenate([batch.data[batch.can_id == 0x085] for batch in batches])
    assert len(frames) == 4
    assert not frames[:, 3:].any()


def test_an_episode_begins_and_ends_with_its_emcys() -> None:
    result = run("io", Errors(5, 6.0, TWO))
    times = {row.code: row.t_ns for row in result.truth.emcy if row.code}
    clears = [row.t_ns for row in result.truth.emcy if not row.code]
    assert [(row.code, row.raised_ns, row.cleared_ns) for row in result.truth.errors] == [
        (0x1000, times[0x1000], clears[0]),
        (0x5000, times[0x5000], clears[1]),
    ]


def test_a_power_cycle_loses_the_errors() -> None:
    result = run("io", Errors(5, 6.0, ((0, "+", 0x4210),)), PowerLoss(5, 7.0, 0.5))
    assert [row.status for row in result.truth.errors] == ["lost at reset"]
    assert len(result.truth.emcy) == 1


def test_the_error_list_can_be_read_newest_first() -> None:
    steps = ((0, "+", 0x4200), (0.1, "+", 0x3100))
    result = run("jn2100", Errors(5, 6.0, steps), ErrorHistory(5, 6.5))
    values = [int.from_bytes(row.data, "little") for row in result.truth.sdo]
    assert values == [0x0D, 2, 0x3100, 0x4200]


def test_reading_the_register_of_an_old_lir_clears_it() -> None:
    steps = ((0, "+", 0x5530),)
    reads = SdoAccess(5, 6.5, (read(0x1001), read(0x1001)))
    for device, second in (("lir-da158", 0x00), ("lir-da158a", 0x80)):
        rows = run(device, Errors(5, 6.0, steps), reads).truth.sdo
        assert [row.data[0] for row in rows] == [0x80, second]


@pytest.mark.parametrize(
    ("device", "codes"),
    [("jn2100", [0x1000, 0, 0x1000, 0, 0x1000, 0]), ("lir-da158a", [0x1000, 0x1000])],
)
def test_inhibit_time_delays_or_drops(device: str, codes: list[int]) -> None:
    """A LIR may show what came within its inhibit time in 1003h only (sheet, section 4)."""
    result = run(device, EmcyInhibitTime(5, 6.0))
    assert [row.code for row in result.truth.emcy] == codes
    times = [row.t_ns for row in result.truth.emcy]
    assert all(b - a >= 99 * MS for a, b in pairwise(times))


def test_a_hasty_device_violates_its_inhibit_time() -> None:
    result = run("jn2100", EmcyInhibitTime(5, 6.0, hasty=True))
    times = [row.t_ns for row in result.truth.emcy]
    assert max(b - a for a, b in pairwise(times)) < 40 * MS
    assert [row.id for row in result.truth.required()] == ["emcy.inhibit_time"]


def test_malformed_emcys_are_short() -> None:
    for dlc in (0, 1, 2, 7):
        result = run("io", EmcyMalformed(5, 6.0, dlc=dlc))
        assert [row.dlc for row in result.truth.emcy] == [dlc] * 3
        assert result.truth.errors == []


def test_a_lir_reacts_to_a_lost_master_as_1029h_asks() -> None:
    for reaction, state in ((0, "PRE-OPERATIONAL"), (1, "OPERATIONAL"), (2, "STOPPED")):
        jobs = (write(0x100C, 0, 100), write(0x100D, 0, 3), write(0x1029, 1, reaction))
        spec = DeviceSpec(5, "lir-da158a", "device", jobs=jobs, guard_ms=100)
        fault = MasterSilent(7.0, 0.6, restart_s=5.0)
        result = Scenario("emcy", 9.0, (spec,), (fault,), sync_us=0).run()
        assert result.truth.states[-1].state == state
        assert result.truth.emcy[0].code == 0x8130
