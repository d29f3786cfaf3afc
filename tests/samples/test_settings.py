"""What the master changes at run time shows on the bus as the sheets and CiA 301 say."""

from collections import Counter

import numpy as np
import pytest

from syncline_samples import abort
from syncline_samples.faults import (
    Command,
    Emcy,
    FactoryReset,
    MoveEmcy,
    MovePdo,
    MoveSdo,
    MoveSync,
    NodeIdChange,
    RemapPdo,
    ResetBySdo,
    SdoAccess,
    Storage,
)
from syncline_samples.machine import DeviceSpec, Fault, Run, Scenario
from syncline_samples.master import RESET_COMMUNICATION, RESET_NODE
from syncline_samples.motion import Shaft, Tilt
from syncline_samples.scenarios import haomiao, io_module, jn2100_guarded, lir_heartbeat
from syncline_samples.sdo_client import read, write
from syncline_schemas.batch import FrameBatch, FrameFlag

SECOND = 1_000_000_000
LIFT, TILT, CABINET, DRUM = 20, 11, 30, 5


def run(*faults: Fault, seconds: float = 7.0, lir: bool = False) -> Run:
    shaft = Shaft((0, 0), (5, 50))
    devices: tuple[DeviceSpec, ...] = (
        haomiao(LIFT, "lift", shaft, 200),
        jn2100_guarded(TILT, "tilt", Tilt((0, 0, 0), (5, 9000, 100)), 200),
        io_module(CABINET, "cabinet", 200),
    )
    if lir:
        devices = (lir_heartbeat(DRUM, "lir-da158a", "drum", shaft, 200),)
    return Scenario("settings", seconds, devices, faults, sync_us=50_000, rpdo_node=CABINET).run()


def heard(run: Run, from_s: float = 0.0, to_s: float = 99.0) -> FrameBatch:
    frames = FrameBatch.concat([item for item in run.batches if isinstance(item, FrameBatch)])
    t_s = (frames.t_ns - run.scenario.epoch_ns) / SECOND
    plain = (frames.flags & FrameFlag.REMOTE) == 0
    return frames[(t_s > from_s) & (t_s < to_s) & plain]


def identifiers(run: Run, from_s: float, to_s: float = 99.0) -> Counter[int]:
    return Counter(heard(run, from_s, to_s).can_id.tolist())


def results(run: Run) -> set[str]:
    return {row.result for row in run.truth.sdo}


def test_a_moved_tpdo_comes_on_its_new_identifier() -> None:
    result = run(MovePdo(LIFT, 4.0, 0x3A5, 2))
    assert identifiers(result, 0, 4.0)[0x280 + LIFT] > 30
    after = identifiers(result, 4.1)
    assert after[0x280 + LIFT] == 0
    assert after[0x3A5] == pytest.approx(2.9 / 0.05, abs=2)
    assert results(result) == {"ok"}


def test_an_io_module_refuses_to_move_a_pdo_that_is_on() -> None:
    job = write(0x1800, 1, 0x1F0, 4)
    row = run(SdoAccess(CABINET, 4.0, (job,))).truth.sdo[-1]
    assert (row.result, row.abort_code) == ("abort", abort.VALUE_RANGE)


def test_a_moved_rpdo_still_switches_the_outputs() -> None:
    result = run(MovePdo(CABINET, 4.0, 0x2F0, 1, receive=True))
    assert identifiers(result, 4.1)[0x2F0] >= 14
    assert identifiers(result, 4.3)[0x180 + CABINET] >= 12, "inputs follow the outputs"


def test_a_remapped_pdo_has_the_mapped_bytes() -> None:
    result = run(RemapPdo(LIFT, 4.0, (0x60040020, 0x65010020), 2))
    frames = heard(result, 4.2)
    rows = np.flatnonzero(frames.can_id == 0x280 + LIFT)
    assert (frames.dlc[rows] == 8).all()
    assert (frames.data[rows, 4:].copy().view("<u4") == 8192).all()


def test_what_cannot_be_mapped_is_refused() -> None:
    for entry, code in ((0x12340020, abort.NOT_MAPPABLE), (0x60040010, abort.PDO_LENGTH)):
        row = run(SdoAccess(LIFT, 4.0, (write(0x1A00, 1, entry, 4),))).truth.sdo[-1]
        assert (row.result, row.abort_code) == ("abort", code)


def refusals(*faults: Fault) -> list[tuple[int, int, int]]:
    rows = [row for row in run(*faults).truth.sdo if row.abort_code]
    return [(row.index, row.sub, row.abort_code or 0) for row in rows]


def test_more_than_eight_bytes_cannot_be_mapped() -> None:
    entries = (0x10180120, 0x10180220, 0x10180320)
    assert refusals(RemapPdo(CABINET, 4.0, entries)) == [(0x1A00, 0, abort.PDO_LENGTH)]


def test_more_entries_than_there_are_cannot_be_mapped() -> None:
    assert refusals(RemapPdo(LIFT, 4.0, (0x60040020, 0x65000010, 0x65000010), 2)) == [
        (0x1A01, 3, abort.NO_SUB),
        (0x1A01, 0, abort.VALUE_RANGE),
    ]


