"""Claim: contact forces are correct, energy is lost to friction alone, and no capsule escapes.

Presses spheres and capsules into walls of several meshes and compares with the closed form, lets a
capsule fly, slide and be pulled through a tube, and pushes capsules about in five organs with
random forces of up to 5 N in random posture. Organs from CT are skipped if absent.

    python -m benchmarks.validation.contact [--steps 1000000]
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.integrate import quad

from benchmarks.common.scripts import DATA, parser, table, write_section
from tests.support.walls import HALF_AXIS, LINEAR, RADIUS, capsule, floor, tube, world_on
from vrcaps import _core
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.motility.motility import Motility
from vrcaps.tissue.tissue import Drag, SpringWall, Tissue, WinklerFoundation
from vrcaps.world.control import Control
from vrcaps.world.mechanics import SUBSTEP
from vrcaps.world.model import Model, State, posture_transform
from vrcaps.world.world import World

FREE, STILL, DOWN = (0.0,) * 6, (0.0,) * 3, (0.0, 0.0, -9.81)
EDGES = (4.0, 2.0, 1.0, 0.5)
DEPTHS = (0.02, 0.1, 0.5, 1.0, 2.0)
STRONGEST = 5.0
BLOCK = 400
"""Substeps with one force."""
POSTURES = ("supine", "prone", "left-lateral", "right-lateral", "standing")
HEAD = ("quantity", "measured", "promised")


def main() -> None:
    """Measure, and write the tables."""
    made = parser(__doc__ or "")
    made.add_argument("--steps", type=int, default=1_000_000, help="substeps in all organs")
    args = made.parse_args()
    rows = [*closed_form_rows(), flight_row(), friction_row(), *pull_rows(), *sliding_rows()]
    organs = list(organ_makers())
    walks = [walk(name, make(), args.steps // len(organs)) for name, make in organs]
    text = f"""## Contact

Force and patch of a capsule {2e3 * RADIUS:.0f} mm thick on flat walls of triangles with edges of
{", ".join(f"{edge:g}" for edge in EDGES)} mm, {", ".join(f"{depth:g}" for depth in DEPTHS)} mm
deep, at three positions each: the largest error.

{table(HEAD, rows)}

Random forces of up to {STRONGEST:g} N, new every {1e3 * BLOCK * SUBSTEP:.0f} ms, in postures that
change: {args.steps:,} substeps of {1e6 * SUBSTEP:.0f} µs in all. "Escaped" counts instants, one
after each force, at which the capsule's axis was not in the lumen.

{table(WALK_HEAD, [found.row() for found in walks])}

