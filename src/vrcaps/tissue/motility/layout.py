"""Layout of the muscle along an organ: samples, parameters of the segments, and rows of waves."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import UnknownNameError
from vrcaps.core.units import CM, MM
from vrcaps.organ.surface import Centerline, OrganSurface, polyline_points
from vrcaps.tissue.motility.segment import ZONES, organ_divisions

if TYPE_CHECKING:
    from collections.abc import Iterator

    from jaxtyping import Float, Int

    from vrcaps.tissue.motility.motility import Motility


_SPACING = 1.0 * MM


def arc_length_samples(centerline: Centerline) -> Float[np.ndarray, " k"]:
    """Arc lengths [m] of the samples: evenly spaced from end to end, about 1 mm apart."""
    return np.linspace(0.0, centerline.length, max(2, math.ceil(centerline.length / _SPACING) + 1))


def sample_coordinates(
    organ: OrganSurface,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Offset of each vertex to the centerline [m], and its position in samples [spacings]."""
    curve = organ.centerline
    nearest = polyline_points(curve, organ.arc_length)
    node_position = organ.arc_length / arc_length_samples(curve)[1]
    return nearest - organ.vertices, np.ascontiguousarray(node_position, float)


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
        pace: Index of the pacemaker of each sample, ascending.
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
            start_row = zones.get(segment.zone, ends)[0]
            zones[segment.zone] = (float(start_row), float(ends[1]))
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
    index = np.empty(len(samples), int)
    for value, start, end in _runs(label):
        name = _known_name(organ, value, motility)
        parts = ((name, 1.0),) if name in motility.segments else organ_divisions()[name]
        ends = np.rint(
            start + (end - start) * np.cumsum([fraction for _, fraction in parts])
        ).astype(int)
        for (part, _), first, last in zip(parts, [start, *ends[:-1]], ends, strict=True):
            if part not in known:
                known.append(part)
            index[first:last] = known.index(part)
    return tuple(known), index


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
    """Predominant label of the wall at each sample; without vertices, the next label."""
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
    start = index = 0
    for k in range(len(rates)):
        if abs(rates[k] - rates[start]) > _DRIFT or cycles[k] != cycles[start]:
            start, index = k, index + 1
        pace[k] = index
    return pace


def _blended(parameters: Float[np.ndarray, "7 k"], spacing: float) -> Float[np.ndarray, "7 k"]:
    """Moving averages over a short length."""
    half = max(1, round(0.5 * _BLEND / spacing))
    wide = np.pad(parameters, ((0, 0), (half + 1, half)), mode="edge")
    total = np.cumsum(wide, axis=1)
    return (total[:, 2 * half + 1 :] - total[:, : -2 * half - 1]) / (2 * half + 1)


KINDS = (1.0, -1.0, 0.0)
"""Antegrade, retrograde and standing waves."""

_OVERLAP = 2.0 * CM
_FADE = 1.0 * CM


@dataclass(frozen=True)
class Rows:
    """Time-independent properties of the waves, sorted by pacemaker, kind and sample.

    Attributes:
        sample: Index of the sample.
        group: Index unique to a pair of pacemaker and kind.
        pace: Index of the pacemaker.
        kind: A value of `KINDS`.
        rate: Slow-wave rate of the pacemaker [1/s].
        lag: Phase lag of the slow wave [cycles].
        start: Time at which wave 0 is, or would be, at the start of the organ [s].
        duty: Fraction of the slow-wave period that a contraction lasts.
        amplitude: Fraction of the radius that a full contraction takes.
        node_position: Position in nodes of irregular contractions.
        low: Minimum draw for which a wave is of this kind somewhere nearby.
        high: Maximum such draw.
    """

    sample: Int[np.ndarray, " r"]
    group: Float[np.ndarray, " r"]
    pace: Float[np.ndarray, " r"]
    kind: Float[np.ndarray, " r"]
    rate: Float[np.ndarray, " r"]
    lag: Float[np.ndarray, " r"]
    start: Float[np.ndarray, " r"]
    duty: Float[np.ndarray, " r"]
    amplitude: Float[np.ndarray, " r"]
    node_position: Float[np.ndarray, " r"]
    low: Float[np.ndarray, " r"]
    high: Float[np.ndarray, " r"]

    def take(self, which: Int[np.ndarray, " q"] | slice) -> Rows:
        """Subset of the rows."""
        return Rows(**{name: values[which] for name, values in vars(self).items()})


