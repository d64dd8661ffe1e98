"""Mappings in frozen objects, as copies that refuse every change."""

from __future__ import annotations

from dataclasses import fields
from types import MappingProxyType
from typing import Any, NoReturn, TypeVar

__all__ = ["FrozenDict", "FrozenMappings"]

#: Type of a mapping's keys.
Key = TypeVar("Key")
#: Type of a mapping's values.
Value = TypeVar("Value")


class FrozenDict(dict[Key, Value]):
    """Dictionary that cannot be changed; it can be pickled, and written as JSON.

    Every method that would change it raises TypeError.
    """

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        """Raise TypeError."""
        raise TypeError("a mapping in a frozen object cannot be changed: make another object with a changed copy")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[type, tuple[dict[Key, Value]]]:
        return type(self), (dict(self),)


class FrozenMappings:
    """Base of frozen dataclasses with mappings among their fields.

    Dictionaries passed in are copied, nested ones included, and the copies are frozen. A field with ``init=False`` is
    left as it is: a cache of the object, which `dataclasses.replace` does not pass on.
    """

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if field.init and isinstance(value, dict | MappingProxyType | tuple):
                object.__setattr__(self, field.name, _frozen(value))


def _frozen(value: Any) -> Any:
    """Frozen copy of a value: of mappings, also in lists and tuples; others are returned."""
    if isinstance(value, FrozenDict):
        return value
    if isinstance(value, dict | MappingProxyType):
        return FrozenDict({key: _frozen(part) for key, part in value.items()})
    if type(value) is list:
        return [_frozen(part) for part in value]
    if type(value) is tuple and any(isinstance(part, dict | MappingProxyType | tuple) for part in value):
        return tuple(_frozen(part) for part in value)
    return value
