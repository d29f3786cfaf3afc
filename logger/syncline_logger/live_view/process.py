"""The live view's own process: taken frames on standard input, a Rerun viewer at the other end.

`python -m syncline_logger.live_view.process TARGET`, where TARGET is "viewer", the address of one,
or a file to write.
"""

import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time

from syncline_logger.live_view.scene import Scene
from syncline_logger.live_view.taken import Begun, Taken

VIEWER = "viewer"
LOOPBACK = "127.0.0.1"
MEMORY_LIMIT = "1GB"
"""Of the viewer; it forgets the oldest beyond it."""
NOT_OPENED = 3
"""Exit code: the viewer could not be opened, for example because there is no screen."""
_OPENING_S = 5.0
"""A viewer that ends so soon with an error was never open."""


def main(target: str) -> None:
    """Show what comes until there is no more; the viewer stays open after that."""
    # Ctrl-C is meant for the recorder, whose end is the end of the input.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    begun: Begun = pickle.load(sys.stdin.buffer)
    if target == VIEWER:
        target = _open_viewer()
    from syncline_logger.live_view.viewer_sink import ViewerSink

    scene, sink = Scene(begun), ViewerSink(target, begun.start_ns)
    while True:
        try:
            taken: Taken = pickle.load(sys.stdin.buffer)
        except EOFError:
            break
        sink.show(scene.take(taken))
    sink.close()
    os._exit(0)  # without waiting for the thread that waits for the viewer


def _open_viewer() -> str:
    """Start a viewer that only this machine reaches; its address. Its end is that of this process."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port = probe.getsockname()[1]
    command = [
        *(sys.executable, "-m", "rerun", "--bind", LOOPBACK, "--port", str(port)),
        *("--memory-limit", MEMORY_LIMIT, "--hide-welcome-screen", "--expect-data-soon"),
    ]
    # Without CI in its environment the viewer reports its use to its makers.
    viewer = subprocess.Popen(
        command,
        env={**os.environ, "CI": "true"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    threading.Thread(target=_end_with, args=(viewer,), daemon=True).start()
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def _end_with(viewer: "subprocess.Popen[bytes]") -> None:
    begun = time.monotonic()
    code = viewer.wait()
    os._exit(NOT_OPENED if code and time.monotonic() - begun < _OPENING_S else 0)


if __name__ == "__main__":
    main(sys.argv[1])
