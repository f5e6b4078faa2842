"""Resolution of a scenario, and construction of its world model and capsule motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from vrcaps.capsule.device import Device
from vrcaps.capsule.device_file import device_of
from vrcaps.config.file_ref import with_checksums
from vrcaps.render.channels import CHANNELS
from vrcaps.scenario.organ_source import OrganSource, resolve_organ
from vrcaps.scenario.scenario import Scenario, organ_named
from vrcaps.world.model import Model, posture_transform

if TYPE_CHECKING:
    from vrcaps.camera_pipeline.effects import Effects
    from vrcaps.motion.motion import Motion


@dataclass(frozen=True)
class ResolvedScenario:
    """Scenario without open settings, see `resolve`.

    Attributes:
        scenario: The scenario with all values filled in, as `episode.json` contains it.
        device: Capsule, without the effects of the scenario.
        organ: Source of the organ.
        fps: Frames per second.
        channels: Image channels, in the order of `Frame`.
        effects: Effects, each with one severity or exact parameters.
    """

    scenario: Scenario
    device: Device
    organ: OrganSource
    fps: float
    channels: tuple[str, ...]
    effects: Effects


def resolve(scenario: Scenario) -> ResolvedScenario:
    """Resolve all open settings of a scenario; those already filled in stay as they are.

    Fills in the frame rate, the capsule's own effects and the checksums of files, samples the
    severities of effects, and sorts the channels in the order of `Frame`.

    Raises:
        InputError: If a file does not match its checksum, or a mesh file has no unit.
        UnknownNameError: If the capsule is unknown.
    """
    device, given = device_of(scenario.capsule), scenario.organ
    organ = resolve_organ(organ_named(given) if isinstance(given, str) else given)
    fps = device.frame_rate if scenario.fps is None else scenario.fps
    channels = tuple(channel for channel in CHANNELS if channel in scenario.channels)
    effects = scenario.effects.of_device(device).sample(scenario.seed)
    motion = with_checksums(scenario.motion)
    scenario = replace(
        scenario, organ=organ, motion=motion, fps=fps, channels=channels, effects=effects
    )
    source = OrganSource(organ, scenario.lesions, scenario.posture, scenario.seed)
    return ResolvedScenario(scenario, device, source, fps, channels, effects)


def build(scenario: Scenario | ResolvedScenario) -> tuple[Model, Motion]:
    """Build the world and the motion of a scenario.

    The effects are applied to the capsule's cameras, the wall and the contents of the lumen.

    Returns:
        The model to render, without lesions for a clean twin, and the motion in it.

    Raises:
        InputError: As `resolve`, or if the organ cannot be made or the capsule cannot move in it.
        UnknownNameError: As `resolve`.
    """
    resolved = resolve(scenario) if isinstance(scenario, Scenario) else scenario
    scenario, effects = resolved.scenario, resolved.effects
    organ = effects.organ(resolved.organ.load())
    model = Model(
        organ,
        effects.device(resolved.device),
        posture_transform(scenario.posture),
        effects.contents(scenario.contents),
    )
    rendered = model
    if scenario.clean_twin:
        rendered = replace(model, organ=effects.organ(resolved.organ.load(clean=True)))
    motion = scenario.motion.begin(
        model, frames=scenario.frames, fps=resolved.fps, seed=scenario.seed, shown=rendered
    )
    return rendered, motion
