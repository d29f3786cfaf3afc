"""`dataclass` of the standard library, whose methods are made when they are first called.

An analysis imports over three hundred dataclasses. To compile six methods of each takes a third of
its start, and most are never called.
"""

from typing import TYPE_CHECKING

__all__ = ["dataclass"]

if TYPE_CHECKING:
    from dataclasses import dataclass
else:
    import dataclasses
    import inspect

    _OWN = ("__init__", "__repr__", "__eq__", "__hash__", "__setattr__", "__delattr__")

    def dataclass(cls=None, /, *, frozen=False, slots=False, eq=True, repr=True, kw_only=False):
        """As that of the standard library, with those of its options that are used here."""
        options = {"frozen": frozen, "slots": slots, "repr": repr, "eq": eq}

        def made(cls):
            # What is not plain is left to the standard library.
            plain = cls.__bases__ == (object,) and not any(name in vars(cls) for name in _OWN)
            if not plain or any("InitVar" in str(kind) for kind in _annotations(cls).values()):
                return dataclasses.dataclass(cls, kw_only=kw_only, **options)
            if cls.__doc__ is None:
                cls.__doc__ = cls.__name__
            own_state = any(name in vars(cls) for name in ("__getstate__", "__setstate__"))
            cls = dataclasses.dataclass(
                cls, init=False, repr=False, eq=False, slots=slots, kw_only=kw_only
            )
            return _with_methods(cls, options, own_state)

        return made if cls is None else made(cls)

    def _annotations(cls):
        return inspect.get_annotations(cls)

    def _with_methods(cls, options, own_state):
        """The class with methods that make themselves."""
        names = ["__init__"]
        names += ["__repr__"] * options["repr"] + ["__eq__"] * options["eq"]
        names += ["__hash__"] * (options["eq"] and options["frozen"])
        for name in names:
            setattr(cls, name, _maker(cls, name, options))
        if options["eq"] and not options["frozen"]:
            cls.__hash__ = None
        if options["frozen"]:
            _freeze(cls)
            if options["slots"] and not own_state:
                cls.__getstate__, cls.__setstate__ = _getstate, _setstate
        for name, value in options.items():
            if name != "slots":
                setattr(cls.__dataclass_params__, name, value)
        cls.__dataclass_params__.init = True
        return cls

    def _maker(cls, name, options):
        """A method that puts the one of the standard library in its place, and calls it."""

        def method(self, /, *args, **values):
            twin = _twin(cls, name, options)
            function = getattr(twin, name)
            # Somebody may have put another one there that calls this one.
            if vars(cls).get(name) is method:
                setattr(cls, name, function)
            return function(self, *args, **values)

        method.__name__, method.__qualname__ = name, f"{cls.__qualname__}.{name}"
        return method

    def _twin(cls, name, options):
        """A dataclass of the same fields that has one of the methods."""
        fields = dataclasses.fields(cls)
        body = {field.name: field for field in fields}
        body["__annotations__"] = {field.name: field.type for field in fields}
        body |= {"__module__": cls.__module__, "__qualname__": cls.__qualname__}
        if hasattr(cls, "__post_init__"):
            body["__post_init__"] = cls.__post_init__
        frozen = options["frozen"] and name in ("__init__", "__hash__")
        return dataclasses.dataclass(
            type(cls.__name__, (), body),
            init=name == "__init__",
            repr=name == "__repr__",
            eq=name in ("__eq__", "__hash__"),
            frozen=frozen,
            slots=options["slots"] and name == "__init__",
        )

    def _freeze(cls):
        names = frozenset(field.name for field in dataclasses.fields(cls))

        def __setattr__(self, name, value):
            if type(self) is cls or name in names:
                raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
            super(cls, self).__setattr__(name, value)

        def __delattr__(self, name):
            if type(self) is cls or name in names:
                raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
            super(cls, self).__delattr__(name)

        cls.__setattr__, cls.__delattr__ = __setattr__, __delattr__

    def _getstate(self):
        return [getattr(self, field.name) for field in dataclasses.fields(self)]

    def _setstate(self, state):
        for field, value in zip(dataclasses.fields(self), state, strict=True):
            object.__setattr__(self, field.name, value)
