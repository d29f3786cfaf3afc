"""Findings on the bit rate that everything about the load of a bus rests on."""

from collections.abc import Iterator
from itertools import chain

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.results import Finding
from syncline_schemas.wording import counted

_SAYS = {
    "bus-description": "the bus description",
    "recorded": "the capture",
    "command-line": "the command line",
}
_OVERRIDE = {
    "bus-description": "Correct the bit rate of {bus} in the bus description to {rate}: it goes before"
    " the capture and the command line.",
    "recorded": "State {rate} for {bus} in a bus description: it goes before what the capture says.",
    "command-line": "Analyze again with {rate} as --bitrate.",
}


def _contradicted(facts: Facts) -> Iterator[Finding]:
    """Bit rates that are told, and that the spacing of the frames rules out."""
    context, capture = facts.context, facts.analysis.capture
    for bus, found in context.estimates.items():
        told, source = context.bitrates.get(bus), context.bitrate_sources.get(bus)
        if told is None or source not in _SAYS or context.contradiction(bus) is None:
            continue
        factor = max(told, found.bitrate) / min(told, found.bitrate)
        seen = found.bitrate / 1000
        yield Finding(
            "bus.bitrate_contradicted",
            "warning",
            bus,
            None,
            capture.begin_ns,
            capture.end_ns,
            f"By {_SAYS[source]} the bit rate of {bus} is {told / 1000:g} kbit/s, but its frames"
            f" follow one another as {seen:g} kbit/s allow ({counted(found.frames, 'spacing')}, of"
            f" short and long frames alike): the load of {bus} is wrong by a factor of"
            f" {factor:.3g}, and device and waiting times are not told.",
            f"{_SAYS[source].capitalize()} names the bit rate of another bus or machine.",
            _OVERRIDE[source].format(bus=bus, rate=f"{seen:g} kbit/s"),
            [],
        )


def _impossible(facts: Facts) -> Iterator[Finding]:
    """Bit rates that are told, and at which the frames would not have had the time."""
    context, capture = facts.context, facts.analysis.capture
    for bus, percent in context.impossible_loads.items():
        source = context.bitrate_sources.get(bus)
        if source not in _SAYS or context.contradiction(bus) is not None:
            continue
        yield Finding(
            "bus.bitrate_contradicted",
            "warning",
            bus,
            None,
            capture.begin_ns,
            capture.end_ns,
            f"By {_SAYS[source]} the bit rate of {bus} is {context.bitrates[bus] / 1000:g} kbit/s,"
            f" but its frames would need {percent:.0f} % of the time at that rate: load, device and"
            f" waiting times of {bus} are not told.",
            f"{_SAYS[source].capitalize()} names the bit rate of another bus or machine; or several"
            " recordings of one bus stand in the capture as one.",
            _OVERRIDE[source].format(bus=bus, rate="the bit rate of the machine"),
            [],
        )


RULES: tuple[Rule, ...] = (
    Rule(
        "bus.bitrate_contradicted",
        "The bit rate that was told is not the one at which the frames pass the wire.",
        "The tightest spacings between frames of different length, or the time that all frames would"
        " need; no single frame.",
        (
            "Only where the spacings of short and long frames rule out every other bit rate.",
            "Not where both are nearly the same: there are more bit rates than the usual ones.",
            "Stamps that come in bundles, in coarse steps or late leave it silent.",
        ),
        lambda facts: chain(_contradicted(facts), _impossible(facts)),
    ),
)
