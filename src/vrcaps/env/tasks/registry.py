"""All tasks: the type of a settings' field."""

from typing import TypeAlias

from vrcaps.env.tasks.coverage import CoverageTask
from vrcaps.env.tasks.inspect import InspectTask
from vrcaps.env.tasks.navigate import NavigateTask

AnyTask: TypeAlias = CoverageTask | NavigateTask | InspectTask
