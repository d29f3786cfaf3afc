"""What is wrong with a device description file: what the reader repaired and what it did not see."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from syncline_schemas.devices.build import EDS_SUFFIXES
from syncline_schemas.devices.catalog import load_device
from syncline_schemas.devices.check.general import general_faults
from syncline_schemas.devices.check.kinds import SEVERITIES, Severity
from syncline_schemas.devices.check.objects import object_faults
from syncline_schemas.devices.check.pdos import pdo_faults
from syncline_schemas.devices.check.sheet import Fault as Fault
from syncline_schemas.devices.check.sheet import Sheet, of_warning
from syncline_schemas.eds import load_eds
from syncline_schemas.errors import DescriptionError
from syncline_schemas.xdd import looks_like_xml


@dataclass(frozen=True, slots=True)
class FileCheck:
    """Outcome of a check; `problem` says why nothing in the file can be used, else it is None.

    Attributes:
        title: of the device. variables: how many objects are described, subindexes counted.
        file: name of the EDS, DCF, XDD or XDC that the lines count in.
        faults: the worst first, of equal ones in file order.
    """

    path: Path
    title: str
    variables: int
    faults: tuple[Fault, ...]
    problem: str | None = None
    file: str = ""

    @property
    def usable(self) -> bool:
        """Whether the file can be used."""
        return self.problem is None

    def count(self, severity: Severity) -> int:
        """Number of faults of a severity."""
        return sum(fault.severity == severity for fault in self.faults)


def check_file(path: str | Path) -> FileCheck:
    """Check an EDS, DCF, XDD, XDC or device TOML file; never raises for what is in the file."""
    path = Path(path)
    try:
        device = load_device(path.absolute())
    except DescriptionError as error:
        return FileCheck(path, "", 0, (), str(error))
    eds = [name for name in device.files if name.lower().endswith(EDS_SUFFIXES)]
    faults = check_eds(device.files[eds[0]], Path(eds[0]).suffix) if eds else ()
    file = Path(eds[0]).name if eds else path.name
    return FileCheck(path, device.title, len(device.facts), faults, file=file)


def check_eds(data: bytes, suffix: str = "") -> tuple[Fault, ...]:
    """Faults of an EDS, DCF, XDD or XDC file, the worst first.

    suffix: of the file's name; ".eds" and ".xdd" may hold no set values, ".dcf" and ".xdc" a node id.

    Raises:
        DescriptionError: nothing in it can be used.
    """
    loaded = load_eds(data)
    sheet = Sheet(loaded, suffix, is_xml=looks_like_xml(data))
    found = [of_warning(warning) for warning in loaded.warnings]
    found += [*general_faults(sheet), *object_faults(sheet), *pdo_faults(sheet)]
    return tuple(sorted(_each_once(found), key=_rank))


def _each_once(faults: Iterable[Fault]) -> list[Fault]:
    return list(dict.fromkeys(faults))


def _rank(fault: Fault) -> tuple[int, int]:
    return SEVERITIES.index(fault.severity), fault.line or 0
