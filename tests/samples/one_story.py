"""A script played to the analyzer: it must tell what was scripted, and accuse nobody else."""

from pathlib import Path

from syncline_analyzer import open_session
from syncline_analyzer.results import Finding
from syncline_samples.comparison import compare
from syncline_samples.generate import candump_log
from syncline_samples.machine import Scenario


def told(script: Scenario, tmp_path: Path) -> list[Finding]:
    """Findings on a run, without the notes on what angles rest on, which come with any machine."""
    run = script.run()
    return _findings(candump_log(run), run.description_toml, tmp_path)


def _findings(log: bytes, description: str, tmp_path: Path) -> list[Finding]:
    path, described = tmp_path / "one.log", tmp_path / "one.toml"
    path.write_bytes(log)
    described.write_text(description, encoding="utf-8")
    findings = open_session(path, description=described).analysis.findings
    return [each for each in findings if each.severity != "info" or "angle." not in each.id]


def told_alone(script: Scenario, tmp_path: Path) -> None:
    """The analyzer tells what was scripted, and nothing else."""
    run = script.run()
    findings = _findings(candump_log(run), run.description_toml, tmp_path)
    outcome = compare(run.truth.findings, findings)
    assert not outcome.missing, [(each.id, each.node, each.what) for each in outcome.missing]
    assert not outcome.unexpected, [(each.id, each.node, each.text) for each in outcome.unexpected]
