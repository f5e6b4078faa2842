"""Settings of trainings: device and threads of PyTorch, and changes by dotted path."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Annotated, Any, TypeVar, cast, get_args, get_type_hints

from vrcaps.config.convert import classes_by_kind, from_plain
from vrcaps.config.fields import Range, check_fields
from vrcaps.core.errors import InputError, UnknownNameError, import_extra


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


Settings = TypeVar("Settings")


def preset_named(
    presets: Mapping[str, Callable[..., Settings]], name: str
) -> Callable[..., Settings]:
    """Return a preset by name.

    Raises:
        UnknownNameError: If there is none.
    """
    if name not in presets:
        raise UnknownNameError("preset", name, presets)
    return presets[name]


def changed_settings(settings: Settings, changes: Iterable[tuple[str, Any]]) -> Settings:
    """Return settings with changed values.

    Example:
        >>> changed_settings(default(), [("env.actuation", "magnet"), ("learner.epochs", 4)])

    Args:
        settings: A dataclass.
        changes: Dotted path of field names, and plain value, of each change; a part or a list of
            parts may be given by kind.

    Raises:
        UnknownNameError: If there is no such field.
        InputError: If a value is not allowed.
    """
    for path, value in changes:
        settings = _changed(settings, path, value)
    return settings


def _changed(settings: Any, path: str, value: Any) -> Any:
    name, _, rest = path.partition(".")
    known = [f.name for f in fields(settings)] if is_dataclass(settings) else []
    if name not in known:
        raise UnknownNameError("setting", name, known)
    if rest:
        new = _changed(getattr(settings, name), rest, value)
    else:
        new = _from_plain(get_type_hints(type(settings))[name], value, name)
    return replace(cast(Any, settings), **{name: new})


def _from_plain(declared: Any, value: Any, at: str) -> Any:
    """Convert a plain value to a type; parts may be given by kind."""
    kinds = classes_by_kind(declared)
    if (
        isinstance(value, str)
        and kinds
        and "" not in kinds
        and str not in (get_args(declared) or (declared,))
    ):
        if value not in kinds:
            raise UnknownNameError(at, value, kinds)
        return kinds[value]()
    if isinstance(value, list) and get_args(declared):
        return tuple(_from_plain(get_args(declared)[0], item, at) for item in value)
    return from_plain(declared, value, at=at)
