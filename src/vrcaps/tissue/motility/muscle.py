"""Muscle of one organ of one patient: lumen scale at each position and time."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.tissue.motility.layout import KINDS, Rows, Table, lay_out, make_table
from vrcaps.tissue.motility.migrating_complex import draw_complex

if TYPE_CHECKING:
    from jaxtyping import Float, Int, Real

    from vrcaps.organ.surface import OrganSurface
    from vrcaps.tissue.motility.migrating_complex import Front, MigratingMotorComplex
    from vrcaps.tissue.motility.motility import GiantContractions, Motility

_WEYL = 0x9E3779B97F4A7C15
_WHOLE = 1 << 64


def uniform(key: int, purpose: int, *indices: Real[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Uniform random values in [0, 1), one for each row of integers.

    Uses the finalizer of SplitMix64 (Steele, Lea, Flood, OOPSLA 2014) on a sum of odd multiples.

    Args:
        key: Key of the stream, 0 to 2⁶⁴ − 1.
        purpose: Distinguishes draws for the same integers.
        indices: Integers that index the draws.
    """
    factor = _WEYL
    mixed = np.full(1, (key ^ (purpose * factor)) % _WHOLE, np.uint64)
    for index in indices:
        factor = (factor * 0xD1342543DE82EF95) % _WHOLE
        mixed = mixed + index.astype(np.int64).view(np.uint64) * np.uint64(factor)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((mixed ^ (mixed >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53


_HOUR = 3600.0
_CHANGE_OVER = 2.0
"""Transition time of the contractions after a front is started [s]."""

_GIANT_RAMP = 0.1
"""Fraction of its extent over which a giant contraction grows and fades."""

_RATE_STEP = 1e-3
_ACTIVITY = np.array(
    [
        [0.0, 0.0, 1.0, 0.0, -1.0],
        [1.0, 0.0, 0.5, 1.0, 1.0],
        [1.0, 1.0, 1.0, 0.0, 0.0],
    ]
)
"""Fraction of slow waves that contract without a complex and in phases I to IV: its change over
the phase, its initial value, and whether both are relative to the steady activity. Contractions
increase through phase II and die away in phase IV."""

_STRENGTH = np.array([[0.0, 0.0, 0.5, 0.0, -1.0], [1.0, 0.0, 0.5, 1.0, 1.0]])
"""Strength of these contractions, in the same layout without the last row."""


@dataclass(frozen=True)
class _Rule:
    """Behavior of the muscle from a time onwards.

    Attributes:
        start: Start time [s].
        clock: Cycle of the migrating motor complex; None without one.
        is_awake: Whether the muscle contracts.
    """

    start: float
    clock: MigratingMotorComplex | None
    is_awake: bool = True


class Muscle:
    """Waves of contraction along an organ, as functions of time only.

    The n-th slow wave of a pacemaker passes a position when φ = f t − k ∫ f ds / c − θ is n, with
    k = 1 for antegrade, −1 for retrograde and 0 for standing waves. There it narrows the lumen by

        amplitude · cos²(π (φ − n) / (f d)) · g

    of its radius while |φ − n| < f d / 2; d is the duration of the contraction and g its local
    strength. g changes smoothly between nodes that are `extent` apart and differ from wave to wave;
    at each node it is 0 or 1, drawn by patient, wave and node only. The strongest contraction
    determines the lumen. When a front of phase III is started, the muscle changes over from the
    previous cycle within a short time. The lumen scale at a time is therefore stateless and
    independent of the time steps.
    """

    def __init__(self, organ: OrganSurface, motility: Motility, rng: np.random.Generator) -> None:
        """Create the muscle of a patient.

        Args:
            organ: The gut at rest.
            motility: Motility of the segments.
            rng: Random generator of the patient's cycle and of all contractions.

        Raises:
            InputError: If no front passes a position at which one is set.
            UnknownNameError: If a segment of the wall has no known name.
        """
        self.motility, self.centerline = motility, organ.centerline
        self.layout = lay_out(organ, motility)
        self._table: Table = make_table(self.layout, rng)
        self._key = int(rng.integers(2**63))
        self.clock = None
        if motility.complex is not None and self.layout.zones:
            self.clock = draw_complex(motility.complex, self.layout.zones, rng)
            if motility.front is not None:
                self.clock = self.clock.at_front(motility.front)
        self._rules = self._rules_of(motility)

    def with_fronts(self, fronts: tuple[Front, ...]) -> Muscle:
        """Muscle of the same patient with other fronts of phase III, see `Motility.fronts`.

        Raises:
            InputError: If no front passes a position at which one is set.
        """
        other = copy(self)
        other.motility = replace(self.motility, fronts=fronts)
        other._rules = other._rules_of(other.motility)
        return other

    def _rules_of(self, motility: Motility) -> list[_Rule]:
        """Rules of the muscle in order of time."""
        rules = [_Rule(-math.inf, self.clock, not motility.is_asleep)]
        for front in motility.fronts:
            if self.clock is None:
                raise InputError(
                    "Phase III starts only where the migrating motor complex passes: in stomach "
                    "and small bowel, unless motility is steady."
                )
            clock = self.clock.at_front(front.arc_length, ahead=front.time)
            rules.append(_Rule(front.time, clock))
        return rules

    def _rule_index(self, time: float) -> int:
        """Index of the rule in force at a time [s]."""
        return bisect_right(self._rules, time, key=lambda rule: rule.start) - 1

    def _under_rules(
        self, time: float, value: Callable[[_Rule], Float[np.ndarray, "*n"]]
    ) -> Float[np.ndarray, "*n"]:
        """Value under the rule at a time [s], blended with the previous rule after a change."""
        index = self._rule_index(time)
        passed = (time - self._rules[index].start) / _CHANGE_OVER
        now = value(self._rules[index])
        if index == 0 or passed >= 1.0:
            return now
        before = value(self._rules[index - 1])
        return before + passed * passed * (3.0 - 2.0 * passed) * (now - before)

    def lumen_scale(self, time: float, span: slice = slice(None)) -> Float[np.ndarray, " k"]:
        """Radius of the lumen at the samples, relative to that at rest.

        Args:
            time: World time [s].
            span: Range of samples, in steps of 1; all by default.
        """
        return self._under_rules(time, lambda rule: self._lumen_scale(rule, time, span))

    def _lumen_scale(self, rule: _Rule, time: float, span: slice) -> Float[np.ndarray, " k"]:
        """Relative radius of the lumen at the samples under one rule."""
        first, last, _ = span.indices(len(self.layout.arc_length))
        if not rule.is_awake:
            return np.ones(last - first)
        rows = self._table.near(first, last)
        turns = rows.rate * time - rows.lag
        wave = np.rint(turns)
        offset = turns - wave
        at = np.flatnonzero(np.abs(offset) < 0.5 * rows.duty)
        deepest = np.zeros(last - first)
        if len(at):
            at, factor = self._strengths(rule, rows, wave, at)
            pulse = np.cos(np.pi * offset[at] / rows.duty[at]) ** 2
            depth = rows.amplitude[at] * pulse * factor
            np.maximum.at(deepest, rows.sample[at] - first, depth)
        if self.motility.giant is not None:
            self._add_giant(self.motility.giant, deepest, time, first)
        return np.maximum(1.0 - deepest, self.motility.min_lumen_scale)

    def rate(self, time: float) -> Float[np.ndarray, " k"]:
        """Rate of change of the lumen scale at the samples [1/s], by central differences."""
        after, before = self.lumen_scale(time + _RATE_STEP), self.lumen_scale(time - _RATE_STEP)
        return (after - before) / (2.0 * _RATE_STEP)

    def phase(self, arc_length: Float[np.ndarray, "*n"], time: float) -> Int[np.ndarray, "*n"]:
        """Phase 1 to 4 of the migrating motor complex at positions [m]; 0 where none passes."""
        arc_length = np.asarray(arc_length, float)
        phase = np.zeros(arc_length.shape, int)
        cycles = self.layout.cycles[self._nearest(arc_length)]
        rule = self._rules[self._rule_index(time)]
        if rule.clock is not None and rule.is_awake:
            phase = np.where(cycles, rule.clock.phase(arc_length, time)[0], 0)
        return phase

    def strength(self, arc_length: Float[np.ndarray, "*n"], time: float) -> np.ndarray:
        """Strength of contractions at positions [m], from 0 in phase I to 1 in phase III."""
        arc_length = np.asarray(arc_length, float)
        times = np.full(arc_length.shape, time)

        def strength(rule: _Rule) -> Float[np.ndarray, "*n"]:
            return rule.is_awake * self._activity(rule, arc_length, times)[1]

        return self._under_rules(time, strength)

    def propulsion(
        self,
        position: Float[np.ndarray, " 3"],
        velocity: Float[np.ndarray, " 3"],
        time: float,
    ) -> Float[np.ndarray, " 3"]:
        """Force of `Propulsion` [N] on a capsule, in the organ frame.

        Args:
            position: Position of the capsule [m].
            velocity: Velocity of the capsule [m/s].
            time: World time [s].
        """
        law, line = self.motility.propulsion, self.centerline
        if law is None:
            return np.zeros(3)
        nearest = np.argmin(np.square(line.points - position).sum(axis=1))
        arc_length = line.arc_length[nearest]
        alpha = law.alpha
        if alpha is None:
            alpha = self.layout.parameters[1, self._nearest(arc_length)]
        force = law.force(alpha * law.unit_vector(line, float(arc_length)), velocity)
        return self.strength(arc_length, time) * force

    def _nearest(self, arc_length: Float[np.ndarray, "*n"] | float) -> np.ndarray:
        samples = self.layout.arc_length
        index = np.rint(np.asarray(arc_length) / samples[1]).astype(int)
        return np.clip(index, 0, len(samples) - 1)

    def _strengths(
        self, rule: _Rule, rows: Rows, wave: Float[np.ndarray, " r"], at: Int[np.ndarray, " q"]
    ) -> tuple[Int[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """Rows among `at` that may contract, and their strength, 0 to 1, blended between nodes."""
        run, starts = _runs(rows.group[at], wave[at])
        head = at[starts]
        drawn = uniform(self._key, 1, rows.pace[head], wave[head])
        likely = ((drawn >= rows.low[head]) & (drawn <= rows.high[head]))[run]
        at, run = at[likely], run[likely]
        shift = uniform(self._key, 2, rows.pace[head], wave[head])
        node_position = rows.node_position[at] + shift[run]
        node = np.floor(node_position)
        part, starts = _runs(run, node)
        first, waves = at[starts], run[starts]
        before, after = self._contracts(
            rule,
            rows.take(first),
            wave[first],
            drawn[waves],
            node[starts] + [[0.0], [1.0]],
            shift[waves],
        )
        between = node_position - node
        smooth = between * between * (3.0 - 2.0 * between)
        return at, before[part] + smooth * (after - before)[part]

    def _contracts(
        self,
        rule: _Rule,
        rows: Rows,
        wave: Float[np.ndarray, " r"],
        drawn: Float[np.ndarray, " r"],
        node: Float[np.ndarray, "2 r"],
        shift: Float[np.ndarray, " r"],
    ) -> Float[np.ndarray, "2 r"]:
        """Strength of contraction of waves at nodes, 0 to 1."""
        arc_length = np.interp(node - shift, self._table.node_position, self.layout.arc_length)
        nearest = self._nearest(arc_length)
        when = wave / rows.rate + rows.start + rows.kind * self._table.delay[nearest]
        activity, strength, stands = self._activity(rule, arc_length, when)
        back, stand = self.layout.parameters[5:, nearest]
        kind = np.where(drawn > 1.0 - stand * stands, KINDS[2], KINDS[0])
        kind = np.where(drawn < back, KINDS[1], kind)
        lot = uniform(self._key, 3, rows.pace, wave, node)
        return strength * ((kind == rows.kind) & (lot < activity))

    def _activity(
        self, rule: _Rule, arc_length: Float[np.ndarray, " r"], time: Float[np.ndarray, " r"]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fraction of slow waves that contract, their strength, and whether some of them stand."""
        nearest = self._nearest(arc_length)
        steady = self.layout.parameters[4, nearest]
        if rule.clock is None:
            return steady, np.ones_like(steady), np.ones_like(steady)
        phase, passed = rule.clock.phase(arc_length, time)
        phase = np.where(self.layout.cycles[nearest], phase, 0)
        slope, base, of_steady = _ACTIVITY[:, phase]
        activity = np.where(of_steady, steady, 1.0) * (base + slope * passed)
        slope, base = _STRENGTH[:, phase]
        return activity, base + slope * passed, (phase < 3) * 1.0

    def _add_giant(
        self, giant: GiantContractions, deepest: Float[np.ndarray, " k"], time: float, first: int
    ) -> None:
        """Add the giant contractions in progress at a time, from sample `first` onwards."""
        layout = self.layout
        colon = np.flatnonzero(~layout.cycles)
        if len(colon) == 0:
            return
        start, end = layout.arc_length[colon[[0, -1]]]
        hours = np.floor(time / _HOUR) + np.array([-1.0, 0.0])
        lots, moments, origins = (uniform(self._key, 4 + k, hours) for k in range(3))
        since = time - (hours + moments) * _HOUR
        lasts = giant.duration + giant.extent / giant.speed
        active = (lots < giant.rate * _HOUR) & (since >= 0.0) & (since < lasts)
        here = slice(first, first + len(deepest))
        for k in np.flatnonzero(active):
            traveled = layout.arc_length[here] - start - origins[k] * giant.origin * (end - start)
            middle = (since[k] - traveled / giant.speed) / giant.duration - 0.5
            pulse = np.cos(np.pi * np.clip(middle, -0.5, 0.5)) ** 2
            whole = np.minimum(traveled, giant.extent - traveled) / (_GIANT_RAMP * giant.extent)
            factor = np.clip(whole, 0.0, 1.0) * ~layout.cycles[here]
            np.maximum(deepest, giant.amplitude * pulse * factor, out=deepest)


def _runs(
    one: Float[np.ndarray, " r"], other: Float[np.ndarray, " r"]
) -> tuple[Int[np.ndarray, " r"], Int[np.ndarray, " s"]]:
    """Runs in which both are equal: run index of each entry, and start of each run."""
    is_new = np.ones(len(one), bool)
    is_new[1:] = (one[1:] != one[:-1]) | (other[1:] != other[:-1])
    return np.cumsum(is_new) - 1, np.flatnonzero(is_new)
