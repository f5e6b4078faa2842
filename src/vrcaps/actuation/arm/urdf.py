"""Robot arms from URDF files, through yourdfpy: joints, limits, tool frame, collision shapes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from xml.etree import ElementTree

import numpy as np

from vrcaps.actuation.arm.chain import Arm, Joint, Link, LinkMass
from vrcaps.core.errors import InputError, import_extra, reading, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import transform_points
from vrcaps.core.names import inside
from vrcaps.magnet.pose import magnet_pose

if TYPE_CHECKING:
    from jaxtyping import Float

_MAX_BYTES = 2**25
"""Maximum size of a URDF [byte]."""
_MAX_MESH_BYTES = 2**28
_MAX_JOINTS = 32
_MAX_NUMBER = 1e5
"""Maximum mass [kg], moment of inertia [kg·m²] and coordinate [m] of a link."""
_PARENTS = 6
"""Number of folders above a URDF that are searched for the packages of its meshes."""
_WHOLE_TURNS = 2.0 * math.pi
_FIXED, _TURNING = "fixed", ("revolute", "continuous")


@dataclass(frozen=True)
class UrdfArm:
    """An arm from a URDF file, and what such a file does not state.

    Attributes:
        urdf: Path of the URDF file.
        base: Link that is the base; empty is the root.
        tool: Link that is the flange; empty is the only one with the most joints before it.
        home: Home angles [rad]; empty is 0, or the limit next to it.
        payload: Maximum payload [kg]; inf if unknown.
        acceleration: Limit of the acceleration of every joint [rad/s²], an assumption.
        jerk: Limit of the jerk of every joint [rad/s³], an assumption.
        meshes: Folder of the packages of `package://` meshes; empty searches the folders above the
            file.
        collision: Whether collision capsules are made from the collision shapes of the links.
        masses: Whether masses are read from the inertial elements of the links.
    """

    urdf: str
    base: str = ""
    tool: str = ""
    home: tuple[float, ...] = field(default=(), metadata={"unit": "deg"})
    payload: float = field(default=math.inf, metadata={"unit": "kg"})
    acceleration: Annotated[float, Range(above=0.0, below=math.inf)] = field(
        default=10.0, metadata={"unit": "rad_per_s2"}
    )
    jerk: Annotated[float, Range(above=0.0, below=math.inf)] = field(
        default=1000.0, metadata={"unit": "rad_per_s3"}
    )
    meshes: str = ""
    collision: bool = True
    masses: bool = True

    def __post_init__(self) -> None:
        check_fields(self)


def arm_from_urdf(settings: UrdfArm, *, name: str) -> Arm:
    """Convert the chain of revolute joints from base to tool to an arm.

    Frame k of the arm has its origin in that of the URDF's joint k, and z along its axis. The
    collision shapes of a link become one capsule that holds them. Masses are those of the
    <inertial> elements of the links from base to tool; other branches do not count.

    Raises:
        InputError: If the file is not a URDF, has closed loops, the chain contains other joints
            than revolute, continuous and fixed ones, a limit or mesh is missing, a link is unknown,
            or an inertia is impossible.
        MissingExtraError: If yourdfpy is not installed.
    """
    path = Path(settings.urdf)
    robot = _robot(path)
    chain = _chain(path, robot, settings)
    joints, offsets, after = _joints(path, chain, settings)
    count = len(joints)
    require(0 < count <= _MAX_JOINTS, f"{path}: number of joints", count, f"1 to {_MAX_JOINTS}")
    if settings.home and len(settings.home) != count:
        raise InputError(
            f"{path.name}: home has {len(settings.home)} angles. Allowed: {count}, one for each "
            f"joint: {', '.join(j.name for j in chain if j.type in _TURNING)}."
        )
    home = settings.home or tuple(min(max(0.0, j.lower), j.upper) for j in joints)
    links = tuple(_capsules(path, robot, offsets, settings)) if settings.collision else ()
    rotation: Any = tuple(map(tuple, after[:3, :3].tolist()))
    arm = Arm(
        name=name,
        title=str(robot.name or name),
        joints=joints,
        flange_offset=(float(after[0, 3]), float(after[1, 3]), float(after[2, 3])),
        home=home,
        payload=settings.payload,
        links=links,
        source=f"URDF {path.name}",
        flange_rotation=rotation,
        masses=_masses(path, robot, offsets) if settings.masses else (),
    )
    return _with_pairs(arm)


def _robot(path: Path) -> Any:
    yourdfpy = import_extra("yourdfpy", "robots")
    try:
        size = path.stat().st_size
    except OSError as error:
        raise InputError(f"Cannot read the URDF file {path}: {error.strerror}.") from error
    require(size <= _MAX_BYTES, f"size of {path}", f"{size} byte", f"up to {_MAX_BYTES}")
    with reading(f"the URDF file {path}"):
        data = path.read_bytes()  # yourdfpy would repair what is not XML, and expand entities
        if ElementTree.fromstring(data, ElementTree.XMLParser(target=_Plain())).tag != "robot":
            raise InputError(
                f"{path} is not a URDF file. Allowed: the element <robot>, without DOCTYPE."
            )
        robot = yourdfpy.URDF.load(str(path), build_scene_graph=False, load_meshes=False).robot
    if not robot.links:
        raise InputError(f"{path} contains no links. Give a URDF file of a robot.")
    return robot


class _Plain(ElementTree.TreeBuilder):
    """Elements of a file without DOCTYPE, in any encoding."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Reject definitions of entities before any is expanded."""
        raise ValueError("it is not a URDF file. Allowed: the element <robot>, without DOCTYPE")


