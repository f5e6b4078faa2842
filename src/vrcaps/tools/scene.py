"""Scene of an episode at a frame, as MJCF for MuJoCo or USD: wall, capsule, magnet and arm.

The frame of both files is the world, z up, in meters. MJCF: mujoco.readthedocs.io, XML reference.
USD: openusd.org, schemas UsdGeom and UsdPhysics.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from vrcaps.actuation.arm.arm import Arm, frames, read_arm
from vrcaps.actuation.arm.arm_with_payload import transverse_mount
from vrcaps.actuation.arm.chain import LinkMass
from vrcaps.actuation.steering_program import base_beside
from vrcaps.capsule.device import Body, homogeneous_body
from vrcaps.core.errors import InputError, import_extra, require
from vrcaps.core.files import scratch_folder, write_bytes
from vrcaps.core.geometry import invert, quaternion_from_matrix
from vrcaps.magnet.magnets import Magnet, magnet_mesh
from vrcaps.magnet.presets import read_magnet
from vrcaps.mesh.mesh import Mesh
from vrcaps.motion.dynamics import Dynamics
from vrcaps.world.control import GRAVITY

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.recording.episode import Episode

LINK_DENSITY = 1000.0
"""Density of the collision capsules of links whose mass an arm does not state [kg/m³], an
assumption."""
_MIN_MASS = 0.1
_WALL_COLOR, _CAPSULE_COLOR, _MAGNET_COLOR, _LINK_COLOR = (
    (0.86, 0.55, 0.5, 0.35),
    (0.95, 0.95, 0.95, 1.0),
    (0.82, 0.24, 0.2, 1.0),
    (0.7, 0.72, 0.75, 1.0),
)


@dataclass(frozen=True)
class PosedArm:
    """An arm at joint angles.

    Attributes:
        arm: The arm.
        T_world_base: Pose of its base.
        angles: Joint angles [rad].
    """

    arm: Arm
    T_world_base: Float[np.ndarray, "4 4"]
    angles: Float[np.ndarray, " j"]

    def masses(self) -> dict[int, LinkMass]:
        """Masses by frame: those that the arm states, for other joints see `LINK_DENSITY`."""
        sums = dict.fromkeys(range(1, self.arm.num_joints + 1), 0.0)
        for link in self.arm.links:
            length = math.dist(link.start, link.end)
            volume = math.pi * link.radius**2 * (length + 4.0 / 3.0 * link.radius)
            if link.frame in sums:
                sums[link.frame] += LINK_DENSITY * volume
        assumed = {k: LinkMass(k, max(mass, _MIN_MASS)) for k, mass in sums.items()}
        return assumed | {each.frame: each for each in self.arm.masses}


@dataclass(frozen=True)
class Scene:
    """Poses, shapes and masses at one instant, in the world frame.

    Attributes:
        wall: The wall [m].
        T_world_capsule: Pose of the capsule.
        capsule: Its mass and shape.
        magnet: The external magnet at its pose; None for none.
        arm: The arm that holds it; None for none.
    """

    wall: Mesh
    T_world_capsule: Float[np.ndarray, "4 4"]
    capsule: Body
    magnet: Magnet | None = None
    arm: PosedArm | None = None


def scene_of(episode: Episode, frame: int = 0) -> Scene:
    """Scene of an episode at a frame; the wall is at rest if walls were not recorded.

    Raises:
        InputError: If there is no such frame, or the organ is missing.
    """
    count = len(episode)
    require(0 <= frame < count, "frame", frame, f"0 to {count - 1}")
    wall = episode.wall(frame) if "wall" in episode.head else episode.organ
    body = homogeneous_body(episode.scenario.device)
    pose = episode.Ts_world_capsule[frame]
    motion = episode.scenario.motion
    if not isinstance(motion, Dynamics) or motion.magnet is None:
        return Scene(wall, pose, body)
    steering = motion.magnet
    magnet = read_magnet(steering.magnet, episode.table.poses("magnet")[frame])
    if steering.arm is None:
        return Scene(wall, pose, body, magnet)
    arm, base = read_arm(steering.arm), np.eye(4)
    given = steering.arm_base
    base[:3, 3] = base_beside(episode.organ.vertices) if given is None else given
    names = [f"joint_{k}_rad" for k in range(1, arm.num_joints + 1)]
    angles = np.array([episode.table.columns[name][frame] for name in names], float)
    return Scene(wall, pose, body, magnet, PosedArm(arm, base, angles))


def write_scene(scene: Scene, path: str | Path) -> Path:
    """Write a scene as MJCF (.xml, with wall and magnet as OBJ next to it) or USD (.usda, .usdc).

    In MJCF the capsule has a free joint, the joints of the arm are hinges at the recorded angles in
    the keyframe `recorded`, and the magnet is fixed to the flange or, without an arm, a mocap body.
    The wall is visual: MuJoCo would replace it by its convex hull. A missing folder is created.

    Raises:
        InputError: If the suffix is unknown or the file cannot be written.
        MissingExtraError: If usd-core is not installed.
    """
    path = Path(path)
    writers: dict[str, Callable[[Scene, Path], None]] = {
        ".xml": _write_mjcf,
        **dict.fromkeys((".usda", ".usd", ".usdc"), _write_usd),
    }
    if path.suffix not in writers:
        raise InputError(f"{path}: unknown kind of scene. Allowed: {', '.join(writers)}.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        writers[path.suffix](scene, path)
    except OSError as error:
        raise InputError(f"Cannot write {path}: {error.strerror}.") from error
    return path


def _text(values: Any) -> str:
    return " ".join(f"{value:.17g}" for value in np.asarray(values, float).ravel())


def _add(parent: Any, tag: str, **attributes: Any) -> Any:
    """Add an element; numbers are written with all their digits."""
    plain = {
        name: value if isinstance(value, str) else _text(value)
        for name, value in attributes.items()
    }
    return ElementTree.SubElement(parent, tag, plain)


def _place(pose: Float[np.ndarray, "4 4"]) -> dict[str, Any]:
    return {"pos": pose[:3, 3], "quat": quaternion_from_matrix(pose[:3, :3])}


def _write_mjcf(scene: Scene, path: Path) -> None:
    root = ElementTree.Element("mujoco", model=path.stem)
    _add(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    _add(root, "option", gravity=(0.0, 0.0, -GRAVITY))
    assets, world = _add(root, "asset"), _add(root, "worldbody")
    _add(world, "light", pos=(0.0, 0.0, 2.0))
    seen = {"contype": "0", "conaffinity": "0"}
    name = f"{path.stem}-wall.obj"
    _write_obj(path.with_name(name), scene.wall.vertices, scene.wall.faces)
    _add(assets, "mesh", name="wall", file=name, inertia="shell")
    # MuJoCo moves a mesh to its center of mass; the geom's pose accounts for it.
    _add(world, "geom", name="wall", type="mesh", mesh="wall", rgba=_WALL_COLOR, **seen)
    body, shape = (
        _add(world, "body", name="capsule", **_place(scene.T_world_capsule)),
        scene.capsule,
    )
    _add(body, "freejoint", name="capsule")
    _add_inertia(body, shape.mass, shape.inertia)
    size = (shape.radius, max(shape.half_axis, 1e-6))
    _add(body, "geom", name="capsule", type="capsule", size=size, rgba=_CAPSULE_COLOR)
    holder: Any = world
    if scene.arm is not None:
        holder = _add_arm(world, scene.arm)
        angles = np.concatenate([_free_position(scene.T_world_capsule), scene.arm.angles])
        _add(_add(root, "keyframe"), "key", name="recorded", qpos=angles)
    if scene.magnet is not None:
        name, mesh = f"{path.stem}-magnet.obj", magnet_mesh(scene.magnet)
        _write_obj(path.with_name(name), np.asarray(mesh.vertices), np.asarray(mesh.faces))
        _add(assets, "mesh", name="magnet", file=name)
        pose = np.asarray(scene.magnet.T_world_magnet, float)
        extra: dict[str, Any] = {"mocap": "true"}
        if scene.arm is not None:
            extra, pose = {}, transverse_mount(scene.magnet)
        magnet = _add(holder, "body", name="magnet", **_place(pose), **extra)
        _add_inertia(magnet, scene.magnet.mass, _magnet_inertia(scene.magnet, mesh))
        _add(magnet, "geom", name="magnet", type="mesh", mesh="magnet", rgba=_MAGNET_COLOR, **seen)
    ElementTree.indent(root)
    write_bytes(path, ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _free_position(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " 7"]:
    return np.concatenate([pose[:3, 3], quaternion_from_matrix(pose[:3, :3])])


def _magnet_inertia(magnet: Magnet, mesh: Any) -> Float[np.ndarray, "3 3"]:
    """Inertia of a magnet of a shape about its center, in its own, principal axes [kg·m²]."""
    return magnet.mass * np.diag(np.diag(mesh.moment_inertia / mesh.mass))


def _add_inertia(
    body: Any, mass: float, tensor: Float[np.ndarray, "3 3"], center: Any = (0.0, 0.0, 0.0)
) -> None:
    rows = (*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2])
    _add(body, "inertial", pos=center, mass=mass, fullinertia=rows)


def _add_arm(world: Any, posed: PosedArm) -> Any:
    """Add the links of an arm at angle 0; return the flange's body."""
    arm, masses = posed.arm, posed.masses()
    zero = frames(arm, np.zeros(arm.num_joints))
    names = ["base", *(f"link_{k}" for k in range(1, arm.num_joints + 1)), "flange"]
    holder, before = world, np.eye(4)
    for k, (name, pose) in enumerate(zip(names, [np.eye(4), *zero], strict=True)):
        place = posed.T_world_base if k == 0 else invert(before) @ pose
        holder = _add(holder, "body", name=name, **_place(place))
        if 0 < k <= arm.num_joints:
            limits = (arm.joints[k - 1].lower, arm.joints[k - 1].upper)
            _add(holder, "joint", name=f"joint_{k}", type="hinge", axis=(0, 0, 1), range=limits)
        if k in masses:
            _add_inertia(holder, masses[k].mass, masses[k].tensor, masses[k].center)
        _add_links(holder, arm, k)
        before = pose
    return holder


