"""What is wrong with a device description file: what the reader repaired and what it did not see."""

from collections.abc import Iterable
from pathlib import Path

from syncline_schemas.devices.build import EDS_SUFFIXES
from syncline_schemas.devices.catalog import load_device
from syncline_schemas.devices.check.general import general_faults
from syncline_schemas.devices.check.kinds import SEVERITIES, Severity
from syncline_schemas.devices.check.objects import object_faults
from syncline_schemas.devices.check.pdos import pdo_faults
from syncline_schemas.devices.check.sheet import Fault as Fault
from syncline_schemas.devices.check.sheet import Sheet, of_warning
from syncline_schemas.eds import LoadedEds, load_eds, read_eds, variables
from syncline_schemas.errors import DescriptionError
from syncline_schemas.records import dataclass
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
    """Check an EDS, DCF, XDD, XDC or device TOML file; never raises for what is in the file.

    What has none of their endings is taken for an EDS or XDD by its content.
    """
    path = Path(path)
    try:
        if path.suffix.lower() == ".toml":
            return _check_pair(path)
        data = read_eds(path)
        loaded = load_eds(data)
    except DescriptionError as error:
        problem = str(error).replace("the EDS file", str(path), 1)
        return FileCheck(path, "", 0, (), problem)
    title = loaded.info.get("deviceinfo.productname") or path.stem
    count = sum(1 for _ in variables(loaded.od))
    return FileCheck(path, title, count, _faults(loaded, data, path.suffix), file=path.name)


def _check_pair(path: Path) -> FileCheck:
    device = load_device(path.absolute())
    name = next(each for each in device.files if each.lower().endswith(EDS_SUFFIXES))
    faults = check_eds(device.files[name], Path(name).suffix)
    return FileCheck(path, device.title, len(device.facts), faults, file=Path(name).name)


def check_eds(data: bytes, suffix: str = "") -> tuple[Fault, ...]:
    """Faults of an EDS, DCF, XDD or XDC file, the worst first.

    suffix: of the file's name; ".eds" and ".xdd" may hold no set values, ".dcf" and ".xdc" a node id.

    Raises:
        DescriptionError: nothing in it can be used.
    """
    return _faults(load_eds(data), data, suffix)


def _faults(loaded: LoadedEds, data: bytes, suffix: str) -> tuple[Fault, ...]:
    sheet = Sheet(loaded, suffix, is_xml=looks_like_xml(data))
    found = [of_warning(warning) for warning in loaded.warnings]
    found += [*general_faults(sheet), *object_faults(sheet), *pdo_faults(sheet)]
    return tuple(sorted(_each_once(found), key=_rank))


def _each_once(faults: Iterable[Fault]) -> list[Fault]:
    return list(dict.fromkeys(faults))


def _rank(fault: Fault) -> tuple[int, int]:
    return SEVERITIES.index(fault.severity), fault.line or 0
