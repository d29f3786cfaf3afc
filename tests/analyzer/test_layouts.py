"""Layouts for other viewers: every path in them is held against the messages that were recorded."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from syncline_analyzer.layout_command import layout
from syncline_analyzer.layouts.channels import decoded_channels
from syncline_analyzer.layouts.foxglove import foxglove_layout
from syncline_logger.record_options import RecordOptions
from syncline_logger.recorder import record_batches
from syncline_samples.scenarios import bad_day
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.description import BusDescription
from syncline_schemas.errors import CaptureError, UsageError

Json = dict[str, Any]


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty-two seconds of the bad day with two EMCYs, as our recorder writes them."""
    path = tmp_path_factory.mktemp("layouts") / "line3.mcap"
    run = bad_day(22.0).start()
    description = BusDescription.loads(run.description_toml)
    options = RecordOptions(description=description, sync=False, recording_id="layout")
    record_batches(run.stream(), [BusInfo("can0", 0, 500_000)], path, options)
    return path


@pytest.fixture(scope="module")
def messages(capture: Path) -> dict[str, Any]:
    """One message of every topic, decoded by other people's decoders."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    found: dict[str, Any] = {}
    with capture.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, message)
    return found


def panels(text: str) -> dict[str, Json]:
    configs: dict[str, Json] = json.loads(text)["configById"]
    return configs


def paths_of(configs: dict[str, Json]) -> Iterator[tuple[str, str]]:
    """(panel, message path) of all panels."""
    for panel, config in configs.items():
        for series in config.get("paths", []):
            yield panel, series["value"]
        if "topicPath" in config:
            yield panel, config["topicPath"]


def placed(node: Any) -> Iterator[str]:
    """Panels that a layout tree places."""
    if isinstance(node, str):
        yield node
    else:
        yield from placed(node["first"])
        yield from placed(node["second"])


def test_every_topic_and_field_of_the_foxglove_layout_is_in_the_capture(
    capture: Path, messages: dict[str, Any]
) -> None:
    configs = panels(foxglove_layout(decoded_channels([capture])))
    named = list(paths_of(configs))
    assert len(named) > 40
    for panel, path in named:
        topic, _, field = path.partition(".")
        assert topic in messages, path
        if not field:
            assert panel.startswith("RawMessages!")
            continue
        value = getattr(messages[topic], field)
        wanted = (int, float) if panel.startswith("Plot!") else str
        assert isinstance(value, wanted), path


def test_foxglove_layout_shows_states_emcys_and_every_decoded_value(
    capture: Path, messages: dict[str, Any]
) -> None:
    configs = panels(foxglove_layout(decoded_channels([capture])))
    named = {path for _, path in paths_of(configs)}
    for topic, message in messages.items():
        service = topic.rsplit("/", 1)[-1]
        if "tpdo" in service:
            fields = [field.name for field in message.DESCRIPTOR.fields]
            assert {f"{topic}.{field}" for field in fields} <= named, topic
        field = {"heartbeat": "state_name", "emcy": "text", "nmt": "command_name"}.get(service)
        if field:
            assert f"{topic}.{field}" in named
    labels = [each["label"] for each in configs["StateTransitions!nmt"]["paths"]]
    assert "can0 2 guide roller" in labels
    assert len(configs["StateTransitions!emcy"]["paths"]) == 2


def test_every_panel_is_placed_once_and_every_placed_panel_is_there(capture: Path) -> None:
    whole = json.loads(foxglove_layout(decoded_channels([capture])))
    configs = whole["configById"]
    shown = list(placed(whole["layout"]))
    for config in configs.values():
        shown += [tab["layout"] for tab in config.get("tabs", [])]
    assert sorted(shown) == sorted(configs)


def test_rerun_imports_the_channels_and_the_layout_maps_components_that_it_made(
    capture: Path, tmp_path: Path
) -> None:
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    from syncline_analyzer.layouts.plain_rerun import write_plain

    channels = decoded_channels([capture])
    reader = RrdReader(write_plain([capture], channels, tmp_path / "channels.rrd"))
    components: dict[str, set[str]] = {}
    for chunk in reader.stream():
        names = chunk.to_record_batch().schema.names
        components.setdefault(chunk.entity_path, set()).update(names)
    for channel in channels:
        assert f"{channel.schema}:message" in components[channel.topic]
    assert len(reader.blueprints()) == 1


def folder_named(path: Path) -> Path:
    path.mkdir()
    return path


def test_command_writes_the_layout_that_the_ending_asks_for(capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "line3.json"
    done = CliRunner().invoke(layout, [str(capture), str(out)], catch_exceptions=False)
    assert done.exit_code == 0
    assert "StateTransitions!nmt" in panels(out.read_text(encoding="utf-8"))
    refused = CliRunner().invoke(layout, [str(capture), str(tmp_path / "x.xml")])
    assert "name it .json for Foxglove or .rrd for Rerun" in str(refused.exception)
    for name in ("foo.json", "foo.rrd"):
        refused = CliRunner().invoke(layout, [str(capture), str(tmp_path / "nope" / name)])
        assert isinstance(refused.exception, UsageError)
        assert f"there is no folder {tmp_path / 'nope'}" in str(refused.exception)
    refused = CliRunner().invoke(layout, [str(capture), str(folder_named(tmp_path / "x.json"))])
    assert "x.json: cannot be written: Is a directory" in str(refused.exception)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"(1700000000.000000) can0 705#05", "no MCAP capture; layouts are for the channels that"),
        (b"\x89MCAP0\r\n", "no closed MCAP file; make one of it with syncline recover"),
        (None, "No such file"),
    ],
)
def test_what_is_no_capture_is_refused(content: bytes | None, said: str, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    if content:
        path.write_bytes(content)
    with pytest.raises(CaptureError, match=said):
        decoded_channels([path])


def test_raw_frames_alone_have_no_decoded_channels() -> None:
    sample = Path(__file__).parents[2] / "samples" / "bad_day.mcap"
    with pytest.raises(CaptureError, match="only 'syncline record' with decoding on"):
        decoded_channels([sample])