def _chain(path: Path, robot: Any, settings: UrdfArm) -> list[Any]:
    """Joints from base to tool.

    Raises:
        InputError: If there is no single such chain.
    """
    links = {link.name for link in robot.links}
    parents: dict[str, Any] = {}
    for joint in robot.joints:
        if not {joint.parent, joint.child} <= links:
            raise InputError(f"{path}: joint {joint.name} connects a link that does not exist.")
        if joint.child in parents:
            raise InputError(
                f"{path}: link {joint.child} is the child of the joints "
                f"{parents[joint.child].name} and {joint.name}, a closed loop. Allowed: a tree."
            )
        parents[joint.child] = joint
    for name in (settings.base, settings.tool):
        if name and name not in links:
            raise InputError(f"{path}: no link {name!r}. Known: {', '.join(sorted(links))}.")
    base = settings.base or next((n for n in sorted(links) if n not in parents), "")
    chains = {name: _joints_to(path, parents, name) for name in sorted(links)}
    tool = settings.tool or _only_tool(path, chains)
    chain = chains[tool]
    starts = [joint.parent for joint in chain]
    if base not in starts:
        raise InputError(f"{path}: no joints lead from base {base!r} to tool {tool!r}.")
    return chain[starts.index(base) :]


def _joints_to(path: Path, parents: dict[str, Any], name: str) -> list[Any]:
    """Joints from the root to a link."""
    chain: list[Any] = []
    while name in parents:
        chain.insert(0, parents[name])
        name = parents[name].parent
        if len(chain) > len(parents):
            raise InputError(f"{path}: joint {parents[name].name} is in a closed loop.")
    return chain


def _only_tool(path: Path, chains: dict[str, list[Any]]) -> str:
    """Link with the most revolute joints before it, farthest from the root."""
    leaves = set(chains) - {joint.parent for chain in chains.values() for joint in chain}
    counts = {n: sum(j.type != _FIXED for j in chains[n]) for n in leaves}
    most = max(counts.values())
    ends = sorted(name for name, count in counts.items() if count == most)
    if len(ends) > 1:
        raise InputError(
            f"{path} has several ends: {', '.join(ends)}. State the one that holds the magnet as "
            "tool in a TOML file with urdf and tool."
        )
    return ends[0]


_Offsets = dict[str, tuple[int, np.ndarray]]
"""Frame of the arm to which each link is fixed, and the link's pose in it."""


def _joints(
    path: Path, chain: list[Any], settings: UrdfArm
) -> tuple[tuple[Joint, ...], _Offsets, Float[np.ndarray, "4 4"]]:
    """Joints, offsets of the links on the chain, and the pose of the tool in the last frame."""
    joints: list[Joint] = []
    pose = np.eye(4)
    offsets: _Offsets = {chain[0].parent: (0, pose)}
    for joint in chain:
        if joint.origin is not None:
            pose = pose @ np.asarray(joint.origin, float)
        if joint.type != _FIXED:
            axis = np.array([1.0, 0.0, 0.0] if joint.axis is None else joint.axis, float)
            if joint.type not in _TURNING or joint.mimic is not None:
                kind = "mimic" if joint.mimic is not None else joint.type
                raise InputError(
                    f"{path}: joint {joint.name} is {kind}. Allowed between base and tool: "
                    "revolute, continuous, fixed."
                )
            turn = magnet_pose(np.zeros(3), axis)  # from z to the axis
            joints.append(_joint(path, joint, pose @ turn, settings))
            pose = turn.T
        offsets[joint.child] = (len(joints), pose)
    return tuple(joints), offsets, pose


