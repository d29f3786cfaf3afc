"""One SDO client/server pair as a state machine (CiA 301 7.2.4.3): frames in, transfers out."""

from collections import deque
from collections.abc import Callable

from syncline_analyzer.folds.sdo.blocks import Block
from syncline_analyzer.folds.sdo.segments import Segments
from syncline_analyzer.folds.sdo.transfer import (
    Direction,
    Ender,
    Oddity,
    OddKind,
    Refusal,
    Result,
    Side,
    Step,
    Strays,
    Transfer,
)
from syncline_schemas.canopen.sdo import ClientCommand, ServerCommand

NO_ANSWER_NS = 30_000_000_000
"""A late answer comes within this [ns]."""
PATIENCE_NS = 50_000_000
"""A client that asks for something else after this has given up; sooner it is a second client."""
OUTDATED = 2
"""... and before so many more requests were made."""
RETRIED = 4
"""Of requests repeated at a client's time-out the first waits less than so many times the last."""
OVERTAKEN = 16
"""A request that waits on is given up when so many others followed, or after `NO_ANSWER_NS`."""
READ_REQUESTS = (0x40, 0x42)
"""Initiate upload; the second as some makers print it. Others count once they are answered."""
RESET_NS = 1_000_000_000
"""A reset (or the end) this soon after a request explains why no answer came [ns]."""
SEGMENT_NS = 1_000_000_000
"""Segments of a block that come later than this do not skip numbers [ns]."""
DOUBLED_NS = 2_000_000_000
"""A second answer comes this soon after the first [ns]."""
MAX_ODDITIES = 1000

_Frame = tuple[int, int, bytes]
_ANSWERS: dict[int, Direction] = {
    ServerCommand.INITIATE_UPLOAD: "upload",
    ServerCommand.INITIATE_DOWNLOAD: "download",
}


