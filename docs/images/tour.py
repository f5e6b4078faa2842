"""Make a video of two minutes: patients, labeled frames, a magnet on an arm, a policy, the cockpit.

python -m docs.images.tour [--out tour.mp4] [--seed 0] [--quick]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import vrcaps
from vrcaps.actuation.arm.arm import frames as frames_of
from vrcaps.core.files import write_bytes
from vrcaps.core.geometry import transform_points, wall_of
from vrcaps.core.units import CM
from vrcaps.env.cameras import resized_camera
from vrcaps.motion.rollout import Rollout
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.evaluate import Plan, evaluate
from vrcaps.policy.evaluation import Evaluation
from vrcaps.recording.pictures import Preview, limits_of, picture
from vrcaps.scenario.scenario import parse_lesions
from vrcaps.tools.reports.evaluation import Subject
from vrcaps.tools.reports.run_video import write_run_video
from vrcaps.tools.reports.views import VIEWS, exposed_image, outside_view

WIDTH, HEIGHT, TITLE, BAND = 960, 540, 46, 64
"""Size of the video, height of the title above and of the caption below [px]."""
BACKGROUND, TEXT, QUIET, ACCENT = (18, 18, 22), (240, 240, 240), (150, 150, 158), (108, 184, 255)
RED, BLUE, STEEL = (214, 74, 64), (60, 130, 240), (165, 170, 180)
COLORS = np.array([[0.91, 0.62, 0.58], [0.85, 0.5, 0.48], [0.95, 0.74, 0.66], [0.8, 0.56, 0.6]])
FLOW = "flow_backward"


@dataclass(frozen=True)
class Length:
    """Length of the video.

    Attributes:
        fps: Frames per second.
        quick: Whether each chapter has two frames of coarse scenes, to test the script.
    """

    fps: float = 10.0
    quick: bool = False

    def count(self, seconds: float) -> int:
        """Number of frames of a chapter that lasts some seconds."""
        return 2 if self.quick else round(self.fps * seconds)


@dataclass(frozen=True)
class Shot:
    """A frame: title, picture between title and caption, and caption."""

    title: str
    picture: Image.Image
    caption: str


def main() -> None:
    """Make the video."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--out", type=Path, default=Path("tour.mp4"))
    options.add_argument("--seed", type=int, default=0, help="patients and drives")
    options.add_argument("--quick", action="store_true", help="a few frames of each chapter")
    given = options.parse_args()
    _require_writable(options, given)
    length = Length(2.0, quick=True) if given.quick else Length()
    video, count = Preview(fps=length.fps, width=WIDTH, height=HEIGHT, crf=40), 0
    for chapter in (opening, patients, labels, magnet, policy, cockpit, ending):
        for shot in chapter(length, given.seed):
            video.add([np.asarray(drawn(shot))])
            count += 1
    write_bytes(given.out, video.finish())
    text = f"Wrote {given.out}: {count} frames, {count / length.fps:.0f} s.\n"
    sys.stdout.write(text)


def _require_writable(options: argparse.ArgumentParser, given: argparse.Namespace) -> None:
    """Exit if the seed or the path of the video cannot be used, before minutes of work."""
    if given.seed < 0:
        options.error(f"--seed is {given.seed}. Allowed: 0 or more.")
    try:
        if given.out.is_dir():
            options.error(f"--out is {given.out}, a folder. Give a file.")
        given.out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=given.out.parent):
            pass
    except (OSError, ValueError) as error:
        options.error(f"--out is {given.out}: {error}. Give a file in a folder of yours.")


