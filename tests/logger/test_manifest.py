"""Manifests: what is written is read again, and what is broken is no manifest."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from syncline_logger.manifest import Manifest, MarkNote, Segment
from syncline_logger.recording_folder import RecordingFolder
from tests.logger.store_runs import Run, S, files_of, numbers_in


def manifest() -> Manifest:
    segments = [Segment(0, "a.mcap", "closed", 1, 2, 3, 4, [MarkNote(5, "trigger")])]
    made = Manifest("id", 7, "1.0", "here", "virtual x", 8, ["a", "b"], 9, "stopped", 10)
    made.segments = [*segments, Segment(1, "b.part.mcap")]
    made.delete(made.segments[0], 11, "too old")
    made.segments.insert(0, segments[0])
    return made


def test_it_is_read_as_it_was_written() -> None:
    assert Manifest.from_json(manifest().to_json()) == manifest()


def test_fields_of_a_later_version_are_left_out() -> None:
    values = json.loads(manifest().to_json())
    values["weather"] = values["segments"][0]["weather"] = "rain"
    assert Manifest.from_json(json.dumps(values)) == manifest()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("segments", [{"segment": 0, "file": "../precious.mcap"}]),
        ("segments", [{"segment": 0, "file": "/etc/passwd"}]),
        ("segments", [{"segment": 0, "file": 5}]),
        ("segments", [{"segment": "0", "file": "a.mcap"}]),
        ("segments", [{"segment": 0, "file": "a.mcap", "state": "gone"}]),
        ("segments", [5]),
        ("segments", None),
        ("recording_id", "../x"),
        ("recording_id", ["id"]),
        ("buses", "a"),
        ("buses", [1]),
        ("end_ns", "now"),
        ("schema", "something else"),
    ],
)
def test_what_is_broken_is_none(name: str, value: Any) -> None:
    assert Manifest.from_json(json.dumps(json.loads(manifest().to_json()) | {name: value})) is None


_ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5),
    lambda each: (
        st.lists(each, max_size=3) | st.dictionaries(st.text(max_size=5), each, max_size=3)
    ),
    max_leaves=8,
)


@given(changes=st.dictionaries(st.sampled_from(list(json.loads(manifest().to_json()))), _ANY))
def test_no_content_makes_it_raise(changes: dict[str, Any]) -> None:
    Manifest.from_json(json.dumps(json.loads(manifest().to_json()) | changes))


@given(data=st.binary(max_size=60))
def test_no_bytes_make_it_raise(data: bytes) -> None:
    Manifest.from_json(data.decode(errors="replace"))


@pytest.mark.parametrize("seed", range(12))
def test_a_folder_of_broken_files_keeps_no_recorder_from_starting(
    tmp_path: Path, seed: int
) -> None:
    import random

    rng = random.Random(seed)
    before = Run(tmp_path, recording_id="old").step(5).kill()
    for path in [*files_of(tmp_path), tmp_path / "old.json"]:
        data = bytearray(path.read_bytes())
        for _ in range(rng.randrange(1, 20)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        path.write_bytes(data[: rng.randrange(len(data))] if seed % 3 == 0 else data)
    run = Run(tmp_path, recording_id="new", resumes=True, start_ns=before.now_ns + S).step(2)
    run.finish()
    assert numbers_in(*(p for p in files_of(tmp_path) if "_new" in p.name)) == list(range(200))


def a_month(segments: int) -> Manifest:
    """A recording of many files of a minute, each sixtieth with a mark that reaches back three."""
    made = Manifest("month", buses=["a"])
    for n in range(segments):
        made.segments.append(Segment(n, f"{n}.mcap", "closed", n * 60 * S, (n + 1) * 60 * S))
        if n % 60 == 0:
            made.segments[n].mark(MarkNote(n * 60 * S, "trigger", (n - 3) * 60 * S + 1))
    return made


def test_marks_reach_back_over_many_files() -> None:
    made = a_month(600)
    assert made.spread_marks()
    assert [n for n in range(600) if made.segments[n].marks] == [
        n for n in range(598) if n % 60 in (57, 58, 59, 0)
    ][:-1]
    assert not made.spread_marks()


def test_the_mark_that_reaches_farthest_counts() -> None:
    made = Manifest("id")
    made.segments = [Segment(n, f"{n}.mcap", "closed", n * S, (n + 1) * S) for n in range(6)]
    made.segments[4].mark(MarkNote(4 * S, "far", 2 * S))
    made.segments[5].mark(MarkNote(5 * S, "near", 5 * S))
    made.spread_marks()
    assert [bool(each.marks) for each in made.segments] == [False, True, True, True, True, True]


def test_a_long_manifest_is_written_seldom_and_whole_at_the_end(tmp_path: Path) -> None:
    now_ns = 0
    folder = RecordingFolder(tmp_path, "here", elapsed_ns=lambda: now_ns)
    made = a_month(1000)
    folder.add(made)
    written = []
    for n in range(100):
        made.segments.append(Segment(1000 + n, f"{1000 + n}.mcap"))
        folder.save(made)
        text = (tmp_path / "month.json").read_text(encoding="utf-8")
        read = Manifest.from_json(text)
        assert read is not None
        written.append(len(read.segments))
        now_ns += S
    assert 5 < len(set(written)) < 20
    made.end_ns = now_ns
    folder.save(made)
    assert Manifest.from_json((tmp_path / "month.json").read_text(encoding="utf-8")) == made
