"""Which finding can be the consequence of which: the causal knowledge behind the stories.

A bond states place and time; that two things stand side by side is not enough. Where a finding
gathers events of a long time, only frames that both rest on join them.
"""

from syncline_analyzer.results import Finding
from syncline_schemas.records import dataclass

_S = 1_000_000_000
_FOREVER = 1 << 62
_SPAN_NS = 120 * _S
"""A cause that lasts longer may gather several events: only what begins with it follows from it."""


@dataclass(frozen=True, slots=True)
class Bond:
    """That one kind of finding can be the consequence of another.

    Attributes:
        cause, effect: ids of the findings.
        after_ns: the effect begins no later than this after the cause ended.
        before_ns: nor earlier than this before the cause was seen to begin.
        same_node: whether both must be about one node; else about one bus.
        lasting: whether the effect may go on long after the cause, as an active error does.
        lifelong: whether the cause holds at any time from its beginning on.
        shared: whether both must rest on a common frame; time is then not asked.
        opens: whether the cause must rest on the effect's first frame; time is then not asked.
    """

    cause: str
    effect: str
    after_ns: int = _S
    before_ns: int = _S
    same_node: bool = True
    lasting: bool = False
    lifelong: bool = False
    shared: bool = False
    opens: bool = False

    def holds(self, cause: Finding, effect: Finding) -> bool:
        """Whether the effect follows from the cause by place, and by time or frames."""
        if (cause.id, effect.id) != (self.cause, self.effect) or cause.bus != effect.bus:
            return False
        if self.same_node and (effect.node is None or effect.node not in _nodes(cause)):
            return False
        if self.opens:
            return bool(effect.evidence) and effect.evidence[0] in cause.evidence
        if self.shared:
            return not set(cause.evidence).isdisjoint(effect.evidence)
        return self._in_time(cause, effect)

    def _in_time(self, cause: Finding, effect: Finding) -> bool:
        if effect.start_ns < cause.start_ns - self.before_ns:
            return False
        if self.lifelong:
            return True
        latest_ns = cause.end_ns + self.after_ns
        gathered = cause.end_ns - cause.start_ns > _SPAN_NS
        if effect.start_ns > (cause.start_ns + self.after_ns if gathered else latest_ns):
            return False
        return self.lasting or effect.end_ns <= latest_ns


def _nodes(cause: Finding) -> set[int | None]:
    """Nodes that a finding is about, itself or as a story that several of them share."""
    return {cause.node, *(link.node for link in cause.chain if link.id == cause.id)}


_TRAFFIC = ("pdo.missed", "pdo.stopped", "sdo.no_answer", "sdo.interrupted", "nmt.guard_unanswered")
"""What is missing of a node that is not there."""
_ERRORS_ON_THE_WIRE = ("error.passive", "error.warning_level", "error.frames", "error.no_ack")


def _bonds(cause: str, *effects: str, **how: int | bool) -> tuple[Bond, ...]:
    return tuple(Bond(cause, effect, **how) for effect in effects)  # type: ignore[arg-type]


