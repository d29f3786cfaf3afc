"""PDOs of every node between what may change its state, and two cadences of one PDO."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.nmt.cadence import Doubles, Int64s
from syncline_analyzer.folds.nmt.error_control import ErrorControl
from syncline_analyzer.folds.nmt.events import PdoSpan
from syncline_analyzer.folds.nmt.senders import Sent
from syncline_analyzer.folds.nmt.table import NodeKey
from syncline_analyzer.folds.timing.pdo_spans import PdoSpans
from syncline_schemas.canopen.services import Service
from syncline_schemas.named_tuples import NamedTuple

Cut = tuple[int, int]
"""(seq, t_ns) of what may change a node's state."""


class _Frames(NamedTuple):
    """Frames of one PDO: (n,) `seq` and stamps, and (r,) `seq` of the remote frames that ask for it."""

    can_id: int
    seq: Int64s
    t_ns: Int64s
    asked: Int64s

    def parted(self, seq: int) -> tuple["_Frames", "_Frames"]:
        """Those before a `seq`, and the others."""
        at, asked = (int(column.searchsorted(seq)) for column in (self.seq, self.asked))
        before = _Frames(self.can_id, self.seq[:at], self.t_ns[:at], self.asked[:asked])
        return before, _Frames(self.can_id, self.seq[at:], self.t_ns[at:], self.asked[asked:])


class NodePdos:
    """Collects the stretches of PDOs of each node.

    The PDOs behind a message that is held back, because what it means depends on the next one, wait
    as long as it does.

    Args:
        controls: the error control of each node.
        news: what may have changed the state of a node, and was not told before.

    Attributes:
        doubles: by node and identifier, for a node that booted more than once: cadences of a PDO.
    """

    def __init__(
        self, controls: Mapping[NodeKey, ErrorControl], news: Callable[[NodeKey], list[Cut]]
    ) -> None:
        self.doubles: dict[NodeKey, dict[int, Doubles]] = {}
        self._controls = controls
        self._news = news
        self._spans: dict[NodeKey, PdoSpans] = {}
        self._waiting: dict[NodeKey, list[_Frames]] = {}
        self._cuts: dict[NodeKey, list[Cut]] = {}
        """Those that wait."""
        self._last_ns: dict[tuple[int, int], int] = {}
        """By bus number and identifier: time of the last PDO."""

    def __contains__(self, key: NodeKey) -> bool:
        return key in self._spans

    def take(self, batch: IndexedBatch, sent: Mapping[NodeKey, Sent]) -> None:
        """Take in the PDOs of a batch."""
        asked = batch.rows_of(Service.PDO, remote=True)
        asked_id, asked_bus = batch.frames.can_id[asked], batch.frames.bus[asked]
        for key, frames in sent.items():
            if frames.pdos and key not in self._spans:
                self._spans[key] = PdoSpans()
        for key, spans in self._spans.items():
            fresh = []
            for can_id, place in sent[key].pdos if key in sent else ():
                mine = asked[(asked_id == can_id) & (asked_bus == key[0])] if len(asked) else asked
                columns = batch.seqs_by_id[place], batch.t_ns_by_id[place]
                fresh.append(_Frames(can_id, *columns, batch.seqs_at(mine) if len(mine) else mine))
            self._follow(key, spans, fresh)

    def close(self, bus: int | None) -> None:
        """End all stretches of a bus, as at a gap; no message is held back any longer."""
        for key, spans in self._spans.items():
            if bus in (None, key[0]):
                self._follow(key, spans, [])
                spans.close()

    def spans(self) -> Iterator[tuple[NodeKey, list[PdoSpan]]]:
        """All stretches of each node, once no message is held back any longer."""
        for key, spans in self._spans.items():
            self._follow(key, spans, [])
            yield key, spans.spans()

    def _follow(self, key: NodeKey, spans: PdoSpans, fresh: list[_Frames]) -> None:
        control = self._controls.get(key)
        held_seq = control.held_seq if control is not None else None
        cuts, frames = self._news(key), fresh
        if key in self._waiting or held_seq is not None:
            cuts += self._cuts.pop(key, [])
            frames = [*self._waiting.pop(key, []), *fresh]
        if held_seq is not None:
            parted = [each.parted(held_seq) for each in frames]
            self._waiting[key] = [later for _, later in parted if len(later.seq)]
            self._cuts[key] = [cut for cut in cuts if cut[0] >= held_seq]
            cuts = [cut for cut in cuts if cut[0] < held_seq]
            frames = [before for before, _ in parted if len(before.seq)]
        if cuts:
            spans.cut(cuts)
        twice_seq = control.booted_again_seq if control is not None else None
        for each in frames:
            spans.take(*each)
            if twice_seq is not None:
                self._follow_cadence(key, each.parted(twice_seq)[1])

    def _follow_cadence(self, key: NodeKey, frames: _Frames) -> None:
        """Look for two cadences of one PDO: a second device may have told the second boot-up."""
        can_id, seq, t_ns, _ = frames
        if not len(seq):
            return
        before = self._last_ns.get((key[0], can_id))
        self._last_ns[key[0], can_id] = int(t_ns[-1])
        passed = np.diff(t_ns, prepend=t_ns[:1] if before is None else before)
        doubles = self.doubles.setdefault(key, {}).setdefault(can_id, Doubles())
        doubles.note(seq, t_ns, passed, passed > 0)
