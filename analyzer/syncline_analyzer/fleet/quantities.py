"""What of a node is followed over captures, weeks and machines, and from which table it comes."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

Kind = Literal["level", "events", "growth"]


@dataclass(frozen=True, slots=True)
class Quantity:
    """One quantity.

    Attributes:
        meaning: one line on what it is.
        unit: of its values.
        kind: "level" has a value in each capture, and the median of captures stands for all;
            "events" are counted, and "growth" is what a counter grew: the sum of captures divided
            by the time that they cover, so that a long capture counts more than a short one.
        floor: difference that never means anything [unit].
        rows: SQL, a row per capture and node (or PDO, or trace): `machine`, `date`, `capture_id`,
            `bus`, `node`, `part`, `amount` (value, count or growth), `over` (time, in what the
            unit is per; NULL for levels), `samples` (that a level was made from, NULL where it does
            not matter), `reading` (of a counter, else NULL).
        steady: share of the value that never means anything: what a deviation is made from few
            samples differs by itself.
    """

    meaning: str
    unit: str
    kind: Kind
    floor: float
    rows: str
    steady: float = 0.01

    @property
    def value(self) -> str:
        """SQL: what stands for several rows."""
        if self.kind == "level":
            return "median(amount)"
        return 'sum(amount) / nullif(sum("over") FILTER (amount IS NOT NULL), 0)'

    @property
    def single(self) -> str:
        """SQL: the value of one row."""
        return "amount" if self.kind == "level" else 'amount / nullif("over", 0)'


_KEY = "machine, date, capture_id"
_LEVEL = 'NULL::DOUBLE AS "over"'
_NO_READING = "NULL::DOUBLE AS reading"
_HOURS = "greatest(duration_ns - coalesce(blind_ns, 0), 0) / 3.6e12"

PDO_LATENCY = f"""
SELECT {_KEY}, bus, node, coalesce(pdo, format('{{:03X}}h', cob_id)) AS part,
    response_us_median AS amount, {_LEVEL}, answered AS samples, {_NO_READING}
FROM pdos WHERE response_us_median IS NOT NULL
"""
SYNC_JITTER = f"""
SELECT {_KEY}, bus, CASE WHEN len(producer_nodes) = 1 THEN producer_nodes[1] END AS node,
    format('SYNC {{:03X}}h', cob_id) AS part,
    jitter_us_std AS amount, {_LEVEL}, count AS samples, {_NO_READING}
FROM sync WHERE jitter_us_std IS NOT NULL
"""
HEARTBEAT = f"""
SELECT {_KEY}, bus, node, 'heartbeat' AS part,
    period_us_median / 1000 AS amount, {_LEVEL}, count AS samples, {_NO_READING}
FROM error_control_periods WHERE kind = 'heartbeat' AND period_us_median IS NOT NULL
"""
RESETS = f"""
SELECT {_KEY}, bus, node, 'resets' AS part, coalesce(resets, 0)::DOUBLE AS amount,
    {_HOURS} AS "over", NULL::BIGINT AS samples, {_NO_READING}
FROM nodes JOIN captures USING ({_KEY})
LEFT JOIN (
    SELECT {_KEY}, bus, node, count(*) AS resets FROM nmt_states
    WHERE state = 'INITIALISING' AND certainty = 'implied' GROUP BY ALL
) USING ({_KEY}, bus, node)
"""
EMCY = f"""
SELECT {_KEY}, bus, node, 'EMCY' AS part, coalesce(messages, 0)::DOUBLE AS amount,
    {_HOURS} AS "over", NULL::BIGINT AS samples, {_NO_READING}
FROM (SELECT {_KEY}, bus, node FROM nodes) JOIN captures USING ({_KEY})
LEFT JOIN (
    SELECT {_KEY}, bus, node, count(*) AS messages FROM emcy WHERE code <> 0 GROUP BY ALL
) USING ({_KEY}, bus, node)
"""
EEPROM_WEAR = f"""
SELECT {_KEY}, bus, node, part, CASE WHEN grown >= 0 AND days > 0 THEN grown END AS amount,
    days AS "over", NULL::BIGINT AS samples, reading
FROM (
    SELECT {_KEY}, bus, node, what AS part, last_value AS reading,
        last_value - lag(last_value) OVER earlier AS grown,
        (last_ns - lag(last_ns) OVER earlier) / 8.64e13 AS days
    FROM device_health WHERE unit = 'writes' AND "last" IS NOT NULL
    WINDOW earlier AS (PARTITION BY machine, bus, node, index, sub ORDER BY last_ns)
)
"""
ENCODER_NOISE = f"""
SELECT {_KEY}, bus, node, name || format(' {{:04X}}h', object >> 8) AS part,
    noise_deg AS amount, {_LEVEL}, rest_samples AS samples, {_NO_READING}
FROM traces WHERE noise_deg IS NOT NULL AND rest_samples > 0
"""
BUS_LOAD = f"""
SELECT {_KEY}, bus, NULL::BIGINT AS node, 'bus' AS part,
    mean_percent AS amount, {_LEVEL}, NULL::BIGINT AS samples, {_NO_READING}
FROM bus_load WHERE mean_percent IS NOT NULL
"""

QUANTITIES: Mapping[str, Quantity] = MappingProxyType(
    {
        "pdo-latency": Quantity(
            "from a SYNC to the PDO that answers it, median", "us", "level", 2.0, PDO_LATENCY
        ),
        "sync-jitter": Quantity(
            "standard deviation of the times of SYNC", "us", "level", 2.0, SYNC_JITTER, 0.05
        ),
        "heartbeat": Quantity("period of a node's heartbeat", "ms", "level", 0.1, HEARTBEAT),
        "resets": Quantity(
            "starts of a node that nobody commanded, power cuts too", "1/h", "events", 0.0, RESETS
        ),
        "emcy": Quantity("emergency messages that report an error", "1/h", "events", 0.0, EMCY),
        "eeprom-wear": Quantity(
            "writes of a node's EEPROM, between readings of its counter",
            "1/day",
            "growth",
            1.0,
            EEPROM_WEAR,
        ),
        "encoder-noise": Quantity(
            "noise of a position while the shaft is at rest",
            "deg",
            "level",
            0.001,
            ENCODER_NOISE,
            0.1,
        ),
        "bus-load": Quantity("mean load of a bus", "%", "level", 0.5, BUS_LOAD),
    }
)
"""By name."""


def quantity_named(name: str) -> Quantity:
    """Raises: UsageError, there is none of this name."""
    if name not in QUANTITIES:
        raise UsageError(f"there is no quantity '{name}'; there are {', '.join(QUANTITIES)}")
    return QUANTITIES[name]
