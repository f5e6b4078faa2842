"""Textures of organs that commands bake or unfold are coarse."""

from tests.support.coarse_organs import coarse_looks

__all__ = ["coarse_looks"]
