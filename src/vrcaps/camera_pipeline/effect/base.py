"""Base classes of the camera effects, and what their stages are told."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

from vrcaps.errors import InputError
from vrcaps.limits import check_fields

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import UInt8

    from vrcaps.camera.camera import Camera
    from vrcaps.lumen.contents import Contents
    from vrcaps.motion.step import Step
    from vrcaps.organ.surface import OrganSurface

Severity = int | tuple[int, int]
"""A severity from 0 to `MAX_SEVERITY`, or the first and last of a range to sample one from."""

MAX_SEVERITY = 4
_SEVERITY = re.compile(r"(\d+)(?:\.\.(\d+))?")


class Effect:
    """One effect of a camera, in physical parameters.

    A subclass is a frozen dataclass in a file of its own; a field of `Effects` names it.

    Attributes:
        name: Key in a scenario and in `--effects`.
        short: Short name in `--effects`; empty for none.
        acts_on: What it changes: the scene, the camera, the image or the timing.
        severities: Parameters of each severity from 0 to `MAX_SEVERITY`; None where the effect is
            off. Empty for an effect that has exact parameters only.
    """

    name: ClassVar[str]
    short: ClassVar[str] = ""
    acts_on: ClassVar[str]
    severities: ClassVar[tuple[Mapping[str, Any] | None, ...]] = ()

    def __post_init__(self) -> None:
        check_fields(self, of=type(self).__name__)

    @classmethod
    def at(cls, severity: int) -> Self | None:
        """The effect at a severity; None where it is off."""
        parameters = cls.severities[severity]
        return None if parameters is None else cls(**parameters)

    @classmethod
    def summary(cls) -> str:
        """What it does, in a line."""
        return (inspect.getdoc(cls) or "").partition("\n")[0]

    @classmethod
    def parse(cls, text: str) -> Severity | Self:
        """What `--effects NAME=TEXT` means; by default a severity or a range of severities.

        Raises:
            InputError: If the text is none.
        """
        found = _SEVERITY.fullmatch(text)
        if found is None:
            raise InputError(
                f"Effect {cls.name} has the severity {text!r}. Allowed: {cls.name}=0 to "
                f"{cls.name}={MAX_SEVERITY}, or a range such as {cls.name}=0..{MAX_SEVERITY}."
            )
        first, last = found.groups()
        return int(first) if last is None else (int(first), int(last))


class SceneEffect(Effect):
    """An effect on what the camera sees: on the organ or on the contents of the lumen."""

    acts_on: ClassVar[str] = "scene"

    def on_organ(self, organ: OrganSurface) -> OrganSurface:
        """The organ with the effect."""
        return organ

    def on_contents(self, contents: Contents) -> Contents:
        """The contents of the lumen with the effect."""
        return contents


class CameraEffect(Effect):
    """An effect on the camera itself, which is changed before anything is rendered."""

    acts_on: ClassVar[str] = "camera"

    def on(self, camera: Camera) -> Camera:
        """The camera with the effect."""
        raise NotImplementedError


class ImageEffect(Effect):
    """An effect on the image: a stage of the pipeline that the compiled core runs.

    Attributes:
        needs: Channels of the renderer that the stage reads.
        needs_motion: Whether the stage reads where points appear in a neighboring frame.
    """

    acts_on: ClassVar[str] = "image"
    needs: ClassVar[tuple[str, ...]] = ()
    needs_motion: ClassVar[bool] = False

    def params(self, setup: CameraSetup) -> Any:
        """Parameters that no frame changes, as the core's stage of this name takes them."""

    def stage(self, setup: CameraSetup) -> Stage:
        """The stage of one camera."""
        return Stage(self.params(setup))


class TimingEffect(Effect):
    """An effect on which frames the capsule captures."""

    acts_on: ClassVar[str] = "timing"


class Stage:
    """A stage of one camera's pipeline.

    Attributes:
        params: Parameters that no frame changes; None where there are none.
    """

    def __init__(self, params: Any = None) -> None:
        """Keeps the parameters."""
        self.params = params

    def frame_params(self, frame: FrameContext) -> Any:
        """Parameters of one frame; None where there are none."""

    def mark_dome(self, label: UInt8[np.ndarray, "h w"], time: float) -> None:
        """Writes what it puts on the dome into the channel `dome_label`."""


_Kind = TypeVar("_Kind", bound=ImageEffect)


@dataclass(frozen=True)
class CameraSetup:
    """What a stage may know when the pipeline of a camera is made.

    Attributes:
        camera: With all camera effects.
        number: Which of the capsule's cameras.
        fps: Frames per second.
        seed: Of all random numbers.
        effects: Image effects that are on.
    """

    camera: Camera
    number: int = 0
    fps: float = 1.0
    seed: int = 0
    effects: tuple[ImageEffect, ...] = field(default_factory=tuple)

    def find(self, kind: type[_Kind]) -> _Kind | None:
        """The effect of a class; None where it is off."""
        return next((effect for effect in self.effects if isinstance(effect, kind)), None)


@dataclass(frozen=True)
class FrameContext:
    """What a stage may know of a frame.

    Attributes:
        step: State of the world, with its neighbors in time.
        exposure: Relative to the camera's own, as automatic exposure has set it.
        channels: Channels that the renderer gave, among them those that stages need.
    """

    step: Step
    exposure: float
    channels: Mapping[str, np.ndarray]
