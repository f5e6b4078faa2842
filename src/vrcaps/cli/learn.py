"""`vrcaps train TASK`, `vrcaps evaluate TASK`, `vrcaps predict TASK`: networks on images."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from tyro.conf import UseAppendAction

from vrcaps.cli.arguments import require_sources
from vrcaps.cli.console import console, progress_bar
from vrcaps.cli.parts import command_of, part_of
from vrcaps.core.errors import InputError
from vrcaps.learn.registry import LEARNERS, AnyTask

if TYPE_CHECKING:
    from vrcaps.learn.samples import Samples
    from vrcaps.recording.frame_sequence import FrameSequence

_TOLD = 20
"""Maximum number of near-duplicates to list."""


@dataclass(frozen=True, kw_only=True)
class _Train:
    """Options shared by the training of all tasks."""

    data: UseAppendAction[tuple[str, ...]]
    """Folder or URL of an episode or data set, or KIND:FOLDER for a layout of `vrcaps export`, such
    as c3vd:/data/c3vd; repeat for more."""

    validation: UseAppendAction[tuple[str, ...]] = ()
    """Data to select checkpoints on, as above; by default the data's val split, or a part of it."""

    out: Path
    """Output folder: new, empty, or of the same training, which is resumed."""

    preset: Literal["default", "paper", "ci"] = "default"
    """Preset of all settings: ours, the paper's, or one that takes a minute."""

    start: str = ""
    """Initial weights: imagenet, scratch, a checkpoint to fine-tune, such as one pre-trained on
    other data, or the name of published weights; from those of another task only the encoder is
    used. By default that of the preset."""

    set: UseAppendAction[tuple[str, ...]] = ()
    """Change any setting of training: NAME=VALUE, such as steps=5000, batch=16, rate=1e-4,
    fraction=0.1 or seed=3; repeat for more. settings.json contains all of them."""

    duplicates: Literal["drop", "keep", "refuse"] = "drop"
    """Handling of real training images that are near-duplicates of validation or test images:
    drop them, keep them, or refuse to train."""

    device: str = "auto"
    """cpu, cuda, mps, or auto for the fastest available."""

    threads: int = 1
    """Threads of PyTorch on a CPU; more are slower on a busy machine."""

    tensorboard: bool = False
    """Write TensorBoard logs to the subfolder tensorboard."""

    force: bool = False
    """Resume a training that was started with another version of vrcaps or of a package."""

    part: ClassVar[type[AnyTask]]

    def run(self) -> None:
        """Train and report.

        Raises:
            InputError: If the data are not suitable for training.
        """
        require_sources((*self.data, *self.validation))
        from vrcaps.learn.hub import SUFFIX, find_weights

        if self.start.endswith(SUFFIX):
            find_weights(self.start)
        from vrcaps.formats.io import read_sources
        from vrcaps.learn.presets import settings_of
        from vrcaps.learn.samples import samples_of, split_samples
        from vrcaps.learn.training import BEST, ComputeSettings, Progress, train

        learner = part_of(self)
        settings = settings_of(
            learner, self.preset, self.data, self.start, self.set, validation=self.validation
        )
        sequences = read_sources(self.data)
        if self.validation:
            samples = samples_of(learner, [s for s in sequences if s.split in (None, "train")])
            held_out = samples_of(learner, read_sources(self.validation))
        else:
            samples, held_out = split_samples(learner, sequences)
        tested = [s for s in sequences if s.split == "test"]
        samples = self._without_duplicates(samples, held_out, tested)
        console.print(f"{len(samples)} frames to learn from, {len(held_out)} to validate with.")
        figure, told = learner.figure.name, 0
        with progress_bar("training") as show:

            def report(progress: Progress) -> None:
                nonlocal told
                show(progress.step, progress.total)
                for row in progress.rows[told:]:
                    console.print(
                        f"step {row['step']:,.0f}: loss {row['training_loss']:.4f}, {figure} "
                        f"{row[figure]:.4f} (best {progress.best:.4f})"
                    )
                told = len(progress.rows)

            train(
                settings,
                samples,
                held_out,
                self.out,
                machine=ComputeSettings(self.device, self.threads),
                is_forced=self.force,
                tensorboard=self.tensorboard,
                report=report,
            )
        _tell_skipped({**samples.skipped, **held_out.skipped})
        console.print(f"Written: {self.out / BEST}. Pictures: {self.out / 'pictures'}.")

    def _without_duplicates(
        self, samples: Samples, held_out: Samples, tested: list[FrameSequence]
    ) -> Samples:
        """Training frames without near-duplicates of validation or test frames."""
        from vrcaps.learn.duplicates import without_duplicates
        from vrcaps.learn.samples import Samples

        if self.duplicates == "keep":
            return samples
        test = [(one, index) for one in tested for index in range(len(one))]
        others = Samples(held_out.learner, [*held_out.frames, *test])
        with progress_bar("comparing") as show:
            left, found = without_duplicates(samples, others, progress=show)
        if found and self.duplicates == "refuse":
            name, other = next(iter(found.items()))
            raise InputError(
                f"{len(found)} images to learn from are among those to validate or test with: "
                f"{name} is {other}. Give --duplicates drop to leave them out."
            )
        for name, other in list(found.items())[:_TOLD]:
            console.print(f"Not learned from: {name}, which is {other}.")
        if found:
            console.print(
                f"{len(found)} near-duplicates of images to validate or test with are not learned "
                "from. Give --duplicates keep to do so."
            )
        return left


