"""`vrcaps train` and `vrcaps evaluate`: train and evaluate policies that steer the capsule."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional, UseAppendAction

from vrcaps.cli.arguments import require_existing
from vrcaps.cli.console import console, progress_bar
from vrcaps.cli.parts import with_env_parts
from vrcaps.core.errors import InputError, UnknownNameError, require_extra

if TYPE_CHECKING:
    from vrcaps.env.settings import EnvSettings
    from vrcaps.policy.policy import Policy
    from vrcaps.policy.training import TrainingSettings
    from vrcaps.tools.reports.evaluation import Subject
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

    preset: Literal["default", "device", "paper", "ci"] = "default"
    """Preset of all other settings: the default, that of a device (magnet, gravity, observations of
    its sensors), the paper's, or a smoke test that takes seconds."""

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
        from vrcaps.policy.training import PRESETS
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


@dataclass(frozen=True)
class Evaluate:
    """Evaluate policies over many seeds and episodes, in parallel on all cores, with full physics.

    A policy is a baseline (random, centerline, look-around, next-best-view, explorer, navigator), a
    trained policy's file, or an import path package.module:Class. The output folder contains, for
    each policy and capsule, episodes.csv (one row per episode), curves.parquet (coverage, force and
    pose over time) and median.mp4 (a video of the median run); and for all of them index.html with
    summary.png and summary.csv. To resume an interrupted evaluation, repeat the command.

    To evaluate predictions from images instead, name their task first, such as vrcaps evaluate
    depth; vrcaps predict --help lists the tasks.

    Coverage is evaluated at the levels that need no images: frustum, visible, resolved. For
    `readable`, record an episode with --coverage.

    For example:
      vrcaps evaluate centerline --organs stomach:0-1 --seeds 4 --episodes 1 --out runs/evaluated
      vrcaps evaluate runs/coverage/best.npz next-best-view --out runs/evaluated
      vrcaps evaluate next-best-view --capsules mono stereo dual panoramic --out runs/designs
      vrcaps evaluate navigator --task navigate --seeds 20 --episodes 1 --out runs/navigated
      vrcaps evaluate mine.policies:Mine --organs stomach.glb colon:0-4 --out runs/mine
    """

    policies: Positional[tuple[str, ...]]
    """Policies: names of baselines, files of trained policies, import paths."""

    out: Path
    """Output folder: new, empty, or of the same evaluation, which is resumed."""

    task: str = "coverage"
    """Task of the policies: coverage (see the whole wall), navigate (reach a position along the
    gut) or inspect (look at each lesion)."""

    organs: tuple[str, ...] = ()
    """Organs: a name with its seeds, such as stomach:0-19, or a mesh with its unit, such as
    mine.ply:mm; by default seeds 100 to 119 of the task's organ: stomach, or colon to navigate."""

    capsules: tuple[str, ...] = ()
    """Capsules to compare, names of the catalog or files; by default the policy's own, or magnetic.
    """

    actuation: str = ""
    """Actuation of the capsule; by default that of the policy's training, one that suits the task,
    or a wrench that balances gravity. The kind that the policy was trained with keeps the settings
    of the training, such as the magnet's speed."""

    seeds: int = 80
    """Number of seeds, 0, 1, …; they cycle through the organs."""

    episodes: int = 5
    """Number of episodes per seed, each from another start."""

    time: float | None = None
    """Duration of an episode [s]; by default 60, for navigate 1200, for inspect 180."""

    dynamics: Literal["physics", "quasi-static"] = "physics"
    """Full simulation, or a fast one without inertia."""

    worlds: int = 20
    """Number of episodes simulated in parallel."""

    video: bool = True
    """Write videos of the median runs."""

    def run(self) -> None:
        """Evaluate, draw and report."""
        from vrcaps.tools.reports.evaluation import VIDEO, write_page
        from vrcaps.tools.reports.run_video import write_run_video

        if not self.policies:
            raise InputError("No policy is given. Allowed: one or more, such as centerline.")
        require_extra("reports", "matplotlib")
        if self.video:
            require_extra("video", "av")
        subjects = self._evaluate()
        for subject in subjects:
            video = subject.evaluation.folder / VIDEO
            if self.video and not video.is_file():
                with progress_bar(f"video of {subject.name}") as progress:
                    write_run_video(video, subject, progress)
        with console.status("drawing"):
            written = write_page(self.out, subjects)
        _report(subjects)
        console.print(f"Written: {', '.join(map(str, written))}")

    def _evaluate(self) -> list[Subject]:
        """Run all episodes of all policies with all capsules; errors are raised before any run."""
        from vrcaps.policy.evaluate import Plan, evaluate
        from vrcaps.policy.evaluation import Evaluation
        from vrcaps.tools.reports.evaluation import Subject

        plan = Plan(self.seeds, self.episodes, self.worlds)
        planned: list[tuple[Policy, EnvSettings, str]] = []
        for name in self.policies:
            for capsule in self.capsules or ("",):
                policy = _policy_of(name)
                settings = self._settings(policy, capsule)
                policy.requires.check(settings, name)
                label = " ".join(filter(None, [_short(name), capsule and _short(capsule)]))
                planned.append((policy, settings, label))
        labels = [label for *_, label in planned]
        if len(set(labels)) < len(labels):
            raise InputError(
                f"Two policies have the same output folder: {', '.join(labels)}. Rename one, or "
                "give it another --out."
            )
        subjects = []
        for policy, settings, label in planned:
            folder = self.out / label.replace(" ", "-")
            evaluation = Evaluation(folder, self._stated(label, settings))
            with progress_bar(label) as progress:
                evaluate(policy, settings, plan, evaluation, progress)
            subjects.append(Subject(label, evaluation, settings))
        return subjects

    def _settings(self, policy: Policy, capsule: str) -> EnvSettings:
        """Environment settings for the evaluation of one policy: up to the end of the time."""
        from vrcaps.env.actuation import Wrench
        from vrcaps.env.patients import check_names
        from vrcaps.env.settings import env_settings

        keywords: dict[str, Any] = dict(policy.requires.settings)
        if getattr(keywords.get("task"), "kind", "") != self.task:
            keywords["task"] = self.task
        trained = keywords.get("actuation")
        if self.actuation and self.actuation != getattr(trained, "kind", None):
            keywords["actuation"] = self.actuation
        if capsule:
            keywords["capsule"] = capsule
        settings = env_settings(**keywords | {"dynamics": self.dynamics})
        usual = {"organs": ("stomach",), "episode_time": 60.0} | settings.task.defaults
        if "actuation" not in keywords | usual:
            settings = replace(settings, actuation=Wrench(is_weightless=True))
        organs = self.organs or tuple(f"{organ}:100-119" for organ in usual["organs"])
        time = usual["episode_time"] if self.time is None else self.time
        settings = replace(
            settings,
            organs=organs,
            episode_time=time,
            stuck_time=2.0 * time,
        )
        check_names(settings.organs, settings.capsule)
        if hasattr(settings.task, "target"):
            settings = replace(settings, task=replace(settings.task, target=1.0))
        return settings

    def _stated(self, label: str, settings: EnvSettings) -> dict[str, Any]:
        """Description of the evaluation in the folder; seeds and episodes may be added later."""
        from vrcaps import __version__
        from vrcaps.env.settings import plain_environment

        return {
            "policy": label,
            "version": __version__,
            "environment": plain_environment(settings),
        }


def _policy_of(name: str) -> Policy:
    """Create a policy by name; the error lists the tasks on images, which are allowed instead.

    Raises:
        InputError: If there is none.
    """
    from vrcaps.learn.registry import TASKS
    from vrcaps.policy.catalog import read_policy

    try:
        return read_policy(name)
    except UnknownNameError as error:
        raise InputError(f"{error} Tasks on images: {', '.join(TASKS)}.") from error


def _short(name: str) -> str:
    """Policy or capsule name as part of a folder name."""
    if ":" in name:
        return name.replace(":", "-")
    path = Path(name)
    return f"{path.parent.name}-{path.stem}" if path.parent.name else path.stem


def _report(subjects: list[Subject]) -> None:
    from rich.table import Table

    from vrcaps.tools.reports.evaluation import summary

    columns = [summary(subject) for subject in subjects]
    table = Table(title="Medians over all episodes")
    table.add_column("")
    for subject in subjects:
        table.add_column(subject.name, justify="right")
    for name in columns[0]:
        table.add_row(name, *(column[name] for column in columns))
    console.print(table)


def command(*path: str) -> type:
    """Command of the verb; its help lists the parts of environments."""
    return with_env_parts(Evaluate if path == ("evaluate",) else Coverage)
