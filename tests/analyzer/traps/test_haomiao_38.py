"""The traps of the Haomiao 38 mm sheet, each through the whole analysis."""

import pytest

from tests.analyzer.traps.script import (
    OPERATIONAL,
    PRE_OPERATIONAL,
    STOPPED,
    Script,
    numbered_traps,
    says,
)

TRAPS = 24
RANGE = 1 << 25


def encoder(**changes: object) -> Script:
    """A Haomiao as node 1, described by the user."""
    return Script("haomiao-38", **changes)  # type: ignore[arg-type]


def turning(script: Script, start: float, stop: float, first: int = 1000, step: int = 40) -> Script:
    """TPDO1 every 100 ms of a slowly turning shaft, with the heartbeat beside it."""
    script.heartbeat(start, stop)
    return script.pdo(start + 5, stop, 100, lambda k: (first + step * k) % RANGE)


@pytest.mark.triggers("device.undocumented_write")
def test_trap_01_the_printed_direction_frame_writes_2100h() -> None:
    """601#22 00 21 00 01 is undocumented here; on a LIR it is the baud rate index."""
    told = turning(encoder(), 0, 3000).write(1500, 0x2100, value=1).told()
    found = told.finding("device.undocumented_write")
    assert found.severity == "warning"
    assert says(found.text, "2100h", "not in", "direction")
    assert says(found.text + found.cause + found.check_next, "LIR", "20 kbit/s")


def turned_round(**changes: object) -> Script:
    """6000h was read, and half-way 2100h = 1 is acknowledged."""
    script = turning(encoder(**changes).read(-10, 0x6000, 0, 0, size=2), 0, 3000)
    return script.write(1500, 0x2100, value=1)


def test_trap_01_what_related_firmware_makes_of_it_is_assumed_from_then_on() -> None:
    told = turned_round().told()
    row = told.trace_row()
    assert says(row.shows, "rising counter-clockwise")
    assert says(turning(encoder().read(-10, 0x6000, 0, 0, size=2), 0, 3000).told().trace_row().shows,
                "rising clockwise")  # fmt: skip
    assert "direction" in row.assumed
    assert row.cuts == 1
    (change,) = (c for c in told.analysis.object_changes if c.index == 0x2100)
    assert says(change.words, "counter-clockwise", "related firmware", "undocumented")


def test_trap_01_what_6000h_says_later_counts_more() -> None:
    told = turned_round().write(2000, 0x6000, value=0, size=2).told()
    assert says(told.trace_row().shows, "rising clockwise")


def test_trap_01_a_refused_write_turns_nothing_round() -> None:
    script = turning(encoder().read(-10, 0x6000, 0, 0, size=2), 0, 3000)
    told = script.write(1500, 0x2100, value=1, abort=0x06020000).told()
    assert says(told.trace_row().shows, "rising clockwise")
    assert "direction" not in told.trace_row().assumed


def test_trap_01_the_user_says_that_2100h_is_nothing() -> None:
    told = turned_round(overrides="alias_2100 = false").told()
    assert says(told.trace_row().shows, "rising clockwise")
    assert "direction" not in told.trace_row().assumed


@pytest.mark.triggers("device.bit_rate_change")
@pytest.mark.near_miss("device.undocumented_write")
def test_trap_01_on_a_lir_the_same_bytes_are_a_bit_rate() -> None:
    told = Script("lir-da158").heartbeat(0, 3000).write(1500, 0x2100, value=1).told()
    assert "device.undocumented_write" not in told.ids
    assert says(told.finding("device.bit_rate_change").text, "20 kbit/s", "reset")


@pytest.mark.parametrize(
    ("reads", "degrees", "assumed"),
    [
        ({}, 180.0, True),
        ({0x6001: 0x2000}, 180.0, False),
        ({0x6000: 0}, 180.0, False),
        ({0x6501: 8192, 0x6000: 0}, 180.0, False),
        ({0x6000: 4, 0x6001: 4096}, 0.0, False),
        ({0x6001: 4096}, 180.0, True),
    ],
)
def test_trap_02_4096_or_8192_counts_per_turn(
    reads: dict[int, int], degrees: float, assumed: bool
) -> None:
    """With scaling off 8192 counts (or 6501h), marked as assumed until something was seen."""
    script = encoder().heartbeat(0, 3000)
    for k, (index, value) in enumerate(reads.items()):
        script.read(10 + 10 * k, index, 0, value)
    told = script.pdo(500, 3000, 100, lambda _: 4096).told()
    trace = told.trace()
    assert trace.columns["angle_deg"][-1] == degrees
    assert bool({"cpr", "scaling"} & set(trace.assumed)) is assumed
    assert bool(told.trace_row().flags["scale_assumed"]) is bool(trace.assumed)


