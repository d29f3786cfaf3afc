"""`rerun-importer-syncline`: lets `rerun night.blf` open a log with our analysis and layout.

The Rerun viewer starts every program of this prefix on PATH for each file whose ending it does not
know, with the path and settings of its own, and takes a recording from its standard output. Exit
code 66 says that the file is none of ours. Rerun 0.41 never asks for an .mcap, which it imports
itself; with a capture of ours it goes by a pipe: `rerun-importer-syncline line3.mcap | rerun -`.
"""

import argparse
import sys
from pathlib import Path

from syncline_schemas.errors import SynclineError

INCOMPATIBLE = 66
"""`rerun.EXTERNAL_IMPORTER_INCOMPATIBLE_EXIT_CODE`, which is slow to import for every file."""
_FAILED = 1
_PROFILE = "syncline"
_LOGS = (".asc", ".blf", ".trc", ".log")
"""Endings of logs that the viewer itself cannot open."""


def main(arguments: list[str] | None = None) -> int:
    """Write the recording of a capture to standard output; the exit code."""
    path = _path(arguments)
    if not _is_ours(path):
        return INCOMPATIBLE
    try:
        from syncline_analyzer.session import open_session
        from syncline_analyzer.views.rerun_view import write_recording
    except ImportError as error:
        sys.stderr.write(f"syncline: {error}; pip install 'syncline[analyzer]'\n")
        return INCOMPATIBLE
    try:
        session = open_session(path)
        analysis = session.analyze()
    except SynclineError as error:
        sys.stderr.write(f"syncline: {error}\n")
        return _FAILED if path.suffix.lower() == ".mcap" else INCOMPATIBLE
    write_recording(
        analysis,
        lambda recording, layout: recording.stdout(layout),
        session.frames,
        decode=session.decoding,
    )
    return 0


def _path(arguments: list[str] | None) -> Path:
    """The file to open; what the viewer says of how it would log the data is not ours to follow."""
    parser = argparse.ArgumentParser(prog="rerun-importer-syncline", description=__doc__)
    parser.add_argument("path", type=Path, help="a capture")
    path: Path = parser.parse_known_args(arguments)[0].path
    return path


def _is_ours(path: Path) -> bool:
    """Whether it is a capture of our recorder, or has the ending of a log."""
    if not path.is_file():
        return False
    if path.suffix.lower() != ".mcap":
        return path.suffix.lower() in _LOGS
    from syncline_schemas.capture.record_file import RecordFile

    try:
        with path.open("rb") as stream:
            return RecordFile(stream).profile() == _PROFILE
    except (OSError, SynclineError):
        return False


if __name__ == "__main__":
    sys.exit(main())
