"""Questions to a data set, by SQL and ready-made, against what was planted in a simulated fleet."""

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("duckdb")
pytest.importorskip("fsspec")

import pandas as pd
import pyarrow.parquet as pq
from click.testing import CliRunner, Result

from syncline_analyzer.fleet import open_fleet
from syncline_analyzer.fleet.ask import Fleet
from syncline_analyzer.fleet.questions import QUESTIONS
from syncline_analyzer.fleet_command import fleet as command
from syncline_samples.fleet import Planted
from syncline_schemas.errors import UsageError
from tests.analyzer.fleet.fleet_builder import analyze, capture, small_log, small_mcap

DAYS = (0, 1, 7, 8)
"""From Monday, 2 March 2026, on: two weeks of two days."""
SECOND_WEEK = "2026-03-09"


def planted(machine: int, day: int) -> Planted:
    """One thing on each machine; machine 5 is healthy."""
    late = day >= 7
    return {
        0: Planted(noise_counts=30 if late else 0, eeprom_writes=1000 + 10 * day),
        1: Planted(resets=3 if late else 0, eeprom_writes=1000 + 500 * day),
        2: Planted(emcys=3 if late else 0, eeprom_writes=1000 + 10 * day),
        3: Planted(late_us=400 if late else 0, eeprom_writes=1000 + 10 * day),
        4: Planted(sync_jitter_us=200, eeprom_writes=1300 if late else 1000),
    }.get(machine, Planted(eeprom_writes=1000 + 10 * day))


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set of six machines."""
    folder = tmp_path_factory.mktemp("line")
    for machine in range(6):
        for day in DAYS:
            capture(folder / "in", machine, day, planted(machine, day))
    analyze(folder / "in", folder / "out")
    return folder / "out"


@pytest.fixture(scope="module")
def asked(line: Path) -> Fleet:
    return open_fleet(str(line))


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set of two machines: 0012, and one whose name is a formula."""
    folder = tmp_path_factory.mktemp("small")
    small_mcap(folder / "in" / "0012" / "a.mcap", recording_id="a")
    small_mcap(folder / "in" / "=1+2" / "b.mcap", recording_id="b", frames=30)
    analyze(folder / "in", folder / "out")
    return folder / "out"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(command, ["query", *map(str, arguments)])


def who(frame: pd.DataFrame, *columns: str) -> list[tuple[object, ...]]:
    """Rows of some columns, by machine `machine` and these."""
    return [tuple(row) for row in frame[["machine", *columns]].itertuples(index=False)]


def test_emcy_since_names_machine_node_and_how_often(asked: Fleet) -> None:
    told = asked.emcy_since(SECOND_WEEK, code="7320h")
    assert who(told, "node", "code", "messages", "captures") == [("machine-002", 1, "7320h", 6, 2)]
    assert str(told["first"].iloc[0])[:10] == "2026-03-09"
    assert asked.emcy_since("2026-03-10", code="73xx")["messages"].tolist() == [3]
    assert asked.emcy_since("2026-03-11").empty
    assert asked.emcy_since(until=SECOND_WEEK).empty
    assert asked.emcy_since(code="74xx").empty
    assert asked.emcy_since(machine="machine-00[0-1]").empty


def test_quantities_by_week_are_what_was_planted(asked: Fleet) -> None:
    latency = asked.over_time("pdo-latency", machine="machine-003", node=3)
    assert latency["week"].astype(str).tolist() == ["2026-03-02", "2026-03-09"]
    assert latency["captures"].tolist() == [2, 2]
    before, after = latency["value"]
    assert 390 < after - before < 440

    noise = asked.over_time("encoder-noise", machine="machine-000", node=3)["value"].tolist()
    assert noise[0] == 0
    assert noise[1] > 0.05

    jitter = asked.over_time("sync-jitter")
    jitter["big"] = jitter["value"] > 200
    assert set(jitter[jitter["big"]]["machine"]) == {"machine-004"}

    resets = asked.over_time("resets", machine="machine-001")
    assert resets[resets["node"] == 2]["total"].tolist() == [0, 6]
    assert set(resets[resets["node"] != 2]["total"]) == {0}

    wear = asked.over_time("eeprom-wear", node=3)
    grown = wear[wear["machine"] == "machine-001"]
    assert grown["value"].round().tolist() == [500, 500]
    assert grown["total"].tolist() == [500, 3500]
    assert grown["latest_reading"].tolist() == [1500, 5000]


def test_heartbeats_with_few_samples_are_left_out(asked: Fleet) -> None:
    slow = asked.over_time("heartbeat", machine="machine-005", every="month", node=20)
    assert slow["captures"].tolist() == [4]
    assert slow["value"].round().tolist() == [1000]
    assert asked.over_time("heartbeat", node=20, min_samples=50).empty


