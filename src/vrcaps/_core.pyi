"""Types of the compiled core (Rust, `rust/src`)."""

from collections.abc import Sequence
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

__version__: str
__file__: str

testing: ModuleType
"""Individual stages of the camera pipeline: functions that only tests call."""

class Wall:
    """A triangle surface with its bounding-volume hierarchy; normals point into the lumen."""

    center: tuple[float, float, float]
    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None: ...
    def copy(self) -> Wall: ...
    def refit(self, vertices: NDArray[np.float64]) -> None: ...
    def cast(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]: ...
    def signed_distance(self, points: NDArray[np.float64]) -> NDArray[np.float32]: ...
    def closest_point(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]: ...
    def visible(
        self, origin: tuple[float, float, float], points: NDArray[np.float64]
    ) -> NDArray[np.bool_]: ...
    def vertex_normals(self) -> NDArray[np.float32]: ...

Vector = tuple[float, float, float]
OpticalProperties = tuple[Vector, float, float, NDArray[np.float32], float, NDArray[np.float32]]
Pose = tuple[Vector, tuple[float, float, float, float], Vector, Vector]

class World:
    """A capsule in a soft wall; positions are relative to `Wall.center`."""

    pose: Pose
    active_wall: NDArray[np.float64]
    wall_displacement: NDArray[np.float64]
    coupling_state: tuple[NDArray[np.float64], NDArray[np.float64]] | None

    def __init__(
        self,
        wall: Wall,
        body: Any,
        foundation: Any,
        drag: Any,
        spring_wall: Any | None,
        pose: Pose,
        is_quasi_static: bool = False,
    ) -> None: ...
    def set_lumen_drive(self, inward: NDArray[np.float64], sample: NDArray[np.float64]) -> None: ...
    def step(
        self,
        dt: float,
        count: int,
        wrench: tuple[float, ...],
        gravity: tuple[float, ...],
        lumen_scale: NDArray[np.float64] | None = None,
        outer: int = 1,
    ) -> None: ...
    def set_layer(self, layer: FemLayer, tolerance: float) -> None: ...
    def set_magnets(self, sources: FieldSources, magnets: NDArray[np.float64]) -> None: ...
    def aim_sources(
        self,
        begin: NDArray[np.float64],
        end: NDArray[np.float64],
        duration: float,
        pose: NDArray[np.float64],
    ) -> None: ...
    def pose_in(self, wall: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def magnetic_coupling(
        self, pose: NDArray[np.float64]
    ) -> tuple[Vector, Vector, Vector, tuple[float, ...], int, Vector, float] | None: ...
    def save(self) -> None: ...
    def undo(self) -> None: ...
    def settle(self, tolerance: float = 0.0) -> None: ...
    def vertices(self, transform: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def contact(self) -> tuple[Vector, Vector, float, float, float, float, float]: ...
    def set_contact(self, row: tuple[float, ...]) -> None: ...
    def contact_forces(self) -> NDArray[np.float64]: ...
    def penetration_depth(self) -> float: ...
    def kinetic_energy(self) -> float: ...
    def resistance(self, speed: float) -> float: ...
    def inside(self) -> bool: ...

def step_worlds(
    worlds: list[World],
    dt: float,
    loads: NDArray[np.float64],
    strides: list[tuple[int, int]],
    lumen_scales: list[NDArray[np.float64] | None],
) -> list[str | None]: ...
def world_states(
    worlds: list[World], poses: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
def worlds_inside(worlds: list[World]) -> list[bool]: ...
def settle_worlds(worlds: list[World]) -> None: ...

class FieldSources:
    """Sources of a magnetic field (`vrcaps.magnet.field`)."""

    def __init__(self) -> None: ...
    def __len__(self) -> int: ...
    def add_dipole(self, pose: NDArray[np.float64], moment: float) -> None: ...
    def add_shell(
        self,
        pose: NDArray[np.float64],
        radius: float,
        length: float,
        sheet: float,
        is_solid: bool = False,
    ) -> None: ...
    def add_magnet_ring(
        self,
        pose: NDArray[np.float64],
        radii: tuple[float, float],
        length: float,
        remanence: float,
        across: bool,
    ) -> None: ...
    def add_block(self, pose: NDArray[np.float64], size: Vector, remanence: float) -> None: ...
    def add_ball(self, pose: NDArray[np.float64], radius: float, remanence: float) -> None: ...
    def add_ring(self, pose: NDArray[np.float64], radius: float, current: float) -> None: ...
    def add_uniform(self, pose: NDArray[np.float64], flux: float) -> None: ...
    def add_map(
        self,
        pose: NDArray[np.float64],
        origin: Vector,
        spacing: Vector,
        values: NDArray[np.float64],
        factor: float,
    ) -> None: ...
    def set_pose(self, index: int, pose: NDArray[np.float64]) -> None: ...
    def set_strength(self, index: int, strength: float) -> None: ...
    def field(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]: ...
    def wrench(
        self, magnets: NDArray[np.float64], poses: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]: ...

class _WrenchTarget(Protocol):
    """Fields of `vrcaps.actuation.magnet_pose_solver.WrenchTarget` that are read."""

    @property
    def force(self) -> Sequence[float]: ...
    @property
    def torque(self) -> Sequence[float]: ...
    @property
    def force_weight(self) -> Sequence[Sequence[float]]: ...
    @property
    def torque_weight(self) -> float: ...
    @property
    def motion_weight(self) -> float: ...

class _Workspace(Protocol):
    """Fields of `vrcaps.actuation.magnet_pose_solver.Workspace` that are read."""

    @property
    def low(self) -> Vector: ...
    @property
    def high(self) -> Vector: ...
    @property
    def min_distance(self) -> float: ...

def solve_magnet_pose(
    sources: FieldSources,
    index: int,
    magnets: NDArray[np.float64],
    pose: NDArray[np.float64],
    start: NDArray[np.float64],
    target: _WrenchTarget,
    workspace: _Workspace,
    max_iterations: int,
) -> tuple[NDArray[np.float64], Vector, Vector, float]: ...
def rotate_by_vector(
    vector: NDArray[np.float64], matrix: NDArray[np.float64]
) -> NDArray[np.float64]: ...
def rotation_vector(matrix: NDArray[np.float64]) -> NDArray[np.float64]: ...

class _CapsuleTarget(Protocol):
    """Fields of `vrcaps.actuation.capsule_target.CapsuleTarget` that are read."""

    @property
    def position(self) -> Sequence[float] | NDArray[np.float64]: ...
    @property
    def direction(self) -> Sequence[float] | NDArray[np.float64] | None: ...
    @property
    def tangent(self) -> Sequence[float] | NDArray[np.float64] | None: ...
    @property
    def wall_normal(self) -> Sequence[float] | NDArray[np.float64]: ...
    @property
    def parallel_to_wall(self) -> bool: ...
    @property
    def on_planned_wall(self) -> bool: ...

class _ReferenceLimits(Protocol):
    """Fields of `vrcaps.actuation.magnet_controller.ControllerGains` that are read."""

    @property
    def speed(self) -> float: ...
    @property
    def angular_speed(self) -> float: ...
    @property
    def lookahead(self) -> float: ...
    @property
    def lookahead_angle(self) -> float: ...

def advance_reference(
    reference: NDArray[np.float64],
    capsule: NDArray[np.float64],
    contact: Sequence[float] | NDArray[np.float64],
    target: _CapsuleTarget,
    gains: _ReferenceLimits,
    dt: float,
) -> tuple[
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    float,
    bool,
]: ...

class ArmChain:
    """An arm of revolute joints (`vrcaps.actuation.arm`)."""

    has_closed_form: bool
    def __init__(
        self,
        joints: NDArray[np.float64],
        flange: NDArray[np.float64],
        links: NDArray[np.float64],
        pairs: list[tuple[int, int]],
        placements: NDArray[np.float64] | None = None,
    ) -> None: ...
    def frames(self, angles: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def jacobian(self, angles: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def inverse(
        self, targets: NDArray[np.float64], last: Sequence[float]
    ) -> NDArray[np.float64]: ...
    def nearest(
        self,
        targets: NDArray[np.float64],
        near: NDArray[np.float64],
        others: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]: ...
    def follow(
        self,
        targets: NDArray[np.float64],
        start: NDArray[np.float64],
        others: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]: ...
    def clearance(
        self, angles: NDArray[np.float64], table: tuple[Vector, Vector] | None = None
    ) -> NDArray[np.float64]: ...

class ArmWithPayload:
    """A robot arm with a magnet (`vrcaps.actuation.arm.arm_with_payload`)."""

    def __init__(
        self,
        arm: ArmChain,
        loaded: ArmChain,
        base: NDArray[np.float64],
        mount: NDArray[np.float64],
        size: tuple[float, float],
        table: float | None,
    ) -> None: ...
    def clearance(self, angles: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def lowest(self, magnet: NDArray[np.float64]) -> float: ...

class RobotActuator:
    """A robot arm that moves its magnet (`vrcaps.actuation.magnet_actuator`)."""

    def __init__(
        self,
        robot: ArmWithPayload,
        joints: NDArray[np.float64],
        workspace: tuple[Vector, Vector],
        along: Vector,
        speeds: tuple[float, float],
    ) -> None: ...
    def align_flange(self, goal: NDArray[np.float64]) -> NDArray[np.float64]: ...
    def move_towards(
        self,
        magnet: NDArray[np.float64],
        velocity: NDArray[np.float64],
        angles: NDArray[np.float64],
        goal: NDArray[np.float64],
        dt: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], str]: ...

class Texture:
    """Packed albedo, roughness and relief with mip levels."""

    def __init__(
        self, albedo: NDArray[np.uint8], roughness: NDArray[np.uint8], height: NDArray[np.float32]
    ) -> None: ...

class Scene:
    """Surface properties for rendering a wall."""

    def __init__(
        self,
        uv: NDArray[np.float32],
        aspect: NDArray[np.float32],
        label: NDArray[np.uint8],
        instance: NDArray[np.uint16],
        arc_length: NDArray[np.float32],
        *,
        texture: Texture | None,
        albedo: tuple[float, float, float],
        roughness: float,
        reflectance: tuple[float, float, float],
        tissue: OpticalProperties | None = None,
    ) -> None: ...

class RayTable:
    """Unit ray directions of every pixel of a camera."""

    shape: tuple[int, int]
    def __init__(self, directions: NDArray[np.float32]) -> None: ...

class Particles:
    """Moving bubbles and particles; positions are relative to `Wall.center`."""

    states: NDArray[np.float64]
    count: int
    def __init__(
        self,
        wall: Wall,
        spheres: Any,
        laws: Any,
        tangents: NDArray[np.float64],
        spacing: float,
    ) -> None: ...
    def step(
        self, wall: Wall, around: Any, dt: float, sweep: float | None = None
    ) -> tuple[Vector, Vector]: ...
    def masses(self) -> list[float]: ...

def terminal_speed(
    radius: float, density: float, liquid_density: float, viscosity: float, gravity: float
) -> float: ...
def around_capsule(
    centers: NDArray[np.float64],
    radius: NDArray[np.float64],
    dome_sites: NDArray[np.float64],
    pose: NDArray[np.float64],
    capsule: tuple[float, float],
) -> NDArray[np.float64] | None: ...

class Contents:
    """Contents of a lumen at one instant, ready for rendering."""

    def __init__(
        self, wall: Wall, spheres: Any, film: Any, pools: tuple[Any, Any] | None, label: int
    ) -> None: ...
    def move_to(self, wall: Wall, centers: NDArray[np.float64]) -> None: ...
    def free(
        self, wall: Wall, origin: tuple[float, float, float], points: NDArray[np.float64]
    ) -> NDArray[np.bool_]: ...
    def segments_unoccluded(
        self, wall: Wall, starts: NDArray[np.float64], points: NDArray[np.float64]
    ) -> NDArray[np.bool_]: ...

class Radiosity:
    def __init__(self, rest: Wall, scene: Scene) -> None: ...

def render(
    wall: Wall,
    scene: Scene,
    rays: RayTable,
    pose: NDArray[np.float64],
    leds: NDArray[np.float64],
    out: dict[str, NDArray[Any]],
    *,
    exposure: float,
    shadows: bool,
    contents: Contents | None = None,
    paths: tuple[int, int, int] | None = None,
    radiosity: Radiosity | None = None,
) -> None: ...
def render_batch(
    walls: Sequence[Wall],
    scenes: Sequence[Scene],
    rays: RayTable,
    poses: NDArray[np.float64],
    leds: NDArray[np.float64],
    out: dict[str, NDArray[Any]],
    *,
    exposure: float,
    shadows: bool,
) -> None: ...
def immerse(
    planes: NDArray[np.float32],
    rays: NDArray[np.float32],
    distance: NDArray[np.float32],
    start: NDArray[np.float32],
    pose: NDArray[np.float64],
    leds: NDArray[np.float64],
    medium: dict[str, object],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
def scatter_forward(
    planes: NDArray[np.float32],
    lit: NDArray[np.bool_],
    fraction: NDArray[np.float32],
    sigma: float,
) -> None: ...
def raise_villi(
    planes: NDArray[np.float32],
    seen: tuple[NDArray[Any], ...],
    wall: tuple[NDArray[np.float64], NDArray[np.int64]],
    by_label: Sequence[Sequence[float]],
    tissue: tuple[float, Sequence[float]],
    focal: float,
) -> None: ...
def intersecting_triangles(
    corners: NDArray[np.float64], vertices: NDArray[np.int64], tolerance: float
) -> NDArray[np.int64]: ...
def turned_triangles(
    vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> NDArray[np.int64]: ...
def sum_wave_tables(
    tables: NDArray[np.float64],
    step: float,
    arc_length: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> NDArray[np.float64]: ...
def covered_texels(
    corners: NDArray[np.float64], margin: float
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]: ...
def mark_seen(
    walls: Sequence[Wall],
    rays: RayTable,
    pixels_per_steradian: NDArray[np.float32],
    poses: NDArray[np.float64],
    seen: NDArray[np.uint8],
    *,
    min_density: float,
    min_cosine: float,
) -> None: ...
def wall_distances(
    walls: Sequence[Wall],
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    reach: float,
) -> NDArray[np.float32]: ...

class WallPoints:
    def __init__(
        self,
        corners: NDArray[np.uint32],
        weights: NDArray[np.float32],
        fractions: NDArray[np.float64],
        cell: NDArray[np.uint32],
    ) -> None: ...

class DirectionTable:
    def __init__(self, density: NDArray[np.float32]) -> None: ...

def mark_points(
    walls: Sequence[Wall],
    points: Sequence[WallPoints],
    table: DirectionTable,
    poses: NDArray[np.float64],
    flags: list[NDArray[np.uint8]],
    cells: NDArray[np.float64],
    *,
    max_depth: float,
    min_density: float,
    min_cosine: float,
) -> NDArray[np.float64]: ...
def walk_tissue(
    wall: Wall,
    origin: tuple[float, float, float],
    direction: tuple[float, float, float],
    *,
    albedo: tuple[float, float, float],
    extinction: tuple[float, float, float],
    ior: float,
    count: int,
    seed: int,
) -> tuple[NDArray[np.float64], NDArray[np.float32]]: ...
def encode_srgb(radiance: NDArray[np.float32], exposure: float) -> NDArray[np.uint8]: ...

class CameraPipeline:
    """Stages of one camera (`vrcaps.camera_pipeline`)."""

    def __init__(
        self,
        rays: RayTable,
        lit: NDArray[np.bool_],
        cosine: NDArray[np.float32],
        stages: dict[str, Any],
    ) -> None: ...
    @property
    def planes_shape(self) -> tuple[int, int, int]: ...
    def apply(self, radiance: NDArray[np.float32], frame: dict[str, Any]) -> NDArray[np.uint8]: ...
    def meter(
        self, radiance: NDArray[np.float32], factors: tuple[float, float, float]
    ) -> float: ...

def flow_by_rays(
    rays: RayTable,
    given: tuple[
        NDArray[np.float32],
        NDArray[np.float64],
        tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float64], tuple[float, float]]
        | None,
    ],
    step: int,
) -> NDArray[np.float32]: ...
def standard_normal(shape: tuple[int, int], key: int, stream: int) -> NDArray[np.float32]: ...
def quantize(values: NDArray[np.float32], scale: float, offset: float) -> NDArray[np.uint16]: ...
def write_pngs(items: list[tuple[str, NDArray[Any]]]) -> None: ...
def read_png(path: str) -> NDArray[Any]: ...
def encode_pngs(arrays: list[NDArray[Any]]) -> list[bytes]: ...
def decode_pngs(files: list[NDArray[np.uint8]]) -> list[NDArray[Any]]: ...
def cpu_features() -> list[str]: ...
def num_threads() -> int: ...
def bake_mucosa(
    wall: NDArray[np.float32],
    faces: NDArray[np.uint32],
    uv: NDArray[np.float64],
    layout: tuple[int, int, float],
    seed: int,
    mucosa: object,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]]:
    """Flat sRGB albedo, roughness and height [m] of a mucosa (`vrcaps.mucosa.bake`)."""

class FemLayer:
    """A layer of finite elements that carries a surface (`vrcaps.tissue.fem`)."""

    rounds: int
    fill: int
    nodes: NDArray[np.float64]
    def __init__(
        self, matrices: object, elements: object | None, embedding: object, damping: float
    ) -> None: ...
    def step(
        self,
        force: NDArray[np.float64],
        acceleration: tuple[float, float, float],
        dt: float,
        tolerance: float,
    ) -> None: ...
    def wall_displacement(self) -> NDArray[np.float64]: ...
    def energies(self) -> tuple[float, float]: ...
