"""Findings on settings that are to be kept in a node, or called back."""

from collections.abc import Iterator

from syncline_analyzer.findings.config.settings import restart_after, written
from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.results import Finding
from syncline_schemas.canopen.sdo import abort_meaning

SAVE, LOAD = 0x1010, 0x1011
_NO_STORAGE = (0x06020000, 0x06090011)
"""Abort codes of a node that does not have what it is asked for."""


def _save_refused(facts: Facts) -> Iterator[Finding]:
    """A save that the node refused and that was not repeated with success."""
    saves = [
        row
        for row in facts.analysis.sdo.writes.of_objects(lambda each: each.index == SAVE)
        if row.data == b"save"
    ]
    for row in saves:
        if row.result != "abort" or row.abort_by == "client":
            continue
        later = (other for other in saves if (other.bus, other.node) == (row.bus, row.node))
        again = any(o.seq > row.seq and (o.sub == row.sub or o.result == "ok") for o in later)
        if again:
            continue
        code = row.abort_code or 0
        absent = code in _NO_STORAGE
        if absent and facts.context.shadow.device(facts.number(row.bus), row.node):
            continue
        yield Finding(
            "config.save_refused",
            "info" if absent else "warning",
            row.bus,
            row.node,
            row.start_ns,
            row.end_ns,
            f"{facts.who(row.bus, row.node)} refused to save its settings (1010h:{row.sub}): "
            f"{abort_meaning(code)} ({code:08X}h); they are lost at the next restart.",
            "The device has no such store: it may save with another sub-index or by itself."
            if absent
            else "The device cannot save in its present state, or its memory is faulty.",
            "Whether the device saves in PRE-OPERATIONAL only; then read the settings after a restart.",
            [row.seq],
        )


def _defaults(facts: Facts) -> Iterator[Finding]:
    """The maker's settings were called back by 1011h `load`."""
    for key, row in written(facts):
        if row.index != LOAD or row.data != b"load" or facts.context.shadow.device(*key):
            continue
        restart = restart_after(facts, key, row.seq)
        when = (
            f"took effect with the restart at {facts.moment(restart[1])}"
            if restart
            else "take effect with the next restart, which is not in the capture"
        )
        yield Finding(
            "config.factory_defaults",
            "info",
            row.bus,
            row.node,
            row.start_ns,
            restart[1] if restart else row.end_ns,
            f"{facts.who(row.bus, row.node)} was told at {facts.moment(row.start_ns)} to go back to "
            f"the maker's settings (1011h:{row.sub}); they {when}.",
            "Somebody restored the defaults; settings that were saved before are gone.",
            "Whether node id, bit rate, heartbeat and PDO settings are what the machine needs.",
            [row.seq, restart[0]] if restart else [row.seq],
        )


RULES: tuple[Rule, ...] = (
    Rule(
        "config.save_refused",
        "The node refused to save its settings: they will be gone after the next restart.",
        "The refused write of `save` to 1010h.",
        (
            "A later save that succeeds, or another try of the same one, keeps it silent.",
            "Silent for a store that the device is known not to have.",
        ),
        _save_refused,
        untimed=True,
    ),
    Rule(
        "config.factory_defaults",
        "Somebody made a node of unknown make go back to the maker's settings.",
        "The acknowledged write of `load` to 1011h.",
        (
            "A refused write is none; of devices that are known `device.defaults_pending` tells more.",
        ),
        _defaults,
        untimed=True,
    ),
)
