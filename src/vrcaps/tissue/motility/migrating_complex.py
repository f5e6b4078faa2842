"""Migrating motor complex: the fasting cycle of the gut, in real minutes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.units import CM
from vrcaps.tissue.motility.segment import ZONES

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MINUTE = 60.0
_CM_PER_MINUTE = CM / MINUTE
_CYCLES = 256
_ORDER = np.array([3, 4, 1, 2])
_TERMINAL = 0.3
"""Length of the terminal ileum [m]."""

_SPEEDS = MappingProxyType(
    {
        "stomach": (5.0 * _CM_PER_MINUTE, 0.0),
        "duodenum": (8.7 * _CM_PER_MINUTE, 0.9 * _CM_PER_MINUTE),
        "jejunum": (4.7 * _CM_PER_MINUTE, 1.8 * _CM_PER_MINUTE),
        "ileum": (1.3 * _CM_PER_MINUTE, 0.4 * _CM_PER_MINUTE),
        "terminal": (0.9 * _CM_PER_MINUTE, 0.2 * _CM_PER_MINUTE),
    }
)


_Fraction = Annotated[float, Range(0.0, 1.0)]


@dataclass(frozen=True)
class ComplexStatistics:
    """Variation of the migrating motor complex between patients and between cycles.

    Kerlin and Phillips, Gastroenterology 82:694, 1982 [1]; Dooley et al., Dig. Dis. Sci. 37:723,
    1992 [2]; Ouyang et al., Dig. Dis. Sci. 34:528, 1989 [3]; Kellow et al., Gastroenterology
    91:386, 1986 [4].

    Attributes:
        cycle_means: Minimum and maximum mean cycle of a patient [s]; 113 to 230 min [2].
        cycle_deviation: Standard deviation of a patient's single cycles [s]; 58 to 70 min [2].
        shortest_cycle: Minimum length of a single cycle [s]; 15 min [1]. Cycles are symmetric about
            the mean, so the maximum is twice the mean less this: 195 min, as in [1], for a mean of
            105 min.
        origins: Fractions of fronts that start in the antrum, the proximal and the distal duodenum
            and the jejunum [2].
        third_phase: Minimum and maximum phase III [s]; grows from the pylorus to the end of the
            ileum by half of that range [2].
        fourth_phase: Minimum and maximum phase IV [s]; assumed.
        gastric_first_phase: Mean and standard deviation of phase I, fraction of the cycle [2].
        second_phase: Minimum and maximum mean fraction of phase II in the bowel [2].
        second_phase_deviation: Standard deviation of single cycles from that mean; assumed.
        front_speeds: Mean and standard deviation between patients of the front's speed [m/s] in
            each zone and the terminal ileum: [1], in the duodenum [3]; in the stomach assumed.
            In each patient it falls from the duodenum onwards [1].
        reaching: Fractions of fronts that reach the middle and the end of the small bowel: fewer
            than half, less than 10 % [4]; in [1] all did.
    """

    cycle_means: tuple[float, float] = (113.0 * MINUTE, 230.0 * MINUTE)
    cycle_deviation: Annotated[float, Range(0.0, below=math.inf)] = 64.0 * MINUTE
    shortest_cycle: float = 15.0 * MINUTE
    origins: tuple[_Fraction, _Fraction, _Fraction, _Fraction] = (0.71, 0.18, 0.10, 0.01)
    third_phase: tuple[float, float] = (5.0 * MINUTE, 10.0 * MINUTE)
    fourth_phase: tuple[float, float] = (0.0, 5.0 * MINUTE)
    gastric_first_phase: tuple[_Fraction, _Fraction] = (0.55, 0.23)
    second_phase: tuple[_Fraction, _Fraction] = (0.7, 0.8)
    second_phase_deviation: Annotated[float, Range(0.0, below=math.inf)] = 0.1
    front_speeds: Mapping[str, tuple[float, float]] = field(default_factory=lambda: dict(_SPEEDS))
    reaching: tuple[_Fraction, _Fraction] = (0.45, 0.1)

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("cycle_means", "third_phase", "fourth_phase"):
            low, high = getattr(self, name)
            require(0.0 <= low <= high < math.inf, name, (low, high), "two ascending times [s]")
        require(
            0.0 < self.shortest_cycle < self.cycle_means[0],
            "shortest_cycle",
            self.shortest_cycle,
            "above 0 s and below every mean cycle",
        )
        whole = math.fsum(self.origins)
        require(abs(whole - 1.0) < 1e-9, "origins", self.origins, "four fractions with sum 1")
        self._check_speeds()

    def _check_speeds(self) -> None:
        names = (*ZONES, "terminal")
        valid = set(self.front_speeds) == set(names) and all(
            0.0 < mean < math.inf and 0.0 <= deviation < math.inf
            for mean, deviation in self.front_speeds.values()
        )
        require(
            valid,
            "front_speeds",
            dict(self.front_speeds),
            f"mean above 0 and deviation [m/s] for each of {', '.join(names)}",
        )


@dataclass(frozen=True)
class Front:
    """Front of phase III at a position and time.

    Attributes:
        time: World time [s].
        arc_length: Position along the centerline [m].
    """

    time: float
    arc_length: float

    def __post_init__(self) -> None:
        require(math.isfinite(self.time), "A front's time", self.time, "finite [s]")
        is_on = 0.0 <= self.arc_length < math.inf
        require(is_on, "A front's arc_length", self.arc_length, "0 m or more")


@dataclass(frozen=True)
class MigratingMotorComplex:
    """Cycle of a patient: phase of the complex at each position and time.

    A cycle starts when its front starts in the antrum, or would. The front reaches each position
    after the same delay, so fronts never meet. It brings phase III, followed by IV, I and II until
    the next front. Where a front does not pass, phase II replaces III and IV. After the last cycle
    the first repeats.

    Attributes:
        starts: Start times of the cycles [s], from 0; the last entry is when the first repeats.
        positions: Arc lengths [m] of `delays`, ascending.
        delays: Time at which the front passes these positions, after the start of the cycle [s].
        first: Arc length at which the front of each cycle starts [m].
        last: Arc length at which it dies out [m].
        third: Duration of phase III at the pylorus and oral to it [s].
        third_growth: Growth of that duration per length beyond the pylorus [s/m].
        fourth: Duration of phase IV [s].
        gastric_quiet: Duration of phase I in the stomach [s].
        quiet: Duration of phase I in the bowel [s].
        pylorus: Arc length of the pylorus [m].
        offset: Time of the cycle at world time 0 [s].
    """

    starts: Float[np.ndarray, " n+1"]
    positions: Float[np.ndarray, " p"]
    delays: Float[np.ndarray, " p"]
    first: Float[np.ndarray, " n"]
    last: Float[np.ndarray, " n"]
    third: Float[np.ndarray, " n"]
    third_growth: float
    fourth: Float[np.ndarray, " n"]
    gastric_quiet: Float[np.ndarray, " n"]
    quiet: Float[np.ndarray, " n"]
    pylorus: float
    offset: float = 0.0

    def phase(
        self, arc_length: Float[np.ndarray, "*n"], time: Float[np.ndarray, "*n"] | float
    ) -> tuple[Int[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
        """Phase 1 to 4 at positions and times, and its elapsed fraction, 0 to 1.

        Args:
            arc_length: Positions along the centerline [m].
            time: World time [s].
        """
        local = time + self.offset - np.interp(arc_length, self.positions, self.delays)
        local = np.mod(local, self.starts[-1])
        cycle = np.searchsorted(self.starts, local, side="right") - 1
        since = local - self.starts[cycle]
        length = self.starts[cycle + 1] - self.starts[cycle]
        beyond = arc_length - self.pylorus
        passes = (arc_length >= self.first[cycle]) & (arc_length <= self.last[cycle])
        third = self.third[cycle] + self.third_growth * np.maximum(beyond, 0.0)
        third = np.where(passes, np.minimum(third, length), 0.0)
        fourth = np.where(passes, np.minimum(third + self.fourth[cycle], length), 0.0)
        quiet = np.where(beyond < 0.0, self.gastric_quiet[cycle], self.quiet[cycle])
        first = np.minimum(fourth + quiet, length)
        # Times since the start of the cycle at which phases III, IV, I and II end, in this order.
        ends = np.stack([third, fourth, first, length])
        phase = (since >= ends[:3]).sum(axis=0)
        end = np.take_along_axis(ends, phase[None], axis=0)[0]
        start = np.where(phase > 0, np.take_along_axis(ends, phase[None] - 1, axis=0)[0], 0.0)
        return _ORDER[phase], (since - start) / np.maximum(end - start, 1e-9)

    def at_front(self, arc_length: float, ahead: float = 0.0) -> MigratingMotorComplex:
        """Shift the cycle so that the first front that passes a position reaches it at time 0.

        Args:
            arc_length: The position [m].
            ahead: Time until the front arrives [s].

        Raises:
            InputError: If no front passes that position.
        """
        passes = np.flatnonzero((self.first <= arc_length) & (self.last >= arc_length))
        if len(passes) == 0:
            raise InputError(
                f"No front passes at {arc_length:g} m. Allowed: positions in stomach and "
                "small bowel."
            )
        delay = float(np.interp(arc_length, self.positions, self.delays))
        return replace(self, offset=float(self.starts[passes[0]]) + delay - ahead)


def draw_complex(
    statistics: ComplexStatistics,
    zones: Mapping[str, tuple[float, float]],
    rng: np.random.Generator,
) -> MigratingMotorComplex:
    """Draw the cycle of a patient.

    Args:
        statistics: Variation between patients.
        zones: Start and end of each of `ZONES` that the organ has [m].
        rng: Random generator of the patient.

    Raises:
        InputError: If the organ has none of the zones.
    """
    if not zones:
        raise InputError("The migrating motor complex requires a stomach or small bowel.")
    s, n = statistics, _CYCLES
    mean = rng.uniform(*s.cycle_means)
    low, high = s.shortest_cycle, 2.0 * mean - s.shortest_cycle
    lengths = _truncated_normal(rng, (mean, s.cycle_deviation), (low, high), n)
    positions, delays = _delays(s, zones, rng)
    base, growth = s.third_phase[0], 0.5 * (s.third_phase[1] - s.third_phase[0])
    third = base + rng.uniform(0.0, growth, n)
    fourth = rng.uniform(*s.fourth_phase, n)
    fraction = rng.uniform(*s.second_phase)
    second = _truncated_normal(rng, (fraction, s.second_phase_deviation), (0.0, 1.0), n)
    gastric = _truncated_normal(rng, s.gastric_first_phase, (0.0, 1.0), n)
    bowel = [ends for zone, ends in zones.items() if zone != "stomach"]
    start = bowel[0][0] if bowel else positions[-1]
    span = max(positions[-1] - start, 1e-6)
    first, last = _reach(s, zones, (start, span), rng)
    shortened = third + 0.5 * growth + fourth
    return MigratingMotorComplex(
        starts=np.append(0.0, np.cumsum(lengths)),
        positions=positions,
        delays=delays,
        first=first,
        last=last,
        third=third,
        third_growth=growth / span,
        fourth=fourth,
        gastric_quiet=gastric * lengths,
        quiet=np.maximum((1.0 - second) * lengths - shortened, 0.0),
        pylorus=float(start),
        offset=float(rng.uniform(0.0, np.sum(lengths))),
    )


def _delays(
    statistics: ComplexStatistics,
    zones: Mapping[str, tuple[float, float]],
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """Positions at which the front's speed changes [m], and its arrival times there [s]."""
    speeds = _front_speeds(statistics, rng)
    positions, delays = [next(iter(zones.values()))[0]], [0.0]
    for zone, (_, end) in zones.items():
        parts = [(end, speeds[zone])]
        if zone == "ileum":
            parts = [(max(positions[-1], end - _TERMINAL), speeds[zone]), (end, speeds["terminal"])]
        for to, speed in parts:
            delays.append(delays[-1] + (to - positions[-1]) / speed)
            positions.append(to)
    return np.array(positions), np.array(delays)


