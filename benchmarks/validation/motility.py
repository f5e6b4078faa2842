"""Claim: contractions agree with manometry.

Simulates 200 cycles of the migrating motor complex in 20 patients against the published values of
their distributions, counts contractions at positions of the wall, compares the wall's radius with
the commanded wave, and measures how fast a ring carries a capsule.

    python -m benchmarks.validation.motility
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from tests.support.tubes import straight_gut
from vrcaps.capsule.device_file import read_device
from vrcaps.core.units import CM, MM
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.motility.migrating_complex import MINUTE, MigratingMotorComplex
from vrcaps.tissue.motility.motility import Motility
from vrcaps.tissue.motility.muscle import Muscle
from vrcaps.tissue.motility.segment import PER_MINUTE, segment_motilities
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.control import Control
from vrcaps.world.model import Model, State
from vrcaps.world.world import World

LENGTHS = {"antrum": 0.12, "duodenum": 0.25, "jejunum": 1.3, "ileum": 1.95}
PORTS = {
    "antrum": (0.06, 0.11),
    "duodenum": (0.15, 0.35),
    "jejunum": (0.6, 1.5),
    "ileum": (1.8, 3.2),
    "terminal ileum": (3.35, 3.6),
}
"""Two places in each zone [m]."""
HEAD = ("quantity", "place", "measured", "published")
SAMPLE = 5.0
DURATION = 8.0


def main() -> None:
    """Measure, and write the tables."""
    args = options(__doc__ or "", size=20)
    gut = straight_gut(LENGTHS, edge=4.0 * MM)
    muscles = [Muscle(gut, Motility(), np.random.default_rng(k)) for k in range(args.size)]
    clocks = [muscle.clock for muscle in muscles if muscle.clock is not None]
    rows = [*cycle_rows(clocks), *phase_rows(clocks), *speed_rows(clocks)]
    rows += [*count_rows(gut), *physics_rows()]
    text = f"""## Motility

`python -m benchmarks.validation.motility`: {10 * len(clocks)} cycles of the migrating motor complex
in {len(clocks)} patients, read every {SAMPLE:g} s at places of a straight gut of
{gut.centerline.length:g} m; contractions counted where they take half the length of a full one.
Mean ± standard deviation; of speeds and cycle means between patients. Values and sources:
`ComplexStatistics`, `SegmentMotility`. The two studies of cycles differ; patients follow the first.

{table(HEAD, rows)}

