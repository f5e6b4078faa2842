"""Estimate of a data set before making it: frames, time and bytes, from a short measurement."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean

from vrcaps.core.errors import InputError
from vrcaps.core.files import cache_in, files_in, scratch_folder
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.data.card import duration_text, size_text
from vrcaps.data.units import Unit, Units
from vrcaps.organ.cache import short_lived_organs
from vrcaps.scenario.scenario import OrganGenerated, Scenario

_FRAMES = 6
_MAX_PATIENTS = 25
_MAX_KINDS = 4


@dataclass(frozen=True)
class Estimate:
    """Estimated cost of recordings.

    Attributes:
        seconds: Time on this machine, sequentially with all processors [s].
        num_bytes: Size of all files.
        measured: Measured kinds of recordings: an organ and a capsule each.
    """

    seconds: float
    num_bytes: int
    measured: tuple[str, ...]


@dataclass(frozen=True)
class _Cost:
    """Time [s] and size [bytes]."""

    seconds: float
    num_bytes: float


@dataclass(frozen=True)
class _Costs:
    """Costs of one kind of recording: start, each frame, and organ."""

    start: _Cost
    frame: _Cost
    organ: _Cost


def num_frames(units: Units, numbers: Sequence[int]) -> int:
    """Number of frames of recordings, from the mean of at most 25 patients.

    Args:
        units: Units of the data set.
        numbers: Indices of the recordings; at least one.

    Raises:
        InputError: If a scenario is invalid.
    """
    return round(fmean(u.scenario.frames for u in _sample(units, numbers)) * len(numbers))


def estimate(
    units: Units,
    numbers: Sequence[int],
    progress: ProgressReport = no_report,
) -> Estimate:
    """Measure a few frames of each kind of recording and extrapolate.

    A kind is an organ and a capsule; the four most frequent ones are measured. Two recordings,
    one with twice as many frames, separate the time per frame from that of the start. One patient
    of each organ is generated for this, without the cache; all capsules record this one.

    Args:
        units: Units of the data set.
        numbers: Indices of the recordings; at least one.
        progress: Called with the number of measured kinds and their total number.

    Raises:
        InputError: If a recording cannot be made.
    """
    sample = _sample(units, numbers)
    kinds: dict[str, list[Unit]] = {}
    for unit in sample:
        kinds.setdefault(_kind(unit.scenario), []).append(unit)
    chosen = sorted(kinds, key=lambda kind: (-len(kinds[kind]), kind))[:_MAX_KINDS]
    with scratch_folder() as scratch, short_lived_organs():
        costs = _measured({kind: kinds[kind][0] for kind in chosen}, scratch, progress)
    scale = len(numbers) / sum(len(kinds[kind]) for kind in chosen)
    seconds = num_bytes = 0.0
    for kind in chosen:
        cost, frames = costs[kind], fmean(u.scenario.frames for u in kinds[kind])
        count = scale * len(kinds[kind])
        # Recordings of a patient share an organ.
        organs = count * len({_organ_of(u) for u in kinds[kind]}) / len(kinds[kind])
        for part, times in ((cost.start, 1.0), (cost.frame, frames)):
            seconds += count * times * part.seconds
            num_bytes += count * times * part.num_bytes
        seconds += organs * cost.organ.seconds
        num_bytes += organs * cost.organ.num_bytes
    return Estimate(seconds, round(num_bytes), tuple(chosen))


def describe(cost: Estimate, out: str, free: int | None) -> str:
    """Two lines: duration and size, and the measured recordings.

    Args:
        cost: The estimate.
        out: Folder or URL of the data set.
        free: Its free space [bytes]; None if unknown.
    """
    space = "" if free is None else f"; {out} has {size_text(free)} free"
    return (
        f"About {duration_text(cost.seconds)} on this machine (one after the other) and "
        f"{size_text(cost.num_bytes)}{space}.\n"
        f"Measured with {', '.join(cost.measured)}."
    )


def require_space(cost: Estimate, out: str, free: int | None) -> None:
    """Check that the target has the estimated space.

    Raises:
        InputError: If it has less.
    """
    if free is not None and free < cost.num_bytes:
        raise InputError(
            f"{out} has {size_text(free)} free; {size_text(cost.num_bytes)} are required. Give an "
            "--out with more space, or fewer frames, channels or patients."
        )


def _sample(units: Units, numbers: Sequence[int]) -> list[Unit]:
    """Requested recordings of at most 25 evenly spaced patients."""
    patients = sorted({number // units.per_patient for number in numbers})
    taken = set(patients[:: max(1, len(patients) // _MAX_PATIENTS)])
    return [units[number] for number in numbers if number // units.per_patient in taken]


def _kind(scenario: Scenario) -> str:
    capsule = scenario.capsule if isinstance(scenario.capsule, str) else "a capsule"
    return f"{_organ_name(scenario)} with {Path(capsule).stem}"


def _organ_name(scenario: Scenario) -> str:
    organ = scenario.organ
    name = organ.name if isinstance(organ, OrganGenerated) else str(getattr(organ, "path", "organ"))
    return Path(name).stem


def _organ_of(unit: Unit) -> tuple[object, ...]:
    """Key of a stored organ; capsules share one, twins do not."""
    scenario = unit.scenario
    return unit.patient, bool(scenario.lesions) and scenario.clean_twin


def _measured(
    units: Mapping[str, Unit], scratch: Path, progress: ProgressReport
) -> dict[str, _Costs]:
    """Costs of some recordings; those of the same kind of organ share one patient.

    Args:
        units: Recordings by kind.
        scratch: Folder for the recordings.
        progress: Called with the number of measured kinds and their total number.
    """
    costs: dict[str, _Costs] = {}
    patients: dict[str, tuple[Scenario, _Cost]] = {}
    with cache_in(scratch / "cache"):
        for kind, unit in units.items():
            progress(len(costs), len(units))
            name = _organ_name(unit.scenario)
            if name not in patients:
                seconds = [_build_seconds(unit.scenario) for _ in range(2)]
                organ = _Cost(max(seconds[0] - seconds[1], 0.0), 0.0)
                patients[name] = unit.scenario, organ
            first, organ = patients[name]
            scenario = replace(first, capsule=unit.scenario.capsule)
            start, frame, num_bytes = _recording_costs(scenario, scratch / kind)
            costs[kind] = _Costs(start, frame, replace(organ, num_bytes=num_bytes))
    return costs


def _build_seconds(scenario: Scenario) -> float:
    from vrcaps.scenario.build import build

    started = time.perf_counter()
    build(scenario)
    return time.perf_counter() - started


def _recording_costs(scenario: Scenario, folder: Path) -> tuple[_Cost, _Cost, int]:
    """Costs of the start of a recording and of each frame, and the size of its organ [bytes]."""
    from vrcaps.recording.layout import ORGAN_GLB
    from vrcaps.recording.recorder import record

    costs, organ_bytes = [], 0
    for frames in (_FRAMES, 2 * _FRAMES):
        out = folder / str(frames)
        started = time.perf_counter()
        record(replace(scenario, frames=frames), out)
        organ_bytes = (out / ORGAN_GLB).stat().st_size
        size = sum(path.stat().st_size for path in files_in(out)) - organ_bytes
        costs.append(_Cost(time.perf_counter() - started, size))
    short, long = costs
    frame = _Cost(
        max(long.seconds - short.seconds, 0.0) / _FRAMES,
        max(long.num_bytes - short.num_bytes, 0.0) / _FRAMES,
    )
    start = _Cost(
        max(short.seconds - _FRAMES * frame.seconds, 0.0),
        max(short.num_bytes - _FRAMES * frame.num_bytes, 0.0),
    )
    return start, frame, organ_bytes
