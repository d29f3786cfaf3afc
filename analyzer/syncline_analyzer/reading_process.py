"""The process that reads captures for another one, and sends it what the analyses are fed with.

A process and not threads: reading and analysis both hold the interpreter most of the time, so that
threads of one process only take turns. Of 10 million frames of a small machine each takes either
of them about 0.2 us of processor time, their start included; the other one half as much again where
the bit rate is known, as then it is told who waited for whom.
The child reads, merges, joins, marks copies, parts by bus, finds silences, sorts by identifier and
computes lengths on the wire; the parent runs all folds that need to know what others found. To send
a frame costs about a tenth of reading it.
"""

import pickle
import signal
import sys
import traceback
from copy import copy
from dataclasses import fields, replace
from io import FileIO

from syncline_analyzer.batch_transfer import packed
from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.messages import MessageWriter
from syncline_analyzer.reading import LocalReading
from syncline_analyzer.reading_messages import End, Failed, News, Opened, SentStep
from syncline_analyzer.reading_request import Request
from syncline_schemas.collecting import rare_collections
from syncline_schemas.errors import SynclineError
from syncline_schemas.processors import leave

_AT_ONCE = ("resolution_ns", "bitrates", "data_bitrates")
"""Facts that are looked at while frames are read; the others only at the end."""
_ALL = tuple(field.name for field in fields(CaptureFacts))


def main() -> None:
    """Read what standard input asks for; the messages go to standard output."""
    # Ctrl-C is meant for the parent, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    out, sys.stdout = FileIO(sys.stdout.fileno(), "wb", closefd=False), sys.stderr
    try:
        request: Request = pickle.load(sys.stdin.buffer)
    except EOFError:  # started in vain
        return
    # The parent has one of its own to work with.
    leave(1)
    with MessageWriter(out) as writer, rare_collections():
        try:
            _read(request, writer)
        except Exception as error:  # noqa: BLE001  whatever it is, the parent raises it
            writer.put(Failed(_sendable(error)))


def _read(request: Request, writer: MessageWriter) -> None:
    reading = LocalReading(request)
    watch = _Watch(reading)
    writer.put(Opened(list(reading.facts), reading.buses, reading.origin_ns, reading.veil))
    for step in reading.steps():
        batches = [packed(batch) for batch in step.batches]
        writer.put(SentStep(replace(step, batches=[]), batches, watch.news(_AT_ONCE)))
    news = watch.news(_ALL)
    writer.put(End(news, reading.census, reading.doubled, reading.silence, reading.veil))


class _Watch:
    """Knows what was told of each file, to tell only what changed."""

    def __init__(self, reading: LocalReading) -> None:
        self._reading = reading
        self._told = [{name: copy(getattr(each, name)) for name in _ALL} for each in reading.facts]

    def news(self, names: tuple[str, ...]) -> News:
        """What changed of these facts."""
        changed = {}
        for number, (told, facts) in enumerate(zip(self._told, self._reading.facts, strict=True)):
            now = {name: getattr(facts, name) for name in names}
            if new := {name: value for name, value in now.items() if value != told[name]}:
                changed[number] = new
                told |= {name: copy(value) for name, value in new.items()}
        return News(self._reading.buses, changed)


def _sendable(error: Exception) -> Exception:
    """An error as it can be sent, with the way to it where it is nobody's mistake but ours."""
    if not isinstance(error, SynclineError):
        error.add_note("".join(traceback.format_exception(error)))
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001  some errors cannot be made again from what they hold
        return RuntimeError("".join(traceback.format_exception(error)))
    return error
