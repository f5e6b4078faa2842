"""Registry of the tasks of an environment."""

from vrcaps.config.convert import register_family
from vrcaps.core.registry import Registry
from vrcaps.env.tasks.task import Task

_FOLDER = "vrcaps.env.tasks"
TASKS: Registry[Task] = Registry(
    "task",
    {
        "coverage": (f"{_FOLDER}.coverage:CoverageTask", "see the whole wall"),
        "navigate": (f"{_FOLDER}.navigate:NavigateTask", "reach a position along the gut"),
        "inspect": (f"{_FOLDER}.inspect:InspectTask", "look at each lesion"),
    },
)
"""Tasks by name, including those of plug-ins."""

register_family(Task, TASKS)
