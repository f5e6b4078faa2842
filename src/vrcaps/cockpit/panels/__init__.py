"""Panels of the cockpit's page.

A panel is created with the page, adds its elements there, and then receives each view. `PANELS`
lists those of the page, from top to bottom, and then those of the window at the right.
"""

from vrcaps.cockpit.panels.drive_panels import (
    DrivingPanel,
    PadPanel,
    PolicyPanel,
    RecordPanel,
    RunPanel,
)
from vrcaps.cockpit.panels.scene_panels import NewDrivePanel, PatientPanel, ScenePanel
from vrcaps.cockpit.panels.view_panels import CameraPanel, ChartPanel, MapPanel, RenderPanel

PANELS = (
    *(RunPanel, DrivingPanel, PadPanel, PolicyPanel, RecordPanel),
    *(PatientPanel, NewDrivePanel, RenderPanel, ScenePanel),
    *(CameraPanel, MapPanel, ChartPanel),
)
