"""How the machine moves: shafts and tilts, in integers so that every platform gets the same."""

from bisect import bisect_right
from collections.abc import Sequence

_NS = 1_000_000_000


class Shaft:
    """A shaft whose speed follows straight lines between points, again and again.

    Args:
        points: (seconds, rpm) pairs from second 0 on; the last point's speed is where the next
            round starts.
        start_turns: where the shaft stands at time 0.
    """

    def __init__(self, *points: tuple[int, int], start_turns: int = 0) -> None:
        self._t_ns = [seconds * _NS for seconds, _ in points]
        self._rpm = [rpm for _, rpm in points]
        self._nanoturns = [0]
        for leg in range(len(points) - 1):
            travelled = self._leg(leg, self._t_ns[leg + 1] - self._t_ns[leg])
            self._nanoturns.append(self._nanoturns[leg] + travelled)
        self._start = start_turns * _NS

    def _leg(self, leg: int, t_ns: int) -> int:
        length_ns = self._t_ns[leg + 1] - self._t_ns[leg]
        slope = self._rpm[leg + 1] - self._rpm[leg]
        return (2 * self._rpm[leg] * length_ns * t_ns + slope * t_ns * t_ns) // (120 * length_ns)

    def nanoturns(self, t_ns: int) -> int:
        """Where the shaft stands, in 1e-9 turns."""
        rounds, t_ns = divmod(t_ns, self._t_ns[-1])
        leg = bisect_right(self._t_ns, t_ns) - 1
        travelled = self._nanoturns[leg] + self._leg(leg, t_ns - self._t_ns[leg])
        return self._start + rounds * self._nanoturns[-1] + travelled


class Tilt:
    """A platform whose two angles follow straight lines between points, again and again.

    Args:
        points: (seconds, longitudinal, lateral) from second 0 on, angles in millidegrees; the last
            point should be the first one's pose.
    """

    def __init__(self, *points: tuple[int, int, int]) -> None:
        self._points: Sequence[tuple[int, int, int]] = points
        self._t_ns = [point[0] * _NS for point in points]

    def millidegrees(self, t_ns: int) -> tuple[int, int]:
        """Longitudinal and lateral angle, signed."""
        t_ns %= self._t_ns[-1]
        leg = bisect_right(self._t_ns, t_ns) - 1
        part = t_ns - self._t_ns[leg]
        length = self._t_ns[leg + 1] - self._t_ns[leg]
        _, long0, lat0 = self._points[leg]
        _, long1, lat1 = self._points[leg + 1]
        return (long0 + (long1 - long0) * part // length, lat0 + (lat1 - lat0) * part // length)
