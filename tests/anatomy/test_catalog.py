"""The catalog: known names, a patient per seed, appearance included, cached."""

from __future__ import annotations

import sys
import types
from pathlib import Path

import numpy as np
import pytest

from vrcaps.anatomy import colon
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.anatomy.colon import ColonParameters
from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.organ.segments import DISTENSIONS, ORGANS, organ_segments
from vrcaps.organ.surface import Appearance, Centerline, OrganSurface


def plain_organ(parameters: ColonParameters, seed: int) -> OrganSurface:
    """A single triangle that remembers what it was made with."""
    zeros = np.zeros(3)
    line = Centerline(np.zeros((2, 3)), np.arange(2.0), np.ones(2), np.tile(np.eye(3), (2, 1, 1)))
    return OrganSurface(
        "colon",
        np.eye(3) * parameters.length,
        np.array([[0, 1, 2]]),
        np.eye(3),
        np.zeros((1, 3, 2)),
        zeros.astype(np.uint8),
        ("background",),
        zeros.astype(np.uint16),
        zeros,
        zeros,
        zeros,
        line,
        metadata={"seed": seed},
    )


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Seeds the generator was called with; generator and baker are stand-ins."""
    seeds: list[int] = []

    def generate(parameters: ColonParameters, *, seed: int) -> OrganSurface:
        seeds.append(seed)
        return plain_organ(parameters, seed)

    def bake(organ: OrganSurface, *, seed: int, mucosa: str) -> Appearance:
        assert mucosa == "colon"
        pixels = np.full((2, 2, 3), seed, np.uint8)
        return Appearance(pixels, pixels[..., 0], np.zeros((2, 2)))

    stand_in = types.ModuleType("vrcaps.mucosa.bake")
    stand_in.__dict__["bake_appearance"] = bake
    monkeypatch.setitem(sys.modules, "vrcaps.mucosa.bake", stand_in)
    monkeypatch.setattr(colon, "generate_colon", generate)
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path))
    return seeds


def test_an_organ_comes_with_its_appearance_and_from_the_cache(calls: list[int]):
    first, again = generate_organ("colon", seed=4), generate_organ("colon", seed=4)
    assert calls == [4]
    assert again.appearance is not None
    assert again.appearance.albedo[0, 0, 0] == 4
    assert first.vertices.tobytes() == again.vertices.tobytes()


def test_each_seed_is_another_patient(calls: list[int]):
    lengths = {float(generate_organ("colon", seed=seed).vertices[0, 0]) for seed in range(5)}
    assert calls == [0, 1, 2, 3, 4]
    assert len(lengths) == 5


def test_unknown_names_and_negative_seeds_are_refused():
    assert "colon" in ORGANS
    with pytest.raises(
        UnknownNameError, match=r"No organ named 'colom'\. Known: colon, full-tract"
    ):
        generate_organ("colom", seed=0)
    with pytest.raises(InputError, match=r"Distension is 'full'\. Allowed: inflated, normal"):
        generate_organ("colon", seed=0, distension="full")
    with pytest.raises(InputError, match="Seed is 1\\.5"):
        generate_organ("colon", seed=1.5)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match=r"Seed is -1\. Allowed: 0 to 18446744073709551615"):
        generate_organ("colon", seed=-1)
    with pytest.raises(InputError, match="Seed is 18446744073709551616"):
        generate_organ("colon", seed=2**64)


def test_every_organ_has_segments_and_every_distension_a_patient() -> None:
    assert all(organ_segments(name) for name in ORGANS)
    assert len(organ_segments("full-tract")) == 18
    for distension in DISTENSIONS:
        draw_patient_anatomy(0, distension)
    with pytest.raises(UnknownNameError, match="No organ named 'liver'"):
        organ_segments("liver")
