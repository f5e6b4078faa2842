"""Flags that set values of a scenario; types and help come from the scenario's own tree."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field, make_dataclass
from typing import Annotated, Any, Literal, get_args, get_origin

from tyro.conf import UseAppendAction, arg

from vrcaps.motion.motion import MOTIONS
from vrcaps.scenario.scenario import OrganFile, organ_named
from vrcaps.scenario.settings import Setting, settings

_PATHS = {
    "unit": "organ.unit",
    "distension": "organ.distension",
    "mucosa": "organ.mucosa",
    "patient_seed": "organ.seed",
    "posture": "posture",
    "clean_twin": "clean_twin",
    "capsule": "capsule",
    "start": "motion.start",
    "end": "motion.end",
    "speed": "motion.speed",
    "whole": "motion.whole",
    "pose": "motion.magnet.pose",
    "steer": "motion.magnet.command_file",
    "frames": "frames",
    "fps": "fps",
    "seed": "seed",
    "channels": "channels",
    "light": "render.light",
    "wall": "wall",
}
"""Flags that set one value of the scenario, by the path of that value."""

_HELP = {
    "seed": "Seed of all random values: the generated patient (organ, lesions and contents, "
    "unless --patient-seed is given), the motion, the mucosa of an organ from a file, sampled "
    "effects, and the noise of camera and sensors. The same seed gives the same bytes.",
    "patient_seed": "Seed of the patient only: generated organ, lesions and contents of the lumen; "
    "by default --seed. The same patient can thus be recorded with several motions.",
    "steer": "CSV file of commands of the magnet: waypoints or joystick axes, see `read_commands`. "
    "For a motion with coils and no magnet it is motion.coils.command_file: currents or joystick "
    "axes.",
}
"""Help of flags that set more than the value of their path."""

_MOTIONS: Any = Literal[tuple(MOTIONS)]  # with those of plug-ins


def _flags(name: str, doc: str, *flags: str, **others: tuple[Any, Any, str]) -> Any:
    """Group of flags: those of `_PATHS` by name, with type and help from the scenario's tree.

    Args:
        name: Name of the class.
        doc: Heading of the group in the help.
        flags: Keys of `_PATHS`.
        others: Type, default and help of flags with their own text.
    """
    known = {setting.path: setting for setting in reversed([*settings()])}
    entries = []
    for flag, (declared, default, text) in others.items():
        about = arg(help=text, help_behavior_hint="")
        entries.append((flag, Annotated[declared, about], field(default=default)))
    entries += [_entry(flag, known[_PATHS[flag]]) for flag in flags]
    group = make_dataclass(name, entries, frozen=True)
    group.__doc__ = doc
    return group


def _entry(flag: str, setting: Setting) -> tuple[str, Any, Any]:
    declared = setting.declared
    if get_origin(declared) is Annotated:
        declared = get_args(declared)[0]
    if flag in ("capsule", "mucosa", "steer"):
        declared = str
    is_switch = declared is bool
    about = arg(
        help=_HELP.get(flag, setting.doc),
        help_behavior_hint=f"[{setting.path}: {setting.default_text}]",
    )
    declared = bool if is_switch else declared | None
    return flag, Annotated[declared, about], field(default=False if is_switch else None)


_LESION = """Lesion to put into the organ; repeat for more. A kind, then the settings that differ
from its defaults: polyp-Ip:size=12mm,segment=sigmoid, colitis-2, bleeding-3. vrcaps organ list
lists all."""
_EFFECTS = """Camera effects by severity 0 to 4, such as dof=1,noise=2, noise=1..3 (a range, sampled
by the seed), all=2, random (three to five effects at severity 1 or 2), ae=settled, bayer=rggb,
afr=4..35; default is the capsule's own camera, nominal that of its model without differences
between units, none an ideal camera of fixed exposure. An effect that is not named is the capsule's
own. vrcaps organ list lists all effects."""

OrganFlags = _flags(
    "Organ",
    "Organ and patient.",
    *("unit", "distension", "mucosa", "patient_seed", "posture", "clean_twin"),
    organ=(
        str | None,
        None,
        "Name of a generated organ (colon, stomach, small-bowel, full-tract), a mesh file (PLY, "
        "OBJ, STL, GLB), or an organ file that vrcaps organ wrote.",
    ),
    lesion=(UseAppendAction[tuple[str, ...]], (), _LESION),
    lesions=(
        str | None,
        None,
        "File of lesions (TOML or JSON), or prevalence: as many as a screening patient has.",
    ),
    preparation=(
        int | None,
        None,
        "Bowel preparation by the Boston scale: 3 clean, 2 fragments, 1 stool and turbid liquid, "
        "0 stool everywhere. Sets the contents of the lumen.",
    ),
)
MotionFlags = _flags(
    "Motion",
    "Capsule and motion.",
    *("capsule", "start", "end", "speed", "whole", "pose", "steer"),
    motion=(
        _MOTIONS | None,
        None,
        "Motion of the capsule: along the centerline, between random positions to look at lesions "
        "and wall, along a recorded path (--set motion.path=…), or by gravity, contact, muscle "
        "and magnets.",
    ),
)
ImageFlags = _flags(
    "Images",
    "Images and measurements.",
    *("frames", "fps", "seed", "channels", "light", "wall"),
    effects=(str | None, None, _EFFECTS),
    sensors=(
        tuple[Literal["imu", "magnetometer", "hall"], ...],
        (),
        "Sensors to read in each frame, as columns of frames.parquet: imu and magnetometer "
        "in the capsule, hall under the patient.",
    ),
)


def changes(flags: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Path and plain value of all changes of the flags to a scenario, in order, without `steer`.

    Args:
        flags: Values of all groups of flags by name.

    Raises:
        InputError: If a value cannot be parsed.
        UnknownNameError: If an effect is unknown.
    """
    yield from _patient_changes(flags)
    if flags["motion"] is not None:
        yield "motion.kind", flags["motion"]
    for flag, path in _PATHS.items():
        value = flags[flag]
        if flag == "channels" and value is not None:  # rgb,depth is accepted as well
            value = " ".join(value).replace(",", " ").split()
        if value is not None and value is not False and flag not in ("patient_seed", "steer"):
            yield path, list(value) if isinstance(value, tuple) else value
    for name in flags["sensors"]:
        yield f"sensors.{name}", {}
    if flags["effects"] is not None:
        yield from _effect_changes(flags["effects"])


