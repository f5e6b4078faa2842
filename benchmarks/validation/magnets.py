"""Claim: fields, forces and kinematics of the arm are correct.

Fields against closed forms and magpylib (Ortner and Bandeira, SoftwareX 11, 2020), forces against
published numbers, forward kinematics against pinocchio's model of the Panda, the inverse against
the forward.

    python -m benchmarks.validation.magnets [--size POINTS]
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import magpylib
import numpy as np
import pinocchio
from scipy.spatial.transform import Rotation

from benchmarks.common.scripts import options, table, write_section
from vrcaps.actuation.arm.arm import forward, nearest, read_arm
from vrcaps.core.geometry import transform_from, transform_points
from vrcaps.magnet.field import field, wrench
from vrcaps.magnet.presets import MAGNETS, dipole_distance, magnet_names, read_magnet
from vrcaps.magnet.sources import (
    Coil,
    Cylinder,
    Dipole,
    InternalMagnet,
    Solenoid,
    Source,
    UniformField,
    magnet_pose,
)

# isort: split
from tests.support.flange_paths import loop_of, pose_errors
from tests.support.scenes import random_directions, random_poses, relative

HEAD = ("what", "how many", "measured", "claimed")
PUBLISHED = ((0.10, 6.52, 217), (0.15, 1.29, 64), (0.20, 0.41, 27))
Row = tuple[str, str, str, str]


def verdict(worst: float, limit: float, unit: str = "") -> tuple[str, str]:
    """Last two columns of a row whose value has an upper limit."""
    return f"{worst:.1e}{unit}", f"≤ {limit:g}{unit}: {'yes' if worst <= limit else 'NO'}"


def same_in_magpylib(source: Source) -> magpylib.misc.Dipole:
    """Source of magpylib in its own frame."""
    match source:
        case Cylinder():
            size = (source.diameter, source.length)
            return magpylib.magnet.Cylinder(polarization=(0, 0, source.remanence), dimension=size)
        case Coil():
            current = source.current * source.turns
            return magpylib.current.Circle(current=current, diameter=2 * source.radius)
        case Solenoid():
            sheet = magpylib.mu_0 * source.current * source.turns / source.length
            size = (2 * source.radius, source.length)
            return magpylib.magnet.Cylinder(polarization=(0, 0, sheet), dimension=size)
        case _:
            return magpylib.misc.Dipole(moment=(0, 0, getattr(source, "moment", 1.0)))


def sources() -> dict[str, Source]:
    """One source of each kind, and the named magnets."""
    named: dict[str, Source] = {f"`{name}`": read_magnet(name) for name in magnet_names()}
    named |= {"coil, 100 mm": Coil(0.05, 12.0, 100)}
    return named | {"solenoid, 100 × 80 mm": Solenoid(0.05, 0.08, 10.0, 300)}


def fields(count: int) -> Iterator[Row]:
    """Rows of flux density and gradient."""
    rng = np.random.default_rng(0)
    pose = random_poses(rng, 1)[0]
    spots = random_directions(rng, count) * np.exp(rng.uniform(np.log(0.01), 0, (count, 1)))
    points = transform_points(pose, spots)
    dipole = Dipole(970.1, pose)
    r, moment = points - pose[:3, 3], 970.1 * pose[:3, 2]
    length = np.linalg.norm(r, axis=1, keepdims=True)
    n = r / length
    exact = magpylib.mu_0 / (4 * np.pi) * (3 * (n @ moment)[:, None] * n - moment) / length**3
    number = f"{count:,}"
    worst = relative(field([dipole], points)[0], exact).max()
    yield ("dipole against its closed form, 10 mm to 1 m", number, *verdict(worst, 1e-12))
    for name, source in sources().items():
        size = getattr(source, "length", 0.1)
        near = rng.uniform(-3 * size, 3 * size, (count, 3))
        placed, other = replace(source, T_world_magnet=pose), same_in_magpylib(source)
        other.position, other.orientation = pose[:3, 3], Rotation.from_matrix(pose[:3, :3])
        points = transform_points(pose, near)
        flux, gradient = field([placed], points)
        worst = relative(flux, other.getB(points)).max()
        yield (f"{name} against magpylib, in and around it", number, *verdict(worst, 1e-9))
        size = np.linalg.norm(gradient, axis=(1, 2))
        worst = (np.abs(np.trace(gradient, axis1=1, axis2=2)) / size).max()
        curl = np.linalg.norm(gradient - np.swapaxes(gradient, 1, 2), axis=(1, 2)) / size
        parts = verdict(max(worst, curl.max()), 1e-12)
        yield (f"{name}: div B and curl B over the gradient's size", number, *parts)
    uniform = field([UniformField(0.05, pose)], points)[0]
    worst = np.abs(uniform - 0.05 * pose[:3, 2]).max() / 0.05
    yield ("uniform field against its vector", number, *verdict(worst, 1e-15 * 4))


def gradients(count: int) -> Iterator[Row]:
    """Rows of the gradient against Richardson's extrapolation of central differences."""
    rng = np.random.default_rng(1)
    for name, source in {"dipole": Dipole(970.1), **sources()}.items():
        size = getattr(source, "length", 0.1)
        points = random_directions(rng, count) * rng.uniform(0.9, 4, (count, 1)) * size
        h = 3e-4 * size

        def slope(step: float, axis: np.ndarray, of: Source = source, at: np.ndarray = points):
            up, down = (field([of], at + s * step * axis)[0] for s in (1, -1))
            return (up - down) / (2 * step)

        columns = [(4 * slope(h, e) - slope(2 * h, e)) / 3 for e in np.eye(3)]
        expected = np.stack(columns, axis=-1).reshape(-1, 9)
        worst = relative(field([source], points)[1].reshape(-1, 9), expected)
        parts = verdict(np.quantile(worst, 0.999), 1e-8)
        yield (f"{name}: gradient against differences, 99.9 %", f"{count:,}", *parts)


