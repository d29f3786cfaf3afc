"""What stands in a data set after a run, and after the next one."""

import os
import shutil
import threading
from pathlib import Path

import pytest

pytest.importorskip("duckdb")
pytest.importorskip("fsspec")

import duckdb

from syncline_analyzer import open_session
from syncline_analyzer.fleet import work
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.task import Settings
from syncline_samples.fleet import Planted
from tests.analyzer.fleet.fleet_builder import (
    T0_NS,
    analyze,
    capture,
    content,
    small_log,
    small_mcap,
    standing,
    statuses,
)

HIVE = "hive_types = {machine: VARCHAR, date: VARCHAR, capture_id: VARCHAR}"


def rows(out: Path, table: str, columns: str) -> list[tuple[object, ...]]:
    """Rows of a table as DuckDB reads it by itself."""
    place = f"{out.as_posix()}/machine=*/*/*/{table}.parquet"
    query = f"SELECT {columns} FROM read_parquet('{place}', {HIVE}) ORDER BY ALL"
    with duckdb.connect() as connection:
        return connection.execute(query).fetchall()


def test_tables_are_partitioned_and_tell_what_a_single_analysis_tells(tmp_path: Path) -> None:
    paths = [
        capture(tmp_path / "in", 0, 0, Planted(emcys=1)),
        capture(tmp_path / "in", 0, 1),
        capture(tmp_path / "in", 1, 0, Planted(resets=1)),
    ]
    out = tmp_path / "out"
    assert statuses(analyze(tmp_path / "in", out)) == ["analyzed"] * 3
    assert standing(out) == [
        ("machine-000", "2026-03-02", "warning"),
        ("machine-000", "2026-03-03", "healthy"),
        ("machine-001", "2026-03-02", "error"),
    ]
    alone = [open_session(path).analysis for path in paths]
    assert rows(out, "captures", "machine, date, frames") == [
        ("machine-000", "2026-03-02", alone[0].capture.frames),
        ("machine-000", "2026-03-03", alone[1].capture.frames),
        ("machine-001", "2026-03-02", alone[2].capture.frames),
    ]
    told = [("machine-000", f.id, f.text) for f in alone[0].findings]
    told += [("machine-001", f.id, f.text) for f in alone[2].findings]
    assert rows(out, "findings", "machine, id, text") == sorted(told)
    responses = [
        (row.cob_id, row.response_us.median)
        for analysis in alone
        for row in analysis.pdos
        if row.response_us
    ]
    found = rows(out, "pdos", "cob_id, response_us_median")
    assert [each for each in found if each[1] is not None] == sorted(responses)


