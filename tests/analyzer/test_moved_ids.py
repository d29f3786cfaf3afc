"""Identifiers that a client moves are followed from the frame on that moves them."""

import pytest

from tests.analyzer.traps.script import OPERATIONAL, Script, little

S = 1000


def encoder(**given: object) -> Script:
    """A Haomiao encoder as node 1, OPERATIONAL for ten seconds; its PDOs can be moved."""
    script = Script("haomiao-38", 1, **given)  # type: ignore[arg-type]
    return script.boot(10).nmt(500, 1).heartbeat(600, 10 * S)


def positions(script: Script, can_id: int, start: float, stop: float, first: int = 0) -> Script:
    return script.every(start, stop, 100, lambda k: f"{can_id:03X}#{little(first + k)}")


def test_a_tpdo_is_its_nodes_before_and_after_it_moves() -> None:
    script = positions(encoder(), 0x181, 600, 5 * S)
    script.write(5 * S, 0x1800, 1, 0x333)
    told = positions(script, 0x333, 5100, 10 * S, 44).told()
    for can_id, frames in ((0x181, 44), (0x333, 49)):
        row = told.pdo(can_id)
        assert (row.node, row.pdo, row.frames) == (1, "TPDO1", frames)
    assert told.trace_row().samples == 93
    assert told.row().pdo_frames == 93


def test_an_identifier_that_is_given_back_by_a_reset() -> None:
    """Sheet, trap 10: 82h drops what was not saved. The last frames are TPDO1 on 181h again."""
    script = encoder().write(700, 0x1800, 1, 0x333)
    positions(script, 0x333, 800, 5 * S)
    script.nmt(5 * S, 0x82).boot(5200).nmt(5300, 1)
    told = positions(script, 0x181, 5400, 10 * S, 42).told()
    assert [(told.pdo(can_id).node, told.pdo(can_id).pdo) for can_id in (0x181, 0x333)] == [
        (1, "TPDO1"),
        (1, "TPDO1"),
    ]
    assert told.trace_row().samples == 88


def test_pdos_answer_the_sync_that_their_node_listens_to() -> None:
    """From 5 s on the SYNC is 090h: no PDO is late or missed around the move."""
    script = encoder().read(300, 0x1801, 2, 1).read(310, 0x1801, 1, 0x281)
    for start, stop, sync in ((1000, 5000, 0x80), (5000, 10000, 0x90)):
        script.every(start, stop, 20, f"{sync:03X}#")
        script.every(start + 1, stop, 20, "281#00000000")
    script.write(4990, 0x1005, 0, 0x90)
    told = script.told()
    rows = {row.cob_id: row.count for row in told.analysis.sync}
    assert rows == {0x80: 200, 0x90: 250}
    row = told.pdo(0x281)
    assert (row.missed, row.extra) == (0, 0)
    assert row.response_us is not None
    assert row.response_us.max == pytest.approx(1000)
    (responses,) = (r for r in told.analysis.responses if r.cob_id == 0x281)
    assert len(responses.t_ns) == 450


def test_emcys_are_their_nodes_before_and_after_they_move() -> None:
    """0F5h is node 117's by the predefined connection set, until 1014h of node 5 takes it."""
    script = Script(node=5).boot(10).heartbeat(100, 3 * S)
    script.frame(500, "0F5#0031010000000000").frame(600, "085#1042010000000000")
    script.write(1000, 0x1014, 0, 0xF5)
    told = script.frame(1500, "0F5#2050010000000000").frame(1600, "0F5#0000000000000000").told()
    assert [(row.node, row.code) for row in told.emcy] == [
        (117, 0x3100),
        (5, 0x4210),
        (5, 0x5020),
        (5, 0x0000),
    ]


@pytest.mark.parametrize("value", [0x8000_00F5, 0x2000_00F5])
def test_an_emcy_identifier_that_is_off_or_long_moves_nothing(value: int) -> None:
    script = Script(node=5).boot(10).heartbeat(100, 3 * S).write(1000, 0x1014, 0, value)
    told = script.frame(1500, "0F5#2050010000000000").frame(1600, "085#3050010000000000").told()
    assert [row.node for row in told.emcy] == [117, 5]


def test_a_mapping_counts_from_the_frame_on_that_enables_it() -> None:
    """Byte order tells the two apart: position alone, then error register and position."""
    script = positions(encoder(), 0x181, 600, 5 * S, 1000)
    script.write(5000, 0x1800, 1, 0x80000181).write(5010, 0x1A00, 0, 0)
    script.write(5020, 0x1A00, 1, 0x10010008).write(5030, 0x1A00, 2, 0x60040020)
    script.write(5040, 0x1A00, 0, 2).write(5050, 0x1800, 1, 0x181)
    script.every(5100, 10 * S, 100, lambda k: f"181#00{little(1044 + k)}")
    told = script.told()
    trace = told.trace()
    assert trace.raw.tolist() == list(range(1000, 1093))
    assert not told.events("jump")


