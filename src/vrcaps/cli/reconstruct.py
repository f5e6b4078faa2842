"""`vrcaps reconstruct`: the wall that a run saw, from depth and poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from vrcaps.cli.console import console, progress_bar
from vrcaps.errors import InputError
from vrcaps.files import require_new_folder
from vrcaps.units import MM


@dataclass(frozen=True)
class Reconstruct:
    """Fuse depth and poses of a whole run into a surface, and compare it with the true wall.

    Depth and poses are those of the recording, or estimates: --depth takes the folder that `vrcaps
    predict depth` wrote, --poses a trajectory in TUM's form. The folder then holds mesh.ply, the
    wall in the colors of the images; and for an episode errors.csv, errors.ply and errors.png, its
    distances from the true wall at rest.

    For example:
      vrcaps reconstruct runs/colon --out runs/colon-mesh
      vrcaps reconstruct runs/colon --depth runs/colon-depth --out runs/colon-estimated
      vrcaps reconstruct runs/colon --poses slam.txt --align sim3 --out runs/colon-slam
    """

    source: Positional[str]
    """Folder or URL of an episode, or KIND:FOLDER for a layout of `vrcaps export`."""

    out: Path
    """Folder to make."""

    camera: str = ""
    """Camera to use; by default the first."""

    depth: Path | None = None
    """Folder of estimated depth that `vrcaps predict depth` wrote."""

    poses: Path | None = None
    """File of estimated poses, rows `timestamp tx ty tz qx qy qz qw`, camera to world."""

    align: Literal["none", "se3", "sim3"] = "none"
    """What is fitted to the true poses first, for estimates in a frame or scale of their own."""

    voxel_mm: float = 1.0
    """Side of a voxel [mm]."""

    max_distance_mm: float = 80.0
    """Distance beyond which depth is left out [mm]."""

    every: int = 1
    """Every how many frames is used."""

    min_views: int = 2
    """Views in which a place must have been seen to count."""

    def run(self) -> None:
        """Reconstruct, compare and report.

        Raises:
            InputError: If depth or poses are missing or do not fit.
        """
        from vrcaps.formats.sources import read_source
        from vrcaps.tools.reconstruction.compare import compare, write_comparison, write_ply
        from vrcaps.tools.reconstruction.estimates import read_depth, read_poses
        from vrcaps.tools.reconstruction.fuse import FuseSettings, fuse

        require_new_folder(self.out)
        found = read_source(self.source)
        chosen = [one for one in found if self.camera in ("", one.name.rpartition("/")[2])]
        if not chosen:
            raise InputError(f"{self.source} has no camera {self.camera!r}.")
        sequence = chosen[0]
        settings = FuseSettings(
            self.voxel_mm * MM, self.max_distance_mm * MM, self.every, self.min_views
        )
        with progress_bar("fusing") as progress:
            mesh, color = fuse(
                sequence,
                settings,
                depth_of=None if self.depth is None else read_depth(self.depth, sequence),
                Ts_world_camera=(
                    None if self.poses is None else read_poses(self.poses, sequence, self.align)
                ),
                progress=progress,
            )
        self.out.mkdir(parents=True, exist_ok=True)
        write_ply(self.out / "mesh.ply", mesh, color)
        console.print(f"Written: {self.out / 'mesh.ply'}, {len(mesh.faces)} triangles.")
        if sequence.episode is None:
            return
        errors = compare(mesh, sequence.episode.organ)
        write_comparison(self.out, mesh, errors)
        console.print(
            f"RMSE {errors.errors.rmse / MM:.2f} mm, median {errors.errors.median / MM:.2f} mm; "
            f"{100.0 * errors.completeness:.0f} % of the wall within 2 mm. See "
            f"{self.out / 'errors.png'}."
        )
