"""The formats that are written: endings, and what each cannot hold."""

from pathlib import Path
from typing import Final

from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

PACKINGS: Final = (".gz", ".zst")


@dataclass(frozen=True, slots=True)
class WriteFormat:
    """One format that `convert` writes.

    Attributes:
        name: as in `ReadFormat.name`.
        endings: of the output, the first being the usual one.
        packed_outside: whether .gz or .zst may follow; the others are packed inside.
        cannot: what it cannot hold, in the words in which `convert` counts it.
    """

    name: str
    endings: tuple[str, ...]
    packed_outside: bool = True
    cannot: tuple[str, ...] = ()


GAPS: Final = "gaps in the recording"
MARKS: Final = "marks of a contradictory length"
BUS_NAMES: Final = "bus names"
ERROR_CONTENTS: Final = "contents of error frames"
NO_TIMES: Final = "that there are no times"
NO_DATES: Final = "that the times are no dates"
BIT_RATES: Final = "bit rates"
ATTACHED: Final = "attached descriptions and device files"
RECORDER_MARKS: Final = "moments that the recorder marked"
REDACTED: Final = "that payloads are redacted"
LEARNED: Final = "what the recorder had learned of devices"
ADAPTERS: Final = "how well clocks of adapters were known"
_FOREIGN: Final = (GAPS, NO_TIMES, ATTACHED, RECORDER_MARKS, REDACTED, LEARNED, ADAPTERS)

WRITE_FORMATS: Final = (
    WriteFormat("mcap", (".mcap",), packed_outside=False),
    WriteFormat(
        "candump",
        (".log", ".candump", ".txt"),
        cannot=(*_FOREIGN, NO_DATES, BIT_RATES, MARKS),
    ),
    WriteFormat("asc", (".asc",), cannot=(*_FOREIGN, BIT_RATES, MARKS, BUS_NAMES, ERROR_CONTENTS)),
    WriteFormat(
        "blf", (".blf",), packed_outside=False, cannot=(*_FOREIGN, BIT_RATES, MARKS, BUS_NAMES)
    ),
    WriteFormat("trc", (".trc",), cannot=(*_FOREIGN, BIT_RATES, MARKS, BUS_NAMES, ERROR_CONTENTS)),
    WriteFormat("pcapng", (".pcapng",), cannot=(*_FOREIGN, NO_DATES, MARKS)),
    WriteFormat(
        "csv",
        (".csv",),
        cannot=(*_FOREIGN, NO_DATES, BIT_RATES, MARKS, BUS_NAMES),
    ),
    WriteFormat("parquet", (".parquet",), packed_outside=False, cannot=(*_FOREIGN, BIT_RATES)),
)
"""All that `convert` writes."""


def output_format(output: Path) -> WriteFormat:
    """The format that a file's ending names.

    >>> output_format(Path("a.log.gz")).name
    'candump'

    Raises:
        UsageError: the ending names none, or one that is packed inside already.
    """
    packed = output.suffix.lower() in PACKINGS
    ending = (output.with_suffix("") if packed else output).suffix.lower()
    form = next((each for each in WRITE_FORMATS if ending in each.endings), None)
    if form is None:
        known = ", ".join(each.endings[0] for each in WRITE_FORMATS)
        raise UsageError(f"{output}: the ending names no format that can be written: use {known}")
    if packed and not form.packed_outside:
        raise UsageError(
            f"{output}: {form.name} is packed inside; leave out the {output.suffix.lower()}"
        )
    return form
