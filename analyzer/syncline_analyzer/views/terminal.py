"""What the screen and the full text have in common: the console, first lines, the bar of states."""

import os
from collections.abc import Iterator
from itertools import groupby
from typing import IO

from rich.console import Console
from rich.text import Text

from syncline_analyzer.results import Analysis
from syncline_analyzer.views.palette import STATE_COLOURS, STATE_LETTERS, css
from syncline_analyzer.views.words import Clock, printable

PIPE_WIDTH = 120
"""Columns where the output is no terminal and COLUMNS does not say otherwise."""

SEVERITY_WORDS = {"error": "ERROR", "warning": "WARNING", "info": "NOTE"}


def console_for(stream: IO[str]) -> Console:
    """A console on a stream: its colours and width on a terminal, plain text of 120 columns else."""
    piped = not stream.isatty() and "COLUMNS" not in os.environ
    return Console(file=stream, width=PIPE_WIDTH if piped else None, highlight=False, markup=False)


def start_lines(analysis: Analysis, clock: Clock) -> Iterator[Text]:
    """When the capture was made, and what is to be known before anything else."""
    capture = analysis.capture
    if not capture.frames:
        yield Text("There are no frames in it, so there are no times.", style="dim")
    elif not clock.timed:
        yield Text(
            "The log has no times: nothing here is about how long or how late.", style="yellow"
        )
    elif not clock.dated:
        yield Text("The log has no date: times count from its first frame.", style="dim")
    else:
        begin, end = clock.full(capture.begin_ns), clock.full(capture.end_ns)
        yield Text(begin if begin == end else f"{begin} to {end}", style="dim")
    for damage in capture.damage:
        yield Text(f"Damaged, read in part: {printable(damage)}", style="bold red")
    if capture.frames and not analysis.nodes:
        yield Text(
            "No frame proves a CANopen node; this may be a bus of another protocol.", style="yellow"
        )


def state_bar(states: list[str]) -> Text:
    """One letter per cell, on the colour of its state."""
    bar = Text()
    for state, run in groupby(states):
        count = len(list(run))
        if state:
            bar.append(STATE_LETTERS[state] * count, style=f"black on {css(STATE_COLOURS[state])}")
        else:
            bar.append(" " * count)
    return bar
