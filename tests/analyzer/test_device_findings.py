"""Rules on what devices do with settings, and on their traces: near misses, and what no trap shows."""

import pytest

from tests.analyzer.traps.script import Script, little
from tests.analyzer.whole_run import beats, every, found, ids, whole, write

TURN = 8192


def encoder(device: str = "lir-ma158k") -> Script:
    """A multi-turn LIR as node 1 whose scale was read."""
    script = Script(device).read(-90, 0x6000, 0, 0, size=2).read(-80, 0x6001, 0, TURN)
    return script.read(-70, 0x6002, 0, TURN * 4096).read(-60, 0x6502, 0, 4096, size=2)


def turning(script: Script, stop: float = 5000) -> Script:
    return script.heartbeat(0, stop).pdo(5, stop, 20, lambda k: 1000 + 7 * k)


@pytest.mark.near_miss("device.identifier_kept")
def test_switching_a_pdo_off_and_on_is_no_move() -> None:
    script = turning(encoder()).write(1000, 0x1800, 1, 0x80000181)
    assert "device.identifier_kept" not in script.write(1100, 0x1800, 1, 0x181).told().ids


@pytest.mark.near_miss("device.defaults_pending")
def test_a_refused_load_stores_no_defaults() -> None:
    script = turning(encoder()).write(1000, 0x1011, 1, 1, abort=0x08000020)
    assert "device.defaults_pending" not in script.told().ids


@pytest.mark.near_miss("device.bit_rate_change")
def test_the_bit_rate_that_the_bus_has_is_no_change() -> None:
    script = turning(encoder()).write(1000, 0x2100, 0, 6)
    script.bitrate = 500_000
    assert "device.bit_rate_change" not in script.told().ids


@pytest.mark.near_miss("device.node_id_change")
def test_writing_the_node_id_that_it_has_is_no_change() -> None:
    told = turning(encoder()).write(1000, 0x2101, 0, 1).told()
    assert "device.node_id_change" not in told.ids


def test_a_node_that_was_there_before_is_not_the_renamed_one() -> None:
    script = turning(encoder()).write(1000, 0x2101, 0, 10).save(1100)
    script.node = 10
    script.heartbeat(0, 5000)
    (found,) = script.told().findings("device.node_id_change")
    assert "now node 10" not in found.text
    assert "acts after a reset" in found.text


@pytest.mark.near_miss("device.factory_reset")
def test_a_zero_to_207fh_resets_nothing() -> None:
    script = Script("jn2100", 10).heartbeat(0, 3000).write(1000, 0x207F, 0, 0, size=1)
    assert "device.factory_reset" not in script.told().ids


@pytest.mark.near_miss("device.settling")
def test_a_filter_that_is_switched_off_settles_at_once() -> None:
    script = Script("jn2100", 10).heartbeat(0, 3000).write(1000, 0x2049, 0, 0, size=1)
    assert "device.settling" not in script.told().ids


@pytest.mark.near_miss("device.lost_at_reset")
def test_a_master_that_configures_after_each_boot_up_has_lost_nothing() -> None:
    script = encoder().heartbeat(0, 3000).write(500, 0x1800, 5, 20).nmt(3000, 0x81)
    script.boot(7000).write(7100, 0x1800, 5, 20).nmt(7200, 0x01).heartbeat(7300, 9000)
    assert "device.lost_at_reset" not in script.told().ids


@pytest.mark.near_miss("device.lost_at_reset")
def test_a_value_that_reads_the_same_after_the_reset_is_not_lost() -> None:
    script = turning(encoder()).write(500, 0x1800, 5, 20).nmt(5000, 0x81).boot(9000)
    told = script.read(9100, 0x1800, 5, 20, size=2).heartbeat(9200, 11_000).told()
    assert "device.lost_at_reset" not in told.ids


def test_what_a_reset_left_is_marked_as_assumed() -> None:
    script = turning(encoder()).write(500, 0x1800, 5, 20).nmt(5000, 0x81).boot(9000)
    found = script.heartbeat(9200, 11_000).told().finding("device.lost_at_reset")
    assert "back from 20 to 515 (not saved)" in found.text
    assert found.assumed == ["1800h:5 = 515 (eds-default)"]


