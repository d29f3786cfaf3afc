"""Which PDOs the recorder binds; expected values from the devices' sheets and CiA 301."""

from syncline_logger.node_objects import NodeObjects, PdoBinding
from syncline_schemas.description import NodeEntry
from syncline_schemas.devices import load_device


def node(device: str | None = None, number: int = 10) -> NodeObjects:
    return NodeObjects(number, NodeEntry(device=load_device(device)) if device else None)


def learn(objects: NodeObjects, *values: tuple[int, int, int], written: bool = True) -> NodeObjects:
    for index, sub, value in values:
        objects.learn((index, sub), value.to_bytes(4, "little"), written=written)
    return objects


def bound(objects: NodeObjects) -> dict[str, tuple[int, list[tuple[int, int]]]]:
    """Identifier, and index and bits of each entry, by PDO."""
    return {each.service: (each.can_id, entries(each)) for each in objects.bindings()}


def entries(binding: PdoBinding) -> list[tuple[int, int]]:
    return [(entry.index, entry.bits) for entry in binding.mapping.entries]


MAPPING = ((0x1A00, 1, 0x60040020), (0x1A00, 0, 1))


def test_nothing_known_nothing_bound() -> None:
    assert bound(node()) == {}


def test_a_learned_mapping_has_the_predefined_identifier() -> None:
    assert bound(learn(node(), *MAPPING)) == {"tpdo1": (0x18A, [(0x6004, 32)])}


def test_rpdos_too() -> None:
    rpdo = learn(node(), (0x1601, 1, 0x62000108), (0x1601, 0, 1))
    assert bound(rpdo) == {"rpdo2": (0x30A, [(0x6200, 8)])}


def test_a_fifth_pdo_has_no_predefined_identifier() -> None:
    fifth = learn(node(), (0x1A04, 1, 0x60040020), (0x1A04, 0, 1))
    assert bound(fifth) == {}
    assert bound(learn(fifth, (0x1804, 1, 0x1E7)))["tpdo5"][0] == 0x1E7


def test_an_invalid_identifier_unbinds() -> None:
    assert bound(learn(node(), *MAPPING, (0x1800, 1, 0x8000018A))) == {}


def test_an_incomplete_mapping_is_not_bound() -> None:
    assert bound(learn(node(), (0x1A00, 1, 0x60040020), (0x1A00, 0, 2))) == {}


def test_a_multiplexed_pdo_is_not_bound() -> None:
    assert bound(learn(node(), (0x1A00, 1, 0x60040020), (0x1A00, 0, 0xFE))) == {}


def test_a_read_value_survives_a_reset_and_a_written_one_does_not() -> None:
    read = learn(node(), *MAPPING, written=False)
    assert not read.reset()
    assert bound(read)
    written = learn(node(), *MAPPING)
    assert written.reset()
    assert bound(written) == {}


def test_a_read_of_an_unsaved_value_does_not_save_it() -> None:
    objects = learn(node(), *MAPPING)
    learn(objects, *MAPPING, written=False)
    objects.reset()
    assert bound(objects) == {}


def test_saving_keeps_what_was_written() -> None:
    objects = learn(node(), *MAPPING, (0x1010, 1, 0x65766173))
    objects.reset()
    assert bound(objects)


def test_jn2100_measures_angles_or_vibration() -> None:
    """Sheet: 2047h selects what TPDO1/2 (angles) or TPDO3 (vibration) carry."""
    device = node("jn2100")
    assert set(bound(device)) == {"tpdo1", "tpdo2"}
    assert bound(device)["tpdo1"] == (0x18A, [(0x6010, 16), (0x6020, 16)])
    learn(device, (0x2047, 0, 1))
    assert set(bound(device)) == {"tpdo3"}
