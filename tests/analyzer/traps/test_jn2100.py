"""The traps of the ifm JN2100 sheet, each through the whole analysis."""

from collections.abc import Callable

import numpy as np
import pytest

from syncline_schemas.batch import FrameFlag
from tests.analyzer.traps.script import (
    OPERATIONAL,
    PRE_OPERATIONAL,
    STOPPED,
    T0,
    Script,
    numbered_traps,
    says,
)

TRAPS = 35
LONG, LATERAL = 0x6010, 0x6020


def tilt(**changes: object) -> Script:
    """A JN2100 as node 10, described by the user."""
    return Script("jn2100", 10, **changes)  # type: ignore[arg-type]


def running(script: Script, start: float, stop: float, *values: int) -> Script:
    """Heartbeat, SYNC every 20 ms and TPDO1 after each, with always the same two values."""
    script.heartbeat(start, stop).sync(start + 1, stop)
    return script.pdo(start + 2, stop, 20, lambda _: tuple(values or (200, 100)), bits=16)


def settings(script: Script, **read: int) -> Script:
    """Settings read at the start: `res`, `quad`, `definition`, `teach`, `zero`."""
    objects = {"res": 0x6000, "quad": 0x2040, "definition": 0x2044, "teach": 0x2042, "zero": 0x2046}
    for name, value in read.items():
        script.read(
            -50 - 2 * len(script.rows), objects[name], 0, value, size=2 if name == "res" else 1
        )
    return script


@pytest.mark.triggers("pdo.silent")
def test_trap_01_operational_and_silent_without_sync() -> None:
    """Factory type 1 and no 080h on the bus: waits for SYNC, not a dead sensor."""
    told = tilt().boot(0).nmt(100, 0x01).heartbeat(110, 20_000).told()
    assert told.accusations == []
    found = told.finding("pdo.silent")
    assert says(found.text, "node 10", "SYNC", "no SYNC")
    assert says(found.cause, "SYNC")


@pytest.mark.near_miss("pdo.silent")
def test_trap_01_with_sync_it_is_not_told() -> None:
    told = running(tilt().boot(0).nmt(50, 0x01), 100, 20_000).told()
    assert "pdo.silent" not in told.ids


def test_trap_02_the_event_timer_is_idle() -> None:
    """180xh:5 = 10 is set but frames follow SYNC: the timer counts only with type FEh."""
    script = tilt().read(-4, 0x1800, 2, 1, size=1).read(-2, 0x1800, 5, 10, size=2)
    told = running(script, 0, 10_000).told()
    assert told.accusations == []
    row = told.pdo(0x18A)
    assert (row.transmission_type, row.missed) == (1, 0)
    assert row.response_us is not None


@pytest.mark.parametrize(
    ("res", "degrees", "assumed"), [(None, 20.0, True), (100, 20.0, False), (10, 2.0, False)]
)
def test_trap_03_the_scale_is_in_6000h(res: int | None, degrees: float, assumed: bool) -> None:
    """The same bytes are other angles by 6000h; without it 0.1 deg, marked as assumed."""
    script = settings(tilt(), quad=2, definition=0, teach=2, zero=2)
    if res is not None:
        settings(script, res=res)
    told = running(script, 0, 2000).told()
    assert told.trace(LONG).value[0] == pytest.approx(degrees)
    assert ("res" in told.trace(LONG).assumed) is assumed
    assert bool(told.trace_row(LONG).flags["scale_assumed"]) is assumed


def test_trap_03_a_write_rescales_from_then_on() -> None:
    script = settings(tilt(), res=100)
    running(script, 0, 4000).write(2001.5, 0x6000, 0, 10, size=2)
    told = script.told()
    assert told.trace(LONG).value[0] == pytest.approx(20.0)
    assert told.trace(LONG).value[-1] == pytest.approx(2.0)
    assert says(told.events("cut", LONG)[0].text, "resolution")


def test_trap_03_the_user_may_say_it() -> None:
    told = running(tilt(overrides="res = 10"), 0, 1000).told()
    assert told.trace(LONG).value[0] == pytest.approx(2.0)
    assert "res" not in told.trace(LONG).assumed


def test_trap_04_the_manual_divides_by_100() -> None:
    """Factory raw 3300 is 330.0 deg, not 33.00."""
    told = running(settings(tilt(), res=100, quad=2), 0, 1000, 3300, 0).told()
    assert told.trace(LONG).value[0] == pytest.approx(330.0)


def test_trap_05_minus_30_deg_is_sent_as_330() -> None:
    """A tilt through level goes from 0.0 to 359.9: continuous motion."""
    script = settings(tilt(), res=100, quad=2).heartbeat(0, 2000).sync(1, 2000)
    script.pdo(2, 2000, 20, lambda k: ((50 - k) % 3600, 0), bits=16)
    told = script.told()
    trace = told.trace(LONG)
    assert np.diff(trace.columns["unwrapped_deg"]) == pytest.approx(-0.1)
    assert told.trace_row(LONG).flags["wrap"] == 1
    assert told.trace_row(LONG).flags["jump"] == 0
    assert told.accusations == []
    row = told.trace_row(LONG)
    assert (row.unwrapped_min_deg, row.unwrapped_max_deg) == pytest.approx((-4.9, 5.0))
    assert row.unwrapped_mean_deg == pytest.approx(0.05)


