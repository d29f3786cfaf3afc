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
            function = _init(cls, options) if name == "__init__" else _of_twin(cls, name, options)
            # Somebody may have put another one there that calls this one.
            if vars(cls).get(name) is method:
                setattr(cls, name, function)
            return function(self, *args, **values)

        method.__name__, method.__qualname__ = name, f"{cls.__qualname__}.{name}"
        return method

    def _init(cls, options):
        """The `__init__` of the standard library, made in a quarter of its time."""
        listed = dataclasses.fields(cls)
        this = "__self__" if any(field.name == "self" for field in listed) else "self"
        assign = (
            f"__set__({this}, {{0!r}}, {{1}})" if options["frozen"] else f"{this}.{{0}} = {{1}}"
        )
        names = {"__set__": object.__setattr__, "__unset__": object()}
        parameters, keywords, body = [this], ["*"], []
        for field in listed:
            names[f"__default_{field.name}"] = field.default
            names[f"__make_{field.name}"] = field.default_factory
            if field.init:
                (keywords if field.kw_only else parameters).append(field.name + _default(field))
            if value := _value(field, options["slots"]):
                body.append(assign.format(field.name, value))
        if hasattr(cls, "__post_init__"):
            body.append(f"{this}.__post_init__()")
        if len(keywords) > 1:
            parameters += keywords
        exec(f"def __init__({', '.join(parameters)}):\n " + "\n ".join(body or ["pass"]), names)
        function = names["__init__"]
        function.__module__, function.__qualname__ = cls.__module__, f"{cls.__qualname__}.__init__"
        told = {field.name: field.type for field in listed if field.init}
        function.__annotations__ = told | {"return": None}
        return function

    def _default(field):
        """What follows the name of the parameter."""
        if field.default is not dataclasses.MISSING:
            return f"=__default_{field.name}"
        return "" if field.default_factory is dataclasses.MISSING else "=__unset__"

    def _value(field, slots):
        """What is assigned; empty where there is nothing, or where the class holds it."""
        name = field.name
        if field.default_factory is not dataclasses.MISSING:
            return f"__make_{name}()" + f" if {name} is __unset__ else {name}" * field.init
        if field.init:
            return name
        return f"__default_{name}" if slots and field.default is not dataclasses.MISSING else ""

    def _of_twin(cls, name, options):
        """The method of a dataclass of the same fields that has no other one."""
        fields = dataclasses.fields(cls)
        body = {field.name: field for field in fields}
        body["__annotations__"] = {field.name: field.type for field in fields}
        body |= {each: getattr(cls, each) for each in ("__module__", "__qualname__", "__doc__")}
        twin = dataclasses.dataclass(
            type(cls.__name__, (), body),
            init=False,
            repr=name == "__repr__",
            eq=name in ("__eq__", "__hash__"),
            frozen=options["frozen"] and name == "__hash__",
        )
        return getattr(twin, name)

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
