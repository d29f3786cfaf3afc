"""An SDO client: the master's, or a second one of a tool; one transfer at a time per node."""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Literal

from syncline_samples import abort
from syncline_samples.bus import Frame
from syncline_samples.sdo_transfers import (
    BlockRead,
    SdoJob,
    Step,
    Transfer,
    aborted_by_client,
    begin,
    server_abort,
)
from syncline_samples.truth import SdoTruth
from syncline_samples.world import MS, World

__all__ = ["OnTimeout", "SdoClient", "SdoJob", "read", "write", "write_block", "write_text"]

_RESETS = (0x81, 0x82)

OnTimeout = Literal["silent", "abort"]


def read(index: int, sub: int = 0, *, block: bool = False) -> SdoJob:
    """A read."""
    return SdoJob(index, sub, block=block)


def write(index: int, sub: int, value: int, width: int = 0) -> SdoJob:
    """A write of a number of `width` bytes; 0 leaves the size open."""
    return SdoJob(index, sub, value.to_bytes(width or 4, "little"), width)


def write_text(index: int, sub: int, text: bytes) -> SdoJob:
    """A segmented write."""
    return SdoJob(index, sub, text, len(text))


def write_block(index: int, sub: int, data: bytes) -> SdoJob:
    """A block write."""
    return SdoJob(index, sub, data, block=True)


