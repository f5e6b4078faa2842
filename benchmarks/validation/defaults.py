"""Claim: default recordings are plausible.

Records every generated organ at every distension with default settings, by a flight and by random
views, and reports exposure and motion: clipped pixels (255 in every color), black pixels (luminance
below 5 of 255), mean luminance, and the largest distance between the capsule's places in
consecutive frames of a flight. Claimed: at most 5 % clipped and 50 % black pixels in the median
frame, at most 20 % clipped in any frame, and at most 5 mm between frames. `--sheet PATH` saves
frames of all recordings as one picture.

    python -m benchmarks.validation.defaults --sheet defaults.png
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from PIL import Image

from benchmarks.common.scripts import parser, table, write_section
from vrcaps.camera.camera import camera_rays
from vrcaps.core.color import LUMINANCE
from vrcaps.core.units import MM
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.motion.random_views import RandomViews
from vrcaps.organ.segments import Distension
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.recorder import record
from vrcaps.scenario.scenario import OrganGenerated, Scenario

ORGANS = ("colon", "stomach", "small-bowel", "full-tract")
CAPSULES = ("mirocam", "pillcam-colon2", "pillcam-sb3")
MOTIONS = (FlyThrough(), RandomViews())
MAX_CLIPPED, MAX_CLIPPED_ANY, MAX_BLACK, LONGEST_STEP = 0.05, 0.2, 0.5, 5.0 * MM
HEAD = ("recording", "mean luminance", "clipped", "black", "largest step [mm]", "holds")


@dataclass(frozen=True)
class Measured:
    """Exposure and motion of a recording.

    Attributes:
        clipped: Fraction of white pixels in each frame.
        black: Fraction of black pixels in each frame.
        luminance: Mean luminance of each frame, 0 to 255.
        step: Largest distance between places in consecutive frames of a flight [m]; 0 for others.
    """

    clipped: np.ndarray
    black: np.ndarray
    luminance: np.ndarray
    step: float

    @property
    def holds(self) -> bool:
        """Return whether the claim holds."""
        return bool(
            np.median(self.clipped) <= MAX_CLIPPED
            and self.clipped.max() <= MAX_CLIPPED_ANY
            and np.median(self.black) <= MAX_BLACK
            and self.step <= LONGEST_STEP
        )

    def row(self, name: str) -> tuple[str, ...]:
        """Row of the table."""
        return (
            name,
            f"{self.luminance.mean():.0f} ({self.luminance.min():.0f}–{self.luminance.max():.0f})",
            f"{np.median(self.clipped):.1%} (most {self.clipped.max():.1%})",
            f"{np.median(self.black):.1%} (most {self.black.max():.1%})",
            f"{self.step / MM:.2f}" if self.step else "",
            "yes" if self.holds else "**no**",
        )


def measure(episode: Episode) -> Measured:
    """Measure a recording on the pixels that its first camera sees."""
    camera = episode.cameras[0]
    lit = np.isfinite(camera_rays(camera)).all(axis=-1)
    images = [episode.image(camera.name, "rgb", k)[lit] for k in range(len(episode))]
    luminance = np.array([image @ LUMINANCE for image in images])
    steps = np.linalg.norm(np.diff(episode.Ts_world_capsule[:, :3, 3], axis=0), axis=1)
    is_flight = isinstance(episode.scenario.motion, FlyThrough)
    return Measured(
        clipped=np.array([(image == 255).all(axis=-1).mean() for image in images]),
        black=(luminance < 5.0).mean(axis=1),
        luminance=luminance.mean(axis=1),
        step=float(steps.max()) if is_flight else 0.0,
    )


def picture(episode: Episode) -> np.ndarray:
    """Six frames side by side."""
    chosen = np.linspace(0, len(episode) - 1, 6).round().astype(int)
    name = episode.cameras[0].name
    images = [Image.fromarray(episode.image(name, "rgb", k)).resize((160, 160)) for k in chosen]
    return np.hstack([np.asarray(image) for image in images])


def main() -> None:
    """Record and measure all, and write the table."""
    given = parser("Validate the default recordings.")
    given.add_argument("--frames", type=int, default=12, help="of each recording")
    given.add_argument("--sheet", type=Path, help="picture to save")
    options = given.parse_args()
    rows, pictures = [], []
    for organ in ORGANS:
        for distension in get_args(Distension):
            for k, motion in enumerate(MOTIONS):
                scenario = Scenario(
                    organ=OrganGenerated(organ, distension=distension),
                    capsule=CAPSULES[(k + len(rows)) % len(CAPSULES)],
                    motion=motion,
                    frames=options.frames,
                )
                name = f"{organ}, {distension}, {motion.kind}, {scenario.capsule}"
                with tempfile.TemporaryDirectory() as folder:
                    episode = read_episode(record(scenario, Path(folder) / "episode"))
                    rows.append(measure(episode).row(name))
                    pictures.append(picture(episode))
                print(" | ".join(rows[-1]), flush=True)
    if options.sheet is not None:
        Image.fromarray(np.vstack(pictures)).save(options.sheet)
    write_section(options.out, Path(__file__), f"## Default recordings\n\n{table(HEAD, rows)}")


if __name__ == "__main__":
    main()
