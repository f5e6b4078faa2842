"""Draw the missing thumbnails of the examples, from a short run of each.

python -m docs.images.examples
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
SIDE_PX = 360
WITHOUT_PICTURE = {
    "09_own_controller": ROOT / "docs" / "images" / "gallery_segments_stomach.jpg",
    "10_train_a_policy": ROOT / "docs" / "images" / "policy.jpg",
}
"""Examples that print text only, and a picture for them."""


def picture_of(example: Path, folder: Path) -> Path:
    """Run an example; return the last picture in its output folder by depth and time."""
    if example.stem in WITHOUT_PICTURE:
        return WITHOUT_PICTURE[example.stem]
    out = folder / example.stem
    command = [sys.executable, str(example), "--smoke", "--out", str(out)]
    subprocess.run(command, check=True, cwd=folder)
    pictures = [p for p in out.rglob("*.png") if "images" not in p.parts and "front" not in p.parts]
    pictures += [p for p in folder.glob("*.png") if p.stem.startswith(example.stem)]
    return min(pictures, key=lambda path: (len(path.parts), -path.stat().st_mtime))


def main() -> None:
    """Write one thumbnail for each example that has none."""
    with tempfile.TemporaryDirectory() as folder:
        for example in sorted((ROOT / "examples").glob("[0-9]*.py")):
            thumbnail = ROOT / "docs" / "images" / f"example_{example.stem}.jpg"
            if thumbnail.exists():
                continue
            with Image.open(picture_of(example, Path(folder))) as picture:
                small = picture.convert("RGB")
            small.thumbnail((SIDE_PX, SIDE_PX // 2))
            small.save(thumbnail, quality=85)


if __name__ == "__main__":
    main()