def steer_path(plain: Mapping[str, Any]) -> str:
    """Path of the file of commands in a plain scenario: that of the coils if they act alone."""
    motion = plain.get("motion")
    motion = motion if isinstance(motion, Mapping) else {}
    has_coils = motion.get("coils") is not None and motion.get("magnet") is None
    return "motion.coils.command_file" if has_coils else _PATHS["steer"]


def _patient_changes(flags: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The organ, the contents of its lumen, and the seed of both."""
    from vrcaps.config.convert import to_plain
    from vrcaps.lumen.contents import Contents
    from vrcaps.lumen.preparation import prepared

    is_file = False
    if flags["organ"] is not None:
        is_file = isinstance(organ_named(flags["organ"]), OrganFile)
        table = {"kind": "file", "path": flags["organ"]}
        yield "organ", table if is_file else {"kind": "generated", "name": flags["organ"]}
    if flags["preparation"] is not None:
        yield "contents", to_plain(prepared(flags["preparation"]), Contents)
    seed = flags["seed"] if flags["patient_seed"] is None else flags["patient_seed"]
    if seed is not None:
        yield "contents.seed", seed
    if flags["patient_seed"] is not None or (seed is not None and not is_file):
        yield "organ.seed", seed


def _effect_changes(text: str) -> Iterator[tuple[str, Any]]:
    from vrcaps.camera_pipeline.effect.base import SceneEffect
    from vrcaps.camera_pipeline.effects import EFFECTS, RESETS, Effects, parse_effects
    from vrcaps.config.convert import to_plain

    is_reset = any(item.strip() in RESETS for item in text.split(","))
    of_scene = [name for name, kind in EFFECTS.items() if issubclass(kind, SceneEffect)]
    for name, value in to_plain(parse_effects(text), Effects).items():
        is_given = value is not None and value is not False
        if is_given or (is_reset and name not in of_scene):
            yield f"effects.{name}", value
