"""How long a recorder has run, whatever was done to the date meanwhile."""

DAY_NS = 86_400_000_000_000
"""No pause, and no jump of log time that the clocks do not explain, counts for more than this."""


class RunningTime:
    """Log time without the jumps of the date.

    Attributes:
        ran_ns: since the start.
        jumped_ns: how far log time went ahead without that time having passed, as far as known.
    """

    def __init__(self, start_ns: int) -> None:
        self._last_ns = start_ns
        self._steps_ns = 0
        self.ran_ns = self.jumped_ns = 0

    def step(self, step_ns: int) -> None:
        """The date was set; log time follows it forward, so the next turn shows it."""
        self._steps_ns += max(step_ns, 0)

    def turn(self, now_ns: int) -> None:
        """Log time has come to `now_ns`; a recorder turns every second or so."""
        passed_ns = max(now_ns - self._last_ns, 0)
        step_ns = min(self._steps_ns, passed_ns)
        believed_ns = min(passed_ns - step_ns, DAY_NS)
        self._steps_ns -= step_ns
        self._last_ns = max(self._last_ns, now_ns)
        self.ran_ns += believed_ns
        self.jumped_ns += passed_ns - believed_ns
