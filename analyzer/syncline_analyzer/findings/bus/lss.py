"""Findings on LSS: a node-ID or bit rate that was changed, or not taken (CiA 305)."""

from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.folds.bus.lss import LssSetting
from syncline_analyzer.results import Finding
from syncline_schemas.canopen.lss import UNCONFIGURED


def _settings(facts: Facts, command: str, *, refused: bool) -> list[LssSetting]:
    return [
        each
        for each in facts.control.lss.settings
        if each.request.command == command and each.refused == refused
    ]


def _node_id_changed(facts: Facts) -> Iterator[Finding]:
    """Node-IDs that a slave took."""
    for each in _settings(facts, "configure node-ID", refused=False):
        node = each.request.values.get("node_id", 0)
        given = "no node-ID any more" if node == UNCONFIGURED else f"node-ID {node}"
        yield _finding(
            "lss.node_id_changed",
            "info",
            each,
            f"{_whose(facts, each)} was given {given} by LSS, and took it.",
            "Somebody, or the master, configured a device.",
            "Was it meant? The new node-ID must be no other node's, and is lost at the next start"
            " unless it was stored.",
            None if node == UNCONFIGURED else node,
        )


def _whose(facts: Facts, setting: LssSetting) -> str:
    """The device, by the node-ID that it had."""
    before = facts.control.lss.node_before(setting)
    if before is None or before == UNCONFIGURED:
        return "A device"
    return facts.who(setting.request.bus, before)


def _bitrate_changed(facts: Facts) -> Iterator[Finding]:
    """Bit rates that a slave took."""
    for each in _settings(facts, "configure bit timing", refused=False):
        yield _finding(
            "lss.bitrate_changed",
            "info",
            each,
            f"A device was given another bit rate by LSS ({each.request.text}), and took it.",
            "Somebody, or the master, configured a device; it takes effect when it is activated or"
            " at the next start.",
            "All devices of a bus need the same bit rate: was each of them changed?",
        )


def _refused(facts: Facts) -> Iterator[Finding]:
    """Settings that a slave did not take."""
    for command in ("configure node-ID", "configure bit timing", "store configuration"):
        for each in _settings(facts, command, refused=True):
            yield _finding(
                "lss.refused",
                "warning",
                each,
                f'A device did not do what LSS asked it: "{each.request.text}" was answered'
                f' "{each.answer.text}".',
                "The device does not support it, or the value is not allowed.",
                "Look up in the device's manual which LSS services and values it takes.",
            )


def _finding(
    id: str,
    severity: str,
    setting: LssSetting,
    text: str,
    cause: str,
    check_next: str,
    node: int | None = None,
) -> Finding:
    request, answer = setting.request, setting.answer
    return Finding(
        id,
        "warning" if severity == "warning" else "info",
        request.bus,
        node,
        request.t_ns,
        answer.t_ns,
        text,
        cause,
        check_next,
        [request.seq, answer.seq],
    )


_ANSWERED = ("Only where a device answers the request within 2 s.",)
RULES = (
    Rule(
        "lss.node_id_changed",
        "A device was given another node-ID by LSS.",
        "The request and the device's answer.",
        _ANSWERED,
        _node_id_changed,
        untimed=True,
    ),
    Rule(
        "lss.bitrate_changed",
        "A device was given another bit rate by LSS.",
        "The request and the device's answer.",
        _ANSWERED,
        _bitrate_changed,
        untimed=True,
    ),
    Rule(
        "lss.refused",
        "A device did not take a node-ID, bit rate or store command of LSS.",
        "The request and the device's answer.",
        (*_ANSWERED, "A search for devices that nobody answers is none."),
        _refused,
        untimed=True,
    ),
)
