"""Whose PDO an identifier is, by what was seen, described, built in, or only usual."""

import pytest

from syncline_analyzer.context import Context
from syncline_analyzer.pdo_binding import PdoBindings, settled
from syncline_schemas.description import BusDescription
from tests.analyzer.timing_builder import context, learn


def bindings(ctx: Context) -> PdoBindings:
    made = PdoBindings(ctx.shadow)
    made.refresh(0)
    return made


def name(ctx: Context, can_id: int, seq: int | None = None) -> tuple[int, str, str] | None:
    pdo = bindings(ctx).owner(0, can_id, seq)
    return None if pdo is None else (pdo.node, pdo.name, pdo.source)


def test_a_predefined_identifier_is_a_guess() -> None:
    assert name(context(), 0x28A) == (10, "TPDO2 (guess)", "predefined")
    assert name(context(), 0x30A) == (10, "RPDO2 (guess)", "predefined")
    assert name(context(), 0x10A) is None


def test_what_was_read_binds() -> None:
    ctx = context()
    learn(ctx, 5, 0x1802, 1, 0x4000_0322)
    assert name(ctx, 0x322) == (5, "TPDO3", "sdo-read")


def test_a_node_bound_elsewhere_is_not_guessed() -> None:
    ctx = context()
    learn(ctx, 10, 0x1800, 1, 0x322)
    assert name(ctx, 0x18A) is None
    assert name(ctx, 0x28A) == (10, "TPDO2 (guess)", "predefined")


def test_a_binding_holds_from_the_moment_it_was_made() -> None:
    ctx = context(devices={1: "haomiao-38"})
    learn(ctx, 1, 0x1800, 1, 0x333, seq=100, source="sdo-write")
    assert name(ctx, 0x181, 99) == (1, "TPDO1", "eds-default")
    assert name(ctx, 0x333, 100) == (1, "TPDO1", "sdo-write")
    assert name(ctx, 0x181, 100) is None


def test_bit_31_switches_off() -> None:
    ctx = context()
    learn(ctx, 5, 0x1800, 1, 0x8000_0185)
    assert name(ctx, 0x185) is None


def test_a_fixed_identifier_does_not_move() -> None:
    """LIR-DA158: a write to 1800h:1 takes over bit 31 only (sheet, trap 11)."""
    ctx = context(devices={1: "lir-da158"})
    learn(ctx, 1, 0x1800, 1, 0x200, seq=10, source="sdo-write")
    assert name(ctx, 0x181, 11) == (1, "TPDO1", "sdo-write")
    learn(ctx, 1, 0x1800, 1, 0x8000_0200, seq=20, source="sdo-write")
    assert name(ctx, 0x181, 21) is None


def test_the_bus_description_binds_before_the_device() -> None:
    text = '[bus.can0.node.7]\ndevice = "haomiao-38"\n[bus.can0.node.7.objects]\n"1800:1" = 0x2AA\n'
    ctx = context(description=BusDescription.loads(text))
    assert name(ctx, 0x2AA) == (7, "TPDO1", "bus-description")
    assert name(ctx, 0x287) == (7, "TPDO2", "eds-default")


def test_a_described_pdo_far_up_is_found() -> None:
    text = '[node.7.objects]\n"18C8:1" = 0x2AB\n'
    ctx = context(description=BusDescription.loads(text))
    assert name(ctx, 0x2AB) == (7, "TPDO201", "bus-description")


def test_the_sender_wins_over_the_receiver() -> None:
    ctx = context(devices={10: "jn2100"})
    learn(ctx, 3, 0x1400, 1, 0x18A)
    assert name(ctx, 0x18A) == (10, "TPDO1", "eds-default")


def test_a_pdo_far_up_is_found() -> None:
    ctx = context()
    learn(ctx, 5, 0x19FF, 1, 0x2C5)
    assert name(ctx, 0x2C5) == (5, "TPDO512", "sdo-read")


