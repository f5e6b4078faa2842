"""Files of a drive, from which `record` records it again, and the scenario of the next drive."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vrcaps.actuation.coil_program import CoilCommand
from vrcaps.actuation.steering_program import JoystickCommand, MagnetSteering
from vrcaps.camera_pipeline.effect.base import ImageEffect
from vrcaps.camera_pipeline.effects import EFFECTS, SEVERITIES
from vrcaps.capsule.device_file import device_names, read_device
from vrcaps.core.errors import InputError
from vrcaps.core.fields import FileRef, path_of
from vrcaps.core.files import is_new_folder, remove_stale, write_bytes, write_json
from vrcaps.motion.dynamics import Dynamics
from vrcaps.organ.segments import ORGANS
from vrcaps.scenario.build import ResolvedScenario, resolve
from vrcaps.scenario.scenario import (
    MAX_FRAMES,
    PREVALENCE,
    SOURCE_ORGAN,
    OrganFile,
    OrganGenerated,
    Scenario,
    organ_named,
    parse_lesions,
    scenario_to_plain,
)

if TYPE_CHECKING:
    from vrcaps.capsule.device import Device
    from vrcaps.cockpit.session.operator import Operator
    from vrcaps.scenario.scenario import Scenario

COMMANDS_CSV = "commands.csv"
"""File of joystick commands, the input of `vrcaps record --steer`."""

DRIVE_JSON = "drive.json"
"""Scenario of the drive so far, an input of `vrcaps record`."""


def make_folder(folder: Path) -> None:
    """Create the folder of a drive; remnants of a run killed in its first second are removed.

    Raises:
        InputError: If it contains a drive or anything else, or cannot be created.
    """
    remove_stale(folder)
    if (folder / DRIVE_JSON).exists():
        raise InputError(
            f"{folder} contains a drive. Record it with `vrcaps record {folder / DRIVE_JSON} --out "
            "EPISODE`, or give a new or empty folder."
        )
    leftovers = [folder / COMMANDS_CSV, folder / SOURCE_ORGAN]  # written before DRIVE_JSON
    if folder.is_dir() and {*folder.iterdir()} <= {*leftovers}:
        for path in leftovers:
            path.unlink(missing_ok=True)
    if not is_new_folder(folder):
        raise InputError(f"{folder} is not empty. Give a new or empty folder.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"Cannot create the folder {folder}: {error.strerror}.") from error


class Drive:
    """Files of a drive in a folder: commands.csv and drive.json.

    Commands are appended to their file and synced to disk, so a crash loses only the commands since
    the last `save`.
    """

    def __init__(self, folder: Path, operator: Operator, scenario: Callable[[], Scenario]) -> None:
        """Create no file yet.

        Args:
            folder: See `make_folder`.
            operator: Operator whose commands are saved.
            scenario: Returns the scenario of the drive so far.
        """
        self.folder = folder
        self._operator, self._scenario = operator, scenario
        self._num_saved, self._num_rewound = 0, -1
        self._saving = threading.Lock()

    def save(self) -> Scenario:
        """Update both files; return the scenario of the drive so far.

        Raises:
            OSError: If a file cannot be written; the next call writes the missing part.
        """
        with self._saving:
            scenario = self._scenario()
            num_rewound, commands = self._operator.commands(self._num_saved)
            if num_rewound != self._num_rewound:
                _, commands = self._operator.commands()
                header = ",".join(self._operator.columns) + "\n"
                write_bytes(self.folder / COMMANDS_CSV, (header + _lines(commands)).encode())
                self._num_saved, self._num_rewound = len(commands), num_rewound
            elif commands:
                self._num_rewound = -1  # if this fails, the file may be incomplete: rewrite it
                _append(self.folder / COMMANDS_CSV, _lines(commands).encode())
                self._num_saved, self._num_rewound = self._num_saved + len(commands), num_rewound
            scenario = self.recorded(scenario)
            write_json(self.folder / DRIVE_JSON, scenario_to_plain(scenario))
            return scenario

    def recorded(self, scenario: Scenario) -> Scenario:
        """Scenario with the commands of the file, or with none if there are none."""
        motion = scenario.motion
        assert isinstance(motion, Dynamics)
        file = FileRef(str(self.folder / COMMANDS_CSV)) if self._num_saved else None
        still = () if file else (JoystickCommand(0.0),)
        if motion.coils is not None:
            coils = replace(motion.coils, joystick=still, currents=(), command_file=file)
            return replace(scenario, motion=replace(motion, coils=coils))
        assert motion.magnet is not None
        magnet = replace(motion.magnet, joystick=still, waypoints=(), command_file=file)
        return replace(scenario, motion=replace(motion, magnet=magnet))


def _lines(commands: list[JoystickCommand]) -> str:
    """Rows of a table of commands; each value is read back exactly."""
    rows = [
        (*(entry.time, *entry.linear, *entry.angular), *currents)
        for entry in commands
        for currents in [entry.currents if isinstance(entry, CoilCommand) else ()]
    ]
    return "".join(",".join(map(repr, row)) + "\n" for row in rows)


def _append(path: Path, data: bytes) -> None:
    with path.open("ab") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


NO_LESIONS = "none"
"""Value of the lesion text that removes all lesions."""

CONTENTS = ("bubbles", "chyme", "liquid")
"""Lumen contents that can be set, by severity."""

LASTING_EFFECTS = tuple(name for name in SEVERITIES if not issubclass(EFFECTS[name], ImageEffect))
"""Effects that are fixed during a drive: those of the capsule's cameras, of the wall and of the
lumen contents. Image effects can change at any time."""


@dataclass(frozen=True)
class Choice:
    """Changes to a scenario; omitted values stay the same.

    Attributes:
        organ: Name of a generated organ, or a file.
        seed: Seed of the patient.
        lesions: Names separated by spaces, `prevalence` for as many as in a screening
            patient has, or `none`.
        capsule: Name in the catalog, or a device file.
        contents: Severities by name, see `CONTENTS`.
        effects: Severities by name, see `LASTING_EFFECTS`.
    """

    organ: str | None = None
    seed: int | None = None
    lesions: str = ""
    capsule: str | None = None
    contents: Mapping[str, int] = field(default_factory=dict)
    effects: Mapping[str, int] = field(default_factory=dict)


def magnetic_capsules() -> tuple[str, ...]:
    """Names of the catalog's capsules that can be steered by magnet."""
    return tuple(name for name in device_names() if read_device(name).magnets)


