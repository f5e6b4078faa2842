"""Randomization per episode: factors, lenses, and effects on images."""

import numpy as np
import pytest

from tests.support.small_envs import GUT, simulation_of, small_settings
from tests.support.tubes import textured
from vrcaps.camera.derive import focal_length_px
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.core.errors import InputError
from vrcaps.env.actuation import Wrench
from vrcaps.env.env import CapsuleEnv
from vrcaps.env.observations import ImageObservation
from vrcaps.env.randomization import Randomization, varied_tissue
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.tissue import Drag, Tissue

_RANGE = (0.5, 2.0)
_VARIED = Randomization(_RANGE, _RANGE, _RANGE, (0.9, 1.1), _RANGE, (0.8, 1.2))


def test_nothing_varies_by_default_and_nothing_is_drawn():
    generator = np.random.default_rng(0)
    before = generator.bit_generator.state
    factors, seed = Randomization(friction=0.7).draw(generator)
    assert generator.bit_generator.state == before and seed == 0
    assert factors.tolist() == [1.0, 0.7, 1.0, 1.0, 1.0, 1.0]
    simulation = simulation_of()
    world, patient = simulation.worlds.batch.worlds[0], simulation.worlds.patient(0)
    assert world.model is patient.model and world.tissue is simulation.settings.tissue


def test_factors_are_drawn_evenly_from_their_ranges():
    generator = np.random.default_rng(0)
    drawn = np.array([_VARIED.draw(generator)[0] for _ in range(400)])
    for k, (low, high) in enumerate([_RANGE] * 3 + [(0.9, 1.1), _RANGE, (0.8, 1.2)]):
        assert low <= drawn[:, k].min() < low + 0.05 * (high - low)
        assert high >= drawn[:, k].max() > high - 0.05 * (high - low)
        assert drawn[:, k].mean() == pytest.approx(0.5 * (low + high), abs=0.05 * (high - low))
    assert len(np.unique(drawn[:, 5].round(9))) == 9


def test_factors_act_on_tissue_and_capsule():
    simulation = simulation_of(1, randomization=_VARIED)
    stiffness, friction, drag, mass, magnet, focal = simulation.memory["randomization/factors"][0]
    world, known = simulation.worlds.batch.worlds[0], simulation.worlds.device
    settings = simulation.settings.tissue
    modulus = settings.foundation.youngs_modulus
    assert world.tissue.foundation.youngs_modulus == pytest.approx(stiffness * modulus)
    assert world.tissue.deformation.stiffness / settings.deformation.stiffness == stiffness
    assert world.tissue.drag.friction == pytest.approx(friction * settings.drag.friction)
    assert world.tissue.drag.constant == pytest.approx(drag * settings.drag.constant)
    assert world.tissue.drag.relaxation_time == pytest.approx(0.1 / drag)
    assert world.body.mass == pytest.approx(mass * known.mass)
    device = simulation.worlds.devices[0]
    assert device is world.model.device
    moment = np.array(device.magnets[0].moment_capsule)
    np.testing.assert_allclose(moment, magnet * np.array(known.magnets[0].moment_capsule))
    one, other = (focal_length_px(d.cameras[0].lens) for d in (device, known))
    assert one == pytest.approx(focal * other, rel=1e-6)
    # What was made of the organ is made once.
    assert world.model.wall_in_patient is simulation.worlds.patient(0).model.wall_in_patient
    tissue = Tissue(deformation=FemDeformation(), drag=Drag(viscosity=2.0))
    varied = varied_tissue(tissue, np.array([2.0, 1.0, 3.0, 1.0, 1.0, 1.0]))
    assert varied.deformation.youngs_modulus == 2.0 * tissue.deformation.youngs_modulus
    assert varied.drag.viscosity == 6.0


@pytest.mark.slow
def test_longer_lens_sees_less_but_finer_and_the_same_beside_others():
    wide, long = (simulation_of(randomization=Randomization(focal=f)) for f in (0.8, 1.3))
    frustum, visible, resolved = wide.coverage.fraction[0] / long.coverage.fraction[0]
    assert frustum > 1.05 and visible > 1.05 and resolved < 0.95
    varied = Randomization(focal=(0.8, 1.3))
    many = simulation_of(2, randomization=varied)
    assert len({id(device.cameras) for device in many.worlds.devices}) > 1
    for index in range(2):
        alone = simulation_of(1, randomization=varied)
        alone.reset(0, np.random.default_rng(index))
        np.testing.assert_array_equal(alone.coverage.fraction[0], many.coverage.fraction[index])


def test_effects_are_drawn_for_each_episode_and_come_back_with_a_snapshot():
    effects = Effects(sensor_noise=(1, 4), vignetting=(0, 4), distortion=2, auto_exposure=2)
    settings = small_settings(
        organs=(textured(GUT),),
        observations=(ImageObservation(size=(24, 24)), ImageObservation("depth", size=(24, 24))),
        randomization=Randomization(effects=effects),
        actuation=Wrench(force=2e-3, torque=0.0),
    )
    env, still = CapsuleEnv(settings), np.zeros(6)
    first = env.reset(seed=0)[0]["rgb"]
    ideal = simulation_of(1, organs=settings.organs, observations=settings.observations)
    plain = settings.observations[0].observe(ideal.view)[0]
    assert np.abs(first.astype(int) - plain).mean() > 1.0
    assert (env.reset(seed=1)[0]["rgb"] != first).any()
    np.testing.assert_array_equal(env.reset(seed=0)[0]["rgb"], first)
    env.step(still)
    snapshot = env.snapshot()
    expected = [env.step(still)[0]["rgb"] for _ in range(2)]
    env.reset(seed=5)
    env.restore(snapshot)
    for image in expected:
        np.testing.assert_array_equal(env.step(still)[0]["rgb"], image)


def test_bad_factors_say_what_is_allowed():
    with pytest.raises(InputError, match=r"mass is \(1\.1, 0\.9\)\. Allowed: a factor above 0"):
        Randomization(mass=(1.1, 0.9))
    with pytest.raises(InputError, match=r"friction is 0\.0\. Allowed"):
        Randomization(friction=0.0)
    with pytest.raises(InputError, match="effects hold motion_blur, which needs a recording"):
        Randomization(effects=Effects(motion_blur=2))
