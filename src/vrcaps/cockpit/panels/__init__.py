"""Panels of the cockpit's page, one file each.

A panel is created with the page, adds its elements there, and then receives each view. `PANELS`
lists those of the page, from top to bottom, and then those of the window at the right.
"""

from vrcaps.cockpit.panels.camera_panel import CameraPanel
from vrcaps.cockpit.panels.chart_panel import ChartPanel
from vrcaps.cockpit.panels.driving_panel import DrivingPanel
from vrcaps.cockpit.panels.look_panel import LookPanel
from vrcaps.cockpit.panels.map_panel import MapPanel
from vrcaps.cockpit.panels.new_drive_panel import NewDrivePanel
from vrcaps.cockpit.panels.pad_panel import PadPanel
from vrcaps.cockpit.panels.patient_panel import PatientPanel
from vrcaps.cockpit.panels.policy_panel import PolicyPanel
from vrcaps.cockpit.panels.record_panel import RecordPanel
from vrcaps.cockpit.panels.run_panel import RunPanel
from vrcaps.cockpit.panels.scene_panel import ScenePanel

PANELS = (
    *(RunPanel, DrivingPanel, PadPanel, PolicyPanel, RecordPanel),
    *(PatientPanel, NewDrivePanel, LookPanel, ScenePanel),
    *(CameraPanel, MapPanel, ChartPanel),
)
