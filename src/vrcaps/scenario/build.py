"""Builder of the world model and the capsule motion from a scenario."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.capsule.device_file import device_of
from vrcaps.config.convert import to_plain
from vrcaps.config.file_ref import FileRef, path_of, with_checksums
from vrcaps.core.errors import InputError
from vrcaps.core.units import LENGTH_UNITS
from vrcaps.lesion import AnyLesion, add_lesions, lesion_rng
from vrcaps.lesion.placement import require_possible
from vrcaps.organ.organ_file import is_organ_file
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.channels import CHANNELS
from vrcaps.render.imaging import make_imaging
from vrcaps.scenario.scenario import OrganFile, OrganGenerated, Scenario
from vrcaps.world.model import Model, posture_transform

if TYPE_CHECKING:
    from vrcaps.motion.motion import Motion


def resolve(scenario: Scenario) -> Scenario:
    """Resolve all open settings of a scenario; resolving it again changes nothing.

    Fills in the frame rate, the capsule's own effects and the checksums of files, samples the
    severities of effects, and sorts the channels in the order of `Frame`.

    Raises:
        InputError: If a file does not match its checksum, a mesh file has no unit, or the capsule's
            LEDs lack a color.
        UnknownNameError: If the capsule is unknown.
    """
    device, organ = device_of(scenario.capsule), scenario.organ
    make_imaging(device, scenario.render.imaging)
    if isinstance(organ, OrganFile):
        organ = replace(organ, unit=organ.unit or _own_unit(path_of(organ.path)))
    return replace(
        scenario,
        organ=organ if isinstance(organ, OrganSurface) else with_checksums(organ),
        motion=with_checksums(scenario.motion),
        fps=device.frame_rate if scenario.fps is None else scenario.fps,
        channels=tuple(channel for channel in CHANNELS if channel in scenario.channels),
        effects=scenario.effects.of_device(device).sample(scenario.seed),
    )


def _own_unit(path: Path) -> str:
    """Unit of an organ file; mesh files do not state one."""
    if not is_organ_file(path):
        raise InputError(
            f"unit is missing: {path} does not say its unit. Allowed: {', '.join(LENGTH_UNITS)}, "
            "or e.g. 5cm."
        )
    return "m"


def build(scenario: Scenario) -> tuple[Model, Motion]:
    """Build the world and the motion of a scenario.

    The effects are applied to the capsule's cameras, the wall and the contents of the lumen.

    Returns:
        The model to render, without lesions for a clean twin, and the motion in it.

    Raises:
        InputError: As `resolve`, or if the organ cannot be made or the capsule cannot move in it.
        UnknownNameError: As `resolve`.
    """
    scenario = resolve(scenario)
    device = scenario.effects.device(device_of(scenario.capsule))
    T_world_patient = posture_transform(scenario.posture)
    contents = scenario.effects.contents(scenario.contents)

    def make_model(*, clean: bool) -> Model:
        organ = scenario.effects.organ(make_organ(scenario, clean=clean))
        return Model(organ, device, T_world_patient, contents)

    shown = model = make_model(clean=False)
    if scenario.clean_twin:
        shown = make_model(clean=True)
    assert scenario.fps is not None
    motion = scenario.motion.begin(
        model, frames=scenario.frames, fps=scenario.fps, seed=scenario.seed, shown=shown
    )
    return shown, motion


def make_organ(scenario: Scenario, *, clean: bool = False) -> OrganSurface:
    """Organ of a resolved scenario with its lesions, or its clean twin without them.

    An organ with lesions is generated once and then read from the user's cache folder.

    Raises:
        InputError: If the organ cannot be made, or a lesion does not fit in it.
    """
    from vrcaps.organ.cache import cached_organ, fingerprint

    if not scenario.lesions:
        organ = _load_organ(scenario)
        if clean and organ.metadata.get("lesions"):
            raise InputError(
                f"{organ.name} holds its lesions for good, so it has no clean twin. Give the file "
                "of the clean twin, which `vrcaps organ make --clean-twin` writes."
            )
        return organ
    if isinstance(scenario.organ, OrganGenerated):  # check before minutes of work
        require_possible(scenario.lesions, _widest(scenario.organ))
    gravity_world = np.array([0.0, 0.0, -1.0])
    down = posture_transform(scenario.posture)[:3, :3].T @ gravity_world
    seed = getattr(scenario.organ, "seed", scenario.seed)

    def make() -> OrganSurface:
        rng, organ = lesion_rng(seed), _load_organ(scenario)
        if organ.metadata.get("lesions"):
            raise InputError(f"{organ.name} has lesions already. Give none, or its clean twin.")
        patient = add_lesions(organ, scenario.lesions, rng, down=down)
        return patient.clean if clean else patient.organ

    if isinstance(scenario.organ, OrganSurface):
        return make()
    plain = to_plain(scenario.lesions, tuple[AnyLesion, ...])
    key = {"lesions": plain, "organ": _key(scenario), "down": down.tolist(), "seed": seed}
    return cached_organ(f"lesions-{fingerprint({**key, 'clean': clean})}", make)


def _widest(organ: OrganGenerated) -> float:
    from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy, widest_diameter

    return widest_diameter(draw_patient_anatomy(organ.seed, organ.distension), organ.name)


def _load_organ(scenario: Scenario) -> OrganSurface:
    """Organ with its appearance, generated once and then read from the user's cache folder."""
    from vrcaps.anatomy.catalog import generate_organ
    from vrcaps.mucosa.bake import bake_appearance
    from vrcaps.mucosa.mucosa import own_mucosa
    from vrcaps.organ.cache import cached_organ, fingerprint

    given = scenario.organ
    assert not isinstance(given, str)
    mucosa = None if isinstance(given, OrganSurface) else given.mucosa
    mucosa = mucosa.path if isinstance(mucosa, FileRef) else mucosa
    if isinstance(given, OrganGenerated):
        return generate_organ(
            given.name, seed=given.seed, distension=given.distension, mucosa=mucosa
        )

    def dressed(organ: OrganSurface) -> OrganSurface:
        look = bake_appearance(organ, seed=scenario.seed, mucosa=mucosa or own_mucosa(organ))
        return replace(organ, appearance=look)

    if isinstance(given, OrganSurface):
        return given if given.appearance is not None else dressed(given)
    path = path_of(given.path)
    if is_organ_file(path) and (organ := _read_file(given)).appearance is not None:
        if given.mucosa is not None:
            raise InputError(f"{path} has textures of its own. Leave out the mucosa.")
        return organ
    key = fingerprint(_key(scenario) | {"seed": scenario.seed})
    return cached_organ(f"file-{key}", lambda: dressed(_read_file(given)))


def _read_file(given: OrganFile) -> OrganSurface:
    from vrcaps.organ.read_organ import read_organ

    return read_organ(
        path_of(given.path),
        unit=given.unit,
        open_ends=given.open_ends,
        keep_uv=given.keep_uv,
        reverse=given.reverse,
    )


def _key(scenario: Scenario) -> dict[str, Any]:
    """Cache key: everything that the organ without lesions depends on."""
    assert isinstance(scenario.organ, OrganGenerated | OrganFile)
    return asdict(scenario.organ)
