"""`vrcaps reconstruct`: reconstruct the wall from a run, by fusion of its frames or stitching."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from vrcaps.cli.arguments import require_file, require_folder, require_sources
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import InputError, require, require_extra
from vrcaps.core.files import atomic_folder, require_new_folder, write_bytes
from vrcaps.core.units import MM

if TYPE_CHECKING:
    import numpy as np

    from vrcaps.mesh.mesh import Mesh
    from vrcaps.recording.frame_sequence import FrameSequence


@dataclass(frozen=True)
class Reconstruct:
    """Reconstruct the wall from a recording, and compare it with the true wall.

    --method fusion fuses depth and poses of the whole run. Both are those of the recording, or
    estimates: depth from --weights, or --depth, the output folder of `vrcaps predict depth`; poses
    from --odometry, which matches features of the images, or --poses, a trajectory in TUM format.
    With --weights and --odometry, only the images are used.

    --method stitching follows algorithm 1 of the VR-Caps paper: highlights are inpainted, the
    images stitched into one without poses, its depth converted to a surface, and the surface
    registered to the true wall. Depth may then also come from --shading.

    The output folder contains mesh.ply, the wall in the colors of the images; for an episode also
    errors.csv, errors.ply and errors.png, the distances from the true wall at rest. Odometry adds
    poses.txt, in TUM format, in the frame of the first camera. Stitching adds highlights.png,
    matches.png and matches.csv, mosaic.png, depth.png and registration.csv.

    For example:
      vrcaps reconstruct runs/colon --out runs/colon-mesh
      vrcaps reconstruct runs/colon --weights depth --odometry --out runs/colon-estimated
      vrcaps reconstruct runs/colon --depth runs/colon-depth --out runs/colon-depth-mesh
      vrcaps reconstruct runs/colon --poses slam.txt --align sim3 --out runs/colon-slam
      vrcaps reconstruct runs/colon --method stitching --out runs/colon-stitched
      vrcaps reconstruct runs/colon --method stitching --weights depth --out runs/colon-as-paper
    """

    source: Positional[str]
    """Folder or URL of an episode, or KIND:FOLDER for a layout of `vrcaps export`."""

    out: Path
    """Folder to create."""

    method: Literal["fusion", "stitching"] = "fusion"
    """Reconstruction from depth and poses of all frames, or from one stitched image."""

    camera: str = ""
    """Camera to use; by default the first."""

    depth: Path | None = None
    """Folder of estimated depth from `vrcaps predict depth`."""

    weights: str = ""
    """Estimate depth by a network: a file of weights of `vrcaps train depth` or `sfm`, or the name
    of published ones, such as depth."""

    shading: bool = False
    """Estimate depth of the stitched image from its shading, assuming a uniform albedo."""

    poses: Path | None = None
    """File of estimated poses, rows `timestamp tx ty tz qx qy qz qw`, camera to world."""

    odometry: bool = False
    """Estimate poses from the images and their depth."""

    align: Literal["none", "se3", "sim3"] | None = None
    """Alignment to the true poses, for estimates in another frame or scale: none, SE(3) or Sim(3).
    By default none for --poses, and se3 for --odometry if true poses are known. With --odometry,
    sim3 also scales depth."""

    voxel_mm: float = 1.0
    """Side of a voxel of fusion [mm]."""

    max_distance_mm: float = 80.0
    """Distance beyond which depth is ignored in fusion [mm]."""

    field_of_view_deg: float = 90.0
    """Field of view of the images to stitch [deg]; less if the lens has less."""

    every: int = 1
    """Use every n-th frame."""

    min_views: int = 2
    """Minimum number of views of a voxel in fusion."""

    def run(self) -> None:
        """Reconstruct, compare and report.

        Raises:
            InputError: If depth or poses are missing or do not match.
        """
        self._check()
        from vrcaps.formats.io import read_source

        require_extra("reconstruct", "matplotlib", "skimage", "trimesh")
        require_new_folder(self.out)  # before the work
        with progress_bar("reading") as show:
            sequences = read_source(self.source, show)
        chosen = [one for one in sequences if self.camera in ("", one.name.rpartition("/")[2])]
        if not chosen:
            raise InputError(f"{self.source} has no camera {self.camera!r}.")
        sequence = chosen[0]
        with atomic_folder(self.out) as out:
            self._write(sequence, out)

    def _write(self, sequence: FrameSequence, out: Path) -> None:
        """Reconstruct and compare into a folder, which is renamed to `self.out` afterwards."""
        from vrcaps.tools.reconstruction.estimates import compare, write_comparison, write_ply

        make = self._fused if self.method == "fusion" else self._stitched
        mesh, color = make(sequence, out)
        write_ply(out / "mesh.ply", mesh, color)
        console.print(f"Wrote {self.out / 'mesh.ply'}, {len(mesh.faces)} triangles.")
        if sequence.episode is None:
            return
        errors = compare(mesh, sequence.episode.organ)
        write_comparison(out, mesh, errors)
        console.print(
            f"RMSE {errors.errors.rmse / MM:.2f} mm, median {errors.errors.median / MM:.2f} mm; "
            f"{100.0 * errors.completeness:.0f} % of the wall within 2 mm. See "
            f"{self.out / 'errors.png'}."
        )

    def _check(self) -> None:
        """Check that the depth flags match the method and each other, and that paths exist.

        Raises:
            InputError: If they do not.
        """
        if self.method == "fusion" and self.shading:
            raise InputError("--shading requires --method stitching.")
        if self.method == "stitching" and (self.odometry or self.poses is not None):
            flag = "--odometry" if self.odometry else "--poses"
            raise InputError(f"{flag} requires --method fusion.")
        if self.odometry and self.poses is not None:
            raise InputError("--poses and --odometry are both given. Give one of them.")
        if sum([self.weights != "", self.shading, self.depth is not None]) > 1:
            raise InputError(
                "Several of --depth, --weights and --shading are given. Give one of them."
            )
        require(self.every >= 1, "every", self.every, "1 or more")
        require_sources((self.source,))
        if self.depth is not None:
            require_folder(self.depth, "predictions of `vrcaps predict depth`")
        if self.poses is not None:
            require_file(self.poses, "a trajectory in TUM format")

    def _fused(self, sequence: FrameSequence, out: Path) -> tuple[Mesh, np.ndarray]:
        from vrcaps.learn.checkpoint import read_weights
        from vrcaps.learn.hub import find_weights
        from vrcaps.tools.reconstruction.estimates import (
            read_depth,
            read_poses,
            with_network_depth,
            with_poses,
        )
        from vrcaps.tools.reconstruction.fusion.fuse import FuseSettings, fuse

        settings = FuseSettings(self.voxel_mm * MM, self.max_distance_mm * MM, self.min_views)
        used = sequence
        if self.depth is not None:
            used = read_depth(self.depth, used)
        if self.weights:
            used = with_network_depth(used, read_weights(find_weights(self.weights)))
        if self.poses is not None:
            used = with_poses(used, read_poses(self.poses, sequence, self.align or "none"))
        used = used.subset(range(0, len(used), self.every))
        if self.odometry:
            used = self._tracked(used, out)
        with progress_bar("fusing") as progress:
            return fuse(used, settings, progress=progress)

    def _tracked(self, sequence: FrameSequence, out: Path) -> FrameSequence:
        """Frames whose poses odometry could estimate, with these poses."""
        from vrcaps.formats.slam.tum import trajectory_text
        from vrcaps.metrics.trajectory import absolute_trajectory_error
        from vrcaps.recording.frame_sequence import CAMERA_POSE
        from vrcaps.tools.reconstruction.estimates import aligned, with_poses
        from vrcaps.tools.reconstruction.fusion.odometry import OdometrySettings, estimated_poses

        with progress_bar("estimating poses") as progress:
            sequences = estimated_poses(sequence, OdometrySettings(), progress=progress)
        kept = sequence.subset(sequences.frames)
        estimate = with_poses(kept, sequences.Ts_first_camera)
        write_bytes(out / "poses.txt", trajectory_text(estimate).encode())
        console.print(f"Estimated the poses of {len(kept)} of {len(sequence)} frames.")
        if CAMERA_POSE not in sequence.values and self.align is None:
            return estimate
        align, truth = self.align or "se3", kept.Ts_world_camera
        error = absolute_trajectory_error(sequences.Ts_first_camera, truth, align=align)
        rmse = float((error**2).mean()) ** 0.5
        console.print(f"Absolute trajectory error {rmse / MM:.2f} mm ({align}).")
        return aligned(estimate, truth, align)

    def _stitched(self, sequence: FrameSequence, out: Path) -> tuple[Mesh, np.ndarray]:
        from vrcaps.tools.reconstruction.estimates import read_depth
        from vrcaps.tools.reconstruction.stitching.stitch import StitchSettings, stitch
        from vrcaps.tools.reconstruction.stitching.surface import (
            DepthSource,
            wall_surface,
            write_registration,
            write_stitched,
        )

        settings = StitchSettings(math.radians(self.field_of_view_deg), self.every)
        if self.depth is not None:
            sequence = read_depth(self.depth, sequence)
        with progress_bar("matching features") as progress:
            sequences = stitch(sequence, settings, progress=progress)
        used = len(sequences.mosaic.images)
        console.print(f"Stitched {used} of {len(sequences.frames)} frames.")
        sequences, surface = wall_surface(sequences, DepthSource(self.weights, self.shading))
        write_stitched(out, sequences)
        write_registration(out, surface)
        return surface.mesh, surface.color
