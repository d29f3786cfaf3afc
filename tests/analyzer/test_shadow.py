"""The object-dictionary shadow: what is known of an object, from where, and since when."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from syncline_analyzer.shadow import Known, Shadow, Source
from syncline_schemas.description import BusDescription, NodeEntry
from syncline_schemas.devices import load_device
from tests.analyzer.control_runs import frame, run


def shadow(device: str | None = None, **objects: int) -> Shadow:
    """Shadow of node 5, with a device and values of the bus description."""
    entry = NodeEntry(objects={(int(key[1:], 16), 0): value for key, value in objects.items()})
    description = BusDescription(nodes={(None, 5): entry})
    devices = {5: load_device(device)} if device else {}
    return Shadow(lambda _: "can0", description, devices)


def learn(
    store: Shadow, index: int, value: int, seq: int, *, sub: int = 0, source: Source = "sdo-write"
) -> None:
    store.learn(0, 5, index, sub, Known(value, source, seq, seq))


def test_the_bus_comes_before_the_description_and_that_before_the_eds() -> None:
    store = shadow("lir-da158a", x1017=700)
    known = store.get(0, 5, 0x1017)
    assert known == Known(700, "bus-description")
    learn(store, 0x1017, 250, 10)
    assert store.number(0, 5, 0x1017) == 250
    assert store.number(0, 5, 0x1017, seq=9) == 700
    default = store.get(0, 5, 0x1800, 2)
    assert default == Known(0xFE, "eds-default")


def test_a_reset_throws_written_values_back_unless_they_were_saved() -> None:
    store = shadow()
    learn(store, 0x1017, 100, 1, source="sdo-read")
    learn(store, 0x1017, 250, 2)
    store.reset(0, 5, 3)
    assert store.number(0, 5, 0x1017) == 100
    assert store.number(0, 5, 0x1017, seq=2) == 250
    learn(store, 0x1017, 300, 4)
    store.save(0, 5, 5)
    learn(store, 0x1017, 400, 6)
    store.reset(0, 5, 7)
    assert store.number(0, 5, 0x1017) == 300


def test_reading_a_written_value_back_does_not_save_it() -> None:
    store = shadow()
    learn(store, 0x1017, 250, 1)
    learn(store, 0x1017, 250, 2, source="sdo-read")
    store.reset(0, 5, 3)
    assert store.number(0, 5, 0x1017) is None


def test_load_falls_back_to_what_is_assumed_at_the_next_reset() -> None:
    store = shadow("lir-da158a")
    learn(store, 0x1017, 250, 1)
    store.save(0, 5, 2)
    store.restore(0, 5, 2)
    assert store.number(0, 5, 0x1017) == 250
    store.reset(0, 5, 3)
    assert store.get(0, 5, 0x1017) == Known(0, "eds-default")


def test_a_save_keeps_what_the_maker_says_and_nothing_else() -> None:
    """LIR: bit 31 of 1800h:1 is not in the EEPROM list, 1017h is."""
    store = shadow("lir-da158a")
    learn(store, 0x1017, 250, 1)
    learn(store, 0x1800, 0x80000185, 2, sub=1)
    store.save(0, 5, 3)
    store.reset(0, 5, 4)
    assert store.number(0, 5, 0x1017) == 250
    assert store.number(0, 5, 0x1800, 1) == 0x185


def test_a_cob_id_that_cannot_be_moved_stays() -> None:
    """LA15: the write is acknowledged, only bit 31 is taken over."""
    store = shadow("lir-da158a")
    learn(store, 0x1800, 0x80000200, 1, sub=1)
    assert store.number(0, 5, 0x1800, 1) == 0x80000185


def test_a_write_to_6000h_zeroes_the_offset_of_a_lir() -> None:
    store = shadow("lir-da158a")
    learn(store, 0x6509, 1234, 1, source="sdo-read")
    learn(store, 0x6000, 1, 2)
    assert store.number(0, 5, 0x6509) == 0


def test_transfers_saves_and_resets_arrive_in_order_of_seq() -> None:
    """Written, saved, written again, reset by command: the saved value is back."""
    result = run(
        frame(0, 0x705, "7F"),
        frame(1, 0x605, "2B171000FA000000"),
        frame(2, 0x585, "6017100000000000"),
        frame(3, 0x605, "2310100173617665"),
        frame(4, 0x585, "6010100100000000"),
        frame(5, 0x605, "2B171000E8030000"),
        frame(6, 0x585, "6017100000000000"),
        frame(7, 0x000, "8105"),
        frame(8, 0x705, "00"),
    )
    store = result.context.shadow
    values = [store.number(0, 5, 0x1017, seq=seq) for seq in range(9)]
    assert values == [None, None, 250, 250, 250, 250, 1000, 250, 250]


def test_an_unanswered_write_teaches_nothing() -> None:
    result = run(frame(0, 0x705, "7F"), frame(1, 0x605, "2B171000FA000000"), end_ms=5000)
    assert result.context.shadow.number(0, 5, 0x1017) is None


def test_a_device_is_identified_by_what_it_answers() -> None:
    result = run(
        frame(0, 0x70A, "7F"),
        frame(1, 0x60A, "4000100000000000"),
        frame(2, 0x58A, "430010009A010400"),
        frame(3, 0x60A, "4008100000000000"),
        frame(4, 0x58A, "4108100006000000"),
        frame(5, 0x60A, "6000000000000000"),
        frame(6, 0x58A, "034A4E3231303000"),
    )
    assert result.nodes[10].device == "jn2100"
    assert result.analysis.sdo[1].value == "JN2100"


COMMUNICATION, NODE, BOOT = 0x82, 0x81, 0


def written(store: Shadow) -> list[int | None]:
    """A heartbeat time and a manufacturer's object that were written and not saved."""
    return [store.number(0, 5, 0x1017), store.number(0, 5, 0x2040)]