@pytest.mark.near_miss("angle.ambiguous")
@pytest.mark.near_miss("angle.out_of_range")
def test_trap_06_int16_overflow_at_001_deg() -> None:
    """88B8h is 350.00 deg, not -305.36."""
    told = running(settings(tilt(), res=10, quad=2), 0, 1000, 0x88B8, 0).told()
    assert told.trace(LONG).value[0] == pytest.approx(350.0)
    assert told.findings("angle.ambiguous") == []
    assert told.accusations == []


@pytest.mark.triggers("angle.ambiguous")
def test_trap_07_int16_ambiguity_at_0001_deg() -> None:
    """TPDO1 repeats every 65.536 deg: ambiguous, with the candidates; use TPDO2."""
    script = settings(tilt(), res=1, quad=2).heartbeat(0, 1000).sync(1, 1000)
    told = script.pdo(2, 1000, 20, lambda _: (3392, 0), bits=16).told()
    row = told.trace_row(LONG)
    assert row.flags["ambiguous"] == row.samples
    found = told.findings("angle.ambiguous")[0]
    assert found.severity == "info"
    assert says(found.text, "3.392", "65.536", "200")
    assert says(found.check_next, "TPDO2")
    assert told.accusations == []


def both_widths(low: Callable[[int], int], whole: Callable[[int], int], res: int = 1) -> Script:
    """TPDO1 with 16 bits and TPDO2 with 32 bits of the longitudinal axis, 5 s."""
    script = settings(tilt(), res=res, quad=2).heartbeat(0, 5000).sync(1, 5000)
    script.pdo(2, 5000, 20, lambda k: (low(k), 0), bits=16)
    return script.pdo(3, 5000, 20, lambda k: (whole(k), 0), base=0x280)


@pytest.mark.near_miss("angle.widths_disagree")
@pytest.mark.parametrize("rate", [0, 137, -900])
def test_trap_07_tpdo1_and_tpdo2_agree_modulo_65536(rate: int) -> None:
    """The candidates are told, and where the right one is to be read."""

    def true(k: int) -> int:
        return (200_000 + rate * k) % 360_000

    told = both_widths(lambda k: true(k) % 65_536, true).told()
    assert told.trace(0x6110).value[0] == pytest.approx(200.0)
    assert told.trace_row(0x6110).flags["ambiguous"] == 0
    found = told.findings("angle.ambiguous")[0]
    assert says(found.text, "65.536", "6110h")
    assert told.findings("angle.widths_disagree") == []
    assert told.accusations == []


@pytest.mark.triggers("angle.widths_disagree")
def test_trap_07_tpdo1_and_tpdo2_that_do_not_agree_are_told() -> None:
    told = both_widths(lambda k: 100 + k % 5, lambda k: 150 + k % 5, res=100).told()
    (found,) = told.findings("angle.widths_disagree")
    assert found.severity == "error"
    assert says(found.text, "10 deg", "15 deg in 6110h", "5 deg off")


@pytest.mark.near_miss("angle.widths_disagree")
def test_trap_07_a_moment_of_disagreement_is_none() -> None:
    told = both_widths(lambda k: 100, lambda k: 150 if 50 <= k < 80 else 100, res=100).told()
    assert told.findings("angle.widths_disagree") == []


@pytest.mark.parametrize(
    ("definition", "words"),
    [(0, "perpendicular"), (1, "direction of the slope"), (2, "gimbal X"), (3, "gimbal Y")],
)
def test_trap_08_the_axes_change_their_meaning(definition: int, words: str) -> None:
    """2044h names the axes."""
    told = running(settings(tilt(), res=100, quad=2, definition=definition), 0, 1000).told()
    assert says(told.trace_row(LATERAL).shows, words)


def test_trap_08_no_alarm_at_the_singular_points() -> None:
    """Slope 0: the direction is random; that is neither noise nor a jump."""
    script = settings(tilt(), res=100, quad=2, definition=1).heartbeat(0, 2000).sync(1, 2000)
    script.pdo(2, 2000, 20, lambda k: (0, (k * 1237) % 3600), bits=16)
    told = script.told()
    assert told.accusations == []
    assert told.trace_row(LATERAL).flags["jump"] == 0


def test_trap_09_perpendicular_has_two_formulas() -> None:
    """Shown as sent: 20.7 stays 20.7, and no gravity vector is made of it."""
    told = running(settings(tilt(), res=100, quad=0, definition=0), 0, 1000, 207, 207).told()
    assert told.trace(LONG).value[0] == pytest.approx(20.7)
    assert sorted(told.traced()) == [LONG, LATERAL]


def test_trap_10_x_is_bit_2() -> None:
    """2048h = 6 is x and y; 4004h:2 = 5 is "y failed"."""
    script = running(tilt(), 0, 2000).read(500, 0x2048, 0, 6, size=1)
    told = script.read(600, 0x4004, 2, 5, size=1).told()
    axes = told.object(0x2048).meaning or ""
    assert says(axes, "x", "y")
    assert not says(axes, "z")
    assert says(told.object(0x4004, 2).meaning or "", "x", "z", "y failed")


@pytest.mark.parametrize(("index", "words"), [(0x2042, "teach"), (0x2046, "zero set")])
def test_trap_11_teach_and_zero_look_like_a_fall(index: int, words: str) -> None:
    """Both axes go to 0 after a write of 1: tied to the write; relative from then on."""
    script = settings(tilt(), res=100, quad=2, definition=0, teach=2, zero=2)
    script.heartbeat(0, 4000).sync(1, 4000).write(2000, index, 0, 1, size=1)
    script.pdo(2, 2000, 20, lambda _: (300, 250), bits=16)
    told = script.pdo(2002, 4000, 20, lambda _: (0, 0), bits=16).told()
    assert told.accusations == []
    assert [says(cut.text, words) for cut in told.events("cut", LONG)] == [True]
    assert says(told.trace_row(LONG).shows, "relative")


