"""Findings on the bit rate that everything about the load of a bus rests on."""

from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.results import Finding
from syncline_schemas.wording import counted

_SAYS = {
    "bus-description": "the bus description",
    "recorded": "the capture",
    "command-line": "the command line",
}
NEAR = 0.1
"""The spacings know the usual bit rates only: one so near to what is told is the same."""


def _contradicted(facts: Facts) -> Iterator[Finding]:
    """Bit rates that are told, and that the spacing of the frames rules out."""
    context, capture = facts.context, facts.analysis.capture
    for bus, found in context.estimates.items():
        told, source = context.bitrates.get(bus), context.bitrate_sources.get(bus)
        if told is None or source not in _SAYS or not found.confident:
            continue
        factor = max(told, found.bitrate) / min(told, found.bitrate)
        if factor < 1 + NEAR:
            continue
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
            f" short and long frames alike): load and waiting times of {bus} are wrong by a factor"
            f" of {factor:.3g}.",
            f"{_SAYS[source].capitalize()} names the bit rate of another bus or machine.",
            f"Analyze again with {seen:g} kbit/s; correct what names the other one.",
            [],
        )


RULES: tuple[Rule, ...] = (
    Rule(
        "bus.bitrate_contradicted",
        "The bit rate that was told is not the one at which the frames pass the wire.",
        "The tightest spacings between frames of different length; no single frame.",
        (
            "Only where the spacings of short and long frames rule out every other bit rate.",
            "Not where both are nearly the same: there are more bit rates than the usual ones.",
            "Stamps that come in bundles, in coarse steps or late leave it silent.",
        ),
        _contradicted,
    ),
)
