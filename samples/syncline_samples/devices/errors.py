"""Errors that the devices can report by EMCY, with the bits that go with them (the sheets)."""

from syncline_samples.emcy import ActiveError

_LIR = {
    0x1000: ActiveError(0x01, alarms=0x0002),
    0x5530: ActiveError(0x80),
    0x6010: ActiveError(0x01, warnings=0x0004),
    0x7320: ActiveError(0x01, alarms=0x0001),
    0x7510: ActiveError(0x10),
}
_JN2100 = {
    0x1000: ActiveError(0x01),
    0x3100: ActiveError(0x05),
    0x3200: ActiveError(0x05),
    0x4100: ActiveError(0x09),
    0x4200: ActiveError(0x09),
    0x8110: ActiveError(0x11),
    0x8120: ActiveError(0x11),
    0x8140: ActiveError(0x11),
    0x9000: ActiveError(0x01),
    0xF000: ActiveError(0x01),
}
_PLAIN = {
    0x1000: ActiveError(0x01),
    0x2310: ActiveError(0x03),
    0x3120: ActiveError(0x05),
    0x4210: ActiveError(0x09),
    0x5000: ActiveError(0x81),
    0x8110: ActiveError(0x11),
}
"""CiA 301 names alone: a Haomiao, which prints no list, and the I/O module."""

ERRORS = {
    "lir-da158": _LIR,
    "lir-da158a": _LIR,
    "lir-ma158k": _LIR,
    "lir-918": _LIR,
    "jn2100": _JN2100,
    "haomiao-38": _PLAIN,
    "io": _PLAIN,
}
"""By device and EMCY code; 8130h comes from the guarding itself."""
