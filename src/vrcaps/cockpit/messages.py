"""Messages between a browser and the server, as JSON: commands to the server, and its answers.

A command is JSON such as ``{"id": 7, "command": "rewind", "snapshot": "1.20 s"}``; its fields
are checked here, once, for type and range. An answer has the key `type`. Images are binary: one
byte that names the image, see `IMAGE_KINDS`, then a JPEG file.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import Annotated, Any, ClassVar, Literal

from vrcaps.camera_pipeline.effect.base import MAX_SEVERITY
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields

MAX_COMMAND = 8192
"""Maximum length of a command [characters]."""

IMAGE_KINDS = {"camera": 1, "map": 2, "other camera": 3}
"""First byte of a binary message."""


class Command:
    """Command of a browser.

    Attributes:
        name: Value of the key `command`.
        by_driver: Whether only the browser that drives may send it.
    """

    name: ClassVar[str]
    by_driver: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class SetCamera(Command):
    """Show another camera or channel."""

    name = "set-camera"
    by_driver = False
    camera: str
    channel: str


@dataclass(frozen=True)
class SetScene(Command):
    """Change the display of the scene.

    Attributes:
        coloring: Name of a coloring of the organ.
        opacity: Opacity of the organ.
        cut: Cut of the organ, see `scene.nodes.CUTS`.
        cut_fraction: Position of a cut across an axis, from the lowest point to the highest.
        has_lines: Whether field lines are shown.
        has_patient: Whether patient and table are shown.
    """

    name = "set-scene"
    by_driver = False
    coloring: str
    opacity: Annotated[float, Range(0.05, 1.0)]
    cut: Literal["capsule", "none", "x", "y", "z"]
    cut_fraction: Annotated[float, Range(0.0, 1.0)]
    has_lines: bool
    has_patient: bool


@dataclass(frozen=True)
class FrameView(Command):
    """Move the viewpoint of this browser so that a target fills the scene."""

    name = "frame-view"
    by_driver = False
    target: Literal["capsule", "organ", "all"]


@dataclass(frozen=True)
class ReportFrameRate(Command):
    """Report how many frames per second this browser draws."""

    name = "report-frame-rate"
    by_driver = False
    rate: Annotated[float, Range(0.0, 1e4)]


@dataclass(frozen=True)
class SetSpeed(Command):
    """Set simulated or recorded time per real time."""

    name = "set-speed"
    speed: Annotated[float, Range(0.05, 8.0)]


@dataclass(frozen=True)
class Steer(Command):
    """Hold the axes of keys or a gamepad, along and about the world's x, y and z."""

    name = "steer"
    axes: tuple[float, float, float, float, float, float]

    def __post_init__(self) -> None:
        if not all(-1.0 <= axis <= 1.0 for axis in self.axes):
            raise InputError("axes are out of range. Allowed: six numbers from -1 to 1.")


@dataclass(frozen=True)
class SetCurrent(Command):
    """Set the current of a coil, counted from 1 [A]; the axes are released."""

    name = "set-current"
    coil: Annotated[int, Range(1, 64)]
    current: Annotated[float, Range(-1e6, 1e6, unit="A")]


@dataclass(frozen=True)
class Pause(Command):
    """Pause the simulation."""

    name = "pause"


@dataclass(frozen=True)
class Resume(Command):
    """Resume the simulation."""

    name = "resume"


@dataclass(frozen=True)
class StepFrame(Command):
    """Pause after one more frame."""

    name = "step-frame"


@dataclass(frozen=True)
class Reset(Command):
    """Rewind to the first frame."""

    name = "reset"


@dataclass(frozen=True)
class SaveSnapshot(Command):
    """Save a snapshot of the last frame."""

    name = "save-snapshot"


@dataclass(frozen=True)
class Rewind(Command):
    """Rewind to a snapshot; everything after it is dropped."""

    name = "rewind"
    snapshot: str


@dataclass(frozen=True)
class TakeControl(Command):
    """Make this browser the driver."""

    name = "take-control"
    by_driver = False


@dataclass(frozen=True)
class StopMagnet(Command):
    """Release all input; the requested pose of the magnet stays the same."""

    name = "stop-magnet"


@dataclass(frozen=True)
class StartPolicy(Command):
    """Let a policy drive.

    Attributes:
        policy: One of the offered policies.
        goal: Target of a policy that navigates, as a fraction of the centerline.
    """

    name = "start-policy"
    policy: str
    goal: Annotated[float, Range(0.0, 1.0)] = 1.0