def test_an_identifier_that_a_reset_left_is_written_as_people_write_it() -> None:
    """LIR-DA158: bit 31 of 180xh:1 goes with the reset whatever is saved."""
    script = turning(encoder()).write(500, 0x1800, 1, 0x80000185).nmt(5000, 0x81).boot(9000)
    found = script.heartbeat(9200, 11_000).told().finding("device.lost_at_reset")
    node = found.node or 0
    assert found.assumed == [f"1800h:1 = {0x180 + node:X}h (eds-default)"]


@pytest.mark.near_miss("device.lost_at_reset")
def test_a_device_of_which_nothing_is_known_may_store_by_itself() -> None:
    script = Script(None).heartbeat(0, 3000).write(500, 0x2005, 0, 20, size=2)
    told = script.nmt(3000, 0x81).boot(3500).heartbeat(3600, 6000).told()
    assert "device.lost_at_reset" not in told.ids


@pytest.mark.near_miss("pdo.silent")
def test_a_node_that_stays_pre_operational_owes_no_pdo() -> None:
    assert "pdo.silent" not in encoder().heartbeat(0, 20_000, 0x7F).told().ids


@pytest.mark.near_miss("pdo.silent")
def test_a_pdo_on_an_identifier_of_29_bits_is_not_said_to_stay_away() -> None:
    """It is told neither under the lower 11 bits, which may be another PDO's, nor as silent."""
    rows = [*beats(5, 10, 20_000), *write(100, 5, 0x1800, 1, 0x38FF1205)]
    assert "pdo.silent" not in ids(whole(rows))
    rows = [*beats(5, 10, 20_000), *write(100, 5, 0x1800, 1, 0xB8FF1205)]
    assert "is switched off" in found(whole(rows), "pdo.silent")[0].text


@pytest.mark.near_miss("pdo.silent")
def test_of_two_nodes_that_send_on_one_identifier_neither_is_silent() -> None:
    rows = [*write(100, 5, 0x1800, 1, 0x185), *write(200, 6, 0x1800, 1, 0x185)]
    nodes = [*beats(5, 10, 20_000), *beats(6, 11, 20_000)]
    told = whole(nodes, rows, every(0x185, 300, 20_000, 50, bytes(8)))
    assert "config.cob_id_collision" in ids(told)
    assert "pdo.silent" not in ids(told)


def two_ways(second: int) -> Script:
    """The position by timer and by SYNC, of which the second stands still if `second` is 0."""
    script = encoder().heartbeat(0, 10_000).sync(1, 10_000)
    script.read(-40, 0x1801, 2, 1, size=1)
    script.pdo(5, 10_000, 20, lambda k: 1000 + 40 * k)
    return script.pdo(2, 10_000, 20, lambda k: 1000 + second * k, base=0x280)


@pytest.mark.triggers("angle.frozen")
def test_a_pdo_that_repeats_an_old_value_is_frozen() -> None:
    told = two_ways(0).told()
    found = told.finding("angle.frozen")
    assert "281h" in found.text
    assert "frozen at 1000" in found.text
    assert told.trace_row().flags["frozen"] == 500


@pytest.mark.near_miss("angle.frozen")
def test_two_pdos_that_move_together_are_not_frozen() -> None:
    assert "angle.frozen" not in two_ways(40).told().ids


@pytest.mark.near_miss("angle.frozen")
def test_pdos_too_short_for_the_value_show_no_standstill() -> None:
    script = encoder().heartbeat(0, 10_000).sync(1, 10_000).read(-40, 0x1801, 2, 1, size=1)
    script.pdo(5, 10_000, 20, lambda k: 1000 + 40 * k)
    script.pdo(2, 5000, 20, lambda k: 1000 + 40 * k, base=0x280)
    script.pdo(5002, 10_000, 20, lambda k: 11_000 + 40 * k, base=0x280, bits=16)
    assert "angle.frozen" not in script.told().ids


@pytest.mark.near_miss("angle.frozen")
def test_standstill_is_not_frozen() -> None:
    script = encoder().heartbeat(0, 10_000).pdo(5, 10_000, 20, lambda _: 1000)
    told = script.pdo(9, 10_000, 20, lambda _: 1000, base=0x280).told()
    assert "angle.frozen" not in told.ids


