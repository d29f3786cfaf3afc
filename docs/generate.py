"""Writes the pages made from the code: `uv run python -m docs.generate`.

`commands.md` comes from the commands' own --help, `findings.md` from the rules, `formats.md` from the
registries of readers and writers, `device-check.md` from the kinds of faults, `devices/*.md` from the
devices' files and from the tables that their readers know.
"""

import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import click

from syncline_analyzer.findings import RULES
from syncline_analyzer.findings.bonds import BONDS
from syncline_analyzer.findings.rule import Rule
from syncline_analyzer.readers.formats import READ_FORMATS
from syncline_analyzer.writers.formats import PACKINGS, WRITE_FORMATS
from syncline_logger.cli import cli
from syncline_logger.device_sheet import HANDLED, Section, objects, sections
from syncline_schemas.description import BUS_KEYS, NODE_KEYS
from syncline_schemas.devices import Device, device_names, load_device
from syncline_schemas.devices.check.kinds import KINDS, SEVERITIES
from syncline_schemas.devices.profile import known_keys
from syncline_schemas.devices.standard import standard_profiles

FOLDER = Path(__file__).parent
FINDINGS_HEADER = """# Findings

Made from the rules by `python -m docs.generate`; a test keeps it true. A finding says what a service engineer would
write in a report: what happened, the frames that prove it, the likely cause and what to check next. Findings that follow
from another one become links of its `chain`: one story, told at its root. Severities: `error` is a fault that stops or
endangers the machine, `warning` something to look at, `info` a note. What a finding rests on that was only assumed stands
in `assumed`.
"""
HEADER = """# Commands

Made from `--help` by `python -m docs.generate`; a test keeps it true. Data goes to stdout, words and progress to
stderr. Exit codes: 0 fine, 1 the wanted result was not reached (`--check`, a damaged capture that could be read only in
part), 2 wrong use or unreadable input, 130 interrupted.
"""


def commands_page() -> str:
    """The whole page: `syncline --help`, then each command in the order of their names."""
    root = click.Context(
        cli,
        info_name="syncline",
        max_content_width=100,
        terminal_width=100,
        **cli.context_settings,
    )
    sections = [HEADER, _section("syncline", root)]
    for name in sorted(cli.list_commands(root)):
        command = cli.get_command(root, name)
        assert command is not None
        context = click.Context(command, parent=root, info_name=name, terminal_width=100)
        sections.append(_section(f"syncline {name}", context))
        if isinstance(command, click.Group):
            sections += _subcommands(command, context)
    return "\n".join(sections)


def _subcommands(group: click.Group, context: click.Context) -> Iterator[str]:
    """The sections of a group's commands."""
    for name in sorted(group.list_commands(context)):
        command = group.get_command(context, name)
        assert command is not None
        inner = click.Context(command, parent=context, info_name=name, terminal_width=100)
        yield _section(inner.command_path, inner)


def _section(title: str, context: click.Context) -> str:
    return f"## {title}\n\n```\n{context.get_help().rstrip()}\n```\n"


def findings_page() -> str:
    """Every rule by family: meaning, evidence, guards against false alarms, and what it explains."""
    by_id = sorted(RULES, key=lambda rule: rule.id)
    sections = [FINDINGS_HEADER, f"{len(by_id)} findings are known.\n"]
    for family, rules in groupby(by_id, key=lambda rule: rule.id.partition(".")[0]):
        sections += [f"## {family}\n", *(_rule_section(rule) for rule in rules)]
    return "\n".join(sections)


def _rule_section(rule: Rule) -> str:
    effects = sorted({bond.effect for bond in BONDS if bond.cause == rule.id})
    lines = [
        f"### {rule.id}\n",
        f"{rule.meaning}\n",
        f"- Evidence: {rule.evidence}",
        *(f"- Guard: {guard}" for guard in rule.guards),
    ]
    if effects:
        lines.append(f"- May explain: {', '.join(f'`{effect}`' for effect in effects)}")
    if rule.untimed:
        lines.append("- Also judged on logs without times.")
    if rule.by_remote:
        lines.append("- In a log that does not mark remote frames it says what it assumes.")
    return "\n".join(lines) + "\n"


