"""README, docs and --help say what is true of the code."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("**/*.md"))]


def test_made_pages_are_those_that_the_code_makes(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    # A process of its own: click keeps the help option of the first call of a command.
    subprocess.run([sys.executable, str(ROOT / "docs" / "generate.py"), str(tmp_path)], check=True)
    pages = [made.relative_to(tmp_path) for made in sorted(tmp_path.glob("**/*.md"))]
    assert len(pages) > 8
    for page in pages:
        written = (ROOT / "docs" / page).read_text(encoding="utf-8")
        made = (tmp_path / page).read_text(encoding="utf-8")
        assert written == made, f"{page}: python -m docs.generate"
    listed = {path.name for path in (ROOT / "docs" / "devices").glob("*.md")}
    assert listed == {page.name for page in pages if page.parent.name == "devices"}


def _toml_examples(page: Path) -> list[str]:
    return re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def test_examples_of_the_bus_description_are_descriptions(tmp_path: Path) -> None:
    from syncline_schemas.description import BUS_KEYS, NODE_KEYS, BusDescription

    examples = _toml_examples(ROOT / "docs" / "bus-description.md")
    assert len(examples) >= 2
    read = [BusDescription.loads(text) for text in examples]
    whole = read[0]
    assert (whole.bitrate("can0"), whole.data_bitrate("can1")) == (500_000, 2_000_000)
    twin = whole.node("can0", 6)
    assert twin is not None
    assert (twin.same_shaft_as, twin.ratio, twin.tolerance_deg) == (5, -2.5, 3.0)
    boom = whole.node("can9", 10)
    assert boom is not None
    assert boom.overrides == {"res": 100, "perp_formula": "atan"}
    text = "\n".join(examples)
    for key in {*BUS_KEYS, *NODE_KEYS} - {"node", "eds"}:
        assert re.search(rf"\b{key}\b", text), f"no example of {key}"
    for other in _toml_examples(ROOT / "README.md"):
        BusDescription.loads(other)


def test_every_override_and_contradiction_stands_in_the_page() -> None:
    from syncline_schemas.devices import device_names, load_device

    page = (ROOT / "docs" / "bus-description.md").read_text(encoding="utf-8")
    for name in device_names(()):
        device = load_device(name, ())
        assert device.contradictions
        assert {each.override for each in device.contradictions} - {""} <= set(device.overrides)
        _, _, part = page.partition(f"### {name}: ")
        part = part.partition("###")[0]
        assert all(f"| {setting} |" in part for setting in device.overrides), name


def test_every_help_ends_with_two_examples() -> None:
    pytest.importorskip("pandas")
    import click

    from syncline_logger.cli import cli

    root = click.Context(cli, info_name="syncline", **cli.context_settings)
    for name in cli.list_commands(root):
        command = cli.get_command(root, name)
        assert command is not None
        text = command.get_help(click.Context(command, info_name=name, parent=root))
        last = [line for line in text.splitlines() if line.strip()][-2:]
        assert all(line.strip().startswith("syncline ") for line in last), (name, last)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_paths_in_a_page_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", text):
        assert (page.parent / target).exists(), target


def test_readme_commands_are_real_commands() -> None:
    pytest.importorskip("pandas")
    import click

    from syncline_logger.cli import cli

    known = set(cli.list_commands(click.Context(cli, **cli.context_settings)))
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    used = set(re.findall(r"^\s*(?:.*uv run )?syncline ([a-z]+)", text, re.MULTILINE))
    assert used
    assert used <= known
