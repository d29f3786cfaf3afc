"""What the screen and the full text have in common: the console, first lines, the bar of states."""

import os
from collections.abc import Iterator
from itertools import groupby
from typing import IO, TYPE_CHECKING

from syncline_analyzer.results import Analysis
from syncline_analyzer.views.line import Line
from syncline_analyzer.views.palette import STATE_COLOURS, STATE_LETTERS, css
from syncline_analyzer.views.words import Clock, extent_words, printable

if TYPE_CHECKING:
    from rich.console import Console

PIPE_WIDTH = 120
"""Columns where the output is no terminal and COLUMNS does not say otherwise."""

_AS_TERMINAL = {"COLUMNS", "FORCE_COLOR", "TTY_COMPATIBLE"}
"""Variables by which rich writes to what is no terminal as it would to one."""

SEVERITY_WORDS = {"error": "ERROR", "warning": "WARNING", "info": "NOTE"}


def is_plain(stream: IO[str]) -> bool:
    """Whether a stream is no terminal, and nothing says that it shall be written to as to one."""
    return not stream.isatty() and _AS_TERMINAL.isdisjoint(os.environ)


def console_for(stream: IO[str]) -> "Console":
    """A console on a stream: its colours and width on a terminal, plain text of 120 columns else."""
    from rich.console import Console

    piped = not stream.isatty() and "COLUMNS" not in os.environ
    return Console(file=stream, width=PIPE_WIDTH if piped else None, highlight=False, markup=False)


def start_lines(analysis: Analysis, clock: Clock) -> Iterator[Line]:
    """When the capture was made, and what is to be known before anything else."""
    capture = analysis.capture
    if not capture.frames:
        yield Line.of("There are no frames in it, so there are no times.", "dim")
    elif not clock.timed:
        yield Line.of("The log has no times: nothing here is about how long or how late.", "yellow")
    elif not clock.dated:
        yield Line.of("The log has no date: times count from its first frame.", "dim")
    else:
        yield Line.of(extent_words(capture, clock), "dim")
    for damage in capture.damage:
        yield Line.of(f"Damaged, read in part: {printable(damage)}", "bold red")
    if capture.frames and not analysis.nodes:
        yield Line.of(
            "No frame proves a CANopen node; this may be a bus of another protocol.", "yellow"
        )


def state_bar(states: list[str]) -> Line:
    """One letter per cell, on the colour of its state."""
    pieces = []
    for state, run in groupby(states):
        letter = STATE_LETTERS[state] if state else " "
        style = f"black on {css(STATE_COLOURS[state])}" if state else ""
        pieces.append((letter * len(list(run)), style))
    return Line(tuple(pieces))
