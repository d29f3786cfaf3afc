"""Each rule on configuration: a case that triggers it, and a near miss that does not."""

import pytest

from syncline_analyzer.findings.config import rules as config
from tests.analyzer.traps.script import Script, Told

S = 1000
ALL_RULES = tuple(rule.id for rule in config.RULES)


def texts(told: Told, id: str) -> list[str]:
    """What the findings of one rule say, also where they became part of a story."""
    found = told.analysis.findings
    return [f.text for f in found if f.id == id] + [
        link.text for f in found for link in f.chain if link.id == id
    ]


def running(node: int = 5, device: str | None = None, **given: object) -> Script:
    """A node that is heard for 20 s, OPERATIONAL from the third second on."""
    script = Script(device, node, **given)  # type: ignore[arg-type]
    script.boot(10).heartbeat(100, 3 * S, 0x7F).nmt(3 * S, 1).heartbeat(3100, 20 * S)
    return script


def silent(told: Told) -> None:
    """None of the rules on configuration says anything."""
    assert [text for id in ALL_RULES for text in texts(told, id)] == []


def restarted(script: Script, at: float) -> Script:
    return script.nmt(at, 0x81).boot(at + 500)


@pytest.mark.triggers("config.save_refused")
def test_a_save_that_is_refused() -> None:
    told = running().write(500, 0x1010, 1, 0x65766173, abort=0x08000022).told()
    (text,) = texts(told, "config.save_refused")
    assert "refused to save its settings (1010h:1)" in text
    assert "present device state" in text


@pytest.mark.near_miss("config.save_refused")
def test_a_save_that_succeeds_in_the_end() -> None:
    script = running().write(500, 0x1010, 1, 0x65766173, abort=0x08000022).save(900)
    silent(script.told())
    other = running(1, "lir-da158a").write(500, 0x1010, 2, 0x65766173, abort=0x06090011)
    silent(other.told())


@pytest.mark.triggers("config.factory_defaults")
def test_load_is_told_with_the_restart_that_makes_it_work() -> None:
    script = restarted(running().load(500), 2 * S)
    (text,) = texts(script.told(), "config.factory_defaults")
    assert "(1011h:1); they took effect with the restart at +1.990 s" in text


@pytest.mark.near_miss("config.factory_defaults")
def test_a_load_that_is_refused_or_has_another_signature() -> None:
    script = running().write(500, 0x1011, 1, 0x64616F6C, abort=0x08000020)
    silent(script.write(600, 0x1011, 1, 1).told())
    silent(running(1, "lir-da158a").load(500).told())


def mapped(script: Script, *, last: int | None = 2, abort: int | None = None) -> Script:
    """The sequence of CiA 301 7.5.2.38 for TPDO1 of node 5 up to, at most, its last steps."""
    script.read(300, 0x1800, 1, 0x185)
    script.write(400, 0x1800, 1, 0x80000185).write(410, 0x1A00, 0, 0)
    script.write(420, 0x1A00, 1, 0x64010110).write(430, 0x1A00, 2, 0x64010210, abort=abort)
    if last is not None:
        script.write(440, 0x1A00, 0, last).write(450, 0x1800, 1, 0x185)
    return script


@pytest.mark.triggers("config.mapping_refused")
def test_a_mapping_that_is_refused_midway() -> None:
    told = mapped(running(), last=None, abort=0x06040041).told()
    (text,) = texts(told, "config.mapping_refused")
    assert "1A00h:2 (TPDO1 mapped object 2)" in text
    assert "6401h:02, 16 bits for 1A00h:2" in text
    assert '"object cannot be mapped to the PDO" (06040041h)' in text
    assert "it is off" in text
    assert not texts(told, "config.pdo_left_off")


@pytest.mark.near_miss("config.mapping_refused")
def test_a_refusal_after_which_the_pdo_works() -> None:
    silent(mapped(running(), last=1, abort=0x06040041).told())
    fixed = running(10, "jn2100").write(500, 0x1A00, 0, 0, abort=0x06010002)
    silent(fixed.told())


@pytest.mark.triggers("config.pdo_left_off")
def test_a_configuration_without_its_last_step() -> None:
    (text,) = texts(mapped(running(), last=None).told(), "config.pdo_left_off")
    assert "TPDO1 of node 5 was configured" in text
    assert "never switched on again" in text


