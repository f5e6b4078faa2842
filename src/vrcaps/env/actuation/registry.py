"""All actuations: the type of a settings' field."""

from typing import TypeAlias

from vrcaps.env.actuation.wrench import Wrench

AnyActuation: TypeAlias = Wrench