def test_outliers_are_the_planted_ones(asked: Fleet) -> None:
    told = asked.outliers(min_captures=2, since=SECOND_WEEK)
    assert set(who(told[told["quantity"] != "pdo-latency"], "quantity")) == {
        ("machine-000", "encoder-noise"),
        ("machine-001", "eeprom-wear"),
        ("machine-001", "resets"),
        ("machine-002", "emcy"),
        ("machine-004", "eeprom-wear"),
        ("machine-004", "sync-jitter"),
    }
    latency = told[told["quantity"] == "pdo-latency"]
    assert set(latency["machine"]) == {"machine-003"}
    assert latency["node"].iloc[0] == 3
    assert set(told["machines"]) == {6}
    assert asked.outliers("resets", machine="machine-005").empty


def test_outliers_need_enough_machines_and_captures(asked: Fleet) -> None:
    assert asked.outliers(min_captures=2, min_machines=7).empty
    assert asked.outliers(min_captures=5).empty


def test_changes_after_a_date_are_the_planted_ones(asked: Fleet) -> None:
    told = asked.changes(SECOND_WEEK, min_captures=2, threshold=4.0)
    assert set(who(told, "quantity")) == {
        ("machine-000", "encoder-noise"),
        ("machine-003", "pdo-latency"),
    }
    latency = told[(told["quantity"] == "pdo-latency") & (told["node"] == 3)].iloc[0]
    assert 390 < latency["difference"] < 440
    assert (latency["captures_before"], latency["captures_after"]) == (2, 2)
    # Six in two captures of twelve seconds, and none before: chance makes that once in 64 times.
    rates = asked.changes(SECOND_WEEK, min_captures=2, threshold=2.0)
    events = rates[rates["quantity"].isin(["resets", "emcy"])]
    assert set(who(events, "quantity", "node")) == {
        ("machine-001", "resets", 2),
        ("machine-002", "emcy", 1),
    }
    assert asked.changes(SECOND_WEEK, min_captures=3).empty


def test_changed_objects_were_steady_before(asked: Fleet) -> None:
    told = asked.changed_objects(SECOND_WEEK)
    assert who(told, "node", "object", "value_before", "value_after", "first_seen") == [
        ("machine-004", 3, "1011h:04", "1000", "1300", "2026-03-09")
    ]
    assert asked.changed_objects("2026-03-10", min_captures=4).empty


def test_every_question_is_answered_on_the_command_line(line: Path) -> None:
    for name, question in QUESTIONS.items():
        needed = [f"--{option}={SECOND_WEEK}" for option in question.required]
        result = run(line, "--question", name, "--format", "csv", *needed)
        assert result.exit_code == 0, result.output
        assert result.output.splitlines()[0].count(",") >= 8


def test_sql_sees_machine_names_as_text_and_tables_without_rows(small: Path) -> None:
    told = open_fleet(str(small))
    nodes = told.query("SELECT machine, date, node, heartbeats FROM nodes ORDER BY machine")
    assert who(nodes, "date", "node", "heartbeats") == [
        ("0012", "2026-03-02", 5, 20),
        ("=1+2", "2026-03-02", 5, 30),
    ]
    assert told.query("SELECT * FROM emcy").columns[:5].tolist() == [
        "machine", "date", "capture_id", "bus", "node",
    ]  # fmt: skip
    assert (
        told.query("SELECT count(*) AS n FROM captures JOIN nodes USING (capture_id)")["n"][0] == 2
    )
    assert told.query("SELECT * FROM nodes WHERE machine = $m", {"m": "0012"})["node"].tolist() == [
        5
    ]


def test_stamps_are_utc(small: Path) -> None:
    start = open_fleet(str(small)).query("SELECT start FROM captures")["start"]
    assert start[0] == pd.Timestamp("2026-03-02T06:00:00Z")


@pytest.mark.parametrize(
    "sql",
    [
        "INSERT INTO nodes VALUES (1)",
        "COPY nodes TO '{out}/x.csv'",
        "WITH x AS (COPY (SELECT 1) TO '{out}/x.csv') SELECT 1",
        "SELECT * FROM query('WITH x AS (COPY (SELECT 1) TO ''{out}/x.csv'') SELECT 1')",
        "SELECT * FROM read_text('{here}')",
        "SELECT * FROM '{here}'",
        "SELECT * FROM glob('{out}/*')",
        "ATTACH '{out}/x.db'",
        "SET enable_external_access = true",
        "INSTALL httpfs",
        "LOAD httpfs",
        "SELECT 1; SELECT 2",
        "",
    ],
)
def test_sql_reads_tables_only(small: Path, tmp_path: Path, sql: str) -> None:
    statement = sql.format(out=tmp_path.as_posix(), here=Path(__file__).as_posix())
    with pytest.raises(UsageError, match="SQL: "):
        open_fleet(str(small)).query(statement)
    assert not list(tmp_path.iterdir())