DEVICES_HEADER = """# Devices

Made from the devices' files by `python -m docs.generate`; a test keeps it true. `syncline devices NAME` prints the same. What is told of
a device that is not listed here comes from its EDS or DCF and from the CiA profile that its 1000h names (406 encoders, 410 inclinometers).

Which device a node is, is known from the bus description or `--device`, else from what it answered to 1000h, 1008h and 1018h while the
recorder listened ([bus description](../bus-description.md)); Syncline never asks. The reason stands beside each node. Where nothing was asked, PDOs that look like the factory
settings of a device are a hint only. A device that was named and does what it cannot do is the finding `device.wrong_device`.
"""
OWN_DEVICE = """## A device of one's own

Two files in a folder that the environment variable `SYNCLINE_DEVICES` names (several folders as in `PATH`): `NAME.eds` (or `.dcf`, `.xdd`)
and `NAME.toml` with what an EDS has no field for. An EDS alone is a device too. No Python is needed:
[generic-406.toml](../../samples/own_devices/generic-406.toml) and [its EDS](../../samples/own_devices/generic-406.eds) are a whole encoder.
A device of one's own is recognised before the built-in ones, and hides a built-in one of the same name. A capture carries the files of
every device that was named or recognised while it was recorded, so that it tells the same on a machine that lacks the folder.

```sh
SYNCLINE_DEVICES=samples/own_devices syncline devices generic-406
syncline devices --check samples/own_devices/generic-406.toml    # what is wrong and what to write: ../device-check.md
```

Objects are written as `"6004"` or `"1018:2"`. The tables and keys of the TOML file, of which any may be missing:
"""


OVERRIDES = """The numbers `cpr`, `turns`, `range`, `res`, `quad` and `angle_def` state what the device did not tell: where an SDO answer or an
acknowledged write tells another number, that one is used, and `device.override_contradicted` names both. `cpr`, `turns` and `range` are whole
numbers from 1 on, speeds are above 0; anything else is a mistake of the file. All other settings say how what the bus tells is to be read
(`scaling`, `direction`, `i16_unsigned`, `temp_scale`), and hold against it.
"""
DESCRIPTION_HEADER = """# Bus description

Made by `python -m docs.generate`, its tables from the code; a test reads every example. A TOML file says once what is on the buses of a
machine: `syncline record --description line3.toml` keeps it in the capture with all device files that it names, `syncline analyze
--description line3.toml` uses it afterwards. What the bus itself says (an SDO answer, an acknowledged write) always counts more; what rests
on a description or an EDS alone is told as such. All mistakes of a file are told at once, each with its place.

```toml
[bus.can0]                  # the name of the bus in the recording; "can0" where a log names none
bitrate = 500000

[bus.can0.node.5]
name = "main shaft"
device = "lir-da158a"       # of `syncline devices`, or a file: device = "parts/widget.eds"

[bus.can0.node.5.objects]   # hold unless the bus says otherwise; hexadecimal digits, sub-index after a colon
"6001" = 131072
"1800:2" = 254
"1800:1" = 0x185            # a TPDO under another identifier

[bus.can0.node.5.overrides] # by the names in the tables below
max_rpm = 1500
direction = "ccw"

[bus.can0.node.6]
device = "haomiao-38"
same_shaft_as = 5           # redundant encoders are compared
ratio = -2.5                # it makes 2.5 turns for one of node 5, the other way round
tolerance_deg = 3.0

[bus.can0.node.6.overrides]
scaling = "off"
cpr = 8192

[bus.can1]
bitrate = 500000
data_bitrate = 2000000      # CAN FD

[node.10]                   # on any bus that has no node 10 of its own
name = "boom"
device = "jn2100"

[node.10.overrides]
res = 100                   # 6000h was not recorded: 0.1 deg
perp_formula = "atan"       # the manual has two formulas
```

An encoder or inclinometer of which nothing is known but its EDS:

```toml
[node.7]
name = "winch"

[node.7.objects]
"1000" = 0x00020196         # CiA 406, multi-turn
"6001" = 4096
"6002" = 0x1000000
"1A00:0" = 1
"1A00:1" = 0x60040020
"1800:1" = 0x187
```

A description of one node without a file is `--device 10=jn2100` (or `10=widget.eds`) on the command line.
"""


