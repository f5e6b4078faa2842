"""Resolution of a scenario, and construction of its organ, world model and capsule motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.capsule.device import Device
from vrcaps.config.convert import to_plain
from vrcaps.core.errors import InputError, require_extra
from vrcaps.core.fields import path_of, with_checksums
from vrcaps.core.units import LENGTH_UNITS
from vrcaps.lesion import Lesion, LesionPair, add_lesions, lesion_rng
from vrcaps.lesion.placement import require_possible
from vrcaps.mucosa.mucosa import MucosaSettings
from vrcaps.organ.organ_file import is_organ_file
from vrcaps.organ.segments import ORGANS
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.channels import CHANNELS
from vrcaps.scenario.scenario import OrganFile, OrganGenerated, Scenario, organ_named
from vrcaps.scenario.variation import varied
from vrcaps.world.model import Model, posture_transform

if TYPE_CHECKING:
    from vrcaps.camera_pipeline.effects import Effects
    from vrcaps.motion.motion import Motion

Organ = OrganGenerated | OrganFile | OrganSurface
"""Generator, file, or organ in memory."""


@dataclass(frozen=True)
class ResolvedScenario:
    """Scenario without open settings, see `resolve`.

    The capsule's unit is drawn when its effects are first needed: organ, capsule and motion do not
    depend on it.

    Attributes:
        given: The scenario with all values filled in but the capsule's own effects.
        device: Nominal capsule, without effects on its cameras.
        organ: Source of the organ.
        fps: Frames per second.
        channels: Image channels, in the order of `Frame`.
    """

    given: Scenario
    device: Device
    organ: OrganSource
    fps: float
    channels: tuple[str, ...]

    @cached_property
    def effects(self) -> Effects:
        """Effects, each with one severity or exact parameters, the capsule's own included."""
        return self.given.effects.of_device(self.device, self.given.seed)

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario with all values filled in, as `episode.json` contains it."""
        return replace(self.given, effects=self.effects)

    @cached_property
    def unit(self) -> Device:
        """Capsule with the camera effects on its cameras: LEDs, lens and resolution of its unit."""
        return self.effects.device(self.device)


def resolve(scenario: Scenario) -> ResolvedScenario:
    """Resolve all open settings of a scenario; those already filled in stay as they are.

    Fills in the frame rate, the capsule's own effects and the checksums of files, draws open
    settings by prevalence, samples the severities of effects, and sorts the channels in the order
    of `Frame`.

    Raises:
        InputError: If a file does not match its checksum, or a mesh file has no unit.
        UnknownNameError: If the capsule is unknown.
    """
    scenario = varied(scenario)
    device, given = scenario.device, scenario.organ
    organ = resolve_organ(organ_named(given) if isinstance(given, str) else given)
    fps = device.frame_rate if scenario.fps is None else scenario.fps
    channels = tuple(channel for channel in CHANNELS if channel in scenario.channels)
    effects = scenario.effects.sample(scenario.seed)
    motion = with_checksums(scenario.motion)
    scenario = replace(
        scenario, organ=organ, motion=motion, fps=fps, channels=channels, effects=effects
    )
    source = OrganSource(organ, scenario.lesions, scenario.posture, scenario.seed)
    return ResolvedScenario(scenario, device, source, fps, channels)


def build(scenario: Scenario | ResolvedScenario) -> tuple[Model, Motion]:
    """Build the world and the motion of a scenario.

    The effects on the scene are applied to the wall and to the contents of the lumen; those on the
    cameras by `CameraPipeline`, which the nominal capsule of the model does not contain.

    Returns:
        The model to render, without lesions for a clean twin, and the motion in it.

    Raises:
        InputError: As `resolve`, or if the organ cannot be made or the capsule cannot move in it.
        UnknownNameError: As `resolve`.
    """
    resolved = resolve(scenario) if isinstance(scenario, Scenario) else scenario
    scenario, effects = resolved.given, resolved.given.effects
    source = resolved.organ
    organ, clean = source.load_pair() if scenario.clean_twin else (source.load(), None)
    model = Model(
        effects.organ(organ),
        resolved.device,
        posture_transform(scenario.posture),
        effects.contents(scenario.contents),
    )
    rendered = model if clean is None else replace(model, organ=effects.organ(clean))
    motion = scenario.motion.begin(
        model, frames=scenario.frames, fps=resolved.fps, seed=scenario.seed, shown=rendered
    )
    return rendered, motion


@dataclass(frozen=True)
class OrganSource:
    """Organ of a resolved scenario: its generator or file, and the lesions to add.

    Attributes:
        given: Generator, file, or organ in memory.
        lesions: Lesions to add.
        posture: Posture of the patient: some lesions lie at the lowest point.
        seed: Seed of the mucosa of an organ that has none, and of lesions in it.
    """

    given: Organ
    lesions: tuple[Lesion, ...] = ()
    posture: str = "supine"
    seed: int = 0

    def load(self, *, clean: bool = False) -> OrganSurface:
        """Organ with its lesions, or its clean twin without them.

        An organ with lesions is generated once and then read from the user's cache folder.

        Raises:
            InputError: If the organ cannot be generated or read, or a lesion does not fit in it.
        """
        if not self.lesions:
            return self._require_clean(self.load_healthy()) if clean else self.load_healthy()
        return self._load(self._with_lesions, clean=clean)

    def load_pair(self) -> tuple[OrganSurface, OrganSurface]:
        """Organ with its lesions and its clean twin; lesions are added once for both.

        Raises:
            InputError: As `load`.
        """
        if not self.lesions:
            organ = self.load(clean=True)
            return organ, organ
        make = cache(self._with_lesions)
        return self._load(make, clean=False), self._load(make, clean=True)

    def _load(self, make: Callable[[], LesionPair], *, clean: bool) -> OrganSurface:
        """Organ with its lesions or clean twin, from the cache or from the pair."""
        from vrcaps.organ.cache import cached_organ, fingerprint

        def made() -> OrganSurface:
            return make().clean if clean else make().organ

        if isinstance(self.given, OrganGenerated):  # check before minutes of work
            require_possible(self.lesions, _max_diameter(self.given))
        if isinstance(self.given, OrganSurface):
            return made()
        key = {
            "lesions": to_plain(self.lesions, tuple[Lesion, ...]),
            "organ": asdict(self.given),
            "down": self._down.tolist(),
            "seed": self._lesion_seed,
            "clean": clean,
        }
        return cached_organ(f"lesions-{fingerprint(key)}", made)

    def load_healthy(self) -> OrganSurface:
        """Organ with its appearance, without the lesions to add.

        It is generated once and then read from the user's cache folder.
        """
        from vrcaps.anatomy.catalog import generate_organ
        from vrcaps.organ.cache import cached_organ, fingerprint

        given = self.given
        if isinstance(given, OrganGenerated):
            mucosa = given.mucosa
            if isinstance(mucosa, MucosaSettings):
                mucosa = mucosa.of(ORGANS[given.name].mucosa if given.name in ORGANS else "")
            return generate_organ(
                given.name, seed=given.seed, distension=given.distension, mucosa=mucosa
            )
        if isinstance(given, OrganSurface):
            return given if given.appearance is not None else self._with_appearance(given)
        path = path_of(given.path)
        if is_organ_file(path) and (organ := _read_file(given)).appearance is not None:
            if given.mucosa is not None:
                raise InputError(f"{path} has its own textures. Omit the mucosa.")
            return organ
        key = fingerprint(asdict(given) | {"seed": self.seed})
        return cached_organ(f"file-{key}", lambda: self._with_appearance(_read_file(given)))

    def _with_appearance(self, organ: OrganSurface) -> OrganSurface:
        from vrcaps.mucosa.bake import bake_appearance
        from vrcaps.mucosa.mucosa import own_mucosa

        own = own_mucosa(organ)
        mucosa = None if isinstance(self.given, OrganSurface) else self.given.mucosa
        if isinstance(mucosa, MucosaSettings):
            mucosa = mucosa.of(own)
        look = bake_appearance(organ, seed=self.seed, mucosa=mucosa or own)
        return replace(organ, appearance=look)

    def _with_lesions(self) -> LesionPair:
        """Organ with the lesions, and the same organ before they are added."""
        require_extra("lesions", "potpourri3d")
        rng, organ = lesion_rng(self._lesion_seed), self.load_healthy()
        if organ.metadata.get("lesions"):
            raise InputError(f"{organ.name} has lesions already. Give none, or its clean twin.")
        return add_lesions(organ, self.lesions, rng, down=self._down)

    @property
    def _lesion_seed(self) -> int:
        return getattr(self.given, "seed", self.seed)

    @property
    def _down(self) -> np.ndarray:
        """Direction of gravity in the patient frame."""
        return posture_transform(self.posture)[:3, :3].T @ np.array([0.0, 0.0, -1.0])

    @staticmethod
    def _require_clean(organ: OrganSurface) -> OrganSurface:
        if organ.metadata.get("lesions"):
            raise InputError(
                f"{organ.name} contains its lesions permanently, so it has no clean twin. Give the "
                "file of the clean twin, which `vrcaps organ make --clean-twin` writes."
            )
        return organ


def resolve_organ(organ: Organ) -> Organ:
    """Fill in the unit and the checksums of an organ's files.

    Raises:
        InputError: If a file does not match its checksum, or a mesh file has no unit.
    """
    if isinstance(organ, OrganSurface):
        return organ
    organ = with_checksums(organ)
    if isinstance(organ, OrganFile) and not organ.unit:
        if not is_organ_file(path_of(organ.path)):
            raise InputError(
                f"unit is missing: {path_of(organ.path)} does not state its unit. Allowed: "
                f"{', '.join(LENGTH_UNITS)}, or e.g. 5cm."
            )
        return replace(organ, unit="m")
    return organ


def _max_diameter(organ: OrganGenerated) -> float:
    from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy, widest_diameter

    return widest_diameter(draw_patient_anatomy(organ.seed, organ.distension), organ.name)


def _read_file(organ: OrganFile) -> OrganSurface:
    from vrcaps.organ.read_organ import read_organ

    return read_organ(
        path_of(organ.path),
        unit=organ.unit,
        open_ends=organ.open_ends,
        keep_uv=organ.keep_uv,
        reverse=organ.reverse,
    )
