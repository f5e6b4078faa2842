"""Constants of the page of a drive, and quantities that it shows as numbers and charts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from vrcaps.actuation.arm.arm import arm_names
from vrcaps.actuation.coil_array import coil_array_names, read_coil_array
from vrcaps.camera_pipeline.effect.base import MAX_SEVERITY, ImageEffect
from vrcaps.camera_pipeline.effects import EFFECTS, SEVERITIES
from vrcaps.cockpit.scene.colorings import coloring_names
from vrcaps.cockpit.scene.nodes import CUTS
from vrcaps.cockpit.session.camera_images import LIVE_CHANNELS
from vrcaps.cockpit.session.drive import CONTENTS, LASTING_EFFECTS, magnetic_capsules
from vrcaps.core.units import DEG, MM
from vrcaps.magnet.presets import magnet_names
from vrcaps.organ.segments import ORGANS
from vrcaps.render.settings import Light
from vrcaps.scenario.scenario import OrganGenerated
from vrcaps.world.model import POSTURES

if TYPE_CHECKING:
    from vrcaps.actuation.coil_program import CoilSteering
    from vrcaps.actuation.steering_program import MagnetSteering
    from vrcaps.cockpit.session.camera_images import CameraImages
    from vrcaps.cockpit.session.clock import View
    from vrcaps.cockpit.session.seen_wall import SeenWall
    from vrcaps.cockpit.session.session import Session

SPEEDS = {"1/10": 0.1, "1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0}
"""Simulated time per real time, by label."""

IMAGING = ("white-light", "narrow-band")
"""Kinds of imaging of the live image."""

LIVE_EFFECTS = tuple(name for name in SEVERITIES if issubclass(EFFECTS[name], ImageEffect))
"""Image effects, which can change while the simulation runs. Effects of the capsule's cameras and
of the organ are chosen with a new drive."""

NO_COILS = "none"
"""Choice of a magnet instead of coils."""

NO_ARM = "none"
"""Choice of a magnet without an arm."""

CONTROLS = {
    "x+": "magnet to +x",
    "x-": "magnet to −x",
    "y+": "magnet to +y",
    "y-": "magnet to −y",
    "z+": "magnet up",
    "z-": "magnet down",
    "tilt-x+": "tilt about +x",
    "tilt-x-": "tilt about −x",
    "tilt-y+": "tilt about +y",
    "tilt-y-": "tilt about −y",
    "turn-z+": "turn about +z",
    "turn-z-": "turn about −z",
    "pause": "pause or resume",
    "step": "next frame",
    "snapshot": "save a snapshot",
    "policy": "start or stop the policy",
}
"""Functions that can be assigned to a gamepad's sticks and buttons, by name."""

_LIMITS = {
    "": "",
    "speed": "its maximum speed",
    "workspace": "the edge of its workspace",
    "unreachable": "the reach of the arm",
    "collision": "a collision of the arm",
    "current": "their maximum current",
    "temperature": "their temperature: a coil is switched off",
}
_LOST = {
    "misaligned": "the capsule is turned away from the field",
    "wrong_wall": "the capsule lies on another wall",
    "insufficient_force": "the force is too small",
    "stalled": "the capsule does not follow",
}


def limit_text(limit: str) -> str:
    """Text after "Magnet limited by" or "Coils limited by"; empty without a limit."""
    return _LIMITS.get(limit, limit.replace("_", " "))


def lost_text(lost: str) -> str:
    """Reason for a lost coupling, as text; empty while coupled."""
    return _LOST.get(lost, lost.replace("_", " "))


def magnet_name(steering: MagnetSteering) -> str:
    """Name of the magnet; one of a file is named after its shape."""
    magnet = steering.magnet
    return magnet if isinstance(magnet, str) else f"own {type(magnet).__name__.lower()}"


def arm_name(steering: MagnetSteering) -> str:
    """Name of the arm, or `NO_ARM`."""
    arm = steering.arm
    return NO_ARM if arm is None else arm if isinstance(arm, str) else arm.name


def coils_name(steering: CoilSteering | None) -> str:
    """Name of the coil array, or `NO_COILS`."""
    if steering is None:
        return NO_COILS
    names = (name for name in coil_array_names() if read_coil_array(name) == steering.array)
    return next(names, "own array")


def _controls(session: Session) -> dict[str, str]:
    """Functions of a gamepad; with coils they pull and turn the capsule."""
    if session.rollout.coils is None:
        return CONTROLS
    return {
        name: label.replace("magnet", "pull").replace("tilt", "torque").replace("turn", "torque")
        for name, label in CONTROLS.items()
    }


def _coils(session: Session) -> list[dict[str, float]]:
    """Limits of each coil; empty with a magnet."""
    program = session.rollout.coils
    if program is None:
        return []
    return [
        {"maxCurrent": coil.max_current, "maxTemperature": coil.max_temperature}
        for coil in program.array.coils
    ]