@dataclass(frozen=True, kw_only=True)
class _Evaluate:
    """Options shared by the evaluation of all tasks."""

    weights: str = ""
    """File of trained weights, or the name of published ones (`vrcaps weights list`); by default
    those published for the task."""

    data: UseAppendAction[tuple[str, ...]]
    """Frames with ground truth, as for `vrcaps train`; repeat for more."""

    split: str = ""
    """Split to use of data with splits: train, val or test."""

    out: Path | None = None
    """Output folder for scores.csv, evaluation.json (input of a model card) and a figure."""

    device: str = "auto"
    """cpu, cuda, mps, or auto for the fastest available."""

    task: ClassVar[str]

    def run(self) -> None:
        """Evaluate and report.

        Raises:
            InputError: If weights and data do not match.
        """
        require_sources(self.data)
        from vrcaps.core.files import file_sha256, write_csv
        from vrcaps.formats.io import read_sources
        from vrcaps.learn.checkpoint import read_weights
        from vrcaps.learn.evaluation import Evaluation, write_evaluation
        from vrcaps.learn.hub import find_weights
        from vrcaps.learn.samples import samples_of
        from vrcaps.learn.training import chosen_device
        from vrcaps.learn.validation import validate, write_pictures

        weights = find_weights(self.weights, self.task)
        trained = read_weights(weights, task=self.task, device=chosen_device(self.device))
        sequences = [s for s in read_sources(self.data) if self.split in ("", s.split)]
        samples = samples_of(trained.learner, sequences)
        found = validate(trained, samples)
        for name, value in found.scores.items():
            console.print(f"{name:16} {value:.4f}")
        _tell_skipped(samples.skipped)
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
            write_csv(self.out / "scores.csv", [dict(found.scores)])
            evaluation = Evaluation(
                task=self.task,
                sha256=file_sha256(weights),
                data=self.data,
                split=self.split,
                frames=len(found.samples),
                skipped=len(samples.skipped),
                scores=found.scores,
            )
            write_evaluation(self.out, evaluation)
            write_pictures(self.out / "frames.png", trained.learner, found)


