"""Runs of a world: what moves the capsule, and that a run is the same however it is walked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import transform_points
from vrcaps.core.units import CM, MM
from vrcaps.lumen.contents import Contents
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.motion import Step
from vrcaps.motion.rollout import Rollout
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.motility.migrating_complex import Front
from vrcaps.tissue.motility.motility import Propulsion
from vrcaps.tissue.tissue import Drag, SpringWall
from vrcaps.world.model import Contact, Model, mean_contact, posture_transform
from vrcaps.world.schedule import Flush, Insufflation, PostureChange, Wrench

G = 9.80665
RIGID = Dynamics(start=0.5, deformation="rigid", settle=0.5, substep=5e-4)


@pytest.fixture(scope="module")
def gut() -> OrganSurface:
    return straight_gut({"jejunum": 0.2}, radius=11.0 * MM, edge=3.0 * MM)


@pytest.fixture(scope="module")
def lying(gut: OrganSurface) -> Model:
    """A gut along x, its patient on the back."""
    return Model(gut, read_device("mirocam"), posture_transform("supine"))


def run(model: Model, settings: Dynamics, *, frames: int = 4, fps: float = 10.0) -> list[Step]:
    return list(Rollout(model, settings, frames=frames, fps=fps, seed=0).steps())


def test_the_first_frame_is_at_rest_on_the_wall(lying: Model) -> None:
    """After settling the wall carries the weight; the camera looks towards the anal end."""
    first = run(lying, replace(RIGID, settle=1.5), frames=1)[0]
    assert first.state.time == 0.0
    contact = first.state.contact
    assert contact is not None
    weight = lying.device.mass * G
    pushes = run(lying, replace(RIGID, settle=1.5), frames=3)[-1].state.contact
    assert pushes is not None
    assert pushes.force_world[2] == pytest.approx(weight, rel=1e-3)
    np.testing.assert_allclose(first.state.T_world_capsule[:3, 2], [1.0, 0.0, 0.0], atol=0.05)
    floor = posture_transform("supine") @ [0.1, 0.0, 0.0, 1.0]
    assert first.state.T_world_capsule[2, 3] == pytest.approx(
        floor[2] - 11.0 * MM + lying.device.radius, abs=0.8 * MM
    )


@pytest.mark.slow
def test_a_layer_of_elements_carries_the_weight(lying: Model) -> None:
    """The wall that is shown sinks under the capsule, and by as much as the layer does."""
    layer = FemDeformation(edge=10.0 * MM, support=1e5)
    soft = replace(RIGID, deformation="fem", fem=layer)
    simulation = Rollout(lying, soft, frames=2, fps=20.0, seed=0)
    state = list(simulation.steps())[-1].state
    assert state.contact is not None
    assert state.vertices_world is not None
    assert state.contact.force_world[2] == pytest.approx(lying.device.mass * G, rel=0.01)
    assert simulation.world.layer is not None
    still = transform_points(lying.T_world_patient, lying.organ.vertices)
    sunk = np.linalg.norm(state.vertices_world - still, axis=1)
    given = np.linalg.norm(simulation.world.layer.wall_displacement[:, :3], axis=1)
    np.testing.assert_allclose(sunk, given, rtol=0, atol=1e-8)
    assert sunk.max() > 0.01 * MM


@pytest.mark.parametrize(
    ("name", "kind"), [("spring", SpringWall), ("fem", FemDeformation), ("rigid", type(None))]
)
def test_each_deformation_has_its_tissue(name: str, kind: type) -> None:
    tissue = replace(RIGID, deformation=name).make_tissue(front=0.0)
    assert isinstance(tissue.deformation, kind)


def test_it_looks_back_at_an_angle_of_pi(lying: Model) -> None:
    first = run(lying, replace(RIGID, angle=np.pi, settle=0.0), frames=1)[0]
    np.testing.assert_allclose(first.state.T_world_capsule[:3, 2], [-1.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("frame", ["gut", "world", "capsule"])
def test_a_pull_along_the_gut(lying: Model, frame: str) -> None:
    """m dv/dt = F − μ N − … : the commanded force wins over friction, in each of the frames."""
    force = (0.02, 0.0, 0.0) if frame == "world" else (0.0, 0.0, 0.02)
    smooth = Drag(friction=0.01, viscosity=0.5)
    settings = replace(RIGID, drag=smooth, wrenches=(Wrench(force=force),), wrench_frame=frame)
    steps = run(lying, settings, frames=5)
    for step in steps[1:]:
        assert step.command is not None
        np.testing.assert_allclose(step.command.force_world, [0.02, 0.0, 0.0], atol=1e-3)
    expected = (0.02 - 0.01 * lying.device.mass * G) / 0.5
    assert steps[-1].state.linear_velocity_world[0] == pytest.approx(expected, rel=0.03)
    assert steps[0].command is not None
    np.testing.assert_array_equal(steps[0].command.force_world, 0.0)


def test_it_rolls_to_the_lowest_place_as_the_patient_turns(lying: Model) -> None:
    """In the patient the lowest place moves from the back to the left side."""
    settings = replace(
        RIGID, posture_changes=(PostureChange("left-lateral", time=0.0, duration=1.0),)
    )
    steps = run(lying, settings, frames=16)
    places = []
    for step in steps:
        assert step.command is not None
        T = step.command.T_world_patient
        places.append((np.linalg.inv(T) @ step.state.T_world_capsule)[:3, 3])
    end = steps[-1]
    assert end.command is not None
    np.testing.assert_allclose(end.command.T_world_patient, posture_transform("left-lateral"))
    vertices = end.state.vertices_world
    assert vertices is not None
    np.testing.assert_allclose(
        vertices,
        Model(lying.organ, lying.device, end.command.T_world_patient).vertices_world,
        atol=1e-8,
    )
    assert places[0][1] > 4.0 * MM  # behind the axis: towards the back
    assert abs(places[-1][1]) < 2.0 * MM


def test_the_gut_is_filled_when_the_first_frame_is_taken(lying: Model) -> None:
    settings = replace(
        RIGID, insufflation=(Insufflation(0.0, 0.8), Insufflation(0.2, 1.1)), settle=0.3
    )
    for step, factor in zip(run(lying, settings, frames=3), (0.8, 0.95, 1.1), strict=True):
        vertices = step.state.vertices_world
        assert vertices is not None
        radius = np.linalg.norm(vertices[100:400, 1:], axis=1)
        np.testing.assert_allclose(radius, 11.0 * MM * factor, rtol=1e-6)
        assert step.command is not None
        assert step.command.insufflation == pytest.approx(factor)


def test_phase_three_is_at_the_capsule(lying: Model) -> None:
    settings = replace(RIGID, motility="phase-three", start=0.3)
    for step in run(lying, settings, frames=2):
        assert step.command is not None
        assert step.command.phase == 3


def test_a_run_is_the_same_however_it_is_walked(lying: Model) -> None:
    """Again from the start, and from a snapshot taken on the way."""
    settings = Dynamics(start=0.3, motility="steady", settle=0.1, substep=1e-3)
    simulation = Rollout(lying, settings, frames=5, fps=10.0, seed=3)
    assert len(simulation) == 5
    taken, first, steps = [], [], []
    walk = simulation.steps(
        progress=lambda time, duration: steps.append((time, duration)), is_due=lambda: True
    )
    for step in walk:
        first.append(step)
        taken.append(simulation.checkpoint())
    assert [state.frame for state in taken] == [0, 1, 2, 3, 4]
    assert steps[-1] == pytest.approx((0.5, 0.5))
    assert np.all(np.diff([time for time, _ in steps]) > 0.0)
    again = list(simulation.steps())
    assert simulation.checkpoint() is None  # none was due
    later = list(simulation.steps(taken[2]))
    assert [step.index for step in later] == [3, 4]
    assert later[0].previous.T_world_capsule.tobytes() == first[2].state.T_world_capsule.tobytes()
    for one, other in [*zip(first, again, strict=True), *zip(first[3:], later, strict=True)]:
        for name in ("T_world_capsule", "vertices_world", "linear_velocity_world"):
            assert getattr(one.state, name).tobytes() == getattr(other.state, name).tobytes()
        assert one.state.time == other.state.time


def test_contact_over_a_frame() -> None:
    """Means of what the wall does, the sum of its work, the last patch."""
    contacts = [
        Contact(np.full(3, float(k)), np.full(3, -float(k)), float(k), 0.5, float(k), 1.0, 2.0 * k)
        for k in (1, 3)
    ]
    total = mean_contact(contacts)
    np.testing.assert_array_equal(total.force_world, 2.0)
    np.testing.assert_array_equal(total.torque_world, -2.0)
    assert (total.normal_force_total, total.friction_work, total.energy, total.depth) == (
        2.0,
        1.0,
        3.0,
        6.0,
    )


def test_it_is_set_further_in_where_it_does_not_fit(lying: Model) -> None:
    simulation = Rollout(lying, replace(RIGID, start=0.0), frames=1, fps=1.0, seed=0)
    (note,) = simulation.notes
    assert note.startswith("Set the capsule ")
    assert Rollout(lying, RIGID, frames=1, fps=1.0, seed=0).notes == ()
    backwards = Rollout(lying, replace(RIGID, start=1.0), frames=1, fps=1.0, seed=0)
    assert backwards.world.state.T_world_capsule[0, 3] > 0.1


def test_it_fits_nowhere() -> None:
    narrow = Model(straight_gut({"jejunum": 0.1}, radius=2.5 * MM), read_device("mirocam"))
    with pytest.raises(
        InputError,
        match=r"start 0.5: the lumen is 5\.0 to 5\.0 mm wide, the capsule 10\.8 mm thick\. Ch",
    ):
        Rollout(narrow, RIGID, frames=1, fps=1.0, seed=0)


def test_too_strong_a_command_names_the_time(lying: Model) -> None:
    ramp = (Wrench(0.0), Wrench(0.1, (0.0, 0.0, 0.0)), Wrench(0.2, (2e4, 0.0, 0.0)))
    with pytest.raises(InputError, match=r"^At 0\.1\d\d s of the simulation: Control's force"):
        run(lying, replace(RIGID, wrenches=ramp))


def test_rejects_phase_three_where_no_complex_passes() -> None:
    colon = Model(straight_gut({"sigmoid": 0.2}), read_device("mirocam"))
    with pytest.raises(InputError, match="motility is phase-three, but the migrating motor"):
        Rollout(colon, replace(RIGID, motility="phase-three"), frames=1, fps=1.0, seed=0)


def test_rejects_filling_without_time_to_settle(lying: Model) -> None:
    settings = replace(RIGID, settle=0.0, insufflation=(Insufflation(0.0, 1.2),))
    with pytest.raises(InputError, match=r"settle is 0 s, but the gut needs time"):
        Rollout(lying, settings, frames=1, fps=1.0, seed=0)


def test_rejects_a_twin_with_other_triangles(lying: Model) -> None:
    other = straight_gut({"jejunum": 0.1})
    with pytest.raises(InputError, match="different triangles"):
        Rollout(lying, RIGID, frames=1, fps=1.0, seed=0, shown=other)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"start": 1.5}, r"Dynamics' start is 1.5. Allowed: 0 to 1"),
        ({"angle": np.nan}, r"Dynamics' angle is nan. Allowed: finite"),
        ({"settle": -1.0}, r"Dynamics' settle is -1.0. Allowed: 0 to 3600 s"),
        ({"step": 0.0}, r"Dynamics' step is 0.0. Allowed: above 0 to 0.5 s"),
        ({"propulsion": Propulsion()}, "Propulsion requires motility, but motility is none"),
        (
            {"wrenches": (Wrench(),), "wrench_file": "a.csv"},
            "wrenches and wrench_file are both given",
        ),
        ({"posture_changes": (PostureChange("prone", time=-1.0),)}, "a turn starts at -1.0 s"),
        ({"insufflation": (Insufflation(0.0, 9.0),)}, r"insufflation: entry 0 is 9.0 at 0.0 s"),
        ({"wrenches": (Wrench(np.nan),)}, "wrenches: entry 0 is not finite"),
    ],
)
def test_rejects_impossible_settings(settings: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Dynamics(**settings)


@pytest.mark.parametrize("name", ["deformation", "motility", "wrench_frame"])
def test_rejects_unknown_names(name: str) -> None:
    with pytest.raises(UnknownNameError, match=r"named 'soft'\. Known: "):
        Dynamics(**{name: "soft"})


def test_rejects_a_substep_that_is_too_long(lying: Model) -> None:
    with pytest.raises(InputError, match=r"substep is 0\.1"):
        Rollout(lying, replace(RIGID, substep=0.1), frames=1, fps=1.0, seed=0)


def test_tissue_has_the_fields_asked_for() -> None:
    spring, drag = SpringWall(stiffness=99.0), Drag(law="incetan2021")
    settings = Dynamics(spring=spring, drag=drag, motility="phase-three", fallback_segment="ileum")
    tissue = settings.make_tissue(front=7.0 * CM)
    assert (tissue.deformation, tissue.drag) == (spring, drag)
    assert tissue.motility is not None
    assert (tissue.motility.front, tissue.motility.fallback_segment) == (7.0 * CM, "ileum")
    assert replace(settings, deformation="rigid").make_tissue(front=0.0).deformation is None
    steady = replace(settings, motility="steady").make_tissue(front=0.0).motility
    assert steady is not None
    assert steady.complex is None
    assert Dynamics().make_tissue(front=0.0).motility is None


@pytest.mark.slow
@pytest.mark.parametrize("motility", ["none", "fasting"])
def test_commands_given_on_the_way_are_as_if_known_from_the_beginning(
    lying: Model, motility: str
) -> None:
    """A flush and phase III, begun where the capsule is."""
    model = replace(lying, contents=Contents(bubbles=1))
    settings = Dynamics(start=0.3, motility=motility, settle=0.1, substep=1e-3)  # type: ignore[arg-type]
    live = Rollout(model, settings, frames=6, fps=5.0, seed=3)
    given, steps = settings, []
    for moment in live.moments(None, lambda *_: None, lambda: False):
        if moment.index == 0:
            front = Front(0.3, live.front_arc_length)
            given = replace(settings, flushes=(Flush(0.1, 0.5),), phase_three=(front,))
            live.change(given)
        steps.append(moment)
    known = Rollout(model, given, frames=6, fps=5.0, seed=3)
    for one, other in zip(steps, known.moments(None, lambda *_: None, lambda: False), strict=True):
        np.testing.assert_array_equal(one.state.T_world_capsule, other.state.T_world_capsule)
        np.testing.assert_array_equal(one.state.vertices_world, other.state.vertices_world)
        spheres = [moment.state.lumen_contents.spheres.centers for moment in (one, other)]  # type: ignore[union-attr]
        np.testing.assert_array_equal(*spheres)
    phases = [moment.command.phase for moment in steps]
    assert phases[-1] == 3
    assert phases[0] == 0 or motility == "fasting"
    still = Rollout(model, settings, frames=6, fps=5.0, seed=3)
    *_, last = still.moments(None, lambda *_: None, lambda: False)
    assert not np.array_equal(last.state.T_world_capsule, steps[-1].state.T_world_capsule)


def test_steady_muscle_has_no_fronts() -> None:
    with pytest.raises(InputError, match="steady motility has none"):
        Dynamics(motility="steady", phase_three=(Front(0.0, 0.1),))
    with pytest.raises(InputError, match="phase_three: time 1 s does not come after 2 s"):
        Dynamics(phase_three=(Front(2.0, 0.1), Front(1.0, 0.1)))
