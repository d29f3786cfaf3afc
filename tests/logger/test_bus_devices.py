"""The description that a recording works with."""

from pathlib import Path

import pytest

from syncline_logger.bus_devices import load_description
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import load_device
from syncline_schemas.errors import DescriptionError, SynclineError, UsageError


def devices(description: BusDescription, bus: str) -> dict[int, str]:
    entries = description.described(bus).items()
    return {node: entry.device.name for node, entry in entries if entry.device}


def test_devices_by_name_hold_on_any_bus() -> None:
    assert devices(load_description(None, ["5=lir-da158a", "10=jn2100"]), "can7") == {
        5: "lir-da158a",
        10: "jn2100",
    }


def test_a_device_of_one_bus_only() -> None:
    description = load_description(None, ["can0:5=jn2100"])
    assert devices(description, "can0") == {5: "jn2100"}
    assert devices(description, "can1") == {}


def test_a_file_of_the_users_travels_with_the_description(tmp_path: Path) -> None:
    eds = load_device("jn2100").files["jn2100.eds"]
    (tmp_path / "mine.eds").write_bytes(eds)
    description = load_description(None, [f"5={tmp_path / 'mine.eds'}"])
    assert description.files["mine.eds"] == eds
    assert str(tmp_path) not in description.text
    again = BusDescription.loads(description.text, files=description.files)
    assert devices(again, "a") == devices(description, "a") == {5: "mine"}


def test_devices_are_added_to_a_file(tmp_path: Path) -> None:
    path = tmp_path / "line.toml"
    path.write_text('[bus.can0]\nbitrate = 250000\n[node.7]\ndevice = "jn2100"', encoding="utf-8")
    description = load_description(path, ["5=haomiao-38"])
    assert devices(description, "can0") == {5: "haomiao-38", 7: "jn2100"}
    assert description.bitrate("can0") == 250_000
    with pytest.raises(UsageError, match="describes this node already"):
        load_description(path, ["7=haomiao-38"])


@pytest.mark.parametrize("word", ["5", "=jn2100", "0=jn2100", "128=jn2100", "x=jn2100", "5="])
def test_a_wrong_word_is_named(word: str) -> None:
    with pytest.raises(UsageError, match="--device"):
        load_description(None, [word])


@pytest.mark.parametrize("word", ["5=no-such-device", "5=missing.eds"])
def test_an_unknown_device_is_named(word: str) -> None:
    with pytest.raises(SynclineError, match=r"no-such-device|missing\.eds") as error:
        load_description(None, [word])
    assert isinstance(error.value, DescriptionError)
