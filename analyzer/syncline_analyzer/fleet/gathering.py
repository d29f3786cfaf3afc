"""Which files are one recording: the segments that a recorder split it into, and copies of them."""

import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from io import BytesIO
from itertools import groupby
from operator import attrgetter
from typing import Any, BinaryIO, cast

import zstandard

from syncline_analyzer.fleet.identity import capture_id, short_hash
from syncline_analyzer.fleet.machine import MachineRule
from syncline_analyzer.fleet.recording import File, Recording
from syncline_analyzer.fleet.source import Found
from syncline_analyzer.fleet.storage import open_url
from syncline_schemas.capture.layout import METADATA_NAME, CaptureMetadata
from syncline_schemas.capture.record_file import RecordFile
from syncline_schemas.capture.record_stream import MAGIC

_HEAD_BYTES = 64 << 10
"""What is read of each file; the recorder writes what it says of itself first."""
_AT_ONCE = 32
"""Files that are looked at at a time: object stores are slow to answer."""
_GZIP_MAGIC, _ZSTD_MAGIC = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"
_MACHINE_KEY = "machine"
"""In the record `syncline`, where a recorder was told the name of its machine."""


def recordings_of(
    found: Sequence[Found],
    rule: MachineRule,
    known: Mapping[str, File] | None = None,
    options: Mapping[str, Any] | None = None,
) -> list[Recording]:
    """The recordings that files are of, in order of their first URL.

    Args:
        found: the files.
        rule: which machine a file is of.
        known: by URL, files that were looked at before; unchanged ones are not opened again.
        options: of the file systems of URLs.
    """
    files = _identified(found, known or {}, options or {})
    alone = [file for file in files if not file.recording_id]
    split = sorted((file for file in files if file.recording_id), key=_identity)
    recordings = [_of_one(file, rule) for file in alone]
    for _, group in groupby(split, key=_identity):
        recordings.extend(_of_recording(list(group), rule))
    return sorted(recordings, key=lambda each: each.files[0].url)


def _identified(
    found: Sequence[Found], known: Mapping[str, File], options: Mapping[str, Any]
) -> list[File]:
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        return list(pool.map(lambda each: _identify(each, known.get(each.url), options), found))


def _identify(found: Found, known: File | None, options: Mapping[str, Any]) -> File:
    file = File(found.url, found.size_bytes, found.modified_ns, found.etag, sure=found.sure)
    if known is not None and known.stamp == file.stamp:
        return replace(known, sure=found.sure)
    about = _about(file.url, options)
    if about is None:
        return file
    return replace(
        file,
        recording_id=about.recording_id,
        host=about.host,
        machine=about.extra.get(_MACHINE_KEY, ""),
        segment=about.segment,
        created_ns=about.created_ns,
    )


def _about(url: str, options: Mapping[str, Any]) -> CaptureMetadata | None:
    """What a capture of ours says of its recording; of its head, mostly, no more is read."""
    try:
        fs, path = open_url(url, options)
        head = _unpacked(fs.cat_file(path, start=0, end=_HEAD_BYTES))
        if not head.startswith(MAGIC):
            return None
        about = _metadata(BytesIO(head))
        if about is None:
            with fs.open(path, "rb", block_size=_HEAD_BYTES) as stream:
                about = _metadata(cast(BinaryIO, stream))
    except (OSError, ValueError):
        return None  # The analysis of it will say what is wrong.
    return about


def _metadata(stream: BinaryIO) -> CaptureMetadata | None:
    for record in RecordFile(stream).metadata():
        if record.name == METADATA_NAME:
            return CaptureMetadata.from_record(record.metadata)
    return None


def _unpacked(head: bytes) -> bytes:
    """The beginning of what a packed file holds."""
    if head.startswith(_GZIP_MAGIC):
        try:
            return zlib.decompressobj(wbits=31).decompress(head, _HEAD_BYTES)
        except zlib.error:
            return b""
    if head.startswith(_ZSTD_MAGIC):
        try:
            reader = zstandard.ZstdDecompressor().stream_reader(head)
            return bytes(reader.read(_HEAD_BYTES))
        except zstandard.ZstdError:
            return b""
    return head


def _identity(file: File) -> tuple[str, str]:
    return file.recording_id, file.host


def _of_one(file: File, rule: MachineRule) -> Recording:
    """A file that belongs to no other one."""
    machine, source = rule.machine(file.url, told=file.machine, host=file.host)
    return Recording(f"f{short_hash(file.url)}", "", (file,), machine, source)


def _of_recording(files: Sequence[File], rule: MachineRule) -> Iterator[Recording]:
    """Recordings of files of one recording id and host: one, but where ids are the same by chance."""
    chosen, copies = _without_copies(files)
    if len({file.segment for file in chosen}) == len(chosen):
        yield _joined(chosen, copies, rule)
        return
    undated = [file for file in chosen if not file.created_ns]
    for file in undated:
        yield _of_one(file, rule)
    dated = [file for file in chosen if file.created_ns]
    dated.sort(key=lambda each: (_machine(each, rule), each.created_ns))
    for machine, group in groupby(dated, key=lambda each: _machine(each, rule)):
        for run in _rising(group):
            begun = str(run[0].created_ns)
            own = [each for each in copies if each.created_ns in {f.created_ns for f in run}]
            yield _joined(run, own, rule, machine, begun)


def _rising(files: Iterable[File]) -> Iterator[list[File]]:
    """Runs in which the segments' numbers rise."""
    run: list[File] = []
    for file in files:
        if run and file.segment <= run[-1].segment:
            yield run
            run = []
        run.append(file)
    yield run


def _machine(file: File, rule: MachineRule) -> str:
    return rule.machine(file.url, told=file.machine, host=file.host)[0]


def _without_copies(files: Sequence[File]) -> tuple[list[File], list[File]]:
    """One file of each segment, and the others: begun at the same moment, they are copies.

    The largest one holds most, and of equal ones the oldest is what was copied; of a file that does
    not tell when it was begun nobody knows.
    """
    order = sorted(
        files,
        key=lambda each: (
            each.segment,
            each.created_ns,
            -each.size_bytes,
            each.modified_ns or 0,
            each.url,
        ),
    )
    chosen: list[File] = []
    copies: list[File] = []
    for (_, created_ns), group in groupby(order, key=attrgetter("segment", "created_ns")):
        first, *others = group
        chosen.append(first)
        (copies if created_ns else chosen).extend(others)
    return chosen, copies


def _joined(
    files: Sequence[File], copies: Sequence[File], rule: MachineRule, *distinct: str
) -> Recording:
    ordered = tuple(sorted(files, key=attrgetter("segment")))
    first = ordered[0]
    machine, source = rule.machine(first.url, told=first.machine, host=first.host)
    name = capture_id(first.recording_id, first.host, *distinct)
    return Recording(name, name, ordered, machine, source, tuple(copies))
