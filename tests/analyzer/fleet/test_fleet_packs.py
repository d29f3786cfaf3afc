"""Packs: what questions read of many captures is what stands in the captures' own folders."""

import os
import random
import shutil
from pathlib import Path

import pytest

pytest.importorskip("duckdb")
pytest.importorskip("fsspec")

import duckdb
import fsspec

from syncline_analyzer.fleet import packing, relations
from syncline_analyzer.fleet.database import Database, Query
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.packing import pack_captures
from syncline_analyzer.fleet.schemas import tables
from syncline_analyzer.fleet.storage import open_storage
from syncline_samples.fleet import Planted
from syncline_schemas.errors import UsageError
from tests.analyzer.fleet.fleet_builder import T0_NS, analyze, capture, small_mcap

HIVE = "hive_types = {machine: VARCHAR, date: VARCHAR, capture_id: VARCHAR}"


def told(out: Path | str, table: str, columns: str = "*") -> list[tuple[object, ...]]:
    """Rows of a table by our own way."""
    query = Query(f'SELECT {columns} FROM "{table}" ORDER BY ALL', {})
    with Database(Dataset.open(str(out))).ask(query) as reader:
        return [tuple(row.values()) for row in reader.read_all().to_pylist()]


def stored(out: Path, table: str, columns: str) -> list[tuple[object, ...]]:
    """Rows of the captures' own files, as DuckDB reads them by itself."""
    place = f"{out.as_posix()}/machine=*/*/*/{table}.parquet"
    query = f"SELECT {columns} FROM read_parquet('{place}', {HIVE}) ORDER BY ALL"
    with duckdb.connect() as connection:
        return connection.execute(query).fetchall()


@pytest.fixture(scope="module")
def analyzed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two machines' captures of two days in `in` and their tables in `out`."""
    folder = tmp_path_factory.mktemp("packs")
    for machine in range(2):
        capture(folder / "in", machine, 0, Planted(emcys=machine, resets=1))
        capture(folder / "in", machine, 1)
    analyze(folder / "in", folder / "out")
    return folder


def packs(out: Path) -> list[str]:
    folder = out / "_packs"
    return sorted(path.name for path in folder.iterdir()) if folder.exists() else []


