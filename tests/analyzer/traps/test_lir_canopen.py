"""The traps of the newer SKB IS sheet (LIR-DA158A, LIR-MA158K, LIR-918), each through the analysis."""

import pytest

from tests.analyzer.traps.script import (
    OPERATIONAL,
    PRE_OPERATIONAL,
    STOPPED,
    Script,
    little,
    numbered_traps,
    says,
)

TRAPS = 31
TURN, RANGE = 8192, 1 << 25


def encoder(device: str | None = "lir-ma158k", **changes: object) -> Script:
    """A LIR-MA158K as node 1 whose 8192 x 4096 scale was read."""
    script = Script(device, **changes)  # type: ignore[arg-type]
    script.read(-90, 0x6000, 0, 0, size=2).read(-80, 0x6001, 0, TURN).read(-70, 0x6002, 0, RANGE)
    return script.read(-60, 0x6502, 0, 4096, size=2)


def turning(script: Script, start: float, stop: float, period: float = 20, step: int = 7) -> Script:
    """Heartbeat, and TPDO1 of a shaft that turns slowly."""
    script.heartbeat(start, stop)
    return script.pdo(start + 5, stop, period, lambda k: (1000 + step * k) % RANGE)


def test_trap_01_the_boot_up_may_be_7fh_after_a_command() -> None:
    """Heartbeat stored on: 81h, silence, then 7Fh is the restart."""
    script = turning(encoder(), 0, 3000).nmt(3000, 0x81).heartbeat(6000, 9000, PRE_OPERATIONAL)
    told = script.told()
    assert told.row().boot_ups == 1
    assert "INITIALISING" in told.state_names()
    assert told.accusations == []


def test_trap_01_a_fall_to_7fh_without_a_command_is_a_restart() -> None:
    script = turning(encoder(), 0, 3000).heartbeat(5000, 9000, PRE_OPERATIONAL)
    script.node = 9
    script.heartbeat(0, 9000)
    script.node = 1
    told = script.told()
    assert told.row().boot_ups == 1
    errors = [f for f in told.analysis.findings if f.severity == "error"]
    assert [f.node for f in errors] == [1]
    assert says(told.text, "came back with a boot-up")


def test_trap_01_only_a_gap_makes_it_a_probable_one() -> None:
    script = encoder().heartbeat(0, 3000, PRE_OPERATIONAL).heartbeat(5000, 9000, PRE_OPERATIONAL)
    script.node = 9
    script.heartbeat(0, 9000)
    told = script.told()
    assert "nmt.unexpected_reset" not in [
        f.id for f in told.analysis.findings if f.severity == "error"
    ]
    assert says(told.text, "node 1")


@pytest.mark.parametrize("empty", ["701#00", "701#"])
def test_trap_02_one_remote_frame_spoils_the_heartbeat(empty: str) -> None:
    """After 701#R the heartbeats are empty: alive, state unknown since, no series of boot-ups."""
    script = turning(encoder(), 0, 3000).frame(3000, "701#R").every(3100, 9000, 100, empty)
    told = script.told()
    assert told.row().boot_ups == 0
    assert told.state_at(8000).state in ("UNKNOWN", "OPERATIONAL")
    assert "INITIALISING" not in told.state_names()
    assert "nmt.unexpected_reset" not in told.ids
    assert "nmt.node_lost" not in told.ids
    found = told.finding("config.rtr_on_heartbeat_node")
    assert says(found.text, "no state")
    assert found.evidence


def test_trap_03_rtrs_and_heartbeats_for_one_node() -> None:
    """A master that guards a heartbeat node: warned of even before trap 2 shows."""
    told = turning(encoder(), 0, 5000).every(1000, 5000, 1000, "701#R").told()
    assert told.finding("config.rtr_on_heartbeat_node").severity == "warning"
    assert "nmt.node_lost" not in told.ids


