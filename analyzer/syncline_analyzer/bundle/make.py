"""Making a bundle: cut and redact first, then analyze what is left."""

import platform
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from syncline_analyzer.bundle.archive import CAPTURE, Member, safe_name, sha256_of, write_bundle
from syncline_analyzer.bundle.capture_file import Stretch, Written, write_capture
from syncline_analyzer.bundle.place import around as stretch_around
from syncline_analyzer.bundle.place import between, finding_at
from syncline_analyzer.bundle.readme import readme
from syncline_analyzer.bundle.settings import settings_at
from syncline_analyzer.capture import CaptureFacts, CaptureReader
from syncline_analyzer.merge import Merge
from syncline_analyzer.offsets import shifted
from syncline_analyzer.readers import open_capture
from syncline_analyzer.redaction import Redaction
from syncline_analyzer.results import Analysis
from syncline_analyzer.segments import in_segment_order
from syncline_analyzer.session import Session, open_session
from syncline_schemas.capture.layout import Attachment, description_attachment, device_attachment
from syncline_schemas.capture.learned import learned_record
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import is_path, load_device
from syncline_schemas.errors import CaptureError, DescriptionError, UsageError
from syncline_schemas.records import dataclass
from syncline_schemas.wording import counted

LIBRARIES = ("numpy", "mcap", "protobuf", "canopen", "python-can", "pandas", "zstandard")
"""Whose versions the manifest states."""

Progress = Callable[[int], None]


@dataclass(frozen=True, slots=True)
class BundleResult:
    """What went into a bundle: frames, what was left out of the capture, and its members' names."""

    output: Path
    written: Written
    members: list[str]
    notes: list[str]


@dataclass(frozen=True, slots=True)
class Case:
    """What the user wants in the bundle; see `make_bundle`."""

    paths: Sequence[Path]
    description: BusDescription | None = None
    devices: Mapping[int, str] | None = None
    bitrate: int | None = None
    data_bitrate: int | None = None
    around: str | None = None
    start: str | None = None
    end: str | None = None
    redact: Sequence[str] = ()
    offsets: Mapping[str, str] = field(default_factory=dict)

    def session(self) -> Session:
        """The captures with all that the user says of them."""
        return open_session(
            list(self.paths),
            description=self.description,
            devices=self.devices,
            bitrate=self.bitrate,
            data_bitrate=self.data_bitrate,
            offsets=self.offsets,
        )

    def readers(self) -> list[CaptureReader]:
        """The captures, opened anew."""
        readers = in_segment_order([open_capture(path) for path in self.paths])
        return shifted(readers, self.offsets)


def make_bundle(case: Case, output: Path, progress: Progress | None = None) -> BundleResult:
    """Write captures, or a part of them, with all that explains them as one zip file.

    The report and the analysis in it are made from the capture in it: what was redacted is in none
    of them. The file appears when it is complete.

    Raises:
        CaptureError: a capture cannot be read, or the bundle cannot be written.
        DescriptionError: the description or a device is unusable.
        UsageError: an option makes no sense, or the output is one of the inputs.
    """
    if case.around and (case.start or case.end):
        raise UsageError("--around and --from/--to both say what to keep: give one of them")
    if any(path.resolve() == output.resolve() for path in case.paths):
        raise UsageError(f"{output}: is one of the captures; choose another name")
    with tempfile.TemporaryDirectory(prefix="syncline-", ignore_cleanup_errors=True) as folder:
        return _made(case, output, Path(folder), progress)


