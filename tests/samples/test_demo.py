"""`syncline demo`: the whole chain, held to its script."""

from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import CliRunner

from syncline_samples import demo
from syncline_samples.machine import Machine, Scenario
from syncline_samples.scenarios import bad_day, healthy_line


@dataclass(frozen=True)
class Phantom:
    """Expects a finding of something that never happens."""

    at_s: float = 5.0

    def arm(self, machine: Machine) -> None:
        machine.expect("nmt.node_lost", 1, self.at_s, what="never happens")


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(demo.demo, arguments)
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def test_the_bad_day_is_found_as_scripted(tmp_path: Path) -> None:
    code, output = run("--out", str(tmp_path))
    assert code == 0, output
    wanted = len(bad_day().start().truth.required())
    assert f"{wanted} of {wanted} scripted faults found, 0 findings" in output
    assert ", 1 recorder gap.\n" in output
    for name in ("bad_day.mcap", "report.html", "session.rrd"):
        assert (tmp_path / name).stat().st_size > 10_000
    assert list((tmp_path / "tables").glob("*.parquet"))


def test_a_missing_package_is_told_before_the_day_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo, "NEEDED", ("pandas", "no_such_package"))
    with pytest.raises(ModuleNotFoundError) as raised:
        run("--out", str(tmp_path))
    assert raised.value.name == "no_such_package"
    assert list(tmp_path.iterdir()) == []


def test_a_second_demo_replaces_the_first(tmp_path: Path) -> None:
    for _ in range(2):
        code, output = run("--out", str(tmp_path), "--seconds", "15")
        assert code == 0, output


def test_a_fault_that_is_not_found_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def phantom_day(seconds: float) -> Scenario:
        healthy = healthy_line(seconds)
        return Scenario("phantom", seconds, healthy.devices, (Phantom(),))

    monkeypatch.setattr(demo, "bad_day", phantom_day)
    code, output = run("--out", str(tmp_path), "--seconds", "12")
    assert code == 1
    assert "NOT FOUND       5.0 s  node 1 (entry roller): never happens (nmt.node_lost)" in output
    assert "0 of 1 scripted faults found" in output


def test_a_finding_that_is_not_in_the_script_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def silent_script(seconds: float) -> Scenario:
        return bad_day(seconds)

    monkeypatch.setattr(demo, "bad_day", silent_script)
    monkeypatch.setattr(Machine, "expect", lambda *args, **more: None)
    code, output = run("--out", str(tmp_path), "--seconds", "20")
    assert code == 1
    assert "NOT IN SCRIPT nmt.unexpected_reset" in output


def test_real_time_over_a_virtual_bus(tmp_path: Path) -> None:
    code, output = run("--out", str(tmp_path), "--seconds", "10", "--real-time")
    assert code == 0, output
