"""`syncline devices`."""

import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from syncline_schemas.errors import DescriptionError, UsageError

if TYPE_CHECKING:
    from rich.table import Table

    from syncline_schemas.devices import Device, ObjectFacts
    from syncline_schemas.devices.check import FileCheck

EPILOG = """\b
Examples:
  syncline devices lir-da158a
  syncline devices --check drive.eds
"""
_PIPE_WIDTH = 200
"""Columns of a table that goes into a pipe, where no terminal says how wide it is."""
_BYTES = ("bootup_bytes", "event_timer_types", "sdo_read_specifiers")
"""Quirks that list bytes as they are on the wire."""


@click.command(epilog=EPILOG)
@click.argument("name", required=False)
@click.option(
    "--check",
    "checked",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Say what is wrong with an EDS, DCF or device TOML file.",
)
def devices(name: str | None, checked: Path | None) -> None:
    """Show known devices, or one with its objects, scales and quirks.

    NAME is a name from the list or the path of an .eds, .dcf or .toml file. Own devices are found
    in the folders that the environment variable SYNCLINE_DEVICES names. --check ends with exit
    code 0 when the file can be used, whatever had to be repaired, and 2 when nothing in it can.
    """
    from syncline_schemas.devices import load_device

    if checked is not None and name is not None:
        raise UsageError("give either a NAME or --check FILE, not both")
    if checked is not None:
        _check(checked)
    elif name is None:
        _print(_list_of_devices())
    else:
        _show(load_device(name))


def _check(path: Path) -> None:
    from syncline_schemas.devices.check import check_file

    result = check_file(path)
    if result.problem is not None:
        raise DescriptionError(result.problem)
    for warning in result.warnings:
        click.echo(f"{path.name}: {warning}")
    click.echo(_verdict(result), err=True)


def _verdict(result: "FileCheck") -> str:
    count = len(result.warnings)
    said = "no faults" if not count else f"{count} fault{'s' if count > 1 else ''}, listed above"
    return f"{result.path}: can be used: {result.title}, {result.variables} objects; {said}"


def _list_of_devices() -> "Table":
    from syncline_schemas.devices import device_names, load_device

    table = _table("name", "device", "vendor", "kind", "node", "bit/s", "objects")
    for name in device_names():
        try:
            device = load_device(name)
        except DescriptionError as error:
            click.echo(f"{name}: {error}", err=True)
            continue
        table.add_row(
            name,
            device.title,
            device.vendor,
            device.kind,
            _text(device.default_node),
            _text(device.default_bitrate),
            str(len(device.facts)),
        )
    return table


def _show(device: "Device") -> None:
    click.echo(
        f"{device.name}: {device.title} ({device.vendor or 'vendor unknown'}), {device.kind}"
    )
    if device.default_node is not None:
        click.echo(f"Factory settings: node {device.default_node}, {device.default_bitrate} bit/s")
    for note in device.notes:
        click.echo(f"  - {note}")
    _print(_objects(device))
    for title, rows in (
        ("EMCY codes", _emcy(device)),
        ("Quirks", _quirks(device)),
        ("Limits", [(name, _text(value)) for name, value in device.limits.items()]),
        ("Settings per node", _settings(device)),
        ("Repaired in the EDS", [(w.where, w.text) for w in device.warnings]),
    ):
        rows = list(rows)
        if rows:
            click.echo(f"\n{title}")
            _print(_pairs(rows))


def _objects(device: "Device") -> "Table":
    table = _table("object", "name", "type", "access", "default", "unit", "meaning")
    node = device.default_node or 1
    for (index, sub), facts in sorted(device.facts.items()):
        default = device.default(index, sub, node)
        place = f"{index:04X}h:{sub:02X}" if facts.record else f"{index:04X}h"
        shown = _shown(device, facts, default)
        table.add_row(
            place,
            facts.full_name,
            facts.type_name,
            facts.access,
            shown,
            _unit(facts),
            _meaning(facts),
        )
    return table


def _shown(device: "Device", facts: "ObjectFacts", default: int | bytes | None) -> str:
    if isinstance(default, bytes):
        return str(device.value(facts.index, facts.sub, default))
    if default is None:
        return ""
    return f"{default:X}h" if default > 9 and not facts.unit else str(default)


def _unit(facts: "ObjectFacts") -> str:
    scale = "" if facts.scale == 1 else f"{facts.scale:g} "
    by = f"{facts.scale_object[0]:04X}h x " if facts.scale_object else ""
    return f"{by}{scale}{facts.unit}"


def _meaning(facts: "ObjectFacts") -> str:
    """The maker's words, which name the values too; else the values and bits alone."""
    words = [f"{value} = {text}" for value, text in facts.values.items()]
    words += [f"bit {bit} = {text}" for bit, text in facts.bits.items()]
    return facts.meaning or "; ".join(words)


def _emcy(device: "Device") -> Iterator[tuple[str, str]]:
    yield from ((f"{code:04X}h", text) for code, text in sorted(device.emcy_codes.items()))
    yield from (
        (f"register bit {bit}", text) for bit, text in sorted(device.emcy_register_names.items())
    )
    for field in device.emcy_fields:
        first = 3 + field.start
        bits = "; ".join(f"bit {bit} = {text}" for bit, text in field.bits.items())
        yield f"bytes {first}..{first + field.length - 1}", f"{field.name}: {bits}"


def _quirks(device: "Device") -> Iterator[tuple[str, str]]:
    from syncline_schemas.devices import GENERIC_QUIRKS

    for field in fields(device.quirks):
        value = getattr(device.quirks, field.name)
        if value != getattr(GENERIC_QUIRKS, field.name):
            yield field.name.replace("_", " "), _byte_list(field.name, value) or _quirk_text(value)


def _byte_list(name: str, value: Any) -> str:
    return ", ".join(f"{byte:02X}h" for byte in value) if name in _BYTES else ""


def _quirk_text(value: Any) -> str:
    from syncline_schemas.devices import Jump

    match value:
        case bool():
            return "yes" if value else "no"
        case Jump():
            values = f" = {', '.join(map(str, value.values))}" if value.values else ""
            return f"{value.index:04X}h{values} ({value.text})"
        case (int(index), int(sub)) if index > 0xFF:
            return f"{index:04X}h" + (f":{sub:X}" if sub else "")
        case int():
            return f"{value:04X}h" if value > 0xFFF and value % 1000 else str(value)
        case Mapping():
            return "; ".join(f"{_quirk_text(k)}: {_quirk_text(v)}" for k, v in value.items())
        case tuple():
            return ", ".join(_quirk_text(part) for part in value)
    return str(value)


def _settings(device: "Device") -> Iterator[tuple[str, str]]:
    for name, setting in device.overrides.items():
        choices = f" ({' | '.join(map(str, setting.choices))})" if setting.choices else ""
        yield name, f"{setting.default}{choices}: {setting.meaning}"


def _text(value: object) -> str:
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _table(*columns: str) -> "Table":
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def _pairs(rows: list[tuple[str, str]]) -> "Table":
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    for row in rows:
        table.add_row(*row)
    return table


def _print(table: "Table") -> None:
    from rich.console import Console

    width = None if sys.stdout.isatty() else _PIPE_WIDTH
    Console(width=width, highlight=False, markup=False, emoji=False).print(table)
