"""Tables of the fleet's report: devices and firmware, how good the recordings are, what failed."""

from collections.abc import Iterator, Sequence
from pathlib import PurePosixPath

from syncline_analyzer.fleet.overview import NO_CAPTURE, Device, Machine, Overview
from syncline_analyzer.views.fleet_links import many
from syncline_analyzer.views.html import Html, element
from syncline_analyzer.views.report_tables import limited
from syncline_analyzer.views.words import duration, hex_code, number

_NAMED = 6
"""Machines that are named where not all have a thing."""


def devices_part(found: Overview) -> Iterator[Html]:
    """What the nodes are by what they answered, each version with its machines."""
    if not found.devices:
        told = "No capture tells what its nodes are: nobody asked for 1008h to 100Ah or 1018h."
        yield element("p", told)
        return
    fleet = len(found.machines)
    rows: list[Sequence[object]] = [
        (
            device.device or device.told or "not known",
            device.told or "-",
            device.hardware or "-",
            device.software or "-",
            hex_code(device.revision, 8),
            f"{hex_code(device.vendor, 8)} / {hex_code(device.product, 8)}",
            f"{device.nodes:,}",
            element("div", _whose(device, fleet), class_="wrap"),
        )
        for device in found.devices
    ]
    heads = ["Device", "Name (1008h)", "Hardware (1009h)", "Software (100Ah)", "Revision (1018h:03)", "Vendor / product", ">Nodes", "Machines"]  # fmt: skip
    yield element("p", _mixed(found.devices), class_="dim")
    yield from limited("Devices by version, as they were last", heads, rows)


def _whose(device: Device, fleet: int) -> str:
    """How many machines have it; a few are named."""
    count = len(device.machines)
    if count == fleet:
        return "all" if count > 1 else device.machines[0]
    if count <= _NAMED:
        return ", ".join(device.machines)
    return f"{count} of {fleet}: {', '.join(device.machines[:_NAMED])} ..."


def _mixed(devices: Sequence[Device]) -> str:
    """Which devices are there in several versions."""
    versions: dict[str, int] = {}
    for each in devices:
        if each.device:
            versions[each.device] = versions.get(each.device, 0) + 1
    mixed = [f"{name} ({count})" for name, count in versions.items() if count > 1]
    if not mixed:
        return "Each device is there in one version, as far as somebody asked."
    return f"In several versions: {', '.join(mixed)}."


def recording_part(found: Overview) -> Iterator[Html]:
    """How much was recorded and how well; machines whose recordings are not whole."""
    captures = list(found.captures)
    frames = sum(each.frames for each in captures)
    recorded_ns = sum(each.duration_ns for each in captures)
    blind_ns = sum(each.blind_ns for each in captures)
    undated = sum(each.begun_ns is None for each in captures)
    facts = {
        "Recorded": f"{frames:,} frames in {duration(recorded_ns)}",
        "Blind": _share(blind_ns, recorded_ns) if blind_ns else "never",
        "Frames lost": _at_least(sum(machine.lost_frames for machine in found.machines)),
        "Damaged": many(sum(each.damages > 0 for each in captures), "capture"),
    }
    if undated:
        facts["Without a date"] = many(undated, "capture")
    terms = [(element("dt", name), element("dd", told)) for name, told in facts.items()]
    yield element("dl", *(part for pair in terms for part in pair), class_="facts")
    flawed = [machine for machine in found.machines if _is_flawed(machine)]
    flawed.sort(key=lambda each: -sum(capture.blind_ns for capture in each.captures))
    heads = ["Machine", ">Captures", ">Blind", ">Frames lost", ">Captures damaged", ">Error frames", ">Lines not read"]  # fmt: skip
    yield from limited("Machines whose recordings are not whole", heads, [*map(_flaws, flawed)])


def _is_flawed(machine: Machine) -> bool:
    return any(
        each.blind_ns or each.error_frames or each.unparsed_lines or each.damages
        for each in machine.captures
    )


def _flaws(machine: Machine) -> Sequence[object]:
    of = machine.captures
    blind_ns, recorded_ns = (
        sum(each.blind_ns for each in of),
        sum(each.duration_ns for each in of),
    )
    return (
        machine.name,
        f"{len(of):,}",
        _share(blind_ns, recorded_ns) if blind_ns else "-",
        _at_least(machine.lost_frames) if machine.lost_frames else "-",
        sum(each.damages > 0 for each in of) or "-",
        sum(each.error_frames for each in of) or "-",
        sum(each.unparsed_lines for each in of) or "-",
    )


def _share(part_ns: int, whole_ns: int) -> str:
    share = f" ({number(100 * part_ns / whole_ns, digits=2)} %)" if whole_ns else ""
    return f"{duration(part_ns)}{share}"


def _at_least(count: int) -> str:
    return f"at least {count:,}" if count else "none known"


def failures_part(found: Overview) -> Iterator[Html]:
    """What could not be analyzed, and why."""
    failed = [each for each in found.failures if each.kind != NO_CAPTURE]
    others = len(found.failures) - len(failed)
    if not failed:
        yield element("p", "All recordings were analyzed.")
    rows: list[Sequence[object]] = [
        (
            PurePosixPath(each.files[0].url).name if each.files else each.key,
            each.machine,
            element("div", _reason(each.reason), class_="wrap"),
            element("div", each.files[0].url if each.files else "-", class_="wrap"),
        )
        for each in failed
    ]
    heads = ["Recording", "Machine", "Reason", "Where"]
    yield from limited("Recordings that could not be analyzed", heads, rows)
    if others:
        told = f"{many(others, 'more file')} with an ending of captures that are none."
        yield element("p", told, class_="dim")


def _reason(text: str) -> str:
    return text if len(text) <= _MAX_REASON else f"{text[:_MAX_REASON]}…"


_MAX_REASON = 300
