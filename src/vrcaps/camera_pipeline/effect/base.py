"""Base classes of the camera effects, and the inputs of their stages."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

from vrcaps.core.errors import InputError
from vrcaps.core.fields import check_fields

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import UInt8

    from vrcaps.camera.camera import Camera
    from vrcaps.lumen.contents import Contents
    from vrcaps.motion.motion import Step
    from vrcaps.organ.surface import OrganSurface

Severity = int | tuple[int, int]
"""A severity from 0 to `MAX_SEVERITY`, or the first and last of a range to sample from."""

MAX_SEVERITY = 4
_SEVERITY = re.compile(r"([0-9]{1,9})(?:\.\.([0-9]{1,9}))?")


class Effect:
    """Effect of a camera, in physical parameters.

    A subclass is a frozen dataclass in the file of its stage, with a field in `Effects`.

    Attributes:
        name: Key in a scenario and in `--effects`.
        short: Short name in `--effects`; empty for none.
        acts_on: Target of the effect: the scene, the camera, the image or the timing.
        severities: Parameters of each severity from 0 to `MAX_SEVERITY`; None for off. Empty for an
            effect that only has exact parameters.
    """

    name: ClassVar[str]
    short: ClassVar[str] = ""
    acts_on: ClassVar[str]
    severities: ClassVar[tuple[Mapping[str, Any] | None, ...]] = ()

    def __post_init__(self) -> None:
        check_fields(self, of=type(self).__name__)

    @classmethod
    def at(cls, severity: int) -> Self | None:
        """Return the effect at a severity; None for off."""
        parameters = cls.severities[severity]
        return None if parameters is None else cls(**parameters)

    @classmethod
    def summary(cls) -> str:
        """One-line description: the first line of the docstring."""
        return (inspect.getdoc(cls) or "").partition("\n")[0]

    @classmethod
    def parse(cls, text: str) -> Severity | Self:
        """Parse TEXT of `--effects NAME=TEXT`; by default a severity or a range of severities.

        Raises:
            InputError: If the text is invalid.
        """
        match = _SEVERITY.fullmatch(text)
        if match is None:
            raise InputError(
                f"Effect {cls.name} has the severity {text!r}. Allowed: {cls.name}=0 to "
                f"{cls.name}={MAX_SEVERITY}, or a range such as {cls.name}=0..{MAX_SEVERITY}."
            )
        first, last = match.groups()
        return int(first) if last is None else (int(first), int(last))


class SceneEffect(Effect):
    """Effect on the scene: on the organ or on the contents of the lumen."""

    acts_on: ClassVar[str] = "scene"

    def on_organ(self, organ: OrganSurface) -> OrganSurface:
        """Return the organ with the effect applied."""
        return organ

    def on_contents(self, contents: Contents) -> Contents:
        """Return the contents of the lumen with the effect applied."""
        return contents


class CameraEffect(Effect):
    """Effect on the camera itself, which is changed before rendering."""

    acts_on: ClassVar[str] = "camera"

    def on(self, camera: Camera) -> Camera:
        """Return the camera with the effect applied."""
        raise NotImplementedError


class ImageEffect(Effect):
    """Effect on the image: a stage of the pipeline in the compiled core.

    Attributes:
        needs: Channels of the renderer that the stage reads.
        needs_motion: Whether the stage reads apparent points in a neighboring frame.
    """

    acts_on: ClassVar[str] = "image"
    needs: ClassVar[tuple[str, ...]] = ()
    needs_motion: ClassVar[bool] = False

    def params(self, setup: CameraSetup) -> Any:
        """Parameters constant over frames, in the form of the core's stage of this name."""

    def stage(self, setup: CameraSetup) -> Stage:
        """Create the stage for one camera."""
        return Stage(self.params(setup))


class TimingEffect(Effect):
    """Effect on the timing of captured frames."""

    acts_on: ClassVar[str] = "timing"


class Stage:
    """Stage of one camera's pipeline.

    Attributes:
        params: Parameters that are constant over frames; None if there are none.
    """

    def __init__(self, params: Any = None) -> None:
        """Set the parameters."""
        self.params = params

    def frame_params(self, frame: FrameContext) -> Any:
        """Parameters of one frame; None if there are none."""

    def mark_dome(self, label: UInt8[np.ndarray, "h w"], time: float) -> None:
        """Draw its matter on the dome into the channel `dome_label`."""


_Kind = TypeVar("_Kind", bound=ImageEffect)


@dataclass(frozen=True)
class CameraSetup:
    """Inputs of a stage on creation of a camera's pipeline.

    Attributes:
        camera: Camera with all camera effects applied.
        camera_index: Index of the camera in the capsule.
        fps: Frames per second.
        seed: Seed of all random numbers.
        effects: Image effects that are on.
    """

    camera: Camera
    camera_index: int = 0
    fps: float = 1.0
    seed: int = 0
    effects: tuple[ImageEffect, ...] = field(default_factory=tuple)

    def find(self, kind: type[_Kind]) -> _Kind | None:
        """Return the effect of a class; None if it is off."""
        return next((effect for effect in self.effects if isinstance(effect, kind)), None)


@dataclass(frozen=True)
class FrameContext:
    """Inputs of a stage for one frame.

    Attributes:
        step: State of the world, with its neighbors in time.
        exposure: Exposure relative to the camera's own, as set by automatic exposure.
        channels: Channels from the renderer, including those that stages need.
    """

    step: Step
    exposure: float
    channels: Mapping[str, np.ndarray]
