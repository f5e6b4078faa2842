"""Claim: the passive transit time of the small bowel is that of patients.

Reference: median 198.5 min, quartiles 157 and 240.5 (71 healthy subjects; O'Grady et al., Endosc.
Int. Open 8:E396, 2020); mean 282 ± 132 min (336 patients; Tominaga et al., Ann. Transl. Med. 2020).

The muscle is the simulator's own. The capsule is a reduced model, because full physics takes about
real time: it moves along the centerline only, without inertia and gravity; the wall presses with
the pressure of `WinklerFoundation` where the lumen is narrower than the capsule; the capsule rests
if the axial part of that pressure is below Coulomb friction, else moves to where it is.

    python -m benchmarks.validation.small_bowel_transit [--size PATIENTS]
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from tests.support.tubes import straight_gut
from vrcaps.anatomy.small_bowel.parameters import SmallBowelParameters
from vrcaps.capsule.device_file import read_device
from vrcaps.core.units import CM, MM
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.motility.motility import Motility
from vrcaps.tissue.motility.muscle import Muscle
from vrcaps.tissue.tissue import Drag, WinklerFoundation

STEP = 0.25
REST = 5.0
LONGEST = 12 * 3600.0
FASTEST = 4.0 * CM
_CANDIDATES = np.linspace(0.0, FASTEST * STEP, 21)
_FINE = np.linspace(0.0, 1.0, 49)


@dataclass(frozen=True)
class Slider:
    """Capsule on the centerline, with positions along its length from the rear [m]."""

    along: np.ndarray
    radius: np.ndarray
    area_slope: np.ndarray

    def forces(self, lumen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axial force and grip [N] for the lumen's radius at each position, `... n`."""
        foundation = WinklerFoundation()
        depth = np.maximum(self.radius - lumen, 0.0)
        fold = foundation.stiffening_depth
        pressure = foundation.stiffness * fold * np.expm1(np.minimum(depth / fold, 5.0))
        spacing = self.along[1] - self.along[0]
        axial = -(pressure * self.area_slope).sum(axis=-1) * spacing
        return axial, (2.0 * np.pi * self.radius * pressure).sum(axis=-1) * spacing


def slider() -> Slider:
    """The capsule's outline: a cylinder with round ends."""
    device = read_device("pillcam-sb3")
    length, r = device.length, device.radius
    along = length * _FINE
    into = np.maximum(r - np.minimum(along, length - along), 0.0)
    radius = np.sqrt(np.maximum(r * r - into * into, 0.0))
    return Slider(along, radius, np.gradient(np.pi * radius**2, along))


def small_bowel() -> tuple[OrganSurface, np.ndarray, np.ndarray]:
    """Straight bowel of mean length: positions [m] and the lumen's radius there [m]."""
    p = SmallBowelParameters()
    rest = p.length - p.duodenum_length
    lengths = {
        "duodenum": p.duodenum_length,
        "jejunum": p.jejunum_fraction * rest,
        "ileum": (1.0 - p.jejunum_fraction) * rest,
    }
    end = lengths["duodenum"] + lengths["jejunum"]
    places = np.array([0.0, lengths["duodenum"], end, end + 0.05, p.length])
    diameters = np.array(
        [
            p.duodenum_diameter,
            p.jejunum_diameter,
            p.jejunum_diameter,
            p.proximal_ileum_diameter,
            p.terminal_ileum_diameter,
        ]
    )
    return straight_gut(lengths, edge=5.0 * MM), places, diameters / 2.0


def transit(muscle: Muscle, capsule: Slider, lumen: np.ndarray) -> float:
    """Time [s] from the duodenum to the ileocaecal valve, `inf` beyond the longest."""
    samples = muscle.layout.arc_length
    spacing, end, length = samples[1], samples[-1] - 1.0 * CM, capsule.along[-1]
    place, time, friction = 5.0 * CM, 0.0, Drag().friction
    while time < LONGEST:
        if place + length / 2.0 > end:
            return time
        if muscle.phase(np.array(place), time) == 1:
            time += REST
            continue
        time += STEP
        first = max(0, int((place - 3.0 * CM) / spacing))
        span = slice(first, min(len(samples), int((place + 3.0 * CM) / spacing) + 2))
        radius = lumen[span] * muscle.lumen_scale(time, span)
        if radius.min() < capsule.radius.max():
            place += shift(capsule, place, samples[span], radius, friction)
    return np.inf


def shift(
    capsule: Slider, place: float, samples: np.ndarray, radius: np.ndarray, friction: float
) -> float:
    """Displacement of the capsule [m], limited by friction."""
    rear = place - capsule.along[-1] / 2.0
    axial, grip = capsule.forces(np.interp(rear + capsule.along, samples, radius))
    if abs(axial) <= friction * grip:
        return 0.0
    ways = np.sign(axial) * _CANDIDATES
    axials, grips = capsule.forces(np.interp(rear + ways[:, None] + capsule.along, samples, radius))
    holds = np.flatnonzero(np.sign(axial) * axials <= friction * grips)
    return float(ways[holds[0]] if len(holds) else ways[-1])


def main() -> None:
    """Measure, and write the table."""
    args = options(__doc__ or "", size=10)
    organ, places, radii = small_bowel()
    capsule = slider()
    minutes = []
    for seed in range(args.size):
        muscle = Muscle(organ, Motility(), np.random.default_rng(seed))
        lumen = np.interp(muscle.layout.arc_length, places, radii)
        minutes.append(transit(muscle, capsule, lumen) / 60.0)
    done = np.array([m for m in minutes if np.isfinite(m)])
    low, middle, high = np.percentile(np.where(np.isfinite(minutes), minutes, 1e4), [25, 50, 75])
    rows = [
        ("median", f"{middle:.0f} min", "198.5 min (O'Grady 2020)"),
        ("quartiles", f"{low:.0f} to {high:.0f} min", "157 to 240.5 min (O'Grady 2020)"),
        ("mean", f"{done.mean():.0f} ± {done.std():.0f} min", "282 ± 132 min (Tominaga 2020)"),
        ("range", f"{done.min():.0f} to {done.max():.0f} min", "none"),
        ("complete within 12 h", f"{len(done)} of {args.size}", "336 of 397 (Tominaga 2020)"),
    ]
    text = f"""## Passive transit of the small bowel

`python -m benchmarks.validation.small_bowel_transit`: {args.size} patients, a bowel of
{organ.centerline.length:g} m, PillCam SB3. The muscle is the simulator's; the capsule is a reduced
model (along the centerline, no inertia, no gravity, wall pressure against Coulomb friction).

{table(("transit time", "simulated", "published"), rows)}"""
    write_section(args.out, Path(__file__), text)


if __name__ == "__main__":
    main()
