"""Lazily computed attributes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

Value = TypeVar("Value")


class lazy(Generic[Value]):
    """Property that is computed once, like `functools.cached_property`, but without its lock.

    Before Python 3.12 that holds one lock for all objects of a class, so the tables of many
    episodes would be read one after the other. Concurrent threads may compute a value twice.
    """

    def __init__(self, method: Callable[[Any], Value]) -> None:
        self._method = method
        self.__doc__ = method.__doc__

    @overload
    def __get__(self, instance: None, owner: type) -> lazy[Value]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...
    def __get__(self, instance: object | None, owner: type) -> lazy[Value] | Value:
        if instance is None:
            return self
        value = self._method(instance)
        instance.__dict__[self._method.__name__] = value  # later accesses read it from here
        return value
