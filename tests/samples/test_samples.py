"""The committed sample captures are what the generator writes."""

import json
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from syncline_samples.generate import generate

SAMPLES = Path(__file__).parents[2] / "samples"
CAPTURES = ("healthy_line.mcap", "bad_day.mcap", "jittery_sync.log")


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("samples")
    generate(folder)
    return folder


def messages(path: Path) -> list[tuple[str, int, int, bytes]]:
    with path.open("rb") as stream:
        return [
            (channel.topic, message.log_time, message.publish_time, message.data)
            for _, channel, message in make_reader(stream).iter_messages()
        ]


def expected(name: str) -> dict[str, Any]:
    return dict(json.loads((SAMPLES / f"{name}.expected.json").read_text(encoding="utf-8")))


@pytest.mark.parametrize("name", CAPTURES)
def test_samples_are_small(name: str) -> None:
    assert (SAMPLES / name).stat().st_size < 400_000


def test_generator_reproduces_every_file(fresh: Path) -> None:
    """Byte for byte; where another zstd compresses otherwise, message for message."""
    for path in sorted(fresh.iterdir()):
        committed = SAMPLES / path.name
        same = path.read_bytes() == committed.read_bytes()
        if path.suffix == ".mcap" and not same:
            assert messages(path) == messages(committed)
        else:
            assert same, f"{path.name}: run python -m syncline_samples.generate"


def test_two_generations_are_equal(fresh: Path, tmp_path: Path) -> None:
    for path in generate(tmp_path):
        assert path.read_bytes() == (fresh / path.name).read_bytes()


@pytest.mark.parametrize("name", ["healthy_line", "bad_day"])
def test_the_official_reader_counts_the_same_frames(name: str) -> None:
    rows = messages(SAMPLES / f"{name}.mcap")
    frames = [row for row in rows if row[0] == "/can/can0/frames"]
    assert len(frames) == expected(name)["capture"]["frames"]


def test_the_log_has_a_line_for_each_frame() -> None:
    lines = (SAMPLES / "jittery_sync.log").read_text(encoding="ascii").splitlines()
    truth = expected("jittery_sync")
    assert len(lines) == truth["capture"]["frames"]
    assert sum("#R" in line for line in lines) == truth["capture"]["remote_frames"]
    assert sum(" 080#" in line for line in lines) == truth["sync"]["count"]
