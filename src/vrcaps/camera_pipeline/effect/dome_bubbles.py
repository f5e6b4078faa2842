"""Bubbles on the capsule's dome."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

from vrcaps.camera_pipeline.effect.base import SceneEffect
from vrcaps.config.limits import Range
from vrcaps.lumen.bubbles import Bubbles

if TYPE_CHECKING:
    from vrcaps.lumen.contents import Contents


@dataclass(frozen=True)
class DomeBubbles(SceneEffect):
    """Bubbles on each round end of the capsule, replacing those of the contents.

    Attributes:
        count: Number of bubbles on each end.
    """

    count: Annotated[int, Range(min=0)]

    name = "dome_bubbles"
    severities = ({"count": 0}, {"count": 1}, {"count": 2}, {"count": 4}, {"count": 9})

    def on_contents(self, contents: Contents) -> Contents:
        """Return the contents with these bubbles on the capsule."""
        bubbles = contents.resolved[0] if contents.bubbles else Bubbles(per_area=0.0)
        return replace(contents, bubbles=replace(bubbles, on_dome=self.count))
