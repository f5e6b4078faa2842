"""Parts that all trainings share: settings, device, and the folder with progress and checkpoint."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar, cast, get_args, get_type_hints

from vrcaps import __version__
from vrcaps.config.convert import classes_by_kind, from_plain
from vrcaps.config.plain_files import decode_json
from vrcaps.core.build_info import core_sha256, versions
from vrcaps.core.errors import InputError, UnknownNameError, import_extra, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import is_new_folder, write_json
from vrcaps.core.processes import MAX_WORKERS


@dataclass(frozen=True)
class ComputeSettings:
    """Compute settings: device and number of threads.

    Attributes:
        device: `cpu`, `cuda`, `mps`, or `auto` for the fastest available.
        threads: PyTorch threads on a CPU; more than one is slower on a machine with other load.
    """

    device: str = "auto"
    threads: Annotated[int, Range(1, MAX_WORKERS)] = 1

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
    require(1 <= threads <= MAX_WORKERS, "threads", threads, f"1 to {MAX_WORKERS}")
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


SETTINGS = "settings.json"


def begin_training(
    out: Path,
    plain: dict[str, Any],
    packages: tuple[str, ...],
    *,
    is_forced: bool = False,
    growing: tuple[str, ...] = (),
    update: Callable[[Any], Any] = lambda plain: plain,
) -> None:
    """Create the folder of a training, or check that it belongs to the same one.

    Args:
        out: Folder: new, empty, or of the same training.
        plain: Settings as plain values.
        packages: Packages that the result's bytes depend on.
        is_forced: Resume even if vrcaps or a package has changed since the start of the training.
        growing: Dotted paths of settings that may have grown; the new values are written.
        update: Replaces former names in the settings of an older version.

    Raises:
        InputError: If the folder contains other files, or a training with other settings or
            versions.
    """
    path = out / SETTINGS
    made_with = {"vrcaps": __version__, "core": core_sha256(), **versions(packages)}
    if not path.is_file():
        if not is_new_folder(out):
            raise InputError(f"{out} contains no training. Give a new or empty folder.")
        out.mkdir(parents=True, exist_ok=True)
        write_json(path, {"made_with": made_with, "settings": plain})
        return
    try:
        stored = decode_json(path.read_bytes(), path)
        before, versions_before = update(stored["settings"]), stored["made_with"]
    except (InputError, LookupError, TypeError) as error:
        raise InputError(f"{path} is damaged. Give a new folder.") from error
    grown = _with_grown(before, plain, growing)
    changed = _differences(grown, plain)
    if changed:
        raise InputError(
            f"{out} contains a training with other settings: {', '.join(changed[:5])}. Give a new "
            "folder, or its original settings."
        )
    newer = _differences(versions_before, made_with)
    if newer and not is_forced:
        raise InputError(
            f"{out} contains a training of other versions: {', '.join(newer)}. Its result would "
            "not be the same. Give a new folder, or --force to resume."
        )
    if grown != before:
        write_json(path, {**stored, "settings": plain})


def _with_grown(before: Any, now: Any, growing: tuple[str, ...]) -> Any:
    """Copy of a plain tree with the numbers at some paths raised to those of another tree."""
    raised = copy.deepcopy(before)
    for path in growing:
        *groups, name = path.split(".")
        own, new = raised, now
        for group in groups:
            own, new = (tree.get(group) if isinstance(tree, dict) else None for tree in (own, new))
        if isinstance(own, dict) and isinstance(new, dict):
            old, value = own.get(name), new.get(name)
            if isinstance(old, int | float) and isinstance(value, int | float) and value > old:
                own[name] = value
    return raised


def _differences(before: Any, now: Any, at: str = "") -> list[str]:
    """Paths at which two plain trees differ, with both values."""
    if isinstance(before, dict) and isinstance(now, dict):
        keys = sorted({*before, *now})
        return [
            line
            for key in keys
            for line in _differences(before.get(key), now.get(key), f"{at}.{key}".strip("."))
        ]
    if before is None and now == []:  # a list that an older version lacked
        return []
    return [] if before == now else [f"{at} was {_short(before)}, now {_short(now)}"]


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 24 else f"{text[:12]}…"


PROGRESS = "progress.csv"
"""File of the rows of the progress, written before each checkpoint, which completes the state."""


@dataclass(frozen=True)
class Progress:
    """Progress of a training.

    Attributes:
        step: Number of completed steps: batches of a network, rounds of a policy.
        total: Total number of steps.
        rows: A row of statistics for each evaluation of a network, each round of a policy.
        best: Best value of the metric that selects the best weights; None before the first.
    """

    step: int
    total: int
    rows: tuple[dict[str, float], ...] = ()
    best: float | None = None


class Training(Protocol):
    """A training that can be interrupted between steps."""

    @property
    def progress(self) -> Progress:
        """Progress so far."""
        ...

    def advance(self) -> None:
        """Run one step, and the evaluation and the checkpoint that are due after it."""
        ...


def run_training(training: Training, report: Callable[[Progress], None]) -> Progress:
    """Run all remaining steps of a training.

    Args:
        training: The training.
        report: Called before the first and after each step.
    """
    report(training.progress)
    while training.progress.step < training.progress.total:
        training.advance()
        report(training.progress)
    return training.progress


@contextmanager
def restoring(path: Path) -> Iterator[None]:
    """Convert any error in restoring a checkpoint to one line.

    Errors of PyTorch for damaged files and states have no common base.

    Raises:
        InputError: If the block raises any exception.
    """
    try:
        yield
    except Exception as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path} is damaged ({reason}). Give a new folder.") from error