def _add_links(body: Any, arm: Arm, frame: int) -> None:
    for link in (link for link in arm.links if link.frame == frame):
        ends = (*link.start, *link.end)
        seen: dict[str, Any] = {"contype": "0", "conaffinity": "0", "rgba": _LINK_COLOR}
        if math.dist(link.start, link.end) < 1e-6:
            _add(body, "geom", type="sphere", size=(link.radius,), pos=link.start, **seen)
        else:
            _add(body, "geom", type="capsule", size=(link.radius,), fromto=ends, **seen)


def _write_obj(path: Path, vertices: Float[np.ndarray, "n 3"], faces: np.ndarray) -> None:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (np.asarray(faces) + 1).tolist()]
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _write_usd(scene: Scene, path: Path) -> None:
    pxr = {name: import_extra(f"pxr.{name}", "robots", package="usd-core") for name in _MODULES}
    with scratch_folder() as folder:  # a complete file replaces that of the path
        file = folder / f"scene{path.suffix}"
        _fill_stage(pxr, pxr["Usd"].Stage.CreateNew(str(file)), scene)
        write_bytes(path, file.read_bytes())


def _fill_stage(pxr: dict[str, Any], stage: Any, scene: Scene) -> None:
    geom, physics = pxr["UsdGeom"], pxr["UsdPhysics"]
    geom.SetStageUpAxis(stage, geom.Tokens.z)
    geom.SetStageMetersPerUnit(stage, 1.0)
    physics.SetStageKilogramsPerUnit(stage, 1.0)
    root = geom.Xform.Define(stage, "/scene")
    stage.SetDefaultPrim(root.GetPrim())
    gravity = physics.Scene.Define(stage, "/scene/physics")
    gravity.CreateGravityDirectionAttr((0.0, 0.0, -1.0))
    gravity.CreateGravityMagnitudeAttr(GRAVITY)
    _add_mesh(pxr, stage, "/scene/wall", scene.wall.vertices, scene.wall.faces, _WALL_COLOR)
    body, pose = scene.capsule, scene.T_world_capsule
    mass = (body.mass, body.inertia, (0.0, 0.0, 0.0))
    prim = _add_body(pxr, stage, "/scene/capsule", pose, mass)
    physics.RigidBodyAPI.Apply(prim)
    _add_capsule(pxr, stage, "/scene/capsule/shell", 2.0 * body.half_axis, body.radius)
    if scene.magnet is not None:
        mesh = magnet_mesh(scene.magnet)
        pose = np.asarray(scene.magnet.T_world_magnet, float)
        mass = (scene.magnet.mass, _magnet_inertia(scene.magnet, mesh), (0.0, 0.0, 0.0))
        _add_body(pxr, stage, "/scene/magnet", pose, mass)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        _add_mesh(pxr, stage, "/scene/magnet/body", vertices, faces, _MAGNET_COLOR)
    if scene.arm is not None:
        _add_usd_arm(pxr, stage, scene.arm)
    stage.GetRootLayer().Save()