def forces() -> Iterator[Row]:
    """Rows of forces and torques."""
    for distance, force, torque in PUBLISHED:
        pose = transform_from(np.eye(3), np.array([0, 0, distance]))
        along, across = (InternalMagnet((0, 0, 0), m) for m in ((0, 0, 1.12), (1.12, 0, 0)))
        pull = np.linalg.norm(wrench([Dipole(970.1)], [along], pose)[0])
        turn = 1e3 * np.linalg.norm(wrench([Dipole(970.1)], [across], pose)[1])
        near = abs(pull / force - 1) < 0.01 and abs(turn / torque - 1) < 0.01
        name = f"970.1 and 1.12 A·m², coaxial, {100 * distance:.0f} cm, dipoles"
        claim = f"{force} N, {torque} mN·m within 1 %: {'yes' if near else 'NO'}"
        yield (name, "1", f"{pull:.3f} N, {turn:.1f} mN·m", claim)
        exact = np.linalg.norm(wrench([read_magnet("cylinder-101.6")], [along], pose)[0])
        share = f"{100 * (exact / pull - 1):+.1f} % of the dipole's"
        yield ("the same, the large magnet as its cylinder", "1", f"{exact:.3f} N, {share}", "")
    rng = np.random.default_rng(2)
    worst = 0.0
    for _ in range(1000):
        places, axes = rng.uniform(-0.2, 0.2, (2, 3)), random_directions(rng, 2)
        pair = [
            wrench(
                [Dipole(1.0, magnet_pose(places[i], axes[i]))],
                [InternalMagnet((0, 0, 0), tuple(axes[1 - i]))],
                transform_from(np.eye(3), places[1 - i]),
            )[0]
            for i in (0, 1)
        ]
        worst = max(worst, np.linalg.norm(pair[0] + pair[1]) / np.linalg.norm(pair[0]))
    yield ("force and counterforce of two dipoles", "1,000", *verdict(worst, 1e-9))


def presets() -> Iterator[tuple[str, ...]]:
    """Rows of the magnets by name."""
    for name in magnet_names():
        magnet, preset = read_magnet(name), MAGNETS[name]
        size = f"{1e3 * magnet.diameter:g} × {1e3 * magnet.length:g} mm"
        distance = 1e3 * dipole_distance(magnet)
        moment = f"{magnet.moment:.4g} A·m²"
        yield (
            f"`{name}`",
            size,
            f"{preset.grade}, {preset.remanence} T",
            moment,
            f"{distance:.1f} mm",
        )