@pytest.mark.near_miss("angle.frozen")
def test_an_axis_that_stays_level_while_the_other_tilts_is_not_frozen() -> None:
    script = Script("jn2100", 10).heartbeat(0, 10_000).sync(1, 10_000)
    told = script.pdo(2, 10_000, 20, lambda k: (k, 0), bits=16).told()
    assert "angle.frozen" not in told.ids


@pytest.mark.triggers("angle.scale_assumed")
def test_degrees_on_an_assumed_scale_are_told_so() -> None:
    script = Script("haomiao-38").heartbeat(0, 3000).pdo(5, 3000, 20, lambda k: 1000 + 7 * k)
    found = script.told().finding("angle.scale_assumed")
    assert found.severity == "info"
    assert "6001h" in found.text
    assert found.assumed


@pytest.mark.near_miss("angle.scale_assumed")
def test_a_scale_that_was_read_is_not_assumed() -> None:
    assert "angle.scale_assumed" not in turning(encoder()).told().ids


@pytest.mark.near_miss("angle.scale_assumed")
def test_a_shaft_that_stands_needs_no_scale() -> None:
    script = Script("haomiao-38").heartbeat(0, 3000).pdo(5, 3000, 20, lambda _: 1000)
    assert "angle.scale_assumed" not in script.told().ids


@pytest.mark.triggers("angle.sensor_alarm")
def test_an_alarm_that_was_read_is_told() -> None:
    script = turning(encoder("lir-da158")).read(1000, 0x6503, 0, 0, size=2)
    found = script.read(2000, 0x6503, 0, 1, size=2).told().finding("angle.sensor_alarm")
    assert found.severity == "warning"
    assert "6503h = 0001h (position code invalid)" in found.text


@pytest.mark.triggers("angle.sensor_alarm")
def test_an_alarm_in_a_pdo_is_told() -> None:
    script = Script("haomiao-38").heartbeat(0, 3000).write(10, 0x1A00, 0, 0, size=1)
    script.write(20, 0x1A00, 2, 0x65030010, size=4).write(30, 0x1A00, 0, 2, size=1)
    script.every(50, 1000, 20, lambda k: f"181#{little(k)}0000")
    told = script.every(1000, 3000, 20, lambda k: f"181#{little(k)}0100").told()
    assert told.finding("angle.sensor_alarm").start_ns == told.analysis.capture.first_ns + 10**9
    assert told.trace(0x6503).unit == "bits"


@pytest.mark.near_miss("angle.sensor_alarm")
def test_a_zero_is_no_alarm() -> None:
    script = turning(encoder("lir-da158")).read(1000, 0x6503, 0, 0, size=2)
    assert "angle.sensor_alarm" not in script.told().ids


def test_a_restart_between_two_samples_is_no_jump() -> None:
    """A boot-up with 7Fh and no command: the preset was not saved, the position is another one."""
    script = turning(encoder(), 3000).heartbeat(5000, 9000, 0x7F)
    script.node = 9
    script.heartbeat(0, 9000)
    script.node = 1
    script.pdo(8000, 9000, 20, lambda k: 20_000_000 + 7 * k)
    told = script.told()
    assert told.row().boot_ups == 1
    assert "angle.jump" not in told.ids


def test_the_offset_between_two_pdos_is_no_jump_and_no_freeze() -> None:
    script = encoder().heartbeat(0, 10_000).pdo(5, 10_000, 515, lambda k: 1000 + 1000 * k)
    told = script.pdo(9, 10_000, 20, lambda k: 1000 + 39 * k, base=0x280).told()
    assert told.events("jump") == []
    assert "angle.frozen" not in told.ids


def test_what_restored_defaults_took_back_is_not_called_unstorable() -> None:
    script = turning(encoder()).write(500, 0x1800, 5, 20).save(600).load(700)
    told = script.nmt(5000, 0x81).boot(9000).heartbeat(9200, 11_000).told()
    restored = told.finding("device.defaults_pending")
    (lost,) = (link for link in restored.chain if link.id == "device.lost_at_reset")
    assert "back from 20 to 515 (the defaults were restored)" in lost.text


def overridden(text: str, device: str = "lir-ma158k") -> Script:
    script = encoder(device)
    script.overrides = text
    return turning(script)


