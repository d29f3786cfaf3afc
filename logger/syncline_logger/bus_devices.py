"""The bus description a recording works with: the user's file and the devices he named."""

from collections.abc import Sequence
from pathlib import Path

from syncline_schemas.description import BusDescription
from syncline_schemas.devices import is_path, load_device
from syncline_schemas.errors import UsageError


def load_description(path: Path | None, devices: Sequence[str]) -> BusDescription:
    """Description from a file and `[BUS:]NODE=NAME_OR_EDS` words, as one text for the capture.

    Raises DescriptionError or UsageError for what cannot be used.
    """
    described = BusDescription.load(path) if path else BusDescription()
    if not devices:
        return described
    text, files = described.text, dict(described.files)
    for word in devices:
        bus, node, device = split_device(word)
        if (bus, node) in described.nodes:
            raise UsageError(f"--device {word}: {path} describes this node already")
        line = _device_line(device, files)
        place = f'bus."{bus}".node.{node}' if bus else f"node.{node}"
        text += f"\n[{place}]\n{line}\n"
    return BusDescription.loads(text.lstrip("\n"), path.parent if path else None, files)


def _device_line(name_or_path: str, files: dict[str, bytes]) -> str:
    """The device's line in the description; a file's content is put under its name."""
    device = load_device(name_or_path)
    if not is_path(name_or_path):
        return f'device = "{name_or_path}"'
    files |= device.files
    return f'eds = "{Path(name_or_path).name}"'


def split_device(word: str) -> tuple[str | None, int, str]:
    """Bus (None = any), node and device of a `[BUS:]NODE=NAME_OR_EDS` word.

    >>> split_device("5=jn2100"), split_device("can0:7=x.eds")
    ((None, 5, 'jn2100'), ('can0', 7, 'x.eds'))
    """
    place, _, device = word.partition("=")
    bus, _, node = place.rpartition(":")
    if not device or not node.isdecimal() or not 1 <= int(node) <= 127:
        raise UsageError(f"--device: '{word}' is not NODE=NAME_OR_EDS with a node of 1..127")
    return bus or None, int(node), device