def test_only_what_is_new_or_changed_is_done_again(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    first, log = capture(source), small_log(source / "machine-000" / "night.log")
    assert statuses(analyze(source, out)) == ["analyzed"] * 2
    assert analyze(source, out) == []
    # Copied anew, the content is the same: read, not analyzed.
    for path in (first, log):
        os.utime(path, ns=(1, 1))
    assert statuses(analyze(source, out)) == ["unchanged"] * 2
    assert analyze(source, out) == []
    capture(source, 0, 1)
    assert statuses(analyze(source, out)) == ["analyzed"]
    small_log(log, frames=50)
    (done,) = analyze(source, out)
    assert (done.status, done.frames) == ("analyzed", 50)
    # The log's id comes from its content: the old capture of it is gone.
    assert [e.values["frames"] for e in Dataset.open(str(out)).captures].count(50) == 1
    assert len(Dataset.open(str(out)).captures) == 3


def test_another_analysis_is_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    small_mcap(source / "a.mcap", recording_id="one")
    assert statuses(analyze(source, out)) == ["analyzed"]
    monkeypatch.setattr("syncline_analyzer.fleet.identity.code_version", lambda: "later")
    assert statuses(analyze(source, out)) == ["analyzed"]
    assert [entry.version for entry in Dataset.open(str(out)).captures] == ["later"]
    described = Settings({"in": "[bus.can0]\nbitrate = 250000\n"})
    assert statuses(analyze(source, out, settings=described)) == ["analyzed"]
    assert analyze(source, out, settings=described) == []
    # A description of another machine changes nothing here.
    other = {**described.descriptions, "else": "[bus.can0]\nbitrate = 1000000\n"}
    assert analyze(source, out, settings=Settings(other)) == []


def test_a_capture_that_is_of_another_day_or_machine_now_leaves_no_old_one(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    path = small_mcap(source / "press" / "a.mcap", recording_id="one")
    analyze(source, out)
    assert standing(out) == [("press", "2026-03-02", "healthy")]
    small_mcap(path, recording_id="one", start_ns=T0_NS + 86_400 * 10**9)
    analyze(source, out)
    assert standing(out) == [("press", "2026-03-03", "healthy")]
    path.parent.rename(source / "winder")
    analyze(source, out)
    assert standing(out) == [("winder", "2026-03-03", "healthy")]
    assert sorted(p.name for p in out.iterdir()) == ["machine=winder"]


def test_segments_that_were_deleted_at_the_source_change_nothing(tmp_path: Path) -> None:
    source, out = tmp_path / "in" / "press", tmp_path / "out"
    first = small_mcap(source / "a.mcap", recording_id="one")
    small_mcap(source / "b.mcap", recording_id="one", segment=1, start_ns=T0_NS + 10**10)
    (done,) = analyze(source, out)
    assert done.frames == 40
    first.unlink()
    assert analyze(source, out) == []


def test_failures_are_rows_until_they_are_over(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    broken = source / "broken.mcap"
    broken.write_bytes(b"no capture at all")
    (source / "notes.txt").write_text("to do: tighten the cable", encoding="utf-8")
    small_mcap(source / "good.mcap", recording_id="one")
    assert statuses(analyze(source, out)) == ["analyzed", "failed", "no capture"]
    failures = {e.files[0].url.rsplit("/")[-1]: e for e in Dataset.open(str(out)).failures}
    assert failures["broken.mcap"].kind == "capture"
    assert "no known format" in failures["broken.mcap"].reason
    assert failures["notes.txt"].kind == "no capture"
    assert analyze(source, out) == []
    assert statuses(analyze(source, out, retry_failed=True)) == ["failed", "no capture"]
    small_mcap(broken, recording_id="two")
    assert statuses(analyze(source, out)) == ["analyzed"]
    left = Dataset.open(str(out))
    assert [e.kind for e in left.failures] == ["no capture"]
    assert len(left.captures) == 2


def test_a_bug_of_ours_is_a_failure_of_one_capture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("division by zero")

    small_mcap(tmp_path / "in" / "a.mcap", recording_id="one")
    monkeypatch.setattr(work, "capture_values", fail)
    (done,) = analyze(tmp_path / "in", tmp_path / "out")
    assert (done.status, done.reason) == (
        "failed",
        "internal error: ZeroDivisionError: division by zero",
    )
    assert not list((tmp_path / "out").rglob("nodes.parquet"))
    assert not (tmp_path / "out" / ".staging").exists()


def test_what_a_killed_run_left_is_removed_after_a_week(tmp_path: Path) -> None:
    small_mcap(tmp_path / "in" / "a.mcap", recording_id="one")
    staging = tmp_path / "out" / ".staging"
    for run in ("killed", "running"):
        (staging / run / "x").mkdir(parents=True)
    os.utime(staging / "killed", ns=(T0_NS, T0_NS))
    analyze(tmp_path / "in", tmp_path / "out")
    assert [each.name for each in staging.iterdir()] == ["running"]


def test_the_same_content_twice_is_one_capture(tmp_path: Path) -> None:
    source, out = tmp_path / "in" / "press", tmp_path / "out"
    log = small_log(source / "b.log")
    shutil.copy(log, source / "a.log")
    analyze(source, out)
    (entry,) = Dataset.open(str(out)).captures
    assert [Path(f.url).name for f in (*entry.files, *entry.copies)] == ["a.log", "b.log"]
    assert analyze(source, out) == []
    # On two machines it is two: whoever copied it wanted it so.
    small_log(tmp_path / "in" / "winder" / "a.log")
    assert statuses(analyze(tmp_path / "in", out)) == ["analyzed"]
    assert len(Dataset.open(str(out)).captures) == 2


def test_a_damaged_copy_does_not_hide_a_whole_one(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    whole = small_mcap(tmp_path / "a.mcap", recording_id="one", frames=5000)
    damaged = source / "press" / "a.mcap"
    damaged.parent.mkdir(parents=True)
    content = bytearray(whole.read_bytes())
    content[content.index(b"zstd") + 100] ^= 0xFF  # in the first chunk
    damaged.write_bytes(content)
    os.utime(damaged, ns=(T0_NS, whole.stat().st_mtime_ns - 10**9))
    analyze(source, out)
    (entry,) = Dataset.open(str(out)).captures
    assert entry.values["damage"]
    assert entry.values["frames"] < 5000
    # Found later, and younger.
    backup = source / "backup" / "a.mcap"
    backup.parent.mkdir()
    shutil.copy(whole, backup)
    assert statuses(analyze(source, out)) == ["analyzed"]
    (entry,) = Dataset.open(str(out)).captures
    assert (entry.values["frames"], entry.values["damage"]) == (5000, [])
    assert [Path(f.url).parent.name for f in (*entry.files, *entry.copies)] == ["backup", "press"]
    assert entry.partition.machine == "press"
    assert analyze(source, out) == []


def test_a_copy_that_comes_after_a_failure_is_read(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    broken = small_mcap(source / "press" / "a.mcap", recording_id="one", frames=5000)
    content = broken.read_bytes()
    broken.write_bytes(content[:1000] + bytes(len(content) - 1000))
    statuses(analyze(source, out))
    frames = [entry.values["frames"] for entry in Dataset.open(str(out)).captures]
    assert frames in ([], [0])
    os.utime(broken, ns=(T0_NS, T0_NS))
    statuses(analyze(source, out))
    copy = source / "backup" / "a.mcap"
    copy.parent.mkdir()
    copy.write_bytes(content)
    assert statuses(analyze(source, out)) == ["analyzed"]
    (entry,) = Dataset.open(str(out)).captures
    assert entry.values["frames"] == 5000


def test_names_of_machines_are_percent_encoded_and_numbers_stay_text(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    names = [
        "0012",
        "line 3/press=1".replace("/", "_"),
        "Пресс",
        "..",
        "__HIVE_DEFAULT_PARTITION__",
    ]
    for number, name in enumerate(names):
        small_mcap(source / f"{number}.mcap", recording_id=str(number), machine=name)
    analyze(source, out)
    assert [machine for machine, _, _ in standing(out)] == sorted(names)
    assert rows(out, "captures", "DISTINCT machine") == [(name,) for name in sorted(names)]
    assert {path.name for path in tmp_path.iterdir()} == {"in", "out"}


def test_a_name_that_is_too_long_is_the_same_one_each_time(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    small_mcap(source / "a.mcap", recording_id="a", machine="x" * 300)
    assert statuses(analyze(source, out)) == ["analyzed"]
    assert analyze(source, out) == []


def test_a_log_without_dates_is_undated(tmp_path: Path) -> None:
    log = tmp_path / "in" / "a.log"
    log.parent.mkdir()
    log.write_text("  can0  705   [1]  05\n" * 5, encoding="ascii")
    (done,) = analyze(tmp_path / "in", tmp_path / "out")
    assert done.status == "analyzed"
    assert done.partition is not None
    assert (done.partition.date, done.frames) == ("undated", 5)
    assert rows(tmp_path / "out", "captures", "start, start_utc_ns") == [(None, None)]


def test_samples_reports_and_recordings_come_where_they_are_asked_for(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    capture(source)
    analyze(source, out)
    assert not list(out.rglob("pdo_responses.parquet"))
    (entry,) = Dataset.open(str(out)).captures
    assert Dataset.open(str(out)).report(entry) is None
    asked = Settings(extras=("samples", "report", "recording"))
    assert statuses(analyze(source, out, settings=asked)) == ["analyzed"]
    data = Dataset.open(str(out))
    (entry,) = data.captures
    report, recording = data.report(entry), data.recording(entry)
    assert report is not None
    assert recording is not None
    assert Path(report).read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert Path(recording).read_bytes().startswith(b"RRF2")
    alone = open_session(entry.files[0].url).analysis
    assert rows(out, "pdo_responses", "count(*)") == [
        (sum(len(each.t_ns) for each in alone.responses),)
    ]
    assert rows(out, "trace_samples", "count(*)") == [
        (sum(len(each.t_ns) for each in alone.trace_data),)
    ]
    # Who wants less than there is gets no less.
    assert analyze(source, out) == []


def test_a_reader_beside_a_run_sees_whole_captures_only(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    stop, seen, torn = threading.Event(), set(), []

    def poll() -> None:
        while not stop.is_set():
            for folder in out.glob("machine=*/date=*/capture_id=*"):
                try:
                    names = {path.name for path in folder.glob("*.parquet")}
                except FileNotFoundError:  # taken away as a whole since it was listed
                    continue
                if names and not names >= {"captures.parquet", "nodes.parquet", "pdos.parquet"}:
                    # The folder may have been taken away while it was listed.
                    torn.extend([names] if folder.exists() and _still(folder, names) else [])
                seen.add(len(names))

    reader = threading.Thread(target=poll)
    reader.start()
    try:
        for emcys in (0, 1, 2):
            for machine in range(3):
                capture(source, machine, 0, Planted(emcys=emcys))
            analyze(source, out)
    finally:
        stop.set()
        reader.join()
    assert torn == []
    assert max(seen) > 10


def _still(folder: Path, names: set[str]) -> bool:
    return {path.name for path in folder.glob("*.parquet")} == names


def test_a_data_set_within_its_source_is_no_source(tmp_path: Path) -> None:
    small_mcap(tmp_path / "a.mcap", recording_id="one")
    out = tmp_path / "fleet"
    analyze(tmp_path, out, settings=Settings(extras=("report",)))
    shutil.copy(tmp_path / "a.mcap", out / "b.mcap")
    assert analyze(tmp_path, out, settings=Settings(extras=("report",))) == []


def test_what_a_run_holds_is_the_same_each_time(tmp_path: Path) -> None:
    source = tmp_path / "in"
    capture(source, 0, 0, Planted(emcys=1))
    small_log(source / "machine-000" / "night.log")
    for name in ("a", "b"):
        analyze(source, tmp_path / name)
    assert content(tmp_path / "a") == content(tmp_path / "b")
