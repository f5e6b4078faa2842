"""Registry of all observations: the type of the setting."""

from typing import TypeAlias

from vrcaps.env.observations.coverage_map import MapObservation
from vrcaps.env.observations.image import ImageObservation
from vrcaps.env.observations.landmarks import LandmarksObservation
from vrcaps.env.observations.state import StateObservation

AnyObservation: TypeAlias = (
    StateObservation | LandmarksObservation | MapObservation | ImageObservation
)