class SdoChannel:
    """Follows the transfers between a server and its client, or clients that share it.

    `done` is called with every transfer that ended, in the order in which they ended. Frames of
    transfers that began before the capture are counted in `strays`. A request that another one
    follows at once waits on, since two clients may use one server; an answer that comes after the
    client gave up is none, and kept in `oddities`.
    """

    def __init__(
        self,
        bus: int,
        node: int,
        done: Callable[["SdoChannel", Transfer], None],
    ) -> None:
        self.bus = bus
        self.node = node
        self.strays = Strays()
        self.oddities: list[Oddity] = []
        self.answers = 0
        self.client_id: int | None = None
        """Identifier on which the client asked last."""
        self._done = done
        self._now: Transfer | None = None
        self._running: Segments | Block | None = None
        self._waiting: list[tuple[int, Transfer]] = []
        self._begun = 0
        self._given_up: deque[tuple[int, Transfer]] = deque(maxlen=4)
        self._last: Transfer | None = None
        self._last_answer = b""
        self._unsure: _Frame | None = None
        self._run_command = -1
        self._run = 0
        self._run_seq = 0
        self._answer_command = -1

    @property
    def idle(self) -> bool:
        """Nothing is under way, and no frame waits to be understood."""
        return self._now is None and not self._waiting and not self._run

    def request(self, seq: int, t_ns: int, data: bytes) -> None:
        """Take in a frame of the client."""
        if not data:
            self.strays.malformed += 1
            return
        if self._waiting:
            self._expire(t_ns)
        now, running = self._now, self._running
        if now is not None and running is not None:
            step = running.request(data, t_ns - now.end_ns > SEGMENT_NS)
            if step is not Step.NOT_MINE:
                self._unsure = (seq, t_ns, data)
                now.heard(seq, t_ns)
                if step is Step.DONE:
                    self._complete(now)
                return
        self._unsure = None
        self._count_run(seq, data[0])
        self._dispatch(seq, t_ns, data)

    def answer(self, seq: int, t_ns: int, data: bytes) -> None:
        """Take in a frame of the server."""
        self.answers += 1
        if not data:
            self.strays.malformed += 1
            return
        now, running = self._now, self._running
        if now is not None and running is not None:
            step = running.answer(data, t_ns - now.end_ns > SEGMENT_NS)
            if step is not Step.NOT_MINE:
                self._count_no_run()
                now.answered(seq, t_ns)
                if step is Step.DONE:
                    self._complete(now)
                return
        if data[0] >> 5 == ServerCommand.ABORT:
            self._abort(seq, t_ns, data, "server")
        elif not self._opened(seq, t_ns, data) and not self._answered_before(seq, t_ns, data):
            self._stray_answer(seq, t_ns, data)

    def expects(self, command: int) -> bool:
        """Whether a request that is answered at once stands for itself: `take` may have it."""
        return self._now is None and not self._waiting and command != self._run_command + 1

    def take(self, count: int, last: Transfer, answer: bytes) -> None:
        """Take in expedited transfers that follow one another, each answered right away.

        Does what `request` and `answer` with their frames would do, but for `done`, which is not
        called: the caller knows them. `last` is the last of them, with its answer.
        """
        self.answers += count
        self._begun += count
        self._unsure = None
        self._run_seq = last.seq
        self._count_no_run()
        self._last, self._last_answer = last, answer

    def settled(self, transfer: Transfer) -> bool:
        """Whether nothing that comes can change a transfer that is done: see `exchange_answers`."""
        return self._last is not transfer

    def interrupt(self, seq: int, t_ns: int) -> None:
        """End what runs because the node was reset, unless it was asked for after that."""
        asked = [entry.seq for _, entry in self._waiting]
        asked += [self._now.seq] if self._now is not None else []
        if not asked or min(asked) < seq:
            self._end_all(t_ns, "reset")

    def cut(self, begin_ns: int | None) -> None:
        """End what runs because nothing was heard for a while, from `begin_ns` on if known."""
        self._end_all(begin_ns, "gap")
        self._last = None
        self._given_up.clear()

    def finish(self, end_ns: int, timed: bool) -> None:
        """End what runs because the capture ends."""
        self._end_all(end_ns if timed else None, "end")

    def _dispatch(self, seq: int, t_ns: int, data: bytes) -> None:
        match data[0] >> 5:
            case ClientCommand.INITIATE_DOWNLOAD | ClientCommand.INITIATE_UPLOAD:
                self._initiate(seq, t_ns, data)
            case ClientCommand.ABORT:
                self._abort(seq, t_ns, data, "client")
            case ClientCommand.BLOCK_UPLOAD if data[0] & 3 == 0 and len(data) >= 4:
                transfer = self._begin(_block(seq, t_ns, data, "upload"))
                transfer.block_size = data[4] if len(data) > 4 else 0
            case ClientCommand.BLOCK_DOWNLOAD if data[0] & 1 == 0 and len(data) >= 4:
                transfer = self._begin(_block(seq, t_ns, data, "download"))
                if data[0] & 2:
                    transfer.announced = int.from_bytes(data[4:8], "little")
            case _ if not self._goes_on_unanswered(seq, t_ns, data):
                self.strays.requests += 1
                self._unsure = (seq, t_ns, data)

    def _initiate(self, seq: int, t_ns: int, data: bytes) -> None:
        if len(data) < 4 or self._run >= 2:
            self.strays.malformed += len(data) < 4
            self.strays.requests += len(data) >= 4
            return
        command = data[0]
        read = command >> 5 == ClientCommand.INITIATE_UPLOAD
        if (read and command not in READ_REQUESTS) or command & 0xF0 == 0x30:
            self.strays.requests += 1
            self._unsure = (seq, t_ns, data)
            return
        self._begin(_initiated(seq, t_ns, data))

    def _begin(self, transfer: Transfer) -> Transfer:
        if (now := self._now) is not None:
            if self._running is not None:
                self._close(now, "interrupted", "request")
            elif transfer.start_ns - now.start_ns >= PATIENCE_NS:
                self._give_up(now, transfer.start_ns)
            else:
                self._waiting.append((self._begun, now))
        self._begun += 1
        transfer.heard(transfer.seq, transfer.start_ns)
        self._now, self._running = transfer, None
        return transfer

    def _goes_on_unanswered(self, seq: int, t_ns: int, data: bytes) -> bool:
        """Whether the client goes on after an answer that is missing in the capture."""
        now = self._now
        if now is None or self._running is not None:
            return False
        if self.oddities and self.oddities[-1].asked is now:
            return False
        running: Segments | Block
        command = data[0] >> 5
        if now.direction == "upload" and command == ClientCommand.UPLOAD_SEGMENT:
            now.kind, running = "segmented", Segments(now)
        elif now.kind == "segmented" and command == ClientCommand.DOWNLOAD_SEGMENT:
            running = Segments(now)
        elif now.kind == "block" and data[0] == 0xA3 and now.direction == "upload":
            running = Block(now, crc_used=False)
        else:
            return False
        self._running = running
        running.request(data, False)
        now.heard(seq, t_ns)
        return True

    def _opened(self, seq: int, t_ns: int, data: bytes) -> bool:
        """Whether a server's frame answers a request that waits for it."""
        if (now := self._now) is not None and self._running is None and _fits(now, data):
            self._open(now, seq, t_ns, data)
            return True
        return self._opened_unsure(seq, t_ns, data) or self._opened_waiting(seq, t_ns, data)

    def _open(self, now: Transfer, seq: int, t_ns: int, data: bytes) -> None:
        """Take in the answer to an initiate request."""
        self._count_no_run()
        now.answered(seq, t_ns)
        self._last_answer = data
        command = data[0] >> 5
        now.whole = now.whole or now.kind != "expedited"
        if command == ServerCommand.INITIATE_UPLOAD:
            now.take_initiate(data)
        if now.kind == "block":
            size = (
                data[4]
                if command == ServerCommand.BLOCK_DOWNLOAD and len(data) > 4
                else now.block_size
            )
            if command == ServerCommand.BLOCK_UPLOAD and data[0] & 2:
                now.announced = int.from_bytes(data[4:8], "little")
            self._running = Block(now, now.crc_offered and bool(data[0] & 4), size)
        elif now.kind == "segmented":
            self._running = Segments(now)
        else:
            self._complete(now)

    def _opened_unsure(self, seq: int, t_ns: int, data: bytes) -> bool:
        """Whether the last request, read as something else or as nothing, was one after all."""
        if self._unsure is None or data[0] >> 5 not in _ANSWERS:
            return False
        at, asked_ns, asked = self._unsure
        if len(asked) < 4 or not _may_initiate(asked) or asked[1:4] != data[1:4]:
            return False
        transfer = _initiated(at, asked_ns, asked)
        if not _fits(transfer, data):
            return False
        self.strays.requests -= self._running is None
        self._begin(transfer)
        self._open(transfer, seq, t_ns, data)
        return True

    def _opened_waiting(self, seq: int, t_ns: int, data: bytes) -> bool:
        """Whether a request that others have followed is answered at last."""
        found = next((entry for entry in self._waiting if _fits(entry[1], data)), None)
        if found is None:
            return False
        transfer, later = found[1], self._last
        if self._running is not None and not _settles(transfer, data):
            return False
        self._waiting.remove(found)
        held = self._now, self._running
        self._now, self._running = transfer, None
        self._open(transfer, seq, t_ns, data)
        if later is not None and self._last is transfer and _asks_again(later, transfer):
            transfer.exchange_answers(later)
            self._last = later
        self._resume(*held)
        return True

    def _resume(self, now: Transfer | None, running: Segments | Block | None) -> None:
        """Go on with what was under way before an older request was answered."""
        if now is not None and self._now is None:
            self._now, self._running = now, running
        elif now is not None:
            self._waiting.append((self._begun, now))

    def _answered_before(self, seq: int, t_ns: int, data: bytes) -> bool:
        """Note an answer that comes after the client gave up, or a second one."""
        found = self._late(t_ns, data)
        if found is not None:
            late = found[1]
            self._given_up.remove(found)
            again = self._last if self._last and _asks_again(self._last, late) else late
            self._odd("late", late, (seq, t_ns, data), again.start_ns)
        elif self._again(t_ns, data):
            assert self._last is not None
            differs = data != self._last_answer
            self._odd("doubled", self._last, (seq, t_ns, data), self._last.end_ns, differs)
        else:
            return False
        self.strays.answers += 1
        return True

    def _late(self, t_ns: int, data: bytes) -> tuple[int, Transfer] | None:
        """The request given up that an answer is for: the first of those that repeat one another."""
        given_up = [each for each in self._given_up if self._answers_late(*each, t_ns, data)]
        if not given_up:
            return None
        waited_ns = RETRIED * (t_ns - given_up[-1][1].start_ns)
        return next((e for e in given_up if t_ns - e[1].start_ns <= waited_ns), given_up[-1])

    def _answers_late(self, number: int, given_up: Transfer, t_ns: int, data: bytes) -> bool:
        recent = self._begun - number <= OUTDATED and 0 <= t_ns - given_up.start_ns <= NO_ANSWER_NS
        return _ends(given_up, data) and recent and given_up.names(data)

    def _again(self, t_ns: int, data: bytes) -> bool:
        last = self._last
        return (
            last is not None
            and self._running is None
            and last.kind == "expedited"
            and last.names(data)
            and _ends(last, data)
            and 0 <= t_ns - last.end_ns <= DOUBLED_NS
        )

    def _stray_answer(self, seq: int, t_ns: int, data: bytes) -> None:
        now = self._now
        self.strays.answers += 1
        if now is None:
            self.strays.numbered += data[0] == self._answer_command + 1
            self._answer_command = data[0]
        elif self._running is None:
            now.whole = now.whole and now.kind == "expedited"
            if data[0] >> 5 in _ANSWERS and len(data) >= 4 and not self._waiting:
                self._odd("wrong", now, (seq, t_ns, data), now.start_ns)

    def _odd(
        self,
        kind: OddKind,
        asked: Transfer,
        answer: _Frame,
        since_ns: int,
        differs: bool = False,
    ) -> None:
        if len(self.oddities) < MAX_ODDITIES:
            seq, t_ns, data = answer
            named = (data[1] | data[2] << 8, data[3])
            self.oddities.append(Oddity(kind, asked, seq, t_ns, since_ns, named, differs))

    def _abort(self, seq: int, t_ns: int, data: bytes, by: Side) -> None:
        code = int.from_bytes(data[4:8], "little") if len(data) >= 8 else None
        refusal = Refusal(by, code, seq, t_ns)
        now = self._now
        if now is not None and (self._running is not None or now.names(data) or _nameless(data)):
            self._refuse(now, refusal, data)
            self._now = self._running = None
            return
        waiting = next((entry for entry in self._waiting if entry[1].names(data)), None)
        if waiting is not None:
            self._waiting.remove(waiting)
            self._refuse(waiting[1], refusal, data)
            return
        if by == "server" and self._answered_before(seq, t_ns, data):
            return
        if now is not None:
            now.stray_abort = refusal
        self.strays.requests += by == "client"
        self.strays.answers += by == "server"

    def _refuse(self, transfer: Transfer, refusal: Refusal, data: bytes) -> None:
        self._count_no_run()
        transfer.refuse(refusal)
        if refusal.by == "server":
            self._last, self._last_answer = transfer, data
        elif transfer.answered_ns is None:
            transfer.given_up_ns = refusal.t_ns
            self._given_up.append((self._begun, transfer))
        self._done(self, transfer)

    def _complete(self, transfer: Transfer) -> None:
        self._now = self._running = None
        self._last = transfer
        self._done(self, transfer)

    def _give_up(self, transfer: Transfer, t_ns: int) -> None:
        """End a request that the client no longer waits for."""
        transfer.given_up_ns = t_ns
        self._given_up.append((self._begun, transfer))
        self._close(transfer, "no answer", "request")

    def _close(self, transfer: Transfer, result: Result, by: Ender) -> None:
        transfer.result, transfer.ended_by = result, by
        if transfer.stray_abort is not None:
            transfer.refuse(transfer.stray_abort)
        self._done(self, transfer)

    def _end_all(self, t_ns: int | None, by: Ender) -> None:
        """End everything; at `t_ns`, where that is known."""
        for _, transfer in self._waiting:
            self._close(transfer, "no answer", "request")
        self._waiting.clear()
        if (now := self._now) is not None:
            waits = self._running is None and t_ns is not None and t_ns - now.end_ns > RESET_NS
            self._close(now, "no answer" if waits else "interrupted", by)
        self._now = self._running = self._unsure = None
        self._count_no_run()

    def _expire(self, t_ns: int) -> None:
        """Give up requests that others followed long ago."""
        for number, transfer in list(self._waiting):
            if t_ns - transfer.start_ns > NO_ANSWER_NS or self._begun - number > OVERTAKEN:
                self._waiting.remove((number, transfer))
                self._close(transfer, "no answer", "request")

    def _count_no_run(self) -> None:
        self._run = 0
        self._run_command = -1

    def _count_run(self, seq: int, command: int) -> None:
        """Requests that count up without answers are a block download that began unseen."""
        if command == self._run_command + 1:
            self._run += 1
            self.strays.numbered += self._now is None
        else:
            self._run, self._run_seq = 0, seq
        self._run_command = command
        if self._run < 2:
            return
        kept = [entry for entry in self._waiting if entry[1].seq < self._run_seq]
        self.strays.requests += len(self._waiting) - len(kept)
        self._waiting = kept
        now = self._now
        if now is not None and self._running is None and now.seq >= self._run_seq:
            self.strays.requests += 1
            self._now = None


