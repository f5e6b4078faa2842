"""Parameters of the wall."""

import numpy as np
import pytest

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.tissue.fem.deformation import FemDeformation


@pytest.mark.parametrize("strain", [0.3, 0.6, 1.0])
def test_a_pulled_strip_stiffens_seven_fold(strain: float) -> None:
    """The slope of P = μ exp(b q) (s − 1/s²) at the stated strain is 7 · 3 μ."""
    wall = FemDeformation(model="neo-hookean", stiffening_strain=strain)

    def stress(s: float) -> float:
        q = s**2 + 2.0 / s - 3.0
        return wall.shear * np.exp(wall.stiffening * q) * (s - s**-2)

    s = 1.0 + strain
    slope = (stress(s + 1e-6) - stress(s - 1e-6)) / 2e-6
    assert slope == pytest.approx(21.0 * wall.shear, rel=1e-6)


def test_moduli() -> None:
    wall = FemDeformation(youngs_modulus=1e5, poisson_ratio=0.25)
    assert wall.shear == pytest.approx(4e4)
    assert wall.lame == pytest.approx(4e4)
    assert wall.stiffening == 0.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("thickness", 0.0),
        ("density", -1.0),
        ("youngs_modulus", -180e3),
        ("youngs_modulus", float("nan")),
        ("edge", float("inf")),
        ("support", -1.0),
        ("damping", float("nan")),
        ("poisson_ratio", 0.5),
        ("stiffening_strain", 0.0),
        ("layers", 0),
        ("fixed", ((0.2, 0.1),)),
    ],
)
def test_bad_values_are_named(name: str, value: object) -> None:
    with pytest.raises(InputError, match=f"^{name} is .*Allowed"):
        FemDeformation(**{name: value})


def test_unknown_model_and_a_linear_wall_that_stiffens() -> None:
    with pytest.raises(UnknownNameError, match="No model named 'hooke'"):
        FemDeformation(model="hooke")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="A linear wall has no stiffening_strain"):
        FemDeformation(stiffening_strain=0.5)
