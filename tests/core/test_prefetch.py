"""Work shared by threads: items computed one ahead, and functions that run once."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest

from tests.support.waiting import wait_until
from vrcaps.core.errors import StorageError
from vrcaps.core.processes import once, prefetch


def test_prefetching_computes_one_item_ahead_in_another_thread() -> None:
    computed: list[tuple[int, int]] = []

    def items() -> Iterator[int]:
        for k in range(4):
            computed.append((k, threading.get_ident()))
            yield k

    prefetched = prefetch(items())
    assert computed == []
    for k in range(3):
        assert next(prefetched) == k
        wait_until(lambda: len(computed) >= k + 2)  # noqa: B023
    assert list(prefetched) == [3]
    assert threading.get_ident() not in [thread for _, thread in computed]


def test_a_prefetched_error_is_raised_after_the_items_before_it() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise ValueError("no item 2")

    prefetched = prefetch(items())
    assert next(prefetched) == 1
    with pytest.raises(ValueError, match="no item 2"):
        next(prefetched)


def test_closing_a_prefetched_iterator_computes_no_more() -> None:
    computed: list[int] = []

    def items() -> Iterator[int]:
        for k in range(100):
            computed.append(k)
            yield k

    with closing(prefetch(items())) as prefetched:
        assert next(prefetched) == 0
    assert computed == [0, 1]


def test_once_calls_its_function_one_time_from_several_threads() -> None:
    calls: list[None] = []

    def slow() -> int:
        calls.append(None)
        time.sleep(0.05)
        return len(calls)

    result = once(slow)
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(lambda _: result(), range(8)))
    assert found == [1] * 8


def test_once_calls_a_function_that_failed_again() -> None:
    answers = iter([StorageError("full"), 7])

    def sometimes() -> int:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    result = once(sometimes)
    with pytest.raises(StorageError, match="full"):
        result()
    assert (result(), result()) == (7, 7)
