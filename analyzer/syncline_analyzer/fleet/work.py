"""What a worker does: fetch a recording, analyze it, write its tables, make the capture stand."""

import threading
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from syncline_analyzer.fleet.captures import CaptureEntry, capture_values, outcome_of
from syncline_analyzer.fleet.columns import arrow_table
from syncline_analyzer.fleet.copies import with_whole_files
from syncline_analyzer.fleet.cost import Meter
from syncline_analyzer.fleet.fetch import Fetched, fetched
from syncline_analyzer.fleet.identity import capture_id
from syncline_analyzer.fleet.layout import Partition, date_of, recording_file, report_file
from syncline_analyzer.fleet.publish import (
    publish,
    put_beside,
    refresh,
    staging,
    standing,
    take_away,
)
from syncline_analyzer.fleet.recording import File
from syncline_analyzer.fleet.schemas import CAPTURES, table_schema
from syncline_analyzer.fleet.storage import open_url
from syncline_analyzer.fleet.task import Outcome, Task
from syncline_analyzer.readers import open_capture
from syncline_analyzer.reading import LocalReading
from syncline_analyzer.reading_request import Request
from syncline_analyzer.results import Analysis
from syncline_schemas.collecting import rare_collections
from syncline_schemas.description import BusDescription
from syncline_schemas.errors import CaptureError

_ONE_AT_A_TIME = threading.Lock()
"""Parallel are captures, in processes of one thread; a cluster may have workers of several."""
_SMALL_ROWS = 500
"""Up to here a table is small whatever is done, and plain columns are written fastest."""


def analyze_recording(task: Task) -> Outcome:
    """Do a task; whatever goes wrong is told by the outcome."""
    with _ONE_AT_A_TIME, rare_collections():
        meter = Meter()
        try:
            outcome = _done(task, meter)
        except Exception as error:  # noqa: BLE001 - one capture never stops the others
            outcome = _failed(error, task)
        return replace(outcome, cpu_s=meter.cpu_s, peak_mb=meter.peak_mb)


def _done(task: Task, meter: Meter) -> Outcome:
    here = task.settings.version(task.recording.machine)
    if task.foreign and here != task.version:
        return Outcome(
            "failed",
            f"this worker has Syncline {here}, {task.version} was asked for:"
            " install the same on all machines of the cluster",
        )
    if task.recording.copies:
        task = replace(task, recording=with_whole_files(task.recording, task.options))
    with fetched(task.recording.files, task.options) as found:
        earlier = [entry for each in task.earlier if (entry := standing(task.out, each))]
        same = next((entry for entry in earlier if _is_same(entry, task, found)), None)
        if same is not None:
            refresh(task.out, _with_files(same, task))
            return outcome_of("unchanged", same)
        if not task.recording.files[0].sure:
            unreadable = _not_a_capture(found.paths)
            if unreadable:
                reason = _told(unreadable, task.recording.files, found.paths)
                return Outcome("no capture", reason, content_sha256=found.content_sha256)
        try:
            analysis = _analyzed(task, found)
            entry = _published(task, found, analysis, meter, earlier)
        except Exception as error:  # noqa: BLE001 - see above; here the content is known
            outcome = _failed(error, task, found.paths)
            return replace(outcome, content_sha256=found.content_sha256)
    return outcome_of("analyzed", entry)


def _not_a_capture(paths: Sequence[Path]) -> str:
    """Why files cannot be opened as captures, "" where they can."""
    try:
        for path in paths:
            open_capture(path)
    except CaptureError as error:
        return str(error)
    return ""


def _failed(error: Exception, task: Task, paths: Sequence[Path] = ()) -> Outcome:
    text = " ".join(_told(str(error), task.recording.files, paths).split()) or type(error).__name__
    if not isinstance(error, CaptureError | ValueError | OSError):
        text = f"internal error: {type(error).__name__}: {text}"
    return Outcome("failed", text)


def _is_same(entry: CaptureEntry, task: Task, found: Fetched) -> bool:
    """Whether a capture that stands is of this content, this machine and this analysis."""
    return (
        entry.content_sha256 == found.content_sha256
        and entry.version == task.version
        and entry.partition.machine == task.recording.machine
        and entry.has(task.settings.extras)
    )


def _analyzed(task: Task, found: Fetched) -> Analysis:
    """The analysis; all of it in this process."""
    from syncline_analyzer.engine import analyze_prepared

    reading = LocalReading(Request(found.paths))
    analysis = analyze_prepared(
        reading,
        description=_description(task, reading),
        devices={},
        bitrate=task.settings.bitrate,
        origin_ns=reading.origin_ns,
    )
    return _with_urls(reading.veil.lifted(analysis), task.recording.files, found.paths)


def _description(task: Task, reading: LocalReading) -> BusDescription:
    """What the user says of this machine, else what the recorder attached."""
    text = task.settings.description(task.recording.machine)
    if text:
        return BusDescription.loads(text, files=task.settings.device_files)
    for facts in reading.facts:
        if facts.description_toml:
            return BusDescription.loads(facts.description_toml, files=facts.eds_files)
    return BusDescription()


def _with_urls(analysis: Analysis, files: Sequence[File], paths: Sequence[Path]) -> Analysis:
    """The analysis with the URLs of its files in place of where copies of them were."""
    capture = analysis.capture

    def told(texts: Iterable[str]) -> list[str]:
        return [_told(text, files, paths) for text in texts]

    capture = replace(
        capture,
        files=told(capture.files),
        damage=told(capture.damage),
        notes=told(capture.notes),
    )
    return replace(analysis, capture=capture)


