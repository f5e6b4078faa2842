"""Fields of settings: values of a wrong type are reported, files have checksums."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
import pytest

from tests.support.coarse_organs import TEXELS_PER_MM
from vrcaps.actuation.magnet_actuator import FreeActuator
from vrcaps.actuation.magnet_pose_solver import Workspace
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.anatomy import catalog
from vrcaps.anatomy.full_tract.patient import PatientAnatomy
from vrcaps.camera.camera import Camera, led_ring
from vrcaps.camera.lens import LensEquidistant
from vrcaps.camera_pipeline.effects import Effects, WhiteBalance
from vrcaps.capsule.device import Device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.fields import FileRef, Range, check_fields, file_ref, path_of, with_checksums
from vrcaps.env.observations import ImageObservation
from vrcaps.env.randomization import Randomization
from vrcaps.learn.compositing import CompositeSettings
from vrcaps.learn.tasks.depth import DepthTask
from vrcaps.learn.tasks.segmentation import SegmentationTask
from vrcaps.lesion import Polyp
from vrcaps.lesion.base import Location
from vrcaps.lesion.mucosal import Ulcer
from vrcaps.lumen.contents import Bubbles, Chyme, Contents, Liquid
from vrcaps.motion.dynamics_settings import DynamicsSettings
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.settings import RenderSettings
from vrcaps.scenario.scenario import (
    OrganGenerated,
    Scenario,
    scenario_from_plain,
    scenario_to_plain,
)
from vrcaps.sensors.sensors import Sensors
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.motility.migrating_complex import ComplexStatistics
from vrcaps.tissue.motility.motility import GiantContractions, Motility, Propulsion
from vrcaps.tissue.tissue import Drag, SpringWall, WinklerFoundation
from vrcaps.tools.ct.from_ct import WallOptions
from vrcaps.tools.mucosa_from_photos.patches import PhotoScale
from vrcaps.tools.mucosa_from_photos.texture import TextureOptions
from vrcaps.tools.mucosa_from_photos.vessels import VesselPlacement
from vrcaps.world.control import Control
from vrcaps.world.schedule import Flush, Wrench


@dataclass(frozen=True)
class Leaf:
    file: FileRef | None = None
    number: int = 1


@dataclass(frozen=True)
class Tree:
    leaf: Leaf
    leaves: tuple[Leaf, ...] = ()


def test_checksums_anywhere_in_a_tree(tmp_path):
    (tmp_path / "a").write_text("x")
    given = FileRef(str(tmp_path / "a"))
    tree = Tree(Leaf(given), (Leaf(), Leaf(given, 2)))
    checked = with_checksums(tree)
    assert len(checked.leaf.file.sha256) == 64
    assert checked.leaves == (Leaf(), Leaf(checked.leaf.file, 2))
    assert with_checksums(checked) == checked
    (tmp_path / "a").write_text("y")
    with pytest.raises(InputError, match="but the scenario was made with"):
        with_checksums(checked)


def test_a_texture_is_checked_by_its_head(tmp_path):
    with pytest.raises(InputError, match=r"is a folder\. Allowed: a file, or a texture's folder"):
        FileRef(str(tmp_path)).checked()
    (tmp_path / "mucosa.json").write_text("{}")
    assert FileRef(str(tmp_path)).checked().sha256


def test_paths_alone_are_references(tmp_path):
    assert file_ref("a/b") == FileRef("a/b")
    assert path_of(FileRef("a/b")) == path_of("a/b")


@dataclass(frozen=True)
class Settings:
    speed: float = 1.0
    count: Annotated[int, Range(min=1)] = 1
    limit: float | None = None
    color: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sizes: tuple[int, ...] = ()
    anything: Any = None
    factor: Literal[2, 4] = 2
    choice: Literal[0] | str | None = None
    is_wet: bool = False
    name: str = ""
    leaf: Leaf = Leaf()
    leaves: tuple[Leaf, ...] = ()
    gains: tuple[Annotated[float, Range(0.0, 2.0)], ...] = ()
    goal: Annotated[float, Range(0.0, 1.0)] | str = 1.0
    spread: float | tuple[float, float] = 1.0
    light: Literal["direct", "path"] = "direct"
    path: Path | None = None
    pair: tuple[str, int] = ("", 0)
    table: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self, of="Settings")


@pytest.mark.parametrize(
    ("given", "allowed"),
    [
        ({"speed": "a"}, "Settings' speed is 'a'. Allowed: a number."),
        ({"speed": None}, "Settings' speed is None. Allowed: a number."),
        ({"speed": np.str_("1")}, "Allowed: a number."),
        ({"speed": np.complex64(1)}, "Allowed: a number."),
        ({"speed": np.array("1")}, "Allowed: a number."),
        ({"limit": (1.0,)}, "Settings' limit is (1.0,). Allowed: a number."),
        ({"count": 1.5}, "Settings' count is 1.5. Allowed: a whole number, 1 or more."),
        ({"count": np.float64(2.0)}, "Allowed: a whole number, 1 or more."),
        ({"count": 0}, "Settings' count is 0. Allowed: 1 or more."),
        ({"color": 5}, "Settings' color is 5. Allowed: 3 numbers."),
        ({"color": np.array(5.0)}, "Allowed: 3 numbers."),
        ({"color": (1.0, 2.0)}, "Settings' color is (1.0, 2.0). Allowed: 3 numbers."),
        ({"color": "abc"}, "Settings' color is 'abc'. Allowed: 3 numbers."),
        ({"sizes": (1, 2.5)}, "Settings' sizes is (1, 2.5). Allowed: whole numbers."),
        ({"speed": True}, "Settings' speed is True. Allowed: a number."),
        ({"speed": 10**400}, "Allowed: a number."),
        ({"count": 10**400}, "Allowed: a whole number, 1 or more."),
        ({"count": 1 << 20_000}, "count is an integer of thousands of digits. Allowed: a whole nu"),
        ({"count": np.True_}, "Settings' count is True. Allowed: a whole number, 1 or more."),
        ({"sizes": (True,)}, "Allowed: whole numbers."),
        ({"is_wet": 1}, "Settings' is_wet is 1. Allowed: True or False."),
        ({"name": 5}, "Settings' name is 5. Allowed: a string."),
        ({"leaf": None}, "Settings' leaf is None. Allowed: a Leaf."),
        ({"leaves": None}, "Settings' leaves is None. Allowed: Leaf objects."),
        ({"leaves": ("a",)}, "Settings' leaves is ('a',). Allowed: Leaf objects."),
        ({"gains": (1.0, 3.0)}, "gains is (1.0, 3.0). Allowed: numbers, 0 to 2."),
        ({"goal": 1.5}, "Settings' goal is 1.5. Allowed: a string or a number, 0 to 1."),
        ({"goal": None}, "Settings' goal is None. Allowed: a string or a number, 0 to 1."),
        ({"spread": (1.0,)}, "spread is (1.0,). Allowed: a number or 2 numbers."),
        ({"light": 5}, "Settings' light is 5. Allowed: direct, path."),
        ({"path": 5}, "Settings' path is 5. Allowed: a path."),
        ({"pair": ("a", "b")}, "Allowed: a tuple of a string, a whole number."),
        ({"table": ()}, "Settings' table is (). Allowed: a mapping."),
        ({"name": np.zeros((2, 2))}, "name is array([[0., 0.], [0., 0.]]). Allowed: a string."),
        ({"factor": 3}, "Settings' factor is 3. Allowed: 2, 4."),
        ({"factor": None}, "Settings' factor is None. Allowed: 2, 4."),
        ({"factor": "2"}, "Settings' factor is '2'. Allowed: 2, 4."),
        ({"factor": np.array([2, 4])}, "Allowed: 2, 4."),
    ],
)
def test_a_value_of_a_wrong_type_is_reported(given, allowed):
    with pytest.raises(InputError) as error:
        Settings(**given)
    assert allowed in str(error.value)


def test_a_string_that_is_no_literal_is_an_unknown_name():
    with pytest.raises(UnknownNameError, match=r"No light named 'pth'\. Known: direct, path\. Did"):
        Settings(light=cast(Any, "pth"))


def test_lists_become_tuples():
    leaf = Leaf()
    settings = Settings(
        leaves=cast(Any, [leaf]), gains=cast(Any, np.ones(2)), pair=cast(Any, ["a", 1])
    )
    assert (settings.leaves, settings.gains, settings.pair) == ((leaf,), (1.0, 1.0), ("a", 1))


def test_other_real_numbers_become_floats():
    settings = Settings(speed=Fraction(7, 2), limit=np.longdouble(3))
    assert (settings.speed, settings.limit) == (3.5, 3.0)
    assert type(settings.speed) is float and type(settings.limit) is float


def test_numbers_of_numpy_are_numbers():
    given: dict[str, Any] = {"speed": np.float32(2.0), "count": np.int64(3), "limit": np.array(1.0)}
    given |= {"color": np.zeros(3), "sizes": [np.int8(1)], "anything": "text"}
    given |= {"factor": np.int64(4), "choice": "text"}
    settings = Settings(**given)
    assert settings == Settings(
        2.0, 3, 1.0, (0.0, 0.0, 0.0), sizes=(1,), anything="text", factor=4, choice="text"
    )
    values = (settings.speed, settings.count, settings.limit, settings.factor, *settings.color)
    assert {type(value) for value in values} == {float, int}


def test_numbers_of_numpy_reach_files(tmp_path, monkeypatch):
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path))
    zero, two, side = (cast(Any, np.int64(value)) for value in (0, 2, 32))
    half = cast(Any, np.float32(15.5))
    lens, position = LensEquidistant(focal=20.0, cx=half, cy=half), cast(Any, np.zeros(3))
    camera = Camera("front", lens, side, side, position, leds=led_ring(two, radius=3e-3))
    device = Device(length=cast(Any, np.float32(24e-3)), radius=5e-3, mass=3e-3, cameras=(camera,))
    assert (type(camera.width), camera.position) == (int, (0.0, 0.0, 0.0))
    assert len(camera.leds) == 2
    assert Contents(medium=two).medium_and_film == Contents(medium=2).medium_and_film
    assert Effects(sensor_noise=(two, two)) == Effects(sensor_noise=(2, 2))
    given: dict[str, Any] = {"frames": two, "seed": two, "fps": np.float32(4.0)}
    given |= {
        "capsule": device,
        "effects": Effects(sensor_noise=two),
        "contents": Contents(bubbles=two),
    }
    scenario = Scenario(OrganGenerated("stomach", seed=two), **given)
    assert scenario_from_plain(json.loads(json.dumps(scenario_to_plain(scenario)))) == scenario
    make = catalog._generator("stomach")  # below with few triangles and texels

    def coarse(patient: PatientAnatomy) -> OrganSurface:
        return make(replace(patient, stomach=replace(patient.stomach, edge=5e-3)))

    monkeypatch.setitem(catalog._GENERATORS, "stomach", coarse)
    monkeypatch.setattr("vrcaps.mucosa.bake.DEFAULT_TEXELS_PER_MM", TEXELS_PER_MM)
    assert catalog.generate_organ("stomach", seed=zero).metadata["seed"] == 0


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (Bubbles, "radius"),
        (Bubbles, "stain"),
        (Chyme, "density"),
        (Liquid, "fill"),
        (Contents, "drift"),
        (CompositeSettings, "count"),
        (DynamicsSettings, "start"),
        (WhiteBalance, "gains"),
        (Polyp, "variant"),
        (FreeActuator, "max_speed"),
        (Workspace, "low"),
        (WallOptions, "edge"),
        (WinklerFoundation, "thickness"),
        (Drag, "friction"),
        (SpringWall, "length"),
        (FemDeformation, "edge"),
        (Propulsion, "beta"),
        (GiantContractions, "rate"),
        (RenderSettings, "spp"),
        (Flush, "duration"),
        (Wrench, "force"),
        (TextureOptions, "luminance"),
        (VesselPlacement, "size_std"),
        (Motility, "front"),
        (ComplexStatistics, "reaching"),
        (Location, "arc_length"),
        (Sensors, "earth_field"),
        (PhotoScale, "mm_per_pixel"),
        (ImageObservation, "size"),
        (Randomization, "mass"),
    ],
)
def test_settings_report_a_text_for_a_number(make, name):
    with pytest.raises(InputError, match=rf"{name} is 'abc'\. Allowed: .*number"):
        make(**{name: "abc"})


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: MagnetSteering(waypoints=cast(Any, None)), "waypoints is None. Allowed: Waypoint"),
        (lambda: DepthTask(backbone=cast(Any, "x")), "backbone is 'x'. Allowed: a Backbone"),
        (lambda: SegmentationTask(classes=cast(Any, 5)), "classes is 5. Allowed: strings"),
        (lambda: Ulcer(type=cast(Any, None)), "type is None. Allowed: aphthous, deep"),
        (lambda: Scenario(motion=cast(Any, 5)), "motion is 5. Allowed: a MotionSettings"),
        (lambda: Scenario(channels=cast(Any, "rgb")), "channels is 'rgb'. Allowed: strings"),
        (lambda: Control(flush=cast(Any, "x")), "flush is x. Allowed: finite numbers"),
        (lambda: Control(Ts_world_magnet=cast(Any, 5)), "is 5. Allowed: a list of poses"),
    ],
)
def test_settings_report_a_value_of_another_class(make, match):
    with pytest.raises(InputError, match=match):
        make()