@pytest.mark.parametrize(
    ("resets", "left"),
    [
        ([(COMMUNICATION, 1)], [None, 7]),
        ([(COMMUNICATION, 1), (BOOT, 2)], [None, 7]),
        ([(COMMUNICATION, 1), (BOOT, 2), (BOOT, 2)], [None, 7]),
        ([(COMMUNICATION, 1), (BOOT, 60)], [None, None]),
        ([(COMMUNICATION, 1), (NODE, 2), (BOOT, 3)], [None, None]),
        ([(NODE, 1)], [None, None]),
        ([(BOOT, 1)], [None, None]),
    ],
)
def test_82h_resets_the_communication_profile_only(
    resets: list[tuple[int, int]], left: list[int | None]
) -> None:
    """CiA 301 7.3.2.2: reset communication concerns 1000h..1FFFh, reset node everything."""
    store = shadow()
    learn(store, 0x1017, 250, 1)
    learn(store, 0x2040, 7, 2)
    for seq, (specifier, second) in enumerate(resets, start=10):
        store.reset(0, 5, seq, second * 1_000_000_000, specifier)
    assert written(store) == left


def test_82h_drops_everything_where_the_maker_says_so() -> None:
    """Haomiao sheet, section 1: unsaved values are lost by "reset communication"."""
    store = shadow("haomiao-38")
    learn(store, 0x6001, 4096, 1)
    store.reset(0, 5, 2, 0, COMMUNICATION)
    assert store.get(0, 5, 0x6001) == Known(8192, "eds-default")


def test_a_device_resets_by_a_write() -> None:
    """JN2100 2002h = 1 resets without an NMT frame."""
    store = shadow("jn2100")
    learn(store, 0x1017, 250, 1)
    learn(store, 0x2002, 1, 2)
    assert store.get(0, 5, 0x1017) == Known(0, "eds-default")


def test_the_makers_values_come_back_by_a_write() -> None:
    """JN2100 207Fh = 1: 2000h..5FFFh, not the communication profile."""
    store = shadow("jn2100")
    learn(store, 0x2043, 4, 1)
    learn(store, 0x1017, 250, 2)
    learn(store, 0x207F, 1, 3)
    assert store.get(0, 5, 0x2043) == Known(2, "eds-default")
    assert store.number(0, 5, 0x2043, seq=2) == 4
    assert store.number(0, 5, 0x1017) == 250