def test_every_table_is_the_same_with_packs(
    analyzed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(packing, "_PARTS", 2)
    out = shutil.copytree(analyzed / "out", tmp_path / "out")
    before = {table: told(out, table) for table in tables()}
    assert pack_captures(open_storage(str(out)), "run", min_loose=3, full=3) == 4
    assert len(packs(out)) == 2
    assert set(Dataset.open(str(out)).packs.values()) == set(packs(out))
    assert {table: told(out, table) for table in tables()} == before
    columns = "machine, date, capture_id, id, text"
    assert told(out, "findings", columns) == stored(out, "findings", columns)
    assert len(before["findings"]) == 3


def test_captures_that_changed_or_went_are_not_read_from_a_pack(
    analyzed: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(analyzed, tmp_path / "copy")
    source, out = folder / "in", folder / "out"
    pack_captures(open_storage(str(out)), "run", min_loose=3)
    first = Dataset.open(str(out)).captures
    shutil.rmtree(out / first[0].partition.folder)
    capture(source, 1, 0, Planted(emcys=7, share=2.0))  # Another content under the same name.
    analyze(source, out)
    data = Dataset.open(str(out))
    assert len(data.captures) - len(data.packs) >= 1
    for table in ("emcy", "nodes", "findings"):
        columns = "machine, date, capture_id, bus, node"
        assert told(out, table, columns) == stored(out, table, columns)
    columns = "machine, date, capture_id, frames"
    assert told(out, "captures", columns) == stored(out, "captures", columns)


def more(source: Path, out: Path, numbers: range) -> None:
    """Analyze so many further captures of 20 heartbeats."""
    for number in numbers:
        at_ns = T0_NS + number * 10**12
        small_mcap(source / f"{number}.mcap", recording_id=str(number), created_ns=at_ns)
    analyze(source, out)


def aged(out: Path) -> None:
    """All packs were written two days ago."""
    for path in (out / "_packs").rglob("*.parquet"):
        at_ns = path.stat().st_mtime_ns - 2 * 86_400 * 10**9
        os.utime(path, ns=(at_ns, at_ns))


def test_few_new_captures_make_no_pack_and_small_packs_become_one(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    storage = open_storage(str(out))
    more(source, out, range(3))
    assert pack_captures(storage, "run", min_loose=4, full=10) == 0
    assert packs(out) == []
    more(source, out, range(3, 4))
    assert pack_captures(storage, "run", min_loose=4, full=10) == 4
    assert len(packs(out)) == 1
    more(source, out, range(4, 11))
    assert pack_captures(storage, "run", min_loose=4, full=10) == 11
    sizes = Dataset.open(str(out)).packs
    assert sorted(map(list(sizes.values()).count, packs(out))) == [0, 1, 10]
    (full,) = (name for name in packs(out) if list(sizes.values()).count(name) == 10)
    aged(out)
    more(source, out, range(11, 15))
    assert pack_captures(storage, "run", min_loose=4, full=10) == 5
    assert full in packs(out)
    assert len(packs(out)) == 3
    assert len(told(out, "nodes")) == 15
    assert not (out / ".staging" / "run").exists() or not any((out / ".staging/run").iterdir())


def test_whoever_has_the_data_set_open_can_go_on_asking(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    storage = open_storage(str(out))
    more(source, out, range(3))
    pack_captures(storage, "run", min_loose=3)
    opened = Database(Dataset.open(str(out)))
    more(source, out, range(3, 6))
    assert pack_captures(storage, "run", min_loose=3) == 6
    with opened.ask(Query("SELECT * FROM nodes", {})) as reader:
        assert reader.read_all().num_rows == 3
    aged(out)
    pack_captures(storage, "run", min_loose=3)
    assert len(packs(out)) == 1


def test_a_damaged_pack_is_none(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    more(source, out, range(3))
    pack_captures(open_storage(str(out)), "run", min_loose=1)
    (name,) = packs(out)
    folder = out / "_packs" / name
    index, table = folder / "captures.parquet", folder / "nodes.parquet"
    whole, chance = index.read_bytes(), random.Random(1)
    for _ in range(40):
        content = bytearray(whole)
        begin = chance.randrange(len(content))
        content[begin : begin + 4] = chance.randbytes(4)
        index.write_bytes(content[: chance.choice([begin, len(content)])])
        assert {entry.values["frames"] for entry in Dataset.open(str(out)).captures} == {20}
    index.write_bytes(whole)
    assert Dataset.open(str(out)).packs
    table.write_bytes(table.read_bytes()[:-1])
    assert Dataset.open(str(out)).packs == {}
    assert len(told(out, "nodes")) == 3
    table.unlink()
    assert len(told(out, "nodes")) == 3
    index.unlink()
    aged(out)
    assert pack_captures(open_storage(str(out)), "run", min_loose=1) == 3
    assert name not in packs(out)


@pytest.mark.parametrize("packed", [True, False])
def test_no_answer_comes_from_changed_bytes(tmp_path: Path, packed: bool) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    more(source, out, range(2))
    if packed:
        pack_captures(open_storage(str(out)), "run", min_loose=1)
    (path, *_) = out.glob("_packs/*/nodes.parquet" if packed else "machine=*/**/nodes.parquet")
    answer, whole = told(out, "nodes"), path.read_bytes()
    of_pages = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    errors = []
    for at in random.Random(2).sample(range(4, of_pages), 300):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        try:
            assert told(out, "nodes") == answer, at
        except UsageError as error:
            errors.append(str(error))
    assert len(errors) > 100
    assert all(("_packs, which the next run makes again" in each) == packed for each in errors)


def test_a_capture_with_a_damaged_table_stays_as_it_is(tmp_path: Path) -> None:
    source, out = tmp_path / "in", tmp_path / "out"
    more(source, out, range(4))
    cut, gone, *_ = sorted(out.glob("machine=*/*/*/nodes.parquet"))
    cut.write_bytes(cut.read_bytes()[:300])
    gone.unlink()
    assert pack_captures(open_storage(str(out)), "run", min_loose=1) == 2
    assert len(Dataset.open(str(out)).packs) == 2
    assert len(told(out, "captures")) == 4
    with pytest.raises(UsageError, match="ask again"):
        told(out, "nodes")
    shutil.rmtree(cut.parent)
    shutil.rmtree(gone.parent)
    assert len(told(out, "nodes")) == 2


def test_only_the_pack_is_opened(
    analyzed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = shutil.copytree(analyzed / "out", tmp_path / "out")
    pack_captures(open_storage(str(out)), "run", min_loose=1)
    opened: list[str] = []
    files = relations._files

    def counted(storage: object, schema: object, places: dict[str, object]) -> object:
        opened.extend(places)
        return files(storage, schema, places)  # type: ignore[arg-type]

    monkeypatch.setattr(relations, "_files", counted)
    assert told(out, "nodes")
    assert [path.split("/")[0] for path in opened] == ["_packs"]


def test_packs_in_an_object_store(tmp_path: Path) -> None:
    fs = fsspec.filesystem("memory")
    fs.store.clear()
    source, out = tmp_path / "in", "memory://fleet/a"
    path = capture(source, 1, 0, Planted(emcys=1))
    small_mcap(source / "one.mcap", recording_id="one")
    analyze(source, out)
    before = told(out, "findings")
    assert pack_captures(open_storage(out), "run", min_loose=1) == 2
    assert told(out, "findings") == before
    assert set(Dataset.open(out).packs)
    small_mcap(source / "more.mcap", recording_id="more")
    analyze(source, out)
    assert pack_captures(open_storage(out), "run", min_loose=1) == 3
    assert len(set(Dataset.open(out).packs.values())) == 1
    # Replaced by one of the same size.
    path.unlink()
    for frames in (21, 22):
        small_mcap(source / "one.mcap", recording_id="one", frames=frames)
        analyze(source, out)
        assert (frames,) in told(out, "captures", "frames")
    fs.store.clear()
