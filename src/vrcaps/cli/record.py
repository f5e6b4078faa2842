"""`vrcaps record` and `vrcaps demo`: a labeled run, written as an episode."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction

from vrcaps.cli.console import console, progress_bars
from vrcaps.cli.organ import lesion_lines
from vrcaps.cli.scenario_flags import ImageFlags, MotionFlags, OrganFlags, changes, steer_path
from vrcaps.core.errors import InputError, require
from vrcaps.core.processes import MAX_WORKERS
from vrcaps.scenario.scenario import parse_lesions
from vrcaps.scenario.settings import changed, parse_change, settings

if TYPE_CHECKING:
    from vrcaps.scenario.scenario import Scenario


def run_recording(scenario: Scenario, out: Path, *, threads: int | None = None) -> None:
    """Record a scenario and print a summary.

    Args:
        scenario: Scenario to record.
        out: Folder of the episode.
        threads: Number of threads; None leaves it to the core.

    Raises:
        InputError: If the number of threads or the scenario is invalid.
    """
    use_threads(threads)
    from vrcaps.recording.recorder import record
    from vrcaps.recording.resume import is_recorded

    started, was_complete = time.perf_counter(), is_recorded(out)
    times: list[float] = []
    with progress_bars("recording", "simulating") as (advance, simulated):

        def progress(num_done: int, total: int) -> None:
            times.append(time.perf_counter())
            if num_done == 1:
                _show_first_image(out)
            advance(num_done, total)

        record(scenario, out, progress=progress, simulated=simulated)
    _summarize(out, [] if was_complete else times, time.perf_counter() - started)


def _show_first_image(out: Path) -> None:
    """Print the path of the first color image, which can be opened while the others are made."""
    if image := min(out.glob("*/rgb/[0-9]*"), default=None):
        console.print(f"First image: {image}.")


def use_threads(threads: int | None) -> None:
    """Limit the threads of core and denoiser; only before the first parallel work.

    Raises:
        InputError: If there would be fewer than one, or too many.
    """
    if threads is None:
        return
    require(1 <= threads <= MAX_WORKERS, "--threads", threads, f"1 to {MAX_WORKERS}")
    os.environ["RAYON_NUM_THREADS"] = os.environ["OIDN_NUM_THREADS"] = str(threads)


def _summarize(out: Path, times: list[float], seconds: float) -> None:
    """Print the path of the episode, its contents, the speed, and files to open.

    Without times, the episode was complete before.
    """
    from vrcaps.recording.episode import read_episode

    episode = read_episode(out)
    cameras = ", ".join(camera.name for camera in episode.cameras)
    frames = f"{len(episode)} {'frame' if len(episode) == 1 else 'frames'} of {cameras}"
    if times:
        console.print(f"Recorded {frames} into {out} in {seconds:.1f} s", end="")
    else:
        console.print(f"{out} is complete: {frames}", end="")
    if len(times) > 1 and times[-1] > times[0]:
        rate = (len(times) - 1) / (times[-1] - times[0])
        console.print(f" ({rate:.0f} frames per second once set up)", end="")
    console.print(".")
    console.print(f"Channels: {', '.join(episode.channels)}.")
    organ = episode.head["organ"]
    for line in lesion_lines(organ.get("lesions", []), organ["centerline_length_m"]):
        console.print(f"Lesion {line}.")
    for line in lesion_lines(organ.get("clean_twin_of", []), organ["centerline_length_m"]):
        console.print(f"Without lesion {line}.")
    for note in episode.head.get("motion_notes", []):
        console.print(f"Note: {note}")
    pictures = [out / name for name in ("sheet.png", "preview.mp4") if (out / name).exists()]
    console.print(f"Look at {' and '.join(str(path) for path in pictures)}.")
    if "rgb" in episode.channels and len(pictures) == 1:
        console.print("For a video of later recordings: pip install 'vrcaps[video]'")
    console.print(f"Check it with: vrcaps check {out}")


@dataclass(frozen=True)
class Record:
    """Move a capsule through an organ and record its cameras' images, every pixel labeled.

    The result is an episode: images by camera and channel, a table of poses, the organ as GLB, a
    contact sheet and a preview. To resume an interrupted run, repeat the command.

    Unless they are set, bubbles, debris, turbid fluid, the film on the dome, tilt and distension
    are drawn by prevalence in a generated organ; --set variation=false leaves the lumen empty.

    A scenario file describes a whole recording; flags and --set change individual values. Every
    value of the scenario has a path: vrcaps record --list-settings prints all of them with their
    types, units and defaults.

    For example:
      vrcaps record --out runs/colon --organ colon --seed 3 --frames 300
      vrcaps record --out runs/mine --organ colon.ply --unit mm --capsule pillcam-colon2
      vrcaps record --out runs/polyp --lesion polyp-Ip:size=12mm,segment=sigmoid
      vrcaps record --out runs/cheap --effects dof=1,noise=2,motion_blur=1,jpeg=2
      vrcaps record --out runs/foam --organ small-bowel --set contents.bubbles=3
      vrcaps record --out runs/empty --organ small-bowel --set variation=false
      vrcaps record --out runs/path --frames 20 --light path --set render.spp=64
      vrcaps record --out runs/soft --organ small-bowel --motion dynamics
      --set motion.motility=phase-three
      vrcaps record --out runs/steer --organ stomach --capsule magnetic --motion dynamics
      --set motion.magnet.arm=panda
      vrcaps record my.toml --out runs/mine --frames 20 --set motion.drift=0.1
      vrcaps record runs/mine/episode.json --out runs/again
    """

    scenario: Positional[Path | None] = None
    """Scenario file (TOML, JSON), or the episode.json of an episode to record again."""

    out: Path | None = None
    """Folder of the episode: new, empty, or an interrupted run of the same recording."""

    organ: OmitArgPrefixes[OrganFlags] = field(default_factory=OrganFlags)  # pyright: ignore
    """The patient: the organ, its lesions and the contents of its lumen."""

    motion: OmitArgPrefixes[MotionFlags] = field(default_factory=MotionFlags)  # pyright: ignore
    """The capsule and its motion."""

    images: OmitArgPrefixes[ImageFlags] = field(default_factory=ImageFlags)  # pyright: ignore
    """Output: images, sensors, and the seed of all randomness."""

    set: UseAppendAction[tuple[str, ...]] = ()
    """Change any value of the scenario: PATH=VALUE, such as motion.tilt=0.1; repeat for more."""

    coverage: bool = False
    """Measure how much of the organ the images show, as vrcaps coverage does; adds the required
    channels."""

    list_settings: bool = False
    """Print all values that --set can change, then exit."""

    threads: int | None = None
    """Number of threads; by default all cores. The files do not depend on it."""

    def run(self) -> None:
        """Record and report.

        Raises:
            InputError: If there is no output folder or the scenario is invalid.
        """
        if self.list_settings:
            for line in setting_lines():
                console.print(line)
            return
        if self.out is None:
            raise InputError("--out is missing. Give the folder of the episode.")
        run_recording(self.resolved(), self.out, threads=self.threads)
        if self.coverage:
            from vrcaps.cli.episodes import Coverage

            Coverage(self.out).run()

    def resolved(self) -> Scenario:
        """Scenario of the file with the changes of the flags.

        Raises:
            InputError: If a value is invalid, a path is unknown, or flags contradict.
        """
        from vrcaps.scenario.scenario import read_plain_scenario, scenario_from_plain

        plain: Any = {}
        if self.scenario is not None:
            plain = read_plain_scenario(self.scenario)
        flags = {**vars(self.organ), **vars(self.motion), **vars(self.images)}
        for path, value in (*changes(flags), *map(parse_change, self.set)):
            plain = changed(plain, path, value)
        if flags["steer"] is not None:
            plain = changed(plain, steer_path(plain), flags["steer"])
        is_toml = self.scenario is None or self.scenario.suffix == ".toml"
        scenario = scenario_from_plain(plain, units=is_toml)
        lesions = self._lesions(scenario)
        if lesions:
            scenario = scenario_from_plain(changed(plain, "lesions", lesions), units=is_toml)
        return _with_coverage_channels(scenario) if self.coverage else scenario

    def _lesions(self, scenario: Scenario) -> list[Any]:
        """Plain values of the scenario's lesions and those of the flags; empty without new ones."""
        from vrcaps.config.convert import to_plain
        from vrcaps.lesion import Lesion
        from vrcaps.scenario.scenario import OrganGenerated

        organ = scenario.organ
        is_generated = isinstance(organ, OrganGenerated)
        seed, name = (organ.seed, organ.name) if is_generated else (scenario.seed, "")
        new = parse_lesions(self.organ.lesion, self.organ.lesions, seed, name)
        return to_plain((*scenario.lesions, *new), tuple[Lesion, ...]) if new else []