@dataclass(frozen=True)
class Record(Command):
    """Record an episode of the drive so far."""

    name = "record"


@dataclass(frozen=True)
class TurnPatient(Command):
    """Turn the patient to a posture."""

    name = "turn-patient"
    posture: str


@dataclass(frozen=True)
class Insufflate(Command):
    """Inflate or deflate the gut to a factor on its radius."""

    name = "insufflate"
    factor: Annotated[float, Range(0.6, 1.6)]


@dataclass(frozen=True)
class Flush(Command):
    """Wash off bubbles and chyme around the capsule."""

    name = "flush"


@dataclass(frozen=True)
class StartPhaseThree(Command):
    """Start phase III of the migrating motor complex at the capsule."""

    name = "start-phase-three"


@dataclass(frozen=True)
class Severity:
    """Severity of an effect or of a kind of lumen contents."""

    name: str
    severity: Annotated[int, Range(0, MAX_SEVERITY)]

    def __post_init__(self) -> None:
        check_fields(self, self.name[:40])


@dataclass(frozen=True)
class SetRendering(Command):
    """Set light, imaging and image effects of the live image and of later recordings."""

    name = "set-rendering"
    light: str
    imaging: str
    always_shadows: bool
    effects: tuple[Severity, ...] = ()


@dataclass(frozen=True)
class NewDrive(Command):
    """End the drive, which is saved, and start another one; an empty string keeps a setting.

    Attributes:
        organ: Name of a generated organ.
        seed: Seed of the patient.
        lesions: Lesions as for `--lesion`, `prevalence` or `none`.
        capsule: Name in the catalog; `capsule_file` is a device file instead.
        magnet: Name of the magnet.
        arm: Name of the arm, or `none`.
        coils: Name of a coil array instead of the magnet, or `none`.
        severities: Of lumen contents and of effects that last for a drive.
    """

    name = "new-drive"
    organ: str = ""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    lesions: str = ""
    capsule: str = ""
    capsule_file: str = ""
    magnet: str = ""
    arm: str = ""
    coils: str = ""
    severities: tuple[Severity, ...] = ()


@dataclass(frozen=True)
class SelectFrame(Command):
    """Show a frame of an episode."""

    name = "select-frame"
    by_driver = False
    frame: Annotated[int, Range(0, 2**31 - 1)]


@dataclass(frozen=True)
class Align(Command):
    """Align the estimated path to the true one."""

    name = "align"
    by_driver = False
    alignment: str


@dataclass(frozen=True)
class Acknowledgement:
    """Answer to a command.

    Attributes:
        id: ID of the command.
        error: Reason why it was rejected; empty if it was accepted.
        field: Field of the command that the error is about; empty for the whole.
    """

    type: ClassVar[str] = "acknowledgement"
    id: int
    error: str = ""
    field: str = ""


@dataclass(frozen=True)
class Notice:
    """Message for the user."""

    type: ClassVar[str] = "notice"
    text: str
    is_error: bool = False


@dataclass(frozen=True)
class Viewpoint:
    """Orientation and scale of a browser's scene.

    Attributes:
        world: Directions of the world's x, y, z on the screen: right, up, towards the viewer.
        patient: The same for the patient's left, posterior and superior directions.
        height: Height of the visible part at the point that is looked at [m].
    """

    world: list[list[float]]
    patient: list[list[float]]
    height: float


@dataclass(frozen=True)
class Setup:
    """Constants of a page, sent when a browser opens it and when another drive starts.

    Attributes:
        client: Number of the browser.
        values: All else, by name.
    """

    type: ClassVar[str] = "setup"
    client: int
    values: dict[str, Any]


@dataclass(frozen=True)
class Status:
    """Current values of a page, sent about 15 times a second.

    Attributes:
        values: Values by name.
        viewpoint: Viewpoint of this browser; None before its scene is open.
    """

    type: ClassVar[str] = "status"
    values: dict[str, Any]
    viewpoint: Viewpoint | None = None


def encode(message: Acknowledgement | Notice | Setup | Status) -> str:
    """Encode an answer as JSON; numbers that are not finite become null."""
    plain = {"type": message.type, **asdict(message)}
    try:
        return json.dumps(plain, allow_nan=False)
    except ValueError:
        return json.dumps(_finite(plain))


def _finite(plain: Any) -> Any:
    if isinstance(plain, dict):
        return {key: _finite(value) for key, value in plain.items()}
    if isinstance(plain, list | tuple):
        return [_finite(value) for value in plain]
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
