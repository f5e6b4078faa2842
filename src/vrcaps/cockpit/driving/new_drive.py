"""Scenario of the next drive, from the choices made in a browser; each error names its field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from vrcaps.actuation.arm.arm import arm_names
from vrcaps.actuation.coil_array import coil_array_names
from vrcaps.actuation.coil_program import CoilSteering
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.capsule.device_file import read_device
from vrcaps.cockpit.driving.drive_commands import require_known
from vrcaps.cockpit.driving.drive_setup import NO_ARM, NO_COILS, arm_name, coils_name, magnet_name
from vrcaps.cockpit.page import FieldError
from vrcaps.cockpit.server import is_loopback
from vrcaps.cockpit.session.drive import (
    CONTENTS,
    LASTING_EFFECTS,
    Choice,
    chosen_scenario,
    magnetic_capsules,
    require_magnet,
)
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.magnet.presets import magnet_names
from vrcaps.motion.dynamics import Dynamics
from vrcaps.organ.segments import ORGANS
from vrcaps.scenario.scenario import OrganGenerated

if TYPE_CHECKING:
    from vrcaps.cockpit.messages import NewDrive
    from vrcaps.scenario.scenario import Scenario

T = TypeVar("T")


def _at(field: str, function: Callable[[], T]) -> T:
    """Call a function; its error is about a field."""
    try:
        return function()
    except VrcapsError as error:
        raise FieldError(field, str(error)) from error


def next_scenario(scenario: Scenario, command: NewDrive, host: str) -> Scenario:
    """Return the scenario of the next drive.

    Args:
        scenario: Scenario of the current drive.
        command: Choices.
        host: Address that the server listens at: files are read only if no other machine can
            reach it.

    Raises:
        FieldError: If a choice cannot be used.
    """
    organ, capsule, file = command.organ, command.capsule, command.capsule_file.strip()
    if organ:
        _at("organ", lambda: require_known("organ", organ, ORGANS))
    if file:
        _at("capsule_file", lambda: _require_here(host))
        _at("capsule_file", lambda: require_magnet(read_device(file)))
    elif capsule and capsule != scenario.device.name:
        _at("capsule", lambda: require_known("capsule", capsule, magnetic_capsules()))
    else:
        capsule = ""
    known = (*CONTENTS, *LASTING_EFFECTS)
    for each in command.severities:
        _at("severities", lambda name=each.name: require_known("effect", name, known))
    moved = {each.name: each.severity for each in command.severities}
    choice = Choice(
        organ=organ or None,
        seed=None if command.seed == _seed(scenario) else command.seed,
        lesions=command.lesions,
        capsule=file or capsule or None,
        contents={name: value for name, value in moved.items() if name in CONTENTS},
        effects={name: value for name, value in moved.items() if name in LASTING_EFFECTS},
    )
    return _steered(_at("lesions", lambda: chosen_scenario(scenario, choice)), command)


def _seed(scenario: Scenario) -> int:
    """Seed of the patient, as the page shows it."""
    organ = scenario.organ
    return organ.seed if isinstance(organ, OrganGenerated) else 0


def _steered(scenario: Scenario, command: NewDrive) -> Scenario:
    """Scenario with the chosen magnet and arm, or coils."""
    motion = scenario.motion
    if not isinstance(motion, Dynamics):
        return scenario
    if command.coils and command.coils != coils_name(motion.coils):
        _at("coils", lambda: require_known("coils", command.coils, (NO_COILS, *coil_array_names())))
        coils = None if command.coils == NO_COILS else CoilSteering(coils=command.coils)
        magnet = None if coils else MagnetSteering(arm="panda")
        motion = replace(motion, coils=coils, magnet=magnet)
    steering = motion.magnet
    if steering is None:
        return replace(scenario, motion=motion)
    if command.magnet and command.magnet != magnet_name(steering):
        _at("magnet", lambda: require_known("magnet", command.magnet, magnet_names()))
        steering = replace(steering, magnet=command.magnet)
    if command.arm and command.arm != arm_name(steering):
        _at("arm", lambda: require_known("arm", command.arm, (NO_ARM, *arm_names())))
        steering = replace(steering, arm=None if command.arm == NO_ARM else command.arm)
    return replace(scenario, motion=replace(motion, magnet=steering))


def _require_here(host: str) -> None:
    """Check that only browsers of this machine can reach the page.

    Raises:
        InputError: If other machines can.
    """
    if not is_loopback(host):
        raise InputError(
            "A file is allowed only if no other machine can reach the page. Start the cockpit "
            "without --host, and forward the port."
        )
