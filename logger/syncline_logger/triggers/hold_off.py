"""A storm of the same event is one trigger: the repetitions are counted."""

from collections.abc import Iterator
from dataclasses import dataclass

from syncline_logger.triggers.event import Event, Trigger
from syncline_schemas.wording import counted

HOLD_OFF_NS = 60_000_000_000
"""The same event is no new trigger so soon after the last time that it came [ns]."""
REPEAT_NS = 600_000_000_000
"""A storm is told again after so long [ns]."""
MAX_STORMS = 10_000

Key = tuple[str, int | None, int | None, int | str | None]


@dataclass(slots=True)
class _Storm:
    told_ns: int
    last_ns: int
    count: int = 0


class HoldOff:
    """Lets the first event of a kind, node and detail through; counts what follows closely."""

    def __init__(self, hold_off_ns: int = HOLD_OFF_NS) -> None:
        self._hold_off_ns = hold_off_ns
        self._storms: dict[Key, _Storm] = {}

    def take(self, event: Event) -> Trigger | None:
        """The trigger that an event is; None where it only repeats one."""
        key = (event.kind, event.bus, event.node, event.detail)
        storm = self._storms.get(key)
        if storm is not None and event.kind != "asked" and self._goes_on(storm, event.log_ns):
            storm.last_ns = event.log_ns
            storm.count += 1
            return None
        missed = storm.count if storm else 0
        if storm is None and len(self._storms) >= MAX_STORMS:
            self._storms.pop(next(iter(self._storms)))
        self._storms[key] = _Storm(event.log_ns, event.log_ns)
        text = f"{event.text}{_since(missed)}"
        return Trigger(event.t_ns, event.log_ns, event.bus, event.node, text)

    def rest(self) -> Iterator[str]:
        """At the end: words on what was counted and not told yet."""
        for (kind, _, node, detail), storm in self._storms.items():
            if storm.count:
                whose = f" of node {node}" if node is not None else ""
                what = f"{detail:04X}h" if isinstance(detail, int) else detail or ""
                yield (
                    f"trigger {kind} {what}".rstrip()
                    + f"{whose}: {counted(storm.count, 'time')} more"
                )

    def _goes_on(self, storm: _Storm, log_ns: int) -> bool:
        return log_ns - storm.last_ns < self._hold_off_ns and log_ns - storm.told_ns < REPEAT_NS


def _since(missed: int) -> str:
    return f"; {counted(missed, 'time')} more since the last mark" if missed else ""
