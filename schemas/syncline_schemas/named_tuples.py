"""`NamedTuple` of the standard library, made in a quarter of its time.

An analysis imports a hundred of them, and the library compiles a `__new__` for each.
"""

from typing import TYPE_CHECKING

__all__ = ["NamedTuple"]

if TYPE_CHECKING:
    from typing import NamedTuple
else:
    import sys
    import types
    import typing
    from collections import namedtuple
    from functools import cache
    from keyword import iskeyword

    _RESERVED = {"__new__", "__init__", "__slots__", "__getnewargs__", "_fields", "_field_defaults"}
    _RESERVED |= {"_make", "_replace", "_asdict", "_source"}
    _UNEXPECTED = TypeError if sys.version_info >= (3, 13) else ValueError

    class _Maker(type):
        """Makes of a class statement a tuple with names."""

        def __new__(cls, name, bases, own):
            kinds = own.get("__annotations__", {})
            if len(bases) > 1 or not _is_plain(kinds, own):
                return _of_library(name, own)
            rest = {each: value for each, value in own.items() if each not in kinds}
            return type(name, (tuple,), _COMMON | _parts(name, kinds, own) | rest)

    _BASE = type.__new__(_Maker, "NamedTuple", (), {})

    def NamedTuple():
        """Makes a class below it a tuple with names, as that of the standard library does."""

    NamedTuple.__mro_entries__ = lambda bases: (_BASE,)

    def _is_plain(kinds, own):
        """Whether there is nothing special about a class, nor a mistake in it."""
        given = [name in own for name in kinds]
        return (
            bool(kinds)
            and given == sorted(given)
            and own.keys().isdisjoint(_RESERVED)
            and not any(name[0] == "_" or iskeyword(name) for name in kinds)
        )

    def _of_library(name, own):
        def body(space):
            space.update(own)

        written = own["__orig_bases__"]
        bases = [typing.NamedTuple if base is NamedTuple else base for base in written]
        return types.new_class(name, bases, {}, body)

    def _parts(name, kinds, own):
        """What a named tuple of these fields has, by name."""
        fields = tuple(kinds)
        pattern = _pattern(len(fields))
        made = pattern.__new__
        code = made.__code__.replace(co_varnames=("_cls", *fields))
        defaults = {each: own[each] for each in fields if each in own}
        new = types.FunctionType(code, made.__globals__, "__new__", tuple(defaults.values()))
        new.__annotations__, new.__qualname__ = kinds, f"{name}.__new__"
        told = {"_fields": fields, "_field_defaults": defaults, "__match_args__": fields}
        getters = {each: vars(pattern)[f"_{at}"] for at, each in enumerate(fields)}
        return told | getters | {"__new__": new, "__doc__": f"{name}({', '.join(fields)})"}

    @cache
    def _pattern(count):
        """A named tuple of as many fields, whose code needs only other names."""
        return namedtuple("Pattern", [""] * count, rename=True)

    @classmethod
    def _make(cls, iterable):
        row = tuple.__new__(cls, iterable)
        if len(row) != len(cls._fields):
            raise TypeError(f"Expected {len(cls._fields)} arguments, got {len(row)}")
        return row

    def _replace(self, /, **changes):
        row = self._make(map(changes.pop, self._fields, self))
        if changes:
            raise _UNEXPECTED(f"Got unexpected field names: {list(changes)!r}")
        return row

    def _repr(self):
        shown = ", ".join(
            f"{name}={value!r}" for name, value in zip(self._fields, self, strict=True)
        )
        return f"{type(self).__name__}({shown})"

    def _asdict(self):
        return dict(zip(self._fields, self, strict=True))

    def _getnewargs(self):
        return tuple(self)

    _COMMON = {
        "__slots__": (),
        "_make": _make,
        "_replace": _replace,
        "__replace__": _replace,
        "__repr__": _repr,
        "_asdict": _asdict,
        "__getnewargs__": _getnewargs,
    }