def _front_speeds(statistics: ComplexStatistics, rng: np.random.Generator) -> dict[str, float]:
    """Front speeds of a patient [m/s], falling from the duodenum onwards."""
    speeds = {"stomach": statistics.front_speeds["stomach"][0]}
    before = math.inf
    for zone in ("duodenum", "jejunum", "ileum", "terminal"):
        mean, deviation = statistics.front_speeds[zone]
        bounds = (0.2 * mean, max(before, 0.2 * mean))
        speeds[zone] = before = float(_truncated_normal(rng, (mean, deviation), bounds, 1)[0])
    return speeds


def _reach(
    statistics: ComplexStatistics,
    zones: Mapping[str, tuple[float, float]],
    bowel: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Arc lengths at which the fronts start and die out [m]."""
    start, span = bowel
    duodenum = zones.get("duodenum", (start, start))
    middle = 0.5 * (duodenum[0] + duodenum[1])
    starts = np.array([-np.inf, duodenum[0], middle, duodenum[1]])
    first = starts[rng.choice(4, _CYCLES, p=statistics.origins)]
    half, end = statistics.reaching
    # Fraction of fronts that get beyond a fraction of the bowel: piecewise linear, falling from 1.
    survivors = [1.0, max(half, 1e-9), min(end, half), 0.0]
    position = np.interp(rng.uniform(size=_CYCLES), survivors[::-1], [2.0, 1.0, 0.5, 0.0])
    return first, np.maximum(start + span * position, np.where(np.isfinite(first), first, start))


def _truncated_normal(
    rng: np.random.Generator,
    law: tuple[float, float],
    bounds: tuple[float, float],
    count: int,
) -> Float[np.ndarray, " n"]:
    """Samples of a normal distribution truncated to bounds, by rejection."""
    mean, deviation = law
    if deviation == 0.0:
        return np.clip(np.full(count, mean), *bounds)
    values = rng.normal(mean, deviation, count)
    for _ in range(1000):
        outside = (values < bounds[0]) | (values > bounds[1])
        if not outside.any():
            return values
        values[outside] = rng.normal(mean, deviation, int(outside.sum()))
    return np.clip(values, *bounds)
