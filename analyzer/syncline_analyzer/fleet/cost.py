"""What a piece of work takes: processor time and memory of this process."""

import sys
import time
from contextlib import suppress
from pathlib import Path

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_RESET_PEAK = "5"


class Meter:
    """Measures from when it was made on."""

    def __init__(self) -> None:
        self._begun_s = time.process_time()
        # Linux forgets the peak of what ran before (proc(5), clear_refs).
        with suppress(OSError):
            _CLEAR.write_text(_RESET_PEAK, encoding="ascii")

    @property
    def cpu_s(self) -> float:
        """Processor time of all threads since then [s]."""
        return time.process_time() - self._begun_s

    @property
    def peak_mb(self) -> float | None:
        """Most memory since then; where a system keeps no such number, since the process began."""
        with suppress(OSError, StopIteration):
            lines = _STATUS.read_text(encoding="ascii").splitlines()
            return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024
        with suppress(ImportError):  # Windows has no such module
            import resource

            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            return peak / (1 << 20) if sys.platform == "darwin" else peak / 1024
        return None