"""
    write_section(args.out, Path(__file__), text)


def closed_form_rows() -> Iterator[tuple[str, str, str]]:
    """Closed form with u = R − s, by integration over the flat wall."""
    for name, foundation in (("linear", LINEAR), ("stiffening", WinklerFoundation(rate_gain=0.0))):
        for shape, half_axis in (("sphere", 0.0), ("capsule", HALF_AXIS)):
            errors = [
                _press(half_axis, foundation, depth * MM, edge * MM, place)
                for depth in DEPTHS
                for edge in EDGES
                for place in ((0.3, 0.1), (0.9, -0.7), (-1.3, 0.4))
            ]
            force, radius = 100.0 * np.abs(errors).max(axis=0)
            yield f"{shape}, {name} wall: force", f"{force:.1f} %", "3 %"
            yield f"{shape}, {name} wall: radius of the patch", f"{radius:.1f} %", "3 %"


def _press(
    half_axis: float,
    foundation: WinklerFoundation,
    depth: float,
    edge: float,
    place: tuple[float, float],
) -> tuple[float, float]:
    """Relative errors of force and of the root of the area."""
    fold, nearest = foundation.stiffening_depth, RADIUS - depth

    def pressure(s: float) -> float:
        u = RADIUS - s
        return foundation.stiffness * (fold * np.expm1(u / fold) if np.isfinite(fold) else u)

    edge_of_patch = np.sqrt(2.0 * RADIUS * depth - depth**2)
    ends = 2.0 * np.pi * nearest * quad(pressure, nearest, RADIUS)[0]
    across = quad(lambda y: pressure(np.hypot(y, nearest)) / np.hypot(y, nearest), 0, edge_of_patch)
    force = ends + 4.0 * half_axis * nearest * across[0]
    area = np.pi * edge_of_patch**2 + 4.0 * half_axis * edge_of_patch
    world = world_on(
        floor(edge, 50.0 * MM),
        position=(place[0] * MM, place[1] * MM, nearest),
        body=capsule(half_axis),
        foundation=foundation,
    )
    world.step(1e-9, 1, FREE, STILL)
    found = world.contact()
    return found[0][2] / force - 1.0, np.sqrt(found[5] / area) - 1.0


def flight_row() -> tuple[str, str, str]:
    """A tumbling capsule that touches nothing for a second."""
    world = world_on(floor(8 * MM), position=(0, 0, 1.0), velocity=(0.1, 0, 5), spin=(3, -8, 5))
    weight = 3e-3 * 9.81
    before = world.kinetic_energy() + weight * world.pose[0][2]
    world.step(SUBSTEP, 20_000, FREE, DOWN)
    error = (world.kinetic_energy() + weight * world.pose[0][2]) / before - 1.0
    return "free flight of 1 s: change of energy", f"{abs(error):.0e}", "1e-6"


def friction_row() -> tuple[str, str, str]:
    """Energy lost by a capsule that slides, against the work of friction over its way."""
    friction, weight = 0.1, 3e-3 * 9.81
    stiff = WinklerFoundation(youngs_modulus=3e5, stiffening_strain=np.inf)
    world = world_on(
        floor(2 * MM),
        position=(-30 * MM, 0.0, RADIUS - 0.1 * MM),
        wxyz=(np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0),
        foundation=stiff,
        drag=Drag(friction=friction),
    )
    world.step(1e-4, 2_000, FREE, DOWN)  # settles
    world.pose = (*world.pose[:2], (0.2, 0.0, 0.0), STILL)
    world.step(SUBSTEP, 1, FREE, DOWN)

    def energy() -> float:
        return world.kinetic_energy() + weight * world.pose[0][2] + world.contact()[4]

    before, start = energy(), world.pose[0][0]
    world.step(SUBSTEP, 2_000, FREE, DOWN)
    work = friction * weight * (world.pose[0][0] - start)
    error = 100.0 * abs((before - energy()) / work - 1.0)
    return "sliding 17 mm: energy lost over the work of friction", f"{error:.1f} % off", "2 %"


def pull_rows() -> Iterator[tuple[str, str, str]]:
    """The physical law in a narrow tube, against Zhang et al. and Terry et al., see `Drag`."""
    for name, tissue in (("rigid base", Tissue(deformation=None)), ("default tissue", Tissue())):
        law = Drag(law="continuous")
        errors, squeeze = [], []
        for speed in (1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0):
            world = _dragged(tissue, speed * MM)
            errors.append(-world.contact()[0][2] / law.resistance(np.array(speed * MM)) - 1.0)
            squeeze.append(world.contact()[2] / 2.6)
        worst = 100.0 * np.abs(errors).max()
        drag = f"{name}: drag in a tube 8.4 mm wide, 1 to 60 mm/s, from the measured curve"
        yield drag, f"{worst:.1f} %", "10 %"
        shown = f"{min(squeeze):.1f} to {max(squeeze):.1f} N/cm"
        yield f"{name}: squeeze in that tube", shown, "1.9 ± 1.0 N/cm"


def sliding_rows() -> Iterator[tuple[str, str, str]]:
    """A capsule of 3 g in that tube on a rigid base, pulled below and above its limit."""
    law = Drag(law="continuous")
    limit = 0.018 * _gripped(Tissue(deformation=None), mass=3e-3, settle=0.02).contact()[2]
    for substep in (SUBSTEP, 4.0 * SUBSTEP, 20.0 * SUBSTEP):
        found = {}
        for pull in (0.6 * limit, 0.94 * limit, *law.resistance(np.array([8.0, 20.0, 65.0]) * MM)):
            world = _gripped(Tissue(deformation=None), mass=3e-3, settle=0.02)
            count = round(0.05 / substep)
            for _ in range(2):
                before = world.pose[0][2]
                world.step(substep, count, (0.0, 0.0, float(pull), 0.0, 0.0, 0.0), STILL)
            found[float(pull)] = (world.pose[0][2] - before) / (count * substep)
        below, above = list(found.items())[:2], list(found.items())[2:]
        name = f"3 g, substep {1e6 * substep:.0f} µs"
        creep = max(speed for _, speed in below) / MM
        yield f"{name}: creep at 0.6 and 0.94 of the limit", f"{creep:.4f} mm/s", "0.01 mm/s"
        off = [pull / law.resistance(np.array(speed)) - 1.0 for pull, speed in above]
        shown = f"{100.0 * min(off):+.1f} to {100.0 * max(off):+.1f} %"
        yield f"{name}: drag at 8 to 65 mm/s, from the measured curve", shown, "10 %"


def _dragged(tissue: Tissue, speed: float) -> _core.World:
    """Heavy capsule moved along the tube at a speed [m/s] until its drag is steady."""
    if tissue.deformation is None:
        world = _gripped(tissue, speed)
        world.step(1e-5, 100, FREE, STILL)
        return world
    world, substep = _gripped(tissue, settle=0.2), 4.0 * SUBSTEP
    place, wxyz, _, still = world.pose
    world.pose = (place, wxyz, (0.0, 0.0, speed), still)
    for way in (4.0 * MM, 1.0 * MM):
        world.step(substep, round(way / speed / substep), FREE, STILL)
    return world


def _gripped(
    tissue: Tissue, speed: float = 0.0, mass: float = 1e6, settle: float = 0.0
) -> _core.World:
    """Capsule 26 mm long in a tube 8.4 mm wide, moved along it at a speed [m/s]."""
    deformation = tissue.deformation
    world = world_on(
        tube(4.2 * MM, 120.0 * MM, 1.0 * MM),
        position=(0, 0, 50 * MM),
        wxyz=(1, 0, 0, 0),
        velocity=(0, 0, speed),
        body=capsule(mass=mass),
        foundation=tissue.foundation_in_series,
        drag=tissue.drag,
        spring_wall=deformation if isinstance(deformation, SpringWall) else None,
    )
    world.step(4.0 * SUBSTEP, round(settle / (4.0 * SUBSTEP)), FREE, STILL)
    return world


WALK_HEAD = (
    "organ",
    "triangles",
    "substeps",
    "escaped",
    "not finite",
    "maximum depth",
    "maximum speed",
)


@dataclass
class Walk:
    """Events in one organ."""

    name: str
    triangles: int
    substeps: int = 0
    escaped: int = 0
    broken: int = 0
    depths: list[float] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)

    def row(self) -> tuple[str, ...]:
        """A line of the table."""
        return (
            self.name,
            f"{self.triangles:,}",
            f"{self.substeps:,}",
            str(self.escaped),
            str(self.broken),
            f"{1e3 * max(self.depths):.1f} mm",
            f"{max(self.speeds):.1f} m/s",
        )


def organ_makers() -> Iterator[tuple[str, Callable[[], OrganSurface]]]:
    """Five organs: three generated ones with active muscle, and two from CT."""
    for name in ("colon", "stomach", "small-bowel"):
        yield f"{name}, muscle at work", lambda name=name: generate_organ(name, seed=0)
    for name in ("colon_GI1_mm", "stomach_A_mm"):
        path = DATA / f"{name}.ply"
        if path.exists():
            yield f"{name}, from CT", lambda path=path: read_organ(path, unit="mm")


def walk(name: str, organ: OrganSurface, num_steps: int) -> Walk:
    """Push a capsule at random; a capsule that has escaped is placed again."""
    rng = np.random.default_rng(len(organ.faces))
    tissue = Tissue(motility=Motility() if "muscle" in name else None)
    found, world = Walk(name, len(organ.faces)), _start(organ, tissue)
    for block in range(num_steps // BLOCK):
        push = rng.normal(size=3)
        control = Control(
            force_world=push * (rng.uniform(0.0, STRONGEST) / np.linalg.norm(push)),
            T_world_patient=posture_transform(rng.choice(POSTURES)) if block % 10 == 0 else None,
        )
        found.substeps += BLOCK
        try:
            world.step(control, BLOCK * SUBSTEP)
        except InputError:
            found.broken += 1
            world = _start(organ, tissue)
            continue
        contact = world.state.contact
        found.depths.append(0.0 if contact is None else contact.depth)
        found.speeds.append(float(np.linalg.norm(world.state.linear_velocity_world)))
        if not world.is_inside():
            found.escaped += 1
            world = _start(organ, tissue)
    return found


def _start(organ: OrganSurface, tissue: Tissue) -> World:
    """World with the capsule at the widest position of the lumen."""
    model, line = Model(organ, read_device("mirocam")), organ.centerline
    widest, pose = int(np.argmax(line.radius)), np.eye(4)
    pose[:3, :3], pose[:3, 3] = line.frames[widest], line.points[widest]
    return World(model, tissue, State(0.0, model.T_world_patient @ pose))


if __name__ == "__main__":
    main()