def test_trap_04_42h_as_a_read_request() -> None:
    """601#42 is an upload; 42h on 581h is a legal answer without a size."""
    script = turning(encoder(), 0, 3000).read(1000, 0x6502, 0, 4096, size=2, request=0x42)
    script.frame(2000, "601#4001600000000000").frame(2001, f"581#42016000{little(TURN)}")
    told = script.told()
    rows = [
        row for row in told.analysis.sdo if row.start_ns >= told.analysis.capture.first_ns + 900
    ]
    late = [(row.index, row.direction, row.value, row.result) for row in rows][-2:]
    assert late == [(0x6502, "upload", 4096, "ok"), (0x6001, "upload", TURN, "ok")]
    assert told.accusations == []


def test_trap_05_22h_without_size_and_three_answer_sizes() -> None:
    """22h with four bytes for any type; 4Fh, 4Bh, 43h: the object's type decides."""
    script = turning(encoder(), 0, 3000).write(500, 0x1017, 0, 100)
    script.read(1000, 0x1800, 2, 0xFE, size=1).read(1010, 0x1800, 5, 20, size=2)
    told = script.read(1020, 0x6001, 0, TURN).told()
    values = [
        told.object(*key).value for key in ((0x1017, 0), (0x1800, 2), (0x1800, 5), (0x6001, 0))
    ]
    assert values == [100, 0xFE, 20, TURN]
    assert told.accusations == []


def test_trap_06_type_0_sends() -> None:
    """One PDO per position change, only at a SYNC; silent at standstill, whatever 2800h says."""
    script = encoder().read(-40, 0x1800, 2, 0, size=1).read(-30, 0x2800, 0, 5, size=1)
    script.heartbeat(0, 20_000).sync(1, 20_000)
    for k in range(60):
        script.frame(1 + 20 * (k + 20) + 1, f"181#{little(1000 + 9 * k)}")
    for k in range(5):
        script.frame(1 + 20 * (800 + 13 * k) + 1, f"181#{little(3000 + 9 * k)}")
    told = script.told()
    assert told.accusations == []
    row = told.pdo(0x181)
    assert (row.transmission_type, row.missed) == (0, 0)
    assert "pdo.silent" not in told.ids


def test_trap_07_repeat_counters() -> None:
    """Types 1..F0h and FEh: k equal frames after a change, then nothing."""
    script = encoder().read(-40, 0x1800, 2, 1, size=1).read(-30, 0x2800, 0, 3, size=1)
    script.heartbeat(0, 20_000).sync(1, 20_000)
    for change in range(10):
        for k in range(3):
            script.frame(2 + 20 * (70 * change + k + 5), f"181#{little(1000 + 11 * change)}")
    told = script.told()
    assert told.accusations == []
    assert told.pdo(0x181).missed == 0
    assert told.trace_row().flags["frozen"] == 0


def test_trap_08_any_write_to_6000h_drops_the_offset() -> None:
    """Acknowledged, and the next position jumps: offset 6509h zeroed by the write."""
    script = turning(encoder(), 0, 3000).read(-40, 0x6509, 0, 777).write(3001, 0x6000, 0, 0)
    script.heartbeat(3000, 6000).pdo(3005, 6000, 20, lambda k: 9_000_000 + 7 * k)
    told = script.told()
    assert told.accusations == []
    (cut,) = told.events("cut")
    assert says(cut.text, "6000h", "offset 6509h")
    assert told.object(0x6509).value == 0


def test_trap_09_a_preset_is_lost_without_a_save() -> None:
    """Preset, no 1010h, restart: another position at the same angle: unsaved offset lost."""
    script = turning(encoder(), 0, 3000).write(1001, 0x6003, 0, 500).nmt(3000, 0x81).boot(3100)
    told = turning(script.nmt(7100, 0x01), 7200, 9000).told()
    found = told.finding("device.lost_at_reset")
    assert says(found.text, "6003h", "offset")
    assert told.accusations == []


