"""`vrcaps train`: learn a policy."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import UseAppendAction

from vrcaps.cli.console import console, progress_bar
from vrcaps.errors import InputError

if TYPE_CHECKING:
    from vrcaps.env.settings import Organ
    from vrcaps.policy.training import Progress, TrainingSettings

_SEEDS = re.compile(r"(\d+)(?:-(\d+))?")


@dataclass(frozen=True)
class Coverage:
    """Learn to see the whole wall of an organ as fast as possible, by PPO.

    The folder then holds best.npz and policy.npz, the policies of the best evaluation and of the
    last round; progress.csv; settings.json. Interrupted or killed, the same command goes on and
    ends in the same policies.

    For example:
      vrcaps train coverage --out runs/coverage
      vrcaps train coverage --out runs/paper --preset paper
      vrcaps train coverage --out runs/mine --organ stomach:0-15 --organ mine.ply:mm
      vrcaps train coverage --out runs/magnet --set env.actuation=magnet
      --set learner.entropy=0.003
      vrcaps evaluate runs/coverage/best.npz
    """

    out: Path
    """Folder: new, empty, or of the same training, which goes on."""

    preset: Literal["default", "paper", "ci"] = "default"
    """Where all other settings come from: ours, the paper's, or one that takes seconds."""

    organ: UseAppendAction[tuple[str, ...]] = ()
    """Organ to train in: a name with its seeds, such as stomach:0-15, or a mesh with its unit,
    such as mine.ply:mm; repeat for more."""

    actions: int | None = None
    """Actions after which training ends."""

    envs: int | None = None
    """Worlds side by side."""

    seed: int = 0
    """Of all that is random."""

    set: UseAppendAction[tuple[str, ...]] = ()
    """Change any setting: PATH=VALUE, such as env.episode_time=60 or learner.epochs=4; repeat for
    more. settings.json holds all of them."""

    threads: int = 1
    """Threads of PyTorch; more are slower for a network so small. Worlds use all cores."""

    tensorboard: bool = False
    """Write files for TensorBoard into the folder's tensorboard."""

    force: bool = False
    """Go on with a training that another version of vrcaps or of a package began."""

    def run(self) -> None:
        """Train and report."""
        from vrcaps.policy.training import BEST, train

        with progress_bar("training") as show:

            def report(progress: Progress) -> None:
                show(progress.num_rounds, progress.total)
                line = _line(progress)
                if line:
                    console.print(line)

            progress = train(
                self.settings(),
                self.out,
                threads=self.threads,
                is_forced=self.force,
                tensorboard=self.out / "tensorboard" if self.tensorboard else None,
                report=report,
            )
        console.print(f"Written: {self.out / BEST} after {progress.num_rounds} rounds.")

    def settings(self) -> TrainingSettings:
        """The preset with the changes of the flags.

        Raises:
            InputError: If a value is impossible.
            UnknownNameError: If there is no setting of a name.
        """
        from vrcaps.policy.presets import PRESETS, changed_settings
        from vrcaps.scenario.settings import parse_change

        settings = replace(PRESETS[self.preset](), seed=self.seed)
        if self.organ:
            organs = tuple(organ for text in self.organ for organ in parse_organs(text))
            settings = replace(settings, env=replace(settings.env, organs=organs))
        for name, value in (("num_actions", self.actions), ("num_envs", self.envs)):
            if value is not None:
                settings = replace(settings, learner=replace(settings.learner, **{name: value}))
        for change in self.set:
            settings = changed_settings(settings, *parse_change(change))
        return settings


def parse_organs(text: str) -> list[Organ]:
    """Organs of a text such as ``stomach``, ``stomach:3``, ``stomach:0-15`` or ``mine.ply:mm``.

    Raises:
        InputError: If what follows the colon is neither a seed or seeds, nor a unit of a mesh.
    """
    from vrcaps.scenario.scenario import OrganFile, OrganGenerated, organ_named

    name, _, rest = text.rpartition(":") if ":" in text else (text, "", "")
    organ = organ_named(name)
    if not rest:
        return [organ]
    if isinstance(organ, OrganFile):
        return [replace(organ, unit=rest)]
    seeds = _SEEDS.fullmatch(rest)
    if seeds is None:
        raise InputError(f"--organ is {text!r}. Allowed: NAME:SEED, NAME:FIRST-LAST or FILE:UNIT.")
    first, last = int(seeds[1]), int(seeds[2] or seeds[1])
    if first > last:
        raise InputError(
            f"--organ is {text!r}. Allowed: rising seeds, such as {name}:{last}-{first}."
        )
    return [OrganGenerated(name, seed=seed) for seed in range(first, last + 1)]


def _line(progress: Progress) -> str:
    """What the last evaluation found; empty if the last round had none."""
    row = progress.rows[-1] if progress.rows else {}
    found = row.get("evaluation_coverage_visible")
    if found is None:
        return ""
    return (
        f"{row['actions']:,.0f} actions: {100.0 * found:.1f} % visible, "
        f"{100.0 * row['evaluation_coverage_frustum']:.1f} % in the frustum, "
        f"reward {row['evaluation_reward']:.2f} (best {progress.best or 0.0:.2f})"
    )
