"""The formats that are read: the table of which `docs/formats.md` and messages are made."""

from typing import Final

from syncline_schemas.records import dataclass


@dataclass(frozen=True, slots=True)
class ReadFormat:
    """One format as people know it.

    Attributes:
        name: as in `CaptureFacts.format`.
        endings: usual ones; the format is found from the content whatever the ending is.
        what: whose it is, and which versions of it.
        cannot: what such a file cannot tell, and so what Syncline does not know of it.
        told: what of that is kept as a fact of the capture, and how it shows.
    """

    name: str
    endings: tuple[str, ...]
    what: str
    cannot: tuple[str, ...] = ()
    told: tuple[str, ...] = ()


_NO_ZONE = "the time zone of its date: taken as UTC, with a note"
_ERROR_CONTENTS = "what an error frame holds"
_NAMES = "names of buses, only numbers"

READ_FORMATS: Final = (
    ReadFormat("mcap", (".mcap",), "Syncline captures"),
    ReadFormat(
        "ros2",
        (".mcap",),
        "ROS 2 bags with `can_msgs/msg/Frame`, `ros2_socketcan_msgs/msg/Frame` or `FdFrame`, of either byte order",
        ("direction", "BRS and ESI of CAN FD", "gaps", "that two topics are one bus"),
        ("messages without a stamp take the time of recording, with a note",),
    ),
    ReadFormat(
        "candump",
        (".log", ".txt"),
        "candump logs (`-l`, `-L`) and screen dumps with any options (`-ta -td -tz -tA -x -e -a -c -d -i -S -8`); dots between bytes",
        ("bit rates", "in screen dumps without `-L`, CAN FD flags and the direction unless `-x`"),
        (
            "`DROPCOUNT` lines are gaps",
            "differences (`-td`) are summed, with a note; a screen dump without times is analyzed without",
        ),
    ),
    ReadFormat(
        "asc",
        (".asc",),
        "Vector ASC: hexadecimal or decimal, absolute or relative times, CAN FD, dates in English, German or ISO",
        (_ERROR_CONTENTS, _NAMES, _NO_ZONE),
        (
            "requests to send (`TxRq`) are counted in a note",
            "a date before 2000 is none, with a note",
        ),
    ),
    ReadFormat("blf", (".blf",), "Vector BLF, also cut off", (_NAMES, _NO_ZONE)),
    ReadFormat(
        "trc",
        (".trc",),
        "PEAK TRC 1.0 to 2.1",
        (_ERROR_CONTENTS, _NAMES, _NO_ZONE),
        ("bus status lines are counted in a note",),
    ),
    ReadFormat(
        "ixxat",
        (".trc", ".txt", ".csv"),
        "IXXAT MiniMon and canAnalyser ASCII traces, whatever their columns",
        (_NAMES, "direction, but of what it sent itself", _NO_ZONE),
        ("overruns and a contradictory stop time are notes",),
    ),
    ReadFormat(
        "kvaser",
        (".txt", ".log"),
        "Kvaser CanKing text and the plain text of Memorator logs, hexadecimal or decimal, CAN FD",
        (_ERROR_CONTENTS, _NAMES, "a date, in CanKing's; in a Memorator's finer than a second"),
        ("numbers taken for decimal are a note", "frames that a Memorator lost are a note"),
    ),
    ReadFormat(
        "busmaster",
        (".log",),
        "BUSMASTER CAN logs; system, absolute and relative times, hexadecimal or decimal",
        (_ERROR_CONTENTS, _NAMES, "times finer than 100 us", _NO_ZONE),
    ),
    ReadFormat(
        "canhacker",
        (".trc", ".txt"),
        "CANHacker traces",
        ("dates, buses, direction", "error frames"),
        ("times that begin again each minute are told as such",),
    ),
    ReadFormat(
        "clx",
        (".txt", ".csv"),
        "CSS Electronics CL1000, CL2000 and CL3000, whatever fields and separators",
        (
            "remote frames, error frames",
            "times finer than 1 ms",
            "a date, where the clock was not set",
            _NO_ZONE,
        ),
        ("`Lost` counts are gaps", "remote frames would be empty data frames: `remote_lost`"),
    ),
    ReadFormat(
        "csv",
        (".csv", ".txt"),
        "CSV by SavvyCAN (GVRET), python-can, IXXAT, Kvaser, CANTest (ZLG) and home-made: comma, semicolon, tab or bar;"
        " column names in many languages or none",
        ("whatever has no column: remote frames, direction, extended identifiers, buses",),
        (
            "every guess is a note: columns without names, decimal numbers, the unit of times, times that are differences",
            "that nothing tells the direction, and dates before 2000, which are none, are notes",
            "without a column for them remote frames are empty data frames, with a note and `remote_lost`",
        ),
    ),
    ReadFormat(
        "pcap",
        (".pcap", ".cap"),
        "network captures of CAN interfaces: both byte orders, us or ns; SocketCAN and cooked packets",
        ("names of interfaces", "bit rates", "direction, unless cooked"),
        ("packets that are no CAN frames are counted in a note",),
    ),
    ReadFormat(
        "pcapng",
        (".pcapng", ".pcap"),
        "Wireshark captures: several sections and interfaces, any resolution; SocketCAN and cooked packets",
        ("when frames were dropped, unless the packets tell",),
        ("drop counts of packets are gaps, those of interfaces a note",),
    ),
    ReadFormat(
        "mf4",
        (".mf4",),
        "ASAM MDF 4 bus logs, in one block of records or lists of them, plain or packed; also cut off or"
        " never finished; needs `pip install 'syncline[mf4]'`",
        ("times finer than its floating-point numbers", _NAMES),
        (
            "what stands of a cut file is read and counted, but not without what describes its records",
            "what the library that reads it cannot is damage: it runs in a process of its own",
        ),
    ),
)
"""All that `open_capture` opens, each also within .gz and .zst."""

KNOWN_FORMATS: Final = (
    "Syncline captures and ROS 2 bags (.mcap), candump logs and screen dumps, Vector .asc and .blf,"
    " PEAK .trc, IXXAT and CANHacker traces, Kvaser text, BUSMASTER .log, CSV logs and those of CLX000 loggers, .pcap and .pcapng, .mf4; each"
    " also as .gz or .zst"
)