@pytest.mark.triggers("device.scaling_off")
def test_trap_03_setting_6001h_alone_does_nothing() -> None:
    """6001h acknowledged while 6000h bit 2 = 0: scaling is off, no effect."""
    script = turning(encoder(), 0, 4000, first=4096, step=0).read(20, 0x6000, 0, 0, size=2)
    told = script.write(2000, 0x6001, value=4096).told()
    assert says(told.finding("device.scaling_off").text, "6001h", "scaling is off", "no effect")
    assert told.trace().columns["angle_deg"][-1] == 180.0


@pytest.mark.near_miss("device.scaling_off")
def test_trap_03_with_scaling_on_it_counts() -> None:
    script = turning(encoder(), 0, 4000, first=4096, step=0).read(20, 0x6000, 0, 4, size=2)
    told = script.write(2000, 0x6001, value=4096).told()
    assert "device.scaling_off" not in told.ids
    assert told.trace().columns["angle_deg"][-1] == 0.0


@pytest.mark.near_miss("angle.jump")
@pytest.mark.triggers("angle.preset_by_wire")
def test_trap_04_the_hardware_preset_wire() -> None:
    """A jump onto the preset value without any SDO: set input, no overspeed alarm."""
    script = encoder().heartbeat(0, 10000)
    script.pdo(5, 5000, 20, lambda k: 5_000_000 + 40 * k)
    script.pdo(5005, 10000, 20, lambda k: 40 * k)
    told = script.told()
    found = told.finding("angle.preset_by_wire")
    assert says(found.text, "without", "preset value 0")
    assert says(found.cause, "set input")
    assert "angle.jump" not in told.ids


@pytest.mark.near_miss("angle.preset_by_wire")
@pytest.mark.triggers("angle.jump")
def test_trap_04_a_jump_elsewhere_is_a_jump() -> None:
    script = encoder().heartbeat(0, 10000)
    script.pdo(5, 5000, 20, lambda k: 5_000_000 + 40 * k)
    script.pdo(5005, 10000, 20, lambda k: 9_000_000 + 40 * k)
    told = script.told()
    assert "angle.preset_by_wire" not in told.ids
    assert says(told.finding("angle.jump").text, "jumped from 5009960 to 9000000")


def test_trap_05_another_baud_table() -> None:
    """3001h = 3 is 125 kbit/s; LIR 2100h = 3 is 100 kbit/s."""
    haomiao = turning(encoder(), 0, 1000).read(500, 0x3001, 0, 3, size=1).told()
    lir = Script("lir-da158").heartbeat(0, 1000).read(500, 0x2100, 0, 3, size=1).told()
    assert haomiao.object(0x3001).meaning == "125 kbit/s"
    assert lir.object(0x2100).meaning == "100 kbit/s"


def test_trap_06_pdos_can_be_moved_and_remapped() -> None:
    """Writes to 180xh:1 and 1A0xh are followed: another identifier and length are legal."""
    script = encoder().heartbeat(0, 6000)
    script.pdo(5, 2000, 20, lambda k: 1000 + k)
    script.write(2010, 0x1800, 1, 0x800001E5, size=4).write(2020, 0x1A00, 0, 0, size=1)
    script.write(2030, 0x1A00, 1, 0x60040020, size=4).write(2040, 0x1A00, 2, 0x65030010, size=4)
    script.write(2050, 0x1A00, 0, 2, size=1).write(2060, 0x1800, 1, 0x1E5, size=4)
    script.every(2105, 6000, 20, lambda k: f"1E5#{(1100 + k).to_bytes(4, 'little').hex()}0000")
    told = script.told()
    assert told.accusations == []
    assert told.nodes == [1]
    assert (told.pdo(0x1E5).node, told.pdo(0x1E5).pdo) == (1, "TPDO1")
    assert told.trace().value[-1] == 1100 + 194
    assert len(told.trace().value) == 100 + 195


