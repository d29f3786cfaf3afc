"""A recorder's status with keyword defaults, for tests of what is told of it."""

from collections.abc import Mapping

from syncline_logger.live_status import BusSnapshot, StatusSnapshot

S = 1_000_000_000


def bus(
    name: str = "can0",
    *,
    frames: int = 0,
    frames_per_s: float = 0.0,
    load_percent: float | None = None,
    state: str = "active",
    adapter_present: bool = True,
    error_frames: int = 0,
    dropped_frames: int = 0,
    nodes: Mapping[int, str] | None = None,
) -> BusSnapshot:
    """A quiet bus, but for what is given."""
    return BusSnapshot(
        name=name,
        frames=frames,
        frames_per_s=frames_per_s,
        load_percent=load_percent,
        state=state,
        adapter_present=adapter_present,
        error_frames=error_frames,
        dropped_frames=dropped_frames,
        nodes=dict(nodes or {}),
    )


def status(
    *buses: BusSnapshot, path: str = "a.mcap", t_ns: int = 5 * S, gaps: int = 0
) -> StatusSnapshot:
    """A recorder that runs for five seconds."""
    return StatusSnapshot(t_ns, 5 * S, path, 1000, buses or (bus(),), gaps)
