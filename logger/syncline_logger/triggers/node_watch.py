"""One node: its states, boot-ups, silences and errors as they happen (analysis.md 4 and 6)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from statistics import median

from syncline_logger.triggers.event import Event
from syncline_logger.triggers.knowledge import Knowledge
from syncline_logger.triggers.quiet import BusQuiet
from syncline_schemas.canopen.nmt import STATE_AFTER_COMMAND, STATE_OF_BYTE, NmtState
from syncline_schemas.devices import emcy_meaning
from syncline_schemas.emcy_errors import ErrorList

LOST_FACTOR = 1.5
"""Heartbeat periods without a message after which a node is lost (analysis.md 4)."""
MIN_PERIODS = 3
WINDOW = 32
"""Periods of which the median is taken."""
MISSED_GUARDS = 2
"""Guard requests in a row without an answer that make a node lost; a single one may go astray."""
RESTART_NS = 10_000_000_000
"""A silence that a boot-up ends is a restart up to this length, longer ones are losses [ns]."""
RESET_WINDOW_NS = 10_000_000_000
"""A boot-up this long after a reset command is still its effect [ns]."""
PAIR_NS = 150_000_000
"""A second boot-up this soon after the first belongs to the same start [ns]."""
RESET_QUIET_NS = 4_000_000_000
"""Silence after a reset command that is not held against a node of unknown make [ns]."""
RESET_MARGIN_NS = 1_000_000_000
BOOT_UP_NS = 1_000_000_000
"""A boot-up this soon after a loss belongs to it [ns]."""
GUARD_ANSWER_NS = 50_000_000
STATES_SINCE = 2
"""States told since a remote frame that show that it has not emptied the heartbeats."""
EMCY_BYTES = 8
ALIKE = 3
"""So many long intervals of one length in a row are a period, not silences."""
ALIKE_FACTOR = 1.2


@dataclass(slots=True)
class NodeWatch:
    """What is known of a node; every method takes what happened in the order of the frames.

    `heard_ns` is the node's last sign of life since a gap, None where there is none.
    """

    bus: int
    node: int
    knowledge: Knowledge
    quiet: BusQuiet
    heard_ns: int | None = None
    state: NmtState | None = None
    _errors: ErrorList = field(init=False)
    _periods: list[int] = field(default_factory=list)
    _beat_ns: int | None = None
    _guarded: bool = False
    _requests: int = 0
    _request_ns: int | None = None
    _reset_ns: int | None = None
    _last_reset_ns: int | None = None
    _booted_ns: int | None = None
    _known: bool = False
    _blind: bool = False
    _lost_ns: int | None = None
    """When the present loss was told, or the last one ended."""
    _silence: tuple[int, int] | None = None
    """The silence that the present frame ends, where it was too long."""
    _run: list[Event] = field(default_factory=list)
    """Losses one after the other without a frame between, which may be a new period."""
    _run_ends: tuple[int, int] = (0, 0)
    """The last of these silences."""
    _asked: bool = False
    """Whether a remote frame came since the last start: it may have emptied the heartbeats."""
    _since_asked: int = 0
    _emptied: bool = False
    _spoke: bool = False

    def __post_init__(self) -> None:
        self._errors = ErrorList(None)

    def limit_ns(self) -> int | None:
        """Silence after which the node is lost; None while nobody can tell.

        1016h of a consumer, else 1.5 x 1017h, else 1.5 x the median period; a guarded node only
        while it is asked (analysis.md 4).
        """
        usual = int(median(self._periods)) if len(self._periods) >= MIN_PERIODS else None
        if self._beat_ns is None or self.heard_ns is None:
            return None
        if self._guarded:
            if self._requests < MISSED_GUARDS or usual is None:
                return None
            limit = round(LOST_FACTOR * usual)
            return max(limit, (self.knowledge.life_ms(self.node) or 0) * 1_000_000)
        producer = self.knowledge.producer_ms(self.node, self.heard_ns, usual or 0)
        if producer == 0:
            return None
        consumer = self.knowledge.consumer_ms(self.node)
        if consumer is not None and (usual is None or consumer * 1_000_000 > usual):
            return consumer * 1_000_000
        if producer is not None and round(LOST_FACTOR * producer * 1e6) > (usual or 0):
            return round(LOST_FACTOR * producer * 1e6)
        return None if usual is None else round(LOST_FACTOR * usual)

    def gap(self) -> None:
        """The recorder was blind: nothing follows from the time between the frames around it."""
        self.heard_ns = self._beat_ns = self._request_ns = self._silence = None
        self._reset_ns = self._booted_ns = None
        self._requests = 0
        self._blind = True
        self._lost_ns = None
        self._run.clear()
        self.state = None

    def command(self, t_ns: int, specifier: int, log_ns: int) -> Iterator[Event]:
        """An NMT command to the node or to all."""
        state = STATE_AFTER_COMMAND.get(specifier)
        if state is NmtState.INITIALISING:
            self._reset_ns = self._last_reset_ns = t_ns
            self._asked = self._emptied = False
        elif state is not None and len(self._periods) < MIN_PERIODS and self._known:
            yield from self._enter(state, t_ns, log_ns)

    def silent_until(self, t_ns: int, log_ns: int, *, over: bool = False) -> Iterator[Event]:
        """The node was not heard until now, while the bus was; the same at the end (`over`)."""
        if over:
            yield from self._flush()
        limit = self.limit_ns()
        if limit is None or self._lost_ns is not None or self.heard_ns is None:
            return
        passed = t_ns - self.heard_ns
        if passed > limit and (over or passed > RESTART_NS) and self._is_own(t_ns, limit):
            yield self._lost(self.heard_ns + limit, log_ns, limit)

    def heard(self, before_ns: int, t_ns: int, log_ns: int, *, boots: bool) -> Iterator[Event]:
        """A frame of the node after a long time; `boots` says that it is a boot-up."""
        self.heard_ns = before_ns
        limit = self.limit_ns()
        self.heard_ns = t_ns
        self._silence = None
        if limit is None or t_ns - before_ns <= limit:
            return
        self.heard_ns = before_ns
        own = self._is_own(t_ns, limit)
        self.heard_ns = t_ns
        if self._lost_ns is not None or not own:
            return
        if boots and t_ns - before_ns <= RESTART_NS:
            self._silence = (before_ns, t_ns)
        elif boots:
            yield self._lost(before_ns + limit, log_ns, limit)
        else:
            yield from self._came_back(before_ns, t_ns, log_ns, limit)

    def back(self, t_ns: int) -> Iterator[Event]:
        """Frames of the node came, the last one now."""
        self._lost_ns = None
        self.heard_ns = t_ns
        if self._run and t_ns > self._run_ends[1]:
            yield from self._flush()

    def _came_back(self, start_ns: int, end_ns: int, log_ns: int, limit: int) -> Iterator[Event]:
        """A loss that is over; several alike that follow one another are a new, longer period."""
        began, ended = self._run_ends
        lengths = (ended - began, end_ns - start_ns)
        if start_ns != ended or max(lengths) >= ALIKE_FACTOR * min(lengths):
            yield from self._flush()
        self._run.append(self._lost(start_ns + limit, log_ns, limit))
        self._run_ends = (start_ns, end_ns)

    def _flush(self) -> Iterator[Event]:
        """Tell the losses that turned out to be some, now that the node goes on as before."""
        run, self._run = self._run, []
        yield from run if len(run) < ALIKE else ()

    def beat(self, t_ns: int) -> None:
        """A state was told; only its time counts here."""
        if self._beat_ns is not None and t_ns > self._beat_ns:
            self._periods.append(t_ns - self._beat_ns)
            del self._periods[:-WINDOW]
        self._beat_ns = t_ns

    def restarted(self) -> None:
        """The next state is told any time after a boot-up."""
        self._beat_ns = None

    def forget_periods(self) -> None:
        """1017h was written: the periods so far say nothing any more."""
        self._periods.clear()
        self._beat_ns = None

    def request(self, t_ns: int) -> None:
        """A remote frame asks for the node's state."""
        self._requests += 1
        self._request_ns = t_ns
        self._asked, self._since_asked = True, 0

    def told(self, byte: int, t_ns: int, log_ns: int) -> Iterator[Event]:
        """The node tells its state in one byte."""
        answer = self._request_ns is not None and t_ns - self._request_ns <= GUARD_ANSWER_NS
        if answer:
            self._guarded, self._requests, self._request_ns = True, 0, None
        elif self._guarded and not byte & 0x80:
            self._guarded = False
        self._since_asked += 1
        state = STATE_OF_BYTE.get(byte & 0x7F)
        self._spoke = True
        if state is not None and state is not NmtState.INITIALISING:
            yield from self._enter(state, t_ns, log_ns)

    def zero(self, t_ns: int, log_ns: int, before_ns: int | None) -> Iterator[Event]:
        """A byte 00h: a boot-up, unless a remote frame has emptied the heartbeats of the node."""
        if self.is_boot_up():
            yield from self._boot_up(t_ns, log_ns, before_ns)
        else:
            self._emptied = True

    def is_boot_up(self) -> bool:
        """Whether a byte 00h that comes now is a boot-up."""
        if not self._asked or not self._spoke or (self._guarded and not self._emptied):
            return True
        return self._since_asked >= STATES_SINCE and not self._emptied

    def emcy(self, data: bytes, t_ns: int, log_ns: int) -> Iterator[Event]:
        """An EMCY: an event where it raises an error that is not there yet."""
        if len(data) < EMCY_BYTES:
            return
        code = int.from_bytes(data[:2], "little")
        known = self.knowledge.nodes.get(self.node)
        self._errors.device = device = known.device if known else None
        if code >> 8:
            again = self._errors.ended_unseen(code, data)
            if again is not None:
                self._errors.active.remove(again)
            error, fresh = self._errors.raised(code, data, t_ns)
            if error is not None and fresh:
                meaning = emcy_meaning(device, code)
                text = f"node {self.node}: EMCY {code:04X}h {meaning}"
                yield Event("emcy", t_ns, log_ns, text, self.bus, self.node, code)
        else:
            gone = self._errors.ended_by(data)
            left = [] if gone is None else [e for e in self._errors.active if e not in gone]
            self._errors.active[:] = left
        self._errors.remember(data)

    def _boot_up(self, t_ns: int, log_ns: int, before_ns: int | None) -> Iterator[Event]:
        repeated = self._booted_ns is not None and 0 <= t_ns - self._booted_ns <= PAIR_NS
        repeated = repeated and self._reset_ns is None
        if not self._explained(t_ns, before_ns) and not repeated:
            text = f"node {self.node}: boot-up that nobody commanded"
            yield Event("boot-up", t_ns, log_ns, text, self.bus, self.node)
        if not repeated:
            self._errors.active.clear()
            self.knowledge.restart(self.node, t_ns)
        self._errors.forget()
        self._booted_ns, self._reset_ns, self._blind = t_ns, None, False
        self._asked = self._emptied = False
        yield from self._enter(NmtState.PRE_OPERATIONAL, t_ns, log_ns)

    def _explained(self, t_ns: int, before_ns: int | None) -> bool:
        """Whether a boot-up is no restart of the node's own accord, or nobody can tell."""
        if self._blind or not self._known or self._lost_ns is not None or before_ns is None:
            return True
        if self._reset_ns is not None and t_ns - self._reset_ns <= RESET_WINDOW_NS:
            return True
        recent = self._last_reset_ns is not None and t_ns - self._last_reset_ns <= RESET_WINDOW_NS
        if recent and self._silence is None:
            return True
        return self.quiet.switched_off(before_ns, t_ns)

    def _enter(self, state: NmtState, t_ns: int, log_ns: int) -> Iterator[Event]:
        self._known = True
        before, self.state = self.state, state
        if before is not None and before is not state:
            text = f"node {self.node}: {before.value} -> {state.value}"
            yield Event("nmt", t_ns, log_ns, text, self.bus, self.node, state)

    def _lost(self, t_ns: int, log_ns: int, limit: int) -> Event:
        self._lost_ns = t_ns
        text = f"node {self.node}: lost, silent for more than {limit / 1e9:.3f} s"
        return Event("node-lost", t_ns, log_ns, text, self.bus, self.node)

    def _is_own(self, t_ns: int, limit: int) -> bool:
        """Whether a silence is the node's, not that of a start or of everybody."""
        assert self.heard_ns is not None
        if self._reset_ns is not None and self._reset_ns >= self.heard_ns - RESET_MARGIN_NS:
            known = self.knowledge.quirks(self.node).reset_quiet_ms * 1_000_000
            if t_ns - self._reset_ns <= (known or RESET_QUIET_NS) + RESET_MARGIN_NS:
                return False
        return not self.quiet.whole_bus(self.heard_ns, t_ns, limit)
