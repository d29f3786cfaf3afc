"""A file of every format that is read, and what of the frames it holds."""

from collections.abc import Sequence
from dataclasses import dataclass

from tests.analyzer.binary_files import (
    pcap,
    pcap_big,
    pcapng,
    pcapng_big,
    python_can_blf,
    ros2,
    ros2_fd,
    ros2_fd_keeps,
    ros2_keeps,
    sll,
    sll2,
)
from tests.analyzer.log_builder import T0_NS, Row
from tests.analyzer.log_frames import (
    FRAMES,
    Encoder,
    Keeper,
    data_and_remote,
    data_frames,
    everything,
    plain_errors,
    without_direction,
)
from tests.analyzer.mf4_files import mf4
from tests.analyzer.text_files import (
    asc,
    bare,
    bare_keeps,
    busmaster,
    busmaster_keeps,
    candump,
    canhacker,
    canhacker_keeps,
    cantest,
    cantest_keeps,
    clx,
    clx_keeps,
    german_csv,
    gvret,
    ixxat,
    ixxat_keeps,
    kvaser,
    kvaser_keeps,
    memorator,
    screen,
    trc,
    trc_keeps,
)


@dataclass(frozen=True, slots=True)
class LogFile:
    """A format with what of a frame it holds.

    Attributes:
        keep: the frame as it is read, None where the format has no room for it.
        buses: the names that the two buses get.
        corrupt: a damaged line of it, for text formats.
        step_ns: of its stamps.
        origin_ns: what its times count from, for those without dates.
        cut_step: bytes from one cut of a file to the next, where each takes long.
        ordered: whether frames of equal times keep their order.
    """

    name: str
    encode: Encoder
    keep: Keeper
    buses: tuple[str, str] = ("can0", "can1")
    corrupt: bytes | None = None
    origin_ns: int = 0
    cut_step: int = 1
    ordered: bool = True

    def expected(self, frames: Sequence[Row] = FRAMES) -> list[Row]:
        """The frames as the reader must give them."""
        kept = [found for frame in frames if (found := self.keep(frame)) is not None]
        return [(t_ns - self.origin_ns, *rest) for t_ns, *rest in kept]  # type: ignore[misc]


NUMBERED = ("1", "2")
LOG_FILES = (
    LogFile("candump", candump, everything, corrupt=b"(1700000001.0000) can0 12\n"),
    LogFile("candump", screen, everything, corrupt=b" (1700000001.000000)  can0  RX - -  123 \n"),
    LogFile("asc", asc, plain_errors, NUMBERED, corrupt=b"   1.000000 1  zzz  Rx   d 2 01 02\n"),
    LogFile("trc", trc, trc_keeps, NUMBERED, corrupt=b"      3   1.000 DT 1   zz\n"),
    LogFile("kvaser", kvaser, kvaser_keeps, ("0", "1"), b" 0    0000018  garbled\n", T0_NS),
    LogFile("kvaser", memorator, plain_errors, NUMBERED, b"    0.123  1  18  garbled\n"),
    LogFile(
        "busmaster", busmaster, busmaster_keeps, NUMBERED, b"22:13:20:0000 Rx 1 0x181 s 8 0\xff\n"
    ),
    LogFile("csv", german_csv, data_and_remote, corrupt=b"5;0,2;can0;zz\n", origin_ns=T0_NS),
    LogFile("csv", gvret, data_frames, ("0", "1"), b"300,0000zz,false,Rx\n", T0_NS),
    LogFile("csv", cantest, cantest_keeps, ("ch1", "ch2"), b"9,,0x9,ch1,,0xZZ\n", T0_NS),
    LogFile("csv", bare, bare_keeps, NUMBERED, b"0.5,zz\n", T0_NS),
    LogFile("canhacker", canhacker, canhacker_keeps, NUMBERED, b"00.150 18  8\n", T0_NS),
    LogFile("clx", clx, clx_keeps, NUMBERED, b"2023/11/14 22:13:20.000;0;zz;1;0\n"),
    LogFile("ixxat", ixxat, ixxat_keeps, NUMBERED, b'"00:00:02.00";"18\n'),
    LogFile("pcap", pcap, lambda frame: without_direction((frame[0], 0, *frame[2:]))),
    LogFile("pcap", pcap_big, lambda frame: without_direction((frame[0], 0, *frame[2:]))),
    LogFile("pcap", sll, lambda frame: (frame[0], 0, *frame[2:])),
    LogFile("pcap", sll2, everything, ("interface 3", "interface 4")),
    LogFile("pcapng", pcapng, everything),
    LogFile("pcapng", pcapng_big, everything),
    LogFile("ros2", ros2, ros2_keeps, ("/can0/from_can_bus", "/can1/from_can_bus")),
    LogFile("ros2", ros2_fd, ros2_fd_keeps, ("/can0/from_can_bus", "/can1/from_can_bus")),
    LogFile("blf", python_can_blf, everything, NUMBERED),
    LogFile("mf4", mf4, everything, NUMBERED, cut_step=300, ordered=False),
)
IDS = [log.encode.__name__ for log in LOG_FILES]