def test_trap_09_a_saved_preset_stays() -> None:
    script = turning(encoder(), 0, 3000).write(1001, 0x6003, 0, 500).save(1500)
    told = turning(script.nmt(3000, 0x81).boot(3100).nmt(7100, 0x01), 7200, 9000).told()
    assert "device.lost_at_reset" not in told.ids


def test_trap_10_6003h_cannot_be_read() -> None:
    """0601 0001: normal, the object is write-only."""
    told = turning(encoder(), 0, 3000).read(1000, 0x6003, abort=0x06010001).told()
    assert told.accusations == []


@pytest.mark.parametrize(
    ("value", "signed", "modulo"), [(0xFFFFFFFF, -1, RANGE - 1), (0x0001FFFF, 0x1FFFF, 0x1FFFF)]
)
def test_trap_11_6509h_in_two_readings(value: int, signed: int, modulo: int) -> None:
    """Shown as I32, with the value modulo the range beside it."""
    told = turning(encoder(), 0, 3000).read(1000, 0x6509, 0, value).told()
    known = told.object(0x6509)
    assert known.value == signed
    if signed < 0:
        assert says(known.meaning or "", str(modulo))


def test_trap_12_0609_0011_on_1003h() -> None:
    """Above the stored count: no such entry yet; nonzero to sub 0: clear refused."""
    script = turning(encoder(), 0, 3000).read(1000, 0x1003, 3, abort=0x06090011)
    told = script.write(2000, 0x1003, 0, 5, abort=0x06090011).told()
    read, write = sorted(told.findings("sdo.abort"), key=lambda f: f.start_ns)
    assert read.severity == "info"
    assert says(read.text + read.cause, "entry")
    assert says(write.text + write.cause, ("clear", "erase", "empt"))
    assert "dictionary" not in told.text


def test_trap_13_8130h_then_0000h() -> None:
    """The EMCY pair around a gap of guard requests: the master missed the life time."""
    script = encoder().read(-40, 0x100C, 0, 100, size=2).read(-30, 0x100D, 0, 3, size=1)

    def guarded(start: int, stop: int) -> None:
        for k, at in enumerate(range(start, stop, 100)):
            toggle = 0x80 if k % 2 else 0
            script.frame(at, "701#R").frame(at + 1, f"701#{OPERATIONAL | toggle:02X}")

    guarded(0, 3000)
    guarded(4200, 8000)
    script.pdo(5, 8000, 20, lambda k: 1000 + k)
    told = script.emcy(3201, 0x8130, 0x20).emcy(4203, 0x0000, 0x00).told()
    found = told.finding("nmt.guarding_lost")
    assert says(found.text, "master", "301 ms", "8130h")
    assert [row.status for row in told.analysis.errors] == ["cleared"]
    assert "nmt.node_lost" not in told.ids


def test_trap_14_0000h_with_bits_left() -> None:
    """What is still active is listed."""
    script = turning(encoder(), 0, 5000).emcy(1000, 0x5530, 0x80)
    told = script.emcy(1500, 0x8130, 0xA0).emcy(2000, 0x0000, 0x80).told()
    assert told.emcy[-1].transition == "partly cleared"
    assert told.emcy[-1].registers == ["eeprom"]
    states = {row.code: row.status for row in told.analysis.errors}
    assert states == {0x5530: "still active", 0x8130: "cleared"}


def test_trap_15_1015h_hides_emcys() -> None:
    """1003h:0 grows more than the EMCYs seen: suppressed by the inhibit time."""
    script = turning(encoder(), 0, 9000).write(-30, 0x1015, 0, 10_000, size=2)
    script.read(500, 0x1003, 0, 0, size=1).emcy(1000, 0x7320, 0x01, "0100000000")
    script.emcy(3000, 0x0000, 0x00)
    for sub in (1, 2, 3):
        script.read(5000 + 10 * sub, 0x1003, sub, 0x7320)
    told = script.read(5000, 0x1003, 0, 3, size=1).told()
    assert says(told.text, "1015h", ("suppressed", "held"))


