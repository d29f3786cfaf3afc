"""Where everything of a data set is: paths below its root, with `/` between the parts.

machine=press-3/date=2026-11-22/capture_id=c0123456789abcde/captures.parquet
                                                           /nodes.parquet ...
_packs/<name>/captures.parquet          the same rows of many captures, see `packs.py`
             /nodes.parquet ...
failures/<key>.parquet
reports/<capture_id>.html
recordings/<capture_id>.rrd
"""

import hashlib
from datetime import date, timedelta
from urllib.parse import quote, unquote

from syncline_schemas.named_tuples import NamedTuple

UNDATED = "undated"
"""Instead of a date: the capture tells none."""
STAGING, FAILURES, REPORTS, RECORDINGS = ".staging", "failures", "reports", "recordings"
PACKS = "_packs"
"""Readers of hive partitions pass over names that begin so."""
CAPTURES_FILE = "captures.parquet"
_MAX_NAME = 200
_HIVE_NULL = "__HIVE_DEFAULT_PARTITION__"
"""What readers of hive partitions take for no value."""
_DAY_NS = 86_400 * 10**9


class Partition(NamedTuple):
    """What the path of a capture tells: the columns that hive partitioning adds to its rows."""

    machine: str
    date: str
    capture_id: str

    @property
    def folder(self) -> str:
        """Folder of the capture's tables."""
        return "/".join(f"{key}={_quoted(value)}" for key, value in self._asdict().items())

    @classmethod
    def of_path(cls, path: str) -> "Partition | None":
        """Of a path below the root; None where it is none of a capture.

        >>> Partition.of_path("machine=line%203/date=undated/capture_id=c1/nodes.parquet").machine
        'line 3'
        """
        parts = path.split("/")[:3]
        pairs = [part.partition("=") for part in parts]
        if tuple(key for key, _, _ in pairs) != cls._fields:
            return None
        return cls(*(unquote(value) for _, _, value in pairs))


def date_of(start_utc_ns: int | None) -> str:
    """UTC date of a stamp.

    >>> date_of(1_790_000_000_000_000_000), date_of(None)
    ('2026-09-21', 'undated')
    """
    if start_utc_ns is None:
        return UNDATED
    return (date(1970, 1, 1) + timedelta(days=start_utc_ns // _DAY_NS)).isoformat()


def failure_file(key: str) -> str:
    """Where it is told that a recording could not be analyzed."""
    return f"{FAILURES}/{key}.parquet"


def pack_file(name: str, table: str) -> str:
    """A table of a pack."""
    return f"{PACKS}/{name}/{table}.parquet"


def report_file(capture_id: str) -> str:
    """The report of a capture."""
    return f"{REPORTS}/{capture_id}.html"


def recording_file(capture_id: str) -> str:
    """The Rerun recording of a capture."""
    return f"{RECORDINGS}/{capture_id}.rrd"


def stored_name(value: str) -> str:
    """A name as the path of a capture tells it again: one that is too long is cut there.

    >>> stored_name("press 3"), len(stored_name("x" * 300))
    ('press 3', 29)
    """
    return unquote(_quoted(value))


def _quoted(value: str) -> str:
    """A value as one part of a path on any file system, percent-encoded and not too long."""
    quoted = quote(value, safe="")
    if len(quoted) > _MAX_NAME:
        mark = hashlib.sha256(value.encode()).hexdigest()[:12]
        quoted = quote(f"{value[:16]}~{mark}", safe="")
    if quoted == _HIVE_NULL:
        return quoted.replace("_", "%5F")
    return quoted.replace(".", "%2E") if not quoted.strip(".") else quoted