def drive_setup(session: Session, policies: tuple[str, ...]) -> dict[str, Any]:
    """Constants of the page.

    Args:
        session: Session of the drive.
        policies: Names of the offered policies; the first is preselected.
    """
    scenario, device = session.scenario, session.model.device
    cameras = [{"name": c.name, "width": c.width, "height": c.height} for c in device.cameras]
    return {
        "folder": str(session.drive.folder),
        "fps": session.rollout.fps,
        "cameras": cameras,
        "channels": list(LIVE_CHANNELS),
        "speeds": [{"label": f"{label} ×", "value": value} for label, value in SPEEDS.items()],
        "policies": list(policies),
        "controls": _controls(session),
        "coils": _coils(session),
        "hasMagnet": session.rollout.coils is None,
        "postures": list(POSTURES),
        "posture": scenario.posture,
        "lights": list(get_args(Light)),
        "imagings": list(IMAGING),
        "maxSeverity": MAX_SEVERITY,
        "liveEffects": [_effect(name) for name in LIVE_EFFECTS],
        "colorings": list(coloring_names(session.model.organ, is_live=True)),
        "cuts": [{"value": name, "label": label} for name, label in CUTS.items()],
        "quantities": [quantity.plain() for quantity in QUANTITIES],
        "chartSpan": SPAN,
        "newDrive": _new_drive(session),
    }


def _new_drive(session: Session) -> dict[str, Any]:
    """Choices of the next drive, and the current values."""
    scenario, organ = session.scenario, session.scenario.organ
    steering = session.rollout.settings.magnet
    is_generated = isinstance(organ, OrganGenerated)
    lasting = [
        {"name": name, "label": name, "hint": f"Severity of {name}", "severity": severity}
        for name in CONTENTS
        for severity in [_severity(getattr(scenario.contents, name))]
    ]
    return {
        "organs": list(ORGANS),
        "organ": organ.name if is_generated else session.model.organ.name,
        "seed": organ.seed if is_generated else 0,
        "capsules": list(magnetic_capsules()),
        "capsule": session.model.device.name,
        "magnets": list(magnet_names()),
        "magnet": "" if steering is None else magnet_name(steering),
        "arms": [NO_ARM, *arm_names()],
        "arm": NO_ARM if steering is None else arm_name(steering),
        "coilArrays": [NO_COILS, *coil_array_names()],
        "coils": coils_name(session.rollout.settings.coils),
        "severities": [
            *lasting,
            *(
                {**_effect(name), "severity": _severity(getattr(scenario.effects, name))}
                for name in LASTING_EFFECTS
            ),
        ],
    }


def _effect(name: str) -> dict[str, Any]:
    return {"name": name, "label": name.replace("_", " "), "hint": EFFECTS[name].summary()}


def _severity(given: Any) -> int:
    return given if isinstance(given, int) else 0


SPAN = 60.0
"""Simulated time [s] on the charts."""
_SPACING = 0.1
"""Simulated time [s] between points."""


@dataclass(frozen=True)
class Quantity:
    """Quantity of a drive.

    Attributes:
        name: Name in the page.
        unit: Unit; empty for a ratio.
        min_span: Minimum span of its chart, so that noise does not fill it.
        digits: Digits after the point.
        of: Returns its value; NaN where there is none.
    """

    name: str
    unit: str
    min_span: float
    digits: int
    of: Callable[[View, SeenWall, CameraImages], float]

    def plain(self) -> dict[str, Any]:
        """Description for the page."""
        return {
            "name": self.name,
            "unit": self.unit,
            "minSpan": self.min_span,
            "digits": self.digits,
        }


def _coupling(view: View) -> float:
    coupling = view.state.coupling
    return np.nan if coupling is None else float(1e3 * np.linalg.norm(coupling.force_world))


def _angle(view: View) -> float:
    coupling = view.state.coupling
    return np.nan if coupling is None else coupling.angle / DEG


def _contact(view: View) -> float:
    contact = view.state.contact
    return np.nan if contact is None else 1e3 * contact.normal_force_total


def _speed(view: View) -> float:
    return float(np.linalg.norm(view.state.linear_velocity_world)) / MM


QUANTITIES = (
    Quantity("Contact force", "mN", 20.0, 1, lambda view, seen, images: _contact(view)),
    Quantity("Speed", "mm/s", 5.0, 1, lambda view, seen, images: _speed(view)),
    Quantity("Magnetic force", "mN", 50.0, 1, lambda view, seen, images: _coupling(view)),
    Quantity("Angle to the field", "°", 10.0, 1, lambda view, seen, images: _angle(view)),
    Quantity("Coverage", "%", 5.0, 1, lambda view, seen, images: 100.0 * seen.fraction),
    Quantity("Exposure", "× nominal", 0.5, 2, lambda view, seen, images: images.exposure),
)
"""Quantities of a drive; the page initially shows the first two."""


class Readings:
    """Values of the quantities in the last minute.

    Attributes:
        latest: Last values.
    """

    def __init__(self, seen: SeenWall, images: CameraImages) -> None:
        self._seen, self._images = seen, images
        self.latest: tuple[float, ...] = (np.nan,) * len(QUANTITIES)
        self._rows: deque[tuple[float, ...]] = deque(maxlen=round(SPAN / _SPACING))

    def update(self, view: View) -> None:
        """Take the values of a view; after a rewind, drop later ones."""
        time = view.state.time
        if time < 0.0:  # the capsule is settling on the wall
            return
        self.latest = tuple(each.of(view, self._seen, self._images) for each in QUANTITIES)
        if self._rows and time < self._rows[-1][0]:
            kept = [row for row in self._rows if row[0] < time]
            self._rows.clear()
            self._rows.extend(kept)
        if not self._rows or time - self._rows[-1][0] >= _SPACING:
            self._rows.append((time, *self.latest))

    def history(self) -> list[list[float]]:
        """Rows of time [s] and values."""
        return [[round(float(value), 4) for value in row] for row in list(self._rows)]
