"""`vrcaps train TASK`, `vrcaps evaluate TASK`, `vrcaps predict TASK`: networks on images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import degrees, radians
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from tyro.conf import UseAppendAction

from vrcaps.cli.arguments import require_outside, require_sources
from vrcaps.cli.console import console, progress_bar
from vrcaps.cli.parts import command_of, part_of
from vrcaps.core.errors import InputError
from vrcaps.core.processes import ProgressReport
from vrcaps.learn.registry import TASKS

if TYPE_CHECKING:
    from vrcaps.learn.samples import Samples
    from vrcaps.recording.frame_sequence import FrameSequence
    from vrcaps.training import Progress

_MAX_LISTED = 20
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
    """Preset of all settings: the default, the paper's, or a smoke test that takes a minute."""

    start: str = ""
    """Initial weights: imagenet, scratch, a checkpoint to fine-tune, such as one pre-trained on
    other data, or the name of published weights; from those of another task only the encoder is
    used. By default that of the preset."""

    set: UseAppendAction[tuple[str, ...]] = ()
    """Change any setting of training: NAME=VALUE, such as steps=5000, batch=16,
    learning_rate=1e-4, fraction=0.1 or seed=3; repeat for more. settings.json contains all of
    them."""

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

    part: ClassVar[type[Any]]

    def run(self) -> None:
        """Train and report.

        Raises:
            InputError: If the data are not suitable for training.
        """
        _require_paths((*self.data, *self.validation), (self.start,))
        from vrcaps.formats.io import read_sources
        from vrcaps.learn.samples import samples_of, split_samples
        from vrcaps.learn.settings import settings_of
        from vrcaps.learn.training import BEST, train
        from vrcaps.scenario.settings import parse_change
        from vrcaps.training import ComputeSettings

        task = part_of(self)
        changes = map(parse_change, self.set)
        settings = settings_of(
            task, self.preset, self.data, self.start, changes, validation=self.validation
        )
        with progress_bar("reading") as show:
            sequences = read_sources(self.data, show)
            validation = read_sources(self.validation, show) if self.validation else ()
        if self.validation:
            samples = samples_of(task, [s for s in sequences if s.split in (None, "train")])
            held_out = samples_of(task, validation)
        else:
            samples, held_out = split_samples(task, sequences)
        tested = [s for s in sequences if s.split == "test"]
        samples = self._without_duplicates(samples, held_out, tested)
        console.print(f"{len(samples)} training frames, {len(held_out)} validation frames.")
        with progress_bar("training") as show:
            train(
                settings,
                samples,
                held_out,
                self.out,
                compute=ComputeSettings(self.device, self.threads),
                is_forced=self.force,
                tensorboard=self.tensorboard,
                report=_reporter(task.metric.name, show),
            )
        _report_skipped({**samples.skipped, **held_out.skipped})
        console.print(f"Written: {self.out / BEST}. Pictures: {self.out / 'pictures'}.")

    def _without_duplicates(
        self, samples: Samples, held_out: Samples, tested: list[FrameSequence]
    ) -> Samples:
        """Training frames without near-duplicates of validation or test frames."""
        from vrcaps.learn.samples import Samples, without_duplicates

        if self.duplicates == "keep":
            return samples
        test = [(one, index) for one in tested for index in range(len(one))]
        others = Samples(held_out.task, [*held_out.frames, *test])
        with progress_bar("comparing") as show:
            kept, dropped = without_duplicates(samples, others, progress=show)
        if dropped and self.duplicates == "refuse":
            name, other = next(iter(dropped.items()))
            raise InputError(
                f"{len(dropped)} training images are near-duplicates of validation or test images: "
                f"{name} is {other}. Give --duplicates drop to exclude them."
            )
        for name, other in list(dropped.items())[:_MAX_LISTED]:
            console.print(f"Dropped {name}: duplicate of {other}.")
        if dropped:
            console.print(
                f"Dropped {len(dropped)} training images that are near-duplicates of validation or "
                "test images. Give --duplicates keep to use them."
            )
        return kept


