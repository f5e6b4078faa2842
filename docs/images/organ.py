"""Draw the picture of an organ: a generated colon with five lesions, as `vrcaps organ make` does.

python -m docs.images.organ
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

import vrcaps
from vrcaps.lesion import add_lesions, parse_lesion
from vrcaps.tools.reports.overview import write_overview

LESIONS = (
    *("polyp-Ip:size=14mm,segment=sigmoid", "polyp-Is:size=12mm,segment=transverse"),
    *("colitis-2:spread=12cm,segment=descending", "tumor:segment=ascending,size=28mm"),
    "bleeding-3:segment=rectum",
)


def main(path: Path) -> None:
    """Draw it, smaller than the command does."""
    organ = vrcaps.generate_organ("colon", seed=0)
    lesions = [parse_lesion(text) for text in LESIONS]
    patient = add_lesions(organ, lesions, np.random.default_rng(1))
    with TemporaryDirectory() as folder:
        write_overview(patient.organ, Path(folder) / "organ.png")
        with Image.open(Path(folder) / "organ.png") as image:
            size = (1100, round(1100 * image.height / image.width))
            picture = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    picture.save(path, quality=85)


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".jpg"))