class SdoClient:
    """Transfers with one node, in the order they were asked for.

    Two clients on one channel take only answers that name their own object: what the second one
    asks for must be another object than what the first one is at.

    Attributes:
        timeout_ns: after this silence the client gives up.
        on_timeout: giving up is silent, or says so by abort 0504 0000h.
        pause_ns: between the end of a transfer and the next request.
        request_id, answer_id: the identifiers of the channel (1200h of the server).
    """

    def __init__(
        self,
        world: World,
        node_id: int,
        *,
        timeout_ns: int = 500 * MS,
        pause_ns: int = 2 * MS,
        on_timeout: OnTimeout = "silent",
    ) -> None:
        self._world = world
        self._node_id = node_id
        self.timeout_ns = timeout_ns
        self.pause_ns = pause_ns
        self.on_timeout: OnTimeout = on_timeout
        self.request_id, self.answer_id = 0x600 + node_id, 0x580 + node_id
        self._waiting: deque[SdoJob | Callable[[], None]] = deque()
        self._job: SdoJob | None = None
        self._transfer: Transfer | None = None
        self._request = 0
        self._start_ns = 0
        self._end_ns = 0
        self._answer_ns: int | None = None
        self._answers = 0
        self._reset_seen = False
        self._late: tuple[int, SdoJob, Transfer] | None = None
        world.bus.listen(self.answer_id, self._on_answer)
        world.bus.listen(0x000, self._on_nmt)
        world.bus.listen(0x700 + node_id, self._on_error_control)

    def move(self, request_id: int, answer_id: int) -> None:
        """Use other identifiers from now on."""
        self._world.bus.unlisten(self.answer_id, self._on_answer)
        self.request_id, self.answer_id = request_id, answer_id
        self._world.bus.listen(answer_id, self._on_answer)

    def run(self, *jobs: SdoJob, then: Callable[[], None] | None = None) -> None:
        """Queue transfers, and what to do when they are through."""
        self._waiting.extend(jobs)
        if then is not None:
            self._waiting.append(then)
        if self._job is None:
            self._next()

    def drop(self) -> None:
        """Forget everything, as a master does when the node has restarted."""
        self._waiting.clear()
        if self._job is not None:
            self._finish("interrupted", None)

    def power_off(self) -> None:
        """Forget everything, with the frames that are still queued."""
        self.drop()
        self._late = None
        self._world.bus.withdraw(self)

    def _next(self) -> None:
        while self._waiting:
            item = self._waiting.popleft()
            if isinstance(item, SdoJob):
                self._begin(item)
                return
            item()

    def _begin(self, job: SdoJob) -> None:
        self._job, self._transfer = job, begin(job)
        self._start_ns = self._end_ns = self._answers = 0
        self._answer_ns = self._late = None
        self._reset_seen = False
        self._send(self._transfer.first)

    def _send(self, data: bytes) -> None:
        self._request += 1
        self._world.bus.send(self._frame(data), self, self._requested)

    def _frame(self, data: bytes) -> Frame:
        short = self._job is not None and self._job.short
        return Frame(self.request_id, data if short else data.ljust(8, b"\0"))

    def _send_last(self, frames: Iterable[bytes]) -> None:
        """Frames that nobody answers; with them the transfer, which is noted next, is over."""
        row = len(self._world.truth.sdo)
        for data in frames:
            self._world.bus.send(self._frame(data), self, partial(self._ended, row))

    def _ended(self, row: int, t_ns: int) -> None:
        truth = self._world.truth.sdo
        end_ns = self._world.utc_ns(t_ns)
        truth[row] = replace(truth[row], end_ns=end_ns, last_ns=end_ns)

    def _requested(self, t_ns: int) -> None:
        self._start_ns = self._start_ns or t_ns
        self._end_ns = t_ns
        self._world.simulation.at(t_ns + self.timeout_ns, self._give_up, self._request)

    def _give_up(self, request: int) -> None:
        job, transfer = self._job, self._transfer
        if request != self._request or job is None or transfer is None:
            return
        begun = bool(self._answers)
        if self.on_timeout == "abort":
            frame = b"\x80" + job.head + abort.TIMEOUT.to_bytes(4, "little")
            self._send_last([frame])
            self._finish("abort", abort.TIMEOUT, by="client")
            return
        self._finish("interrupted" if begun or self._reset_seen else "no answer", None)
        if not begun:
            self._late = len(self._world.truth.sdo) - 1, job, transfer

    def _finish(
        self,
        result: str,
        code: int | None,
        data: bytes = b"",
        by: str | None = None,
    ) -> None:
        job, transfer = self._job, self._transfer
        assert job is not None
        assert transfer is not None
        now_ns = self._world.simulation.now_ns
        self._job = self._transfer = None
        self._request += 1
        utc_ns = self._world.utc_ns
        self._world.truth.sdo.append(
            SdoTruth(
                self._node_id,
                utc_ns(self._start_ns or now_ns),
                utc_ns(now_ns),
                job.index,
                job.sub,
                "upload" if job.data is None else "download",
                transfer.kind,
                data if job.data is None else job.data,
                result,
                code,
                aborted_by=by,
                answer_ns=None if self._answer_ns is None else utc_ns(self._answer_ns),
                last_ns=utc_ns(self._end_ns or now_ns),
                request_id=self.request_id,
            )
        )
        self._world.simulation.at(now_ns + self.pause_ns, self._next_if_idle)

    def _next_if_idle(self) -> None:
        if self._job is None:
            self._next()

    def _on_nmt(self, frame: Frame, t_ns: int) -> None:
        data = frame.data
        concerned = len(data) >= 2 and data[1] in (0, self._node_id)
        self._reset_seen |= concerned and data[0] in _RESETS

    def _on_error_control(self, frame: Frame, t_ns: int) -> None:
        self._reset_seen |= frame.data == b"\0"

    def _on_answer(self, frame: Frame, t_ns: int) -> None:
        data = frame.data
        if not data:
            return
        if self._job is None or self._transfer is None or not self._start_ns:
            if self._late is not None:
                self._take_late(*self._late, data, t_ns)
            return
        step = self._step(self._job, self._transfer, data)
        if not step.mine:
            return
        self._answers += 1
        self._answer_ns = self._answer_ns or t_ns
        self._end_ns = t_ns
        if self._job.abort_after == self._answers:
            step = aborted_by_client(self._job)
        elif self._job.stop_after == self._answers:
            step = Step()
        if step.result is not None:
            self._send_last(step.frames)
            self._finish(step.result, step.abort_code, step.data, step.by)
            return
        for each in step.frames:
            self._send(each)

    def _step(self, job: SdoJob, transfer: Transfer, data: bytes) -> Step:
        in_segments = isinstance(transfer, BlockRead) and transfer.in_segments
        if data[0] == 0x80 and not in_segments:
            return server_abort(job, data)
        return transfer.take(data)

    def _take_late(self, row: int, job: SdoJob, transfer: Transfer, data: bytes, t_ns: int) -> None:
        """The bus tells of a slow answer what this client thinks to be none."""
        step = self._step(job, transfer, data)
        if not step.mine:
            return
        self._late = None
        truth = self._world.truth.sdo
        truth[row] = replace(
            truth[row],
            kind=transfer.kind,
            data=step.data if job.data is None else job.data,
            result=step.result or "interrupted",
            abort_code=step.abort_code,
            aborted_by=step.by,
            end_ns=self._world.utc_ns(t_ns),
            last_ns=self._world.utc_ns(t_ns),
            answer_ns=self._world.utc_ns(t_ns),
        )
