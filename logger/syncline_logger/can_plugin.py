"""Syncline's captures in python-can: `can_logger -f x.mcap`, `can_player x.mcap`, `can_logconvert`.

python-can finds the two classes by the entry points `can.io.message_writer` and
`can.io.message_reader`, and imports this module whenever any log is opened: what weighs something is
imported when an `.mcap` is.
"""

import logging
import os
import shutil
import tempfile
from collections.abc import Iterator
from io import BufferedIOBase
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, cast

import can
from can.io.generic import BinaryIOMessageReader, BinaryIOMessageWriter

from syncline_schemas.errors import CaptureError, UsageError

if TYPE_CHECKING:
    from can.typechecking import StringPathLike

    from syncline_logger.can_message import Channel
    from syncline_schemas.capture.ros2_bag import BagScan
    from syncline_schemas.capture.scan import CaptureScan

LOG = logging.getLogger("syncline.can")


class McapWriter(BinaryIOMessageWriter):
    """python-can's writer of `.mcap`: chunks of a second at most, each synced to disk.

    Each channel of the messages is a bus of its own. As with python-can's other writers a file that
    is there is overwritten.

    Raises:
        UsageError: `append` is asked for.
        OSError: the file cannot be opened, or the disk refuses.
    """

    def __init__(
        self,
        file: "StringPathLike | BinaryIO | BufferedIOBase",
        append: bool = False,
        **kwargs: Any,
    ) -> None:
        if append:
            raise UsageError(
                "an .mcap capture cannot be appended to: give another file name; "
                "`syncline analyze a.mcap b.mcap` reads both as one session"
            )
        super().__init__(file, mode="wb")
        from syncline_logger.message_log import MessageLog

        self._log = MessageLog(cast("BinaryIO", self.file))

    def on_message_received(self, msg: can.Message) -> None:
        """Take a message."""
        self._log.add(msg)

    def file_size(self) -> int:
        """Bytes written so far; up to a second of messages waits beside them."""
        return self._log.bytes_written

    def stop(self) -> None:
        """Write what waits, finish the capture and close the file."""
        try:
            self._log.finish()
        finally:
            super().stop()


class McapReader(BinaryIOMessageReader):
    """python-can's reader of `.mcap`: of this plug-in, of `syncline record`, or a ROS 2 bag.

    Whole, cut off or damaged: what can be read comes, and what was lost is logged as a warning.
    `channel` of the messages is as it was written (a number in digits is an int), the name of the
    recorded bus, or the topic in a bag. A time before the first message of a file object is spent on
    copying it.

    Raises:
        CaptureError: the file cannot be opened, is no MCAP file or holds no CAN frames.
    """

    def __init__(self, file: "StringPathLike | BinaryIO | BufferedIOBase", **kwargs: Any) -> None:
        from syncline_schemas.capture.ros2_bag import BagScan, bag_schemas
        from syncline_schemas.capture.scan import CaptureScan

        self._folder: tempfile.TemporaryDirectory[str] | None = None
        super().__init__(file, mode="rb")
        try:
            if isinstance(file, str | os.PathLike):
                self._path = Path(file)
                self.file.close()  # each pass over the messages opens it anew
            else:
                self._path = self._copied()
            self._scan = CaptureScan(self._path)
            self._bag = BagScan(self._path) if bag_schemas(self._path) else None
            if self._scan.facts.closed and self._bag is None:
                self._check_schemas()
        except BaseException:
            self.stop()
            raise

    def __iter__(self) -> Iterator[can.Message]:
        """All messages in arrival order."""
        if self._bag is not None:
            yield from self._of_bag(self._bag)
            return
        from syncline_logger.can_message import messages_of
        from syncline_schemas.batch import FrameBatch

        for item in self._scan.batches():
            if isinstance(item, FrameBatch):
                yield from messages_of(item, _channels(self._scan))
        self._check_schemas()
        for damage in self._scan.facts.damage:
            LOG.warning("%s: %s", self._path.name, damage)

    def _of_bag(self, bag: "BagScan") -> Iterator[can.Message]:
        from syncline_logger.can_message import messages_of

        for batch in bag.batches():
            yield from messages_of(batch, bag.facts.topics)
        for damage in bag.facts.damage:
            LOG.warning("%s: %s", self._path.name, damage)
        if bag.facts.unreadable:
            LOG.warning("%s: %d messages are no CAN frames", self._path.name, bag.facts.unreadable)

    def stop(self) -> None:
        """Close the file."""
        super().stop()
        if self._folder is not None:
            self._folder.cleanup()

    def _copied(self) -> Path:
        """A file with the content of a file object, which may be one that cannot be searched."""
        self._folder = tempfile.TemporaryDirectory(prefix="syncline-")
        path = Path(self._folder.name) / "capture.mcap"
        with path.open("wb") as copy:
            shutil.copyfileobj(self.file, copy)
        return path

    def _check_schemas(self) -> None:
        from syncline_schemas.capture.layout import FRAME_SCHEMA_NAME, PROFILE

        facts = self._scan.facts
        known = facts.profile == PROFILE or FRAME_SCHEMA_NAME in facts.schema_names
        if known or (facts.damage and not facts.schema_names):
            return
        found = ", ".join(facts.schema_names) or "none"
        raise CaptureError(
            f"{self._path} holds no CAN frames, neither Syncline's nor of a ROS 2 bag; its schemas: {found}"
        )


def _channels(scan: "CaptureScan") -> list["Channel"]:
    """python-can's name of each bus, by number."""
    from syncline_logger.message_log import SOURCE

    facts = scan.facts
    ours = facts.metadata is not None and facts.metadata.source == SOURCE
    names: list[Channel] = []
    for bus in facts.buses:
        names += [None] * (bus.number + 1 - len(names))
        names[bus.number] = _channel(bus.channel if ours else bus.name)
    return names


def _channel(text: str) -> "Channel":
    if not text:
        return None
    return int(text) if text.isascii() and text.isdecimal() and str(int(text)) == text else text
