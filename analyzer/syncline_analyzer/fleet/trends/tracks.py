"""One quantity of all nodes over the days: what trends are judged from."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from syncline_analyzer.fleet.quantities import QUANTITIES
from syncline_analyzer.fleet.trends.limits import LIMITS, MIN_SIDE, SEPARATION
from syncline_analyzer.fleet.trends.statistics import Bools, Floats, Ints
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    import pandas as pd

DAY_NS = 86_400 * 10**9
MAX_BINS = 128
"""Longer spans are divided into bins of several days."""
_MAX_SWITCHES = 3
"""A recorder that changes more often is one of several that are used in turn."""
_OTHER_LENGTH = 1.25
"""Captures that are so many times as long from a day on are others."""
COLUMNS = (
    "machine", "capture_id", "bus", "node", "part", "amount", "over", "reading",
    "begun_ns", "duration_ns", "recorder", "resolution_us", "name", "device", "serial",
)  # fmt: skip
"""Of the rows that tracks are made from; a row per capture and node (or PDO, or trace)."""


class Label(NamedTuple):
    """What a track is of."""

    machine: str
    bus: str
    node: int | None
    part: str
    name: str | None
    device: str | None


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """One quantity of all nodes of all machines, by day. Matrices are (tracks, bins).

    Attributes:
        quantity: name in `QUANTITIES`.
        labels: what the tracks are of.
        group: of each track the number of its fleet: same bus, node, part and device; (tracks,).
        begin_ns: when the first bin begins, midnight UTC.
        bin_ns: length of a bin, whole days.
        value: median of the captures that began in a bin; of what is counted the rate; NaN: none.
        amount, over: what was counted, and in which time; zero where nothing was recorded.
        epoch: grows by one where something else was measured: another device, another recorder.
        captures: how many began in the bin.
        first, last: number of the first and the last capture of a bin, -1: none.
        capture_id, begun_ns: of the captures, by number.
        reading: last reading of a counter in the bin, NaN: none.
    """

    quantity: str
    labels: Sequence[Label]
    group: Ints
    begin_ns: int
    bin_ns: int
    value: Floats
    amount: Floats
    over: Floats
    epoch: Ints
    captures: Ints
    first: Ints
    last: Ints
    capture_id: Sequence[str]
    begun_ns: Ints
    reading: Floats

    @property
    def weekend(self) -> Bools:
        """Which bins are a Saturday or Sunday; none where bins are longer than a day; (bins,)."""
        days = self.begin_ns // DAY_NS + np.arange(self.value.shape[1])
        return (((days + 3) % 7) >= 5) & (self.bin_ns == DAY_NS)


def tracks_of(quantity: str, rows: "pd.DataFrame") -> Tracks | None:
    """Tracks of the rows of a quantity with the columns of `COLUMNS`; None without rows."""
    import pandas as pd

    rows = rows[rows["amount"].notna() | rows["reading"].notna()]
    if rows.empty:
        return None
    rows = rows.sort_values(["begun_ns", "capture_id"], kind="stable").reset_index(drop=True)
    keys = [rows[each] for each in ("machine", "bus", "node", "part")]
    track = pd.Series(keys[0].groupby(keys, dropna=False, sort=True).ngroup().to_numpy())
    begin = int(rows["begun_ns"].iloc[0]) // DAY_NS
    days = int(rows["begun_ns"].iloc[-1]) // DAY_NS - begin + 1
    width = -(-days // MAX_BINS)
    bins = -(-days // width)
    day = ((rows["begun_ns"] // DAY_NS - begin) // width).to_numpy(np.int64)
    shape = (int(track.max()) + 1, bins)
    cell = track.to_numpy(np.int64) * bins + day
    capture, ids = pd.factorize(rows["capture_id"])
    begun = np.zeros(len(ids), np.int64)
    begun[capture] = rows["begun_ns"].to_numpy()
    known = rows["amount"].notna().to_numpy()
    amount = _summed(cell[known], rows["amount"].to_numpy(np.float64)[known], shape)
    over = _summed(cell[known], rows["over"].to_numpy(np.float64, na_value=0.0)[known], shape)
    epoch = _epochs(quantity, rows, track)
    labels = _labels(rows, track)
    return Tracks(
        quantity,
        labels,
        _groups(labels),
        begin * DAY_NS,
        width * DAY_NS,
        _values(quantity, cell, rows, amount, over),
        amount,
        over,
        _filled(_last(cell, epoch, shape)),
        _counted(cell, shape),
        _first(cell, capture, shape),
        _last(cell, capture, shape),
        [str(each) for each in ids],
        begun,
        _readings(cell, rows, shape),
    )


def _values(
    quantity: str, cell: Ints, rows: "pd.DataFrame", amount: Floats, over: Floats
) -> Floats:
    if QUANTITIES[quantity].kind != "level":
        return np.divide(amount, over, out=np.full_like(over, np.nan), where=over > 0)
    value = np.full(amount.size, np.nan)
    median = rows["amount"].groupby(cell).median()
    value[median.index.to_numpy()] = median.to_numpy(np.float64)
    return value.reshape(amount.shape)


def _summed(cell: Ints, values: Floats, shape: tuple[int, int]) -> Floats:
    summed = np.bincount(cell, values, shape[0] * shape[1])
    return summed.astype(np.float64).reshape(shape)


def _counted(cell: Ints, shape: tuple[int, int]) -> Ints:
    return np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape)


def _last(cell: Ints, values: Ints, shape: tuple[int, int]) -> Ints:
    """Of each bin the value of its last row, -1 without any."""
    found = np.full(shape[0] * shape[1], -1, np.int64)
    found[cell] = values  # Rows are in order of time.
    return found.reshape(shape)


def _first(cell: Ints, values: Ints, shape: tuple[int, int]) -> Ints:
    return _last(cell[::-1], values[::-1], shape)


def _filled(epoch: Ints) -> Ints:
    """Bins without captures belong to the epoch before."""
    return np.maximum.accumulate(np.maximum(epoch, 0), axis=1)


def _readings(cell: Ints, rows: "pd.DataFrame", shape: tuple[int, int]) -> Floats:
    found = np.full(shape[0] * shape[1], np.nan)
    told = rows["reading"].to_numpy(np.float64, na_value=np.nan)
    kept = np.isfinite(told)
    found[cell[kept]] = told[kept]
    return found.reshape(shape)


def _labels(rows: "pd.DataFrame", track: "pd.Series[int]") -> list[Label]:
    last = rows.groupby(track.to_numpy()).last()
    return [
        Label(
            str(row.machine),
            str(row.bus),
            _whole(row.node),
            str(row.part),
            _text(row.name),
            _text(row.device),
        )
        for row in last[["machine", "bus", "node", "part", "name", "device"]].itertuples(
            index=False, name="Row"
        )
    ]


def _whole(value: object) -> int | None:
    return int(value) if isinstance(value, int | np.integer) else None


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None


def _groups(labels: Sequence[Label]) -> Ints:
    numbers: dict[tuple[object, ...], int] = {}
    keys = [(each.bus, each.node, each.part, each.device) for each in labels]
    return np.array([numbers.setdefault(key, len(numbers)) for key in keys], np.int64)


def _epochs(quantity: str, rows: "pd.DataFrame", track: "pd.Series[int]") -> Ints:
    """Of each row how often something else came to be measured before it; (rows,)."""
    limits = LIMITS[quantity]
    changed = _switches(rows["device"], track) | _switches(rows["serial"], track)
    if QUANTITIES[quantity].kind == "growth":
        changed |= (rows["reading"].groupby(track).diff() < 0).to_numpy()
    if limits.clock:
        recorder = rows["recorder"].fillna("") + rows["resolution_us"].map("|{:.1g}".format)
        switched = _switches(recorder, track)
        often = track.map(track[switched].value_counts()).fillna(0) > _MAX_SWITCHES
        changed |= switched & ~often.to_numpy()
    if limits.length:
        changed |= _other_lengths(rows, track)
    epoch = np.zeros(len(rows), np.int64)
    for members in _members(track):
        epoch[members] = changed[members].cumsum()
    return epoch


def _members(track: "pd.Series[int]") -> list[Ints]:
    order = np.argsort(track.to_numpy(), kind="stable")
    ends = np.flatnonzero(np.diff(track.to_numpy()[order])) + 1
    return np.split(order, ends)


def _switches(told: "pd.Series[str]", track: "pd.Series[int]") -> Bools:
    """Rows that tell another thing than the last row of their track that told any; (rows,)."""
    before = told.groupby(track).ffill().groupby(track).shift()
    return (told.notna() & before.notna() & (told != before)).to_numpy()


def _other_lengths(rows: "pd.DataFrame", track: "pd.Series[int]") -> Bools:
    """The first row of each track from which on its captures are much longer or shorter; (rows,)."""
    found = np.zeros(len(rows), np.bool_)
    length = np.log(np.maximum(rows["duration_ns"].to_numpy(np.float64), 1.0))
    for members in _members(track):
        at = _cut(length[members])
        if at:
            found[members[at]] = True
    return found


def _cut(lengths: Floats) -> int:
    """Where lengths (logarithms) become others for good; 0 where they do not."""
    if len(lengths) < 2 * MIN_SIDE or np.ptp(lengths) < np.log(_OTHER_LENGTH):
        return 0
    place = np.arange(MIN_SIDE, len(lengths) - MIN_SIDE + 1)
    early = lengths.cumsum()[place - 1]
    mean_early, mean_late = early / place, (lengths.sum() - early) / (len(lengths) - place)
    at = int(place[np.argmax((mean_late - mean_early) ** 2 * place * (len(lengths) - place))])
    before, after = lengths[:at], lengths[at:]
    difference = float(np.median(after) - np.median(before))
    apart = np.sign(after[:, None] - before) == np.sign(difference)
    other = abs(difference) >= np.log(_OTHER_LENGTH) and apart.mean() >= SEPARATION
    return at if other else 0
