"""The index by which built-in devices are told without reading their EDS."""

import json
from pathlib import Path

import pytest

from syncline_schemas.devices import catalog, device_names, identify, index, load_device, suspects
from syncline_schemas.devices.catalog import hallmarks
from syncline_schemas.devices.index import INDEX, Hallmarks, built_in_hallmarks, index_text

MAKE = "make it anew: python -m syncline_schemas.devices.index"


def test_it_says_what_the_device_files_say() -> None:
    assert INDEX.read_text(encoding="utf-8") == index_text(), MAKE
    files = {path.stem for path in INDEX.parent.glob("*.toml")}
    assert set(built_in_hallmarks()) == files == set(device_names(())), MAKE
    for name, found in built_in_hallmarks().items():
        assert found == Hallmarks.of(load_device(name, ())), MAKE


def test_factory_settings_of_tpdos() -> None:
    tpdos = built_in_hallmarks()["jn2100"].tpdos
    assert {can_id: pdo.length for can_id, pdo in tpdos.items()} == {0x180: 4, 0x280: 8, 0x380: 8}
    assert {pdo.type for pdo in tpdos.values()} == {1}


def test_a_node_that_is_no_known_device_costs_no_file(monkeypatch: pytest.MonkeyPatch) -> None:
    def read(*_: object) -> None:
        raise AssertionError("a device was loaded")

    monkeypatch.setattr(catalog, "device_from_files", read)
    catalog._cached.cache_clear()
    known: dict[tuple[int, int], int | bytes] = {
        (0x1000, 0): 0x191,
        (0x1018, 1): 0x99,
        (0x1018, 2): 7,
        (0x1008, 0): b"other",
    }
    assert identify(known, ()) is None
    assert suspects(known, ()) == []
    assert [name for name, _ in hallmarks(())] == device_names(())
    with pytest.raises(AssertionError, match="was loaded"):
        identify({(0x1008, 0): b"JN2100"}, ())
    catalog._cached.cache_clear()


def test_the_users_devices_are_among_them(tmp_path: Path) -> None:
    eds = (INDEX.parent / "lir-918.eds").read_bytes()
    (tmp_path / "own.eds").write_bytes(eds)
    (tmp_path / "broken.eds").write_bytes(b"[nothing")
    found = dict(hallmarks((tmp_path,)))
    assert set(found) >= {"own", "lir-918"}
    assert found["own"].tpdos == found["lir-918"].tpdos
    assert "broken" not in found or not found["broken"].identity


def test_it_is_plain_json() -> None:
    assert set(json.loads(index.index_text())) == set(device_names(()))