def test_trap_16_1029h_1_is_2_makes_it_mute() -> None:
    """Heartbeat 04h, no PDO, SDO unanswered, no stop command: Stopped by its error reaction."""
    script = turning(encoder(), 0, 3000).read(-30, 0x1029, 1, 2, size=1)
    script.emcy(2990, 0x7510, 0x10).heartbeat(3050, 8000, STOPPED)
    told = script.frame(5000, "601#4004600000000000").told()
    assert says(told.text, "STOPPED", ("1029h", "reaction"))
    assert "nmt.unexpected_reset" not in told.ids
    assert "pdo.missed" not in told.ids


def test_trap_17_1029h_1_is_0_looks_like_a_restart() -> None:
    """05h to 7Fh without NMT, an EMCY near: its error reaction, not a restart."""
    script = turning(encoder(), 0, 3000).read(-30, 0x1029, 1, 0, size=1)
    told = script.emcy(2990, 0x7510, 0x10).heartbeat(3050, 8000, PRE_OPERATIONAL).told()
    assert told.row().boot_ups == 0
    assert "nmt.unexpected_reset" not in told.ids
    assert says(told.text, "PRE-OPERATIONAL", "7510h")


@pytest.mark.parametrize("boot_at", [3050, 6900])
def test_trap_18_four_seconds_of_silence_after_a_reset(boot_at: float) -> None:
    """As in the older sheet."""
    script = turning(encoder(), 0, 3000).nmt(3000, 0x82).boot(boot_at).nmt(7010, 0x01)
    told = turning(script.frame(4000, "601#4000100000000000"), 7020, 10_000).told()
    assert told.accusations == []
    assert "LOST" not in told.state_names()


@pytest.mark.parametrize("device_type", [0x00010196, 0x00020196])
@pytest.mark.parametrize(("name", "device"), [(0x3835314D, "lir-ma158k"), (0x3831394C, "lir-918")])
def test_trap_19_1000h_is_the_same_for_all(device_type: int, name: int, device: str) -> None:
    """Identified by 1008h, and the turns by 6502h."""
    script = encoder(None).read(-50, 0x1000, 0, device_type).read(-40, 0x1008, 0, name)
    told = script.heartbeat(0, 2000).frame(100, "181#00341201").told()
    assert told.row().device == device
    assert told.trace().columns["turn"][0] == 2193


def test_trap_20_l158_is_ambiguous() -> None:
    """Both generations answer L158: both stay possible until 1015h, 6200h or 1010h:0 is seen."""
    script = Script(None).read(-50, 0x1008, 0, 0x3835314C).heartbeat(0, 3000)
    told = script.emcy(1000, 0x8130, 0x20).told()
    assert told.row().device == "lir-da158 or lir-da158a"
    assert told.emcy[0].registers == ["node-guard"]


@pytest.mark.parametrize(
    ("index", "abort", "device"),
    [(0x6200, 0x06020000, "lir-da158a"), (0x1015, None, "lir-da158a"), (0x6200, None, "lir-da158")],
)
def test_trap_20_until_one_of_these_is_seen(index: int, abort: int | None, device: str) -> None:
    script = Script(None).read(-50, 0x1008, 0, 0x3835314C).heartbeat(0, 3000)
    assert script.read(-40, index, 0, 20, size=2, abort=abort).told().row().device == device


def test_trap_21_vendor_id_0() -> None:
    """1018h:1 = 0 is accepted: no invalid identity."""
    script = encoder(None).read(-50, 0x1018, 1, 0).read(-40, 0x1008, 0, 0x3835314D)
    told = turning(script, 0, 3000).told()
    assert told.accusations == []
    assert told.row().device == "lir-ma158k"


