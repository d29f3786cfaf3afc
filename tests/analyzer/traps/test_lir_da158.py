"""The traps of the SKB IS LIR-DA158 sheet (older generation), each through the whole analysis."""

import numpy as np
import pytest

from tests.analyzer.traps.script import (
    PRE_OPERATIONAL,
    STOPPED,
    Script,
    little,
    numbered_traps,
    says,
)

TRAPS = 30
TURN = 131072


def encoder(device: str | None = "lir-da158", **changes: object) -> Script:
    """A LIR-DA158 as node 1 whose 17-bit single-turn scale was read."""
    script = Script(device, **changes)  # type: ignore[arg-type]
    script.read(-90, 0x6000, 0, 0, size=2).read(-80, 0x6001, 0, TURN).read(-70, 0x6002, 0, TURN)
    return script.read(-60, 0x6502, 0, 1, size=2)


def turning(script: Script, start: float, stop: float, period: float = 20, step: int = 7) -> Script:
    """Heartbeat, and TPDO1 of a shaft that turns slowly."""
    script.heartbeat(start, stop)
    return script.pdo(start + 5, stop, period, lambda k: (1000 + step * k) % TURN)


@pytest.mark.parametrize(
    ("reads", "reason"),
    [
        ([(0x1800, 2, 0xFE), (0x1800, 5, 0)], "event timer"),
        ([(0x1800, 2, 0)], "type 0"),
        ([(0x1800, 1, 0x80000181)], "switched off"),
        ([(0x1800, 2, 0xFE), (0x1800, 5, 20), (0x2800, 0, 5)], "2800h"),
    ],
)
def test_trap_01_silence_is_not_loss(reads: list[tuple[int, int, int]], reason: str) -> None:
    """No PDO although Operational: not expected, with the reason where the setting was seen."""
    script = encoder().boot(-100).nmt(-50, 0x01).heartbeat(0, 20_000)
    for k, (index, sub, value) in enumerate(reads):
        script.read(-40 + 5 * k, index, sub, value)
    told = script.told()
    assert told.accusations == []
    assert says(told.finding("pdo.silent").text, "no PDO", reason)


def test_trap_01_without_a_known_setting_the_cause_is_unknown() -> None:
    script = Script(None).boot(-100).nmt(-50, 0x01).heartbeat(0, 20_000)
    told = script.read(10, 0x1800, 1, 0x181).told()
    assert told.accusations == []
    assert says(told.finding("pdo.silent").text, "not known")


def bursts(script: Script, stop: int = 20_000) -> Script:
    """Five equal frames after each position change, then nothing."""
    for change in range(8):
        at = 500 + 2500 * change
        script.every(at, min(at + 100, stop), 20, f"181#{little(1000 + 50 * change)}")
    return script


def test_trap_02_k_equal_frames_are_one_event() -> None:
    """2800h = 5: five identical frames after each change, then nothing: not frozen, not missed."""
    script = encoder().read(-40, 0x1800, 2, 0xFE, size=1).read(-35, 0x1800, 5, 20, size=2)
    told = bursts(script.read(-30, 0x2800, 0, 5, size=1).heartbeat(0, 20_000)).told()
    assert told.accusations == []
    assert told.pdo(0x181).missed == 0
    assert told.trace_row().flags["frozen"] == 0


def test_trap_03_speed_aliases_at_the_default_cycle() -> None:
    """Every 515 ms above 58.25 rpm is ambiguous; no overspeed alarm from it."""
    script = encoder().heartbeat(0, 60_000)
    told = script.pdo(5, 60_000, 515, lambda k: round(k * 0.515 * 1000 / 60 * TURN) % TURN).told()
    row = told.trace_row()
    assert row.flags["ambiguous"] >= row.samples - 1
    assert told.events("jump") == []
    assert told.accusations == []
    (event,) = told.events("ambiguous")
    assert says(event.text, "58.25 rpm", "515")
    assert "ambiguous" in told.summary


def test_trap_03_smooth_differences_may_be_wrong_as_well() -> None:
    told = turning(encoder(), 0, 60_000, period=515, step=700).told()
    assert told.trace_row().flags["ambiguous"] > 100


