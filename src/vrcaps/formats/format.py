"""Format protocol, requirements of a format, and the registry of formats."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol, runtime_checkable

from vrcaps.core.errors import InputError
from vrcaps.core.registry import Registry

if TYPE_CHECKING:
    from pathlib import Path

    from vrcaps.recording.frame_sequence import FrameSequence

Advance = Callable[[], None]
"""Called after each written frame."""


@dataclass(frozen=True)
class Needs:
    """Requirements of a format on the sequences.

    Attributes:
        channels: Image channels that every sequence must have, see `render.channels`.
        lenses: Kinds of the supported lenses; None supports any.
        poses: Whether camera poses must be known.
        episode: Whether only episodes can be written, because the format stores more than frames.
    """

    channels: tuple[str, ...] = ("rgb",)
    lenses: tuple[str, ...] | None = None
    poses: bool = True
    episode: bool = False


class Format(Protocol):
    """Layout of files that other tools read.

    A format is a frozen dataclass; its fields are the options of `vrcaps export KIND`.

    Attributes:
        kind: Name on the command line.
        needs: Requirements on the sequences.
    """

    kind: ClassVar[str]
    needs: ClassVar[Needs]

    def write(self, sequences: Sequence[FrameSequence], folder: Path, advance: Advance) -> None:
        """Write sequences into a new folder.

        Args:
            sequences: Sequences that meet `needs`.
            folder: Existing empty folder.
            advance: Called after each frame.
        """
        ...

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        """Return the sequences of a folder in this layout; images are read on demand.

        Raises:
            InputError: If the folder is not in this layout.
        """
        ...


@runtime_checkable
class NamedByFolder(Protocol):
    """Format whose files contain a name that follows the output folder by default."""

    def for_folder(self, out: Path) -> Format:
        """Return the format with the name filled in for an output folder."""
        ...


def require_channels(kind: str, sequence: FrameSequence, channels: Sequence[str]) -> None:
    """Check that a sequence has the channels that a format stores.

    Args:
        kind: Name of the format or layout, for the message.
        sequence: Sequence to write.
        channels: Required channels.

    Raises:
        InputError: If one is missing.
    """
    missing = [name for name in channels if name not in sequence.channels]
    if missing:
        raise InputError(
            f"{kind} requires the channel {missing[0]!r}; {sequence.name} lacks it. "
            f"Record with --channels {' '.join(dict.fromkeys((*sequence.channels, *missing)))}."
        )


_BUILT_IN = {
    "tum": ("slam.tum:Tum", "TUM RGB-D, for visual SLAM and evo."),
    "kitti": ("slam.kitti:Kitti", "KITTI odometry, for visual odometry and evo."),
    "euroc": ("slam.euroc:Euroc", "EuRoC MAV, for visual SLAM."),
    "vslam-lab": ("slam.euroc:VslamLab", "VSLAM-LAB, for dozens of visual SLAM systems."),
    "simcol3d": ("endoscopy.simcol3d:SimCol3D", "SimCol3D, for depth and poses of a colonoscope."),
    "c3vd": ("endoscopy.c3vd:C3vd", "C3VD, for depth, normals and poses of a colonoscope."),
    "endoslam": ("endoscopy.endoslam:EndoSlam", "EndoSLAM, for depth and poses of a capsule."),
    "sfmlearner": ("endoscopy.sfmlearner:SfmLearner", "SC-SfMLearner, for depth without labels."),
    "endomapper": ("endoscopy.endomapper:EndoMapper", "EndoMapper's simulation, with OpenEXR."),
    "images": ("detection.image_folders:Images", "Image folders by class, or with masks."),
    "colmap": ("splatting.colmap:Colmap", "COLMAP text model, for Gaussian splatting."),
    "nerfstudio": ("splatting.nerfstudio:Nerfstudio", "nerfstudio, for radiance fields."),
    "coco": ("detection.coco:Coco", "COCO lesion instances, for detection and segmentation."),
    "bop": ("detection.bop:Bop", "BOP, for 6D poses of lesions as objects."),
    "webdataset": ("storage.webdataset:WebDataset", "WebDataset shards, for sequential reading."),
    "hugging-face": (
        "storage.hugging_face:HuggingFace",
        "Parquet files for Hugging Face.",
    ),
    "lerobot": ("robotics.lerobot:LeRobot", "LeRobot v3.0, for imitation learning."),
    "minari": ("robotics.minari:Minari", "Minari, for offline reinforcement learning."),
    "mcap": ("robotics.mcap:Mcap", "MCAP, for Foxglove."),
    "ros2-bag": ("robotics.ros2_bag:Ros2Bag", "ROS 2 bag, for ROS and its tools."),
}

FORMATS: Registry[Format] = Registry(
    "format",
    {kind: (f"vrcaps.formats.{path}", summary) for kind, (path, summary) in _BUILT_IN.items()},
)
"""All formats by name, including those of plug-ins. A format is imported on first use."""
