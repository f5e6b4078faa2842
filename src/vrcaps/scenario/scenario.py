"""Scenario: definition of a recording as one typed tree, in files and in each episode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from vrcaps.camera_pipeline.effects import Effects, parse_effects
from vrcaps.capsule.device import MAX_FRAME_RATE, Device
from vrcaps.capsule.device_file import device_of
from vrcaps.config.convert import from_plain, to_plain
from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.fields import FileRef, Range, check_fields, file_ref
from vrcaps.core.rng import MAX_SEED, stream
from vrcaps.core.units import parse_length
from vrcaps.lesion import Lesion, draw_lesions, parse_lesion
from vrcaps.lumen.contents import Contents
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.motion.motion import MotionSettings
from vrcaps.mucosa.mucosa import MucosaSettings, is_texture_path
from vrcaps.organ.segments import ORGANS, Distension, organ_segments
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.channels import CHANNELS
from vrcaps.render.settings import RenderSettings
from vrcaps.sensors.sensors import Sensors
from vrcaps.world.model import posture_transform

SOURCE_ORGAN = "source_organ.glb"
"""File in the folder of an episode with the organ, if it was recorded from memory."""

PREVALENCE = "prevalence"
"""Source that replaces a file of lesions: a random number of them, as in screening patients."""

MAX_FRAMES = 10**6
"""Maximum number of frames of a recording: their names have six digits."""

DEFAULT_CHANNELS = ("rgb", "depth", "normal", "label", "instance")


@dataclass(frozen=True)
class OrganGenerated:
    """An organ of the built-in generators.

    Example:
        >>> vrcaps.Scenario(organ=vrcaps.OrganGenerated("stomach", distension="inflated"))

    Attributes:
        name: Name of the generator: colon, stomach, small-bowel or full-tract.
        seed: Seed of the patient: sizes, course and folds.
        distension: Distension of the organ; None is inflated for the colon, collapsed for
            the small bowel and normal for all others.
        mucosa: Appearance of the wall: colon, stomach or small-bowel, the folder of a texture, or
            a table of parameters; None is the organ's own.
    """

    name: str = "colon"
    seed: Annotated[int, Range(0, MAX_SEED)] = 0
    distension: Distension | None = None
    mucosa: str | MucosaSettings | None = None

    kind: ClassVar[str] = "generated"

    def __post_init__(self) -> None:
        check_fields(self)
        _refer_to_mucosa(self)
        organ = ORGANS.get(self.name)
        if organ is None or not isinstance(self.mucosa, MucosaSettings) or self.mucosa.path:
            return
        if len({segment.mucosa for segment in organ.segments}) > 1:
            raise InputError(
                f"organ.mucosa has no path, but {self.name} has several mucosae. State the "
                "mucosa of the whole wall as path, such as small-bowel."
            )


@dataclass(frozen=True)
class OrganFile:
    """An organ from a mesh file, or from an organ file written by `vrcaps organ`.

    An organ file is used unchanged, with its labels, lesions and textures.

    Example:
        >>> vrcaps.Scenario(organ=vrcaps.OrganFile("colon.ply", unit="mm"))

    Attributes:
        path: PLY, OBJ, STL or GLB in the patient frame, relative to the working directory.
        unit: Length unit of a mesh file, such as mm or 5cm; an organ file is in meters.
        open_ends: Whether open ends of the lumen are capped or kept open.
        keep_uv: Whether the file's own texture coordinates are kept.
        reverse: Whether the narrower end of the lumen is the oral one.
        mucosa: Appearance of the wall: colon, stomach or small-bowel, the folder of a texture, or
            a table of parameters; None is the organ's own textures or, if it has none, the mucosa
            of its labels.
    """

    path: FileRef | str
    unit: str = ""
    open_ends: Literal["cap", "keep"] = "cap"
    keep_uv: bool = False
    reverse: bool = False
    mucosa: str | MucosaSettings | None = None

    kind: ClassVar[str] = "file"

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "path", file_ref(self.path))
        if self.unit:
            parse_length(self.unit)
        _refer_to_mucosa(self)


def _refer_to_mucosa(organ: OrganGenerated | OrganFile) -> None:
    """Convert a mucosa given as the path of a texture to settings with its checksum."""
    if isinstance(organ.mucosa, str) and is_texture_path(organ.mucosa):
        object.__setattr__(organ, "mucosa", MucosaSettings(organ.mucosa))


@dataclass(frozen=True)
class Scenario:
    """Definition of a recording; together with its files it determines every byte of the episode.

    Example:
        >>> organ = vrcaps.OrganFile("colon.ply", unit="mm")
        >>> scenario = vrcaps.Scenario(organ=organ, frames=100, channels=("rgb", "depth"))
        >>> vrcaps.record(scenario, "runs/colon")

    Attributes:
        organ: The gut wall: the name of a generated organ, the path of an organ file, one of the
            tables below, or an organ in memory.
        capsule: Name in the catalog, path of a device file, or a device in memory.
        posture: Posture of the patient: supine, prone, left-lateral, right-lateral or standing.
        motion: Motion of the capsule.
        frames: Number of frames. A fly-through is fitted to its number of frames: a shorter one is
            not the beginning of a longer one.
        fps: Frames per second; None is the capsule's own rate.
        seed: Seed of the motion and of the mucosa of an organ from a file.
        channels: Image channels to write.
        render: Settings of the renderer; radiosity by default.
        wall: Whether the position of every vertex of the wall is stored in each frame.
        lesions: Lesions to put into the organ; their instance IDs are 1, 2, … in this order.
        clean_twin: Whether to render the same patient without the lesions, with the same motion.
        contents: Contents of the lumen.
        variation: Whether settings that are left open (distension of the small bowel, tilt of a
            fly-through, bubbles, chyme, fluid, film on the dome) are drawn by their prevalence in a
            generated organ; otherwise the lumen is empty and the others have fixed defaults.
        effects: Effects of lens and sensor; None for an effect is the capsule's own, and a range
            and random effects are sampled by the seed. A file can also contain a string in the
            syntax of `parse_effects`, such as `none`.
        sensors: Further measurements in each frame: motion, magnetic field and position of the
            capsule.
    """

    organ: OrganGenerated | OrganFile | OrganSurface | str = field(default_factory=OrganGenerated)
    capsule: str | Device = "mirocam"
    posture: str = "supine"
    motion: MotionSettings = field(default_factory=FlyThrough)
    frames: Annotated[int, Range(1, MAX_FRAMES)] = 100
    fps: Annotated[float | None, Range(above=0.0, max=MAX_FRAME_RATE)] = None
    seed: Annotated[int, Range(0, MAX_SEED)] = 0
    channels: tuple[str, ...] = DEFAULT_CHANNELS
    render: RenderSettings = field(default_factory=RenderSettings)
    wall: bool = False
    lesions: tuple[Lesion, ...] = ()
    clean_twin: bool = False
    contents: Contents = field(default_factory=Contents)
    variation: bool = True
    effects: Effects = field(default_factory=Effects)
    sensors: Sensors = field(default_factory=Sensors)

    def __post_init__(self) -> None:
        check_fields(self)
        if isinstance(self.organ, str):
            object.__setattr__(self, "organ", organ_named(self.organ))
        posture_transform(self.posture)
        if not self.channels:
            raise InputError("channels is empty. Allowed: at least one.")
        for channel in self.channels:
            if channel not in CHANNELS:
                raise UnknownNameError("channel", channel, CHANNELS)

    @property
    def device(self) -> Device:
        """The capsule, read by name or file if it is not in memory.

        Raises:
            InputError: If its file contains no device.
            UnknownNameError: If no device has the name.
        """
        return device_of(self.capsule)


def organ_named(organ: str) -> OrganGenerated | OrganFile:
    """Organ with a name, or from a file if the string is a path."""
    path = Path(organ)
    is_path = bool(path.suffix) or len(path.parts) > 1 or path.is_file()
    return OrganFile(organ) if is_path else OrganGenerated(organ)


def read_scenario(path: str | Path) -> Scenario:
    """Read a scenario from a JSON or TOML file, or from the `episode.json` of an episode.

    Raises:
        InputError: If the file cannot be read, or a key is unknown or has a wrong value.
    """
    return scenario_from_plain(read_plain_scenario(path), units=Path(path).suffix == ".toml")


def read_plain_scenario(path: str | Path) -> Any:
    """Contents of a scenario file, or the scenario in the `episode.json` of an episode.

    An organ recorded from memory is resolved relative to the current folder of its episode.

    Raises:
        InputError: If the file cannot be read.
    """
    path = Path(path)
    plain = read_plain(path, "scenario")
    if not (isinstance(plain, dict) and "format" in plain):
        return _with_effects_of_text(plain)
    plain = plain.get("scenario")
    organ = plain.get("organ") if isinstance(plain, dict) else None
    file = organ.get("path") if isinstance(organ, dict) else None
    if isinstance(file, dict) and Path(str(file.get("path"))).name == SOURCE_ORGAN:
        file["path"] = str(path.with_name(SOURCE_ORGAN))
    return _with_former_defaults(plain)


def _with_effects_of_text(plain: Any) -> Any:
    """Scenario whose effects, if given as a string such as `none`, are parsed into a table."""
    if isinstance(plain, dict) and isinstance(text := plain.get("effects"), str):
        return {**plain, "effects": to_plain(parse_effects(text), Effects)}
    return plain


def _with_former_defaults(plain: Any) -> Any:
    """Scenario of an episode, completed with the defaults of the version that recorded it.

    In earlier versions, a fly-through without a speed covered the whole stretch, and an adaptive
    frame rate was off if it was null in an episode with a stated exposure. An episode states all
    effects of its version: later ones are off. Nothing was drawn by prevalence.
    """
    if not isinstance(plain, dict):
        return plain
    plain = {"variation": False, **plain}
    motion, effects = plain.get("motion"), plain.get("effects")
    if isinstance(motion, dict) and motion.get("kind") == FlyThrough.kind:
        plain = {**plain, "motion": {"whole": motion.get("speed") is None, **motion}}
    if isinstance(effects, dict) and effects.get("auto_exposure") is not None:
        stated = {name: value for name, value in effects.items() if value is not None}
        off = to_plain(Effects.none(), Effects)
        plain = {**plain, "effects": {**off, **stated}}
    return plain


def read_lesions(path: str | Path) -> tuple[Lesion, ...]:
    """Read lesions from a JSON or TOML file: tables ``lesions``, as in a scenario.

    Raises:
        InputError: If the file cannot be read, or a key is unknown or has a wrong value.
    """
    plain = read_plain(Path(path), "lesions")
    if not isinstance(plain, dict) or set(plain) != {"lesions"}:
        raise InputError(f"{path} is not a lesion file. Allowed: tables [[lesions]] only.")
    return from_plain(tuple[Lesion, ...], plain["lesions"], at="lesions")


def parse_lesions(
    texts: Sequence[str], source: str | None, seed: int, organ: str
) -> tuple[Lesion, ...]:
    """Lesions of a file or of the prevalence table, followed by those given individually.

    Args:
        texts: Lesions in the syntax of `parse_lesion`.
        source: Path of a file, ``prevalence``, or None.
        seed: Seed of the patient, for the table.
        organ: Name or file of the organ that receives them; the table is for the colon.

    Raises:
        InputError: If a lesion or the file cannot be read, or the table is for another organ.
        UnknownNameError: If a lesion or a key is unknown.
    """
    if source == PREVALENCE:
        colons = [name for name in ORGANS if "sigmoid" in organ_segments(name)]
        if organ in ORGANS and organ not in colons:
            raise InputError(
                f"prevalence is a table of the colon, but the organ is {organ}. Allowed with it: "
                f"{', '.join(colons)}. Give single lesions, or a file of your own."
            )
        first: tuple[Lesion, ...] = draw_lesions(None, stream(seed, "lesions/drawn"))
    else:
        first = () if source is None else read_lesions(Path(source))
    return (*first, *(parse_lesion(text) for text in texts))


def scenario_to_plain(scenario: Scenario) -> dict[str, Any]:
    """Convert a scenario to its JSON form, in SI units.

    Raises:
        InputError: If its organ is in memory only; `record` writes such an organ to a file.
    """
    if isinstance(scenario.organ, OrganSurface):
        raise InputError("The organ is in memory. Write it with write_organ and give the file.")
    return to_plain(scenario, Scenario)


def scenario_from_plain(plain: Any, *, units: bool = False) -> Scenario:
    """Convert the output of `scenario_to_plain`, or a user's input with fewer keys, to a scenario.

    Args:
        plain: Contents of a JSON or TOML file.
        units: Whether the keys of a device in it are in the units of device files.

    Raises:
        InputError: If a key is unknown or has a wrong value; the message names it.
    """
    if not isinstance(plain, dict):
        raise InputError(f"A scenario is a table of keys, not {type(plain).__name__}.")
    return from_plain(Scenario, _with_effects_of_text(plain), at="", units=units)
