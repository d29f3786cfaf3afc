"""A process that records a bus on which it sends itself; run by the kill tests.

Arguments: folder of the capture, sidecar file, pause between frames [s]. Each frame's time and
number go to the sidecar before the frame goes to the bus, with a write that a kill cannot undo.
"""

import os
import sys
import threading
import time
from pathlib import Path

from can import Message
from can.interfaces.virtual import VirtualBus

from syncline_logger.bus_options import BusOptions
from syncline_logger.recorder import record
from syncline_logger.sources.python_can import PythonCanSource


def send(sidecar: Path, pause_s: float) -> None:
    """Send numbered frames for ever."""
    log = os.open(sidecar, os.O_WRONLY | os.O_CREAT)
    with VirtualBus("child") as bus:
        number = 0
        while True:
            os.write(log, f"{time.time_ns()} {number}\n".encode())
            data = number.to_bytes(8, "little")
            bus.send(Message(arbitration_id=0x185, is_extended_id=False, data=data))
            number += 1
            time.sleep(pause_s)


def main() -> None:
    """Record until killed; the path of the capture goes to stdout."""
    folder, sidecar, pause_s = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3])
    sender = threading.Thread(target=send, args=(sidecar, pause_s), daemon=True)

    def started(path: Path) -> None:
        sys.stdout.write(f"{path}\n")
        sys.stdout.flush()
        sender.start()

    record([PythonCanSource(BusOptions("a", "virtual", "child"))], folder, on_start=started)


if __name__ == "__main__":
    main()
