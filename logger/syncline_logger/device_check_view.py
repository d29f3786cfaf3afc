"""The outcome of `syncline devices --check` as text and as JSON."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from syncline_schemas.devices.check import Fault, FileCheck
from syncline_schemas.devices.check.kinds import SEVERITIES

SCHEMA = "syncline.device-check/1"
SHOWN_PER_KIND = 5
"""Of faults of one kind in one file; JSON has all of them."""


def fault_lines(result: FileCheck, shown: int | None = SHOWN_PER_KIND) -> Iterator[str]:
    """Each fault with its advice, told once; of one kind no more than `shown`, then how many."""
    told: Counter[str] = Counter()
    advised: set[str] = set()
    for fault in result.faults:
        told[fault.kind] += 1
        if shown is not None and told[fault.kind] > shown:
            continue
        yield f"{_place(result, fault)}: {fault.severity}: {fault}"
        if fault.write not in advised:
            yield f"    instead: {fault.write}"
            if fault.reading and fault.reading not in fault.text:
                yield f"    Syncline: {fault.reading}"
        advised.add(fault.write)
    for kind, count in told.items():
        if shown is not None and count > shown:
            yield f"{result.file}: {count - shown} more of kind {kind} (--all shows them)"


def _place(result: FileCheck, fault: Fault) -> str:
    return f"{result.file}:{fault.line}" if fault.line else result.file


def verdict(result: FileCheck) -> str:
    """One line about a file that can be used."""
    counts = {severity: result.count(severity) for severity in SEVERITIES}
    said = ", ".join(
        f"{count} {severity}{'s' if count > 1 else ''}"
        for severity, count in counts.items()
        if count
    )
    found = f"{said}, listed above" if said else "no faults"
    return f"{result.path}: can be used: {result.title}, {result.variables} objects; {found}"


def check_json(results: Sequence[FileCheck]) -> str:
    """All outcomes as one JSON object."""
    return json.dumps({"schema": SCHEMA, "files": [_file(each) for each in results]}, indent=2)


def _file(result: FileCheck) -> dict[str, Any]:
    return {
        "path": str(result.path),
        "file": result.file,
        "usable": result.usable,
        "problem": result.problem,
        "title": result.title,
        "objects": result.variables,
        "counts": {severity: result.count(severity) for severity in SEVERITIES},
        "faults": [asdict(fault) for fault in result.faults],
    }