def test_mapping_follows_what_was_written() -> None:
    ctx = context(devices={1: "haomiao-38"})
    made = bindings(ctx)
    pdo = made.owner(0, 0x181)
    assert pdo is not None
    mapping = made.mapping(pdo, 0)
    assert mapping is not None
    assert [(e.index, e.bits) for e in mapping.entries] == [(0x6004, 32)]
    learn(ctx, 1, 0x1A00, 0, 2, seq=50, source="sdo-write")
    learn(ctx, 1, 0x1A00, 1, 0x1001_0008, seq=51, source="sdo-write")
    learn(ctx, 1, 0x1A00, 2, 0x6004_0020, seq=52, source="sdo-write")
    later = made.mapping(pdo, 53)
    assert later is not None
    assert [(e.index, e.offset) for e in later.entries] == [(0x1001, 0), (0x6004, 8)]
    assert made.cuts(0, 0x181, 0, 100) == [50, 51, 52]


def test_an_unknown_mapping_is_none() -> None:
    made = bindings(context())
    pdo = made.owner(0, 0x181)
    assert pdo is not None
    assert made.mapping(pdo) is None


@pytest.mark.parametrize(
    ("value", "sync"), [(None, 0x80), (0x4000_0090, 0x90), (0x2000_0090, 0x80)]
)
def test_sync_identifier(value: int | None, sync: int) -> None:
    ctx = context()
    if value is not None:
        learn(ctx, 5, 0x1005, 0, value)
    assert bindings(ctx).sync_cob_id(0, 5) == sync


def test_transmission_names_its_sources() -> None:
    ctx = context(devices={10: "jn2100"})
    learn(ctx, 10, 0x1800, 2, 0xFE, source="sdo-write")
    made = bindings(ctx)
    pdo = made.owner(0, 0x18A)
    assert pdo is not None
    sent = made.transmission(pdo)
    assert sent.type is not None
    assert (sent.type.value, sent.type.source) == (0xFE, "sdo-write")
    assert sent.event_timer_ms is not None
    assert (sent.event_timer_ms.value, sent.event_timer_ms.source) == (10, "eds-default")


def test_an_identifier_of_zero_is_none() -> None:
    """Devices write an unused PDO as 0; NMT commands are not its frames."""
    ctx = context()
    learn(ctx, 5, 0x1800, 1, 0)
    assert bindings(ctx).identifiers(0) == []
    assert name(ctx, 0x185) is None


def test_long_mappings_are_followed_to_their_last_entry() -> None:
    """64 entries of one bit (CiA 301 7.5.2.36), the last of which changes."""
    ctx = context()
    learn(ctx, 5, 0x1800, 1, 0x185)
    for sub in range(1, 65):
        learn(ctx, 5, 0x1A00, sub, 0x2000_0001 + (sub << 16), seq=sub)
    learn(ctx, 5, 0x1A00, 0, 64, seq=65)
    learn(ctx, 5, 0x1A00, 64, 0x2100_0001, seq=100, source="sdo-write")
    made = bindings(ctx)
    assert made.cuts(0, 0x185, 65, 200) == [100]
    pdo = made.owner(0, 0x185)
    assert pdo is not None
    entries = [made.mapping(pdo, seq) for seq in (99, 100)]
    assert [m.entries[63].index for m in entries if m] == [0x2040, 0x2100]
    assert made.mapping_confirmed(pdo, 99)


def test_turns_are_new_values_only() -> None:
    ctx = context()
    learn(ctx, 5, 0x1800, 2, 1, seq=10)
    learn(ctx, 5, 0x1800, 2, 1, seq=20, source="sdo-write")
    learn(ctx, 5, 0x1800, 2, 254, seq=30, source="sdo-write")
    learn(ctx, 5, 0x2000, 0, 7, seq=40, source="sdo-write")
    learn(ctx, 5, 0x1005, 0, 0x90, seq=50, source="sdo-write")
    ctx.shadow.reset(0, 5, 60)
    made = bindings(ctx)
    assert made.turns(0, 0, 100) == [10, 30, 50, 60]
    assert made.turns(0, 10, 30) == [30]


def test_settings_are_settled_where_nothing_changes_behind() -> None:
    ctx = context()
    learn(ctx, 5, 0x1800, 2, 0xFF, seq=100)
    version = settled(ctx.shadow, 0, 100)
    assert version is not None
    assert settled(ctx.shadow, 0, 99) is None
    learn(ctx, 6, 0x1800, 2, 1, seq=200)
    assert settled(ctx.shadow, 0, 100) is None
    assert settled(ctx.shadow, 0, 200) not in (None, version)
