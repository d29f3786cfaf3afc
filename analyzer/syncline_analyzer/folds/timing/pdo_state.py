"""What is kept of one PDO identifier from block to block."""

from dataclasses import field

from syncline_analyzer.distribution import Distribution
from syncline_analyzer.folds.timing.extremes import Extremes
from syncline_analyzer.folds.timing.overdue import Overdue
from syncline_analyzer.folds.timing.periods import Periods
from syncline_analyzer.folds.timing.phase import Phase
from syncline_analyzer.folds.timing.repeats import Repeats
from syncline_analyzer.folds.timing.request_answers import RequestAnswers
from syncline_analyzer.folds.timing.requested import Requested
from syncline_analyzer.folds.timing.rhythm import Missed, Rhythm
from syncline_analyzer.folds.timing.slips import Slips
from syncline_analyzer.object_history import Known
from syncline_analyzer.pdo_binding import Pdo, Transmission
from syncline_analyzer.series import Thinner
from syncline_schemas.records import dataclass

_SEEN = ("sdo-read", "sdo-write", "bus-description")
"""Sources of a setting that hold for this very device."""
_SMALL_SPREAD = 0.25
"""Interquartile range of the response, as a share of the SYNC period, of a synchronous PDO."""
_OTHER_TIMER = 0.1
"""A period that differs by more than this share from the event timer is not made by it."""
_SAME_TIMER = 0.02
"""A steady period that differs by no more than this share from an event timer is made by it."""
_CYCLIC = 0.1
"""Interquartile range of the period of a cyclic PDO, as a share of the median."""
_KEEPS_TO_SYNC = 3.0
"""So much more than the response the period must spread: 1.4 come from independent jitter alone."""
MOST_REPEATS = 255
"""More equal frames in a row no repeat counter (280xh, eight bits) allows."""
PROVE_TIMER = 3
"""Frames that bring nothing new, from which on a timer sends them; changes would not."""
MAX_RESPONSES = 100_000
"""Responses of one PDO that are kept one by one."""


@dataclass(frozen=True, slots=True)
class Pause:
    """A long time between two frames of a PDO; `end_seq` is None where it did not come again."""

    start_ns: int
    end_ns: int
    start_seq: int
    end_seq: int | None