@pytest.mark.triggers("device.override_contradicted")
@pytest.mark.parametrize(
    ("override", "told"),
    [("cpr = 4096", TURN), ("turns = 16", 4096), ("range = 77", TURN * 4096)],
)
def test_the_bus_counts_more_than_a_number_of_the_description(override: str, told: int) -> None:
    result = overridden(override).told()
    found = result.finding("device.override_contradicted")
    name, _, given = override.partition(" = ")
    assert (found.severity, found.node) == ("warning", 1)
    assert f"{name} = {given}" in found.text
    assert f"told {told}" in found.text
    assert found.evidence
    assert result.trace_row().shows.startswith(f"{TURN} counts per turn, range {TURN * 4096}")
    assert [each for each in result.ids if each.startswith("angle.")] == []


@pytest.mark.near_miss("device.override_contradicted")
@pytest.mark.parametrize("override", ["cpr = 8192", "range = 33554432\nmax_rpm = 500", ""])
def test_a_number_that_the_bus_bears_out_is_right(override: str) -> None:
    assert "device.override_contradicted" not in overridden(override).told().ids


@pytest.mark.near_miss("device.override_contradicted")
def test_a_number_that_the_bus_does_not_tell_is_the_users() -> None:
    script = Script("haomiao-38", overrides="cpr = 4096")
    told = turning(script).told()
    assert told.accusations == []
    assert told.trace_row().shows.startswith("4096 counts per turn")


@pytest.mark.triggers("device.override_contradicted")
def test_a_resolution_that_was_read_counts_more() -> None:
    script = Script("jn2100", 10, overrides="res = 10").read(-50, 0x6000, 0, 100, size=2)
    told = script.pdo(0, 1000, 20, lambda _: (200, 100), bits=16).told()
    assert told.trace(0x6010).value[0] == pytest.approx(20.0)
    assert "res = 10" in told.finding("device.override_contradicted").text


def on_one_shaft(other: int, *, also: int | None = None) -> Script:
    """Node 2 is said to share a shaft; node `also` turns with it."""
    script = encoder()
    script.more = (
        f'[node.2]\ndevice = "lir-ma158k"\nsame_shaft_as = {other}\n[node.2.objects]\n'
        '"6001" = 8192\n"6502" = 4096\n'
    )
    for node in (1, *((also,) if also else ())):
        script.node = node
        turning(script)
    return script


@pytest.mark.triggers("device.shafts_not_compared")
def test_a_shaft_that_no_other_node_is_on_is_told() -> None:
    found = on_one_shaft(9, also=2).told().finding("device.shafts_not_compared")
    assert (found.severity, found.node) == ("info", 2)
    assert "no position of node 9" in found.text
    assert "same_shaft_as = 9" in found.check_next


@pytest.mark.triggers("device.shafts_not_compared")
def test_an_encoder_that_is_not_there_cannot_be_compared() -> None:
    found = on_one_shaft(1).told().finding("device.shafts_not_compared")
    assert "no position of node 2" in found.text


@pytest.mark.near_miss("device.shafts_not_compared")
def test_shafts_that_are_compared_are_left_in_peace() -> None:
    told = on_one_shaft(1, also=2).told()
    assert "device.shafts_not_compared" not in told.ids
    assert told.analysis.shafts[0].compared > 0


@pytest.mark.near_miss("device.shafts_not_compared")
def test_a_bus_on_which_neither_encoder_is_says_nothing() -> None:
    script = on_one_shaft(9)
    assert "device.shafts_not_compared" not in script.told().ids


def test_a_device_whose_defaults_were_restored_is_the_same_device() -> None:
    """3000h, by which a Haomiao is known, holds another number then; its trace goes on."""
    script = Script(None, 3).read(-90, 0x1000, 0, 0x20196).read(-80, 0x1008, 0, 0x4147414D)
    script.read(-70, 0x3000, 0, 3, size=1).read(-60, 0x6000, 0, 0, size=2)
    script.read(-50, 0x6001, 0, TURN).heartbeat(0, 5000).pdo(5, 5000, 20, lambda k: 1000 + 7 * k)
    script.load(4000).nmt(5000, 0x81).boot(5400).pdo(6000, 9000, 20, lambda k: 3000 + 7 * k)
    told = script.told()
    assert told.row().device == "haomiao-38"
    assert told.traced() == [0x6004]


