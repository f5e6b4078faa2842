"""Lens models: projection from directions in the camera frame to pixels, and back.

| kind              | class               | image radius r at the angle θ to the axis  |
| ----------------- | ------------------- | ------------------------------------------ |
| `pinhole`         | LensPinhole         | tan θ, with Brown-Conrady distortion       |
| `kannala-brandt`  | LensKannalaBrandt   | θ + k1 θ³ + k2 θ⁵ + k3 θ⁷ + k4 θ⁹ (OpenCV) |
| `scaramuzza`      | LensScaramuzza      | tan θ = r / (a0 + a2 r² + a3 r³ + a4 r⁴)   |
| `equidistant`     | LensEquidistant     | f θ                                        |
| `equirectangular` | LensEquirectangular | longitude and latitude                     |
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Union

from vrcaps.camera.lens.base import Lens as Lens
from vrcaps.camera.lens.pinhole import LensPinhole as LensPinhole
from vrcaps.camera.lens.wide_angle import LensEquidistant as LensEquidistant
from vrcaps.camera.lens.wide_angle import LensEquirectangular as LensEquirectangular
from vrcaps.camera.lens.wide_angle import LensKannalaBrandt as LensKannalaBrandt
from vrcaps.camera.lens.wide_angle import LensScaramuzza as LensScaramuzza

LENSES: dict[str, type[Lens]] = {
    lens.kind: lens
    for lens in (
        LensPinhole,
        LensKannalaBrandt,
        LensScaramuzza,
        LensEquidistant,
        LensEquirectangular,
    )
}
"""Lens classes by their `kind` in files."""

if TYPE_CHECKING:
    AnyLens = Lens
else:
    AnyLens = Union[tuple(LENSES.values())]  # noqa: UP007
"""Any of the lens models, as stored in files."""