def test_trap_03_often_enough_nothing_is_ambiguous() -> None:
    told = turning(encoder(), 0, 10_000, period=8).told()
    assert told.trace_row().flags["ambiguous"] == 0
    assert told.events("ambiguous") == []


def test_trap_04_the_wrap_at_6002h() -> None:
    """1FFFEh, then 00003h: five counts on."""
    script = encoder().heartbeat(0, 1000)
    told = script.frame(100, "181#FEFF0100").frame(120, "181#03000000").told()
    turned = told.trace().columns["unwrapped_deg"]
    assert (turned[1] - turned[0]) * TURN / 360 == pytest.approx(5)
    assert told.trace_row().flags["wrap"] == 1
    assert told.accusations == []


@pytest.mark.parametrize(("index", "words"), [(0x6003, "preset"), (0x6000, "direction")])
def test_trap_05_a_jump_without_motion(index: int, words: str) -> None:
    """The position steps after a write to 6003h or 6000h: tied to that write, no encoder fault."""
    script = turning(encoder(), 0, 3000).write(3001, index, 0, 1)
    script.heartbeat(3000, 6000).pdo(3005, 6000, 20, lambda k: (90_000 + 7 * k) % TURN)
    told = script.told()
    assert told.accusations == []
    (cut,) = told.events("cut")
    assert says(cut.text, words, f"{index:04X}h")
    assert "trace_events" in told.json
    assert cut.text in told.json


def test_trap_05_a_load_and_a_reset_cut_too() -> None:
    script = turning(encoder(), 0, 3000).load(2000).nmt(3000, 0x81).boot(3100).nmt(3150, 0x01)
    told = turning(script, 7500, 9000).told()
    assert told.events("jump") == []
    assert "angle.jump" not in told.ids


def test_trap_06_emcy_0000h_is_not_healthy() -> None:
    """0000h with register, alarm or warning bits left: one error gone, still active: ..."""
    script = turning(encoder(), 0, 5000).emcy(1000, 0x5530, 0x80)
    told = script.emcy(1500, 0x7320, 0x81, "0100000000").emcy(2000, 0x0000, 0x80).told()
    assert [row.transition for row in told.emcy] == ["raised", "further", "partly cleared"]
    states = {row.code: row.status for row in told.analysis.errors}
    assert states == {0x5530: "still active", 0x7320: "cleared"}
    active = [f.text for f in told.findings("emcy.active") if says(f.text, "still active")]
    assert len(active) == 1
    assert says(active[0], "EEPROM")


def test_trap_07_reading_1001h_clears_it() -> None:
    """80h, then 00h, no EMCY between: cleared by the read, not repaired."""
    script = turning(encoder(), 0, 5000).emcy(1000, 0x5530, 0x80)
    told = script.read(2000, 0x1001, 0, 0x80, size=1).read(3000, 0x1001, 0, 0, size=1).told()
    found = told.finding("emcy.cleared_by_read")
    assert found.severity == "info"
    assert says(found.text, "1001h", "because it was read", "not because an error was gone")
    assert [row.status for row in told.analysis.errors] == ["still active"]


@pytest.mark.parametrize(
    ("code", "register", "name"), [(0x8130, 0x20, "node-guard"), (0x5530, 0x80, "eeprom")]
)
def test_trap_08_register_bits_5_and_7_are_the_makers(code: int, register: int, name: str) -> None:
    """Bit 5 is NodeGuard, bit 7 EEPROM; 8130h without bit 4 is no protocol error."""
    told = turning(encoder(), 0, 3000).emcy(1000, code, register).told()
    assert told.emcy[0].registers == [name]
    assert "emcy.malformed" not in told.ids


def test_trap_09_emcy_bytes_3_to_6_are_two_words() -> None:
    """7320h with 01 00 00 00 00: alarms 0001h, warnings 0000h, with our own names."""
    told = turning(encoder(), 0, 3000).emcy(1000, 0x7320, 0x01, "0100000000").told()
    (row,) = told.emcy
    assert (row.details["alarms"], row.details["warnings"]) == (1, 0)
    assert row.details["alarms_bits"] == ["position code invalid"]
    assert row.meaning == "position error"