def require_magnet(device: Device) -> None:
    """Check that a capsule can be steered by magnet.

    Raises:
        InputError: If it contains no magnet.
    """
    if not device.magnets:
        raise InputError(
            f"The capsule {device.name} contains no magnet, so none can steer it. Choose one of "
            f"{', '.join(magnetic_capsules())}, or a device file with [[magnets]]."
        )


def require_drivable(scenario: Scenario) -> None:
    """Check organ and capsule of a drive, before its world is built.

    Raises:
        InputError: If the file of the organ does not exist, or the capsule contains no magnet.
    """
    organ = scenario.organ
    if isinstance(organ, OrganFile) and not path_of(organ.path).is_file():
        raise InputError(
            f"No file at {path_of(organ.path)}. Give the path of an organ, or one of "
            f"{', '.join(ORGANS)}."
        )
    require_magnet(scenario.device)


def cockpit_scenario(scenario: Scenario) -> ResolvedScenario:
    """Return the scenario of a drive: a magnet or coils steered live, and explicit settings.

    A scenario without dynamics, or without a magnet and coils, gets the default ones; waypoints and
    recorded commands are replaced by the driver.
    """
    motion = scenario.motion
    if not isinstance(motion, Dynamics):
        motion = Dynamics(start=getattr(motion, "start", Dynamics.start), substep=2e-4)
    still = (JoystickCommand(0.0),)
    names = ("posture_changes", "insufflation", "flushes", "phase_three")
    orders: dict[str, Any] = dict.fromkeys(names, ())
    if motion.coils is not None:
        coils = replace(motion.coils, currents=(), command_file=None, joystick=still)
        motion = replace(motion, coils=coils, **orders)
    else:
        magnet = motion.magnet or MagnetSteering(arm="panda")
        magnet = replace(magnet, waypoints=(), command_file=None, joystick=still)
        motion = replace(motion, magnet=magnet, **orders)
    return resolve(replace(scenario, motion=motion, frames=MAX_FRAMES, variation=False))


def chosen_scenario(scenario: Scenario, choice: Choice) -> Scenario:
    """Return the scenario of the next drive.

    Args:
        scenario: Scenario of the previous drive.
        choice: Changes to it.

    Raises:
        InputError: If a lesion or a device file cannot be read, or a value is invalid.
        UnknownNameError: If a name of a lesion, capsule or generator is unknown.
    """
    changed: dict[str, Any] = {"organ": _organ(scenario, choice)}
    contents: dict[str, Any] = dict(choice.contents)
    if choice.seed is not None:
        contents["seed"] = choice.seed
    changed["contents"] = replace(scenario.contents, **contents)
    changed["effects"] = replace(scenario.effects, **choice.effects)
    if choice.lesions.strip():
        changed["lesions"] = _lesions(choice.lesions, changed["organ"], scenario.seed)
    if choice.capsule is not None:
        changed["capsule"] = read_device(choice.capsule)
        before = scenario.device
        if scenario.fps == before.frame_rate:
            changed["fps"] = None  # the capsule's own
        changed["effects"] = changed["effects"].without_device(before, scenario.seed)
    return replace(scenario, **changed)


def _organ(scenario: Scenario, choice: Choice) -> Any:
    organ = scenario.organ if choice.organ is None else organ_named(choice.organ)
    if isinstance(organ, OrganGenerated):
        seed = getattr(scenario.organ, "seed", 0) if choice.seed is None else choice.seed
        return replace(organ, seed=seed)
    return organ


def _lesions(text: str, organ: Any, seed: int) -> tuple[Any, ...]:
    words = text.split()
    if words == [NO_LESIONS]:
        return ()
    table = PREVALENCE if PREVALENCE in words else None
    is_generated = isinstance(organ, OrganGenerated)
    seed, name = (organ.seed, organ.name) if is_generated else (seed, "")
    return parse_lesions([word for word in words if word != PREVALENCE], table, seed, name)
