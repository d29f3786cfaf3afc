"""Columnar decoders: frame columns in, value columns out; bytes from a bus never raise."""

from syncline_schemas.decoder.pdo import (
    MappedObject as MappedObject,
)
from syncline_schemas.decoder.pdo import (
    PdoColumn as PdoColumn,
)
from syncline_schemas.decoder.pdo import (
    PdoMapping as PdoMapping,
)
from syncline_schemas.decoder.pdo import (
    decode_pdo as decode_pdo,
)
from syncline_schemas.decoder.sdo import (
    SdoColumns as SdoColumns,
)
from syncline_schemas.decoder.sdo import (
    SdoKind as SdoKind,
)
from syncline_schemas.decoder.sdo import (
    decode_sdo as decode_sdo,
)
from syncline_schemas.decoder.services import (
    EmcyColumns as EmcyColumns,
)
from syncline_schemas.decoder.services import (
    ErrorControlColumns as ErrorControlColumns,
)
from syncline_schemas.decoder.services import (
    LssColumns as LssColumns,
)
from syncline_schemas.decoder.services import (
    NmtColumns as NmtColumns,
)
from syncline_schemas.decoder.services import (
    TimeColumns as TimeColumns,
)
from syncline_schemas.decoder.services import (
    decode_emcy as decode_emcy,
)
from syncline_schemas.decoder.services import (
    decode_error_control as decode_error_control,
)
from syncline_schemas.decoder.services import (
    decode_lss as decode_lss,
)
from syncline_schemas.decoder.services import (
    decode_nmt as decode_nmt,
)
from syncline_schemas.decoder.services import (
    decode_sync as decode_sync,
)
from syncline_schemas.decoder.services import (
    decode_time as decode_time,
)