def test_trap_10_22h_carries_no_size() -> None:
    """FE 00 00 00 to the U8 1800h:2, 43h with four bytes for a U16: the object's type decides."""
    script = turning(encoder(), 0, 3000).write(1000, 0x1800, 2, 0xFE)
    told = script.read(1010, 0x6504, 0, 1, size=4).told()
    assert [told.sdo(0x1800, 2)[0].value, told.sdo(0x6504)[0].value] == [254, 1]
    assert told.accusations == []


@pytest.mark.triggers("device.identifier_kept")
def test_trap_11_writes_to_1800h_1_do_not_move_the_pdo() -> None:
    """00000200h is acknowledged and the PDO stays on 181h: only bit 31 counts."""
    told = turning(encoder(), 0, 3000).write(1000, 0x1800, 1, 0x200).told()
    assert told.pdo(0x181).frames == 150
    assert told.trace_row().samples == 150
    assert told.object(0x1800, 1).value == 0x181
    found = told.finding("device.identifier_kept")
    assert says(found.text, "1800h:01", "200h", "181h", "bit 31")


@pytest.mark.near_miss("device.identifier_kept")
def test_trap_12_the_pdo_off_bit_is_not_stored() -> None:
    """Switched off, saved, reset, and the PDO is back: bit 31 is not in the EEPROM list."""
    script = turning(encoder(), 0, 2000).write(2000, 0x1800, 1, 0x80000181).save(2500)
    script.heartbeat(2000, 4000).nmt(4000, 0x82).boot(4100).nmt(8200, 0x01)
    told = turning(script, 8300, 10_000).told()
    assert told.accusations == []
    found = told.finding("device.lost_at_reset")
    assert says(found.text, "1800h:01", "not stor")
    assert told.pdo(0x181).node == 1


def test_trap_13_sync_is_drawn_with_two_bytes() -> None:
    """080h with DLC 0 is a plain SYNC, and the right one."""
    told = turning(encoder(), 0, 3000).sync(0, 3000).told()
    assert [(row.cob_id, row.count, row.counter_jumps) for row in told.analysis.sync] == [
        (0x80, 150, 0)
    ]
    assert told.accusations == []


@pytest.mark.parametrize("boot_at", [3050, 7000])
def test_trap_14_four_seconds_of_silence_after_a_reset(boot_at: float) -> None:
    """81h or 82h, then up to 4 s without frames or answers: restarting."""
    script = turning(encoder(), 0, 3000).nmt(3000, 0x81).boot(boot_at)
    script.frame(4000, "601#4000100000000000").nmt(7010, 0x01)
    told = turning(script, 7020, 10_000).told()
    assert told.accusations == []
    assert "LOST" not in told.state_names()
    assert told.state_at(min(boot_at, 7000) - 10).state == "INITIALISING"


def test_trap_14_after_that_it_is_lost() -> None:
    script = turning(encoder(), 0, 3000).nmt(3000, 0x81).heartbeat(0, 1)
    script.node = 9
    script.heartbeat(0, 20_000)
    told = script.told()
    assert [f.node for f in told.analysis.findings if f.severity == "error"] == [1]


def test_trap_15_boot_up_need_not_be_00h_on_newer_firmware() -> None:
    """L158 answers with 7Fh after the reset: both generations stay possible by the name alone."""
    script = Script(None).read(-40, 0x1008, 0, 0x3835314C).heartbeat(0, 3000)
    told = script.nmt(3000, 0x81).boot(3500, 0x7F).heartbeat(3600, 6000, PRE_OPERATIONAL).told()
    assert told.row().boot_ups == 1
    assert told.accusations == []


def test_trap_16_switches_overrule_2101h() -> None:
    """2101h written and saved, reset, boot-up from the old id: the rotary switches give it."""
    script = turning(encoder(), 0, 3000).write(1000, 0x2101, 0, 10).save(1100).nmt(3000, 0x81)
    told = script.boot(3100).heartbeat(7200, 9000, PRE_OPERATIONAL).told()
    found = told.finding("device.node_id_change")
    assert found.severity == "info"
    assert says(found.text + found.cause, "2101h", "10", "rotary switches")
    assert told.accusations == []