def _made(case: Case, output: Path, folder: Path, progress: Progress | None) -> BundleResult:
    original = case.session()
    redaction = Redaction.parse(case.redact)
    if redaction.nodes:
        redaction = redaction.resolved(_moved(original.analyze(progress)))
    stretch = _stretch(case, original, progress)
    facts = [reader.facts for reader in case.readers()]
    description, files, notes = _description(case, facts, original, redaction, progress)
    attachments = [device_attachment(name, data) for name, data in files.items()]
    if description:
        attachments.append(description_attachment(description))
    source, learned = original, _learned_before(facts)
    if redaction:
        whole = folder / "whole.mcap"
        _capture(case, case.readers(), whole, Stretch(), redaction, attachments, {}, progress)
        source, learned = open_session(whole), {}
    readers = case.readers()
    if not stretch.whole:
        buses = source.analyze(progress).capture.buses
        assert stretch.start_ns is not None or stretch.end_ns is not None
        if stretch.start_ns is not None:
            learned = {**learned, **settings_at(source.analysis, stretch.start_ns, buses)}
    capture = folder / CAPTURE
    written = _capture(case, readers, capture, stretch, redaction, attachments, learned, progress)
    if not written.frames:
        raise UsageError("no frame lies in the part that was asked for")
    notes += _damage(readers)
    analysis = open_session(capture).analyze(progress)
    analysis = replace(analysis, capture=replace(analysis.capture, files=[CAPTURE]))
    told = _facts(case, stretch, redaction, written, notes)
    members = _members(analysis, told, capture, description, files)
    _write(output, members, told)
    return BundleResult(output, written, [member.name for member in members], notes)


def _damage(readers: Sequence[CaptureReader]) -> list[str]:
    """What could not be read of the captures given, without a word of what stood there."""
    notes = []
    for facts in (reader.facts for reader in readers):
        if facts.damage:
            notes.append(f"{facts.path.name} is damaged and was read in part")
        if facts.unparsed_count:
            lines = counted(facts.unparsed_count, "line")
            notes.append(f"{facts.path.name}: {lines} could not be read")
    return notes


def _capture(
    case: Case,
    readers: Sequence[CaptureReader],
    path: Path,
    stretch: Stretch,
    redaction: Redaction,
    attachments: Sequence[Attachment],
    learned: Mapping[str, str],
    progress: Progress | None,
) -> Written:
    facts = [reader.facts for reader in readers]

    def rates(bus: str) -> tuple[int | None, int | None]:
        bitrate = next((each.bitrates[bus] for each in facts if bus in each.bitrates), case.bitrate)
        known = (each.data_bitrates[bus] for each in facts if bus in each.data_bitrates)
        return bitrate, next(known, case.data_bitrate)

    with path.open("wb") as stream:
        return write_capture(
            stream,
            readers,
            stretch,
            redaction,
            rates=rates,
            attachments=attachments,
            learned=learned,
            progress=progress,
        )


def _stretch(case: Case, original: Session, progress: Progress | None) -> Stretch:
    if case.around:
        return stretch_around(finding_at(original.analyze(progress), case.around))
    if not (case.start or case.end):
        return Stretch()
    return between(case.start, case.end, Merge(case.readers()).first_ns or 0)


def _moved(analysis: Analysis) -> dict[int, set[int]]:
    """Further identifiers of nodes: PDOs, and services that were moved."""
    found: dict[int, set[int]] = {}
    for pdo in analysis.pdos:
        if pdo.node is not None:
            found.setdefault(pdo.node, set()).add(pdo.cob_id)
    for share in analysis.bus_shares:
        if share.node is not None and share.cob_id is not None:
            found.setdefault(share.node, set()).add(share.cob_id)
    for row in analysis.objects:
        if isinstance(row.value, int) and (row.index == 0x1014 or 0x1200 <= row.index < 0x1280):
            found.setdefault(row.node, set()).add(row.value & 0x1FFFFFFF)
    for transfer in analysis.sdo:
        if transfer.client_cob_id is not None:
            found.setdefault(transfer.node, set()).add(transfer.client_cob_id)
    # Only what was seen: the number of an identifier that nobody sends is a payload. And NMT, SYNC
    # and TIME are nobody's own.
    seen = {row.cob_id for row in analysis.bus_shares} - {0x000, 0x080, 0x100}
    return {node: {can_id for can_id in ids if can_id in seen} for node, ids in found.items()}


def _learned_before(facts: Sequence[CaptureFacts]) -> dict[str, str]:
    """What segments before the first file had revealed, where all files are of one recording."""
    recordings = {each.metadata.get("recording_id") for each in facts}
    return learned_record(facts[0].learned) if len(recordings) == 1 else {}


