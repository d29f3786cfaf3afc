"""How well the stamps of an adapter's own clock were mapped onto UTC."""

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Self

from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    from syncline_schemas.proto import syncline_pb2


@dataclass(frozen=True, slots=True)
class AdapterFit:
    """The clock samples of one adapter in a capture.

    Attributes:
        samples: how many there are.
        residual_ns: largest error of t that the last of them allows, the shortest delay between
            adapter and recorder left out.
        worst_residual_ns: the same of the worst: usually the first, before much was seen.
        rate_ppb: how much faster than the adapter's clock t runs, by the last.
    """

    samples: int
    residual_ns: int
    worst_residual_ns: int
    rate_ppb: int

    @classmethod
    def of(cls, sample: "syncline_pb2.ClockSample", before: "AdapterFit | None") -> Self:
        """The fit with one sample more; `before` is None at the first."""
        return cls(
            before.samples + 1 if before else 1,
            sample.residual_ns,
            max(before.worst_residual_ns if before else 0, sample.residual_ns),
            sample.rate_ppb,
        )


def fits_record(fits: Mapping[str, AdapterFit]) -> dict[str, str]:
    """The metadata record of fits by bus name, for a capture that has no clock samples of its own.

    >>> fits_record({"can0": AdapterFit(9, 2_000, 80_000, -350)})
    {'can0': '9 2000 80000 -350'}
    """
    return {
        bus: f"{fit.samples} {fit.residual_ns} {fit.worst_residual_ns} {fit.rate_ppb}"
        for bus, fit in fits.items()
    }


def fits_of(record: Mapping[str, str]) -> dict[str, AdapterFit]:
    """Fits by bus name of a record; what cannot be read is left out."""
    found = {}
    for bus, text in record.items():
        if re.fullmatch(r"[0-9]{1,18} [0-9]{1,18} [0-9]{1,18} -?[0-9]{1,18}", text):
            samples, residual_ns, worst_ns, rate_ppb = map(int, text.split(" "))
            found[bus] = AdapterFit(samples, residual_ns, worst_ns, rate_ppb)
    return found
