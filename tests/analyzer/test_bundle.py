"""Evidence bundles: whole, the same each time, without what was redacted, read with care."""

import hashlib
import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader

from syncline_analyzer import open_session
from syncline_analyzer.bundle.archive import (
    CAPTURE,
    MANIFEST,
    Member,
    check_bundle,
    safe_name,
    unpack_capture,
    write_bundle,
)
from syncline_analyzer.bundle.make import Case, make_bundle
from syncline_analyzer.bundle_command import bundle
from syncline_analyzer.comparison import compare
from syncline_analyzer.convert import convert
from syncline_analyzer.info import inspect
from syncline_analyzer.readers import open_capture
from syncline_analyzer.redaction import Redaction
from syncline_analyzer.writers.formats import RECORDER_MARKS, REDACTED
from syncline_samples.faults import Emcy, MissedPdos, PowerLoss
from syncline_samples.machine import Scenario
from syncline_samples.scenarios import GUIDE, LIFT, PLATFORM
from syncline_schemas.batch import FrameBatch
from syncline_schemas.capture.layout import (
    LEARNED_METADATA_NAME,
    MARK_TOPIC,
    BusInfo,
    CaptureMetadata,
    description_attachment,
    eds_attachment,
)
from syncline_schemas.capture.learned import learned_record
from syncline_schemas.capture.mark import Mark, mark_message
from syncline_schemas.capture.message import MessageBlock, schema_of
from syncline_schemas.capture.writer import CaptureWriter
from syncline_schemas.errors import CaptureError, UsageError
from syncline_schemas.proto import syncline_pb2
from tests.analyzer.comparison_runs import golden, machine, with_faults

SECRET = b"Z7kQ"
"""What is redacted: as bytes, as text, as hexadecimal digits and as numbers it must not be there."""
_WHOLE = (int.from_bytes(SECRET, "little"), int.from_bytes(SECRET, "big"))
NUMBERS = (*_WHOLE, *(number & 0x1FFFFFFF for number in _WHOLE))


def capture_of(
    path: Path,
    scenario: Scenario,
    *extra: tuple[int, int, bytes],
    learned: dict[tuple[int, int], Any] | None = None,
    eds_name: str = "",
) -> Path:
    """A capture of a scenario with frames (ms, identifier, data) put in."""
    run = scenario.run()
    frames = FrameBatch.concat([item for item in run.batches if isinstance(item, FrameBatch)])
    rows = [
        (scenario.epoch_ns + ms * 1_000_000, 0, can_id, 0, len(data), data)
        for ms, can_id, data in extra
    ]
    frames = FrameBatch.concat([frames, FrameBatch.from_rows(rows)])
    frames = frames[np.argsort(frames.t_ns, kind="stable")]
    files = [description_attachment(scenario.description_toml)]
    if eds_name:
        files.append(eds_attachment(eds_name, b"[DeviceInfo]\nVendorName=x\n"))
    metadata = CaptureMetadata("1", "abc", host="plant-7", created_ns=scenario.epoch_ns)
    with path.open("wb") as stream:
        writer = CaptureWriter(
            stream, metadata, [BusInfo("can0", 0, scenario.bitrate)], attachments=files
        )
        if learned:
            writer.add_metadata(LEARNED_METADATA_NAME, learned_record(learned))
        writer.write_frames(frames)
        writer.finish()
    return path


def marked(path: Path, *marks: Mark) -> Path:
    """A small capture with marks."""
    with path.open("wb") as stream:
        metadata = CaptureMetadata("1", "abc", created_ns=START_NS)
        writer = CaptureWriter(stream, metadata, [BusInfo("can0", 0), BusInfo("can1", 1)])
        rows = [(START_NS + k * 10**9, k % 2, 0x181, 0, 1, b"\5") for k in range(10)]
        writer.write_frames(FrameBatch.from_rows(rows))
        channel = writer.add_channel(MARK_TOPIC, schema_of(syncline_pb2.Mark.DESCRIPTOR))
        for mark in marks:
            payload = mark_message(mark).SerializeToString()
            t_ns, length = np.array([mark.t_ns], np.int64), np.array([len(payload)], np.int64)
            block = MessageBlock(channel, t_ns, t_ns, length, np.frombuffer(payload, np.uint8))
            writer.write_chunk(FrameBatch.empty(), messages=[block])
        writer.finish()
    return path


