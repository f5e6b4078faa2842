"""Draw the picture of narrow-band imaging: four places of a generated colon in both lights.

python -m docs.images.narrow_band
"""

from __future__ import annotations

from pathlib import Path

import vrcaps
from docs.images.views import save_rows, view_row


def main(path: Path) -> None:
    """White light above, narrow bands below."""
    model = vrcaps.Model(vrcaps.generate_organ("colon", seed=0), vrcaps.read_device("mirocam"))
    save_rows([view_row(model, imaging=mode) for mode in ("white-light", "narrow-band")], path)


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".jpg"))