def _told(text: str, files: Sequence[File], paths: Sequence[Path]) -> str:
    for path, file in zip(paths, files, strict=False):
        text = text.replace(str(path), file.url)
    return text


def _published(
    task: Task, found: Fetched, analysis: Analysis, meter: Meter, earlier: Sequence[CaptureEntry]
) -> CaptureEntry:
    """Write everything of a capture and make it stand; what stood for it goes."""
    recording = task.recording
    name = recording.capture_id or capture_id(found.content_sha256, recording.machine)
    partition = Partition(recording.machine, date_of(analysis.capture.start_utc_ns), name)
    with staging(task.out, task.run) as staged:
        extras = _write_beside(analysis, task, partition, staged)
        tables = _write_tables(analysis, staged, samples="samples" in task.settings.extras)
        entry = CaptureEntry(
            partition,
            recording.files,
            recording.copies,
            found.content_sha256,
            task.version,
            {
                **capture_values(analysis),
                "tables": [CAPTURES, *tables],
                **extras,
                "cpu_s": meter.cpu_s,
                "peak_mb": meter.peak_mb,
            },
        )
        twin = standing(task.out, partition)
        if twin is not None and _is_same(twin, task, found):
            entry = _with_files(twin, task)
            refresh(task.out, entry)
        else:
            _retire_earlier(task, earlier, partition)
            publish(task.out, staged, entry)
    return entry


def _retire_earlier(task: Task, earlier: Sequence[CaptureEntry], new: Partition) -> None:
    """Take away what stood for this recording elsewhere, unless others of its files stand there."""
    own = {file.url for file in (*task.recording.files, *task.recording.copies)}
    for entry in earlier:
        if entry.partition != new and (
            entry.urls & own or entry.partition.capture_id == task.recording.capture_id
        ):
            take_away(task.out, entry.partition.folder)


def _with_files(entry: CaptureEntry, task: Task) -> CaptureEntry:
    """A capture that stands, with the files that it is of now.

    Other files that are still there with the same content become copies.
    """
    recording = task.recording
    if recording.capture_id:
        return replace(entry, files=recording.files, copies=recording.copies)
    own = recording.files[0]
    others = {
        file.url: file
        for file in (*entry.files, *entry.copies)
        if file.url != own.url and _is_there(file, task)
    }
    first, *copies = sorted([own, *others.values()], key=lambda each: each.url)
    return replace(entry, files=(first,), copies=tuple(copies))


def _is_there(file: File, task: Task) -> bool:
    fs, path = open_url(file.url, task.options)
    try:
        return bool(fs.info(path)["size"] == file.size_bytes)
    except OSError:
        return False


def _write_beside(
    analysis: Analysis, task: Task, partition: Partition, staged: Path
) -> dict[str, bool]:
    """Write report and recording where they are asked for; which of the extras there are."""
    name = partition.capture_id
    extras = {each: each in task.settings.extras for each in ("samples", "report", "recording")}
    if extras["report"]:
        from syncline_analyzer.views.report_html import write_report

        made = write_report(analysis, staged / "report.html")
        put_beside(task.out, made, report_file(name))
        made.unlink(missing_ok=True)
    if extras["recording"]:
        from syncline_analyzer.fleet.label import label_of
        from syncline_analyzer.views.rerun_view import write_rrd

        label = label_of(analysis, partition)
        made = write_rrd(analysis, staged / "session.rrd", label=label)
        put_beside(task.out, made, recording_file(name))
        made.unlink(missing_ok=True)
    return extras


def _write_tables(analysis: Analysis, folder: Path, *, samples: bool) -> list[str]:
    """Write the tables that have rows; their names."""
    from syncline_analyzer.views.tables import ROW_TYPES, is_dated, rows_of

    dated = is_dated(analysis)
    names = []
    for name, kind in ROW_TYPES.items():
        rows = rows_of(analysis, name)
        if len(rows):
            _write(folder / f"{name}.parquet", arrow_table(rows, kind, dated=dated))
            names.append(name)
    if histograms := _histograms(analysis):
        _write(folder / "response_histograms.parquet", pa.concat_tables(histograms))
        names.append("response_histograms")
    if samples:
        from syncline_analyzer.fleet.samples import write_samples

        names += write_samples(analysis, folder)
    return names


def _histograms(analysis: Analysis) -> list[pa.Table]:
    schema = table_schema("response_histograms")
    return [
        pa.Table.from_arrays(
            [
                pa.repeat(pa.scalar(each.bus, pa.string()), len(each.histogram)),
                pa.repeat(pa.scalar(each.cob_id, pa.int64()), len(each.histogram)),
                each.edges_us[:-1],
                each.edges_us[1:],
                pa.array(each.histogram, pa.int64()),
            ],
            schema=schema,
        )
        for each in analysis.responses
        if len(each.histogram)
    ]


def _write(path: Path, table: pa.Table) -> None:
    small = table.num_rows <= _SMALL_ROWS
    # Through memory: to open a file costs Arrow more than to write these tables.
    sink = pa.BufferOutputStream()
    pq.write_table(
        table,
        sink,
        compression="snappy" if small else "zstd",
        use_dictionary=not small,
        write_statistics=not small,
        store_schema=False,
        write_page_checksum=True,
    )
    path.write_bytes(sink.getvalue())
