"""Device and threads of PyTorch."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError, import_extra


@dataclass(frozen=True)
class ComputeSettings:
    """Compute settings: device and number of threads.

    Attributes:
        device: `cpu`, `cuda`, `mps`, or `auto` for the fastest available.
        threads: PyTorch threads on a CPU; more than one is slower on a machine with other load.
    """

    device: str = "auto"
    threads: Annotated[int, Range(1)] = 1

    def __post_init__(self) -> None:
        check_fields(self)


def available_device(device: str) -> str:
    """Resolve `auto` to a device, and check that a named one is available.

    Raises:
        InputError: If it is not available.
        MissingExtraError: If PyTorch is not installed.
    """
    torch = import_extra("torch", "learn")
    available = ["cpu"]
    if torch.cuda.is_available():
        available.insert(0, "cuda")
    if torch.backends.mps.is_available():
        available.insert(0, "mps")
    if device == "auto":
        return available[0]
    if device.split(":", maxsplit=1)[0] not in available:
        raise InputError(f"device is {device!r}. Available: {', '.join(sorted(available))}, auto.")
    return device


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
