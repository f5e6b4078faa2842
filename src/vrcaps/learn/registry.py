"""Registry of all learners: their union type, and the learners by task."""

from typing import TypeAlias

from vrcaps.core.errors import UnknownNameError
from vrcaps.learn.classes import ClassLearner
from vrcaps.learn.depth import DepthLearner
from vrcaps.learn.masks import MaskLearner
from vrcaps.learn.sfm import SfmLearner
from vrcaps.learn.super_resolution import SuperResolutionLearner

AnyLearner: TypeAlias = (
    DepthLearner | MaskLearner | ClassLearner | SuperResolutionLearner | SfmLearner
)

LEARNERS: dict[str, type[AnyLearner]] = {
    learner.kind: learner
    for learner in (DepthLearner, MaskLearner, ClassLearner, SuperResolutionLearner, SfmLearner)
}
"""Learners by the names of their tasks."""


def learner_named(kind: str) -> type[AnyLearner]:
    """Return the learner of a task.

    Raises:
        UnknownNameError: If there is none.
    """
    if kind not in LEARNERS:
        raise UnknownNameError("task", kind, LEARNERS)
    return LEARNERS[kind]