@pytest.mark.parametrize(
    ("read", "words"),
    [({}, "reference unknown"), ({"teach": 2, "zero": 2}, "absolute"), ({"zero": 1}, "relative")],
)
def test_trap_12_relative_or_absolute_is_invisible(read: dict[str, int], words: str) -> None:
    """The reference is unknown until 2042h and 2046h were seen."""
    told = running(settings(tilt(), res=100, **read), 0, 1000).told()
    assert says(told.trace_row(LONG).shows, words)


@pytest.mark.triggers("device.reset_by_sdo")
def test_trap_13_reset_by_sdo() -> None:
    """2002h = 1, then a boot-up without NMT: reset by SDO."""
    script = (
        tilt().sync(1, 6000).heartbeat(0, 3000).write(3000, 0x2002, 0, 1, size=1, answered=False)
    )
    script.pdo(2, 3000, 20, lambda _: (200, 100), bits=16).boot(3400).nmt(3500, 0x01)
    script.heartbeat(3510, 6000).pdo(3522, 6000, 20, lambda _: (200, 100), bits=16)
    told = script.told()
    assert "nmt.unexpected_reset" not in told.ids
    assert told.accusations == []
    found = told.finding("device.reset_by_sdo")
    assert says(found.text, "2002h", "reset by SDO", "not a spontaneous")


@pytest.mark.triggers("device.factory_reset")
def test_trap_14_a_factory_reset_moves_the_node() -> None:
    """207Fh = 1, later a reset: look for node 10 at 125 kbit/s."""
    script = Script("jn2100", 20, bitrate=500_000)
    running(script, 0, 3000).write(3000, 0x207F, 0, 1, size=1).nmt(3500, 0x81)
    script.node = 30
    script.heartbeat(0, 12_000)
    script.node = 20
    told = script.told()
    assert says(told.finding("device.factory_reset").text, "node 10", "125 kbit/s")


def test_trap_14_error_frames_then_have_this_cause() -> None:
    script = Script("jn2100", 20, bitrate=500_000)
    running(script, 0, 3000).write(3000, 0x207F, 0, 1, size=1).nmt(3500, 0x81)
    script.node = 30
    script.heartbeat(0, 12_000)
    for k in range(40):
        script.frame(5000 + 20 * k, "088#0000040000000000", flags=int(FrameFlag.ERROR))
    script.node = 20
    found = script.told().finding("device.factory_reset")
    assert says(found.text, "error frames")


def test_trap_15_a_lost_guard_master_stops_the_pdos() -> None:
    """EMCY 8130h, state 7Fh, TPDOs stop: the missing guard request is the root."""
    script = settings(tilt(), res=100).read(-4, 0x100C, 0, 100, size=2)
    script.read(-2, 0x100D, 0, 3, size=1).sync(1, 8000)
    for k in range(40):
        toggle = 0x80 if k % 2 else 0
        script.frame(k * 100, "70A#R").frame(k * 100 + 1, f"70A#{OPERATIONAL | toggle:02X}")
    script.pdo(2, 4200, 20, lambda _: (200, 100), bits=16).emcy(4210, 0x8130, 0x11)
    for k in range(20):
        toggle = 0x80 if k % 2 else 0
        at = 6000 + k * 100
        script.frame(at, "70A#R").frame(at + 1, f"70A#{PRE_OPERATIONAL | toggle:02X}")
    told = script.told()
    found = told.finding("nmt.guarding_lost")
    assert says(found.text, "guard")
    assert says(found.cause + found.text, "master")
    assert "pdo.missed" not in told.ids
    assert "nmt.left_operational" not in told.ids


@pytest.mark.triggers("device.settling")
@pytest.mark.parametrize(("value", "seconds"), [(1, "70 s"), (3, "12 s"), (5, "5 s")])
def test_trap_16_tpdo3_is_silent_up_to_70_s(value: int, seconds: str) -> None:
    """After a write to 2049h vibration values stay away for 5..70 s: filter settling."""
    script = tilt().read(-4, 0x2047, 0, 1, size=1).heartbeat(0, 80_000).sync(1, 80_000)
    script.pdo(2, 5000, 20, lambda _: (125, 981), base=0x380)
    script.write(5000, 0x2049, 0, value, size=1)
    later = 5000 + 900 * int(seconds.removesuffix(" s"))
    told = script.pdo(later, 80_000, 20, lambda _: (125, 981), base=0x380).told()
    assert told.accusations == []
    assert says(told.finding("device.settling").text, "TPDO3", "settle", seconds)


def test_trap_17_vibration_mode() -> None:
    """2047h = 1: the content of TPDO1 and TPDO2 is undefined, so no angles are drawn."""
    script = settings(tilt(), res=100)
    running(script, 0, 2000).write(2000.5, 0x2047, 0, 1, size=1)
    script.heartbeat(2010, 4000).sync(2011, 4000)
    told = script.pdo(2012, 4000, 20, lambda k: (k * 999, k), bits=16).told()
    assert told.trace_row(LONG).samples == 100
    assert told.accusations == []


def test_trap_17_the_user_may_say_the_mode() -> None:
    told = Script("jn2100", 10, overrides='output = "vibration"').heartbeat(0, 3000)
    told = (
        told.sync(1, 3000)
        .every(2, 3000, 20, "18A#C8006400")
        .every(3, 3000, 20, "38A#" + "7D000000D5030000")
    )
    assert sorted(told.told().traced()) == [0x5C10, 0x5C11]