def test_a_device_that_no_longer_has_what_told_it_apart_was_exchanged() -> None:
    script = Script(None, 3).read(-90, 0x1000, 0, 0x20196).read(-80, 0x1008, 0, 0x4147414D)
    script.read(-70, 0x3000, 0, 3, size=1).heartbeat(0, 5000).load(4000).nmt(5000, 0x81)
    script.boot(5400).read(5500, 0x3000, 0, abort=0x06020000)
    assert script.told().row().device is None


def gone(script: Script, stop: float = 20_000) -> Script:
    """Another node goes on, so that the bus works."""
    node, script.node = script.node, 30
    script.heartbeat(0, stop)
    script.node = node
    return script


def test_a_node_that_its_defaults_gave_another_number_is_not_called_hanging() -> None:
    script = Script("haomiao-38", 3).heartbeat(0, 5000).load(4000).nmt(5000, 0x81)
    told = gone(script).told()
    finding = told.finding("device.defaults_pending")
    assert "by these it is node 1 at 125 kbit/s; as node 3 it was not heard again" in finding.text
    assert "nmt.no_boot_up" in [link.id for link in finding.chain]
    assert "nmt.no_boot_up" not in told.ids


@pytest.mark.near_miss("device.defaults_pending")
def test_a_node_that_may_still_be_starting_is_not_sought_elsewhere() -> None:
    script = Script("haomiao-38", 3).heartbeat(0, 5000).load(4000).nmt(5000, 0x81)
    assert "node 1" not in gone(script, 8000).told().finding("device.defaults_pending").text


@pytest.mark.near_miss("device.defaults_pending")
def test_defaults_that_spare_the_number_do_not_move_a_node() -> None:
    """1011h of a JN2100 restores 1000h to 1FFFh."""
    script = Script("jn2100", 20).heartbeat(0, 5000).load(4000).nmt(5000, 0x81)
    told = gone(script).told()
    assert "node 10" not in told.finding("device.defaults_pending").text
    assert "nmt.no_boot_up" in told.ids


def loaded_and_reset(stop: float = 20_000) -> Script:
    return gone(Script("haomiao-38", 3).heartbeat(0, 5000).load(4000).nmt(5000, 0x81), stop)


def in_a_gap(script: Script, start: float, end: float) -> Script:
    script.gaps.append((start, end))
    script.rows = [row for row in script.rows if not start <= row[0] < end]
    return script


def on_a_dark_bus(script: Script) -> Script:
    """Another bus goes on."""
    script.buses = ("can0", "can1")
    for at in range(0, 20_000, 100):
        script.frame(at, "705#05", bus=1)
    return script


@pytest.mark.near_miss("device.defaults_pending")
@pytest.mark.parametrize(
    "script",
    [
        loaded_and_reset().read(9000, 0x1001, 0, 0, size=1).read(15_000, 0x1001, 0, 0, size=1),
        gone(Script("haomiao-38", 3).load(4000).nmt(5000, 0x81)).read(15_000, 0x1001, 0, 0, size=1),
        loaded_and_reset().pdo(6000, 19_000, 20, lambda k: 5 + k),
        in_a_gap(loaded_and_reset(), 5100, 19_900),
        on_a_dark_bus(loaded_and_reset(5000)),
        loaded_and_reset().save(4500),
        loaded_and_reset().write(4500, 0x3000, 0, 7, size=1),
    ],
    ids=[
        "SDO answers",
        "SDO answers only",
        "PDOs",
        "gap",
        "bus off",
        "saved again",
        "another number",
    ],
)
def test_a_node_that_need_not_have_moved_is_not_sought_elsewhere(script: Script) -> None:
    finding = script.told().finding("device.defaults_pending")
    assert "node 1 at" not in finding.text + finding.check_next
    assert finding.severity == "info"


def test_defaults_that_were_saved_over_do_not_hold_after_the_reset() -> None:
    script = loaded_and_reset().save(4500).boot(5400).heartbeat(5500, 20_000)
    text = script.told().finding("device.defaults_pending").text
    assert "the defaults hold" not in text
    assert "the running ones were saved (1010h) in their place" in text


