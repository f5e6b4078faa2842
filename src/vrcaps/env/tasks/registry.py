"""All tasks: the type of a settings' field."""

from typing import TypeAlias

from vrcaps.env.tasks.coverage import CoverageTask

AnyTask: TypeAlias = CoverageTask