_MODULES = ("Gf", "Usd", "UsdGeom", "UsdPhysics", "Vt")


def _add_usd_arm(pxr: dict[str, Any], stage: Any, posed: PosedArm) -> None:
    arm = posed.arm
    poses = [posed.T_world_base, *(posed.T_world_base @ frames(arm, posed.angles))]
    masses = posed.masses()
    names = ["base", *(f"link_{k}" for k in range(1, arm.num_joints + 1)), "flange"]
    for frame, (name, pose) in enumerate(zip(names, poses, strict=True)):
        own = masses.get(frame)
        mass = None if own is None else (own.mass, own.tensor, own.center)
        _add_body(pxr, stage, f"/scene/{name}", pose, mass)
        for k, link in enumerate(one for one in arm.links if one.frame == frame):
            start, end = np.array(link.start), np.array(link.end)
            at = np.eye(4)
            at[:3, 3] = 0.5 * (start + end)
            length = float(np.linalg.norm(end - start))
            if length > 1e-9:
                from vrcaps.magnet.pose import magnet_pose

                at = magnet_pose(at[:3, 3], end - start)
            shape = _add_capsule(pxr, stage, f"/scene/{name}/part_{k}", length, link.radius)
            shape.AddTransformOp().Set(pxr["Gf"].Matrix4d(at.T.tolist()))