def test_two_buses_with_the_same_node_stay_apart() -> None:
    script = Script(node=5, buses=("can0", "can1"))
    for bus in (0, 1):
        script.frame(10, "705#00", bus=bus).frame(900 + bus, "705#05", bus=bus)
    script.frame(100, "605#2217100064000000", bus=0).frame(101, "585#6017100000000000", bus=0)
    script.frame(200, "605#22001801C5010000", bus=1).frame(201, "585#6000180100000000", bus=1)
    script.every(300, 900, 50, "1C5#01")
    told = script.told()
    known = {(row.bus, row.index): row.value for row in told.analysis.objects}
    assert known == {("can0", 0x1017): 100, ("can1", 0x1800): 0x1C5}
    row = told.pdo(0x1C5)
    assert (row.bus, row.node, row.pdo) == ("can0", 69, "TPDO1 (guess)")


def test_an_unasked_boot_up_with_a_state_byte_takes_settings_back() -> None:
    """LIR: 7Fh is the boot-up where heartbeat runs; what was not saved is lost (LB01)."""
    script = Script("lir-da158a", 1).heartbeat(100, 5 * S, OPERATIONAL)
    script.read(200, 0x1800, 5, 515, size=2).write(300, 0x1800, 5, 20)
    told = script.heartbeat(9 * S, 12 * S, 0x7F).told()
    row = told.object(0x1800, 5)
    assert (row.value, row.cause, row.source) == (515, "reset", "sdo-read")


@pytest.mark.parametrize("size", [1, 7, 64])
def test_what_is_told_does_not_hang_on_the_size_of_batches(size: int) -> None:
    """A PDO, the SYNC and the EMCYs move, and a reset takes two of the moves back."""
    script = positions(encoder(), 0x181, 600, 2 * S)
    script.write(2000, 0x1800, 1, 0x333).write(2010, 0x1014, 0, 0xF5).save(2020)
    script.write(2030, 0x1005, 0, 0x90).write(2040, 0x1801, 1, 0x334)
    positions(script, 0x333, 2100, 4 * S, 20)
    script.every(2100, 4000, 100, "334#00000000").every(1000, 5000, 100, "090#")
    script.frame(1500, "0F5#0031010000000000").frame(2500, "0F5#0031010000000000")
    script.nmt(4 * S, 0x82).boot(4200).nmt(4300, 1)
    positions(script, 0x333, 4400, 6 * S, 42).every(4400, 6000, 100, "281#00000000")
    assert tables(script, size) == tables(script, 1 << 20)


def tables(script: Script, size: int) -> list[object]:
    """What the tables say of identifiers and objects, fed in batches of so many frames."""
    told = script.told(size)
    analysis = told.analysis
    pdos = [(row.cob_id, row.node, row.pdo, row.frames, row.missed) for row in analysis.pdos]
    emcys = [(row.seq, row.node) for row in analysis.emcy]
    syncs = [(row.cob_id, row.count) for row in analysis.sync]
    found = [(f.id, f.node, f.text) for f in analysis.findings]
    return [pdos, emcys, syncs, found, analysis.objects, analysis.object_history]


def test_a_fall_by_command_takes_nothing_back() -> None:
    script = Script("lir-da158a", 1).heartbeat(100, 5 * S, OPERATIONAL)
    script.read(200, 0x1800, 5, 515, size=2).write(300, 0x1800, 5, 20).nmt(5 * S, 0x80)
    told = script.heartbeat(5100, 12 * S, 0x7F).told()
    assert told.object(0x1800, 5).value == 20


def test_the_identifier_of_a_pdo_may_be_taken_over_by_another_node() -> None:
    """Node 5 leaves 1A5h, node 6 takes it: each keeps its frames' name in the history."""
    script = Script(node=5).boot(10).heartbeat(20, 3 * S)
    script.write(100, 0x1800, 1, 0x1A5)
    script.every(200, 1000, 100, "1A5#05").write(1000, 0x1800, 1, 0x1A7)
    script.node = 6
    script.boot(15).heartbeat(25, 3 * S).write(1100, 0x1800, 1, 0x1A5)
    told = script.every(1200, 2000, 100, "1A5#06").told()
    row = told.pdo(0x1A5)
    assert (row.node, row.frames) == (6, 16)