def test_trap_17_angle_mode() -> None:
    """And TPDO3 in angle mode."""
    script = running(settings(tilt(), res=100), 0, 2000).read(-3, 0x2047, 0, 0, size=1)
    told = script.pdo(3, 2000, 20, lambda k: (k, k), base=0x380).told()
    assert 0x5C10 not in told.traced()


@pytest.mark.parametrize("code", [0x0000, 0x0012])
def test_trap_18_emcy_00xxh(code: int) -> None:
    """Code 00xxh with register bits left: one error gone, not all."""
    script = running(tilt(), 0, 3000).emcy(1000, 0x4200, 0x09).emcy(1200, 0x3100, 0x0D)
    told = script.emcy(1500, code, 0x05).told()
    assert [row.transition for row in told.emcy] == ["raised", "further", "partly cleared"]
    states = {row.code: row.status for row in told.analysis.errors}
    assert states == {0x4200: "cleared", 0x3100: "still active"}


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x4210, "device temperature"),
        (0x3120, "supply voltage"),
        (0x8110, "overrun"),
        (0x8210, "PDO not processed"),
        (0xF012, "additional functions"),
        (0x6299, "software"),
    ],
)
def test_trap_19_codes_are_groups(code: int, words: str) -> None:
    """Named by the high byte, exactly for 81xxh and 82xxh; unknown ones by number."""
    told = running(tilt(), 0, 3000).emcy(1000, code, 0x01).told()
    assert says(told.emcy[0].meaning, words)
    assert f"{code:04X}h" in told.summary


def test_trap_20_bus_off_is_told_afterwards() -> None:
    """8140h: was bus-off before t."""
    script = running(tilt(), 0, 3000).heartbeat(4000, 8000).emcy(3990, 0x8140, 0x11)
    script.node = 30
    script.heartbeat(0, 8000)
    script.node = 10
    told = script.told()
    found = told.finding("error.bus_off")
    assert says(found.text, "node 10", "was bus-off", "8140h")
    assert says(found.cause + found.check_next, "before it")


def test_trap_21_580h_is_the_answer() -> None:
    """60Ah is the request, 58Ah the answer, whatever the COB table says."""
    told = running(tilt(), 0, 2000).read(1000, 0x4080, 0, 250).told()
    (row,) = told.sdo(0x4080)
    assert (row.node, row.direction, row.value, row.result) == (10, "upload", 250, "ok")
    assert row.answer_us == pytest.approx(1000)


@pytest.mark.parametrize("state", [PRE_OPERATIONAL, STOPPED])
def test_trap_22_rtr_answers_outside_operational(state: int) -> None:
    """18A#R answered in Pre-operational or Stopped: allowed by this manual."""
    script = settings(tilt(), res=100).heartbeat(0, 3000, state).nmt(-1, 0x80 if state > 9 else 2)
    for k in range(10):
        script.frame(1000 + 100 * k, "18A#R").frame(1001 + 100 * k, "18A#C8006400")
    told = script.told()
    assert "nmt.pdo_outside_operational" not in told.ids
    assert told.accusations == []
    assert told.state_at(1500).state == ("PRE-OPERATIONAL" if state > 9 else "STOPPED")


def test_trap_22_unasked_it_is_a_violation() -> None:
    script = settings(tilt(), res=100).heartbeat(0, 3000, STOPPED)
    for k in range(10):
        script.frame(1001 + 100 * k, "18A#C8006400")
    assert "nmt.pdo_outside_operational" in script.told().ids


@pytest.mark.triggers("device.foreign_identifiers")
def test_trap_23_identifiers_of_another_node() -> None:
    """Heartbeat on 70Ch, PDOs on 18Ah: the connection set belongs to node 10, offer to bind."""
    script = Script("jn2100", 12).heartbeat(0, 5000).sync(1, 5000)
    told = script.every(2, 5000, 20, "18A#C8006400").every(3, 5000, 20, "28A#" + "00" * 8).told()
    found = told.finding("device.foreign_identifiers")
    assert found.severity in ("info", "warning")
    assert says(found.text, "node 12", "18Ah", "node 10")
    assert says(found.check_next, "1800:1")


def test_trap_23_the_user_binds_them() -> None:
    """Sheet 8: pdo_owner = {18A: 12}."""
    bound = Script("jn2100", 12, overrides="pdo_owner = { 18A = 12 }").heartbeat(0, 5000)
    told = bound.sync(1, 5000).every(2, 5000, 20, "18A#C8006400").told()
    assert told.trace(0x6010).value[0] == 20.0
    assert "device.foreign_identifiers" not in told.ids


@pytest.mark.near_miss("device.foreign_identifiers")
def test_trap_23_a_node_10_that_lives_is_no_riddle() -> None:
    script = Script("jn2100", 12).heartbeat(0, 5000).sync(1, 5000)
    script.every(2, 5000, 20, "18A#C8006400").every(50, 5000, 100, "70A#05")
    assert "device.foreign_identifiers" not in script.told().ids


@pytest.mark.parametrize("command", [0x81, 0x82])
def test_trap_24_an_id_change_waits_for_the_reset(command: int) -> None:
    """Write 2000h, nothing happens; after the reset another node boots: the two are linked."""
    script = running(tilt(), 0, 5000).write(2000, 0x2000, 0, 12, size=1).nmt(5000, command)
    script.node = 12
    script.boot(5200).heartbeat(5300, 10_000).sync(5001, 10_000)
    script.node = 5
    script.heartbeat(0, 10_000)
    script.node = 10
    told = script.told()
    assert says(told.finding("device.node_id_change").text, "node 10", "now node 12")
    assert told.accusations == []