def test_trap_17_baud_index_and_switch_differ_by_one() -> None:
    """2100h = 8 is told as kbit/s."""
    told = turning(encoder(), 0, 2000).read(1000, 0x2100, 0, 8, size=1).told()
    assert told.object(0x2100).meaning == "1000 kbit/s"


@pytest.mark.parametrize("reads", [{0x6502: 4096}, {0x6002: 8192 * 4096}])
def test_trap_18_1000h_cannot_tell_single_from_multi_turn(reads: dict[int, int]) -> None:
    """00010196h, yet 6502h > 1 or 6002h > 6001h: turns come from there."""
    script = Script("lir-da158").read(-90, 0x1000, 0, 0x00010196).read(-80, 0x6001, 0, 8192)
    for index, value in reads.items():
        script.read(-70, index, 0, value)
    told = script.heartbeat(0, 1000).frame(100, "181#00341201").told()
    trace = told.trace()
    assert (trace.columns["turn"][0], trace.columns["angle_deg"][0]) == (2193, 225.0)


def test_trap_19_6500h_is_4() -> None:
    """Only bit 0 has a meaning: not "scaling on"."""
    told = turning(encoder(), 0, 2000).read(1000, 0x6500, 0, 4, size=2).told()
    assert not says(told.object(0x6500).meaning or "", "scaling")
    assert told.trace().columns["angle_deg"][-1] == pytest.approx((1000 + 7 * 99) * 360 / TURN)


def test_trap_20_heartbeat_and_guarding_share_700h() -> None:
    """Unanswered guard requests after 1017h > 0 are a conflict of settings, not a dead node."""
    script = turning(encoder(), 0, 6000, period=20).write(-30, 0x1017, 0, 100, size=2)
    told = script.every(3000, 6000, 500, "701#R").told()
    assert "nmt.node_lost" not in told.ids
    found = told.finding("config.rtr_on_heartbeat_node")
    assert found.severity == "warning"
    assert told.row().guard_answers == 0


@pytest.mark.parametrize(("state", "name"), [(0x7F, "PRE-OPERATIONAL"), (0x05, "OPERATIONAL")])
def test_trap_21_the_guard_toggle_is_not_a_state(state: int, name: str) -> None:
    """7Fh / FFh alternate: one state, toggle 0 and 1."""
    script = encoder()
    for k in range(30):
        toggle = 0x80 if k % 2 else 0
        script.frame(k * 100, "701#R").frame(k * 100 + 1, f"701#{state | toggle:02X}")
    told = script.told()
    assert {row.state for row in told.states()} - {"UNKNOWN"} == {name}
    assert told.row().toggle_errors == 0
    assert told.row().guard_answers == 30
    assert told.accusations == []


def test_trap_22_stopped_is_mute() -> None:
    """After 02h no SDO, no EMCY, no PDO: expected; time-outs are the client's mistake."""
    script = turning(encoder(), 0, 3000).nmt(3000, 0x02).heartbeat(3050, 8000, STOPPED)
    for at in (4000, 5000, 6000):
        script.frame(at, "601#4004600000000000")
    told = script.told()
    assert "pdo.missed" not in told.ids
    for found in told.findings("sdo.no_answer"):
        assert says(found.text + found.cause, "STOPPED", "client")
    assert all("STOPPED" in text for text in told.accusations)


def test_trap_23_emcy_7510h_is_late() -> None:
    """7510h after a gap of the node: bus-off before t."""
    script = turning(encoder(), 0, 3000).emcy(5000, 0x7510, 0x10)
    turning(script, 5010, 8000).node = 9
    script.heartbeat(0, 8000)
    found = script.told().finding("error.bus_off")
    assert says(found.text, "node 1", "was bus-off", "7510h", "silent")
    assert says(found.cause, "after the recovery")


@pytest.mark.triggers("device.defaults_pending")
def test_trap_24_load_acts_only_after_a_reset() -> None:
    """Defaults stored, active after the reset; what was stored before is gone at once."""
    script = turning(encoder(), 0, 6000).write(500, 0x1800, 5, 20, size=2).save(600).load(2000)
    told = script.told()
    assert told.accusations == []
    assert told.object(0x1800, 5).value == 20
    assert says(told.finding("device.defaults_pending").text, "defaults", "reset")