def _joint(path: Path, joint: Any, placement: Float[np.ndarray, "4 4"], settings: UrdfArm) -> Joint:
    names = ("lower", "upper", "velocity", "effort")
    values = {name: getattr(joint.limit, name, None) for name in names}
    if joint.type == "continuous":
        values |= {"lower": -_WHOLE_TURNS, "upper": _WHOLE_TURNS}
    missing = [name for name in names[:3] if values[name] is None]
    if missing or not values["velocity"]:
        raise InputError(
            f"{path}: joint {joint.name} has no limit of {' and '.join(missing or ['velocity'])}. "
            "Add <limit> with lower, upper and velocity above 0."
        )
    low, high, velocity, effort = (float(values[name] or 0.0) for name in names)
    rows: Any = tuple(map(tuple, placement[:3].tolist()))
    motion = (low, high, velocity, settings.acceleration, settings.jerk, effort or math.inf)
    try:
        return Joint(0.0, 0.0, 0.0, 0.0, *motion, placement=rows)
    except InputError as error:
        raise InputError(f"{path}: joint {joint.name}: {error}") from error


def _capsules(path: Path, robot: Any, offsets: _Offsets, settings: UrdfArm) -> Iterator[Link]:
    """One capsule around the collision shapes of each link of the chain."""
    points: dict[int, list[np.ndarray]] = {}
    for link in robot.links:
        if link.name not in offsets:
            continue
        frame, pose = offsets[link.name]
        for shape in link.collisions:
            own = np.eye(4) if shape.origin is None else np.asarray(shape.origin, float)
            vertices = _vertices(path, link.name, shape.geometry, settings)
            points.setdefault(frame, []).append(transform_points(pose @ own, vertices))
    for frame, parts in sorted(points.items()):
        yield capsule_around(np.concatenate(parts), frame)


def _masses(path: Path, robot: Any, offsets: _Offsets) -> tuple[LinkMass, ...]:
    """Mass of the links that are fixed to each frame, where stated."""
    parts: dict[int, list[tuple[float, np.ndarray, np.ndarray]]] = {}
    for link in robot.links:
        own = link.inertial
        if link.name not in offsets or own is None or not own.mass:
            continue
        frame, pose = offsets[link.name]
        parts.setdefault(frame, []).append(_mass_of(path, link, pose))
    masses = []
    for frame, rows in sorted(parts.items()):
        mass = sum(row[0] for row in rows)
        center = np.sum([row[0] * row[1] for row in rows], axis=0) / mass
        tensor = np.zeros((3, 3))
        is_stated = len(rows) > 1 or rows[0][2].any()
        for part, position, own in rows:  # parallel axes
            away, is_known = position - center, own.any() or not is_stated
            tensor += own if is_known else LinkMass(frame, part).tensor
            tensor += part * (away @ away * np.eye(3) - np.outer(away, away))
        inertia: Any = (*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2])
        inertia = tuple(map(float, inertia)) if is_stated else None
        try:
            at: Any = tuple(map(float, center))
            masses.append(LinkMass(frame, mass, at, inertia))
        except InputError as error:
            raise InputError(
                f"{path}: <inertial> after {frame} joints: {error} Correct it, or give "
                "masses = false in a TOML file with urdf."
            ) from error
    return tuple(masses)


