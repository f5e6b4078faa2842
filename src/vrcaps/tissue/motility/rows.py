"""Table of waves that may contract each sample: one row per kind, more where pacemakers meet."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.units import CM

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.tissue.motility.layout import Layout

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
        place: Position in nodes of irregular contractions.
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
    place: Float[np.ndarray, " r"]
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
        begin: First entry of each sample in that order, then the number of rows.
        delay: Travel time of waves from the oral end to each sample [s].
        place: Position of each sample in nodes of irregular contractions.
    """

    rows: Rows
    order: Int[np.ndarray, " r"]
    begin: Int[np.ndarray, " k+1"]
    delay: Float[np.ndarray, " k"]
    place: Float[np.ndarray, " k"]

    def near(self, first: int, last: int) -> Rows:
        """Rows of the samples from `first` to before `last`."""
        if (first, last) == (0, len(self.delay)):
            return self.rows
        return self.rows.take(np.sort(self.order[self.begin[first] : self.begin[last]]))


def make_table(layout: Layout, rng: np.random.Generator) -> Table:
    """Build the rows of an organ; each pacemaker starts at a random phase."""
    spacing = layout.arc_length[1]
    amplitude, speed, duration, extent, _, back, stand = layout.parameters
    delay, place = (
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
                "place": place[at],
                "low": low,
                "high": high,
            }
            for name, value in values.items():
                parts[name].append(np.broadcast_to(value, at.shape))
            group += 1
    rows = Rows(**{name: np.concatenate([[], *values]) for name, values in parts.items()})
    rows = replace(rows, sample=rows.sample.astype(int))
    order = np.argsort(rows.sample, kind="stable")
    begin = np.searchsorted(rows.sample[order], np.arange(len(layout.arc_length) + 1))
    return Table(rows, order, begin, delay, place)


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