def test_trap_25_6200h_is_1800h_5() -> None:
    """A write to 6200h changes the period of TPDO1: tied to that write."""
    script = turning(encoder(), 0, 3000).read(-40, 0x1800, 5, 20, size=2)
    script.read(-30, 0x1800, 2, 0xFE, size=1).write(3000, 0x6200, 0, 50)
    told = turning(script, 3000, 9000, period=50).told()
    assert told.accusations == []
    known = told.object(0x1800, 5)
    assert (known.value, known.source) == (50, "sdo-write")
    assert told.pdo(0x181).missed == 0


@pytest.mark.near_miss("device.restarted_unseen")
def test_trap_26_6508h_restarts() -> None:
    """The operating time falls to 0 at a restart: no counter fault."""
    script = turning(encoder(), 0, 3000).read(2000, 0x6508, 0, 120).nmt(3000, 0x81).boot(3100)
    told = turning(script.nmt(7100, 0x01), 7200, 9000).read(8000, 0x6508, 0, 0).told()
    assert told.accusations == []
    assert [row.value for row in told.sdo(0x6508)] == [120, 0]
    assert says(told.object(0x6508).name or "", "operating time")


@pytest.mark.triggers("device.restarted_unseen")
def test_trap_26_without_a_boot_up_it_tells_of_the_restart() -> None:
    script = turning(encoder(), 0, 9000).read(2000, 0x6508, 0, 120).read(8000, 0x6508, 0, 0)
    found = script.told().finding("device.restarted_unseen")
    assert says(found.text, "6508h", "restart")


def test_trap_27_gaps_in_sub_indices() -> None:
    """0609 0011 for 180xh:3/4 although sub 0 = 5: normal for this device."""
    script = turning(encoder(), 0, 3000).read(900, 0x1800, 0, 5, size=1)
    told = (
        script.read(1000, 0x1800, 3, abort=0x06090011)
        .read(1010, 0x1800, 4, abort=0x06090011)
        .told()
    )
    assert told.accusations == []


def test_trap_28_tpdo1_and_tpdo2_differ_slightly() -> None:
    """Sampled by timer and by SYNC: no consistency alarm, and no jump between the two."""
    script = encoder().heartbeat(0, 4000).sync(1, 4000)
    script.pdo(5, 4000, 17, lambda k: (1000 + 170 * k) % TURN)
    told = script.pdo(42, 4000, 40, lambda k: (1040 + 400 * k) % TURN, base=0x280).told()
    assert told.accusations == []
    assert told.events("jump") == []
    assert np.isnan(told.trace().columns["speed_rpm"]).sum() == 2


@pytest.mark.parametrize("size", [2, 4])
def test_trap_29_the_width_of_1003h(size: int) -> None:
    """0000 7320h in a U32 or 7320h in a U16: the code is the low 16 bits."""
    script = turning(encoder(), 0, 3000).read(900, 0x1003, 0, 1, size=1)
    told = script.read(1000, 0x1003, 1, 0x7320, size=size).told()
    assert told.object(0x1003, 1).value == 0x7320
    assert [row.code for row in told.analysis.error_history if row.sub] == [0x7320]


def test_trap_30_bytes_are_counted_from_1() -> None:
    """ "Byte 3" of the manual is data[2]: the error register."""
    told = turning(encoder(), 0, 3000).frame(1000, "081#3055800000040000").told()
    (row,) = told.emcy
    assert (row.code, row.error_register) == (0x5530, 0x80)
    assert (row.details["alarms"], row.details["warnings"]) == (0, 0x0004)


def test_every_trap_of_the_sheet_is_here() -> None:
    assert numbered_traps(globals()) == set(range(1, TRAPS + 1))


def test_a_healthy_encoder_is_left_in_peace() -> None:
    script = encoder().boot(-100).nmt(-50, 0x01).read(-40, 0x1800, 5, 20, size=2)
    assert turning(script, 0, 20_000).told().accusations == []