def drawn(shot: Shot) -> Image.Image:
    """Complete frame with its texts."""
    canvas = Image.new("RGB", (WIDTH, HEIGHT), BACKGROUND)
    canvas.paste(shot.picture, ((WIDTH - shot.picture.width) // 2, TITLE))
    draw = ImageDraw.Draw(canvas)
    draw.text((20, 10), shot.title, fill=ACCENT, font=font(24))
    draw.text((20, HEIGHT - BAND + 8), shot.caption, fill=TEXT, font=font(20), spacing=5)
    return canvas


def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Font of Pillow at a size."""
    return ImageFont.load_default(size)


def blank() -> tuple[Image.Image, ImageDraw.ImageDraw]:
    """Empty picture between title and caption."""
    made = Image.new("RGB", (WIDTH, HEIGHT - TITLE - BAND), BACKGROUND)
    return made, ImageDraw.Draw(made)


def on_background(view: np.ndarray) -> Image.Image:
    """Outside view [h w 3] from 0 to 1, with the background of the video in place of white."""
    shown = np.where((view == 1.0).all(axis=-1, keepdims=True), np.array(BACKGROUND) / 255.0, view)
    return Image.fromarray((255.0 * shown).astype(np.uint8))


def lines(texts: Sequence[str]) -> Image.Image:
    """Picture with lines of text, the first one large."""
    made, draw = blank()
    draw.text((60, 70), texts[0], fill=TEXT, font=font(52))
    for row, text in enumerate(texts[1:]):
        draw.text((62, 170 + 44 * row), text, fill=QUIET, font=font(25))
    return made


def opening(length: Length, seed: int) -> Iterator[Shot]:
    """Title of the video."""
    shown = lines(
        (
            "vrcaps",
            "A simulator of capsule endoscopes: patients, images with labels,",
            "contact with the wall, magnets, robot arms, policies.",
        )
    )
    for _ in range(length.count(5.0)):
        yield Shot("", shown, "Everything in this video is simulated and made by one script.")


def patients(length: Length, seed: int) -> Iterator[Shot]:
    """Stomachs of six patients, turning."""
    organs = [
        vrcaps.generate_organ("stomach", seed=seed + k) for k in range(1 if length.quick else 6)
    ]
    walls = [wall_of(organ.vertices, organ.faces) for organ in organs]
    centers = [0.5 * (o.vertices.min(axis=0) + o.vertices.max(axis=0)) for o in organs]
    half = 0.55 * max(float(np.ptp(o.vertices, axis=0).max()) for o in organs)
    colors = COLORS[np.arange(max(len(o.label_names) for o in organs)) % len(COLORS)]
    count = length.count(18.0)
    for number in range(0, count, 2):
        angle = 2.0 * np.pi * number / count
        turn = np.array(
            [[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        )
        axes = VIEWS["From the front"] @ turn
        made, draw = blank()
        for k, (organ, wall, center) in enumerate(zip(organs, walls, centers, strict=True)):
            view = outside_view(organ, wall, axes, center, half, colors=colors, size_px=205)
            left, top = 120 + 260 * (k % 3), 215 * (k // 3)
            made.paste(on_background(view), (left, top))
            draw.text((left, top + 6), f"patient {seed + k}", fill=QUIET, font=font(17))
        shot = Shot(
            "1  Patients",
            made,
            "Every seed is another patient: stomach, small bowel, colon or the full tract.\n"
            "Organs are also read from mesh files or made from CT scans.",
        )
        yield from (shot, shot)


def labels(length: Length, seed: int) -> Iterator[Shot]:
    """Images of a flight through a colon with polyps, with their labels."""
    organ = "stomach" if length.quick else "colon"
    channels = ("rgb", "depth", "normal", "instance", FLOW)
    scenario = vrcaps.Scenario(
        organ=vrcaps.OrganGenerated(organ, seed=seed),
        capsule="mirocam",
        lesions=parse_lesions(
            ("polyp-Ip:size=12mm", "polyp-Is:size=9mm") * (0 if length.quick else 6),
            None,
            seed,
            organ,
        ),
        seed=seed,
        motion=vrcaps.FlyThrough(start=0.1, end=0.9, speed=0.02),
        frames=length.count(27.0),
        fps=length.fps,
        channels=channels,
    )
    titles = {
        "depth": "depth (blue near, red far)", "normal": "surface normals",
        "instance": "polyps, each a color", FLOW: "motion in the image",
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        episode = vrcaps.read_episode(vrcaps.record(scenario, Path(folder) / "run"))
        camera, some = episode.cameras[0].name, range(0, len(episode), max(len(episode) // 20, 1))
        limits = {c: limits_of(c, [episode.image(camera, c, k) for k in some]) for c in channels}
        for number in range(len(episode)):
            made, draw = blank()
            for k, channel in enumerate(channels):
                shown = picture(channel, episode.image(camera, channel, number), limits[channel])
                side, row, column = (420, 0, 0) if k == 0 else (184, (k - 1) // 2, (k - 1) % 2)
                place = (40, 5) if k == 0 else (520 + 215 * column, 5 + 212 * row)
                made.paste(Image.fromarray(shown).resize((side, side)), place)
                if k:
                    at = (place[0], place[1] + side + 4)
                    draw.text(at, titles[channel], fill=QUIET, font=font(16))
            yield Shot(
                "2  Camera frames with exact labels",
                made,
                "The image of the capsule's camera, and what each pixel shows: distance,\n"
                "orientation, lesions and motion. Such frames train networks for depth and "
                "detection.",
            )


class SideView:
    """Stomach, capsule, magnet and arm, seen from the patient's feet."""

    def __init__(self, run: Rollout) -> None:
        assert run.program is not None
        model, self._robot = run.model, run.program.controller.actuator.robot
        organ = replace(model.organ, vertices=model.vertices_world)
        self._center, self._half = np.array([-0.16, 0.0, 0.21]), 0.42
        self._center[1] = model.vertices_world[:, 1].mean()
        self._axes = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
        colors = COLORS[np.arange(len(organ.label_names)) % len(COLORS)]
        args = (self._axes, self._center, self._half)
        normals = organ.normals @ model.T_world_patient[:3, :3].T
        organ = replace(organ, normals=normals)
        wall = wall_of(organ.vertices, organ.faces)
        view = outside_view(organ, wall, *args, colors=colors, size_px=425)
        self._image = on_background(view)
        self._device, self._low = model.device, float(model.vertices_world[:, 2].min())

    def at(
        self, T_world_capsule: np.ndarray, T_world_magnet: np.ndarray, angles: np.ndarray
    ) -> Image.Image:
        """Picture with the bodies at their poses."""
        made = self._image.copy()
        draw, robot = ImageDraw.Draw(made), self._robot
        joints = transform_points(robot.T_world_base, frames_of(robot.arm, angles)[:, :3, 3])
        ends = np.array([robot.T_world_base[:3, 3], *joints, T_world_magnet[:3, 3]])
        draw.line(self._points(ends), fill=STEEL, width=12, joint="curve")
        for x, y in self._points(ends[:-1]):
            draw.ellipse((x - 5, y - 5, x + 5, y + 5), fill=(60, 62, 70))
        diameter, height = robot.magnet.bounds
        size = 0.5 * np.array([diameter, diameter, height])
        self._hull(draw, T_world_magnet, size, RED)
        radius, half = self._device.radius, 0.5 * self._device.length
        self._hull(draw, T_world_capsule, np.array([radius, radius, half]), BLUE)
        return made

    def _hull(self, draw: ImageDraw.ImageDraw, pose: np.ndarray, half: np.ndarray, color) -> None:
        from scipy.spatial import ConvexHull

        angle = np.linspace(0.0, 2.0 * np.pi, 24)
        ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)
        points = np.vstack([half * (ring + np.array([0, 0, end])) for end in (-1.0, 1.0)])
        flat = np.array(self._points(transform_points(pose, points)))
        draw.polygon([tuple(p) for p in flat[ConvexHull(flat).vertices]], fill=color)

    def _points(self, points: np.ndarray) -> list[tuple[float, float]]:
        flat = (points - self._center) @ self._axes[:2].T / self._half
        side = self._image.width / 2.0
        return [((x + 1.0) * side, (1.0 - y) * side) for x, y in flat.tolist()]


def magnet(length: Length, seed: int) -> Iterator[Shot]:
    """A magnet on a robot arm leads the capsule through a stomach."""
    steering = vrcaps.MagnetSteering(arm="panda", wall="upper", standoff=3.0 * CM, speed=1.0 * CM)
    scenario = vrcaps.Scenario(
        organ=vrcaps.OrganGenerated("stomach", seed=seed, distension="inflated"),
        capsule="magnetic",
        motion=vrcaps.Dynamics(
            start=0.05, magnet=steering, dynamics="quasi-static", settle=0.0, substep=1e-3
        ),
        frames=max(length.count(30.0) // 2, 2),
        fps=0.5 * length.fps,
        seed=seed,
    )
    model, run = vrcaps.build(scenario)
    assert isinstance(run, Rollout)
    view, camera = SideView(run), resized_camera(model.device.cameras[0], 300, 300)
    camera = resized_camera(camera, 40, 40) if length.quick else camera
    settings = vrcaps.RenderSettings(light="direct", supersampling=2, shadows=True)
    renderer = vrcaps.Renderer(model, settings)
    for step in run.steps():
        assert step.command is not None and step.command.controller is not None
        actuator, coupling = step.command.controller.actuator, step.state.coupling
        made, draw = blank()
        pose = step.state.T_world_capsule
        made.paste(view.at(pose, actuator.T_world_magnet, actuator.joint_angles), (40, 0))
        inside = Image.fromarray(exposed_image(renderer, step.state, camera))
        made.paste(inside.resize((300, 300)), (560, 0))
        force = 0.0 if coupling is None else 1e3 * float(np.linalg.norm(coupling.force_world))
        gap = np.linalg.norm(actuator.T_world_magnet[:3, 3] - pose[:3, 3]) / CM
        rows = (
            f"time {step.state.time:.1f} s",
            f"magnet {gap:.0f} cm away",
            f"pull {force:.0f} mN",
        )
        for k, row in enumerate(rows):
            draw.text((560, 315 + 36 * k), row, fill=TEXT, font=font(24))
        shot = Shot(
            "3  A magnet on a robot arm carries the capsule",
            made,
            "Red: magnet, blue: capsule, gray: arm, seen from the patient's feet. Right: capsule "
            "camera.\n"
            "Magnetic force, gravity and contact with the soft wall move the capsule.",
        )
        yield from (shot, shot)


def policy(length: Length, seed: int) -> Iterator[Shot]:
    """A planner sees the wall of a stomach by a magnet, with the observations of a device."""
    import av

    chosen = read_policy("explorer")
    settings = vrcaps.env.env_settings(**dict(chosen.requires.settings) | {"dynamics": "physics"})
    seconds = 0.4 if length.quick else 48.0
    settings = replace(
        settings, organs=(f"stomach:{seed + (0 if length.quick else 100)}",), substep=1e-3,
        episode_time=seconds, stuck_time=2.0 * seconds,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        evaluation = Evaluation(Path(folder), {})
        evaluate(chosen, settings, Plan(1, 1, 1), evaluation)
        path = Path(folder) / "run.mp4"
        write_run_video(path, Subject("explorer", evaluation, settings))
        with av.open(str(path)) as video:
            shown = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    count = length.count(24.0)
    for number in range(count):
        frame = Image.fromarray(shown[min(number, len(shown) - 1)])
        made, _ = blank()
        made.paste(frame.resize((WIDTH, round(WIDTH * frame.height / frame.width))), (0, 14))
        yield Shot(
            "4  A policy that a device could run",
            made,
            "The planner knows a located pose and estimated distances only, and moves the magnet.\n"
            "Green: the wall seen so far. Played at twice the speed.",
        )


def cockpit(length: Length, seed: int) -> Iterator[Shot]:
    """Picture of the cockpit, with its parts outlined one after the other."""
    page = Image.open(Path(__file__).parent / "cockpit.jpg").convert("RGB")
    side = min((HEIGHT - TITLE - BAND) / page.height, WIDTH / page.width)
    page = page.resize((round(side * page.width), round(side * page.height)))
    parts = (
        ((0.0, 0.07, 0.4, 0.76), "Camera and keys: drive by keyboard, gamepad or touch."),
        (
            (0.4, 0.07, 0.75, 0.76),
            "Scene: organ, capsule, magnet and patient; turn it by dragging.",
        ),
        ((0.0, 0.76, 0.75, 1.0), "The seen wall, and charts of force and speed."),
        ((0.75, 0.07, 1.0, 1.0), "Policies, coils, snapshots, patient and image."),
    )
    count = length.count(12.0)
    for number in range(count):
        (x0, y0, x1, y1), text = parts[number * len(parts) // count]
        made = page.copy()
        box = (x0 * page.width, y0 * page.height, x1 * page.width - 1, y1 * page.height - 1)
        ImageDraw.Draw(made).rectangle(box, outline=ACCENT, width=4)
        yield Shot("5  The cockpit in a browser", made, f"vrcaps cockpit\n{text}")


def ending(length: Length, seed: int) -> Iterator[Shot]:
    """Commands to start with."""
    shown = lines(
        (
            "Try it",
            "pip install 'vrcaps[cockpit,video]'",
            "vrcaps demo",
            "vrcaps record --organ colon --frames 100 --out runs/colon",
            "vrcaps cockpit",
        )
    )
    for _ in range(length.count(4.0)):
        yield Shot("", shown, f"Made by python -m docs.images.tour --seed {seed}")


if __name__ == "__main__":
    main()