def _reporter(metric: str, show: ProgressReport) -> Callable[[Progress], None]:
    """Callback that prints a line per evaluation and advances a progress bar."""
    printed = 0

    def report(progress: Progress) -> None:
        nonlocal printed
        show(progress.step, progress.total)
        for row in progress.rows[printed:]:
            console.print(
                f"step {row['step']:,.0f}: loss {row['training_loss']:.4f}, {metric} "
                f"{row[metric]:.4f} (best {progress.best:.4f})"
            )
        printed = len(progress.rows)

    return report


@dataclass(frozen=True, kw_only=True)
class _Evaluate:
    """Options shared by the evaluation of all tasks."""

    weights: str = ""
    """File of trained weights, or the name of published ones (`vrcaps weights list`); by default
    those published for the task."""

    data: UseAppendAction[tuple[str, ...]]
    """Frames with ground truth, as for `vrcaps train`; repeat for more."""

    split: str = ""
    """Split of the data to use, if it has splits: train, val or test."""

    perturb: bool = False
    """Also evaluate 100 of the frames with other exposure, JPEG, noise, a border or a crop."""

    out: Path | None = None
    """Output folder for scores.csv, evaluation.json (input of a model card), and pictures of frames
    and of the worst ones."""

    device: str = "auto"
    """cpu, cuda, mps, or auto for the fastest available."""

    task: ClassVar[str]

    def run(self) -> None:
        """Evaluate and report.

        Raises:
            InputError: If weights and data do not match.
        """
        require_sources(self.data)
        weights = _find_weights(self.weights, self.task)
        from vrcaps.cli.learn_tables import (
            print_evaluation,
            print_perturbed,
            warn_if_constant,
            write_evaluation_folder,
        )
        from vrcaps.core.files import file_sha256
        from vrcaps.formats.io import read_sources
        from vrcaps.learn.checkpoint import read_weights
        from vrcaps.learn.evaluation import Evaluation, evaluate, main_metric, perturbed
        from vrcaps.learn.samples import samples_of
        from vrcaps.training import available_device

        trained = read_weights(weights, task=self.task, device=available_device(self.device))
        warn_if_constant(trained)
        with progress_bar("reading") as show:
            sequences = [s for s in read_sources(self.data, show) if self.split in ("", s.split)]
        samples = samples_of(trained.task, sequences)
        with progress_bar("evaluating") as show:
            result = evaluate(trained, samples, progress=show)
        table, groups = print_evaluation(trained, result, sequences)
        rows, gains = {}, {}
        if self.perturb:
            with progress_bar("perturbing") as show:
                rows, gains = perturbed(trained, samples, progress=show)
            print_perturbed(rows, gains, main_metric(trained.task))
        _report_skipped(samples.skipped)
        if self.out is None:
            return
        counts = len(result.samples), len(samples.skipped)
        stated = self.task, file_sha256(weights), self.data, self.split, *counts
        evaluation = Evaluation(*stated, result.metrics, table, rows, groups, gains)
        write_evaluation_folder(self.out, evaluation, trained.task, result)


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
        require_outside(self.out, (self.images,))
        weights = _find_weights(self.weights, self.task)
        from vrcaps.core.files import require_new_folder
        from vrcaps.learn.checkpoint import read_weights
        from vrcaps.learn.prediction import images_of, predict
        from vrcaps.training import available_device

        require_new_folder(self.out)
        field = None if self.fov is None else radians(self.fov)
        with progress_bar("reading") as show:
            images = images_of(self.images, self.task, self.capsule, field, progress=show)
        if self.fov is not None:
            console.print(
                f"Assumed for images without a camera: an equidistant lens with a field of view of "
                f"{self.fov:g} degrees."
            )
        if "ray" in TASKS[self.task].input_names:
            _report_lenses(images)
        trained = read_weights(weights, task=self.task, device=available_device(self.device))
        with progress_bar("predicting") as show:
            skipped = predict(trained, images, self.out, field_of_view=field, progress=show)
        _report_skipped(skipped)
        unit = f" {_UNITS[self.task]}" if self.task in _UNITS else ""
        console.print(f"Written: {self.out}, with contact sheet sheet.png.{unit}")


def _find_weights(given: str, task: str) -> Path:
    """Resolve the weights of a command; print the alternatives to those of the task."""
    from vrcaps.learn.hub import find_weights

    path = find_weights(given, task)
    if not given and task in _CHOICES:
        console.print(_CHOICES[task])
    return path