def test_trap_06_a_moved_emcy_is_the_nodes_own() -> None:
    script = turning(encoder(), 0, 3000).write(1000, 0x1014, 0, 0x99, size=4)
    told = script.frame(2000, "099#0010010000000000").told()
    assert [(row.node, row.code) for row in told.emcy] == [(1, 0x1000)]
    assert told.nodes == [1]


def test_trap_06_a_moved_sync_is_followed() -> None:
    script = turning(encoder(), 0, 3000).write(10, 0x1005, 0, 0x90, size=4)
    script.every(100, 3000, 20, "090#")
    told = script.told()
    assert [(row.cob_id, row.count) for row in told.analysis.sync] == [(0x90, 145)]
    assert told.emcy == []
    assert told.nodes == [1]


def test_trap_07_the_mapping_is_printed_as_6004h() -> None:
    """1A00h:1 = 60040020h is what stands on the wire."""
    script = turning(encoder(), 0, 3000).read(1000, 0x1A00, 0, 1, size=1)
    told = script.read(1010, 0x1A00, 1, 0x60040020).told()
    assert told.accusations == []
    assert told.object(0x1A00, 1).value == 0x60040020
    assert told.trace_row().samples == 30


def test_trap_08_22h_and_2bh_mixed() -> None:
    """22h with four bytes on U8, 2Bh on U16: the value is of the object's type."""
    script = turning(encoder(), 0, 3000).write(1000, 0x3000, value=1).write(1010, 0x3001, value=3)
    told = script.write(1020, 0x1017, value=100, size=2).told()
    values = [told.sdo(index)[0].value for index in (0x3000, 0x3001, 0x1017)]
    assert values == [1, 3, 100]
    assert told.accusations == []


def renamed(*, saved: bool) -> Script:
    """Node 1 becomes node 10 after a reset, and is switched off and on later."""
    script = turning(encoder(), 0, 5000).write(4000, 0x3000, value=10).nmt(5000, 0x81)
    script.node = 10
    script.boot(5200).heartbeat(5300, 10000)
    if saved:
        script.save(6000)
    script.node = 10 if saved else 1
    script.boot(14000).heartbeat(14100, 18000, PRE_OPERATIONAL)
    script.node = 5
    script.heartbeat(0, 18000)
    script.node = 1
    return script


@pytest.mark.triggers("device.node_id_change")
def test_trap_09_a_change_without_save() -> None:
    """Write 3000h, reset, new id; after a power cycle the old one: the two are linked, not saved."""
    told = renamed(saved=False).told()
    found = told.findings("device.node_id_change")
    assert says(found[0].text, "node 1", "node 10", "3000h")
    assert says(" ".join(f.text + f.cause for f in found), "not saved")
    assert told.accusations == []


def test_trap_09_with_a_save_it_stays() -> None:
    told = renamed(saved=True).told()
    assert "not saved" not in " ".join(f.text for f in told.findings("device.node_id_change"))


@pytest.mark.triggers("device.lost_at_reset")
def test_trap_10_82h_drops_unsaved_settings() -> None:
    """Periods change after reset communication: back to stored values, not drift."""
    script = encoder().heartbeat(0, 3000).read(10, 0x1800, 5, 100, size=2)
    script.pdo(5, 1000, 100, lambda k: k).write(1000, 0x1800, 5, 20, size=2)
    script.pdo(1020, 3000, 20, lambda k: 10 + k).nmt(3000, 0x82).boot(3050)
    script.nmt(3100, 0x01).heartbeat(3110, 6000).pdo(3120, 6000, 100, lambda k: 200 + k)
    told = script.told()
    found = told.finding("device.lost_at_reset")
    assert found.severity == "info"
    assert says(found.text, "1800h:05", "20", "back", ("stored", "saved"))
    assert told.accusations == []
    assert told.object(0x1800, 5).value == 100


