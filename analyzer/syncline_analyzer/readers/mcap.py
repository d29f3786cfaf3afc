"""Reader of Syncline's own captures."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import get_args

from syncline_analyzer.capture import CaptureFacts, TimeBase
from syncline_analyzer.readers.possible import possible
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.can_errors import SOCKETCAN_INTERFACES
from syncline_schemas.capture.adapter_fit import fits_of
from syncline_schemas.capture.clock_history import ClockHistory, ClockRepair
from syncline_schemas.capture.layout import (
    ADAPTERS_METADATA_NAME,
    CLOCK_TOPIC,
    DESCRIPTION_ATTACHMENT,
    DESCRIPTION_MEDIA_TYPE,
    EDS_MEDIA_TYPE,
    FRAME_SCHEMA_NAME,
    LEARNED_METADATA_NAME,
    METADATA_NAME,
    PROFILE,
    RECOVER_METADATA_NAME,
)
from syncline_schemas.capture.learned import learned_settings
from syncline_schemas.capture.scan import CaptureScan
from syncline_schemas.errors import CaptureError

_MAX_DAMAGE_TEXTS = 20


class McapReader:
    """A Syncline capture, whole, cut off, damaged, or rewritten by another MCAP tool.

    Args:
        path: the file.
        start_ns, end_ns: only frames with `start_ns <= t_ns < end_ns`, and gaps that overlap it;
            None is open.

    Raises:
        CaptureError: the file cannot be opened or holds no CAN frames that Syncline reads; of a
            file without a summary `batches` says so, when it has looked at all of it.
    """

    def __init__(self, path: Path, start_ns: int | None = None, end_ns: int | None = None) -> None:
        self._scan = CaptureScan(path, start_ns=start_ns, end_ns=end_ns)
        self.facts = CaptureFacts(path, "mcap")
        self._take_facts()
        if self._scan.facts.closed and self._scan.facts.topics:
            self._check_schemas()

    @property
    def recording_id(self) -> str:
        """The same in all segments of one recording; empty when the file does not tell."""
        metadata = self._scan.facts.metadata
        return metadata.recording_id if metadata else ""

    @property
    def segment(self) -> int:
        """Number of the file in its recording."""
        metadata = self._scan.facts.metadata
        return metadata.segment if metadata else 0

    def add_clock_samples(self, history: ClockHistory) -> None:
        """Give a history the clock samples of the whole file."""
        if not self._scan.facts.closed or CLOCK_TOPIC in self._scan.facts.topics:
            self._scan.add_clock_samples(history)
            self._take_buses()
            self.facts.adapter_fits = {
                self.facts.buses[bus]: fit
                for bus, fit in history.adapter_fits.items()
                if bus < len(self.facts.buses)
            }

    def repair_clock(self, repair: ClockRepair) -> None:
        """Move all stamps; before the first batch."""
        self._scan.repair = repair

    def limit(self, start_ns: int, end_ns: int, skipped: Callable[[int], object]) -> None:
        """From here on read only the chunks that may hold frames of [start_ns, end_ns).

        `skipped` is told how many frames before the range were left out; see `CaptureScan.limit`.
        """
        self._scan.limit(start_ns, end_ns, skipped)

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in file order, with a Gap between them where the recorder was blind."""
        for item in self._scan.batches():
            self._take_buses()
            if not isinstance(item, Gap):
                yield possible(item, self.facts)
            elif item.start_ns <= item.end_ns:
                yield item
        self._take_facts()
        self._check_schemas()

    def _take_buses(self) -> None:
        for bus in self._scan.facts.buses:
            while len(self.facts.buses) <= bus.number:
                self.facts.buses.append(f"bus{len(self.facts.buses)}")
            self.facts.buses[bus.number] = bus.name
            if bus.bitrate is not None:
                self.facts.bitrates[bus.name] = bus.bitrate
            if bus.data_bitrate is not None:
                self.facts.data_bitrates[bus.name] = bus.data_bitrate
            if bus.interface and bus.interface not in SOCKETCAN_INTERFACES:
                self.facts.foreign_errors.add(bus.name)

    def _take_facts(self) -> None:
        scanned = self._scan.facts
        self._take_buses()
        self.facts.metadata = dict(scanned.metadata_records.get(METADATA_NAME, {}))
        if scanned.metadata is not None:
            self.facts.clock = scanned.metadata.clock
            self.facts.resolution_ns = scanned.metadata.resolution_ns
            self.facts.time_base = _time_base(scanned.metadata.time_base)
        self.facts.marks = list(scanned.marks)
        learned = scanned.metadata_records.get(LEARNED_METADATA_NAME, {})
        self.facts.learned = learned_settings(learned)
        adapters = scanned.metadata_records.get(ADAPTERS_METADATA_NAME, {})
        self.facts.adapter_fits = {**fits_of(adapters), **self.facts.adapter_fits}
        for attachment in scanned.attachments:
            if attachment.name == DESCRIPTION_ATTACHMENT:
                self.facts.description_toml = attachment.data.decode(errors="replace")
            elif attachment.media_type in (EDS_MEDIA_TYPE, DESCRIPTION_MEDIA_TYPE):
                self.facts.eds_files[attachment.name] = attachment.data
        recovered = scanned.metadata_records.get(RECOVER_METADATA_NAME)
        if recovered is not None:
            damage = recovered.get("damage") or "nothing was lost"
            note = f"recovered from {recovered.get('source')}: {damage}"
            self.facts.notes = [note, *(each for each in self.facts.notes if each != note)]
        self.facts.damage = _damage_text(scanned.damage, scanned.lost_frames)

    def _check_schemas(self) -> None:
        scanned = self._scan.facts
        ours = scanned.profile == PROFILE or FRAME_SCHEMA_NAME in scanned.schema_names
        if ours or (scanned.damage and not scanned.schema_names):
            return
        found = ", ".join(scanned.schema_names) or "none"
        raise CaptureError(
            f"{self.facts.path}: an MCAP file without {FRAME_SCHEMA_NAME} messages; "
            f"its schemas: {found}"
        )


def _time_base(text: str) -> TimeBase:
    known: dict[str, TimeBase] = {base: base for base in get_args(TimeBase)}
    return known.get(text, "utc")


def _damage_text(damage: list[str], lost_frames: int) -> str | None:
    if not damage:
        return None
    texts = damage[:_MAX_DAMAGE_TEXTS]
    if len(damage) > len(texts):
        texts.append(f"and {len(damage) - len(texts)} more")
    if lost_frames:
        texts.append(f"at least {lost_frames} frames are lost")
    return "; ".join(texts)
