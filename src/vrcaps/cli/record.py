"""`vrcaps record`: a labelled run, written as an episode."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import OmitArgPrefixes, UseAppendAction, arg

from vrcaps.cli.lesions import chosen_lesions
from vrcaps.cli.record_dynamics import DynamicsFlags, dynamics_motion
from vrcaps.cli.record_magnet import MagnetFlags
from vrcaps.cli.recording import run_recording
from vrcaps.errors import InputError
from vrcaps.lumen.contents import Contents
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.organ.organ_file import is_organ_file
from vrcaps.render.frame import CHANNELS
from vrcaps.render.settings import RECORDED, RenderSettings
from vrcaps.units import LENGTH_UNITS

if TYPE_CHECKING:
    from vrcaps.motion.dynamics import Dynamics
    from vrcaps.motion.replay import Replay
    from vrcaps.scenario.scenario import OrganFile, OrganGenerated, Scenario


@dataclass(frozen=True)
class Record:
    """Fly a capsule through an organ and write what its cameras see, every pixel labelled.

    The result is an episode: images by camera and channel, a table of poses, the organ as
    GLB, a contact sheet and a preview. A run that was broken off goes on where it stopped.

    For example:
      vrcaps record --out runs/colon --organ colon --seed 3 --frames 300
      vrcaps record --out runs/empty --organ small-bowel --distension collapsed
      vrcaps record --out runs/mine --organ colon.ply --unit mm --capsule pillcam-colon2
      vrcaps record --out runs/patient --organ colon-3.glb
      vrcaps record --out runs/polyp --lesion polyp-Ip:size=12mm,segment=sigmoid
      vrcaps record --out runs/foam --organ small-bowel --bubbles 3 --chyme 1 --liquid 2
      vrcaps record --out runs/cheap --effects dof=1,noise=2,motion_blur=1,jpeg=2
      vrcaps record --out runs/glow --frames 20 --light path --spp 64
      vrcaps record --out runs/photo --organ colon --mucosa my-mucosa
      vrcaps record --out runs/soft --organ small-bowel --motion dynamics --motility phase-three
      vrcaps record --out runs/roll --organ stomach --motion dynamics \
          --posture-change left-lateral:time=4
      vrcaps record --out runs/led --organ stomach --capsule magnetic --motion magnet --arm panda
      vrcaps record --out runs/sense --capsule magnetic --sensors imu magnetometer hall
      vrcaps record --out runs/path --path poses.txt --path-format tum --path-unit m
      vrcaps record --out runs/again --scenario runs/mine/episode.json
    """

    out: Path
    """Folder of the episode: new, empty, or a broken-off run of the same recording."""

    scenario: Path | None = None
    """Record just what this file says: JSON, TOML, or the episode.json of an episode."""

    organ: str = "colon"
    """Name of a generated organ, a mesh file (PLY, OBJ, STL, GLB), or an organ file: a GLB that
    vrcaps organ wrote, taken as it is with its labels, lesions and textures."""

    unit: str | None = None
    """Length unit of the mesh file: m, dm, cm, mm, um, or e.g. 5cm. Never guessed. An organ file
    needs none."""

    open_ends: Literal["cap", "keep"] = "cap"
    """Whether a mesh file's open ends of the lumen are capped or kept."""

    keep_uv: bool = False
    """Keep a mesh file's own texture coordinates."""

    reverse: bool = False
    """The narrower end of a mesh file's lumen is the oral one."""

    mucosa: str | None = None
    """Look of the wall: colon, stomach or small-bowel, or the folder of a texture that
    vrcaps organ texture wrote; by default the organ's own, see docs/mucosa.md."""

    patient: int | None = None
    """Seed of a generated organ; by default --seed. Give it to fly many runs through one."""

    distension: Literal["inflated", "normal", "collapsed"] | None = None
    """How full a generated organ is; by default the colon is inflated, all else normal."""

    lesion: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Put this into the organ; give it again for more. A kind with its grade, then what differs:
    polyp-Ip:size=12mm,segment=sigmoid, colitis-2:spread=E2, bleeding-3, or a name of the
    library such as polyp-Is-villous or colitis-3-07."""

    lesions: str | None = None
    """A file of lesions (TOML or JSON), or prevalence: as many as such a patient has."""

    clean_twin: bool = False
    """Record the same flight through the same patient without the lesions."""

    bubbles: int = 0
    """Bubbles in the lumen, by grade: 0 none, 1 a few, 2 rings, 3 rafts, 4 foam."""

    chyme: int = 0
    """Yellow and white particles of food, by grade: 0 none, 1 specks, … 4 much of the wall."""

    liquid: int = 0
    """Liquid in the lumen's dips, by grade: 0 none, 1 puddles, … 4 a third full."""

    preparation: int | None = None
    """How well a colon was cleansed, by the Boston scale: 3 clean, 2 fragments, 1 parts of the
    wall hidden, 0 full of stool; in place of --bubbles, --chyme and --liquid."""

    effects: str = ""
    """Lens and sensor by grade 0 to 4, such as specular=3,dof=1,noise=1..3 (a range: drawn from the
    seed), all=2, random, mosaic=rggb, frame_rate=4..35 (which frames are taken): specular, bubbles
    (on the lens), field_of_view, distortion, resolution, motion_blur, rolling_shutter,
    depth_of_field, droplets and smears (on the dome), chromatic, vignette, bloom, exposure, noise,
    white_balance, jpeg; see docs/effects.md."""

    sensors: tuple[Literal["imu", "magnetometer", "hall"], ...] = ()
    """What else is measured in each frame, as columns of frames.parquet: imu (acceleration,
    angular velocity) and magnetometer in the capsule, hall under the patient, with the position
    that it finds."""

    posture: str = "supine"
    """How the patient lies: supine, prone, left-lateral, right-lateral, standing."""

    capsule: str = "mirocam"
    """Name in the catalog (vrcaps doctor lists them), or your own device file (TOML)."""

    frames: int = 100
    """Number of frames of each camera."""

    fps: float | None = None
    """Frames per second; by default the capsule's own."""

    seed: int = 0
    """Seed of everything random: the motion's wandering, the patient, the muscle, the mucosa."""

    channels: Annotated[tuple[str, ...], arg(help=f"Of {', '.join(CHANNELS)}.")] = (
        *("rgb", "depth", "normal", "label", "instance"),
    )
    """Image channels to write."""

    wall: bool = False
    """Store where every vertex of the wall is in each frame (12 bytes a vertex)."""

    motion: Literal["fly-through", "dynamics", "magnet"] = "fly-through"
    """How the capsule moves: flown along the centreline, left to gravity, wall and muscle, or
    steered by a magnet beside these."""

    fly: OmitArgPrefixes[FlyThrough] = field(default_factory=FlyThrough)
    """Fly along the centreline (where no --path is given)."""

    dynamics: OmitArgPrefixes[DynamicsFlags] = field(default_factory=DynamicsFlags)
    """With --motion dynamics the capsule is set on the centreline at --start and left to gravity,
    the wall, the muscle and these commands; time 0 is the first frame. A scenario file sets every
    figure of the wall (docs/episode-format.md)."""

    magnet: OmitArgPrefixes[MagnetFlags] = field(default_factory=MagnetFlags)
    """With --motion magnet a magnet outside steers a capsule that holds one, such as --capsule
    magnetic, along the gut from --start on, or as --steer says."""

    path: Path | None = None
    """Follow this recorded path instead."""

    path_format: Literal["tum", "unity-csv"] | None = None
    """Of the recorded path: tum (right-handed, OpenCV axes) or unity-csv (y up)."""

    path_unit: str | None = None
    """Length unit of the recorded path, such as m, dm or 5cm."""

    path_handedness: Literal["left", "right"] = "left"
    """Of a unity-csv path: left as Unity has it, or right."""

    path_pose: Literal["camera", "capsule"] = "camera"
    """Whose poses the recorded path holds."""

    path_frame: Literal["world", "patient"] = "world"
    """Frame that the recorded path is in."""

    path_start: float = 0.0
    """Time in the recorded path of the first frame [s]."""

    path_allow_outside: bool = False
    """Accept poses whose camera is outside the lumen."""

    render: OmitArgPrefixes[RenderSettings] = RECORDED
    """How the images are rendered."""

    threads: int | None = None
    """Threads to use; by default all cores. The files do not depend on it."""

    def run(self) -> None:
        """Record and report."""
        run_recording(self.resolved(), self.out, threads=self.threads)

    def resolved(self) -> Scenario:
        """The scenario that the flags ask for.

        Raises:
            InputError: If flags contradict each other or one is missing.
        """
        from vrcaps.camera_pipeline.effects import Effects
        from vrcaps.camera_pipeline.parse import parse_effects
        from vrcaps.scenario.scenario import Scenario, read_scenario
        from vrcaps.sensors.sensors import sensors_by_name

        if self.scenario is not None:
            if self != Record(out=self.out, scenario=self.scenario, threads=self.threads):
                raise InputError(
                    "--scenario states the whole recording. Allowed beside it: --out, --threads. "
                    "To change something, edit a copy of the file."
                )
            return read_scenario(self.scenario)
        return Scenario(
            organ=self._organ(),
            capsule=self.capsule,
            posture=self.posture,
            motion=self._motion(),
            frames=self.frames,
            fps=self.fps,
            seed=self.seed,
            channels=self.channels,
            render=self.render,
            wall=self.wall,
            lesions=chosen_lesions(self.lesion, self.lesions, self._patient_seed(), self.organ),
            clean_twin=self.clean_twin,
            contents=self._contents(),
            effects=parse_effects(self.effects) if self.effects else Effects(),
            sensors=sensors_by_name(self.sensors),
        )

    def _contents(self) -> Contents:
        from vrcaps.lumen.bowel_preparation import prepared

        graded = Contents(self.bubbles, self.chyme, self.liquid, seed=self._patient_seed())
        if self.preparation is None:
            return graded
        if not graded.is_empty:
            raise InputError(
                "--preparation says what is left in the colon. Leave out --bubbles, --chyme and "
                "--liquid."
            )
        return replace(prepared(self.preparation), seed=graded.seed)

    def _patient_seed(self) -> int:
        return self.seed if self.patient is None else self.patient

    def _organ(self) -> OrganGenerated | OrganFile:
        from vrcaps.scenario.scenario import OrganFile, OrganGenerated

        mesh = OrganFile(
            path=self.organ,
            unit=self.unit or "",
            open_ends=self.open_ends,
            keep_uv=self.keep_uv,
            reverse=self.reverse,
            mucosa=self.mucosa,
        )
        if is_mesh_file(self.organ):
            if self.patient is not None or self.distension is not None:
                raise InputError(
                    "--patient and --distension go with a generated organ, not with a mesh file."
                )
            if is_organ_file(Path(self.organ)):
                return mesh
            return replace(mesh, unit=require_unit("--unit", self.unit, self.organ))
        if replace(mesh, mucosa=None) != OrganFile(path=self.organ, unit=""):
            raise InputError(
                f"--unit, --open-ends, --keep-uv and --reverse go with a mesh file, but "
                f"{self.organ!r} is a name. Drop them, or give the path of a PLY, OBJ, STL or GLB."
            )
        return OrganGenerated(
            name=self.organ,
            seed=self._patient_seed(),
            distension=self.distension,
            mucosa=self.mucosa,
        )

    def _motion(self) -> FlyThrough | Replay | Dynamics:
        if self.motion != "magnet" and self.magnet != MagnetFlags():
            raise InputError(
                "--magnet, --arm, --commands and the other flags of steering go with "
                "--motion magnet. Add it, or drop them."
            )
        if self.motion != "fly-through":
            if self.path is not None:
                raise InputError(f"--path and --motion {self.motion} exclude each other. Drop one.")
            motion = dynamics_motion(self.fly, self.dynamics, motion=self.motion)
            is_steered = self.motion == "magnet"
            return replace(motion, magnet=self.magnet.steering()) if is_steered else motion
        if self.dynamics != DynamicsFlags():
            raise InputError(
                "--force, --motility, --posture-change and the other flags of dynamics go with "
                "--motion dynamics or magnet. Add it, or drop them."
            )
        return self.fly if self.path is None else self._replay(self.path)

    def _replay(self, path: Path) -> Replay:
        from vrcaps.motion.replay import Replay

        if self.fly != FlyThrough():
            raise InputError(
                "--path follows a recording, so the flags of the fly-through (--start, --speed, "
                "--drift, …) have no meaning beside it. Drop one or the other."
            )
        if self.path_format is None:
            raise InputError("--path needs --path-format. Allowed: tum, unity-csv.")
        return Replay(
            path=str(path),
            format=self.path_format,
            unit=require_unit("--path-unit", self.path_unit, str(path)),
            handedness=self.path_handedness,
            pose=self.path_pose,
            frame=self.path_frame,
            start=self.path_start,
            allow_outside=self.path_allow_outside,
        )


def is_mesh_file(organ: str) -> bool:
    """Whether an organ is given as a path rather than a name."""
    path = Path(organ)
    return bool(path.suffix) or len(path.parts) > 1 or path.is_file()


def require_unit(flag: str, unit: str | None, path: str) -> str:
    """The stated unit of a file.

    Raises:
        InputError: If none was stated.
    """
    if unit is None:
        raise InputError(
            f"{flag} is missing: {path} does not say its unit. "
            f"Allowed: {', '.join(LENGTH_UNITS)}, or e.g. 5cm."
        )
    return unit
