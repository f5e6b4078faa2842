import numpy as np
import pytest

from vrcaps.camera_pipeline.effects import Effects
from vrcaps.camera_pipeline.frame_rate import AdaptiveRate
from vrcaps.camera_pipeline.optics import Defocus
from vrcaps.camera_pipeline.parse import parse_effects
from vrcaps.camera_pipeline.severities import GRADES, HIGHEST
from vrcaps.capsule.catalog import read_device
from vrcaps.errors import InputError, UnknownNameError
from vrcaps.lumen.contents import Contents
from vrcaps.serialization import from_plain, to_plain


def test_effects_as_a_user_writes_them() -> None:
    assert parse_effects("specular=3, dof=1") == Effects(specular=3, depth_of_field=1)
    assert parse_effects("motion-blur=2,mosaic=grbg") == Effects(motion_blur=2, mosaic="grbg")
    assert parse_effects("noise=1..3") == Effects(noise=(1, 3))
    assert parse_effects("random,jpeg=0") == Effects(
        **dict.fromkeys(GRADES, (0, HIGHEST)) | {"jpeg": 0}
    )
    assert parse_effects("all=2").bloom == 2
    assert parse_effects("frame_rate=2..6").frame_rate == AdaptiveRate(2.0, 6.0)


@pytest.mark.parametrize(
    ("text", "error", "match"),
    [
        ("doff=1", UnknownNameError, "No effect named 'doff'. Known: .*depth_of_field"),
        ("", UnknownNameError, "No effect named ''"),
        ("dof=5", InputError, "depth_of_field has the grade 5. Allowed: 0 to 4"),
        ("dof=3..1", InputError, r"has the grade 3\.\.1\."),
        ("dof=much", InputError, "has no grade. Allowed: NAME=0"),
        ("dof", InputError, "has no grade"),
        ("random=2", UnknownNameError, "No effect named 'random'"),
        ("frame_rate=6..2", InputError, "slow, fast is"),
        ("frame_rate=often", InputError, "has no rates. Allowed: frame_rate=SLOW..FAST"),
        ("mosaic=rgb", InputError, "mosaic is 'rgb'. Allowed: none, rggb"),
    ],
)
def test_what_a_user_cannot_write(text: str, error: type[Exception], match: str) -> None:
    with pytest.raises(error, match=match):
        parse_effects(text)


def test_every_grade_is_in_the_table_and_rises() -> None:
    assert set(GRADES) < set(Effects.__dataclass_fields__)
    for name, figures in GRADES.items():
        assert len(figures) == HIGHEST + 1
        assert len(set(map(str, figures))) == HIGHEST + 1, name
    for effects in (Effects(**dict.fromkeys(GRADES, grade)) for grade in range(HIGHEST + 1)):
        plain = to_plain(effects, Effects)
        assert from_plain(Effects, plain, at="effects") == effects
        device = effects.device(read_device("mirocam"))
        assert device.cameras[0].width == round(320 * (1, 0.75, 0.5, 0.375, 0.25)[effects.noise])


def test_grades_drawn_are_fair_and_independent() -> None:
    ranges = Effects(noise=(1, 3), jpeg=(0, 4), bubbles=(0, 4))
    drawn = [ranges.drawn(seed) for seed in range(600)]
    assert drawn[5] == ranges.drawn(5)
    counts = np.bincount([effects.noise for effects in drawn], minlength=5)
    assert counts[[0, 4]].sum() == 0
    assert (np.abs(counts[1:4] - 200) < 60).all()
    alone = Effects(noise=(1, 3))
    assert all(alone.drawn(seed).noise == drawn[seed].noise for seed in range(50))
    pair = np.array([(effects.noise, effects.jpeg) for effects in drawn])
    assert abs(np.corrcoef(pair.T)[0, 1]) < 0.15


def test_exact_figures_take_a_grades_place() -> None:
    effects = Effects(depth_of_field=Defocus(0.4e-3, 0.02))
    assert effects.figures("depth_of_field") == Defocus(0.4e-3, 0.02)
    assert not effects.is_ideal
    assert Effects(specular=2, resolution=3, bubbles=1, distortion=1, field_of_view=4).is_ideal
    plain = to_plain(effects, Effects)
    assert from_plain(Effects, plain, at="effects") == effects
    with pytest.raises(InputError, match="Draw one first"):
        Effects(noise=(0, 2)).figures("noise")


def test_bubbles_sit_on_the_capsule_beside_those_of_the_contents() -> None:
    assert Effects().contents(Contents(2)) == Contents(2)
    only = Effects(bubbles=3).contents(Contents()).resolved[0]
    assert (only.on_dome, only.per_area) == (4, 0.0)
    both = Effects(bubbles=4).contents(Contents(1)).resolved[0]
    assert both.on_dome == 9
    assert both.per_area > 0.0
