"""Registry of formats, one line each. A format is imported on use."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from vrcaps.core.errors import UnknownNameError

if TYPE_CHECKING:
    from vrcaps.formats.format import Format

FORMATS = {
    "tum": ("tum", "Tum", "TUM RGB-D, for visual SLAM and evo."),
    "kitti": ("kitti", "Kitti", "KITTI odometry, for visual odometry and evo."),
    "euroc": ("euroc", "Euroc", "EuRoC MAV, for visual SLAM."),
    "vslam-lab": ("vslam_lab", "VslamLab", "VSLAM-LAB, for dozens of visual SLAM systems."),
    "simcol3d": ("simcol3d", "SimCol3D", "SimCol3D, for depth and poses of a colonoscope."),
    "c3vd": ("c3vd", "C3vd", "C3VD, for depth, normals and poses of a colonoscope."),
    "endoslam": ("endoslam", "EndoSlam", "EndoSLAM's UnityCam, for depth and poses of a capsule."),
    "sfmlearner": ("sfmlearner", "SfmLearner", "SC-SfMLearner and EndoSfMLearner, for training."),
    "endomapper": ("endomapper", "EndoMapper", "EndoMapper's simulated sequences, with OpenEXR."),
    "images": ("images", "Images", "Folders of images by class, or with masks beside them."),
    "colmap": ("colmap", "Colmap", "COLMAP text model, for reconstruction and Gaussian splatting."),
    "nerfstudio": ("nerfstudio", "Nerfstudio", "nerfstudio, for radiance fields and splatting."),
    "coco": ("coco", "Coco", "COCO instances of lesions, for detection and segmentation."),
    "bop": ("bop", "Bop", "BOP, for 6D poses of lesions as objects."),
    "webdataset": ("webdataset", "WebDataset", "WebDataset shards, for sequential storage."),
    "hugging-face": ("hugging_face", "HuggingFace", "Parquet files for Hugging Face datasets."),
    "lerobot": ("lerobot", "LeRobot", "LeRobot v3.0, for learning to steer."),
    "mcap": ("mcap", "Mcap", "MCAP, for Foxglove."),
}
"""Module, class and summary of each format, by name, which equals its `kind`."""


def format_named(kind: str) -> type[Format]:
    """Return a format by name.

    Raises:
        UnknownNameError: If there is none.
    """
    if kind not in FORMATS:
        raise UnknownNameError("format", kind, FORMATS)
    module, noun, _ = FORMATS[kind]
    return getattr(import_module(f"vrcaps.formats.{module}"), noun)
