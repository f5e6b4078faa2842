"""Estimate of a data set before it is made: frames, time and bytes, from a short measurement."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean

from vrcaps.data.units import Units
from vrcaps.files import files_in

_FRAMES = 6


@dataclass(frozen=True)
class Estimate:
    """What a data set takes.

    Attributes:
        frames: Number of frames.
        seconds: Time on this machine, one recording after the other on all processors [s].
        num_bytes: Size of all files.
    """

    frames: int
    seconds: float
    num_bytes: int


def estimate(units: Units) -> Estimate:
    """Measure a few frames of the first unit and extrapolate.

    A recording of few frames and one of twice as many tell the time of a frame from that of the
    beginning. Organs that are made for the first time take longer than this says.

    Raises:
        InputError: If the first unit cannot be recorded.
    """
    from vrcaps.recording.layout import ORGAN_GLB
    from vrcaps.recording.recorder import record

    scenario, organ = units[0].scenario, 0
    costs = []
    with tempfile.TemporaryDirectory(prefix="vrcaps-estimate-") as scratch:
        for number, frames in enumerate((_FRAMES, _FRAMES, 2 * _FRAMES)):
            folder = Path(scratch) / str(number)
            began = time.perf_counter()
            record(replace(scenario, frames=frames), folder)
            organ = (folder / ORGAN_GLB).stat().st_size  # stored once for each patient
            size = sum(path.stat().st_size for path in files_in(folder)) - organ
            costs.append((time.perf_counter() - began, size))
    # The first one may have made the organ.
    (_, _), (short, short_size), (long, long_size) = costs
    mean_frames = fmean(units[number].scenario.frames for number in _sample(len(units)))
    per_frame = max(long - short, 0.0) / _FRAMES
    size_per_frame = (long_size - short_size) / _FRAMES
    begin = max(short - per_frame * _FRAMES, 0.0)
    return Estimate(
        round(mean_frames * len(units)),
        len(units) * (begin + per_frame * mean_frames),
        len(units.splits) * organ
        + round(len(units) * (short_size + size_per_frame * (mean_frames - _FRAMES))),
    )


def _sample(count: int) -> range:
    """At most a hundred numbers, evenly spread."""
    return range(0, count, max(1, count // 100))
