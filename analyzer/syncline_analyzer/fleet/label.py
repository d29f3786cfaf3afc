"""By what the recording of a capture is found among those of all machines."""

from typing import Any

from syncline_analyzer.fleet.captures import capture_values
from syncline_analyzer.fleet.layout import Partition
from syncline_analyzer.results import Analysis
from syncline_analyzer.views.rerun_view import Label
from syncline_analyzer.views.words import Clock

_COUNTED = ("verdict", "errors", "warnings", "infos", "nodes", "frames")


def label_of(analysis: Analysis, partition: Partition) -> Label:
    """The label of a capture's recording: its id is that of the capture.

    Properties are machine, date and capture_id; verdict, the number of findings by severity and
    the text of the worst one; nodes, frames, duration_s, blind_s; buses and bitrates [bit/s], a
    list each.
    """
    values = capture_values(analysis)
    rates = sorted({row.bitrate for row in analysis.bus_load if row.bitrate})
    properties: dict[str, Any] = {
        **partition._asdict(),
        **{name: values[name] for name in _COUNTED},
        "worst": analysis.findings[0].text if analysis.findings else "",
        "duration_s": values["duration_ns"] / 1e9,
        "blind_s": values["blind_ns"] / 1e9,
        "buses": values["buses"] or None,
        "bitrates": rates or None,
    }
    clock = Clock.of(analysis.capture)
    begun = clock.full(values["start_utc_ns"])[:16] if clock.dated else partition.date
    return Label(partition.capture_id, f"{partition.machine} {begun}", properties)