def _with_coverage_channels(scenario: Scenario) -> Scenario:
    from vrcaps.tools.reports.coverage import COVERAGE_CHANNELS

    missing = (name for name in COVERAGE_CHANNELS if name not in scenario.channels)
    return replace(scenario, channels=(*scenario.channels, *missing))


def setting_lines() -> Iterator[str]:
    """All settings of a scenario, one or two lines each."""
    yield "Values of a scenario: PATH: TYPE = DEFAULT, [kind of the table where there are several]."
    for setting in settings():
        kind = f" [{setting.kind}]" if setting.kind else ""
        yield f"{setting.path}: {setting.type_name} = {setting.default_text}{kind}"
        if setting.doc:
            yield f"    {setting.doc}"


@dataclass(frozen=True)
class Demo:
    """Record a labeled run through the generated colon, and name the image to open.

    For example:
      vrcaps demo
    """

    out: Path | None = None
    """Folder of the episode; by default runs/demo, or the first free one of runs/demo-2, …"""

    def run(self) -> None:
        """Record and report."""
        from vrcaps.motion.fly_through import FlyThrough
        from vrcaps.scenario.scenario import Scenario

        channels = ("rgb", "depth", "normal", "label", "arc_length")
        scenario = Scenario(frames=150, fps=10.0, channels=channels, motion=FlyThrough(whole=True))
        run_recording(scenario, self.out or _free_folder(Path("runs/demo")))


def _free_folder(wanted: Path) -> Path:
    """Path itself, or with the first suffix -2, -3, … under which no folder exists."""
    others = (wanted.with_name(f"{wanted.name}-{suffix}") for suffix in count(2))
    return next(folder for folder in chain([wanted], others) if not folder.exists())
