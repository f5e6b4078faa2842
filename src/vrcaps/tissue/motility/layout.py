"""Layout of the muscle: parameters of the segments at each sample along an organ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import UnknownNameError
from vrcaps.core.units import CM
from vrcaps.tissue.arc_length_samples import arc_length_samples
from vrcaps.tissue.motility.segment import ZONES, organ_divisions

if TYPE_CHECKING:
    from collections.abc import Iterator

    from jaxtyping import Float, Int

    from vrcaps.organ.surface import OrganSurface
    from vrcaps.tissue.motility.motility import Motility

_BLEND = 2.0 * CM
_DRIFT = 0.5 / 60.0
"""Change of the slow-wave rate [1/s] beyond which muscle has a separate pacemaker."""


@dataclass(frozen=True)
class Layout:
    """Parameters of `SegmentMotility` at each sample, blended between segments.

    All slow waves of a pacemaker (frequency plateau) have one rate; the rate falls along the bowel
    in steps, as measured (Diamant and Bortoff, Am. J. Physiol. 216:301, 1969).

    Attributes:
        arc_length: Arc lengths [m].
        name: Segment of each sample, an index into `names`.
        names: Names of the organ's segments.
        pace: Index of the pacemaker of each sample, rising.
        rate: Slow-wave rate of each pacemaker [1/s].
        parameters: Amplitude, speed [m/s], duration [s], extent [m], activity, retrograde and
            standing fraction, one row each.
        cycles: Whether the migrating motor complex passes each sample.
        zones: Start and end of each zone of the complex [m].
    """

    arc_length: Float[np.ndarray, " k"]
    name: Int[np.ndarray, " k"]
    names: tuple[str, ...]
    pace: Int[np.ndarray, " k"]
    rate: Float[np.ndarray, " p"]
    parameters: Float[np.ndarray, "7 k"]
    cycles: Float[np.ndarray, " k"]
    zones: dict[str, tuple[float, float]]


def lay_out(organ: OrganSurface, motility: Motility) -> Layout:
    """Lay out the muscle of an organ by the segment labels of its wall.

    Raises:
        UnknownNameError: If neither a segment nor the organ has a known name.
    """
    samples = arc_length_samples(organ.centerline)
    names, name = _segments(organ, motility, samples)
    parameters, rates = np.empty((7, len(samples))), np.empty(len(samples))
    cycles = np.zeros(len(samples), bool)
    zones: dict[str, tuple[float, float]] = {}
    for number, start, end in _runs(name):
        segment = motility.segments[names[number]]
        fraction = np.linspace(0.0, 1.0, end - start)
        rates[start:end] = np.interp(fraction, [0.0, 1.0], segment.rates)
        parameters[0, start:end] = segment.amplitude
        parameters[1, start:end] = np.interp(fraction, [0.0, 1.0], segment.speeds)
        parameters[2:, start:end] = np.array(
            [
                segment.duration,
                segment.extent,
                segment.activity,
                segment.retrograde,
                segment.standing,
            ]
        )[:, None]
        if segment.zone is not None:
            cycles[start:end] = True
            ends = samples[[start, end - 1]]
            begin = zones.get(segment.zone, ends)[0]
            zones[segment.zone] = (float(begin), float(ends[1]))
    pace = _paces(rates, cycles)
    return Layout(
        arc_length=samples,
        name=name,
        names=names,
        pace=pace,
        rate=np.bincount(pace, rates) / np.bincount(pace),
        parameters=_blended(parameters, samples[1]),
        cycles=cycles,
        zones={zone: zones[zone] for zone in ZONES if zone in zones},
    )


def _segments(
    organ: OrganSurface, motility: Motility, samples: Float[np.ndarray, " k"]
) -> tuple[tuple[str, ...], Int[np.ndarray, " k"]]:
    """Names of the segments, and the index of the dominant segment of the wall at each sample."""
    label = _labels(organ, samples)
    known: list[str] = []
    number = np.empty(len(samples), int)
    for value, start, end in _runs(label):
        name = _known_name(organ, value, motility)
        parts = ((name, 1.0),) if name in motility.segments else organ_divisions()[name]
        ends = np.rint(
            start + (end - start) * np.cumsum([fraction for _, fraction in parts])
        ).astype(int)
        for (part, _), first, last in zip(parts, [start, *ends[:-1]], ends, strict=True):
            if part not in known:
                known.append(part)
            number[first:last] = known.index(part)
    return tuple(known), number


def _known_name(organ: OrganSurface, label: int, motility: Motility) -> str:
    names = (organ.label_names[label], organ.name)
    divisions = organ_divisions()
    for name in (names[0], names[0].replace("-", "_"), names[1].replace("-", "_")):
        if name in motility.segments or name in divisions:
            return name
    if motility.fallback_segment is None:
        raise UnknownNameError("segment with muscle", names[0], (*motility.segments, *divisions))
    return motility.fallback_segment


def _labels(organ: OrganSurface, samples: Float[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
    """Most frequent label of the wall at each sample; without vertices, the next label."""
    nearest = np.clip(np.rint(organ.arc_length / samples[1]), 0, len(samples) - 1).astype(int)
    num = len(organ.label_names)
    count = np.bincount(nearest * num + organ.label, minlength=len(samples) * num)
    count = count.reshape(len(samples), num)
    filled = np.flatnonzero(count.any(axis=1))
    after = np.clip(np.searchsorted(filled, np.arange(len(samples))), 0, len(filled) - 1)
    return count[filled[after]].argmax(axis=1)


def _runs(values: Int[np.ndarray, " k"]) -> Iterator[tuple[int, int, int]]:
    """Value, first index and end of each run of equal values."""
    cuts = np.flatnonzero(np.diff(values)) + 1
    for start, end in zip([0, *cuts], [*cuts, len(values)], strict=True):
        yield int(values[start]), int(start), int(end)


def _paces(rates: Float[np.ndarray, " k"], cycles: Float[np.ndarray, " k"]) -> np.ndarray:
    """Index of the pacemaker at each sample: a new one where the rate has changed enough."""
    pace = np.empty(len(rates), int)
    start = number = 0
    for k in range(len(rates)):
        if abs(rates[k] - rates[start]) > _DRIFT or cycles[k] != cycles[start]:
            start, number = k, number + 1
        pace[k] = number
    return pace


def _blended(parameters: Float[np.ndarray, "7 k"], spacing: float) -> Float[np.ndarray, "7 k"]:
    """Moving averages over a short length."""
    half = max(1, round(0.5 * _BLEND / spacing))
    wide = np.pad(parameters, ((0, 0), (half + 1, half)), mode="edge")
    total = np.cumsum(wide, axis=1)
    return (total[:, 2 * half + 1 :] - total[:, : -2 * half - 1]) / (2 * half + 1)