def description_page() -> str:
    """Keys of the bus description, and the settings of every device."""
    parts = [
        DESCRIPTION_HEADER,
        "## Keys\n",
        *_markdown(_keys("[bus.NAME]", BUS_KEYS)),
        *_markdown(_keys("[bus.NAME.node.N], [node.N]", NODE_KEYS)),
        "A node id is a number from 1 to 127, also `0x0A`.\n",
        "## Overrides\n",
        "Settings go into `overrides` of a node whose device is known. `auto` leaves the choice to what was seen on the bus.\n",
        OVERRIDES,
    ]
    devices = [load_device(name, ()) for name in device_names(())]
    for device in devices:
        settings = [part for part in sections(device) if part.title == "Settings per node"]
        parts += [f"### {device.name}: {device.title}\n"]
        parts += [line for part in settings for line in _markdown(replace(part, title=""))]
    for number, profile in sorted(standard_profiles().items()):
        parts += [f"### any other {profile.title}, by its EDS (1000h = ....{number:04X}h)\n"]
        rows = tuple(
            (each.name, str(each.default), each.meaning) for each in profile.overrides.values()
        )
        parts += _markdown(Section("", ("setting", "default", "meaning"), rows))
    parts += ["## Where the manuals contradict themselves\n", CONTRADICTIONS]
    open_places = tuple(
        (device.name, each.manual, each.reading, f"`{each.override}`" if each.override else "-")
        for device in devices
        for each in device.contradictions
    )
    parts += _markdown(Section("", ("device", "the manual", "read as", "override"), open_places))
    return "\n".join(parts)


CONTRADICTIONS = """The devices' manuals contradict themselves in places, or leave open what a byte means. This is how Syncline reads them, and the override
that reads them another way.
"""


def _keys(head: str, keys: Mapping[str, str]) -> Section:
    return Section(
        "", (f"key of `{head}`", "meaning"), tuple((f"`{k}`", v) for k, v in keys.items())
    )


def devices_page() -> str:
    """All devices, and how to add one."""
    rows = []
    for name in device_names(()):
        device = load_device(name, ())
        rows.append((f"[{name}]({name}.md)", device.title, device.vendor, device.kind))
    listed = Section("", ("name", "device", "vendor", "kind"), tuple(rows))
    keys = tuple(
        ("head of the file" if table == "head" else f"`[{table}]`", f"`{'`, `'.join(names)}`")
        for table, names in known_keys().items()
    )
    quirks = tuple((f"`{name}`", words) for name, words in HANDLED.items())
    return "\n".join(
        [
            DEVICES_HEADER,
            *_markdown(listed),
            OWN_DEVICE,
            *_markdown(Section("", ("table", "keys"), keys)),
            "What Syncline makes of the quirks:\n",
            *_markdown(Section("", ("key of `[quirks]`", "what Syncline makes of it"), quirks)),
        ]
    )


def device_page(device: Device) -> str:
    """Everything that is known of one device."""
    factory = (
        f"Factory settings: node {device.default_node}, {device.default_bitrate} bit/s.\n"
        if device.default_node is not None
        else ""
    )
    return "\n".join(
        [
            f"# {device.name}: {device.title}\n",
            f"{device.vendor}, {device.kind}. Made from its files by `python -m docs.generate`; a test keeps it true.\n",
            factory,
            *(f"- {note}" for note in device.notes),
            "",
            *(line for section in sections(device) for line in _markdown(section)),
            *_markdown(objects(device)),
        ]
    )


def _markdown(section: Section) -> Iterator[str]:
    """A table with its title, if it has one."""
    if section.title:
        yield f"## {section.title}\n"
    yield _line(section.heads)
    yield _line(["---"] * len(section.heads))
    yield from (_line([cell.replace("|", "\\|") for cell in row]) for row in section.rows)
    yield ""


def _line(cells: "tuple[str, ...] | list[str]") -> str:
    return f"| {' | '.join(cells)} |"


