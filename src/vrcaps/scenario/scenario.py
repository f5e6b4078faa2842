"""What to record: one typed tree, read from a file and written into the episode it makes."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from vrcaps.camera_pipeline.effects import Effects
from vrcaps.capsule.catalog import read_device
from vrcaps.capsule.device import Device
from vrcaps.errors import InputError, UnknownNameError
from vrcaps.files import file_sha256
from vrcaps.lesion import AnyLesion, add_lesions
from vrcaps.lumen.contents import Contents
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.fly_through import FlyThrough, fly_through
from vrcaps.motion.replay import Replay, replay
from vrcaps.motion.rollout import Rollout
from vrcaps.motion.run import Run
from vrcaps.motion.trajectory import Trajectory
from vrcaps.mucosa.appearance import is_texture_path
from vrcaps.mucosa.texture import texture_head
from vrcaps.organ.organ_file import is_organ_file
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.frame import CHANNELS
from vrcaps.render.led_light import make_imaging
from vrcaps.render.settings import RECORDED, RenderSettings
from vrcaps.scenario.convert import from_plain, to_plain
from vrcaps.sensors.sensors import Sensors
from vrcaps.units import parse_length
from vrcaps.world.model import Model, posture_transform

DEFAULT_CHANNELS = ("rgb", "depth", "normal", "label", "instance")


@dataclass(frozen=True)
class OrganGenerated:
    """An organ of the built-in generator.

    Attributes:
        name: Which, for example `colon`.
        seed: A different patient for each.
        distension: How full it is; None is the usual, the colon inflated, all else normal.
        mucosa: Look of the wall: a name of `vrcaps.mucosa.appearance.MUCOSAE`, or the folder of
            a texture; None is the organ's own.
        mucosa_sha256: Checksum of the texture; filled in when recorded, checked when given.
    """

    name: str = "colon"
    seed: int = 0
    distension: Literal["inflated", "normal", "collapsed"] | None = None
    mucosa: str | None = None
    mucosa_sha256: str = ""

    kind: ClassVar[str] = "generated"


@dataclass(frozen=True)
class OrganFile:
    """An organ from a mesh file, or from an organ file that `vrcaps organ` wrote.

    An organ file is taken as it is, with its labels, lesions and textures.

    Attributes:
        path: PLY, OBJ, STL or GLB in the patient frame, seen from the working directory.
        unit: Length unit of the file, such as `mm` or `5cm`; a mesh file has none of its own,
            an organ file is in metres.
        open_ends: Whether open ends of the lumen are capped or left open.
        keep_uv: Whether the file's own texture coordinates stay.
        reverse: Whether the narrower end of the lumen is the oral one.
        mucosa: Look of the wall: a name of `vrcaps.mucosa.appearance.MUCOSAE`, or the folder of
            a texture; None is the organ's own textures or, where it has none, the mucosa that
            its labels call for, see `own_mucosa`.
        mucosa_sha256: Checksum of the texture; filled in when recorded, checked when given.
        sha256: Checksum of the file; filled in when recorded, checked when given.
    """

    path: str
    unit: str = ""
    open_ends: Literal["cap", "keep"] = "cap"
    keep_uv: bool = False
    reverse: bool = False
    mucosa: str | None = None
    mucosa_sha256: str = ""
    sha256: str = ""

    kind: ClassVar[str] = "file"


@dataclass(frozen=True)
class Scenario:
    """A recording as asked for; with its files at hand it fixes every byte of the episode.

    Attributes:
        organ: The gut wall.
        capsule: Name in the catalog, or path of a device file.
        posture: How the patient lies, see `posture_transform`.
        motion: How the capsule moves.
        frames: Number of frames.
        fps: Frames per second; None takes the capsule's own.
        seed: Of the motion's wandering and the mucosa of an organ from a file.
        channels: Image channels to write.
        render: How to render; by default with radiosity.
        wall: Store where every vertex of the wall is in each frame.
        lesions: What to put into the organ; number k becomes instance k, counted from 1.
        clean_twin: Show the same patient without the lesions; the motion stays as it is with them.
        contents: What floats in the lumen.
        effects: What the cameras' lens and sensor do; a range of grades is drawn from the seed.
        sensors: What else is measured in each frame: the capsule's motion, field and place.
    """

    organ: OrganGenerated | OrganFile = field(default_factory=OrganGenerated)
    capsule: str = "mirocam"
    posture: str = "supine"
    motion: FlyThrough | Replay | Dynamics = field(default_factory=FlyThrough)
    frames: int = 100
    fps: float | None = None
    seed: int = 0
    channels: tuple[str, ...] = DEFAULT_CHANNELS
    render: RenderSettings = RECORDED
    wall: bool = False
    lesions: tuple[AnyLesion, ...] = ()
    clean_twin: bool = False
    contents: Contents = field(default_factory=Contents)
    effects: Effects = field(default_factory=Effects)
    sensors: Sensors = field(default_factory=Sensors)


def read_scenario(path: str | Path) -> Scenario:
    """Read a scenario from a JSON or TOML file, or from the `episode.json` of an episode.

    Raises:
        InputError: If the file cannot be read, or a key is unknown or has a wrong value.
    """
    plain = _read_plain(Path(path), "scenario")
    if isinstance(plain, dict) and "format" in plain:
        plain = plain.get("scenario")
    return scenario_from_plain(plain)


def read_lesions(path: str | Path) -> tuple[AnyLesion, ...]:
    """Read lesions from a JSON or TOML file: tables ``lesions``, as a scenario has them.

    Raises:
        InputError: If the file cannot be read, or a key is unknown or has a wrong value.
    """
    plain = _read_plain(Path(path), "lesions")
    if not isinstance(plain, dict) or set(plain) != {"lesions"}:
        raise InputError(f"{path} is no file of lesions. Allowed: tables [[lesions]], no more.")
    return from_plain(tuple[AnyLesion, ...], plain["lesions"], at="lesions")


def _read_plain(path: Path, what: str) -> Any:
    try:
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"Cannot read the {what} {path}: {reason}.") from error
    except (json.JSONDecodeError, tomllib.TOMLDecodeError) as error:
        kind = "TOML" if path.suffix == ".toml" else "JSON"
        raise InputError(f"{path} is no {kind}: {error}.") from error


def scenario_to_plain(scenario: Scenario) -> dict[str, Any]:
    """The scenario as JSON and TOML hold it."""
    return to_plain(scenario, Scenario)


def scenario_from_plain(plain: Any) -> Scenario:
    """The scenario that `scenario_to_plain` wrote, or a user with fewer keys.

    Raises:
        InputError: If a key is unknown or has a wrong value; names it.
    """
    if not isinstance(plain, dict):
        raise InputError(f"A scenario is a table of keys, not {type(plain).__name__}.")
    return from_plain(Scenario, plain, at="scenario")


def resolve(scenario: Scenario) -> tuple[Scenario, Device]:
    """The scenario with nothing left open, and its capsule.

    Fills in the frame rate and the checksums of files, draws the grades of effects, and puts the
    channels in the order of `Frame`. The capsule's cameras are as the effects have changed them.

    Raises:
        InputError: If a value is out of range, a file is not the one that a checksum names, or the
            capsule's LEDs lack a colour.
        UnknownNameError: If a posture, capsule or channel is unknown.
    """
    device = read_device(scenario.capsule)
    make_imaging(device, scenario.render.imaging)
    posture_transform(scenario.posture)
    for channel in scenario.channels:
        if channel not in CHANNELS:
            raise UnknownNameError("channel", channel, CHANNELS)
    fps = device.frame_rate if scenario.fps is None else scenario.fps
    for name, value, valid, allowed in (
        ("frames", scenario.frames, 1 <= scenario.frames <= 10**6, "1 to 1000000"),
        ("fps", fps, 0.0 < fps < math.inf, "above 0"),
        ("seed", scenario.seed, scenario.seed >= 0, "0 or more"),
        ("channels", list(scenario.channels), len(scenario.channels) > 0, "at least one"),
    ):
        if not valid:
            raise InputError(f"{name} is {value}. Allowed: {allowed}.")
    organ, motion = scenario.organ, scenario.motion
    if isinstance(organ, OrganFile):
        unit = organ.unit or ("m" if is_organ_file(Path(organ.path)) else "")
        parse_length(unit)
        organ = replace(organ, unit=unit, sha256=_checked_sha256(organ.path, organ.sha256))
    if organ.mucosa is not None and is_texture_path(organ.mucosa):
        head = str(texture_head(organ.mucosa))
        organ = replace(organ, mucosa_sha256=_checked_sha256(head, organ.mucosa_sha256))
    if isinstance(motion, Replay):
        parse_length(motion.unit)
        motion = replace(motion, sha256=_checked_sha256(motion.path, motion.sha256))
    if isinstance(motion, Dynamics) and motion.wrench_file:
        checksum = _checked_sha256(motion.wrench_file, motion.wrench_sha256)
        motion = replace(motion, wrench_sha256=checksum)
    if isinstance(motion, Dynamics) and motion.magnet is not None and motion.magnet.command_file:
        checksum = _checked_sha256(motion.magnet.command_file, motion.magnet.command_file_sha256)
        motion = replace(motion, magnet=replace(motion.magnet, command_file_sha256=checksum))
    channels = tuple(channel for channel in CHANNELS if channel in scenario.channels)
    effects = scenario.effects.drawn(scenario.seed)
    resolved = replace(
        scenario, organ=organ, motion=motion, fps=fps, channels=channels, effects=effects
    )
    return resolved, effects.device(device)


def build(scenario: Scenario, device: Device) -> tuple[Model, Run]:
    """World and motion of a resolved scenario.

    Raises:
        InputError: If the organ cannot be made or the capsule cannot move in it as asked.
    """
    T_world_patient = posture_transform(scenario.posture)
    contents = scenario.effects.contents(scenario.contents)
    shown = model = Model(_load_patient(scenario), device, T_world_patient, contents)
    if scenario.clean_twin:
        twin = _load_patient(scenario, clean=True)
        shown = Model(twin, device, T_world_patient, contents)
    if not isinstance(scenario.motion, Dynamics):
        return shown, make_trajectory(scenario, model, shown)
    assert scenario.fps is not None
    simulation = Rollout(
        model,
        scenario.motion,
        frames=scenario.frames,
        fps=scenario.fps,
        seed=scenario.seed,
        shown=shown.organ if scenario.clean_twin else None,
    )
    return shown, simulation


def make_trajectory(scenario: Scenario, model: Model, shown: Model) -> Trajectory:
    """Motion of a resolved scenario in its world, where it is known beforehand.

    Args:
        scenario: What to record.
        model: Where the capsule moves.
        shown: What is seen: the model, or its clean twin.
    """
    assert scenario.fps is not None
    if isinstance(scenario.motion, Replay):
        return replay(model, scenario.motion, frames=scenario.frames, fps=scenario.fps)
    assert isinstance(scenario.motion, FlyThrough)
    rng = np.random.default_rng(scenario.seed)
    path = fly_through(model, scenario.motion, frames=scenario.frames, fps=scenario.fps, rng=rng)
    return replace(
        path,
        wall_displacement=path.wall_displacement and replace(path.wall_displacement, shown=shown),
    )


def _load_patient(scenario: Scenario, *, clean: bool = False) -> OrganSurface:
    """The organ with its lesions, or its clean twin, as wet as the effects have it."""
    return scenario.effects.organ(_with_lesions(scenario, clean=clean))


def _with_lesions(scenario: Scenario, *, clean: bool) -> OrganSurface:
    """The organ with its lesions, or its clean twin; made once like the organ itself."""
    from vrcaps.organ.cache import cached_organ, fingerprint

    if not scenario.lesions:
        organ = _load_organ(scenario)
        if clean and organ.metadata.get("lesions"):
            raise InputError(
                f"{organ.name} holds its lesions for good, so it has no clean twin. Give the file "
                "of the clean twin, which `vrcaps organ make --clean-twin` writes."
            )
        return organ
    gravity_world = np.array([0.0, 0.0, -1.0])
    down = posture_transform(scenario.posture)[:3, :3].T @ gravity_world
    seed = getattr(scenario.organ, "seed", scenario.seed)

    def make() -> OrganSurface:
        rng, organ = np.random.default_rng([seed, 3]), _load_organ(scenario)
        if organ.metadata.get("lesions"):
            raise InputError(f"{organ.name} has lesions already. Give none, or its clean twin.")
        patient = add_lesions(organ, scenario.lesions, rng, down=down)
        return patient.clean if clean else patient.organ

    plain = to_plain(scenario.lesions, tuple[AnyLesion, ...])
    key = {"lesions": plain, "organ": asdict(scenario.organ), "down": down.tolist(), "seed": seed}
    return cached_organ(f"lesions-{fingerprint({**key, 'clean': clean})}", make)


def _load_organ(scenario: Scenario) -> OrganSurface:
    """The organ with its appearance, made once and then read from the user's cache folder."""
    from vrcaps.anatomy.catalog import generate_organ
    from vrcaps.mucosa.appearance import bake_appearance, own_mucosa
    from vrcaps.organ.cache import cached_organ, fingerprint
    from vrcaps.organ.read_organ import read_organ

    given = scenario.organ
    if isinstance(given, OrganGenerated):
        return generate_organ(
            given.name, seed=given.seed, distension=given.distension, mucosa=given.mucosa
        )

    def read() -> OrganSurface:
        return read_organ(
            Path(given.path),
            unit=given.unit,
            open_ends=given.open_ends,
            keep_uv=given.keep_uv,
            reverse=given.reverse,
        )

    def make() -> OrganSurface:
        organ = read()
        mucosa = given.mucosa or own_mucosa(organ)
        look = bake_appearance(organ, seed=scenario.seed, mucosa=mucosa)
        return replace(organ, appearance=look)

    if is_organ_file(Path(given.path)) and (organ := read()).appearance is not None:
        if given.mucosa is not None:
            raise InputError(f"{given.path} has textures of its own. Leave out the mucosa.")
        return organ
    key = fingerprint(asdict(given) | {"seed": scenario.seed})
    return cached_organ(f"file-{key}", make)


def _checked_sha256(path: str, expected: str) -> str:
    try:
        actual = file_sha256(Path(path))
    except OSError as error:
        raise InputError(f"Cannot read {path}: {error.strerror}.") from error
    if expected and actual != expected:
        raise InputError(
            f"{path} has sha256 {actual[:12]}…, but the scenario was made with {expected[:12]}…. "
            "Give the original file, or remove the sha256 from the scenario."
        )
    return actual