@pytest.mark.near_miss("config.pdo_left_off")
def test_pdos_that_are_meant_to_be_off() -> None:
    silent(mapped(running()).told())
    silent(running().read(300, 0x1800, 1, 0x185).write(400, 0x1800, 1, 0x80000185).told())
    whole_file = running().write(300, 0x1801, 1, 0x80000285).write(310, 0x1801, 2, 255)
    whole_file.write(320, 0x1A01, 0, 0).write(330, 0x1A01, 1, 0x20000008).write(340, 0x1A01, 0, 1)
    silent(whole_file.told())


@pytest.mark.triggers("config.pdo_length")
def test_frames_that_do_not_fit_their_mapping() -> None:
    script = mapped(running()).every(4 * S, 5 * S, 100, "185#0102030405060708")
    (text,) = texts(script.told(), "config.pdo_length")
    assert "10 frames of TPDO1 of node 5 (185h) have 8 bytes, its mapping has 4" in text


@pytest.mark.near_miss("config.pdo_length")
def test_frames_of_the_old_mapping_and_longer_rpdos() -> None:
    """The mapping changes from 4 to 2 bytes while the PDO runs; old frames are on their way."""
    script = mapped(running()).every(4 * S, 5 * S, 100, "185#01020304")
    script.write(5 * S, 0x1A00, 0, 0).write(5010, 0x1A00, 0, 1).every(
        5015, 5055, 10, "185#01020304"
    )
    script.every(5200, 6 * S, 100, "185#0102")
    script.read(700, 0x1400, 1, 0x205).read(710, 0x1600, 0, 1).read(720, 0x1600, 1, 0x62000108)
    script.every(4050, 5 * S, 100, "205#01020304")
    silent(script.told())


@pytest.mark.near_miss("config.pdo_length")
def test_two_frames_that_do_not_fit_their_mapping_are_a_chance() -> None:
    script = mapped(running()).every(4 * S, 5 * S, 100, "185#01020304")
    silent(script.every(4150, 4350, 100, "185#0102030405060708").told())


@pytest.mark.near_miss("config.pdo_left_off")
def test_a_configuration_that_the_end_of_the_capture_cuts_off() -> None:
    """OPERATIONAL for 0.5 s only: the last step may come yet."""
    script = Script(None, 5).boot(10).heartbeat(100, 3 * S, 0x7F).nmt(3 * S, 1)
    silent(mapped(script.heartbeat(3100, 3600), last=None).told())


@pytest.mark.triggers("config.inhibit_time")
def test_an_inhibit_time_longer_than_the_event_timer() -> None:
    script = running().read(300, 0x1800, 1, 0x185).write(400, 0x1800, 2, 255)
    script.write(410, 0x1800, 3, 10_000, size=2).write(420, 0x1800, 5, 100, size=2)
    (text,) = texts(script.told(), "config.inhibit_time")
    assert "sent every 100 ms (event timer) but not more often than every 1000 ms" in text


@pytest.mark.near_miss("config.inhibit_time")
def test_an_inhibit_time_in_its_own_unit() -> None:
    """1000 is 100 ms: a reader who takes the unit for ms would complain."""
    script = running().read(300, 0x1800, 1, 0x185).write(400, 0x1800, 2, 255)
    script.write(410, 0x1800, 3, 1000, size=2).write(420, 0x1800, 5, 100, size=2)
    script.write(500, 0x1801, 1, 0x80000285).write(510, 0x1801, 2, 255)
    script.write(520, 0x1801, 3, 60_000, size=2).write(530, 0x1801, 5, 10, size=2)
    silent(script.told())


def two_nodes() -> Script:
    """Nodes 5 and 6, both heard; the one that is written to next is 6."""
    script = running()
    script.node = 6
    return script.boot(20).heartbeat(150, 20 * S, 0x7F)


@pytest.mark.triggers("config.cob_id_collision")
def test_a_pdo_that_is_moved_onto_anothers() -> None:
    script = two_nodes().write(500, 0x1800, 1, 0x185)
    script.node = 5
    told = script.read(400, 0x1800, 1, 0x185).told()
    (text,) = texts(told, "config.cob_id_collision")
    assert "TPDO1 of node 5 and TPDO1 of node 6 use the same identifier 185h" in text


