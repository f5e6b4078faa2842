"""Textures of organs that commands bake are coarse."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.coarse_organs import TEXELS_PER_MM


@pytest.fixture(scope="package", autouse=True)
def coarse_textures() -> Iterator[None]:
    """Textures are coarse in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vrcaps.mucosa.bake.DEFAULT_TEXELS_PER_MM", TEXELS_PER_MM)
        yield
