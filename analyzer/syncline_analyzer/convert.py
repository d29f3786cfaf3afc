"""From every format that can be read to every format that can be written."""

import gzip
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np

from syncline_analyzer.capture import CaptureFacts, CaptureReader
from syncline_analyzer.merge import Merge
from syncline_analyzer.offsets import shifted
from syncline_analyzer.readers import open_capture
from syncline_analyzer.redaction import Redaction
from syncline_analyzer.writers.carried import learned_count, merged_learned, merged_marks
from syncline_analyzer.writers.formats import (
    ADAPTERS,
    ATTACHED,
    BIT_RATES,
    LEARNED,
    NO_DATES,
    NO_TIMES,
    RECORDER_MARKS,
    REDACTED,
    WriteFormat,
    output_format,
)
from syncline_analyzer.writers.log import LogWriter, Survey
from syncline_schemas.batch import Gap
from syncline_schemas.capture.layout import Attachment, description_attachment, device_attachment
from syncline_schemas.errors import CaptureError, UsageError
from syncline_schemas.records import dataclass

Progress = Callable[[int], None]
"""Called with the number of frames read so far."""


@dataclass(frozen=True, slots=True)
class ConvertResult:
    """What a conversion did.

    Attributes:
        output: the file written.
        format: its format.
        frames: frames written.
        lost: what the output format cannot hold, counted by kind in words; empty when nothing.
        unparsed_lines: lines of the inputs that could not be read.
        damage: what could not be read of damaged inputs, with the file's name.
        notes: what the inputs could not tell, with the file's name.
    """

    output: Path
    format: str
    frames: int
    lost: dict[str, int] = field(default_factory=dict)
    unparsed_lines: int = 0
    damage: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Whether everything in the inputs is in the output."""
        return not self.lost and not self.damage and not self.unparsed_lines


def convert(
    inputs: Sequence[str | Path],
    output: str | Path,
    *,
    offsets: Mapping[str, str] | None = None,
    progress: Progress | None = None,
) -> ConvertResult:
    """Write the frames of captures or logs, in order of time, as one log.

    The inputs are read twice: what stands at the start of a log has to be known before its first
    frame. The output appears when it is complete.

    offsets: how the times of a file are moved, as `open_session` takes it.
    progress: called after each batch with the frames read so far, in both passes together.

    Raises:
        CaptureError: an input cannot be read, or the output cannot be written.
        UsageError: the output's ending names no format, or it is one of the inputs.
    """
    output, paths = Path(output), [Path(path) for path in inputs]
    form = output_format(output)
    if not paths:
        raise UsageError("no capture given: name at least one file to convert")
    if any(path.resolve() == output.resolve() for path in paths):
        raise UsageError(f"{output}: is one of the inputs; choose another name")
    readers = _readers(paths, offsets)
    survey = _survey(readers, paths, progress)
    partial = output.with_name(output.name + ".part")
    try:
        with _opened(partial, output.suffix.lower()) as stream:
            result = _written(_readers(paths, offsets), survey, form, stream, output, progress)
        partial.replace(output)
    except OSError as error:
        partial.unlink(missing_ok=True)
        if isinstance(error, CaptureError):
            raise
        raise CaptureError(f"{output}: cannot be written: {error.strerror or error}") from error
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    return result


def _readers(paths: Sequence[Path], offsets: Mapping[str, str] | None) -> list[CaptureReader]:
    return shifted([open_capture(path) for path in paths], offsets or {})


def _opened(path: Path, packing: str) -> BinaryIO:
    try:
        if packing == ".gz":
            return cast(BinaryIO, gzip.open(path, "wb", compresslevel=6))
        if packing == ".zst":
            import zstandard

            return cast(BinaryIO, zstandard.open(path, "wb"))
        return path.open("wb")
    except OSError as error:
        raise CaptureError(f"{path}: cannot be written: {error.strerror or error}") from error


def _written(
    readers: Sequence[CaptureReader],
    survey: Survey,
    form: WriteFormat,
    stream: BinaryIO,
    output: Path,
    progress: Progress | None,
) -> ConvertResult:
    merge = Merge(readers)
    writer = _writer(form.name, stream, survey, [reader.facts for reader in readers])
    frames = 0
    for item in merge.stream():
        if isinstance(item, Gap):
            writer.gap(item)
        else:
            writer.write(item)
            frames += len(item)
            if progress:
                progress(survey.frames + frames)
    writer.close()
    facts = [reader.facts for reader in readers]
    lost = Counter(writer.lost)
    lost.update(_lost_facts(form, survey, facts))
    return ConvertResult(
        output=output,
        format=form.name,
        frames=frames,
        lost=dict(lost),
        unparsed_lines=sum(each.unparsed_count for each in facts),
        damage=[f"{each.path.name}: {each.damage}" for each in facts if each.damage],
        notes=[f"{each.path.name}: {note}" for each in facts for note in each.notes],
    )


def _lost_facts(form: WriteFormat, survey: Survey, facts: Sequence[CaptureFacts]) -> dict[str, int]:
    """What the format cannot hold of what is known besides the frames."""
    attached = len(_attachments(facts))
    known = {
        NO_TIMES: int(survey.time_base == "none"),
        NO_DATES: int(survey.time_base == "relative"),
        BIT_RATES: len(survey.bitrates),
        ATTACHED: attached,
        RECORDER_MARKS: len(survey.marks),
        REDACTED: int(bool(survey.redacted)),
        ADAPTERS: len(survey.adapter_fits),
    }
    lost = {what: count for what, count in known.items() if count and what in form.cannot}
    carried = survey.learned and LEARNED not in form.cannot
    if (learned := learned_count(facts)) and not carried:
        lost[LEARNED] = learned
    return lost


def _survey(
    readers: Sequence[CaptureReader], paths: Sequence[Path], progress: Progress | None
) -> Survey:
    merge = Merge(readers)
    frames, first_ns, whole_us = 0, None, True
    for item in merge.stream():
        if isinstance(item, Gap) or not len(item):
            continue
        frames += len(item)
        if progress:
            progress(frames)
        earliest = int(item.t_ns.min())
        first_ns = earliest if first_ns is None else min(first_ns, earliest)
        whole_us = whole_us and not np.any(item.t_ns % 1000)
    facts = [reader.facts for reader in readers]
    if first_ns is not None and first_ns < 0:
        raise UsageError(
            f"the first frame of {facts[0].path.name} would be before its time 0, which no log can"
            " hold; move it with --offset"
        )
    return Survey(
        buses=tuple(merge.buses),
        bitrates={name: rate for each in facts for name, rate in each.bitrates.items()},
        data_bitrates={n: rate for each in facts for n, rate in each.data_bitrates.items()},
        frames=frames,
        first_ns=first_ns or 0,
        whole_us=whole_us,
        time_base=facts[0].time_base,
        clock=facts[0].clock,
        resolution_ns=max(each.resolution_ns for each in facts),
        source="converted from " + ", ".join(path.name for path in paths),
        marks=tuple(merged_marks(facts, merge.buses)),
        redacted=Redaction.of_metadata(each.metadata for each in facts).text,
        foreign_errors=frozenset(name for each in facts for name in each.foreign_errors),
        learned=merged_learned(facts, merge.buses),
        adapter_fits={bus: fit for each in facts for bus, fit in each.adapter_fits.items()},
    )


def _writer(
    form: str, stream: BinaryIO, survey: Survey, facts: Sequence[CaptureFacts]
) -> LogWriter:
    if form == "mcap":
        from syncline_analyzer.writers.capture import McapWriter

        return McapWriter(stream, survey, _attachments(facts))
    if form == "blf":
        from syncline_analyzer.writers.blf import BlfWriter

        return BlfWriter(stream, survey)
    if form == "pcapng":
        from syncline_analyzer.writers.pcapng import PcapngWriter

        return PcapngWriter(stream, survey)
    if form == "parquet":
        from syncline_analyzer.writers.table import ParquetWriter

        return ParquetWriter(stream, survey)
    from syncline_analyzer.writers import text

    writers: dict[str, type[LogWriter]] = {
        "candump": text.CandumpWriter,
        "asc": text.AscWriter,
        "trc": text.TrcWriter,
        "csv": text.CsvWriter,
    }
    return writers[form](stream, survey)


def _attachments(facts: Sequence[CaptureFacts]) -> tuple[Attachment, ...]:
    files = {name: data for each in facts for name, data in each.eds_files.items()}
    toml = next((each.description_toml for each in facts if each.description_toml), None)
    attached = [device_attachment(name, data) for name, data in files.items()]
    return (*attached, *([description_attachment(toml)] if toml else []))