def test_a_node_that_moved_when_its_supply_was_switched_was_heard_until_then() -> None:
    script = Script("haomiao-38", 3).read(-90, 0x1017, 0, 100, size=2).heartbeat(0, 9000).load(4000)
    text = gone(script, 30_000).told().finding("device.defaults_pending").text
    assert "as node 3 it was not heard again since +8.990 s" in text


def test_a_node_that_a_factory_reset_took_away_is_not_called_hanging() -> None:
    script = Script("jn2100", 20, bitrate=500_000).heartbeat(0, 9000)
    script.write(3000, 0x207F, 0, 1, size=1).nmt(9000, 0x81)
    told = gone(script).told()
    finding = told.finding("device.factory_reset")
    assert "nmt.no_boot_up" in [link.id for link in finding.chain]
    assert "nmt.no_boot_up" not in told.ids


def test_a_bit_rate_that_was_not_saved_before_the_reset_is_not_taken() -> None:
    script = encoder().heartbeat(0, 3000).write(500, 0x2100, 0, 4).nmt(3000, 0x81)
    finding = script.boot(7000).heartbeat(7100, 9000).told().finding("device.bit_rate_change")
    assert " s without a save (1010h)" in finding.text
    assert "keeps the bit rate" in finding.text


@pytest.mark.near_miss("device.bit_rate_change")
@pytest.mark.parametrize("hidden", [False, True])
def test_a_bit_rate_that_may_have_been_saved_is_not_called_kept(hidden: bool) -> None:
    script = encoder().heartbeat(0, 3000).write(500, 0x2100, 0, 4).nmt(3000, 0x81)
    script.boot(7000).heartbeat(7100, 9000)
    if hidden:
        script.gaps.append((1000, 2000))
        script.rows = [row for row in script.rows if not 1000 <= row[0] < 2000]
    else:
        script.save(1000)
    finding = script.told().finding("device.bit_rate_change")
    assert "that acts after a save and a reset" in finding.text


def test_a_number_that_was_saved_is_not_to_be_saved_again() -> None:
    script = encoder().heartbeat(0, 3000).write(500, 0x2101, 0, 9).save(600).nmt(3000, 0x81)
    script.node = 9
    finding = script.boot(7000).heartbeat(7100, 9000).told().finding("device.node_id_change")
    assert "it is now node 9" in finding.text
    assert finding.check_next.startswith("Nothing")


def short_frames(script: Script) -> Script:
    """Ten seconds in which TPDO1 has 2 bytes."""
    script.pdo(5, 5000, 20, lambda k: 1000 + 7 * k).heartbeat(0, 20_000)
    script.every(5000, 15_000, 20, f"{0x180 + script.node:03X}#0102")
    return script.pdo(15_000, 20_000, 20, lambda k: 7000 + 7 * k)


@pytest.mark.triggers("config.pdo_length")
def test_frames_that_do_not_fit_the_only_mapping_of_a_device_are_told() -> None:
    script = Script(None, 5).read(-90, 0x1000, 0, 0x10196).read(-80, 0x1008, 0, 0x3831394C)
    finding = short_frames(script).told().finding("config.pdo_length")
    assert "500 frames of TPDO1 of node 5 (185h) have 2 bytes, its mapping has 4, the only one" in (
        finding.text
    )
    assert finding.assumed == ["1A00h: 4 bytes (eds-default)"]


@pytest.mark.near_miss("config.pdo_length")
@pytest.mark.parametrize("at", [-50, 17_000])
def test_a_device_that_tells_another_mapping_than_its_manual_is_not_judged_by_that(at: int) -> None:
    script = Script(None, 5).read(-90, 0x1000, 0, 0x10196).read(-80, 0x1008, 0, 0x3831394C)
    script.read(at, 0x1A00, 0, 1, size=1).read(at + 10, 0x1A00, 1, 0x60040010)
    assert "config.pdo_length" not in short_frames(script).told().ids


@pytest.mark.near_miss("config.pdo_length")
def test_a_mapping_that_may_have_been_changed_accuses_nobody() -> None:
    script = Script(None, 3).read(-90, 0x1000, 0, 0x20196).read(-80, 0x1008, 0, 0x4147414D)
    script.read(-70, 0x3000, 0, 3, size=1)
    assert "config.pdo_length" not in short_frames(script).told().ids