def test_trap_22_the_lir_918_is_only_a_converter() -> None:
    """Speed belongs to the SSI encoder behind it: no alarm with a LIR's limits."""
    script = encoder("lir-918").heartbeat(0, 3000)
    told = script.pdo(5, 3000, 20, lambda k: round(k * 0.02 * 8000 / 60 * TURN) % RANGE).told()
    assert told.events("jump") == []
    assert told.accusations == []


def test_trap_22_the_user_gives_its_limits() -> None:
    script = encoder("lir-918", overrides="max_rpm = 3000").heartbeat(0, 3000)
    script.pdo(5, 1500, 20, lambda k: 1000 + 7 * k)
    told = script.pdo(1505, 3000, 20, lambda k: 9_000_000 + 7 * k).told()
    assert "angle.jump" in told.ids


def gray(value: int) -> int:
    return value ^ value >> 1


@pytest.mark.triggers("angle.gray_code")
@pytest.mark.parametrize("device", ["lir-918", "lir-ma158k"])
def test_trap_23_the_wrong_gray_setting(device: str) -> None:
    """At steady turning the value steps by powers of two: Gray against binary, not noise."""
    script = encoder(device).heartbeat(0, 8000)
    told = script.pdo(5, 8000, 20, lambda k: gray(40_000 + 3 * k)).told()
    if device == "lir-918":
        found = told.finding("angle.gray_code")
        assert says(found.text, "Gray", "powers of two")
        assert says(found.cause + found.check_next, "6000h", "bit 12")
        assert "angle.jump" not in told.ids
    else:
        assert "angle.gray_code" not in told.ids


@pytest.mark.triggers("angle.gray_code")
@pytest.mark.parametrize("first_wrong", [True, False])
def test_trap_23_a_gray_setting_that_is_wrong_for_a_while(first_wrong: bool) -> None:
    """Before and after the write of 6000h each setting is judged by itself."""
    script = encoder("lir-918").heartbeat(0, 16_000).write(8000, 0x6000, 0, 0x1000)
    parts = [lambda k: gray(20_000 + 3 * k), lambda k: 40_000 + 3 * k]
    for start, value in zip((5, 8005), parts if first_wrong else parts[::-1], strict=True):
        script.pdo(start, start + 7990, 20, value)
    assert says(script.told().finding("angle.gray_code").text, "Gray code is read as binary")


@pytest.mark.near_miss("angle.gray_code")
@pytest.mark.parametrize("step", [0, 1, 3, 64, 4096])
def test_trap_23_steady_turning_by_powers_of_two_is_binary(step: int) -> None:
    told = turning(encoder("lir-918"), 0, 8000, step=step).told()
    assert "angle.gray_code" not in told.ids


def test_trap_24_the_range_changes_at_the_restart() -> None:
    """Write 6001h, save, restart: the new modulus holds from the restart on."""
    script = encoder("lir-918").write(1000, 0x6001, 0, 4096).save(1100)
    script.heartbeat(0, 3000).pdo(5, 3000, 20, lambda _: 12_288)
    script.nmt(3000, 0x81).boot(3100).nmt(7100, 0x01)
    told = script.heartbeat(7200, 9000).pdo(7205, 9000, 20, lambda _: 6144).told()
    turns = told.trace().columns["turn"]
    degrees = told.trace().columns["angle_deg"]
    assert (turns[0], degrees[0]) == (1, 180.0)
    assert (turns[140], degrees[140]) == (1, 180.0)
    assert (turns[-1], degrees[-1]) == (1, 180.0)
    assert told.object(0x6001).value == 4096


def test_trap_25_a_6001h_write_on_the_others() -> None:
    """0601 0002: normal, writable on the LIR-918 only."""
    told = turning(encoder(), 0, 3000).write(1000, 0x6001, 0, 4096, abort=0x06010002).told()
    assert [f.severity for f in told.findings("sdo.abort")] == ["info"]
    assert told.object(0x6001).value == TURN