def _report_lenses(images: Sequence[FrameSequence]) -> None:
    """Print the field of view of each camera, on which depth depends."""
    from vrcaps.learn.picture_border import horizontal_field

    for camera in dict.fromkeys(one.camera for one in images if one.camera is not None):
        angle = degrees(horizontal_field(camera))
        console.print(f"Lens of {camera.name}: {angle:.0f} degrees across the image.")


def check_paths(args: Sequence[str]) -> None:
    """Check the paths in the command line of a training.

    Raises:
        InputError: If one does not exist.
    """
    split = [text for arg in args for text in (arg.split("=", 1) if arg[:2] == "--" else [arg])]
    pairs = list(pairwise(split))
    sources = [value for flag, value in pairs if flag in ("--data", "--validation")]
    _require_paths(sources, [value for flag, value in pairs if flag == "--start"])


def _require_paths(sources: Sequence[str], starts: Sequence[str]) -> None:
    """Check that the data and the initial weights of a training exist.

    Raises:
        InputError: If one does not.
    """
    from vrcaps.learn.hub import SUFFIX, find_weights

    require_sources(sources)
    for start in starts:
        if start.endswith(SUFFIX):
            find_weights(start)


def _report_skipped(skipped: dict[str, str]) -> None:
    for name, reason in skipped.items():
        console.print(f"Skipped {name}: {reason}")


_PUBLISHED = {"depth", "segmentation", "classification", "super-resolution"}
"""Tasks whose examples need no file of weights."""
_CHOICES = {
    "depth": "Published weights: --weights depth-capsule for capsules and narrow lumens, "
    "depth-endoscope for endoscopes in wide lumens; depth (default) for both, less accurate.",
    "segmentation": "Published weights: --weights segmentation-polyp for polyps in images of "
    "colonoscopes, segmentation-bleeding for blood in images of capsules; segmentation (default) "
    "for any lesion, less accurate.",
}
"""Choice between several published weights of a task."""
_UNITS = {
    "depth": "Depth is in 16-bit PNG files, in steps of 10 µm; 0 is no value.",
    "sfm": "Distances along rays are in 16-bit PNG files, in steps of 10 µm at a reference scale "
    "of 30 mm; 0 is no value.",
}
"""Unit of the written images of a task."""
_EXAMPLES = {
    "train": """  vrcaps train {0} --data runs/cohort --out runs/{0}
  vrcaps train {0} --data runs/cohort --out runs/{0}-try --preset ci
  vrcaps train {0} --data images:real --start runs/{0}/best.safetensors --out runs/{0}-real""",
    "evaluate": """  vrcaps evaluate {0} --data runs/cohort --split test --out runs/{0}-test
  vrcaps evaluate {0} --weights runs/{0}/best.safetensors --data runs/cohort""",
    "predict": """  vrcaps predict {0} --images runs/colon --out runs/colon-{0}
  vrcaps predict {0} --weights runs/{0}/best.safetensors --images runs/colon --out runs/mine""",
}
_PHOTOS = "  vrcaps predict {0} --images photos{1} --out runs/photos"
_LENS = {"depth": " --fov 140"}
"""Lens of plain images in the example of a task that needs one."""


def command(verb: str, task: str) -> Any:
    """Create the command of a verb and a task.

    Only training imports the task, whose settings are flags, and with it PyTorch.

    Raises:
        UnknownNameError: If there is no such task.
    """
    lines = _EXAMPLES[verb].format(task).split("\n")
    if verb == "train":
        return command_of(_Train, TASKS[task], "\n".join(lines))
    if task not in _PUBLISHED:
        lines = [line for line in lines if "--weights" in line]
    elif verb == "predict":
        lines.append(_PHOTOS.format(task, _LENS.get(task, "")))
    base = {"evaluate": _Evaluate, "predict": _Predict}[verb]
    own = {"task": task, "__module__": __name__}
    notes = [_CHOICES.get(task), _UNITS.get(task) if verb == "predict" else None]
    about = "\n\n".join((TASKS.summary(task), *filter(None, notes)))
    own["__doc__"] = f"{about}\n\nFor example:\n" + "\n".join(lines)
    return dataclass(frozen=True, kw_only=True)(type(verb, (base,), own))
