"""Registry of all learners: their union type, and the learners by task."""

from typing import TypeAlias

from vrcaps.core.errors import UnknownNameError
from vrcaps.learn.tasks.classification import ClassificationTask
from vrcaps.learn.tasks.depth import DepthTask
from vrcaps.learn.tasks.segmentation import SegmentationTask
from vrcaps.learn.tasks.sfm import SfmTask
from vrcaps.learn.tasks.super_resolution import SuperResolutionTask

AnyTask: TypeAlias = (
    DepthTask | SegmentationTask | ClassificationTask | SuperResolutionTask | SfmTask
)

LEARNERS: dict[str, type[AnyTask]] = {
    learner.kind: learner
    for learner in (DepthTask, SegmentationTask, ClassificationTask, SuperResolutionTask, SfmTask)
}
"""Learners by the names of their tasks."""


def learner_named(kind: str) -> type[AnyTask]:
    """Return the learner of a task.

    Raises:
        UnknownNameError: If there is none.
    """
    if kind not in LEARNERS:
        raise UnknownNameError("task", kind, LEARNERS)
    return LEARNERS[kind]
