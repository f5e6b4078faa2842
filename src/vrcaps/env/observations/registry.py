"""All observations: the type of a settings' field."""

from typing import TypeAlias

from vrcaps.env.observations.state import StateObservation

AnyObservation: TypeAlias = StateObservation
