"""All formats: one line each."""

from vrcaps.errors import UnknownNameError
from vrcaps.formats.c3vd import C3vd
from vrcaps.formats.colmap import Colmap
from vrcaps.formats.endomapper import EndoMapper
from vrcaps.formats.endoslam import EndoSlam
from vrcaps.formats.format import Format
from vrcaps.formats.hugging_face import HuggingFace
from vrcaps.formats.kitti import Kitti
from vrcaps.formats.mcap import Mcap
from vrcaps.formats.simcol3d import SimCol3D
from vrcaps.formats.tum import Tum
from vrcaps.formats.webdataset import WebDataset

FORMATS: dict[str, type[Format]] = {
    form.kind: form
    for form in (
        Tum,
        Kitti,
        SimCol3D,
        C3vd,
        EndoSlam,
        EndoMapper,
        Colmap,
        WebDataset,
        HuggingFace,
        Mcap,
    )
}
"""Formats by their names."""


def format_named(kind: str) -> type[Format]:
    """A format by its name.

    Raises:
        UnknownNameError: If there is none.
    """
    if kind not in FORMATS:
        raise UnknownNameError("format", kind, FORMATS)
    return FORMATS[kind]
