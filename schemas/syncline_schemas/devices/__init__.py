"""Device descriptions: an EDS or DCF file plus the facts that it cannot hold.

A device is a pair of data files, `<name>.eds` and `<name>.toml`, in `data/` or in a folder of the
user's (environment variable `SYNCLINE_DEVICES`); no code knows a device by its name.
"""

from syncline_schemas.devices.build import (
    EDS_SUFFIXES as EDS_SUFFIXES,
)
from syncline_schemas.devices.build import (
    device_from_files as device_from_files,
)
from syncline_schemas.devices.catalog import (
    ABSENT as ABSENT,
)
from syncline_schemas.devices.catalog import (
    device_names as device_names,
)
from syncline_schemas.devices.catalog import (
    evidence as evidence,
)
from syncline_schemas.devices.catalog import (
    excluded as excluded,
)
from syncline_schemas.devices.catalog import (
    identify as identify,
)
from syncline_schemas.devices.catalog import (
    identify_among as identify_among,
)
from syncline_schemas.devices.catalog import (
    identity_objects as identity_objects,
)
from syncline_schemas.devices.catalog import (
    is_path as is_path,
)
from syncline_schemas.devices.catalog import (
    load_device as load_device,
)
from syncline_schemas.devices.catalog import (
    lookalikes as lookalikes,
)
from syncline_schemas.devices.catalog import (
    named_objects as named_objects,
)
from syncline_schemas.devices.catalog import (
    suspects as suspects,
)
from syncline_schemas.devices.catalog import (
    telling_objects as telling_objects,
)
from syncline_schemas.devices.lookalike import (
    either as either,
)
from syncline_schemas.devices.model import (
    GENERIC_QUIRKS as GENERIC_QUIRKS,
)
from syncline_schemas.devices.model import (
    BitField as BitField,
)
from syncline_schemas.devices.model import (
    Contradiction as Contradiction,
)
from syncline_schemas.devices.model import (
    Device as Device,
)
from syncline_schemas.devices.model import (
    EmcyField as EmcyField,
)
from syncline_schemas.devices.model import (
    Jump as Jump,
)
from syncline_schemas.devices.model import (
    ObjectFacts as ObjectFacts,
)
from syncline_schemas.devices.model import (
    Override as Override,
)
from syncline_schemas.devices.model import (
    Quirks as Quirks,
)
from syncline_schemas.devices.model import (
    emcy_details as emcy_details,
)
from syncline_schemas.devices.model import (
    emcy_meaning as emcy_meaning,
)
from syncline_schemas.devices.model import (
    quirks as quirks,
)
from syncline_schemas.devices.model import (
    register_bits as register_bits,
)
from syncline_schemas.devices.settings import (
    check_numbers as check_numbers,
)
from syncline_schemas.devices.settings import (
    configured as configured,
)
from syncline_schemas.devices.settings import (
    stated_objects as stated_objects,
)
from syncline_schemas.devices.standard import (
    standard_device as standard_device,
)
from syncline_schemas.devices.standard import (
    standard_facts as standard_facts,
)
from syncline_schemas.devices.standard import (
    standard_jumps as standard_jumps,
)
from syncline_schemas.devices.standard import (
    standard_of as standard_of,
)
