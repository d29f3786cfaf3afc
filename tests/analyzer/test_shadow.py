"""The object-dictionary shadow: what is known of an object, from where, and since when."""

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
    store.save(0, 5)
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
    store.save(0, 5)
    store.restore(0, 5)
    assert store.number(0, 5, 0x1017) == 250
    store.reset(0, 5, 3)
    assert store.get(0, 5, 0x1017) == Known(0, "eds-default")


def test_a_save_keeps_what_the_maker_says_and_nothing_else() -> None:
    """LIR: bit 31 of 1800h:1 is not in the EEPROM list, 1017h is."""
    store = shadow("lir-da158a")
    learn(store, 0x1017, 250, 1)
    learn(store, 0x1800, 0x80000185, 2, sub=1)
    store.save(0, 5)
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