def _mass_of(
    path: Path, link: Any, pose: Float[np.ndarray, "4 4"]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, center and inertia of a link in the frame to which it is fixed; 0 for no inertia.

    Raises:
        InputError: If the mass is not above 0, a number is not finite or too large, or a principal
            moment is negative: a sum of links could hide it.
    """
    own = link.inertial
    pose = pose if own.origin is None else pose @ np.asarray(own.origin, float)
    tensor = np.zeros((3, 3)) if own.inertia is None else np.asarray(own.inertia, float)
    mass, values = float(own.mass), np.concatenate([pose.ravel(), tensor.ravel()])
    is_valid = 0.0 < mass <= _MAX_NUMBER and bool((np.abs(values) <= _MAX_NUMBER).all())
    if not (is_valid and np.linalg.eigvalsh(tensor)[0] >= -1e-9 * np.abs(tensor).max()):
        rows = ", ".join(f"{value:g}" for value in tensor[np.triu_indices(3)])
        raise InputError(
            f"{path}: <inertial> of link {link.name} has mass {mass:g}, ixx to izz {rows}. "
            f"Allowed: a mass above 0, numbers up to {_MAX_NUMBER:g}, no negative principal "
            "moment. Correct it, or give masses = false in a TOML file with urdf."
        )
    turn = pose[:3, :3]
    return mass, pose[:3, 3], turn @ tensor @ turn.T


def _vertices(path: Path, link: str, shape: Any, settings: UrdfArm) -> Float[np.ndarray, "n 3"]:
    creation = import_extra("trimesh", "robots").creation
    if shape.box is not None:
        return np.asarray(creation.box(shape.box.size).vertices)
    if shape.sphere is not None:
        return np.asarray(creation.icosphere(2, shape.sphere.radius).vertices)
    if shape.cylinder is not None:
        made = creation.cylinder(shape.cylinder.radius, shape.cylinder.length, sections=24)
        return np.asarray(made.vertices)
    if shape.mesh is None:
        raise InputError(
            f"{path}: link {link} has an unknown collision shape. Allowed: box, "
            "cylinder, sphere, mesh."
        )
    scale = 1.0 if shape.mesh.scale is None else shape.mesh.scale
    return _mesh_vertices(_mesh_path(path, link, str(shape.mesh.filename), settings)) * scale


def _mesh_path(path: Path, link: str, name: str, settings: UrdfArm) -> Path:
    """File of a mesh below the package folder, or below that of the URDF."""
    relative = name.split("://", 1)[-1]
    roots = [Path(settings.meshes)] if settings.meshes else [path.parent, *path.absolute().parents]
    for root in roots[: _PARENTS + 1]:
        if not Path(relative).is_absolute() and (root / relative).is_file():
            return inside(root, relative)
    raise InputError(
        f"{path}: mesh {name} of link {link} is missing. Give the folder of its package as meshes, "
        "or collision = false, in a TOML file with urdf."
    )


def _mesh_vertices(path: Path) -> Float[np.ndarray, "n 3"]:
    trimesh = import_extra("trimesh", "robots")
    size = path.stat().st_size
    require(size <= _MAX_MESH_BYTES, f"size of {path}", f"{size} byte", f"up to {_MAX_MESH_BYTES}")
    with reading(f"the mesh {path}"):
        mesh: Any = trimesh.load(path, force="mesh")
        vertices = np.asarray(mesh.vertices, float)
    if not (len(vertices) and np.isfinite(vertices).all()):
        raise InputError(f"The mesh {path} has no finite vertices. Give another mesh.")
    return vertices


def capsule_around(points: Float[np.ndarray, "n 3"], frame: int) -> Link:
    """Capsule that holds all points, along their longest principal axis.

    Args:
        points: Points in the frame [m].
        frame: Index of the frame.
    """
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axis = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]
    along = (points - center) @ axis
    away = np.linalg.norm(points - center - along[:, None] * axis, axis=1)
    radius = max(float(away.max()), 1e-4)
    inset = np.sqrt(np.maximum(radius**2 - away**2, 0.0))  # of a cap above each point
    low, high = float((along + inset).min()), float((along - inset).max())
    low, high = min(low, high), max(low, high)
    start, end = (tuple((center + s * axis).tolist()) for s in (low, high))
    return Link(frame, start, end, radius)  # type: ignore[arg-type]


def _with_pairs(arm: Arm) -> Arm:
    """Arm that avoids collisions of links that are not neighbors and are apart at home."""
    frames = sorted({link.frame for link in arm.links})
    pairs = []
    for i in frames:
        for j in frames:
            if j - i < 2:
                continue
            one = replace(arm, collision_pairs=((i, j),))
            if one.core.clearance(np.array([arm.home], float))[0, 0] > 0.0:
                pairs.append((i, j))
    return replace(arm, collision_pairs=tuple(pairs))
