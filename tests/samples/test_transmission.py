"""Transmission types and repeat counters of the simulated devices against their sheets, section 3.2."""

import numpy as np
import pytest

from syncline_samples.faults import PdoRequests, UnknownState
from syncline_samples.machine import DeviceSpec, Fault, Run, Scenario
from syncline_samples.motion import Shaft
from syncline_samples.sdo_client import write
from syncline_schemas.batch import FrameBatch, FrameFlag

STILL = Shaft((0, 0), (100, 0))
STEP = Shaft((0, 0), (7, 0), (8, 60), (9, 0), (100, 0))
"""Turns between the seconds 7 and 9."""
SYNC_US = 50_000


def pdos(device: str, shaft: Shaft, *settings: tuple[int, int, int], pdo: int = 2) -> list[float]:
    """Seconds from 6 s on at which a TPDO came; the settings are (index, sub, value)."""
    jobs = tuple(write(*setting) for setting in settings)
    spec = DeviceSpec(5, device, "drum", shaft, stored_heartbeat_ms=200, jobs=jobs)
    result = Scenario("types", 11.0, (spec,), sync_us=SYNC_US).run()
    assert {row.result for row in result.truth.sdo} <= {"ok"}
    return times(result, 0x080 + 0x100 * pdo + 5)


def times(result: Run, can_id: int) -> list[float]:
    frames = FrameBatch.concat([item for item in result.batches if isinstance(item, FrameBatch)])
    rows = (frames.can_id == can_id) & ((frames.flags & FrameFlag.REMOTE) == 0)
    t_s = (frames.t_ns[rows] - result.scenario.epoch_ns) / 1e9
    return [float(each) for each in t_s[t_s > 6.0]]


@pytest.mark.parametrize("kind", [1, 2, 7])
def test_every_nth_sync(kind: int) -> None:
    seen = pdos("lir-da158", STILL, (0x1801, 2, kind))
    assert np.diff(seen) == pytest.approx(kind * SYNC_US / 1e6, abs=5e-4)


def test_cyclic_by_the_timer() -> None:
    seen = pdos("lir-da158", STILL, (0x1801, 2, 0xFE), (0x1801, 5, 70))
    assert np.diff(seen) == pytest.approx(0.070, abs=1e-4)


def test_timer_0_sends_nothing() -> None:
    assert pdos("lir-da158", STEP, (0x1801, 2, 0xFE), (0x1801, 5, 0)) == []


def test_type_0_is_off_on_the_old_lir_and_once_per_change_on_the_new_one() -> None:
    assert pdos("lir-da158", STEP, (0x1801, 2, 0)) == []
    seen = pdos("lir-da158a", STEP, (0x1801, 2, 0), (0x2801, 0, 1))
    assert seen
    assert 7.0 < seen[0] < 7.2
    assert seen[-1] < 9.1
    assert np.diff(seen) == pytest.approx(SYNC_US / 1e6, abs=1e-3), "whatever 2801h says"


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("kind", [1, 0xFE])
def test_repeat_counter_sends_k_frames_after_each_change(kind: int, count: int) -> None:
    settings = ((0x1801, 2, kind), (0x1801, 5, 50), (0x2801, 0, count))
    seen = pdos("lir-da158a", STEP, *settings)
    assert min(seen) > 7.0, "the shaft stands still and all frames of the start are spent"
    still = [t_s for t_s in seen if t_s > 9.0]
    assert len(still) in (count - 1, count, count + 1)
    assert max(seen) < 9.0 + 0.05 * (count + 2)


def test_a_pdo_is_switched_off_by_bit_31() -> None:
    seen = pdos("lir-da158", STILL, (0x1801, 1, 0x8000_0285), (0x1801, 2, 1))
    assert seen == []


def run_tilt(*faults: Fault) -> Run:
    return Scenario("tilt", 9.0, (DeviceSpec(10, "jn2100", "tilt"),), faults, sync_us=0).run()


def test_a_jn2100_without_sync_is_silent_but_answers_requests() -> None:
    assert times(run_tilt(), 0x18A) == []
    asked = times(run_tilt(PdoRequests(10, 7.0)), 0x18A)
    assert asked == pytest.approx([7.0, 7.333, 7.666], abs=0.01)


def test_an_unknown_state_byte() -> None:
    spec = DeviceSpec(5, "haomiao-38", "lift", stored_heartbeat_ms=200)
    script = (UnknownState(5, 7.0, 0x33, 1.0),)
    result = Scenario("state", 9.0, (spec,), script, sync_us=0).run()
    frames = FrameBatch.concat([item for item in result.batches if isinstance(item, FrameBatch)])
    said = frames.data[frames.can_id == 0x705, 0].tolist()
    assert said.count(0x33) == 5
    assert {row.state for row in result.truth.states} <= {
        "OFF",
        "INITIALISING",
        "PRE-OPERATIONAL",
        "OPERATIONAL",
    }