@pytest.mark.parametrize(("value", "rate"), [(125, "125 kbit/s"), (500, "500 kbit/s")])
def test_trap_25_2001h_is_kbit_s(value: int, rate: str) -> None:
    """7D 00 is 125, F4 01 is 500: not an index."""
    told = running(tilt(), 0, 2000).read(1000, 0x2001, 0, value, size=2).told()
    assert told.object(0x2001).meaning == rate


def test_trap_25_100_kbit_s_is_not_supported() -> None:
    told = running(tilt(), 0, 2000).write(1000, 0x2001, 0, 100, size=2).told()
    found = told.finding("device.bit_rate_change")
    assert found.severity == "warning"
    assert says(found.text, "100", "not")


def terminated(*, errors: int, read: int | None = None) -> Script:
    """Four JN2100 on a bus with so many error frames."""
    script = Script("jn2100", 10)
    script.more = "".join(f'[node.{n}]\ndevice = "jn2100"\n' for n in (11, 12, 13))
    for node in (10, 11, 12, 13):
        script.node = node
        script.heartbeat(node, 10_000)
        if read is not None:
            script.read(200 + 5 * node, 0x2045, 0, read, size=1)
    for k in range(errors):
        script.frame(1000 + 50 * k, "008#0000040000000000", flags=int(FrameFlag.ERROR))
    return script


@pytest.mark.triggers("device.terminators")
def test_trap_26_the_terminator_is_on_in_every_unit() -> None:
    """Many error frames with several factory-set units: hint at 2045h."""
    found = terminated(errors=60, read=1).told().finding("device.terminators")
    assert says(found.text, "4", "2045h", "error frames")
    assumed = terminated(errors=60).told().finding("device.terminators")
    assert assumed.assumed


@pytest.mark.near_miss("device.terminators")
def test_trap_26_switched_off_or_without_errors_it_is_not_told() -> None:
    assert "device.terminators" not in terminated(errors=60, read=0).told().ids
    assert "device.terminators" not in terminated(errors=0, read=1).told().ids


def test_trap_27_not_storable() -> None:
    """1802h:2 and 1005h are back at the factory value after a reset, in spite of the save."""
    script = running(tilt(), 0, 3000).write(1000, 0x1802, 2, 0xFE, size=1).save(1500)
    told = running(script.nmt(3000, 0x82).boot(3100).nmt(3200, 0x01), 3300, 6000).told()
    found = told.finding("device.lost_at_reset")
    assert says(found.text, "1802h:02", "not stor")
    assert found.severity == "info"


def test_trap_28_save_keeps_1000h_to_1fffh() -> None:
    """After a reset resolution, quadrant and definition are assumed until they are read again."""
    script = running(settings(tilt(), res=100, quad=2, definition=0), 0, 2000)
    script.write(500, 0x6000, 0, 10, size=2).write(510, 0x2040, 0, 1, size=1).save(600)
    told = running(script.nmt(2000, 0x81).boot(2100).nmt(2200, 0x01), 2300, 4000).told()
    flags = told.trace(LONG).flags
    assumed = (flags >> 5 & 1).astype(bool)
    after = told.trace(LONG).seq > told.events("cut", LONG)[-1].seq
    assert assumed[after].all()
    assert {"res", "quad"} <= set(told.trace(LONG).assumed)


def test_trap_29_the_mapping_is_fixed() -> None:
    """A write to 1A0xh must abort; it is not followed."""
    script = running(settings(tilt(), res=100), 0, 3000)
    script.write(1000, 0x1A00, 1, 0x61100020, size=4, abort=0x06010002)
    told = script.write(1010, 0x1A00, 0, 1, size=1).told()
    assert told.trace_row(LONG).samples == 150
    assert sorted(told.traced()) == [LONG, LATERAL]
    assert told.trace(LONG).value[-1] == pytest.approx(20.0)


def test_trap_30_6000h_is_a_resolution_here() -> None:
    """6000h = 0064h: the profile is chosen by 1000h (019Ah), not by the index."""
    script = Script(None, 10).heartbeat(0, 2000).sync(1, 2000)
    script.read(-9, 0x1000, 0, 0x0004019A).read(-7, 0x6000, 0, 10, size=2)
    script.read(-5, 0x1A00, 0, 2, size=1).read(-4, 0x1A00, 1, 0x60100010)
    script.read(-3, 0x1A00, 2, 0x60200010)
    told = script.pdo(2, 2000, 20, lambda _: (200, 100), bits=16).told()
    assert told.trace(LONG).unit == "deg"
    assert told.trace(LONG).value[0] == pytest.approx(2.0)


def test_trap_31_fifty_errors() -> None:
    """1003h:0 up to 50: all of them are read."""
    script = running(tilt(), 0, 3000).read(100, 0x1003, 0, 50, size=1)
    for sub in range(1, 51):
        script.read(110 + 10 * sub, 0x1003, sub, 0x4200 + (sub % 2) * 0x10)
    told = script.told()
    assert told.accusations == []
    assert len([o for o in told.analysis.objects if o.index == 0x1003]) == 51
    entries = [e for e in told.analysis.error_history if e.node == 10 and e.sub]
    assert len(entries) == 50


