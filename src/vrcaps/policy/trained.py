"""Trained: a policy that was learned, from its file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from vrcaps.errors import InputError

if TYPE_CHECKING:
    from vrcaps.policy.policy import Policy


def read_trained_policy(path: Path) -> Policy:
    """A learned policy.

    Raises:
        InputError: If the file holds none.
    """
    raise InputError(f"{path} holds no policy that this version can read.")
