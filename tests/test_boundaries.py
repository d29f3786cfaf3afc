"""The import boundaries of CONTRIBUTING.md, proven in fresh interpreters."""

import subprocess
import sys

import pytest

ANALYSIS_STACK = ("pandas", "pyarrow", "rerun")


def modules_after(statement: str) -> set[str]:
    """Top-level modules loaded by a statement in a fresh interpreter."""
    code = f"{statement}\nimport sys\nprint('\\n'.join({{name.split('.')[0] for name in sys.modules}}))"
    done = subprocess.run(
        [sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("statement", "banned"),
    [
        ("import syncline_logger.cli", ("syncline_analyzer", "can", "numpy", *ANALYSIS_STACK)),
        ("import syncline_logger.recorder", ("syncline_analyzer", *ANALYSIS_STACK)),
        # python-can would bring asammdf: seconds in which nothing is recorded and Ctrl-C is lost.
        ("import syncline_logger.sources.python_can", ("asammdf", *ANALYSIS_STACK)),
        ("import syncline_logger.message_log", ("asammdf", *ANALYSIS_STACK)),
        ("import syncline_schemas.devices", ("syncline_analyzer", "syncline_logger")),
        ("import syncline_schemas.capture.writer", ("syncline_analyzer", "syncline_logger")),
    ],
)
def test_recorder_never_loads_the_analyzer(statement: str, banned: tuple[str, ...]) -> None:
    assert modules_after(statement).isdisjoint(banned)


def test_reading_an_eds_is_light() -> None:
    eds = "[MandatoryObjects]\\n1=0x1000\\n[1000]\\nObjectType=7\\nDataType=7\\nAccessType=ro\\n"
    statement = f"from syncline_schemas.eds import load_eds\nload_eds(b'{eds}')"
    loaded = modules_after(statement)
    assert "canopen" in loaded
    assert loaded.isdisjoint(("asammdf", "sympy", *ANALYSIS_STACK))


@pytest.mark.parametrize(
    "module", ["engine", "session", "readers", "cli", "views.rerun_view", "views.report_html"]
)
def test_analyzer_never_loads_the_logger(module: str) -> None:
    pytest.importorskip("pandas")
    assert "syncline_logger" not in modules_after(f"import syncline_analyzer.{module}")


def test_analyzer_package_itself_is_light() -> None:
    assert modules_after("import syncline_analyzer").isdisjoint(("numpy", *ANALYSIS_STACK))