@pytest.mark.parametrize("vendor", [0x0069666D, 0x159])
def test_trap_32_vendor_id_and_pdo_set_vary(vendor: int) -> None:
    """1008h names the device whatever the vendor id; a fourth PDO on 480h + id is its own."""
    script = Script(None, 10).heartbeat(0, 3000).sync(1, 3000).read(-20, 0x1018, 1, vendor)
    script.frame(-15, "60A#4008100000000000").frame(-14, "58A#4108100006000000")
    script.frame(-13, "60A#6000000000000000").frame(-12, "58A#034A4E3231303000")
    told = script.every(2, 3000, 20, "48A#000001000200").told()
    assert told.row().device == "jn2100"
    assert told.accusations == []
    row = told.pdo(0x48A)
    assert (row.node, row.frames) == (10, 150)
    assert says(row.pdo or "", "TPDO4")


@pytest.mark.triggers("angle.out_of_range")
def test_trap_33_an_impossible_angle() -> None:
    """-237.0 deg: 6000h or 2040h was assumed wrong, not a sensor fault."""
    told = running(tilt(), 0, 2000, -2370, 100).told()
    found = told.finding("angle.out_of_range")
    assert says(found.text, "-237")
    assert says(found.cause, "6000h", "2040h", "assumed", "sensor itself may be fine")
    assert found.assumed


@pytest.mark.triggers("device.overload_by_settings")
def test_trap_34_the_bus_load_at_feh() -> None:
    """Three PDOs every 10 ms are 36.5 kbit/s per unit: overload by settings at 50 kbit/s."""
    script = Script("jn2100", 10, bitrate=50_000)
    script.more = '[node.11]\ndevice = "jn2100"\n'
    for node in (10, 11):
        script.node = node
        script.heartbeat(node, 10_000, period=500)
        for pdo in range(3):
            script.read(30 + 20 * node + 5 * pdo, 0x1800 + pdo, 2, 0xFE, size=1)
            script.read(32 + 20 * node + 5 * pdo, 0x1800 + pdo, 5, 10, size=2)
        script.pdo(500 + node, 10_000, 20, lambda _: (200, 100), bits=16)
    found = script.told().finding("device.overload_by_settings")
    assert says(found.text, "50 kbit/s", "node 10", "node 11")


@pytest.mark.near_miss("device.overload_by_settings")
def test_trap_34_at_500_kbit_s_there_is_room() -> None:
    script = running(tilt(bitrate=500_000), 0, 5000)
    for pdo in range(3):
        script.read(30 + 5 * pdo, 0x1800 + pdo, 2, 0xFE, size=1)
    assert "device.overload_by_settings" not in script.told().ids


@pytest.mark.triggers("config.guarding_and_heartbeat")
def test_trap_35_heartbeat_and_guarding_both_set() -> None:
    """Which one wins is not said: report what is seen, warn about the setting."""
    script = running(tilt(), 0, 3000).read(-9, 0x1017, 0, 100, size=2)
    told = script.read(-7, 0x100C, 0, 100, size=2).read(-5, 0x100D, 0, 3, size=1).told()
    found = [f for f in told.analysis.findings if f.id.startswith("config.") and f.node == 10]
    assert any(says(f.text, "1017h", "100Ch") for f in found), told.text
    assert told.row().heartbeats == 30


@pytest.mark.near_miss("config.guarding_and_heartbeat")
def test_trap_35_guarding_set_without_a_life_time_is_off() -> None:
    script = running(tilt(), 0, 3000).read(-9, 0x1017, 0, 100, size=2)
    told = script.read(-7, 0x100C, 0, 100, size=2).read(-5, 0x100D, 0, 0, size=1).told()
    assert "config.guarding_and_heartbeat" not in told.ids


@pytest.mark.near_miss("device.reset_by_sdo")
def test_trap_13_a_write_of_0_resets_nothing() -> None:
    script = running(tilt(), 0, 3000).write(1000, 0x2002, 0, 0, size=1)
    assert "device.reset_by_sdo" not in script.told().ids


def test_every_trap_of_the_sheet_is_here() -> None:
    assert numbered_traps(globals()) == set(range(1, TRAPS + 1))


def test_a_value_that_rests_on_an_assumed_scale_is_said_to_beside_an_error() -> None:
    """The cause of an EMCY names the inclination; 6000h was never read."""
    script = running(tilt(), 1, 8000).emcy(4210, 0x4210, 0x09)
    found = script.told().finding("emcy.active")
    assert says(found.cause, "by an assumed scale")
    assert any(text.startswith("scale of") for text in found.assumed)


# -- ranges of the angles (sheet 6.2, 6.3, 6.6)

READ = {"res": 100, "quad": 2, "definition": 0, "teach": 2, "zero": 2}


@pytest.mark.triggers("angle.out_of_range")
@pytest.mark.parametrize(
    ("read", "values", "outside"),
    [
        ({"quad": 0}, (1200, 850), [LONG]),
        ({"quad": 0}, (-901, 1500), [LONG, LATERAL]),
        ({"quad": 2}, (3600, 0), [LONG]),
        ({"quad": 1}, (1801, -1800), [LONG]),
        ({"quad": 1, "definition": 2}, (910, 1790), [LONG]),
        ({"quad": 0, "definition": 3}, (1790, 910), [LATERAL]),
        ({"quad": 2, "definition": 1}, (300, 3600), [LATERAL]),
    ],
)
def test_angles_that_the_settings_rule_out(
    read: dict[str, int], values: tuple[int, int], outside: list[int]
) -> None:
    told = running(settings(tilt(), **READ | read), 0, 1000, *values).told()
    rows = {index: told.trace_row(index) for index in (LONG, LATERAL)}
    assert [i for i, row in rows.items() if row.flags["out_of_range"] == row.samples] == outside
    assert [i for i, row in rows.items() if row.flags["out_of_range"]] == outside
    found = told.finding("angle.out_of_range")
    assert says(found.text, "the scale is as it was read")