@pytest.mark.near_miss("device.lost_at_reset")
def test_trap_10_after_a_save_nothing_is_lost() -> None:
    script = encoder().heartbeat(0, 3000).read(10, 0x1800, 5, 100, size=2)
    script.write(1000, 0x1800, 5, 20, size=2).save(1500).nmt(3000, 0x82).boot(3050)
    told = script.nmt(3100, 0x01).heartbeat(3110, 6000).told()
    assert "device.lost_at_reset" not in told.ids
    assert told.object(0x1800, 5).value == 20


def test_trap_11_save_to_take_effect() -> None:
    """The examples act without a save: the period is judged by what is observed."""
    script = encoder().heartbeat(0, 6000).read(10, 0x1800, 5, 100, size=2)
    script.pdo(5, 2000, 100, lambda k: k).write(2000, 0x1800, 5, 50, size=2)
    script.pdo(2020, 4000, 100, lambda k: 20 + k).save(4000)
    script.pdo(4020, 6000, 50, lambda k: 40 + k)
    told = script.told()
    assert told.accusations == []
    assert told.object(0x1800, 5).value == 50
    period = told.pdo(0x181).period_us
    assert period is not None
    assert period.max == pytest.approx(100_000, rel=0.2)


def test_trap_12_an_emcy_without_maker_data() -> None:
    """Bytes 3..7 are always 0: alarms are unknown, not none."""
    told = turning(encoder(), 0, 3000).emcy(1000, 0x1000, 0x01).told()
    (row,) = told.emcy
    assert "alarms" not in row.details
    assert "warnings" not in row.details
    assert row.transition == "raised"
    assert told.analysis.errors[0].status == "still active"


@pytest.mark.parametrize(
    ("code", "group"),
    [
        (0x2310, "current"),
        (0x4299, "temperature"),
        (0x7077, "additional modules"),
        (0xFF42, "device"),
    ],
)
def test_trap_13_emcy_codes_are_not_listed(code: int, group: str) -> None:
    """Any code: the CiA 301 group's name and the number."""
    told = turning(encoder(), 0, 3000).emcy(1000, code, 0x01).told()
    (row,) = told.emcy
    assert row.code == code
    assert says(row.meaning, group)
    assert f"{code:04X}h" in told.summary


def maga(script: Script) -> Script:
    return script.read(10, 0x1008, 0, 0x4147414D).read(20, 0x1000, 0, 0x00020196)


def test_trap_14_maga_is_shared_by_rebrands() -> None:
    """1008h = MAGA alone names no device; 3000h or 3001h must have been seen as well."""
    alone = maga(turning(Script(), 0, 3000)).told()
    proven = maga(turning(Script(), 0, 3000)).read(30, 0x3001, 0, 3, size=1).told()
    assert alone.row().device is None
    assert proven.row().device == "haomiao-38"


def test_trap_15_650bh_ffffffff_is_not_used() -> None:
    """All units alike: not used, no duplicate serial number."""
    script = turning(encoder(), 0, 3000).read(100, 0x650B, 0, 0xFFFFFFFF)
    script.node = 2
    script.heartbeat(0, 3000).read(120, 0x650B, 0, 0xFFFFFFFF)
    script.more = '[node.2]\ndevice = "haomiao-38"\n'
    script.node = 1
    told = script.told()
    assert told.accusations == []
    assert told.object(0x650B).meaning == "not used"


def test_trap_16_1004h_is_known() -> None:
    """An object of DS 301 v3: known, no warning."""
    told = turning(encoder(), 0, 3000).read(100, 0x1004, 1, 2).told()
    assert told.accusations == []
    assert says(told.object(0x1004, 1).name or "", "synchronous PDO")


def test_trap_17_the_wrap_at_2_to_the_25() -> None:
    """1FFFFFFh, then 1: two counts on."""
    script = encoder().heartbeat(0, 3000).read(10, 0x6000, 0, 0, size=2)
    told = script.frame(100, "181#FFFFFF01").frame(120, "181#01000000").told()
    turned = told.trace().columns["unwrapped_deg"]
    assert (turned[1] - turned[0]) * 8192 / 360 == pytest.approx(2)
    assert told.trace_row().flags["wrap"] == 1
    assert told.events("jump") == []
    assert told.accusations == []


