"""A forked process is told that it has no threads; one forked before the first world works."""

import multiprocessing
import sys

import pytest

from small_envs import small_env
from vrcaps.env import forked
from vrcaps.errors import InputError
from waiting import WATCHDOG


def _begin(answer: multiprocessing.Queue) -> None:
    try:
        small_env(num_points=64)
    except InputError as error:
        answer.put(str(error))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not fork")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_fork_of_a_process_with_worlds_is_one_clear_line() -> None:
    small_env(num_points=64)
    context = multiprocessing.get_context("fork")
    answer = context.Queue()
    process = context.Process(target=_begin, args=(answer,))
    process.start()
    said = answer.get(timeout=WATCHDOG)
    process.join()
    assert "context='spawn'" in said


def test_a_fork_before_the_first_world_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forked, "_state", {"used": False, "forked": False})
    forked._after_fork()
    forked.require_threads()
    forked._after_fork()
    with pytest.raises(InputError, match="forked"):
        forked.require_threads()