@pytest.mark.near_miss("config.pdo_length")
def test_a_pdo_that_a_device_does_not_use_in_its_mode_has_any_length() -> None:
    script = Script(None, 10).read(-90, 0x1000, 0, 0x4019A).heartbeat(0, 10_000)
    script.frame(-80, "60A#4008100000000000").frame(-79, "58A#4108100006000000")
    script.frame(-78, "60A#6000000000000000").frame(-77, "58A#034A4E3231303000")
    script.read(-70, 0x2047, 0, 1, size=1).sync(0, 10_000).every(2, 10_000, 20, "18A#0102")
    told = script.told()
    assert told.row().device == "jn2100"
    assert "config.pdo_length" not in told.ids
    script.rows = [row for row in script.rows if not -71 < row[0] < -68]
    assert "config.pdo_length" in script.told().ids


def test_a_preset_to_zero_that_was_not_saved_is_lost() -> None:
    """0 is what 6003h holds after a reset too: what is gone is the offset that it made."""
    script = turning(encoder()).write(1000, 0x6003, 0, 0).nmt(5000, 0x81).boot(9000)
    found = script.heartbeat(9200, 11_000).told().finding("device.lost_at_reset")
    assert "6003h (Preset value) = 0: the offset 6509h that it made is lost" in found.text


@pytest.mark.near_miss("device.lost_at_reset")
def test_a_preset_whose_offset_was_saved_is_not_lost() -> None:
    script = turning(encoder()).write(1000, 0x6003, 0, 0).save(1500).nmt(5000, 0x81).boot(9000)
    assert "device.lost_at_reset" not in script.heartbeat(9200, 11_000).told().ids


@pytest.mark.near_miss("device.lost_at_reset")
def test_an_offset_that_a_write_to_6000h_ended_is_not_lost_at_the_reset() -> None:
    script = turning(encoder()).write(1000, 0x6003, 0, 1000).write(2000, 0x6000, 0, 0, size=2)
    script.nmt(5000, 0x81).boot(9000).heartbeat(9200, 11_000)
    assert "6003h" not in script.told().text


def test_an_identifier_that_a_reset_took_back_is_written_alike_before_and_after() -> None:
    script = turning(encoder()).write(1000, 0x1800, 1, 0x80000181).nmt(5000, 0x81).boot(9000)
    found = script.heartbeat(9200, 11_000).told().finding("device.lost_at_reset")
    assert "back from 80000181h to 181h" in found.text


def test_a_save_with_another_word_is_refused_for_the_word() -> None:
    script = turning(encoder()).write(1000, 0x1010, 1, 0x31766173, abort=0x08000020)
    found = script.told().finding("sdo.abort")
    assert "the write of 31766173h to 1010h:01" in found.text
    assert '1010h takes only "save" (65766173h)' in found.cause


def test_a_save_with_the_right_word_is_refused_for_another_reason() -> None:
    script = turning(encoder()).write(1000, 0x1010, 1, 0x65766173, abort=0x08000022)
    (found,) = script.told().findings("sdo.abort") + script.told().findings("config.save_refused")
    assert "takes only" not in found.text + found.cause


def test_what_1010h_may_not_keep_is_not_counted_as_unsaved() -> None:
    """`save` of a JN2100 keeps 1000h to 1FFFh; a self-test is an order."""
    script = Script("jn2100", 10).heartbeat(0, 5000).write(100, 0x2047, 0, 1, size=1)
    script.write(200, 0x4004, 1, 1, size=1).write(300, 0x6000, 0, 100, size=2)
    told = script.told()
    assert told.object(0x6000).saved is None
    assert "not saved (1010h)" not in told.summary
    told = script.write(400, 0x1017, 0, 500, size=2).told()
    assert told.object(0x1017).saved is False


def test_a_position_error_says_which_alarm_it_is() -> None:
    """Alarm bit 1 of a LIR is its hardware, bit 0 the code that it reads."""
    script = turning(encoder()).emcy(1000, 0x7320, 1, "0200000000").emcy(2000, 0, 0)
    found = script.told().finding("emcy.active")
    assert 'reports position error (7320h) with alarms "hardware error" at' in found.text