@dataclass(slots=True)
class PdoState:
    """A PDO identifier from block to block, and what its row is made of."""

    frames: int = 0
    last_ns: int | None = None
    last_seq: int = 0
    periods: Periods = field(default_factory=Periods)
    response: Distribution = field(default_factory=Distribution)
    slowest: Extremes = field(default_factory=lambda: Extremes(both=False))
    """Of the responses."""
    device_low: Distribution = field(default_factory=lambda: Distribution(moments=False))
    device_high: Distribution = field(default_factory=lambda: Distribution(moments=False))
    extra: int = 0
    extra_alone: int = 0
    """Those beside which no SYNC went unanswered, so that none is a late or early answer."""
    late: int = 0
    rhythm: Rhythm = field(default_factory=Rhythm)
    slips: Slips = field(default_factory=Slips)
    answered: int = 0
    """SYNCs that it answered."""
    phase: Phase = field(default_factory=Phase)
    overdue: Overdue = field(default_factory=Overdue)
    past_deadline: Missed = field(default_factory=Missed)
    """Moments at which an RPDO should have come by its deadline."""
    responses: Thinner = field(default_factory=lambda: Thinner("response", MAX_RESPONSES))
    """The single ones, and what is known of each [ns]."""
    owner: Pdo | None = None
    transmission: Transmission | None = None
    bound_version: int | None = None
    """Version of the shadow with which owner and transmission were looked up; see `settled`."""
    changed_seq: int = 0
    """`seq` since which `transmission` holds."""
    sync_cob_id: int = 0x80
    window_ns: int | None = None
    """Synchronous window length (1007h) of its node, if it sends the PDO; None without one."""
    off: bool = False
    """Its owner has switched it off (bit 31 of 180xh:1), or gave it another identifier."""
    repeats: Repeats = field(default_factory=Repeats)
    """Frames with the same data as the one before: no change of the value made the device send."""
    asked: int = 0
    """Remote frames that asked for it, or empty frames as which some loggers write these down."""
    requested: Requested = field(default_factory=Requested)
    request_answers: RequestAnswers = field(default_factory=RequestAnswers)
    pauses: list[Pause] = field(default_factory=list)
    extra_seq: list[int] = field(default_factory=list)
    extra_ns: list[int] = field(default_factory=list)
    """Stamps of the first and the last of these."""
    too_soon: int = 0
    too_soon_seq: list[int] = field(default_factory=list)
    too_soon_ns: list[int] = field(default_factory=list)
    broken_inhibit_ns: int | None = None
    """Inhibit time that the last of these came too soon for: it may hold no longer."""

    @property
    def period(self) -> Distribution:
        """Of all its periods."""
        return self.periods.spread

    def told_inhibit_ns(self) -> int | None:
        """Inhibit time of an event-driven TPDO that the bus or the user told; None without one."""
        inhibit = self.transmission.inhibit_100us if self.transmission else None
        if self.told_type() not in (0xFE, 0xFF) or inhibit is None or inhibit.source not in _SEEN:
            return None
        value = inhibit.value
        return value * 100_000 if isinstance(value, int) and value else None

    def polled(self) -> bool:
        """Whether it is sent because it is asked for: then nothing is due without a request."""
        return 2 * self.asked >= self.frames > 0

    def sent_by_timer(self) -> bool:
        """Whether most frames bring nothing new, so that no change of the value sends them."""
        return 2 * self.repeats.count >= self.frames > 0

    def told_type(self) -> int | None:
        """Transmission type that the bus or the user told; a device's default does not count."""
        known = self.transmission.type if self.transmission else None
        if known is None or known.source == "eds-default" or not isinstance(known.value, int):
            return None
        return known.value if self.owner is not None and self.owner.kind == "tpdo" else None

    def told_timer_ns(self) -> int | None:
        """Event timer of a cyclic TPDO that the bus or the user told, None when 0 or not in use."""
        timer = self.transmission.event_timer_ms if self.transmission else None
        if self.told_type() not in (0xFE, 0xFF) or timer is None or timer.source == "eds-default":
            return None
        return timer.value * 1_000_000 if isinstance(timer.value, int) and timer.value else None

    def kept_timer_ns(self) -> int | None:
        """Event timer of a TPDO that only the device's EDS tells, where the frames keep to it."""
        timer = self.transmission.event_timer_ms if self.transmission else None
        if self.owner is None or self.owner.kind != "tpdo" or self.owner.guess or timer is None:
            return None
        if timer.source != "eds-default" or not isinstance(timer.value, int):
            return None
        timer_ns = timer.value * 1_000_000
        off_ns = abs(self.period.quantile(0.5) - timer_ns)
        return timer_ns if timer_ns and off_ns <= _SAME_TIMER * timer_ns and self.cyclic() else None

    def may_stand_still(self, counter: Known | None) -> bool:
        """Whether only the EDS tells its event timer, and a value that stands still may end it.

        A repeat counter that nobody read may end equal frames; and where every frame brought another
        value, changes may have sent them all.
        """
        if self.told_timer_ns() is not None:
            return False
        unread = counter is not None and counter.source == "eds-default"
        counted = unread and self.repeats.longest <= MOST_REPEATS
        return counted or self.repeats.count < PROVE_TIMER

    def told_deadline_ns(self) -> int | None:
        """Time within which the node wants to receive an RPDO (140xh:5), as the bus or user told."""
        timer = self.transmission.event_timer_ms if self.transmission else None
        if self.owner is None or self.owner.kind != "rpdo" or self.owner.guess or timer is None:
            return None
        if timer.source not in _SEEN or not isinstance(timer.value, int):
            return None
        return timer.value * 1_000_000 or None

    def answers_sync(self, sync_period_ns: float) -> int | None:
        """n when the frames follow every n-th SYNC closely enough to answer it."""
        known = self.transmission.type if self.transmission else None
        default = known.value if known is not None and known.source == "eds-default" else None
        every = self.rhythm.every(default if isinstance(default, int) else None)
        if every is None or not self.response.count:
            return None
        most_ns = _SMALL_SPREAD * sync_period_ns
        narrow = self.response.maximum - self.response.minimum <= most_ns
        return every if narrow or _spread(self.response) <= most_ns else None

    def cyclic(self) -> bool:
        """Whether its period is steady (analysis.md section 5)."""
        median = self.period.quantile(0.5)
        return median > 0 and _spread(self.period) < _CYCLIC * median

    def timer_excluded(self, resolution_ns: int) -> bool:
        """Whether no event timer of the device's own can have sent the frames.

        The timer is known to be off or of another length, or the frames keep to the SYNC while the
        SYNC itself wavers. A steady SYNC proves nothing: a timer of n periods looks the same.
        """
        timer = self.transmission.event_timer_ms if self.transmission else None
        if timer is not None and isinstance(timer.value, int):
            timer_ns = timer.value * 1_000_000
            if abs(self.period.quantile(0.5) - timer_ns) > _OTHER_TIMER * timer_ns:
                return True
        kept = max(_spread(self.response), resolution_ns)
        return _spread(self.period) >= _KEEPS_TO_SYNC * kept


def _spread(values: Distribution) -> float:
    """Interquartile range."""
    return values.quantile(0.75) - values.quantile(0.25)
