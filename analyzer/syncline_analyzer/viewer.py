"""Starting the Rerun viewer on a recording, reachable from this machine only."""

import os
import subprocess
import sys
from pathlib import Path

LOOPBACK = "127.0.0.1"


def viewer_command(recording: Path | str, *, web: bool) -> list[str]:
    """The command line of the viewer: a window, or a page that a browser on this machine opens."""
    own = ["--bind", LOOPBACK, "--port", "auto", "--hide-welcome-screen"]
    command = [sys.executable, "-m", "rerun", *own]
    return [*command, *(["--web-viewer", "--web-viewer-port", "0"] if web else []), str(recording)]


def show(recording: Path | str, *, web: bool) -> int:
    """Show a recording, or what has a URL, until the viewer is closed; the viewer's exit code."""
    # Without CI in its environment the viewer reports its use to its makers.
    environment = {**os.environ, "CI": "true"}
    return subprocess.call(viewer_command(recording, web=web), env=environment)