def test_a_position_error_that_is_told_twice_says_every_alarm_of_it() -> None:
    script = turning(encoder()).emcy(1000, 0x7320, 1, "0100000000")
    script.emcy(2000, 0x7320, 1, "0200000000").emcy(5000, 0, 0)
    text = script.told().finding("emcy.active").text
    assert 'alarms "position code invalid" and "hardware error" in 2 messages' in text


def test_a_code_without_an_alarm_bit_names_none() -> None:
    script = turning(encoder()).emcy(1000, 0x7320, 1).emcy(2000, 0, 0)
    assert "position error (7320h) at" in script.told().finding("emcy.active").text
    script = turning(encoder()).emcy(1000, 0x5530, 0x81, "0200000000").emcy(2000, 0, 0)
    assert "EEPROM error (5530h) at" in script.told().finding("emcy.active").text


@pytest.mark.parametrize(
    ("kind", "cause"),
    [(1, "Its settings are others than those"), (0, "Its settings; the node itself is alive.")],
    ids=["every SYNC", "after a change"],
)
def test_a_node_that_is_silent_beside_sync_does_not_wait_for_it(kind: int, cause: str) -> None:
    script = encoder().write(-40, 0x1800, 2, kind, size=1).write(-30, 0x1801, 2, kind, size=1)
    finding = script.heartbeat(0, 20_000).sync(0, 20_000).told().finding("pdo.silent")
    assert "nobody sends" not in finding.cause + finding.text
    assert finding.cause.startswith(cause)


def test_a_sync_that_nobody_sends_does_not_explain_a_pdo_that_is_due_by_its_timer() -> None:
    script = encoder().write(-40, 0x1800, 2, 254, size=1).write(-35, 0x1800, 5, 100, size=2)
    script.write(-30, 0x1801, 2, 1, size=1).heartbeat(0, 20_000)
    finding = script.told().finding("pdo.silent")
    assert "is due every 100 ms" in finding.text
    assert "and no SYNC (080h) is on the bus" in finding.text
    assert finding.cause.startswith("Its settings are others than those")


def test_a_node_that_sends_under_another_number_is_told_once() -> None:
    script = Script("jn2100", 12).heartbeat(0, 20_000).sync(0, 20_000)
    script.every(1, 20_000, 20, "18A#C8006400").every(2, 20_000, 20, "28A#C800000064000000")
    told = script.told()
    assert "pdo.silent" in [link.id for link in told.finding("device.foreign_identifiers").chain]
    assert "pdo.silent" not in told.ids


def preset_and_reset(script: Script) -> Script:
    script.write(1000, 0x6003, 0, 0).nmt(5000, 0x81).boot(9000)
    return turning(script).heartbeat(9200, 11_000)


@pytest.mark.near_miss("device.lost_at_reset")
@pytest.mark.parametrize(
    "script",
    [
        in_a_gap(preset_and_reset(encoder()), 2000, 3000),
        preset_and_reset(encoder()).read(1500, 0x6509, 0, 777).read(10_000, 0x6509, 0, 777),
    ],
    ids=["gap", "read again"],
)
def test_a_preset_that_may_have_been_saved_or_is_there_is_not_lost(script: Script) -> None:
    assert "6003h" not in script.told().text


def test_another_offset_after_the_reset_does_not_save_a_preset() -> None:
    script = preset_and_reset(encoder()).read(1500, 0x6509, 0, 777).read(10_000, 0x6509, 0, 0)
    assert "6003h" in script.told().finding("device.lost_at_reset").text


@pytest.mark.near_miss("device.bit_rate_change")
@pytest.mark.parametrize("back", [False, True])
def test_a_bit_rate_of_a_node_that_is_gone_or_may_have_saved_it_is_not_kept(back: bool) -> None:
    script = gone(encoder().heartbeat(0, 3000).write(500, 0x2100, 0, 4).nmt(3000, 0x81))
    if back:
        script.boot(7000).heartbeat(7100, 9000).write(1000, 0x1010, 1, 0x65766173, answered=False)
    assert "keeps the bit rate" not in script.told().finding("device.bit_rate_change").text


@pytest.mark.parametrize("code", [0x06020000, 0x06010002])
def test_a_wrong_word_to_an_object_that_cannot_be_written_is_not_its_cause(code: int) -> None:
    script = turning(encoder()).write(1000, 0x1010, 1, 0x31766173, abort=code)
    assert "takes only" not in script.told().text
