"""From which size on a trend of a quantity is told, and what it may come from."""

from collections.abc import Mapping
from types import MappingProxyType

from syncline_schemas.records import dataclass

MIN_SIDE = 5
"""Days with captures on either side of a step."""
MIN_DAYS = 10
"""Days with captures of a drift."""
MIN_MACHINES = 8
"""Machines with the same node that are a fleet; with fewer each is judged alone."""
SEPARATION = 0.9
"""Share of pairs of a day before and a day after a step that must differ in its direction."""
RISING = 0.45
"""Share of rising less falling pairs of days of a drift."""
CLEAR_STEP, CLEAR_DRIFT = 2.0, 2.5
"""How many spreads of single days a step, or what a drift amounts to, must have."""
APART = 3.0
"""How many spreads of the fleet's own trends a machine's must have."""
FALSE_DISCOVERIES = 0.01
"""Share of what is told that may be chance."""
MANY = 0.1
"""Share of a fleet with a step of the same days that makes it one finding of the fleet."""
MIN_MANY = 5
RATE_FACTOR, FLEET_RATE_FACTOR = 3.0, 2.0
"""Events come so many times as often after the onset as before: of a machine, of a fleet."""
RATE_EVENTS = 6
"""Events of a track that is judged at all."""
RATE_MORE, RATE_DAYS = 8.0, 4
"""More events after the onset than there would be at the rate before, and days that have some."""
WEAR_DAYS = 365.0
"""A rating that is reached later is no finding."""
ENDURANCE = 100_000
"""Writes that an EEPROM is usually rated for."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Of one quantity.

    Attributes:
        floor: least change that is told, in the quantity's unit; of events per hour.
        share: least change as a share of the value before.
        quantum: spread below which two days never differ.
        clock: whether another recorder, with other stamps, gives other values.
        length: whether short captures give other values than long ones.
        falling: whether a fall is worth telling.
        cause: of a trend of one node.
        check_next: what to check then.
        fleet_cause: of one that many machines share.
    """

    floor: float
    share: float
    quantum: float
    clock: bool
    length: bool
    falling: bool
    cause: str
    check_next: str
    fleet_cause: str


LIMITS: Mapping[str, Limits] = MappingProxyType(
    {
        "pdo-latency": Limits(
            20.0,
            0.05,
            1.0,
            True,
            True,
            True,
            "the node takes longer to answer (firmware, load of its processor), or other frames come"
            " before its answer",
            "compare device time and waiting time of the PDO in the captures before and after,"
            " and what was changed on the bus that day",
            "a new firmware or another PDO configuration that was rolled out",
        ),
        "sync-jitter": Limits(
            20.0,
            0.25,
            1.0,
            True,
            True,
            True,
            "the SYNC producer's cycle is disturbed: load of the master, a changed task time",
            "look at the master's cycle time and what runs beside it",
            "a new version of the master's program",
        ),
        "heartbeat": Limits(
            1.0,
            0.02,
            0.05,
            False,
            False,
            True,
            "1017h was changed, or the node's processor is too busy to keep its heartbeat time",
            "read 1017h of the node and compare it with its consumers' times (1016h)",
            "another heartbeat time that was rolled out",
        ),
        "resets": Limits(
            0.04,
            0.0,
            0.0,
            False,
            False,
            False,
            "supply voltage that breaks down, a loose connector, or a watchdog of the node",
            "measure the supply at the node under load, move connector and cable, read its error"
            " history 1003h",
            "a fault of a firmware that was rolled out, or of the mains",
        ),
        "emcy": Limits(
            0.04,
            0.0,
            0.0,
            False,
            False,
            False,
            "what the EMCY codes of these captures say comes more often",
            "look which codes they are: fleet query --question emcy",
            "a firmware or limits of monitoring that were rolled out, or the season",
        ),
        "eeprom-wear": Limits(
            20.0,
            1.0,
            2.0,
            False,
            False,
            False,
            "the master saves parameters (1010h) more often, perhaps in a cycle",
            "look who writes 1010h, and have it save only after a change",
            "a new version of the master's program that saves more often",
        ),
        "encoder-noise": Limits(
            0.02,
            0.3,
            0.005,
            False,
            True,
            True,
            "the coupling or bearing wears, the disc gets dirty, or the machine shakes at rest",
            "check coupling, bearing and shield of the encoder",
            "the season (temperature), or other standstills of the machines",
        ),
        "bus-load": Limits(
            2.0,
            0.1,
            0.2,
            False,
            True,
            True,
            "nodes were added, or PDOs come more often than before",
            "compare what each identifier takes of the bus before and after (bus_shares)",
            "another configuration that was rolled out",
        ),
    }
)
"""By name of the quantity."""