def _block(seq: int, t_ns: int, data: bytes, direction: Direction) -> Transfer:
    transfer = Transfer(seq, t_ns, data[1] | data[2] << 8, data[3], direction, "block")
    transfer.crc_offered = bool(data[0] & 4)
    return transfer


def _initiated(seq: int, t_ns: int, data: bytes) -> Transfer:
    index, sub = data[1] | data[2] << 8, data[3]
    if data[0] >> 5 == ClientCommand.INITIATE_UPLOAD:
        return Transfer(seq, t_ns, index, sub, "upload")
    transfer = Transfer(seq, t_ns, index, sub, "download")
    transfer.take_initiate(data)
    return transfer


def _may_initiate(data: bytes) -> bool:
    """Whether a frame may be an initiate request: a write, or a read, which carries no data."""
    read = data[0] >> 5 == ClientCommand.INITIATE_UPLOAD
    return data[0] & 0xF0 == 0x20 or (read and not any(data[4:]))


def _fits(waiting: Transfer, data: bytes) -> bool:
    """Whether a server's frame answers the initiate request of a transfer."""
    if not waiting.names(data):
        return False
    match data[0] >> 5:
        case ServerCommand.INITIATE_UPLOAD:
            return waiting.direction == "upload"
        case ServerCommand.INITIATE_DOWNLOAD:
            return waiting.direction == "download" and waiting.kind != "block"
        case ServerCommand.BLOCK_DOWNLOAD:
            block = waiting.kind == "block" and waiting.direction == "download"
            return block and data[0] & 3 == 0
        case ServerCommand.BLOCK_UPLOAD:
            block = waiting.kind == "block" and waiting.direction == "upload"
            return block and data[0] & 1 == 0
    return False


def _ends(transfer: Transfer, data: bytes) -> bool:
    """Whether a server's frame is an abort, or an initiate answer in the transfer's direction."""
    command = data[0] >> 5
    return command == ServerCommand.ABORT or _ANSWERS.get(command) == transfer.direction


def _settles(waiting: Transfer, data: bytes) -> bool:
    """Whether an answer ends a transfer at once."""
    if waiting.direction == "download":
        return waiting.kind == "expedited"
    return waiting.kind != "block" and bool(data[0] & 2)


def _asks_again(later: Transfer, transfer: Transfer) -> bool:
    """Whether a request repeats one before it: the first answer was to the first of them."""
    same = (later.index, later.sub, later.direction) == (
        transfer.index,
        transfer.sub,
        transfer.direction,
    )
    return same and later.seq > transfer.seq and later.kind == transfer.kind == "expedited"


def _nameless(data: bytes) -> bool:
    """Whether an abort names no object: cut short, or 0000h:00 as some clients send it."""
    return len(data) < 4 or data[1:4] == bytes(3)