def test_trap_26_writes_to_1800h_1() -> None:
    """Acknowledged, the identifier unchanged: only bit 31 counts."""
    told = turning(encoder(), 0, 3000).write(1000, 0x1800, 1, 0x1E5).told()
    assert told.pdo(0x181).frames == 150
    assert told.object(0x1800, 1).value == 0x181
    assert says(told.finding("device.identifier_kept").text, "1E5h", "181h", "bit 31")


def test_trap_27_6503h_and_6505h_are_missing() -> None:
    """EMCY bytes 3..6 are decoded although the objects abort 0602 0000."""
    script = turning(encoder(), 0, 3000).emcy(1000, 0x7320, 0x01, "0100040000")
    told = script.read(1500, 0x6503, abort=0x06020000).read(1510, 0x6505, abort=0x06020000).told()
    details = told.emcy[0].details
    assert (details["alarms"], details["warnings"]) == (1, 4)
    (note,) = told.findings("sdo.abort")
    assert note.severity == "info"
    assert "6503h:00" in note.text
    assert "6505h:00" in note.text


@pytest.mark.parametrize(("index", "sub"), [(0x1010, 2), (0x1010, 3), (0x1011, 2), (0x1011, 3)])
def test_trap_28_single_groups_cannot_be_stored(index: int, sub: int) -> None:
    """An abort on the store of one group is normal here, present on the old LIR-DA158."""
    script = turning(encoder(), 0, 3000)
    value = 0x65766173 if index == 0x1010 else 0x64616F6C
    told = script.write(1000, index, sub, value, abort=0x06090011).told()
    assert told.accusations == []


@pytest.mark.parametrize("index", [0x100C, 0x100D, 0x1017])
def test_trap_29_the_toggle_restarts_at_0(index: int) -> None:
    """After writes to 100Ch, 100Dh or 1017h: no toggle error, no restart."""
    script = encoder().read(-40, 0x100C, 0, 100, size=2).read(-30, 0x100D, 0, 3, size=1)
    for at, first in ((0, 0), (3000, 0)):
        for k in range(29 if at == 0 else 30):
            toggle = 0x80 if (k + first) % 2 else 0
            script.frame(at + k * 100, "701#R")
            script.frame(at + k * 100 + 1, f"701#{OPERATIONAL | toggle:02X}")
    script.write(2950, index, 0, 0 if index == 0x1017 else 100 if index == 0x100C else 3)
    told = script.told()
    assert told.row().toggle_errors == 0
    assert "nmt.guard_toggle" not in told.ids
    assert "nmt.unexpected_reset" not in told.ids


def test_trap_30_stopped_keeps_the_green_led_on() -> None:
    """Nothing tells Operational but the node's own word: Stopped stays Stopped."""
    script = turning(encoder(), 0, 3000).nmt(3000, 0x02).heartbeat(3050, 8000, STOPPED)
    told = script.told()
    assert told.state_at(7000).state == "STOPPED"
    assert told.accusations == []


def test_trap_31_the_wrap_as_in_the_old_sheet() -> None:
    """At 6002h, here of a multi-turn unit."""
    script = encoder().heartbeat(0, 1000).frame(100, "181#FEFFFF01").frame(120, "181#03000000")
    told = script.told()
    turned = told.trace().columns["unwrapped_deg"]
    assert (turned[1] - turned[0]) * TURN / 360 == pytest.approx(5)
    assert told.accusations == []


def test_trap_31_aliasing_at_515_ms() -> None:
    """As there, on a single-turn unit."""
    script = Script("lir-da158a").read(-90, 0x6001, 0, 131072).read(-80, 0x6002, 0, 131072)
    script.read(-70, 0x6502, 0, 1, size=2).heartbeat(0, 30_000)
    told = script.pdo(5, 30_000, 515, lambda k: (k * 70_000) % 131072).told()
    assert told.trace_row().flags["ambiguous"] > 50
    assert told.accusations == []