def marks_of(path: Path) -> list[Mark]:
    """The marks of a capture or bundle."""
    reader = open_capture(path)
    for _ in reader.batches():
        pass
    return reader.facts.marks


START_NS = 1_700_000_000_000_000_000


def members(path: Path) -> dict[str, bytes]:
    """Every member of a bundle."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def every_byte(path: Path) -> bytes:
    """All that stands in a bundle: members, and messages, metadata and attachments of the capture."""
    parts = members(path)
    reader = make_reader(io.BytesIO(parts[CAPTURE]))
    inner = [message.data for _, _, message in reader.iter_messages()]
    inner += [repr(record).encode() for record in reader.iter_metadata()]
    inner += [record.data for record in reader.iter_attachments()]
    with zipfile.ZipFile(path) as archive:
        names = [f"{info.filename}{info.comment!r}".encode() for info in archive.infolist()]
    return b"\0".join([*parts.values(), *inner, *names])


def traces_of(secret: bytes, path: Path) -> list[str]:
    """The forms in which something stands in a bundle."""
    text = every_byte(path)
    spaced = secret.hex(" ").encode()
    forms = {
        "bytes": secret,
        "hexadecimal": secret.hex().encode(),
        "spaced": spaced,
        "reversed": secret[::-1],
        **{f"number {number}": str(number).encode() for number in NUMBERS},
        **{f"hexadecimal {number:X}": f"{number:X}".encode() for number in NUMBERS},
    }
    lower = text.lower()
    return [name for name, form in forms.items() if form in text or form.lower() in lower]


def bundled(tmp_path: Path, *paths: Path, name: str = "case.zip", **options: Any) -> Path:
    """A bundle of captures."""
    output = tmp_path / name
    make_bundle(Case(list(paths), **options), output)
    return output


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture in which a node is lost after half a minute."""
    folder = tmp_path_factory.mktemp("bad")
    faults = PowerLoss(LIFT, 30.0, 3.0), Emcy(GUIDE, 10.0, 0x7320, 0x21, alarms=1, for_s=2.0)
    return capture_of(folder / "line 3.mcap", with_faults(*faults, MissedPdos(GUIDE, 20.0)))


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The golden run as a capture."""
    return capture_of(tmp_path_factory.mktemp("healthy") / "healthy.mcap", machine())


def test_bundle_holds_all_that_explains_it(bad: Path, tmp_path: Path) -> None:
    path = bundled(tmp_path, bad)
    inside = members(path)
    assert {"README.txt", "report.html", "analysis.json", CAPTURE, MANIFEST} <= inside.keys()
    assert {"devices/jn2100.eds", "devices/jn2100.toml", "bus-description.toml"} <= inside.keys()
    manifest = json.loads(inside[MANIFEST])
    listed = {row["name"]: row for row in manifest["members"]}
    assert listed.keys() == inside.keys() - {MANIFEST}
    for name, row in listed.items():
        assert row["sha256"] == hashlib.sha256(inside[name]).hexdigest()
        assert row["bytes"] == len(inside[name])
    assert manifest["inputs"][0]["sha256"] == hashlib.sha256(bad.read_bytes()).hexdigest()
    assert {"syncline", "python", "numpy", "mcap"} <= manifest["versions"].keys()
    assert manifest["cut"] is manifest["redacted"] is None
    assert b"nothing was cut" in inside["README.txt"]
    assert check_bundle(path) == []
    # Where it was made is nobody's business.
    assert str(tmp_path).encode() not in every_byte(path)


def test_bundle_is_the_same_each_time(bad: Path, tmp_path: Path) -> None:
    paths = [bundled(tmp_path, bad, name=name, around="1") for name in ("a.zip", "b.zip")]
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_capture_within_is_the_one_given(bad: Path, tmp_path: Path) -> None:
    path = bundled(tmp_path, bad)
    ours, theirs = open_session(path), open_session(bad)
    assert ours.analysis.findings == theirs.analysis.findings
    assert ours.analysis.nodes == theirs.analysis.nodes
    assert ours.analysis.capture.files == [str(path)]
    told = json.loads(members(path)["analysis.json"])
    assert told["capture"]["files"] == [CAPTURE]
    assert len(told["findings"]) == len(theirs.analysis.findings)


def test_cut_around_a_finding_tells_the_same_of_it(bad: Path, tmp_path: Path) -> None:
    before = next(f for f in open_session(bad).analysis.findings if f.node == LIFT)
    path = bundled(tmp_path, bad, around=f"{before.id}@{LIFT}")
    manifest = json.loads(members(path)[MANIFEST])
    session = open_session(path)
    assert manifest["cut"]["frames"] == session.analysis.capture.frames
    whole = open_session(bad).analysis.capture.frames
    cut = manifest["cut"]
    assert cut["frames_before"] + cut["frames"] + cut["frames_after"] == whole
    assert [f.text for f in session.analysis.findings if f.id == before.id] == [before.text]


def test_cut_knows_the_settings_that_were_told_before_it(bad: Path, tmp_path: Path) -> None:
    path = bundled(tmp_path, bad, start="20s", end="40s")
    capture = open_session(path).analysis
    assert capture.capture.duration_ns <= 20 * 10**9
    known = {
        (row.node, row.index): row.value for row in capture.objects if row.source != "eds-default"
    }
    assert known[LIFT, 0x1017] == 500
    assert known[PLATFORM, 0x6000] == 100
    assert not [trace for trace in capture.traces if trace.assumed and trace.node == LIFT]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("99", "no such finding"),
        ("nmt.nothing", "nmt."),
        ("x y", "id@node"),
        ("nmt.node_lost@99", "There are"),
    ],
)
def test_finding_that_is_not_there(bad: Path, tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        bundled(tmp_path, bad, around=text)
    assert not list(tmp_path.iterdir())


def secret_capture(tmp_path: Path) -> Path:
    """The secret in PDOs, SDOs of every kind, EMCYs, a heartbeat, and what was learned before."""
    node = PLATFORM
    segmented = (
        (20_000, 0x600 + node, bytes.fromhex("4008100000000000")),
        (20_001, 0x580 + node, bytes.fromhex("4108100004000000")),
        (20_002, 0x600 + node, bytes.fromhex("6000000000000000")),
        (20_003, 0x580 + node, bytes([0x07]) + SECRET + bytes(3)),
    )
    extra = (
        *((5_000 + 100 * k, 0x180 + node, SECRET) for k in range(100)),
        (12_000, 0x600 + node, b"\x23\x14\x10\x00" + SECRET),
        (12_001, 0x580 + node, b"\x60\x14\x10\x00" + bytes(4)),
        (13_000, 0x600 + node, b"\x40\x18\x10\x01" + bytes(4)),
        (13_001, 0x580 + node, b"\x43\x18\x10\x01" + SECRET),
        *segmented,
        (25_000, 0x80 + node, b"\x20\x73\x01" + SECRET + b"\0"),
        (26_000, 0x700 + node, SECRET),
    )
    learned = {(0, node): {(0x2040, 0): (SECRET, True), (0x1018, 1): (SECRET, True)}}
    return capture_of(tmp_path / "secret.mcap", machine(), *extra, learned=learned)


def test_redacted_payload_is_nowhere(tmp_path: Path) -> None:
    source = secret_capture(tmp_path)
    # The search finds it where it is: raw, as text, as digits and as a number.
    assert {"bytes", "spaced"} <= set(traces_of(SECRET, bundled(tmp_path, source, name="all.zip")))
    path = bundled(tmp_path, source, redact=[f"node:{PLATFORM}"])
    assert traces_of(SECRET, path) == []
    manifest = json.loads(members(path)[MANIFEST])
    assert manifest["redacted"]["frames"] > 100
    cut = bundled(
        tmp_path, source, name="cut.zip", redact=[f"node:{PLATFORM}"], start="10s", end="30s"
    )
    assert traces_of(SECRET, cut) == []


@pytest.mark.parametrize("ids", ["18A", "58A,60A", "8A", "080-77F"])
def test_each_identifier_is_redacted_by_itself(tmp_path: Path, ids: str) -> None:
    source = secret_capture(tmp_path)
    chosen = Redaction.parse([ids])
    path = bundled(tmp_path, source, redact=[ids])
    original = FrameBatch.concat(list(open_session(source).frames()))
    written = FrameBatch.concat(list(open_session(path).frames()))
    rows = chosen.covers(original)
    assert rows.any()
    for column in ("t_ns", "can_id", "flags", "dlc"):
        assert (getattr(written, column) == getattr(original, column)).all()
    assert not written.data[rows].any()
    assert (written.data[~rows] == original.data[~rows]).all()
    left = [form for form in traces_of(SECRET, path) if form == "bytes"]
    assert bool(left) == (ids != "080-77F")


@pytest.mark.parametrize(
    "ids",
    [
        "181-57F",
        "581-67F",
        "701-77F",
        "081-0FF",
        f"node:{PLATFORM}",
        f"node:{GUIDE}",
        "0-7FF",
        "080",
    ],
)
def test_zeros_in_place_of_payloads_accuse_nobody(healthy: Path, tmp_path: Path, ids: str) -> None:
    path = bundled(tmp_path, healthy, redact=[ids])
    found = open_session(path).analysis
    assert [f.text for f in found.findings if f.severity != "info"] == []
    assert any("redacted" in note for note in found.capture.notes)
    assert found.capture.extended_frames == 0
    # Nor do they differ from the capture as it was.
    compared = compare(golden(), found)
    assert [row.text for row in compared.rows if row.severity != "info"] == []
    if ids == "181-57F":
        assert found.traces == []
        assert found.pdos


def test_moved_identifiers_of_a_node_are_redacted_too(tmp_path: Path) -> None:
    extra = (
        (12_000, 0x600 + LIFT, b"\x23\x14\x10\x00\xf1\x06\0\0"),
        (12_001, 0x580 + LIFT, b"\x60\x14\x10\x00" + bytes(4)),
        (25_000, 0x6F1, b"\x20\x73\x01" + SECRET + b"\0"),
    )
    source = capture_of(tmp_path / "moved.mcap", machine(), *extra)
    path = bundled(tmp_path, source, redact=[f"node:{LIFT}"])
    assert traces_of(SECRET, path) == []
    assert "6F1" in json.loads(members(path)[MANIFEST])["redacted"]["identifiers"]


@pytest.mark.parametrize("text", ["xyz", "node:0", "node:128", "200-100", "20000000", "", "18A-"])
def test_identifiers_that_are_none(text: str) -> None:
    with pytest.raises(UsageError, match="--redact"):
        Redaction.parse([text])


def test_error_frames_are_nobodys_message() -> None:
    batch = FrameBatch.from_rows([(0, 0, 0x18A, 4, 8, SECRET * 2), (1, 0, 0x18A, 0, 8, SECRET * 2)])
    done = Redaction.parse(["0-7FF"]).applied(batch)
    assert done.data.any(axis=1).tolist() == [True, False]


def test_names_from_a_capture_stay_names(tmp_path: Path) -> None:
    source = capture_of(tmp_path / "a.mcap", machine(), eds_name="../../etc/evil name.eds")
    names = members(bundled(tmp_path, source)).keys()
    assert "devices/evil_name.eds" in names
    assert not [name for name in names if ".." in name or name.startswith("/")]
    assert safe_name("C:\\boot\\..\\x.eds") == "x.eds"
    assert safe_name("...") == "file"


def test_output_is_no_input(bad: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="one of the captures"):
        make_bundle(Case([bad]), bad)
    with pytest.raises(UsageError, match="both say what to keep"):
        bundled(tmp_path, bad, around="1", start="3s")


def small(path: Path, *more: Member, capture: bytes = b"x", **manifest: Any) -> Path:
    """A bundle of a few bytes, its manifest changed."""
    parts = [Member("README.txt", b"hello", "text"), Member(CAPTURE, capture, "frames"), *more]
    with path.open("wb") as stream:
        write_bundle(stream, parts, {})
    if manifest:
        inside = members(path)
        listed = json.loads(inside.pop(MANIFEST)) | manifest
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in inside.items():
                archive.writestr(name, data)
            archive.writestr(MANIFEST, json.dumps(listed))
    return path


def test_check_names_what_was_changed(tmp_path: Path) -> None:
    path = small(tmp_path / "a.zip")
    assert check_bundle(path) == []
    inside = members(path)
    for changed, words in (
        ({**inside, "README.txt": b"hallo"}, "'README.txt' is not what was put in"),
        ({**inside, "README.txt": b"hello there"}, "'README.txt' is not what was put in"),
        ({**inside, "virus.exe": b"MZ"}, "'virus.exe' was added"),
        ({name: data for name, data in inside.items() if name != CAPTURE}, "is missing"),
    ):
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in changed.items():
                archive.writestr(name, data)
        assert [line for line in check_bundle(path) if words in line], words


def test_every_flipped_bit_of_a_bundle_is_found_or_refused(tmp_path: Path) -> None:
    path = small(tmp_path / "a.zip")
    whole = path.read_bytes()
    told = 0
    for place in range(0, len(whole), 3):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x10]) + whole[place + 1 :])
        try:
            told += bool(check_bundle(path))
        except CaptureError:
            told += 1
    # What is left are times and attributes, which say nothing.
    assert told > 0.7 * len(whole) / 3
    for place in range(0, len(whole), 7):
        path.write_bytes(whole[:place])
        with pytest.raises(CaptureError):
            check_bundle(path)


def row(name: str, size: int = 1, sha256: str = "00") -> dict[str, Any]:
    return {"name": name, "bytes": size, "sha256": sha256, "what": ""}


@pytest.mark.parametrize(
    "rows",
    [
        [row("../../evil")],
        [row("/etc/passwd")],
        [row("devices/..")],
        [row("C:\\x")],
        [row(CAPTURE, -1)],
        [{"name": CAPTURE}],
        "text",
        [row(f"f{k}") for k in range(2000)],
    ],
)
def test_manifest_that_makes_no_sense_is_refused(tmp_path: Path, rows: Any) -> None:
    path = small(tmp_path / "a.zip", members=rows)
    for read in (check_bundle, open_capture):
        with pytest.raises(CaptureError):
            read(path)


def test_bomb_is_not_unpacked(tmp_path: Path) -> None:
    """The manifest says one byte, the member would be 50 MB: it is read up to the second byte."""
    path = small(tmp_path / "a.zip", capture=bytes(50_000_000), members=[row(CAPTURE, 1)])
    target = tmp_path / "out"
    with pytest.raises(CaptureError, match="is not the one that was put in"):
        unpack_capture(path, target)
    assert target.stat().st_size <= 2
    huge = small(tmp_path / "b.zip", members=[row(CAPTURE, 1 << 50)])
    with pytest.raises(CaptureError, match="would be"):
        open_capture(huge)


def test_other_archives_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.log", "x")
    for read in (check_bundle, open_capture):
        with pytest.raises(CaptureError, match="no bundle of Syncline"):
            read(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(MANIFEST, " " * 50_000_000)
    with pytest.raises(CaptureError, match="absurdly large"):
        check_bundle(path)
    path.write_bytes(b"PK\3\4 and nothing else")
    for read in (check_bundle, open_capture):
        with pytest.raises(CaptureError):
            read(path)


def test_command(bad: Path, tmp_path: Path) -> None:
    output = tmp_path / "case.zip"
    runner = CliRunner()
    made = runner.invoke(
        bundle,
        [str(bad), "-o", str(output), "--from", "10s", "--redact", "18A", "--device", "5=jn2100"],
    )
    assert made.exit_code == 0, made.output
    assert "redacted: the payload of" in made.stderr
    assert "left out" in made.stderr
    checked = runner.invoke(bundle, ["--check", str(output)])
    assert (checked.exit_code, "as it was put in" in checked.stdout) == (0, True)
    assert b"[node.5]" in members(output)["bus-description.toml"]
    output.write_bytes(output.read_bytes().replace(b"README.txt", b"README.txu"))
    assert runner.invoke(bundle, ["--check", str(output)]).exit_code == 1


def test_bundle_of_a_text_log(tmp_path: Path) -> None:
    """What a log cannot tell stays untold in the bundle's capture."""
    log = tmp_path / "night.log"
    lines = [f"({k / 10:.6f}) can0 705#05" for k in range(200)]
    log.write_text("\n".join(lines) + "\n", encoding="ascii")
    path = bundled(tmp_path, log, bitrate=250_000)
    ours, theirs = open_session(path).analysis, open_session(log, bitrate=250_000).analysis
    assert ours.capture.time_base == theirs.capture.time_base
    assert ours.capture.resolution_ns == theirs.capture.resolution_ns
    assert ours.bus_load[0].bitrate == 250_000
    assert [row.heartbeats for row in ours.nodes] == [200]
    log.write_text(
        "\n".join([*lines, "(20.5) can0 705#0", f"{SECRET.decode()}?"]), encoding="ascii"
    )
    cut = bundled(tmp_path, log, name="cut.zip", redact=["705"])
    assert b"2 lines could not be read" in members(cut)["README.txt"]
    assert traces_of(SECRET, cut) == []
    assert replace(ours.nodes[0]) == replace(theirs.nodes[0])