def _add_body(
    pxr: dict[str, Any],
    stage: Any,
    path: str,
    pose: Float[np.ndarray, "4 4"],
    mass: tuple[float, np.ndarray, tuple[float, float, float]] | None,
) -> Any:
    """Add a body; its mass [kg], inertia [3 3] about its center, and center are in its frame."""
    xform = pxr["UsdGeom"].Xform.Define(stage, path)
    xform.AddTransformOp().Set(pxr["Gf"].Matrix4d(pose.T.tolist()))
    if mass is not None:
        kilograms, tensor, center = mass
        moments, axes = np.linalg.eigh(tensor)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        w, x, y, z = map(float, quaternion_from_matrix(axes))
        mass_api = pxr["UsdPhysics"].MassAPI.Apply(xform.GetPrim())
        mass_api.CreateMassAttr(float(kilograms))
        mass_api.CreateCenterOfMassAttr(tuple(map(float, center)))
        mass_api.CreateDiagonalInertiaAttr(tuple(map(float, moments)))
        mass_api.CreatePrincipalAxesAttr(pxr["Gf"].Quatf(w, x, y, z))
    return xform.GetPrim()


def _add_capsule(pxr: dict[str, Any], stage: Any, path: str, length: float, radius: float) -> Any:
    shape = pxr["UsdGeom"].Capsule.Define(stage, path)
    shape.CreateAxisAttr("Z")
    shape.CreateHeightAttr(float(length))
    shape.CreateRadiusAttr(float(radius))
    return shape


def _add_mesh(
    pxr: dict[str, Any],
    stage: Any,
    path: str,
    vertices: Float[np.ndarray, "n 3"],
    faces: np.ndarray,
    color: tuple[float, ...],
) -> None:
    mesh, vt = pxr["UsdGeom"].Mesh.Define(stage, path), pxr["Vt"]
    mesh.CreatePointsAttr(vt.Vec3fArray.FromNumpy(np.ascontiguousarray(vertices, np.float32)))
    counts = np.full(len(faces), 3, np.int32)
    mesh.CreateFaceVertexCountsAttr(vt.IntArray.FromNumpy(counts))
    indices = np.ascontiguousarray(faces, np.int32).ravel()
    mesh.CreateFaceVertexIndicesAttr(vt.IntArray.FromNumpy(indices))
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreateDisplayColorAttr([color[:3]])
    mesh.CreateDisplayOpacityAttr([color[3]])