def test_trap_31_switches_over_2101h() -> None:
    """As there: the old id after save and reset comes from the switches."""
    script = turning(encoder(), 0, 3000).write(1000, 0x2101, 0, 10).save(1100).nmt(3000, 0x81)
    told = script.boot(3100).heartbeat(7200, 9000, PRE_OPERATIONAL).told()
    assert says(told.finding("device.node_id_change").text, "rotary switches")


def test_trap_31_emcy_7510h_is_late() -> None:
    """As there: bus-off before t."""
    script = turning(encoder(), 0, 3000).emcy(5000, 0x7510, 0x10)
    turning(script, 5010, 8000).node = 9
    script.heartbeat(0, 8000)
    assert says(script.told().finding("error.bus_off").text, "was bus-off", "7510h")


def test_trap_31_stopped_is_mute() -> None:
    """As there: unanswered requests in Stopped are the client's mistake."""
    script = turning(encoder(), 0, 3000).nmt(3000, 0x02).heartbeat(3050, 8000, STOPPED)
    told = script.frame(5000, "601#4004600000000000").told()
    for found in told.findings("sdo.no_answer"):
        assert says(found.text + found.cause, "STOPPED", "client")


def test_every_trap_of_the_sheet_is_here() -> None:
    assert numbered_traps(globals()) == set(range(1, TRAPS + 1))


@pytest.mark.parametrize("batch", [1 << 20, 50])
def test_trap_02_a_heartbeat_that_a_remote_frame_emptied_cuts_no_trace(batch: int) -> None:
    script = Script("lir-ma158k").read(-90, 0x6000, 0, 0, size=2).read(-80, 0x6001, 0, 8192)
    script.read(-70, 0x6002, 0, 8192 * 4096).read(-60, 0x1017, 0, 100, size=2)
    script.heartbeat(0, 3000).frame(3050, "701#R").heartbeat(3100, 9000, 0)
    told = script.pdo(5, 9000, 20, lambda k: 1000 + 7 * k).told(batch)
    assert [event.text for event in told.events("cut")] == []
    assert told.trace().segment.max() == 0


def test_trap_02_a_reset_after_it_cuts_the_trace() -> None:
    script = Script("lir-ma158k").read(-90, 0x6000, 0, 0, size=2).read(-80, 0x6001, 0, 8192)
    script.read(-70, 0x6002, 0, 8192 * 4096).read(-60, 0x1017, 0, 100, size=2)
    script.heartbeat(0, 3000).frame(3050, "701#R").heartbeat(3100, 5000, 0).nmt(5000, 0x81)
    script.boot(9000, 0x7F).nmt(9050, 0x01).heartbeat(9100, 12_000)
    script.pdo(5, 5000, 20, lambda k: 1000 + 7 * k).pdo(9105, 12_000, 20, lambda k: 90 + 7 * k)
    assert [event.text for event in script.told().events("cut")] == ["reset command"]


def guarded(remote: Script) -> Script:
    """A node that is asked by remote frames, and was off for a second at 5 s."""
    remote.read(-90, 0x6000, 0, 0, size=2).read(-80, 0x6001, 0, 8192)
    remote.read(-70, 0x6002, 0, 8192 * 4096).read(-60, 0x1017, 0, 100, size=2)
    remote.heartbeat(0, 5000).boot(6000).heartbeat(6100, 9000)
    remote.pdo(5, 5000, 20, lambda k: 1000 + 7 * k)
    return remote.pdo(6105, 9000, 20, lambda k: 90_000 + 7 * k)


@pytest.mark.parametrize("batch", [1 << 20, 50])
@pytest.mark.parametrize("period", [100, 500, 20_000])
def test_trap_02_a_boot_up_of_a_node_with_states_since_the_remote_frame_cuts_the_trace(
    period: int, batch: int
) -> None:
    """It was asked, and told its states all the same: its heartbeats are not empty."""
    script = guarded(Script("lir-ma158k").every(-20, 9000, period, "701#R"))
    assert [event.text for event in script.told(batch).events("cut")] == ["boot-up"]
