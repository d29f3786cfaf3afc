"""The live status: one line on a terminal, JSON lines elsewhere, a file for other programs."""

import json
import os
from typing import TYPE_CHECKING, Any

from syncline_logger.live_status import BusSnapshot, StatusSnapshot
from syncline_schemas.canopen.nmt import NmtState
from syncline_schemas.wording import counted

if TYPE_CHECKING:
    from rich.text import Text

_STATE_STYLE = {
    NmtState.OPERATIONAL: "green",
    NmtState.PRE_OPERATIONAL: "yellow",
    NmtState.STOPPED: "yellow",
    NmtState.LOST: "bold red",
}


def status_json(snapshot: StatusSnapshot) -> str:
    """One JSON object without a line end."""
    return json.dumps(_values(snapshot))


def status_file_text(snapshot: StatusSnapshot, running: bool) -> str:
    """The same object with whether the recorder runs, and as which process."""
    state = "recording" if running else "stopped"
    return json.dumps({"state": state, "pid": os.getpid()} | _values(snapshot)) + "\n"


def _values(snapshot: StatusSnapshot) -> dict[str, Any]:
    return {
        "t_ns": snapshot.t_ns,
        "elapsed_s": round(snapshot.elapsed_ns / 1e9, 3),
        "path": snapshot.path,
        "bytes": snapshot.bytes_written,
        "frames": snapshot.frames,
        "gaps": snapshot.gaps,
        "trouble": snapshot.trouble,
        "buses": [_bus_values(bus) for bus in snapshot.buses],
    }


def _bus_values(bus: BusSnapshot) -> dict[str, Any]:
    return {
        "bus": bus.name,
        "frames": bus.frames,
        "frames_per_s": round(bus.frames_per_s, 1),
        "load_percent": None if bus.load_percent is None else round(bus.load_percent, 2),
        "state": bus.state,
        "adapter_present": bus.adapter_present,
        "error_frames": bus.error_frames,
        "dropped_frames": bus.dropped_frames,
        "clock_residual_ns": bus.clock_residual_ns,
        "nodes": {str(node): str(state) for node, state in bus.nodes.items()},
    }


def plain_line(snapshot: StatusSnapshot) -> str:
    """One line for `systemctl status`."""
    words = [counted(snapshot.frames, "frame")]
    for bus in snapshot.buses:
        heard = f"{bus.frames_per_s:.0f}/s" if bus.adapter_present else "adapter lost"
        lost = f", {counted(bus.dropped_frames, 'frame')} lost" if bus.dropped_frames else ""
        words.append(f"{bus.name} {heard}{lost}")
    words += [snapshot.trouble] if snapshot.trouble else []
    return f"{'; '.join(words)}; {snapshot.path}"


def status_line(snapshot: StatusSnapshot) -> "Text":
    """One line for people."""
    from rich.text import Text

    seconds = snapshot.elapsed_ns // 1_000_000_000
    line = Text(
        f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
        f"  {counted(snapshot.frames, 'frame')}  {snapshot.bytes_written / 1e6:.1f} MB"
    )
    if snapshot.trouble:
        line.append(f"  {snapshot.trouble}", "bold red")
    for bus in snapshot.buses:
        line.append(f"  | {bus.name}", "bold")
        if not bus.adapter_present:
            line.append(" adapter lost", "bold red")
            continue
        load = "" if bus.load_percent is None else f" {bus.load_percent:.1f} %"
        line.append(f" {bus.frames_per_s:.0f}/s{load}")
        if bus.state not in ("active", "unknown"):
            line.append(f" {bus.state}", "bold red")
        if bus.dropped_frames:
            line.append(f" {bus.dropped_frames} lost", "bold red")
        for node, state in bus.nodes.items():
            line.append(f"  {node} ")
            line.append(str(state), _STATE_STYLE.get(NmtState(state), "dim"))
    return line
