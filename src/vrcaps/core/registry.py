"""Registries: the classes of a family by name, including those of plug-ins.

A plug-in is an installed distribution with an entry point in the group ``vrcaps.plugins``. The
entry point names a module, whose import registers classes:

    [project.entry-points."vrcaps.plugins"]
    mine = "my_package.vrcaps_plugin"
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Generic, TypeVar

from vrcaps.core.errors import InputError, UnknownNameError, reason_of

GROUP = "vrcaps.plugins"
"""Group of the entry points of plug-ins."""

Member = TypeVar("Member")


class Registry(Mapping[str, type[Member]], Generic[Member]):
    """Classes of one family by name.

    An unknown name and the list of all names load the plug-ins. Classes of the package are given
    by import path, so that a list of names and summaries imports none of them.

    Example:
        >>> TASKS: Registry[Task] = Registry(
        ...     "task", {"depth": ("vrcaps.learn.tasks.depth:DepthTask", "depth from one image")}
        ... )
        >>> @TASKS.register
        ... class NormalsTask:
        ...     kind = "normals"

    Args:
        noun: Noun of a member, for messages.
        built_in: Import path ``module:Class`` and summary of each of the package's own classes.
    """

    def __init__(self, noun: str, built_in: Mapping[str, tuple[str, str]]) -> None:
        self.noun = noun
        self._built_in = dict(built_in)
        self._added: dict[str, type[Member]] = {}

    def register(self, cls: type[Member]) -> type[Member]:
        """Add a class under its class variable `kind`; also a decorator.

        Raises:
            InputError: If it has no valid name, or the name belongs to another class.
        """
        kind = getattr(cls, "kind", None)
        if not isinstance(kind, str) or not kind.replace("-", "_").isidentifier():
            raise InputError(
                f"kind of {cls.__name__} is {kind!r}. Allowed: letters, digits and hyphens, "
                "such as 'my-kind'."
            )
        if kind in self._built_in:
            owner = self._built_in[kind][0]
        else:
            owner = _path(self._added.setdefault(kind, cls))
        if owner != _path(cls):
            raise InputError(f"The {self.noun} {kind!r} exists already. Choose another kind.")
        if kind in self._added:
            self._added[kind] = cls
        return cls

    @property
    def built_in(self) -> tuple[str, ...]:
        """Names of the package's own classes; no plug-in is loaded."""
        return tuple(self._built_in)

    def summary(self, name: str) -> str:
        """One-line summary of a member: for a plug-in, the first line of its docstring.

        Raises:
            UnknownNameError: If there is no such member.
        """
        if name in self._built_in:
            return self._built_in[name][1]
        return (self[name].__doc__ or "").partition("\n")[0]

    def __getitem__(self, name: str) -> type[Member]:
        """Return the class with a name.

        Raises:
            UnknownNameError: If there is none.
        """
        if name in self._built_in:
            module, _, noun = self._built_in[name][0].partition(":")
            return getattr(import_module(module), noun)
        if name not in self._added:
            load_plugins()
        if name not in self._added:
            raise UnknownNameError(self.noun, name, self)
        return self._added[name]

    def __contains__(self, name: object) -> bool:
        if name not in self._built_in and name not in self._added:
            load_plugins()
        return name in self._built_in or name in self._added

    def __iter__(self) -> Iterator[str]:
        load_plugins()
        return iter((*self._built_in, *self._added))

    def __len__(self) -> int:
        load_plugins()
        return len(self._built_in) + len(self._added)


def _path(cls: type) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


@cache
def load_plugins() -> None:
    """Import the modules of all installed plug-ins, once per process.

    A plug-in that cannot be imported is reported by a warning and left out.
    """
    for point in entry_points(group=GROUP):
        try:
            point.load()
        except Exception as error:  # code of others
            owner = "" if point.dist is None else f" of {point.dist.name} {point.dist.version}"
            warnings.warn(
                f"The plug-in {point.name!r}{owner} was not loaded: {reason_of(error)}",
                stacklevel=2,
            )
