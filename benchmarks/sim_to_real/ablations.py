"""Ablation of the simulator: our images without one component each, from one small plan."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.sim_to_real.cells import Cell
from benchmarks.sim_to_real.tasks import DEPTH
from vrcaps.core.color import srgb_from_linear
from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.data.make import make_dataset
from vrcaps.data.plan import read_plan
from vrcaps.data.runners.local import InProcess, Pool
from vrcaps.data.units import Units
from vrcaps.mucosa.mucosa import MUCOSAE
from vrcaps.mucosa.texture import HEAD, MucosaTexture, write_texture

PLAN = Path(__file__).with_name("ablations.toml")
PATIENTS = 12
COMPLETE = "nothing"
VARIANTS: Mapping[str, str] = {
    COMPLETE: "complete",
    "indirect light": "direct",
    "lens and sensor effects": "ideal",
    "texture": "plain",
    "contents": "empty",
    "shapes of polyps": "flat",
}
"""Folder of our images by what they lack."""
FRACTION = 0.1
"""Fraction of the real images on which networks are trained after ours."""
_SIDE = 64


def ablation_cells(tasks: Sequence[str], seeds: int) -> list[Cell]:
    """Networks trained on a variant, then on a tenth of the real images; for depth on none."""
    return [
        Cell(task, "ours", 0.0 if task == DEPTH else FRACTION, seed, variant)
        for seed in range(seeds)
        for task in tasks
        for variant in VARIANTS
    ]


def made_variants(run: Path, workers: int, plan: Path = PLAN, patients: int = PATIENTS) -> None:
    """Make the missing data sets, below `variants` of the experiment's folder.

    A patient that cannot be made, such as one whose lumen is too narrow for a polyp, is in none.

    Raises:
        InputError: If no recording can be made, or one can be made only with all components.
    """
    base = read_plan(plan)
    numbers: Sequence[int] = range(patients)
    for name, folder in VARIANTS.items():
        changed = replace(
            base,
            settings=replace(base.settings, patients=patients, name=folder),
            scenario=without(name, base.scenario, run / "variants"),
        )
        place = run / "variants" / folder
        runner = Pool(workers) if workers > 1 else InProcess()
        made = make_dataset(changed, place, numbers=numbers, runner=runner)
        print(f"Images without {name}: {made.made} recordings made.", flush=True)
        for unit, reason in made.failed.items():
            print(f"{folder}: {unit} is left out: {reason}", flush=True)
        if name == COMPLETE:
            names = Units(changed).name
            numbers = [k for k in numbers if names(k) not in made.failed]
        elif made.failed:
            raise InputError(f"{folder}: {next(iter(made.failed.values()))}")
        if not numbers:
            raise InputError(f"{plan}: no patient can be made.")


def without(name: str, scenario: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Scenario of a plan without one component.

    Args:
        name: Missing component, of `VARIANTS`.
        scenario: As the plan has it.
        folder: Folder of the texture of one color.
    """
    change: dict[str, Callable[[dict[str, Any]], Any]] = {
        COMPLETE: lambda plain: None,
        "indirect light": lambda plain: plain.update(render={"light": "direct"}),
        "lens and sensor effects": lambda plain: plain.update(effects="none,ae=settled"),
        "texture": lambda plain: plain["organ"].update(mucosa=str(_plain_texture(folder))),
        "contents": lambda plain: plain.pop("contents", None),
        "shapes of polyps": lambda plain: [
            lesion.update(shape="IIb") for lesion in plain["lesions"] if lesion["kind"] == "polyp"
        ],
    }
    plain = deepcopy(dict(scenario))
    change[name](plain)
    return plain


def _plain_texture(folder: Path) -> Path:
    """A mucosa of one color, smooth, the same for all organs."""
    place = (folder / "texture").resolve()
    if not (place / HEAD).is_file():
        colon = MUCOSAE["colon"]
        color = srgb_from_linear(np.array(colon.base_color))
        shape = (_SIDE, _SIDE)
        place.parent.mkdir(parents=True, exist_ok=True)
        write_texture(
            place,
            MucosaTexture(
                np.broadcast_to(color, (*shape, 3)).copy(),
                np.full(shape, round(255.0 * colon.roughness), np.uint8),
                np.full(shape, 32768, np.uint16),
                0.2 * MM,
                colon.clearcoat_gloss,
            ),
        )
    return place