def _description(
    case: Case,
    facts: Sequence[CaptureFacts],
    original: Session,
    redaction: Redaction,
    progress: Progress | None,
) -> tuple[str, dict[str, bytes], list[str]]:
    """The bus description with what the options add, and the files of all devices in it."""
    description, notes = case.description, []
    files = {name: data for each in facts for name, data in each.eds_files.items()}
    if description is None:
        toml = next((each.description_toml for each in facts if each.description_toml), "")
        description = BusDescription.loads(toml, files=files)
    files |= description.files
    text = description.text
    for node, name in (case.devices or {}).items():
        device = load_device(name)
        shown = Path(name).name if is_path(name) else name
        if any(number == node for _, number in description.nodes):
            notes.append(f"--device {node}={shown} could not be put into the description")
            continue
        files |= device.files
        text += f'\n[node.{node}]\ndevice = "{shown}"\n'
    for name in _recognised(original, redaction, progress):
        files |= load_device(name).files
    return text, files, notes


def _recognised(session: Session, redaction: Redaction, progress: Progress | None) -> list[str]:
    """Names of the devices that were recognised; not looked at where payloads are to go."""
    if redaction:
        return []
    found = []
    for row in session.analyze(progress).nodes:
        try:
            found += [row.device] if row.device and load_device(row.device).files else []
        except DescriptionError:
            continue
    return sorted(set(found))


def _facts(
    case: Case, stretch: Stretch, redaction: Redaction, written: Written, notes: list[str]
) -> dict[str, Any]:
    cut = {
        "around": case.around,
        "from_ns": stretch.start_ns,
        "to_ns": stretch.end_ns,
        "frames_before": written.before,
        "frames": written.frames,
        "frames_after": written.after,
    }
    redacted = {
        "identifiers": redaction.text,
        "frames": written.redacted,
        "bytes": written.redacted_bytes,
    }
    return {
        "versions": {
            "syncline": version("syncline"),
            "python": platform.python_version(),
            **_libraries(),
        },
        "inputs": [_input(path) for path in case.paths],
        "cut": None if stretch.whole else cut,
        "redacted": redacted if redaction else None,
        "options": {"bitrate": case.bitrate, "data_bitrate": case.data_bitrate},
        "notes": notes,
    }


def _input(path: Path) -> dict[str, Any]:
    return {"name": path.name, "bytes": path.stat().st_size, "sha256": sha256_of(path)}


def _libraries() -> dict[str, str]:
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _members(
    analysis: Analysis,
    facts: Mapping[str, Any],
    capture: Path,
    description: str,
    files: Mapping[str, bytes],
) -> list[Member]:
    from syncline_analyzer.views.json_view import to_json
    from syncline_analyzer.views.report_html import report

    members = [
        Member("report.html", report(analysis).encode(), "what happened; opens in any browser"),
        Member("analysis.json", to_json(analysis).encode(), "the same for programs"),
        Member(CAPTURE, capture, "every frame, with its time"),
    ]
    if description:
        what = "which devices are on which bus"
        members.append(Member("bus-description.toml", description.encode(), what))
    taken: set[str] = set()
    for name, data in sorted(files.items()):
        own = safe_name(name)
        while own.lower() in taken:
            own = f"_{own}"
        taken.add(own.lower())
        members.append(Member(f"devices/{own}", data, "description of a device"))
    listed = [(member.name, member.what) for member in members]
    listed.append(("manifest.json", "SHA-256 of every file, versions, what was cut and redacted"))
    return [Member("README.txt", readme(analysis, facts, listed), "this list"), *members]


def _write(output: Path, members: Sequence[Member], facts: Mapping[str, Any]) -> None:
    partial = output.with_name(output.name + ".part")
    try:
        with partial.open("wb") as stream:
            write_bundle(stream, members, facts)
        partial.replace(output)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise CaptureError(f"{output}: cannot be written: {error.strerror or error}") from error
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
