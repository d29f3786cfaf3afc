"""`dataclass` of the standard library, of which each part is made when it is first looked at.

An analysis imports over three hundred dataclasses. To write down the fields of each and to compile
six methods takes a third of its start, and most are never looked at.
"""

from typing import TYPE_CHECKING

__all__ = ["dataclass"]

if TYPE_CHECKING:
    from dataclasses import dataclass
else:
    import dataclasses
    from dataclasses import MISSING, Field
    from functools import partial
    from types import GenericAlias, UnionType
    from typing import ClassVar

    _OPTIONS = {"frozen": False, "slots": False, "repr": True, "eq": True}
    _OWN = {"__init__", "__eq__", "__hash__", "__setattr__", "__delattr__", "__match_args__"}
    _OWN |= {"__slots__"}
    _CHANGING = (list, dict, set)
    _TOLD = ("__dataclass_fields__", "__dataclass_params__")
    _NEVER_SPECIAL = {type, GenericAlias, UnionType}
    """Kinds of annotations of a field, but for `InitVar` itself."""
    _GIVEN = MISSING, MISSING, True
    _BY_THE_WAY = 64
    """Rows made without a compiled `__init__`: to compile one takes as long as that saves."""

    def dataclass(cls=None, /, **options):
        """As that of the standard library, which also makes the classes that are not plain."""

        def made(cls):
            chosen, record = _OPTIONS | options, _Record(cls)
            if len(chosen) > len(_OPTIONS) or not record.is_plain():
                return dataclasses.dataclass(cls, **options)
            return record.finished(chosen)

        return made if cls is None else made(cls)

    def _is_special(kind):
        """Whether an annotation is none of a field, or of one that is no attribute."""
        if type(kind) is type:
            return kind is dataclasses.InitVar
        if isinstance(kind, str):
            return any(name in kind for name in ("ClassVar", "InitVar", "KW_ONLY"))
        known = ClassVar, dataclasses.KW_ONLY
        return isinstance(kind, dataclasses.InitVar) or getattr(kind, "__origin__", kind) in known

    def _said(value):
        """Default, factory and whether it is an argument, by the value of a field in its class."""
        if type(value) is Field:
            return value.default, value.default_factory, value.init
        return value, MISSING, True

    class _Record:
        """A class whose parts are made late.

        Attributes:
            kinds: annotations of its fields by name.
            values: their values in the class as it was written.
        """

        def __init__(self, cls):
            self.cls, self.kinds, self.options = cls, cls.__annotations__, {}
            own = vars(cls)
            self.values = {name: own[name] for name in self.kinds if name in own}
            said = {name: _said(value) for name, value in self.values.items()}
            self.said = dict.fromkeys(self.kinds, _GIVEN) | said

        def is_plain(self):
            """Whether there is nothing special about the class, nor a mistake in it."""
            own = vars(self.cls)
            fields = {name: value for name, value in own.items() if type(value) is Field}
            return (
                self.cls.__bases__ == (object,)
                and type(self.cls) is type
                and own.keys().isdisjoint(_OWN)
                and not self._has_special_kinds()
                and fields.keys() <= self.kinds.keys()
                and not any(field.kw_only is True for field in fields.values())
                and self._has_plain_defaults()
            )

        def _has_special_kinds(self):
            kinds = self.kinds.values()
            if {*map(type, kinds)} <= _NEVER_SPECIAL:
                return dataclasses.InitVar in kinds
            return any(map(_is_special, kinds))

        def _has_plain_defaults(self):
            said = self.said.values()
            needed = [default is factory for default, factory, init in said if init]
            # None that is needed follows one that is not.
            return needed == sorted(needed, reverse=True) and not any(
                isinstance(default, _CHANGING) for default, _, _ in said
            )

        def finished(self, options):
            """The class, or another one with slots, with its parts."""
            self.options = options
            if self.cls.__doc__ is None:
                self.cls.__doc__ = self.cls.__name__
            self.cls = self._slotted(self.cls) if options["slots"] else self._mended(self.cls)
            return self.cls

        def _slotted(self, cls):
            """The class made again, with slots."""
            own = dict(vars(cls))
            for name in ("__dict__", "__weakref__", *self.values):
                own.pop(name, None)
            own |= self._parts(own)
            own |= {"__slots__": (*self.kinds,), "__qualname__": cls.__qualname__}
            return type(cls.__name__, (), own)

        def _mended(self, cls):
            """The class itself, with its parts."""
            for name, value in self._parts(vars(cls)).items():
                setattr(cls, name, value)
            for name, value in self.values.items():
                default = _said(value)[0]
                if default is MISSING:
                    delattr(cls, name)
                else:
                    setattr(cls, name, default)
            return cls

        def _parts(self, own):
            """What a dataclass of these options has, by name. own: what the class itself has."""
            equal, frozen = self.options["eq"], self.options["frozen"]
            parts = {name: _Late(self, name) for name in _TOLD}
            parts["__init__"] = _LateInit(self, "__init__")
            parts["__match_args__"] = tuple([name for name, said in self.said.items() if said[2]])
            if self.options["repr"] and "__repr__" not in own:
                parts["__repr__"] = _Late(self, "__repr__")
            if equal:
                parts["__eq__"] = _Late(self, "__eq__")
                parts["__hash__"] = _Late(self, "__hash__") if frozen else None
            if frozen:
                parts |= self._refusals()
                if self.options["slots"] and own.keys().isdisjoint(_STATE):
                    parts |= _STATE
            # For `copy.replace` of newer versions of Python.
            return parts | {"__replace__": _replace}

        def _refusals(self):
            def __setattr__(row, name, value):
                if type(row) is self.cls or name in self.kinds:
                    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
                super(self.cls, row).__setattr__(name, value)

            def __delattr__(row, name):
                if type(row) is self.cls or name in self.kinds:
                    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
                super(self.cls, row).__delattr__(name)

            return {"__setattr__": __setattr__, "__delattr__": __delattr__}

        def part(self, name):
            """The part of this name as the standard library has it."""
            if name in _TOLD:
                return getattr(_with_fields(self), name)
            if name == "__init__":
                return _init(self)
            return _of_twin(self.cls, name, self.options)

    class _Late:
        """Stands where a part of a class will be, which is made when it is looked at."""

        __slots__ = ("_name", "_record")

        def __init__(self, record, name):
            self._record, self._name = record, name

        def __get__(self, row, cls=None):
            part = self._record.part(self._name)
            # Somebody may have put another one there that calls this one.
            if vars(self._record.cls).get(self._name) is self:
                setattr(self._record.cls, self._name, part)
            bind = getattr(part, "__get__", None)
            return bind(row, cls) if bind else part

    class _LateInit(_Late):
        """An `__init__` that is not compiled before it was called some number of times."""

        _calls = 0
        _steps = None

        def __get__(self, row, cls=None):
            # `inspect` binds it to the class.
            if self._calls == _BY_THE_WAY or not isinstance(row, self._record.cls):
                return super().__get__(row, cls)
            self._calls += 1
            return partial(self._fill, row)

        def _fill(self, row, /, *args, **values):
            if self._steps is None:
                self._look()
            given = dict(zip(self._places, args, strict=False)) | values
            as_many = len(given) == len(args) + len(values)
            if not as_many or not self._needed <= given.keys() <= self._allowed:
                # It knows what to say.
                return super().__get__(row)(*args, **values)
            assign = object.__setattr__ if self._record.options["frozen"] else setattr
            for name, default, factory in self._steps:
                if name in given:
                    assign(row, name, given[name])
                elif factory is not MISSING:
                    assign(row, name, factory())
                elif default is not MISSING:
                    assign(row, name, default)
            if self._ends:
                row.__post_init__()

        def _look(self):
            """Learn what is to be assigned, in which order."""
            said = self._record.said
            self._places = tuple(name for name, (_, _, init) in said.items() if init)
            self._allowed = frozenset(self._places)
            self._needed = {
                name
                for name, (default, factory, init) in said.items()
                if init and default is factory
            }
            self._ends = hasattr(self._record.cls, "__post_init__")
            # What a class without slots has itself is not assigned.
            own = not self._record.options["slots"]
            self._steps = [
                (name, MISSING if own and not init else default, factory)
                for name, (default, factory, init) in said.items()
            ]

    def _init(record):
        """The `__init__` that the standard library makes, in a quarter of its time."""
        cls, options = record.cls, record.options
        this = "__self__" if "self" in record.kinds else "self"
        assign = (
            f"__set__({this}, {{0!r}}, {{1}})" if options["frozen"] else f"{this}.{{0}} = {{1}}"
        )
        names = {"__set__": object.__setattr__, "__unset__": object()}
        parameters, body = [this], []
        for name, (default, factory, init) in record.said.items():
            names[f"__default_{name}"], names[f"__make_{name}"] = default, factory
            if init:
                parameters.append(name + _default(name, default, factory))
            if value := _value(name, default, factory, init, options["slots"]):
                body.append(assign.format(name, value))
        if hasattr(cls, "__post_init__"):
            body.append(f"{this}.__post_init__()")
        exec(f"def __init__({', '.join(parameters)}):\n " + "\n ".join(body or ["pass"]), names)
        function = names["__init__"]
        function.__module__, function.__qualname__ = cls.__module__, f"{cls.__qualname__}.__init__"
        told = {name: record.kinds[name] for name, said in record.said.items() if said[2]}
        function.__annotations__ = told | {"return": None}
        return function

    def _default(name, default, factory):
        """What follows the name of the parameter."""
        if default is not MISSING:
            return f"=__default_{name}"
        return "" if factory is MISSING else "=__unset__"

    def _value(name, default, factory, init, slots):
        """What is assigned; empty where there is nothing, or where the class holds it."""
        if factory is not MISSING:
            return f"__make_{name}()" + f" if {name} is __unset__ else {name}" * init
        if init:
            return name
        return f"__default_{name}" if slots and default is not MISSING else ""

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

    def _with_fields(record):
        """A class of the same fields and options, as the standard library makes it."""
        cls = record.cls
        body = record.values | {"__annotations__": record.kinds, "__module__": cls.__module__}
        # Without one the library looks for the signature, which takes longer than all else.
        body["__doc__"] = cls.__doc__
        made = dataclasses.dataclass(type(cls.__name__, (), body), init=False, repr=False, eq=False)
        for name, value in record.options.items():
            if hasattr(made.__dataclass_params__, name):
                setattr(made.__dataclass_params__, name, value)
        made.__dataclass_params__.init = True
        return made

    def _replace(self, /, **changes):
        return dataclasses.replace(self, **changes)

    def _getstate(self):
        return [getattr(self, field.name) for field in dataclasses.fields(self)]

    def _setstate(self, state):
        for field, value in zip(dataclasses.fields(self), state, strict=True):
            object.__setattr__(self, field.name, value)

    _STATE = {"__getstate__": _getstate, "__setstate__": _setstate}