def arm(count: int) -> Iterator[Row]:
    """Rows of the Panda."""
    panda, rng = read_arm("panda"), np.random.default_rng(3)
    share = Path(pinocchio.__file__).parents[4] / "share" / "example-robot-data" / "robots"
    file = share / "panda_description" / "urdf" / "panda.urdf"
    model = pinocchio.buildModelFromUrdf(os.fspath(file))
    data, flange = model.createData(), model.getFrameId("panda_link8")
    angles = rng.uniform(panda.lower, panda.upper, (count, 7))
    poses, worst, number = forward(panda, angles), 0.0, f"{count:,}"
    fingers = np.zeros(model.nq - 7)
    for q, pose in zip(angles, poses, strict=True):
        pinocchio.framesForwardKinematics(model, data, np.concatenate([q, fingers]))
        worst = max(worst, np.abs(pose - data.oMf[flange].homogeneous).max())
    yield ("forward kinematics against pinocchio", number, *verdict(worst, 1e-9, " m"))
    begin = time.process_time()
    found = panda.core.inverse(poses, list(angles[:, 6]))
    closed = 1e6 * (time.process_time() - begin) / count
    there = ~np.isnan(found[..., 0])
    pose_of, branch = np.nonzero(there)
    place, turn = pose_errors(panda, found[pose_of, branch], poses[pose_of])
    number = f"{len(pose_of):,} branches"
    yield ("every branch of the inverse lands, place", number, *verdict(place, 1e-9, " m"))
    yield ("every branch of the inverse lands, orientation", number, *verdict(turn, 1e-9, " rad"))
    flat = found[pose_of, branch]
    inside = bool(((flat >= panda.lower) & (flat <= panda.upper)).all())
    yield ("every branch is within the limits", number, str(inside), "yes" if inside else "NO")
    lost = 100 * (~there.any(axis=1)).mean()
    number = f"{count:,} poses"
    yield ("poses with q7 given and no branch", number, *verdict(lost, 0.1, " %"))
    parts = (f"{closed:.2f} µs", f"≤ 20 µs: {'yes' if closed <= 20 else 'NO'}")
    yield ("CPU time of all branches for one q7", number, *parts)
    begin = time.process_time()
    near = nearest(panda, poses, np.array(panda.home))
    search = 1e6 * (time.process_time() - begin) / count
    lost = 100 * np.isnan(near[:, 0]).mean()
    yield ("poses without a solution over all q7", number, *verdict(lost, 0.1, " %"))
    parts = (f"{search:.2f} µs", f"≤ 20 µs: {'yes' if search <= 20 else 'NO'}")
    yield ("CPU time of the nearest over all q7", number, *parts)
    yield from path(panda)


def path(panda) -> Iterator[Row]:
    """Rows of a closed path that the arm follows."""
    poses = loop_of(panda, 1000)
    begin = time.process_time()
    angles = panda.core.follow(poses, np.array(panda.home))
    spent = 1e6 * (time.process_time() - begin) / 1000
    step, bend = (np.abs(np.diff(angles, n=n, axis=0)).max() for n in (1, 2))
    text = f"step {step:.4f} rad, change of step {bend:.1e} rad, {spent:.1f} µs a pose"
    claim = f"no jump: {'yes' if step < 0.02 and bend < 1e-3 else 'NO'}"
    yield ("a closed path: largest step of a joint", "1,000 poses", text, claim)


def main() -> None:
    """Measure, write the tables."""
    given = options(__doc__ or "", size=100_000)
    rows = [*fields(given.size), *gradients(given.size // 10), *forces(), *arm(given.size)]
    head = ("magnet", "size", "grade, remanence", "moment", "dipole within 5 % beyond")
    text = (
        "## Magnets\n\n`python -m benchmarks.validation.magnets`: relative errors, the "
        "maximum unless stated otherwise. magpylib\n"
        f"{magpylib.__version__}, pinocchio {pinocchio.__version__}.\n\n"
        + table(HEAD, rows)
        + "\n\nThe gradient of a source with an axis is constructed such that div B and curl B are "
        "zero; the rows\nthat compare it with differences of the field check it. Distances "
        "below are from the magnet's center,\nover all directions.\n\n"
        + table(head, list(presets()))
    )
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