The capsule is 10.8 mm thick, the lumen 22 mm wide. Time of a wave: `vrcaps bench world`."""
    write_section(args.out, Path(__file__), text)


def cycle_rows(clocks: list[MigratingMotorComplex]) -> list[tuple[str, ...]]:
    """Lengths of cycles, and origins of their fronts."""
    cycles = [np.diff(clock.starts[:11]) / MINUTE for clock in clocks]
    means, each = [cycle.mean() for cycle in cycles], np.concatenate(cycles)
    spread = np.mean([cycle.std(ddof=1) for cycle in cycles])
    first = np.concatenate([clock.first[:10] for clock in clocks])
    duodenum = LENGTHS["antrum"], LENGTHS["antrum"] + LENGTHS["duodenum"]
    places = (-np.inf, duodenum[0], sum(duodenum) / 2.0, duodenum[1])
    starts = " / ".join(f"{100 * np.mean(np.abs(first - p) < 0.02):.0f}" for p in places[1:])
    return [
        (
            "mean cycle of a patient",
            "",
            f"{min(means):.0f} to {max(means):.0f} min",
            "113 to 230 min (Dooley 1992)",
        ),
        ("deviation within a patient", "", f"{spread:.0f} min", "58 to 70 min (Dooley 1992)"),
        (
            "single cycles",
            "",
            f"{each.min():.0f} to {each.max():.0f} min, mean {each.mean():.0f}",
            "15 to 195 min, mean 97 (Kerlin 1982)",
        ),
        (
            "start of phase III",
            "antrum / proximal / distal duodenum / jejunum",
            f"{100 * np.mean(np.isneginf(first)):.0f} / {starts} %",
            "71 / 18 / 10 / 1 % (Dooley 1992)",
        ),
    ]


def phase_rows(clocks: list[MigratingMotorComplex]) -> list[tuple[str, ...]]:
    """Fractions of the phases by cycle, and duration of phase III."""
    rows = []
    for zone, phase, published in (
        ("antrum", 1, "55 ± 23 % (Dooley 1992)"),
        ("duodenum", 2, "70 to 80 % (Dooley 1992)"),
        ("jejunum", 2, "70 to 80 % (Dooley 1992)"),
        ("ileum", 2, "none"),
    ):
        shares = np.array([phase_shares(clock, PORTS[zone][0]) for clock in clocks])
        share = 100.0 * shares[:, :, phase - 1]
        spread = f"{share.mean():.0f} ± {share.std():.0f} %"
        name = "I" * phase
        rows.append((f"fraction of phase {name} in the cycle", zone, spread, published))
    for zone in ("duodenum", "jejunum"):
        lasts = np.concatenate([third_phases(clock, PORTS[zone][0]) for clock in clocks]) / MINUTE
        spread = f"{lasts.mean():.1f} ± {lasts.std():.1f} min"
        rows.append(("duration of phase III", zone, spread, "5 to 10 min (VR-Caps 2021)"))
    return rows


def phase_shares(clock: MigratingMotorComplex, place: float) -> np.ndarray:
    """Fractions of phases I to IV in each of ten cycles at a position."""
    moment = replace(clock, offset=0.0)
    delay = float(np.interp(place, clock.positions, clock.delays))
    shares = np.empty((10, 4))
    for k, (start, end) in enumerate(zip(clock.starts[:10], clock.starts[1:11], strict=True)):
        at = np.arange(start, end, SAMPLE) + delay
        phase = moment.phase(np.full(at.shape, place), at)[0]
        shares[k] = np.bincount(phase, minlength=5)[1:] / len(phase)
    return shares


def third_phases(clock: MigratingMotorComplex, place: float) -> np.ndarray:
    """Durations [s] of phase III at a position in ten cycles."""
    at = np.arange(0.0, clock.starts[10], SAMPLE)
    third = replace(clock, offset=0.0).phase(np.full(at.shape, place), at)[0] == 3
    edges = np.flatnonzero(np.diff(np.concatenate([[False], third, [False]]).astype(int)))
    return SAMPLE * (edges[1::2] - edges[::2])


def speed_rows(clocks: list[MigratingMotorComplex]) -> list[tuple[str, ...]]:
    """Speeds of the front between two positions, from the arrivals of phase III."""
    published = {
        "duodenum": "8.7 ± 0.9 (Ouyang 1989), up to 11.4",
        "jejunum": "4.7 ± 1.8 (Kerlin 1982)",
        "ileum": "1.3 ± 0.4 (Kerlin 1982)",
        "terminal ileum": "0.9 ± 0.2 (Kerlin 1982)",
    }
    rows = []
    for zone, figure in published.items():
        speeds = [s for clock in clocks if (s := front_speed(clock, *PORTS[zone])) is not None]
        text = f"{np.mean(speeds):.1f} ± {np.std(speeds, ddof=1):.1f} cm/min"
        rows.append(("speed of the front", zone, text, f"{figure} cm/min"))
    return rows


def front_speed(clock: MigratingMotorComplex, oral: float, anal: float) -> float | None:
    """Mean speed [cm/min] of the fronts that pass both positions; None without a front."""
    passes = np.flatnonzero((clock.first <= oral) & (clock.last >= anal))
    arrivals = []
    for cycle in passes[:10]:
        times = []
        for place in (oral, anal):
            about = clock.starts[cycle] + np.interp(place, clock.positions, clock.delays)
            at = about + np.arange(-60.0, 60.0, 0.1)
            phase = replace(clock, offset=0.0).phase(np.full(at.shape, place), at)[0]
            times.append(at[np.argmax(phase == 3)])
        arrivals.append(times[1] - times[0])
    return (anal - oral) / np.mean(arrivals) * MINUTE / CM if arrivals else None


def count_rows(gut: OrganSurface) -> list[tuple[str, ...]]:
    """Contractions per minute in phase III and in other phases."""
    rows = []
    steady = {
        name: replace(segment_motilities()[name], activity=1.0, retrograde=0.0, standing=0.0)
        for name in LENGTHS
    }
    full = Muscle(
        gut, Motility(segments=steady, complex=None, giant=None), np.random.default_rng(0)
    )
    published = {
        "antrum": "1 to 3 (PMC8553224)",
        "duodenum": "11.3 (Ouyang 1989), 12",
        "jejunum": "12.5 to 10.5 (Kerlin 1982)",
        "ileum": "10.9 to 9.3 (Kerlin 1982)",
        "terminal ileum": "10.0 to 8.6 (Kerlin 1982)",
    }
    for zone, figure in published.items():
        counts = [contraction_rate(full, place) for place in PORTS[zone]]
        text = f"{counts[0]:.1f} to {counts[1]:.1f} per min"
        rows.append(("contractions in phase III", zone, text, f"{figure} per min"))
    irregular = Muscle(gut, Motility(complex=None, giant=None), np.random.default_rng(0))
    rate = np.mean([contraction_rate(irregular, p) for p in np.linspace(0.45, 0.6, 6)])
    rows.append(
        ("contractions in phase II", "upper jejunum", f"{rate:.1f} per min", "2.5 (Ahluwalia 1994)")
    )
    colon = straight_gut({"colon": 1.0}, edge=5.0 * MM)
    muscle = Muscle(colon, Motility(giant=None), np.random.default_rng(0))
    rate = np.mean([contraction_rate(muscle, p) for p in np.linspace(0.2, 0.8, 6)])
    rows.append(("contractions", "colon", f"{rate:.1f} per min", "1.4 ± 0.6 per min (PMC8553224)"))
    return rows


def contraction_rate(muscle: Muscle, place: float, minutes: float = 30.0) -> float:
    """Contractions per minute at a position [m]."""
    sample = int(np.argmin(np.abs(muscle.layout.arc_length - place)))
    span = slice(sample, sample + 1)
    depth = np.array(
        [1.0 - muscle.lumen_scale(t, span)[0] for t in np.arange(0, minutes * 60.0, 0.5)]
    )
    half = 0.5 * muscle.layout.parameters[0, sample]
    return np.sum((depth[1:] > half) & (depth[:-1] <= half)) / minutes


def physics_rows() -> list[tuple[str, ...]]:
    """Rows of the wall against the commanded wave, and of a capsule ahead of a ring."""
    ring = replace(
        segment_motilities()["jejunum"],
        rates=(11.4 * PER_MINUTE,) * 2,
        speeds=(1.5 * CM,) * 2,
        activity=1.0,
        retrograde=0.0,
        standing=0.0,
    )
    motility = Motility(segments={"jejunum": ring}, complex=None, giant=None)
    gut = straight_gut({"jejunum": 0.3}, edge=2.5 * MM)
    device = read_device("mirocam")
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    pose[:3, 3] = [0.08, 0.0, -gut.radius[0] + device.radius + 0.2 * MM]
    world = World(
        Model(gut, device, np.eye(4)), Tissue(motility=motility), State(0.0, pose), substep=1e-3
    )
    far = np.flatnonzero(np.abs(gut.arc_length - 0.25) < 1e-9)
    error, places = 0.0, []
    for _ in range(round(DURATION / 0.02)):
        world.step(Control(), 0.02)
        state = world.state
        places.append(state.T_world_capsule[0, 3])
        if state.time < 4.0 and state.vertices_world is not None and world.muscle is not None:
            radius = np.linalg.norm(state.vertices_world[far, 1:], axis=1)
            depth = 1.0 - world.muscle.lumen_scale(state.time)[250]
            wanted = gut.radius[0] * (1.0 - min(1.0, state.time) * depth)
            error = max(error, np.abs(radius - wanted).max())
    speed = (places[-1] - places[-201]) / 4.0
    return [
        ("radius of the wall against the wave", "jejunum", f"{error:.1e} m", "commanded"),
        (
            "speed of a capsule before a ring",
            "jejunum",
            f"{speed / CM:.2f} cm/s",
            "ring: 1.50 cm/s",
        ),
    ]


if __name__ == "__main__":
    main()