@dataclass(frozen=True, kw_only=True)
class _Predict:
    """Options shared by the prediction of all tasks."""

    weights: str = ""
    """File of trained weights, or the name of published ones (`vrcaps weights list`); by default
    those published for the task."""

    images: str
    """Images: a folder of them, an episode, a data set, or KIND:FOLDER."""

    out: Path
    """Folder to create."""

    capsule: str = ""
    """Capsule or endoscope whose first camera took the images of a plain folder: a name of the
    catalog, such as colonoscope, or a file. Its image size must match. depth and sfm need its
    lens."""

    fov: float | None = None
    """Horizontal field of view [degrees] for images of an unknown lens: an ideal equidistant lens
    is assumed. Absolute depth is then no better than this guess."""

    device: str = "auto"
    """cpu, cuda, mps, or auto for the fastest available."""

    task: ClassVar[str]

    def run(self) -> None:
        """Predict, write and report.

        Raises:
            InputError: If weights and images do not match.
        """
        require_sources((self.images,))
        from vrcaps.learn.hub import find_weights

        weights = find_weights(self.weights, self.task)
        from vrcaps.core.files import require_new_folder
        from vrcaps.learn.checkpoint import read_weights
        from vrcaps.learn.predict import images_of, predict
        from vrcaps.learn.training import chosen_device

        require_new_folder(self.out)
        field = None if self.fov is None else radians(self.fov)
        images = images_of(self.images, self.task, self.capsule, field)
        if self.fov is not None:
            console.print(
                f"Assumed: an equidistant lens that sees {self.fov:g} degrees across the picture, "
                "where the camera is not known."
            )
        trained = read_weights(weights, task=self.task, device=chosen_device(self.device))
        with progress_bar("estimating") as show:
            skipped = predict(trained, images, self.out, field_of_view=field, progress=show)
        _tell_skipped(skipped)
        console.print(f"Written: {self.out}, with contact sheet sheet.png.")


def _tell_skipped(skipped: dict[str, str]) -> None:
    for name, reason in skipped.items():
        console.print(f"Skipped {name}: {reason}")


_EXAMPLES = {
    "train": """  vrcaps train {0} --data runs/cohort --out runs/{0}
  vrcaps train {0} --data runs/cohort --out runs/{0}-try --preset ci
  vrcaps train {0} --data images:real --start runs/{0}/best.safetensors --out runs/{0}-real""",
    "evaluate": """  vrcaps evaluate {0} --data runs/cohort --split test --out runs/{0}-test
  vrcaps evaluate {0} --weights runs/{0}/best.safetensors --data runs/cohort""",
    "predict": """  vrcaps predict {0} --images photos{1} --out runs/photos
  vrcaps predict {0} --weights runs/{0}/best.safetensors --images runs/colon --out runs/mine""",
}
_LENS = " --fov 140"
"""Addition to the example of a task that needs a lens."""
_UNPUBLISHED = ("sfm",)
"""Tasks without published weights, whose examples name a file."""


def _examples(verb: str, task: str) -> str:
    """Example lines of the help."""
    lens = _LENS if "ray" in LEARNERS[task].input_names else ""
    lines = _EXAMPLES[verb].format(task, lens).split("\n")
    if verb != "train" and task in _UNPUBLISHED:
        lines = [line for line in lines if "--weights" in line]
    return "\n".join(lines)


def __getattr__(name: str) -> Any:
    """Command of a verb and a task, such as `train_depth`."""
    verb, _, task = name.partition("_")
    if verb not in _EXAMPLES or task not in LEARNERS:
        raise AttributeError(name)
    learner, examples = LEARNERS[task], _examples(verb, task)
    if verb == "train":
        return command_of(_Train, learner, examples)
    base = {"evaluate": _Evaluate, "predict": _Predict}[verb]
    meaning = (learner.__doc__ or "").partition("\n")[0]
    own = {"task": task, "__module__": __name__}
    own["__doc__"] = f"{meaning}\n\nFor example:\n{examples}"
    return dataclass(frozen=True, kw_only=True)(type(verb, (base,), own))