def test_a_moved_emcy_comes_on_its_new_identifier() -> None:
    faults = (MoveEmcy(CABINET, 4.0, 0x0F1), Emcy(CABINET, 5.0, 0x1000, 0x01, for_s=0.5))
    after = identifiers(run(*faults), 4.5)
    assert (after[0x0F1], after[0x080 + CABINET]) == (2, 0)


def test_a_moved_sync_is_followed_by_those_that_were_told() -> None:
    result = run(MoveSync(4.0, 0x090, (LIFT, CABINET)))
    after = identifiers(result, 4.5)
    assert after[0x090] > 40
    assert after[0x280 + LIFT] == pytest.approx(after[0x090], abs=1)
    assert after[0x080] == after[0x180 + TILT] == 0


def test_a_moved_sdo_channel_counts_after_the_reset() -> None:
    result = run(MoveSdo(CABINET, 4.0, 0x640, 0x5C0))
    after = identifiers(result, 4.5)
    assert after[0x640] == after[0x5C0] > 5
    assert after[0x600 + CABINET] == after[0x580 + CABINET] == 0
    assert {row.request_id for row in result.truth.sdo if row.node == CABINET} == {0x61E, 0x640}
    assert results(result) == {"ok"}


@pytest.mark.parametrize(("what", "kept"), [("save", 75), ("", 0), ("load", 0)])
@pytest.mark.parametrize("specifier", [RESET_NODE, RESET_COMMUNICATION])
def test_what_is_not_saved_is_lost_at_a_reset(what: str, kept: int, specifier: int) -> None:
    job = write(0x1800, 3, 75, 2)
    storage = Storage(LIFT, 4.0, (job,), what, specifier=specifier)
    rows = run(storage, SdoAccess(LIFT, 6.0, (read(0x1800, 3),))).truth.sdo
    assert int.from_bytes(rows[-1].data, "little") == kept


def test_a_jn2100_keeps_what_its_sheet_marks_as_storable() -> None:
    """1800h:2 and 1801h:2 are, 1802h:2 and the inhibit times are not."""
    writes = (write(0x1800, 2, 4, 1), write(0x1802, 2, 4, 1), write(0x1800, 3, 9, 2))
    reads = SdoAccess(TILT, 6.0, (read(0x1800, 2), read(0x1802, 2), read(0x1800, 3)))
    rows = run(Storage(TILT, 4.0, writes), reads).truth.sdo
    assert [int.from_bytes(row.data, "little") for row in rows[-3:]] == [4, 1, 0]


def test_a_jn2100_resets_by_sdo_without_any_command() -> None:
    result = run(ResetBySdo(TILT, 4.0))
    late = [row for row in result.truth.boot_ups if row.t_ns > result.scenario.epoch_ns + 4e9]
    assert [(row.node, row.commanded) for row in late] == [(TILT, True)]
    assert not [row for row in result.truth.commands if row.specifier in (0x81, 0x82)][1:]


@pytest.mark.parametrize("node", [LIFT, TILT])
def test_a_node_changes_its_number_after_the_reset(node: int) -> None:
    result = run(NodeIdChange(node, 4.0, 33))
    before, after = identifiers(result, 0, 4.3), identifiers(result, 5.0)
    assert before[0x700 + 33] == after[0x700 + node] == 0
    assert after[0x700 + 33] >= 7
    assert after[0x280 + 33] > 30
    assert after[0x280 + node] == 0
    assert [row.state for row in result.truth.states if row.node == 33][-1] == "OPERATIONAL"


def test_a_lir_changes_its_number_and_boots_with_7f_once_its_heartbeat_is_saved() -> None:
    result = run(NodeIdChange(DRUM, 6.0, 35), seconds=12.0, lir=True)
    boot_up = result.truth.boot_ups[-1]
    assert (boot_up.node, boot_up.byte) == (35, 0x7F)
    assert result.truth.states[-1].state == "OPERATIONAL"


def test_factory_reset_makes_node_10_of_a_jn2100() -> None:
    result = run(FactoryReset(TILT, 4.0))
    checks = [row.data for row in result.truth.sdo if row.index == 0x207F]
    assert checks == [b"\x01", b"\x01"]
    assert identifiers(result, 5.0)[0x700 + 10] > 5


def test_silence_after_a_reset_may_come_after_the_boot_up() -> None:
    spec = DeviceSpec(DRUM, "lir-da158", "drum", quiet_after_boot_up=True)
    reads = tuple(SdoAccess(DRUM, at_s, (read(0x1000),)) for at_s in (5.0, 8.5, 9.5))
    faults: tuple[Fault, ...] = (Command(5.1, RESET_NODE, DRUM), *reads)
    result = Scenario("quiet", 11.0, (spec,), faults, sync_us=0).run()
    boot_up = result.truth.boot_ups[-1]
    assert (boot_up.t_ns - result.scenario.epoch_ns) / SECOND == pytest.approx(5.35, abs=0.01)
    assert [row.result for row in result.truth.sdo] == ["ok", "no answer", "ok"]
