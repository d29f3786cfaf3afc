"""The status in Prometheus's text format, for node_exporter's textfile collector."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from syncline_logger.live_status import BusSnapshot, StatusSnapshot

BUS_STATES = ("active", "warning", "passive", "off", "unknown")

Labels = Mapping[str, str]
Sample = tuple[Labels, float]
BusValue = Callable[[BusSnapshot], float]


@dataclass(frozen=True, slots=True)
class Metric:
    """A metric with its samples; the name is without the prefix."""

    name: str
    kind: Literal["counter", "gauge"]
    help: str
    samples: tuple[Sample, ...]


def prometheus_text(snapshot: StatusSnapshot, running: bool) -> str:
    """All metrics as one text (Prometheus exposition format 0.0.4)."""
    lines = [line for metric in metrics(snapshot, running) for line in _lines(metric)]
    return "\n".join(lines) + "\n"


def metrics(snapshot: StatusSnapshot, running: bool) -> list[Metric]:
    """What a dashboard wants to know: whether it runs, loses frames, hears nodes."""
    return [
        _one("up", "gauge", "1 while the recorder runs.", int(running)),
        _one("status_time_seconds", "gauge", "UTC of this status.", snapshot.t_ns / 1e9),
        _one("running_seconds", "gauge", "Time since the start.", snapshot.elapsed_ns / 1e9),
        _one("written_bytes", "gauge", "Size of the file being written.", snapshot.bytes_written),
        _one("disk_trouble", "gauge", "1 while the disk refuses.", int(bool(snapshot.trouble))),
        _one("gaps_total", "counter", "Stretches in which a bus was not heard.", snapshot.gaps),
        _of_buses("frames_total", "counter", "Frames recorded.", snapshot, lambda b: b.frames),
        _of_buses(
            "frames_per_second", "gauge", "Frame rate.", snapshot, lambda bus: bus.frames_per_s
        ),
        Metric(
            "bus_load_ratio",
            "gauge",
            "Bus load of the last period, 1 = full.",
            tuple(
                ({"bus": bus.name}, bus.load_percent / 100)
                for bus in snapshot.buses
                if bus.load_percent is not None
            ),
        ),
        _of_buses(
            "error_frames_total", "counter", "Error frames.", snapshot, lambda bus: bus.error_frames
        ),
        _of_buses(
            "lost_frames_total",
            "counter",
            "Frames known to be lost.",
            snapshot,
            lambda bus: bus.dropped_frames,
        ),
        _of_buses(
            "adapter_present",
            "gauge",
            "1 while the adapter answers.",
            snapshot,
            lambda bus: int(bus.adapter_present),
        ),
        Metric(
            "bus_state",
            "gauge",
            "1 for the state that the controller reports.",
            tuple(
                ({"bus": bus.name, "state": state}, int(state == bus.state))
                for bus in snapshot.buses
                for state in BUS_STATES
            ),
        ),
        Metric(
            "node_state",
            "gauge",
            "1 for the NMT state of each node that was heard.",
            tuple(
                ({"bus": bus.name, "node": str(node), "state": str(state)}, 1)
                for bus in snapshot.buses
                for node, state in bus.nodes.items()
            ),
        ),
    ]


def _one(name: str, kind: Literal["counter", "gauge"], text: str, value: float) -> Metric:
    return Metric(name, kind, text, (({}, value),))


def _of_buses(
    name: str,
    kind: Literal["counter", "gauge"],
    text: str,
    snapshot: StatusSnapshot,
    value: BusValue,
) -> Metric:
    samples = tuple(({"bus": bus.name}, float(value(bus))) for bus in snapshot.buses)
    return Metric(name, kind, text, samples)


def _lines(metric: Metric) -> Iterator[str]:
    name = f"syncline_{metric.name}"
    yield f"# HELP {name} {metric.help}"
    yield f"# TYPE {name} {metric.kind}"
    for labels, value in metric.samples:
        yield f"{name}{_label_text(labels.items())} {value:.17g}"


def _label_text(labels: Iterable[tuple[str, str]]) -> str:
    inner = ",".join(f'{key}="{_escaped(value)}"' for key, value in labels)
    return f"{{{inner}}}" if inner else ""


def _escaped(value: str) -> str:
    return value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
