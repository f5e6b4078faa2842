"""Actionable errors: each states the given value, the allowed values and a remedy; checks."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, DTypeLike, NDArray


_SYSTEM = re.compile(r"\[(?:Errno|WinError) -?\d+\] ([^:'\[\]]+)(?:: '[^']*'(?: -> '[^']*')?)?")
"""Pattern of an operating system error: number, reason, paths."""
_UNSEEN = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")
"""Characters that a terminal obeys, ends of lines, and changes of the direction of writing."""


def reason_of(error: BaseException | str) -> str:
    """Reason of an error, without the numbers and paths that Python adds to system errors.

    Example:
        >>> reason_of(FileNotFoundError(2, "No such file or directory", "a.txt"))
        'No such file or directory'
    """
    return _SYSTEM.sub(r"\1", str(error))


class VrcapsError(Exception):
    """Base of all errors that vrcaps raises; the text is one line.

    Of an operating system error it contains the reason only, see `reason_of`. Control characters,
    which names of others may hold, are escaped.
    """

    def __init__(self, *args: object) -> None:
        super().__init__(
            *(_escaped(reason_of(one)) if isinstance(one, str) else one for one in args)
        )


def _escaped(text: str) -> str:
    return _UNSEEN.sub(lambda match: repr(match[0])[1:-1], text)


class InputError(VrcapsError, ValueError):
    """A value, file or combination that vrcaps cannot use."""


class StorageError(InputError):
    """A location that cannot be written or reached: full disk, no permission, lost network."""


@contextmanager
def reading(what: object) -> Iterator[None]:
    """Convert any error that a library raises for damaged data to one InputError.

    Libraries raise more types than a reader can list: Pillow SyntaxError, NumPy TokenError, PyAV
    UnicodeDecodeError, JSON RecursionError. Errors of vrcaps are not changed.

    Args:
        what: The file or folder that is read, for the message.

    Raises:
        InputError: If the block raises any other Exception.
    """
    try:
        yield
    except VrcapsError:
        raise
    except Exception as error:
        raise InputError(f"Cannot read {what}: {_reason(error)}.") from error


def _reason(error: Exception) -> str:
    """One-line reason of a library's error."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, KeyError):
        return f"{error} is missing"
    if isinstance(error, MemoryError):
        return "it does not fit into memory"
    if type(error).__name__ == "UnidentifiedImageError":  # Pillow's text is an address of memory
        return "it is not an image of a known type, or its header is damaged"
    text = " ".join(str(error).split()).rstrip(".")
    return text[:200] if text else type(error).__name__


def nearest(name: str, known: Iterable[str]) -> str:
    """Suggestion of the most similar name as a question, after a space; empty if there is none."""
    import difflib

    matches = difflib.get_close_matches(name, list(known), 1)
    return f" Did you mean {matches[0]!r}?" if matches and matches[0] != name else ""


class UnknownNameError(VrcapsError, LookupError):
    """A name that is in no registry."""

    def __init__(self, noun: str, name: str, known: Iterable[str]) -> None:
        known = sorted(known)
        super().__init__(
            f"No {noun} named {name!r}. Known: {', '.join(known)}.{nearest(str(name), known)}"
        )


class MissingExtraError(VrcapsError, ImportError):
    """A feature whose optional dependency is not installed."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(
            f"{package} is not installed. Install it with: pip install 'vrcaps[{extra}]'"
        )


def import_extra(module: str, extra: str, *, package: str = "") -> Any:
    """Import a module of an optional dependency.

    Args:
        module: Name of the module.
        extra: Extra of vrcaps that installs it.
        package: Name of its package for pip, if different.

    Raises:
        MissingExtraError: If it is not installed.
    """
    from importlib import import_module

    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError(package or module, extra) from error


def require_extra(extra: str, *packages: str) -> None:
    """Check that packages of an extra are installed, before work that ends with their use.

    Args:
        extra: Extra of vrcaps that installs them.
        packages: Names of their modules.

    Raises:
        MissingExtraError: If one is not installed.
    """
    from importlib.util import find_spec

    for package in packages:
        if find_spec(package) is None:
            raise MissingExtraError(package, extra)


def require(is_valid: bool, name: str, value: object, allowed: str) -> None:
    """Check one value.

    Raises:
        InputError: If it is not valid; states the value and the allowed ones.
    """
    if not is_valid:
        raise InputError(f"{name} is {value}. Allowed: {allowed}.")


def narrow(values: ArrayLike, dtype: DTypeLike, name: str) -> np.ndarray[Any, Any]:
    """Convert an array to an integer type without changing any value.

    NumPy's `astype` silently wraps values that are out of range and truncates fractions.

    Args:
        values: Numbers of any type.
        dtype: Integer type.
        name: Subject of the message, in the plural, for example ``labels of colon.ply``.

    Raises:
        InputError: If a number is not finite, not whole, or out of the range of the type.
    """
    import numpy as np

    array, wanted = np.asarray(values), np.iinfo(dtype)
    if array.dtype == np.dtype(dtype):
        return array
    if array.dtype.kind not in "biuf":
        raise InputError(f"The {name} are of type {array.dtype}. Give whole numbers.")
    if array.size == 0:
        return array.astype(dtype)
    low, high = array.min(), array.max()  # NaN, if there is one
    if array.dtype.kind == "f":
        # Not `wanted.max` itself: for 64 bits its float is just beyond the range.
        bad = ~((array >= float(wanted.min)) & (array < float(wanted.max) + 1.0))
        bad |= array != np.floor(array)
    else:
        is_inside = int(low) >= wanted.min and int(high) <= wanted.max
        bad = np.zeros(0, bool) if is_inside else (array < wanted.min) | (array > wanted.max)
    if bad.any():
        first = array[bad].flat[0]
        raise InputError(
            f"{np.count_nonzero(bad)} of the {name} are not allowed, the first is {first!s}. "
            f"Allowed: whole numbers from {wanted.min} to {wanted.max}."
        )
    return array.astype(dtype)


def require_one_shape(estimate: NDArray, truth: NDArray) -> None:
    """Check that an estimate has the shape of the truth.

    Raises:
        InputError: If the shapes differ.
    """
    import numpy as np

    if np.shape(estimate) != np.shape(truth):
        raise InputError(
            f"The estimate has the shape {np.shape(estimate)}, the truth {np.shape(truth)}. "
            "Allowed: equal shapes."
        )
