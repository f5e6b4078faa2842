"""Forked processes: they have none of the threads of the core and would wait for them for ever."""

from __future__ import annotations

import os

from vrcaps.errors import InputError

_state = {"used": False, "forked": False}


def require_threads() -> None:
    """Note that the core works in this process.

    Raises:
        InputError: If this process was forked from one in which it had worked before.
    """
    if _state["forked"]:
        raise InputError(
            "This process was forked from one whose environments had begun, so the core has no "
            "threads in it. Start it anew: AsyncVectorEnv(…, context='spawn'), "
            "multiprocessing.get_context('spawn'); or begin no environment before the fork."
        )
    _state["used"] = True


def _after_fork() -> None:
    _state["forked"] = _state["used"]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
