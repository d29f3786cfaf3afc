"""What the recorder had learned before the first segment that is analyzed."""

from collections.abc import Sequence

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.folds.sdo.values import known_value
from syncline_analyzer.object_history import Known
from syncline_analyzer.shadow import Shadow


def recall(shadow: Shadow, facts: Sequence[CaptureFacts]) -> None:
    """Give the shadow what the first file tells of earlier segments of its recording.

    Only where all files are of that recording: what held at the start of another one is not known
    to hold at the start of the first.
    """
    recordings = {each.metadata.get("recording_id") for each in facts}
    if len(recordings) != 1:
        return
    first = facts[0]
    created = first.metadata.get("created_ns", "")
    t_ns = int(created) if created.isdecimal() else None
    for (bus, node), settings in first.learned.items():
        # Identity first: the device decides what kind of values the other objects have.
        for (index, sub), (data, kept) in sorted(settings.items()):
            value = known_value(shadow.device(bus, node), index, sub, data)
            known = Known(value, "sdo-read" if kept else "sdo-write", None, t_ns)
            shadow.recall(bus, node, (index, sub), known, kept=kept)