BONDS: tuple[Bond, ...] = (
    *_bonds(
        "nmt.duplicate_node_id",
        "nmt.unexpected_reset",
        "nmt.boot_loop",
        "nmt.command_ignored",
        "nmt.pdo_outside_operational",
        "nmt.left_operational",
        "nmt.heartbeat_slow",
        "nmt.heartbeat_fast",
        "nmt.heartbeat_irregular",
        "nmt.guard_toggle",
        "nmt.guard_unanswered",
        "nmt.unknown_state",
        "nmt.state_changed",
        "nmt.consumer_time",
        "sdo.doubled_answer",
        "sdo.wrong_answer",
        "sdo.toggle",
        "pdo.extra",
        "pdo.missed",
        "pdo.inhibit_time",
        "pdo.event_timer",
        "angle.jump",
        "angle.preset_by_wire",
        "angle.out_of_range",
        before_ns=10 * _S,
        lifelong=True,
    ),
    *_bonds(
        "error.overrun",
        "sync.missing",
        "pdo.missed",
        "sdo.no_answer",
        "sdo.interrupted",
        "sdo.toggle",
        "nmt.guard_toggle",
        "nmt.guard_unanswered",
        same_node=False,
    ),
    *_bonds("error.bus_off", *_ERRORS_ON_THE_WIRE, before_ns=10 * _S, same_node=False),
    *_bonds("error.passive", "error.warning_level", "error.frames", same_node=False),
    *_bonds(
        "error.bus_off",
        *_TRAFFIC,
        "nmt.node_lost",
        "nmt.unexpected_reset",
        "nmt.left_operational",
        before_ns=2 * _S,
        after_ns=2 * _S,
    ),
    *_bonds("nmt.bus_silent", "bus.silent", "sync.missing", same_node=False),
    *_bonds("bus.silent", "sync.missing", "nmt.node_lost", "sdo.no_answer", same_node=False),
    *_bonds("bus.silent", "pdo.missed", "pdo.stopped", same_node=False),
    *_bonds(
        "bus.overload",
        "pdo.delaying_node",
        "pdo.outranked",
        "pdo.late",
        "pdo.missed",
        "sync.jitter",
        "nmt.heartbeat_irregular",
        "nmt.heartbeat_waited",
        "sdo.late_answer",
        "sdo.no_answer",
        same_node=False,
    ),
    *_bonds(
        "config.heartbeat_consumer",
        "nmt.guarding_lost",
        "nmt.consumer_time",
        lifelong=True,
        before_ns=_FOREVER,
    ),
    *_bonds("nmt.heartbeat_stopped", "nmt.guarding_lost", after_ns=10 * _S, same_node=False),
    *_bonds("nmt.guarding_lost", "nmt.left_operational", shared=True),
    *_bonds("nmt.node_lost", "nmt.guarding_lost", shared=True, same_node=False),
    *_bonds("nmt.unexpected_reset", "nmt.guarding_lost", shared=True, same_node=False),
    *_bonds("nmt.heartbeat_waited", "nmt.guarding_lost", same_node=False),
    *_bonds("nmt.consumer_time", "nmt.guarding_lost", lifelong=True, before_ns=_FOREVER),
    *_bonds("nmt.life_time", "nmt.guarding_lost", lifelong=True, before_ns=_FOREVER),
    *_bonds("nmt.guarding_lost", "pdo.stopped", before_ns=0, after_ns=2 * _S, lasting=True),
    *_bonds(
        "nmt.guarding_lost", *_TRAFFIC, "nmt.pdo_outside_operational", before_ns=0, after_ns=2 * _S
    ),
    *_bonds(
        "device.node_id_change",
        "nmt.node_lost",
        "nmt.no_boot_up",
        "nmt.command_ignored",
        "device.lost_at_reset",
        lifelong=True,
    ),
    *_bonds("device.factory_reset", "nmt.node_lost", "nmt.no_boot_up", "device.lost_at_reset"),
    *_bonds("device.factory_reset", "nmt.no_boot_up", opens=True),
    *_bonds("device.defaults_pending", "nmt.no_boot_up", opens=True),
    *_bonds("device.bit_rate_change", "nmt.node_lost", "nmt.no_boot_up", lifelong=True),
    *_bonds(
        "nmt.boot_loop",
        "nmt.unexpected_reset",
        "nmt.node_lost",
        "emcy.returns_after_reset",
        "device.lost_at_reset",
        "sdo.interrupted",
        shared=True,
    ),
    *_bonds("nmt.node_lost", "emcy.malformed"),
    *_bonds("nmt.node_lost", *_TRAFFIC, "nmt.unexpected_reset", "nmt.no_boot_up", "nmt.slow_boot"),
    *_bonds("nmt.no_boot_up", *_TRAFFIC),
    *_bonds("nmt.unexpected_reset", "emcy.active", "pdo.stopped", after_ns=5 * _S, lasting=True),
    *_bonds("nmt.unexpected_reset", "device.lost_at_reset", *_TRAFFIC, after_ns=5 * _S),
    *_bonds("nmt.command_ignored", "nmt.pdo_outside_operational"),
    *_bonds("emcy.pdo_length", "emcy.storm", "emcy.active", "emcy.intermittent", shared=True),
    *_bonds("emcy.storm", "emcy.active", "emcy.intermittent", "emcy.inhibit_time", shared=True),
    *_bonds("emcy.after_write", "emcy.active", opens=True),
    *_bonds(
        "emcy.active",
        "emcy.intermittent",
        "emcy.returns_after_reset",
        "emcy.partly_cleared",
        "emcy.register_mismatch",
        "nmt.left_operational",
        shared=True,
    ),
    *_bonds("emcy.active", "angle.sensor_alarm", lasting=True),
    *_bonds("emcy.active", "pdo.stopped", after_ns=5 * _S, lasting=True),
    *_bonds("clock.step_forward", "clock.time_jump", "sdo.no_answer", same_node=False),
    *_bonds("emcy.active", "angle.jump"),
    *_bonds("config.sync_producers", "sync.two_producers", same_node=False, lifelong=True),
    *_bonds("nmt.node_lost", "sync.stopped"),
    *_bonds("sync.stopped", "pdo.stopped", same_node=False, lasting=True),
    *_bonds("sync.two_producers", "sync.jitter", "sync.missing", "sync.period", same_node=False),
    *_bonds("sync.two_producers", "pdo.extra", "pdo.missed", same_node=False),
    *_bonds("config.pdo_left_off", "pdo.silent", "pdo.stopped", lifelong=True),
    *_bonds("config.pdo_length", "emcy.pdo_length", lifelong=True, before_ns=_FOREVER),
    *_bonds("config.inhibit_time", "pdo.event_timer", lifelong=True, before_ns=_FOREVER),
    *_bonds("config.cob_id_collision", "config.pdo_length", same_node=False, lifelong=True),
    *_bonds("sdo.block_crc", "sdo.abort", shared=True),
    *_bonds("sync.missing", "pdo.stopped", same_node=False),
    *_bonds("config.mapping_refused", "sdo.abort", "config.pdo_left_off", shared=True),
    *_bonds("config.save_refused", "sdo.abort", shared=True),
    *_bonds("sdo.configuration_failed", "sdo.abort", shared=True),
    *_bonds("sdo.while_stopped", "sdo.no_answer", shared=True),
    *_bonds("sdo.delays_pdo", "pdo.late", shared=True),
    *_bonds("pdo.delaying_node", "pdo.outranked", "pdo.late", shared=True, same_node=False),
    *_bonds("pdo.outranked", "pdo.late", shared=True),
    *_bonds("pdo.deadline", "emcy.active", "emcy.storm", lasting=True),
    *_bonds("nmt.node_lost", "pdo.not_answered"),
    *_bonds(
        "device.wrong_device",
        "angle.jump",
        "angle.scale_assumed",
        "pdo.silent",
        lifelong=True,
        before_ns=_FOREVER,
    ),
    *_bonds("device.defaults_pending", "device.lost_at_reset", lifelong=True),
    *_bonds("device.foreign_identifiers", "pdo.silent", lifelong=True, before_ns=_FOREVER),
    *_bonds(
        "nmt.duplicate_node_id",
        "angle.step",
        "angle.spike",
        "angle.step_unsure",
        before_ns=10 * _S,
        lifelong=True,
    ),
    *_bonds("emcy.active", "angle.step", "angle.spike", "angle.step_unsure"),
    *(
        bond
        for cause in ("angle.step", "angle.jump", "angle.preset_by_wire")
        for bond in _bonds(
            cause, "angle.shafts_parted", after_ns=2 * _S, same_node=False, lasting=True
        )
    ),
    *_bonds(
        "bus.bitrate_contradicted",
        "bus.overload",
        "device.overload_by_settings",
        lifelong=True,
        same_node=False,
        before_ns=_FOREVER,
    ),
)
"""Causes before what follows from them; of several the first one that holds is taken."""