@pytest.mark.triggers("pdo.silent")
def test_trap_18_the_default_of_the_pdo_timer_is_unknown() -> None:
    """Operational without TPDO1: no alarm before 1800h:5 is known."""
    told = encoder().boot(0).nmt(100, 0x01).heartbeat(110, 60_000).told()
    assert told.accusations == []
    found = told.finding("pdo.silent")
    assert says(found.text, "181h", "1800h:05", "not known")


def test_trap_19_the_default_of_the_heartbeat_is_unknown() -> None:
    """Boot-up, then nothing on 701h: normal."""
    script = encoder().boot(0).nmt(100, 0x01).pdo(200, 60_000, 100, lambda k: 10 * k)
    told = script.told()
    assert told.accusations == []
    assert "LOST" not in told.state_names()


@pytest.mark.parametrize("booted", [10, 11])
def test_trap_20_3000h_may_be_stored_minus_one(booted: int) -> None:
    """Write 0Ah; the next boot-up comes from 10 or 11: compared before the new id is named."""
    script = turning(encoder(), 0, 5000).write(4000, 0x3000, value=10).nmt(5000, 0x81)
    script.node = booted
    script.boot(5200).heartbeat(5300, 10000)
    script.node = 5
    script.heartbeat(0, 10000)
    script.node = 1
    told = script.told()
    assert says(told.finding("device.node_id_change").text, f"now node {booted}")
    assert told.accusations == []


def test_trap_21_the_multi_turn_range_passes_fast() -> None:
    """At 6000 rpm the 4096 turns last 40.96 s: the count wraps, no overflow alarm."""
    script = encoder().heartbeat(0, 50_000).read(1, 0x6000, 0, 0, size=2)
    script.read(3, 0x6501, 0, 8192)
    told = script.pdo(10, 50_000, 10, lambda k: round(8192 * 0.999 * k) % RANGE).told()
    assert told.trace_row().flags["wrap"] == 1
    assert told.events("jump") == []
    assert told.accusations == []
    assert told.trace().columns["speed_rpm"][-1] == pytest.approx(5994, rel=0.01)


def test_trap_22_missing_objects() -> None:
    """0602 0000 for 6002h, 100Ch, 1029h ...: normal."""
    script = turning(encoder(), 0, 3000)
    for k, index in enumerate((0x6002, 0x6005, 0x6502, 0x6509, 0x100C, 0x100D, 0x1029, 0x1200)):
        script.read(100 + 10 * k, index, 0, abort=0x06020000)
    told = script.told()
    assert told.accusations == []
    assert len([row for row in told.analysis.sdo if row.result == "abort"]) == 8


def test_trap_23_stopped_is_mute() -> None:
    """In Stopped no SDO and no PDO: expected."""
    script = turning(encoder(), 0, 3000).read(10, 0x1800, 5, 100, size=2)
    script.nmt(3000, 0x02).heartbeat(3010, 8000, STOPPED)
    for at in (4000, 5000, 6000):
        script.frame(at, "601#4004600000000000")
    told = script.told()
    assert "pdo.missed" not in told.ids
    assert "sensor" not in " ".join(told.accusations)
    for found in told.findings("sdo.no_answer"):
        assert says(found.text + found.cause, "STOPPED")
    assert told.state_at(5000).state == "STOPPED"


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x06010002, "read-only"),
        (0x06090030, "invalid value"),
        (0x08000022, "present device state"),
    ],
)
def test_trap_24_the_warnings_chapter_means_sdo_aborts(code: int, words: str) -> None:
    """Abort codes are told with the texts of CiA 301."""
    told = turning(encoder(), 0, 3000).write(1000, 0x6001, value=9999, abort=code).told()
    assert says(told.finding("sdo.abort").text, words, f"{code:08X}h")


def test_every_trap_of_the_sheet_is_here() -> None:
    assert numbered_traps(globals()) == set(range(1, TRAPS + 1))


def test_a_healthy_encoder_is_left_in_peace() -> None:
    script = encoder().boot(0).read(10, 0x6000, 0, 0, size=2).read(20, 0x6001, 0, 8192)
    script.read(30, 0x1800, 5, 100, size=2).nmt(100, 0x01)
    script.heartbeat(110, 10_000, OPERATIONAL).pdo(205, 10_000, 100, lambda k: 1000 + 40 * k)
    assert script.told().accusations == []
