"""`vrcaps train`: train a policy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import UseAppendAction

from vrcaps.cli.arguments import require_existing
from vrcaps.cli.console import console, progress_bar
from vrcaps.cli.parts import with_env_parts

if TYPE_CHECKING:
    from vrcaps.policy.training import TrainingSettings
    from vrcaps.training import Progress


@dataclass(frozen=True)
class Coverage:
    """Train a policy to see the whole wall of an organ as fast as possible, by PPO.

    The output folder contains best.npz and policy.npz, the policies of the best evaluation and of
    the last round; progress.csv; settings.json. To resume an interrupted training, repeat the
    command; it ends in the same policies.

    For example:
      vrcaps train coverage --out runs/coverage
      vrcaps train coverage --out runs/paper --preset paper
      vrcaps train coverage --out runs/mine --organ stomach:0-15 --organ mine.ply:mm
      vrcaps train coverage --out runs/magnet --set env.actuation=magnet
      --set learner.entropy=0.003
      vrcaps train coverage --out runs/coverage --actions 6000000
      vrcaps train coverage --out runs/colon --organ colon:0-7 --start runs/coverage
      vrcaps evaluate runs/coverage/best.npz --out runs/evaluated
    """

    out: Path
    """Output folder: new, empty, or of the same training, which is resumed."""

    preset: Literal["default", "paper", "ci"] = "default"
    """Preset of all other settings: the default, the paper's, or a smoke test that takes
    seconds."""

    organ: UseAppendAction[tuple[str, ...]] = ()
    """Organ to train in: a name with its seeds, such as stomach:0-15, or a mesh with its unit,
    such as mine.ply:mm; repeat for more."""

    actions: int | None = None
    """Total number of environment steps in all worlds. A larger number continues a finished
    training in its folder."""

    start: Path | None = None
    """Initial state: the folder of a training (policy, value function and optimizer), or a policy's
    file (policy only), with the same observations, actions and layers."""

    envs: int | None = None
    """Number of parallel worlds."""

    seed: int = 0
    """Random seed: initial weights of the network, episodes, and order of updates. Seeds of organs
    are those of --organ."""

    set: UseAppendAction[tuple[str, ...]] = ()
    """Change any setting: PATH=VALUE, such as env.episode_time=60 or learner.epochs=4; repeat for
    more. settings.json contains all of them."""

    threads: int = 1
    """Threads of PyTorch; more are slower for such a small network. Worlds use all cores."""

    tensorboard: bool = False
    """Write TensorBoard logs to the subfolder tensorboard."""

    force: bool = False
    """Resume a training that was started with another version of vrcaps or of a package."""

    def run(self) -> None:
        """Train and report.

        Raises:
            InputError: If the folder or the start does not match the settings.
        """
        if self.start is not None:
            require_existing((self.start,), "the folder of a training, or a policy's file")
        from vrcaps.policy.training import BEST, train

        with progress_bar("training") as show:

            def report(progress: Progress) -> None:
                show(progress.step, progress.total)
                line = _line(progress)
                if line:
                    console.print(line)

            progress = train(
                self.settings(),
                self.out,
                threads=self.threads,
                is_forced=self.force,
                start=self.start,
                tensorboard=self.out / "tensorboard" if self.tensorboard else None,
                report=report,
            )
        console.print(f"Written: {self.out / BEST} after {progress.step} rounds.")

    def settings(self) -> TrainingSettings:
        """Preset with the changes of the flags.

        Raises:
            InputError: If a value is invalid.
            UnknownNameError: If a setting is unknown.
        """
        from vrcaps.policy.presets import PRESETS
        from vrcaps.scenario.settings import parse_change
        from vrcaps.training import changed_settings

        settings = replace(PRESETS[self.preset](), seed=self.seed)
        if self.organ:
            settings = replace(settings, env=replace(settings.env, organs=self.organ))
        for name, value in (("num_actions", self.actions), ("num_envs", self.envs)):
            if value is not None:
                settings = replace(settings, learner=replace(settings.learner, **{name: value}))
        return changed_settings(settings, map(parse_change, self.set))


def _line(progress: Progress) -> str:
    """Summary of the last round, and its evaluation if any; empty before the first."""
    if not progress.rows:
        return ""
    row = progress.rows[-1]
    text = f"round {progress.step} of {progress.total}, {row['actions']:,.0f} actions"
    for name, title in (("coverage_visible", "visible in training"), ("entropy", "entropy")):
        if name in row:
            scale, unit = (100.0, " %") if name.startswith("coverage") else (1.0, "")
            text += f", {scale * row[name]:.1f}{unit} {title}"
    text += f", {row['seconds']:.0f} s"
    coverage = row.get("evaluation_coverage_visible")
    if coverage is None:
        return text
    return (
        f"{text}; evaluated: {100.0 * coverage:.1f} % visible, "
        f"{100.0 * row['evaluation_coverage_frustum']:.1f} % in the frustum, "
        f"reward {row['evaluation_reward']:.2f} (best {progress.best or 0.0:.2f})"
    )


def command(*path: str) -> type:
    """Command of the verb; its help lists the parts of environments."""
    return with_env_parts(Coverage)
