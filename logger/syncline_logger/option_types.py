"""Values on the command line: durations, and options that take several words as python-can's do."""

import re

import click

_UNIT_NS = {
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "m": 60_000_000_000,
    "h": 3_600_000_000_000,
    "d": 86_400_000_000_000,
}


def duration_ns(text: str) -> int:
    """Nanoseconds of a time span written as 500ms, 10s, 5m, 2h, 1d, or in seconds.

    >>> duration_ns("1.5s"), duration_ns("5m")
    (1500000000, 300000000000)
    """
    match = re.fullmatch(r"(\d+)(?:\.(\d{1,9}))?\s*(ms|s|m|h|d)?", text.strip())
    if not match:
        raise click.BadParameter(f"'{text}' is no time; write 500ms, 10s, 5m, 2h or 1d")
    unit = _UNIT_NS[match[3] or "s"]
    billionths = int((match[2] or "").ljust(9, "0"))
    span_ns = int(match[1]) * unit + billionths * unit // 1_000_000_000
    if span_ns == 0:
        raise click.BadParameter("the time must be more than nothing")
    return span_ns


class SeveralWordsCommand(click.Command):
    """A command whose options in `several` take all words up to the next option.

    So that `--bus-kwargs app_name=x serial=1` works as with python-can's own tools.
    """

    several: frozenset[str] = frozenset({"--bus-kwargs", "--timing", "--filter"})

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse with each further word given its option again."""
        spread: list[str] = []
        option = None
        for word in args:
            if word.startswith("-"):
                option = word if word in self.several else None
                if option is None:
                    spread.append(word)
            elif option is not None:
                spread += [option, word]
            else:
                spread.append(word)
        return super().parse_args(ctx, spread)