@pytest.mark.near_miss("angle.out_of_range")
@pytest.mark.parametrize(
    ("read", "values"),
    [
        ({"quad": 0}, (900, -900)),
        ({"quad": 0, "zero": 1}, (1200, -1500)),
        ({"quad": 0, "definition": 1}, (1200, 3599)),
        ({"quad": 0, "definition": 2}, (900, 1800)),
        ({"quad": 1}, (1200, -1800)),
        ({"quad": 2}, (3599, 0)),
    ],
)
def test_angles_that_the_settings_allow(read: dict[str, int], values: tuple[int, int]) -> None:
    """A zero point is subtracted, so that angles may leave the half circle."""
    told = running(settings(tilt(), **READ | read), 0, 1000, *values).told()
    assert told.accusations == []
    assert not told.trace_row(LONG).flags["out_of_range"]


def test_a_zero_point_that_nobody_told_of_is_said_to_be_assumed_away() -> None:
    read = {name: value for name, value in READ.items() if name != "zero"}
    told = running(settings(tilt(), **read | {"quad": 0}), 0, 1000, 1200, 0).told()
    found = told.finding("angle.out_of_range")
    assert says(found.text, "the scale is assumed")
    assert found.assumed == ["no zero point (2046h)"]


def test_one_wrong_resolution_is_one_finding() -> None:
    """TPDO1 and TPDO2 show the same impossible angle."""
    script = running(settings(tilt(), quad=2), 0, 1000, -2370, 0)
    script.pdo(3, 1000, 20, lambda _: (-2370, 0), base=0x280)
    found = script.told().finding("angle.out_of_range")
    assert says(found.text, "longitudinal 16", "longitudinal 32", "-237 deg")


def test_sixteen_bits_are_unsigned_where_the_user_says_so() -> None:
    """2040h = 1 was read, TPDO1 sends 350.00 deg all the same, TPDO2 -10.00."""
    script = settings(tilt(overrides='i16_unsigned = "yes"'), **READ | {"res": 10, "quad": 1})
    running(script, 0, 1000, 35_000, 0).pdo(3, 1000, 20, lambda _: (-1000, 0), base=0x280)
    told = script.told()
    assert told.accusations == []
    assert "device.wrong_device" not in told.ids
    assert told.trace(LONG).value[0] == pytest.approx(350.0)
    assert told.trace(0x6110).value[0] == pytest.approx(-10.0)
    assert says(told.trace_row(LONG).shows, "0 .. 360 deg")


def reset_half_way(zero: int) -> Script:
    script = running(settings(tilt(), **READ | {"zero": zero}), 0, 900)
    return running(script.nmt(950, 0x81).boot(970).nmt(980, 0x01), 1000, 2000)


@pytest.mark.parametrize(("zero", "shows"), [(2, "reference unknown"), (1, "relative")])
def test_a_reset_leaves_the_reference_unknown(zero: int, shows: str) -> None:
    """Whether 2042h survives is not said (traps 12 and 28); a zero point is stored at once."""
    row = reset_half_way(zero).told().trace_row(LONG)
    assert says(row.shows, shows)
    assert not says(row.shows, "absolute")


def test_what_is_read_again_after_a_reset_is_no_longer_assumed() -> None:
    """Trap 28: assumed after a reset until read again, also where the value is the same."""
    script = reset_half_way(2)
    objects = ((0x2042, 2), (0x2046, 2), (0x6000, 100), (0x2040, 2), (0x2044, 0))
    for count, (index, value) in enumerate(objects):
        script.read(1500 + 3 * count, index, 0, value, size=2 if index == 0x6000 else 1)
    told = script.told()
    assert says(told.trace_row(LONG).shows, "absolute")
    assumed = told.trace(LONG).flags & 1 << 5 != 0
    moments_ms = (told.trace(LONG).t_ns - T0) / 1e6
    assert not assumed[(moments_ms < 950) | (moments_ms > 1520)].any()
    assert assumed[(moments_ms > 1000) & (moments_ms < 1500)].all()


def test_a_pose_that_is_held_has_no_spread_below_nothing() -> None:
    told = running(settings(tilt(), **READ), 0, 1000, 0, 0).told()
    std = told.trace_row(LONG).std_deg
    assert std == 0
    assert str(std) == "0.0"


@pytest.mark.triggers("device.wrong_device")
def test_some_impossible_angles_put_the_named_device_in_doubt() -> None:
    """An encoder named a JN2100: of its counts a part is impossible as an angle."""
    script = tilt()
    script.heartbeat(0, 5000).pdo(5, 5000, 50, lambda k: (2000 + 30 * k, 0), bits=16)
    told = script.told()
    row = told.trace_row(LONG)
    assert 0.1 * row.samples < row.flags["out_of_range"] < 0.5 * row.samples
    found = told.finding("device.wrong_device")
    assert (found.severity, says(found.text, "was named a JN2100")) == ("info", True)


def test_views_say_how_the_values_are_read() -> None:
    told = running(settings(tilt(), **READ), 0, 1000).told()
    assert says(told.summary, "traces read as", "0 .. 360 deg", "absolute")