FORMATS_HEADER = """# Formats

Made from the registries of readers and writers by `python -m docs.generate`; tests keep it true. The format of a file is found from its
content, whatever its name; each may be packed as `.gz` or `.zst`. Several files are one session, in any order: segments of a recording
join, what lies between files is a gap, files that overlap in time are different buses. What a file cannot tell is kept as a fact of the
capture: `syncline info` shows it; coarse stamps, missing times and unread lines limit what findings are made.
Where a clock was wrong, or a log has no date, `--offset` puts its frames in their place among those of other files. Damaged files are read
as far as they can be, and what was lost is told; bombs, endless chains and sizes beyond measure are refused with one line that says why.

```sh
syncline info customer/*                    # what each file is, whether it is whole, what could not be read
syncline analyze a.log.gz b.pcapng c.blf    # one session
syncline analyze a.mcap b.trc --offset b.trc=+3600                      # b's clock was an hour slow
syncline analyze a.mcap c.csv --offset c.csv=2026-03-01T12:00:00Z       # c has no date: when its first frame was recorded
syncline convert customer.trc customer.mcap
```
"""
WRITE_HEADER = """## What is written

`syncline convert IN... OUT`: the ending of OUT chooses. What the format cannot hold of what the inputs have is counted and told, and
`ConvertResult.lost` in Python has it; nothing is dropped silently.
"""
_EVERY_FORMAT = """
Every format holds: stamps to the nanosecond (text formats write microseconds where all stamps are whole ones), identifiers, extended
identifiers, remote frames with their length, direction, CAN FD with its flags, and that there was an error frame.
"""
PYTHON_CAN = """
## In python-can

Where Syncline is installed, the base install too, python-can's own tools and functions know `.mcap`:

```sh
can_logger -i socketcan -c can0 -f x.mcap   # also can_logconvert x.blf x.mcap
can_player -i virtual -c 0 x.mcap           # what `syncline record` wrote, too
```

`can.Logger("x.mcap")` writes each channel as a bus of its own, error and remote frames, CAN FD and direction as they come, and the stamps to
the last digit of python-can's seconds; a chunk is synced to disk every second, so a killed logger loses at most that. `can.LogReader("x.mcap")`
reads whole, cut and damaged captures and logs what is lost as warnings. Not possible: appending (`-a` is refused: give another file, two files
analyze as one session) and python-can's splitting by size (`-s`). What python-can does not pass on is not in the file: bit rate, the kind of
adapter, lost frames, kernel stamps; `syncline record` keeps those. ROS 2 bags are read, too.
"""
CHECK_HEADER = """# What the check of an EDS says

Made from the kinds of faults by `python -m docs.generate`; tests keep it true. EDS and DCF (CiA 306), XDD and XDC (CiA 311) are read by one
reader that repairs what it can; the check says what it repaired, what else contradicts the standard, where, and what to write instead.

```sh
syncline devices --check drive.eds                               # exit code 0 when it can be used, 2 when nothing in it can
syncline devices --check *.eds *.xdd --fail-on error             # for scripts: 1 when there is an error
syncline devices --check drive.dcf --format json                 # {schema, files: [{path, usable, counts, faults: [...]}]}
```

An **error** leads a tool that believes the file wrong; a **warning** contradicts the standard, and some tool stumbles over it; a **note** is
unusual or worth a look. In JSON each fault has `kind`, `severity`, `where`, `line` (null where it is not known), `text`, `write` and `reading`.
"""


def formats_page() -> str:
    """What is read and written, and what each format cannot hold."""
    reads = Section(
        "What is read",
        ("format", "usual endings", "which", "cannot tell", "how that shows"),
        tuple(
            (each.name, " ".join(each.endings), each.what, _listed(each.cannot), _listed(each.told))
            for each in READ_FORMATS
        ),
    )
    writes = Section(
        "",
        ("format", "endings", "also packed", "cannot hold"),
        tuple(
            (
                each.name,
                " ".join(each.endings),
                " ".join(PACKINGS) if each.packed_outside else "packed inside",
                _listed(each.cannot),
            )
            for each in WRITE_FORMATS
        ),
    )
    lines = [FORMATS_HEADER, *_markdown(reads), WRITE_HEADER, *_markdown(writes)]
    return "\n".join(lines).rstrip() + "\n" + _EVERY_FORMAT + PYTHON_CAN


def device_check_page() -> str:
    """Every kind of fault of a device description, the worst first."""
    rows = [
        (severity, name, kind.write, kind.reading or "takes it as it stands")
        for severity in SEVERITIES
        for name, kind in KINDS.items()
        if kind.severity == severity
    ]
    table = Section("", ("severity", "kind", "what to write", "what Syncline does"), tuple(rows))
    return "\n".join([CHECK_HEADER, *_markdown(table)]).rstrip() + "\n"


def _listed(words: "tuple[str, ...]") -> str:
    return "; ".join(words) or "-"


def pages() -> Mapping[str, str]:
    """Every made page by its place in the folder."""
    own = {f"devices/{name}.md": device_page(load_device(name, ())) for name in device_names(())}
    return {
        "commands.md": commands_page(),
        "findings.md": findings_page(),
        "bus-description.md": description_page(),
        "formats.md": formats_page(),
        "device-check.md": device_check_page(),
        "devices/README.md": devices_page(),
        **own,
    }


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    for name, page in pages().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(page, encoding="utf-8", newline="\n")