def test_marks_go_with_the_part_that_they_lie_in(tmp_path: Path) -> None:
    early = Mark(START_NS + 10**9, "early", 0, 5)
    late = Mark(START_NS + 7 * 10**9, "late EMCY 8130h", 1)
    nowhere = Mark(START_NS + 8 * 10**9, "button")
    source = marked(tmp_path / "a.mcap", early, late, nowhere)
    assert marks_of(bundled(tmp_path, source)) == [early, late, nowhere]
    assert marks_of(bundled(tmp_path, source, start="5s", name="b.zip")) == [late, nowhere]
    redacted = marks_of(bundled(tmp_path, source, redact=("181",), name="c.zip"))
    assert [mark.t_ns for mark in redacted] == [early.t_ns, late.t_ns, nowhere.t_ns]
    assert {mark.reason for mark in redacted} == {"(redacted)"}


def test_a_converted_capture_keeps_its_marks_and_what_is_redacted(tmp_path: Path) -> None:
    mark = Mark(START_NS + 10**9, "button", 1, 5)
    case = bundled(tmp_path, marked(tmp_path / "a.mcap", mark), redact=("181",))
    result = convert([case], tmp_path / "b.mcap")
    assert result.lost == {}
    assert marks_of(tmp_path / "b.mcap") == [replace(mark, reason="(redacted)")]
    notes = [open_session(each).analyze().capture.notes for each in (case, tmp_path / "b.mcap")]
    assert notes[0] == notes[1]
    assert any("(redacted)" in note for note in notes[1])
    assert inspect(tmp_path / "b.mcap").notes == [
        "the payload of 181 is redacted: zeros stand there"
    ]


@pytest.mark.parametrize("name", ["x.log", "x.asc", "x.blf", "x.trc", "x.pcapng", "x.csv"])
def test_a_log_says_that_it_cannot_hold_marks_and_what_is_redacted(
    tmp_path: Path, name: str
) -> None:
    case = bundled(tmp_path, marked(tmp_path / "a.mcap", Mark(START_NS, "a")), redact=("181",))
    lost = convert([case], tmp_path / name).lost
    assert (lost[RECORDER_MARKS], lost[REDACTED]) == (1, 1)
