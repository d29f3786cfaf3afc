"""python-can as `can`, without the library that only its MDF 4 files need.

Where asammdf is installed, python-can imports it with everything behind it: seconds in which the
recorder does not listen yet and Ctrl-C is swallowed. Nothing here reads or writes MDF 4 by it.
"""

from syncline_schemas.hidden_module import hidden

with hidden("asammdf"):
    import can

__all__ = ["can"]
