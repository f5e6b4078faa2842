"""Registry of tasks, and the former names of tasks and settings in old files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from vrcaps.core.registry import Registry

_TASKS = "vrcaps.learn.tasks"
TASKS: Registry[Any] = Registry(
    "task",
    {
        "depth": (f"{_TASKS}.depth:DepthTask", "Metric depth from one image."),
        "segmentation": (f"{_TASKS}.segmentation:SegmentationTask", "Lesion segmentation."),
        "classification": (
            f"{_TASKS}.classification:ClassificationTask",
            "Image classification: normal or lesion type.",
        ),
        "super-resolution": (
            f"{_TASKS}.super_resolution:SuperResolutionTask",
            "Super-resolution by a factor of two, four or eight.",
        ),
        "sfm": (f"{_TASKS}.sfm:SfmTask", "Depth and camera motion, trained without labels."),
    },
)
"""Classes of all tasks by name, subclasses of `vrcaps.learn.task.Task`."""

FORMER_TASKS = {"masks": "segmentation", "classes": "classification"}
"""Current name of a task by its former name."""
_FORMER_SETTINGS = {
    "learner": "task",
    "rate": "learning_rate",
    "hides": "mask_overlays",
    "size": "backbone.size",
    "encoder": "backbone.encoder",
    "brightness": "augmentation.exposure_jitter",
    "tint": "augmentation.color_jitter",
    "gamma": "augmentation.gamma_jitter",
    "zoom": "augmentation.min_crop",
}
"""Current path of a setting by its former name."""


def current_settings(cls: type[Any], plain: object) -> Any:
    """Replace the former names of settings in a plain table.

    Args:
        cls: Dataclass of the settings.
        plain: Table from a file of any version.
    """
    if not isinstance(plain, Mapping):
        return plain
    known = {field.name for field in fields(cls)}
    result: dict[str, object] = {}
    groups: dict[str, dict[str, object]] = {}
    for key, value in plain.items():
        group, _, name = _FORMER_SETTINGS.get(str(key), str(key)).partition(".")
        if key in known or group not in known or group in plain:
            result[key] = value
        elif name:
            groups.setdefault(group, {})[name] = value
        else:
            result[group] = value
    return {**result, **groups}