def test_python_variables_are_no_tables(small: Path) -> None:
    secret = pd.DataFrame({"a": [1]})
    with pytest.raises(UsageError, match="no table secret"):
        open_fleet(str(small)).query("SELECT * FROM secret")
    assert len(secret) == 1


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["SELECT * FROM nods"], "there is no table nods; there are captures, nodes"),
        (["SELECT nod FROM nodes"], 'Candidate bindings: "node"'),
        (["SELEC 1"], "syntax error"),
        (["--question", "emcys"], "there is no question 'emcys'; there are emcy, "),
        (
            ["--question", "emcy", "--every", "day"],
            "question 'emcy' has no --every; it takes --code",
        ),
        (["--question", "changes"], "question 'changes' needs --after"),
        (["--question", "emcy", "--code", "73"], "write four hexadecimal digits"),
        (["--question", "emcy", "--code", "0x73"], "write four hexadecimal digits"),
        (["--question", "emcy", "--since", "1.3.2026"], "'1.3.2026' is no date"),
        (["--question", "outliers", "--quantity", "speed"], "there are pdo-latency, "),
        (["SELECT 1", "--question", "emcy"], "leave out the SQL"),
        (["--since", "2026-03-01"], "--since: name the --question"),
        (["SELECT 1", "--format", "parquet"], "needs -o FILE"),
    ],
)
def test_mistakes_are_one_line_that_names_what_there_is(
    small: Path, arguments: list[str], told: str
) -> None:
    result = run(small, *arguments)
    assert isinstance(result.exception, UsageError)
    assert told in str(result.exception)
    assert "\n" not in str(result.exception)


def test_a_folder_without_a_data_set_is_said(tmp_path: Path) -> None:
    result = run(tmp_path, "SELECT 1")
    assert "no data set is here" in str(result.exception)


def test_forms_of_an_answer(small: Path, tmp_path: Path) -> None:
    sql = "SELECT machine, start, frames, buses, frames / 0.0 AS inf FROM captures ORDER BY machine"
    text = run(small, sql).output.splitlines()
    assert text[0].split() == ["machine", "start", "frames", "buses", "inf"]
    assert text[1].split()[:3] == ["0012", "2026-03-02T06:00:00.000000000Z", "20"]
    assert text[-1] == "(2 rows)"
    rows = list(csv.reader(run(small, sql, "--format", "csv").output.splitlines()))
    assert [row[0] for row in rows] == ["machine", "0012", "'=1+2"]
    assert rows[1][3] == '["can0"]'
    lines = [json.loads(each) for each in run(small, sql, "--format", "jsonl").output.splitlines()]
    assert lines[1] == {
        "machine": "=1+2",
        "start": "2026-03-02T06:00:00.000000000Z",
        "frames": 30,
        "buses": ["can0"],
        "inf": None,
    }
    path = tmp_path / "answer.parquet"
    assert run(small, sql, "--format", "parquet", "-o", path).output == ""
    assert pq.read_table(path)["machine"].to_pylist() == ["0012", "=1+2"]
    assert [each.name for each in tmp_path.iterdir()] == ["answer.parquet"]


def test_without_sql_it_lists_questions_and_tables(small: Path) -> None:
    output = run(small).output
    assert "changed-objects" in output
    assert "--after" in output
    assert "nodes" in output.split("Tables")[1]
    assert "emcy " not in output.split("Tables")[1]
    assert "heartbeat_period_ms" in run(small, "DESCRIBE nodes").output


def test_captures_without_a_date_are_counted(tmp_path: Path) -> None:
    small_mcap(tmp_path / "in" / "m" / "a.mcap", recording_id="a")
    small_log(tmp_path / "in" / "m" / "b.log", start_ns=0)
    analyze(tmp_path / "in", tmp_path / "out")
    told = run(tmp_path / "out", "--question", "bus-load", "--bus", "can0")
    assert "1 capture without a date" in told.stderr
    assert len(told.stdout.splitlines()) == 2


def test_a_capture_that_goes_meanwhile_is_said(small: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(small, out)
    opened = open_fleet(str(out))
    shutil.rmtree(next(out.glob("machine=0012")))
    with pytest.raises(UsageError, match=r"changed while it was read, or .* ask again"):
        opened.query("SELECT * FROM nodes")


def test_an_object_store_is_asked_the_same(tmp_path: Path) -> None:
    small_mcap(tmp_path / "in" / "0012" / "a.mcap", recording_id="a")
    analyze(tmp_path / "in", "memory://fleet-query")
    nodes = open_fleet("memory://fleet-query").query("SELECT machine, heartbeats FROM nodes")
    assert who(nodes, "heartbeats") == [("0012", 20)]


def test_the_command_itself_says_nothing_but_the_answer(small: Path) -> None:
    words = ["fleet", "query", str(small), "SELECT count(*) AS captures FROM captures"]
    program = "from syncline_logger.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, *words], capture_output=True, text=True, check=True
    )
    assert (done.stdout.split(), done.stderr) == (["captures", "2"], "")