@dataclass(frozen=True)
class Table:
    """Rows of an organ, and values that its samples share.

    Attributes:
        rows: All rows.
        order: Row indices sorted by sample.
        start_row: First entry of each sample in that order, then the number of rows.
        delay: Travel time of waves from the oral end to each sample [s].
        node_position: Position of each sample in nodes of irregular contractions.
    """

    rows: Rows
    order: Int[np.ndarray, " r"]
    start_row: Int[np.ndarray, " k+1"]
    delay: Float[np.ndarray, " k"]
    node_position: Float[np.ndarray, " k"]

    def near(self, first: int, last: int) -> Rows:
        """Rows of the samples from `first` to before `last`."""
        if (first, last) == (0, len(self.delay)):
            return self.rows
        return self.rows.take(np.sort(self.order[self.start_row[first] : self.start_row[last]]))


def make_table(layout: Layout, rng: np.random.Generator) -> Table:
    """Build the rows of an organ; each pacemaker starts at a random phase."""
    spacing = layout.arc_length[1]
    amplitude, speed, duration, extent, _, back, stand = layout.parameters
    delay, node_position = (
        np.concatenate([[0.0], np.cumsum(0.5 * spacing * (1.0 / f[1:] + 1.0 / f[:-1]))])
        for f in (speed, extent)
    )
    parts: dict[str, list[np.ndarray]] = {field.name: [] for field in fields(Rows)}
    group = 0
    for pace, rate in enumerate(layout.rate):
        weight = _weight(layout, pace)
        at = np.flatnonzero(weight * amplitude > 0.0)
        near = np.flatnonzero(np.abs(layout.pace - pace) <= 1)
        origin, turn = delay[np.searchsorted(layout.pace, pace)], rng.uniform()
        for kind, low, high in (
            (KINDS[0], back[near].min(), 1.0),
            (KINDS[1], 0.0, back[near].max()),
            (KINDS[2], 1.0 - stand[near].max(), 1.0),
        ):
            if low == high or len(at) == 0:
                continue
            values = {
                "sample": at,
                "group": group,
                "pace": pace,
                "kind": kind,
                "rate": rate,
                "lag": rate * kind * (delay[at] - origin) + turn,
                "start": turn / rate - kind * origin,
                "duty": np.minimum(rate * duration[at], 1.0),
                "amplitude": (weight * amplitude)[at],
                "node_position": node_position[at],
                "low": low,
                "high": high,
            }
            for name, value in values.items():
                parts[name].append(np.broadcast_to(value, at.shape))
            group += 1
    rows = Rows(**{name: np.concatenate([[], *values]) for name, values in parts.items()})
    rows = replace(rows, sample=rows.sample.astype(int))
    order = np.argsort(rows.sample, kind="stable")
    start_row = np.searchsorted(rows.sample[order], np.arange(len(layout.arc_length) + 1))
    return Table(rows, order, start_row, delay, node_position)


def _weight(layout: Layout, pace: int) -> Float[np.ndarray, " k"]:
    """Remaining weight of a pacemaker's waves at each sample.

    Waves continue into a neighbor of nearly the same rate and fade there; otherwise they fade
    before they reach it.
    """
    samples = layout.arc_length
    own = np.flatnonzero(layout.pace == pace)
    weight = np.ones(len(samples))
    for side, end in ((-1.0, samples[own[0]]), (1.0, samples[own[-1]])):
        other = pace + int(side)
        beyond = side * (samples - end)
        is_near = 0 <= other < len(layout.rate) and (
            abs(layout.rate[other] - layout.rate[pace]) < 1.5 / 60.0
        )
        left = 1.0 - beyond / _OVERLAP if is_near else -beyond / _FADE
        weight = np.minimum(weight, np.clip(left, 0.0, 1.0))
    return weight
