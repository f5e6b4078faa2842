"""Setup of the experiment, shared by all its trainings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.sim_to_real.cells import Cell
from benchmarks.sim_to_real.images import Pictures
from benchmarks.sim_to_real.simulated import Urls
from benchmarks.sim_to_real.tasks import PRESETS, Effort, Task, task_named
from vrcaps.core.errors import InputError
from vrcaps.learn.settings import SCRATCH, TrainSettings
from vrcaps.learn.task import Task as NetworkTask
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.training import ComputeSettings


@dataclass(frozen=True)
class Setup:
    """Setup of an experiment.

    Attributes:
        real: Folders of real data by layout.
        out: Folder of its files.
        ours: Folders or URLs of our data sets; without any, arms that need them are left out.
        weights: Folder of weights that were learned on ours; None learns them here.
        preset: Name of the preset.
        device: Device of the training.
        variants: Simulated data sets without one component, by that component.
    """

    real: Mapping[str, Path]
    out: Path
    ours: Urls = ()
    weights: Path | None = None
    preset: str = "quick"
    device: str = "cpu"
    variants: Mapping[str, str] | None = None

    @property
    def machine(self) -> ComputeSettings:
        """Device and number of threads."""
        return ComputeSettings(self.device)

    def effort(self, task: Task) -> Effort:
        """Effort of a task."""
        return PRESETS[self.preset][task.kind]

    def pictures(self, task: Task) -> Pictures:
        """Real images of a task."""
        return task.read(self.real[task.layout], self.effort(task))

    def ours_of(self, cell: Cell) -> Urls:
        """Simulated data sets of a cell's pre-training.

        Raises:
            InputError: If none was given.
        """
        urls = ((self.variants or {})[cell.variant],) if cell.variant else self.ours
        if not urls:
            raise InputError("There are no images of ours. Give --ours URL.")
        return urls


def task_of(cell: Cell) -> Task:
    """The task of a cell."""
    return task_named(cell.task)


def settings_of(setup: Setup, cell: Cell, learner: NetworkTask, steps: int) -> TrainSettings:
    """Settings that all trainings of a task have in common."""
    effort = setup.effort(task_of(cell))
    return TrainSettings(
        learner,
        start=SCRATCH,
        steps=steps,
        batch=effort.batch,
        learning_rate=effort.rate,
        evaluate_every=steps,
        evaluation_frames=8,
        seed=cell.seed,
    )


def frames_of(pictures: Pictures) -> list[tuple[FrameSequence, int]]:
    """Pictures as frames of one sequence."""
    sequence = pictures.sequence()
    return [(sequence, index) for index in range(len(sequence))]