def test_the_pdo_that_a_node_sends_is_not_the_one_that_it_complains_of() -> None:
    """8210h: the last PDO before it was its own TPDO2, which it does not receive."""
    script = settings(tilt(), res=100).heartbeat(0, 5000).sync(0, 5000)
    script.pdo(1, 5000, 20, lambda _: (50, 60), bits=16)
    script.pdo(2, 5000, 20, lambda _: (50, 60), base=0x280).emcy(3010, 0x8210, 0x11)
    found = script.told().finding("emcy.pdo_length")
    assert "28Ah" not in found.text + found.cause
    assert "no PDO of another node came just before" in found.text


def test_a_pdo_of_another_node_is_the_one_that_it_complains_of() -> None:
    script = settings(tilt(), res=100).heartbeat(0, 5000).sync(0, 5000)
    script.pdo(1, 5000, 20, lambda _: (50, 60), bits=16).emcy(3010, 0x8210, 0x11)
    script.every(0, 5000, 50, "19B#0102")
    assert "19Bh with 2 bytes" in script.told().finding("emcy.pdo_length").text


def after_self_test(result: int, at: float = 5000) -> Script:
    script = settings(tilt(), res=100).heartbeat(0, 20_000)
    return script.write(1000, 0x4004, 1, 1, size=1).read(at, 0x4004, 2, result, size=1)


@pytest.mark.triggers("device.self_test_failed")
def test_trap_10_an_axis_that_failed_the_self_test_is_told() -> None:
    """4004h:2 = 5: bit 1 is y."""
    found = after_self_test(5).told().finding("device.self_test_failed")
    assert found.severity == "warning"
    assert "4004h:02 (MEMS self-test result) = 5 (x ok, y failed, z ok)" in found.text
    assert "later" not in found.text
    again = after_self_test(5).write(9000, 0x4004, 1, 1, size=1).read(12_500, 0x4004, 2, 7, size=1)
    assert "A later self-test was passed." in again.told().finding("device.self_test_failed").text


@pytest.mark.near_miss("device.self_test_failed")
@pytest.mark.parametrize(
    "script", [after_self_test(7), after_self_test(0, 2000), after_self_test(0, 500)], ids="abc"
)
def test_a_good_result_and_one_of_no_test_are_no_failure(script: Script) -> None:
    assert "device.self_test_failed" not in script.told().ids


@pytest.mark.near_miss("device.self_test_failed")
def test_a_result_after_a_restart_is_of_no_test() -> None:
    script = after_self_test(0, 6000).nmt(3000, 0x81).boot(3500)
    assert "device.self_test_failed" not in script.told().ids


def test_trap_28_a_scale_that_was_read_before_a_reset_is_not_called_unseen() -> None:
    script = settings(tilt(), res=10).heartbeat(0, 3000).nmt(3000, 0x81).boot(3500)
    script.nmt(3600, 0x01).heartbeat(3700, 9000).sync(0, 9000)
    script.pdo(3702, 9000, 20, lambda k: (200 + k % 50, 100), bits=16)
    found = script.told().finding("angle.scale_assumed")
    assert "resolution (6000h) was not known all the time" in found.text
    assert "not again after the node started anew" in found.cause
    plain = tilt().heartbeat(0, 9000).sync(0, 9000)
    plain.pdo(2, 9000, 20, lambda k: (200 + k % 50, 100), bits=16)
    assert "was not seen in this capture" in plain.told().finding("angle.scale_assumed").text


def second_test(result: int) -> Script:
    """A passed self-test, and a result that is read while the next one runs."""
    script = after_self_test(7).write(9000, 0x4004, 1, 1, size=1)
    return script.read(9500, 0x4004, 2, 0, size=1).read(13_000, 0x4004, 2, result, size=1)


def unseen_restart() -> Script:
    script = after_self_test(0, 9000)
    script.gaps.append((2000, 6000))
    script.rows = [row for row in script.rows if not 2000 <= row[0] < 6000]
    return script


@pytest.mark.near_miss("device.self_test_failed")
@pytest.mark.parametrize("script", [second_test(7), unseen_restart()], ids=["running", "gap"])
def test_a_result_that_need_not_be_of_a_test_is_no_failure(script: Script) -> None:
    assert "device.self_test_failed" not in script.told().ids


def test_the_second_self_test_is_told_and_a_good_result_without_a_test_passes_none() -> None:
    found = second_test(5).told().finding("device.self_test_failed")
    assert "at +13.050 s" in found.text
    script = after_self_test(5).read(9000, 0x4004, 2, 7, size=1)
    assert "later" not in script.told().finding("device.self_test_failed").text


def test_a_pdo_that_a_node_does_not_send_may_be_the_one_that_it_complains_of() -> None:
    """Its TPDO2 is off: another node sends on that identifier."""
    script = settings(tilt(), res=100).heartbeat(0, 5000).read(-40, 0x1801, 1, 0x8000028A)
    script.every(0, 5000, 50, "28A#0102").emcy(3010, 0x8210, 0x11)
    assert "28Ah with 2 bytes" in script.told().finding("emcy.pdo_length").text


@pytest.mark.parametrize("at", [2000, 8000], ids=["before the reset", "after it"])
def test_a_new_number_counts_as_saved_only_where_it_was_saved_under_it(at: int) -> None:
    """Saved before the reset, the identifiers belong to the old number."""
    script = tilt().heartbeat(0, 5000).write(1000, 0x2000, 0, 20, size=1).nmt(5000, 0x81)
    script.node = 20 if at > 5000 else 10
    script.save(at).node = 20
    found = script.boot(6000).heartbeat(6100, 12_000).told().finding("device.node_id_change")
    assert found.check_next.startswith("Nothing") == (at > 5000)
