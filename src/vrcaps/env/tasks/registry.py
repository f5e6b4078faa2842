"""Registry of all tasks: the type of the setting."""

from typing import TypeAlias

from vrcaps.env.tasks.coverage import CoverageTask
from vrcaps.env.tasks.inspect import InspectTask
from vrcaps.env.tasks.navigate import NavigateTask

AnyTask: TypeAlias = CoverageTask | NavigateTask | InspectTask