@pytest.mark.triggers("config.cob_id_collision")
def test_what_is_assumed_of_the_other_is_said() -> None:
    script = two_nodes().write(500, 0x1800, 1, 0x285)
    script.more = '[node.5]\ndevice = "haomiao-38"\n'
    told = script.told()
    finding = told.finding("config.cob_id_collision")
    assert (finding.severity, finding.assumed) == ("info", ["node 5: 1801h:1 = 285h (eds-default)"])


@pytest.mark.near_miss("config.cob_id_collision")
def test_a_gap_may_hide_that_two_numbers_are_one_node() -> None:
    """Node 5 became node 6 in it, or its SDO server answers on another identifier since then."""
    renumbered = running(5).read(400, 0x1800, 1, 0x185)
    renumbered.rows[:] = [row for row in renumbered.rows if row[0] < 8 * S]
    renumbered.gaps.append((8 * S, 9 * S))
    renumbered.node = 6
    renumbered.heartbeat(9100, 20 * S, 0x7F).read(10 * S, 0x1800, 1, 0x185)
    silent(renumbered.told())
    moved = running(5).read(400, 0x1800, 1, 0x185)
    moved.gaps.append((8 * S, 8050))
    moved.node = 6
    moved.read(10 * S, 0x1800, 1, 0x185)
    silent(moved.told())


@pytest.mark.near_miss("config.cob_id_collision")
def test_identifiers_that_change_hands_or_are_off() -> None:
    """Node 5 leaves 185h before node 6 takes it; TPDO2s are off; on another bus it is free."""
    script = two_nodes().write(500, 0x1800, 1, 0x185).write(510, 0x1801, 1, 0x80000285)
    script.node = 5
    script.read(300, 0x1800, 1, 0x185).write(400, 0x1800, 1, 0x190).read(450, 0x1801, 1, 0x285)
    silent(script.told())
    apart = Script(buses=("can0", "can1"), node=5)
    for bus, node in ((0, 5), (1, 6)):
        apart.frame(10, f"70{node}#05", bus=bus).frame(900, f"70{node}#05", bus=bus)
        apart.frame(100, f"60{node}#4000180100000000", bus=bus)
        apart.frame(101, f"58{node}#4300180185010000", bus=bus)
    silent(apart.told())


@pytest.mark.triggers("config.cob_id_reserved")
def test_a_pdo_on_an_identifier_of_sdo() -> None:
    (text,) = texts(running().write(500, 0x1800, 1, 0x605).told(), "config.cob_id_reserved")
    assert "TPDO1 of node 5 is set to 605h, which belongs to SDO requests" in text


@pytest.mark.near_miss("config.cob_id_reserved")
def test_a_pdo_that_is_off_or_zero() -> None:
    script = running().write(500, 0x1800, 1, 0x80000605).write(510, 0x1801, 1, 0)
    silent(script.write(520, 0x1802, 1, 0x6DF).told())


@pytest.mark.triggers("config.sync_producers")
def test_two_nodes_that_produce_the_sync() -> None:
    script = two_nodes().write(500, 0x1005, 0, 0x40000080)
    script.node = 5
    (text,) = texts(script.read(400, 0x1005, 0, 0x40000080).told(), "config.sync_producers")
    assert "Node 5 and node 6 both produce the SYNC 080h" in text


@pytest.mark.near_miss("config.sync_producers")
def test_a_producer_that_hands_over_and_consumers() -> None:
    script = two_nodes().write(500, 0x1005, 0, 0x40000080)
    script.node = 5
    script.read(300, 0x1005, 0, 0x40000080).write(400, 0x1005, 0, 0x80)
    silent(script.told())


@pytest.mark.triggers("config.heartbeat_consumer")
def test_a_consumer_that_is_too_impatient() -> None:
    script = two_nodes().write(500, 0x1016, 1, 0x0005_0064)
    script.node = 5
    told = script.write(400, 0x1017, 0, 200, size=2).told()
    (text,) = texts(told, "config.heartbeat_consumer")
    assert "waits 100 ms for the heartbeat of node 5 (1016h:1)" in text
    assert "set to send one every 200 ms (1017h)" in text


@pytest.mark.near_miss("config.heartbeat_consumer")
def test_a_consumer_with_time_to_spare() -> None:
    """Node 7 was never heard; a value of 0 watches nobody."""
    script = two_nodes().write(500, 0x1016, 1, 0x0005_0096).write(510, 0x1016, 2, 0x0007_0001)
    script.write(520, 0x1016, 3, 0x0005_0000)
    script.node = 5
    silent(script.write(400, 0x1017, 0, 100, size=2).told())
