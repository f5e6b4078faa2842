"""Repair of wall surfaces from mesh files and CT."""

from __future__ import annotations

from .components import require_lumen_surface as require_lumen_surface
from .repair import repair as repair
from .repair_report import Repair as Repair
from .repair_report import RepairReport as RepairReport
