"""Deterministic PyTorch with a set number of threads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from vrcaps.core.errors import import_extra


@contextmanager
def exact_torch(threads: int = 1) -> Iterator[None]:
    """Set PyTorch's number of threads and deterministic algorithms within the block.

    On a busy machine, a small network trains twenty times slower on two threads than on one.

    Raises:
        MissingExtraError: If PyTorch is not installed.
    """
    torch = import_extra("torch", "learn")
    before, exact = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        torch.use_deterministic_algorithms(exact)
