"""Textures of organs that commands bake or unfold are coarse."""

from tests.support.coarse_organs import coarse_textures

__all__ = ["coarse_textures"]