def test_every_value_has_the_stretch_in_which_it_held() -> None:
    store = shadow()
    learn(store, 0x1017, 100, 1, source="sdo-read")
    learn(store, 0x1017, 250, 5)
    learn(store, 0x1017, 250, 7, source="sdo-read")
    store.reset(0, 5, 9, 9)
    learn(store, 0x1017, 100, 11, source="sdo-read")
    told = [
        (span.change.cause, span.change.known and span.change.known.value, span.until_seq)
        for span in store.spans(0, 5, 0x1017)
    ]
    assert told == [
        ("sdo-read", 100, 5),
        ("sdo-write", 250, 7),
        ("sdo-read", 250, 9),
        ("reset", 100, 11),
        ("sdo-read", 100, None),
    ]


def test_a_value_that_is_polled_is_one_change() -> None:
    store = shadow()
    for seq in range(10):
        learn(store, 0x6004, 77, seq, source="sdo-read")
    assert store.changes(0, 5, 0x6004) == [0]


def test_only_what_the_node_told_is_confirmed() -> None:
    store = shadow("lir-da158a", x1017=700)
    assert store.confirmed(0, 5, 0x1017) is None
    assert store.confirmed(0, 5, 0x1800, 2) is None
    learn(store, 0x1017, 250, 10)
    assert store.confirmed(0, 5, 0x1017) == 250
    assert store.confirmed(0, 5, 0x1017, 0, 9) is None


@given(
    st.lists(
        st.one_of(
            st.tuples(st.sampled_from(["sdo-read", "sdo-write"]), st.integers(0, 3)),
            st.sampled_from(["save", "reset"]),
        ),
        max_size=30,
    )
)
def test_a_reset_gives_what_a_simple_memory_would(steps: list[object]) -> None:
    """Against two plain variables: RAM and EEPROM, where a read tells what is in both."""
    store, ram, eeprom = shadow(), None, None
    dirty = False
    for seq, step in enumerate(steps, start=1):
        if step == "save":
            store.save(0, 5, seq)
            if ram is not None or dirty:
                eeprom, dirty = ram, False
        elif step == "reset":
            store.reset(0, 5, seq)
            if dirty:
                ram, dirty = eeprom, False
        else:
            assert isinstance(step, tuple)
            source, value = step
            learn(store, 0x1017, value, seq, source=source)
            ram = value
            if source == "sdo-write":
                dirty = True
            elif not dirty:
                eeprom = value
        assert store.number(0, 5, 0x1017) == ram


def transfers(first: int, last: int) -> st.SearchStrategy[object]:
    kinds = st.sampled_from(["sdo-read", "sdo-write"])
    return st.one_of(st.tuples(kinds, st.integers(first, last)), st.just("save"))


@given(
    st.lists(st.one_of(transfers(0, 3), st.just("reset")), max_size=8),
    st.lists(transfers(4, 7), max_size=5),
)
def test_a_reset_that_is_told_late_is_one_all_the_same(
    before: list[object], after: list[object]
) -> None:
    """A boot-up of which only the next message of the node tells that it is one.

    Values differ before and after: a read that only repeats the one before leaves no trace.
    """
    in_time, late = shadow(), shadow()
    moment = len(before)
    for seq, step in enumerate([*before, "reset", *after]):
        _take(in_time, seq, step)
        if seq != moment:
            _take(late, seq, step)
    late.reset(0, 5, moment)
    seqs = range(len(before) + len(after) + 2)
    told = [late.number(0, 5, 0x1017, seq=seq) for seq in seqs]
    assert told == [in_time.number(0, 5, 0x1017, seq=seq) for seq in seqs]
    for store in (in_time, late):
        store.reset(0, 5, len(seqs))
    assert late.number(0, 5, 0x1017) == in_time.number(0, 5, 0x1017)


def _take(store: Shadow, seq: int, step: object) -> None:
    if step == "save":
        store.save(0, 5, seq)
    elif step == "reset":
        store.reset(0, 5, seq)
    else:
        assert isinstance(step, tuple)
        learn(store, 0x1017, step[1], seq, source=step[0])
