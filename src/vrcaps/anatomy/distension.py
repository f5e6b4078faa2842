"""Distension: filling of a patient's organs with gas or liquid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeVar

from vrcaps.core.errors import InputError

Distension = Literal["inflated", "normal", "collapsed"]

T = TypeVar("T")


def at_distension(values: Mapping[str, T], distension: str) -> T:
    """Return the value for a distension.

    Raises:
        InputError: If there is no such distension.
    """
    if distension not in values:
        raise InputError(f"Distension is {distension!r}. Allowed: {', '.join(values)}.")
    return values[distension]
