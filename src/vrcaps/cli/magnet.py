"""`vrcaps magnet`: list magnets, and show the field and the pull of one."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tyro.conf import Positional

from vrcaps.cli.arguments import require_out
from vrcaps.cli.console import console
from vrcaps.core.errors import InputError
from vrcaps.core.units import CM, MM
from vrcaps.magnet.magnets import Magnet
from vrcaps.magnet.presets import MAGNETS, dipole_distance, read_magnet

if TYPE_CHECKING:
    import matplotlib.axes

    from vrcaps.magnet.sources import InternalMagnet

_GAPS = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0)
"""Distances from the magnet to the capsule's center in the table [cm]."""
_CELLS = 161
"""Points of the field map along each axis."""


@dataclass(frozen=True)
class List:
    """List the magnets of the catalog.

    For example:
      vrcaps magnet list
    """

    def run(self) -> None:
        """Print them."""
        for name, preset in MAGNETS.items():
            console.print(f"{name}: {preset.title}, {preset.grade}.")


@dataclass(frozen=True)
class Show:
    """Show the moment, mass and field of a magnet, and its pull as a function of distance.

    The magnet is a name of `vrcaps magnet list` or a TOML file with kind (cylinder, ring, block or
    sphere), size, and one of grade, remanence_t and moment_a_m2.

    For example:
      vrcaps magnet show cylinder-76.2
      vrcaps magnet show mine.toml --capsule magnetic --picture mine.png
    """

    magnet: Positional[str]
    """Name of the magnet, or its TOML file."""

    capsule: str = "magnetic"
    """Capsule that is pulled: a name of the catalog or a device file, with one or more magnets."""

    picture: Path | None = None
    """Figure to write; by default <name>-field.png in the working directory."""

    def run(self) -> None:
        """Print the properties and draw the figure."""
        from vrcaps.capsule.device_file import read_device

        picture = self.picture or Path(f"{self._name()}-field.png")
        require_out(picture, ".png", "--picture")
        magnet = read_magnet(self.magnet)
        inside = read_device(self.capsule).magnets
        if not inside:
            raise InputError(
                f"Capsule {self.capsule} contains no magnet. Give one with [[magnets]], such as "
                "magnetic."
            )
        for line in properties(magnet):
            console.print(line)
        console.print(
            f"Pull on the capsule {self.capsule}, aligned above the magnet's north face, by the "
            "distance from the face to the capsule's center:"
        )
        gaps = np.array(_GAPS) * CM
        for gap, force, flux in zip(gaps, *pull(magnet, inside, gaps), strict=True):
            console.print(f"  {gap / CM:5.1f} cm: {force:10.4g} N, {flux * 1e3:10.4g} mT")
        self._draw(magnet, inside, picture)
        console.print(f"Wrote {picture}.")

    def _name(self) -> str:
        return Path(self.magnet).name.removesuffix(".toml")

    def _draw(self, magnet: Magnet, inside: tuple[InternalMagnet, ...], picture: Path) -> None:
        from vrcaps.core.files import write_bytes
        from vrcaps.tools.report import make_figure, png_bytes

        figure = make_figure(11.0, 4.8)
        left, right = figure.subplots(1, 2)
        draw_field(left, magnet)
        gaps = np.geomspace(0.5, 40.0, 200) * CM
        right.loglog(gaps / CM, pull(magnet, inside, gaps)[0])
        right.set_xlabel("distance from the magnet's face [cm]")
        right.set_ylabel(f"pull on the capsule {self.capsule} [N]")
        right.grid(visible=True, which="both", alpha=0.3)
        figure.suptitle(f"{self._name()}: {magnet.moment:.4g} A·m², {mass_of(magnet)}")
        write_bytes(picture, png_bytes(figure, 120.0))


def mass_of(magnet: Magnet) -> str:
    """Mass of a magnet as text."""
    return f"{magnet.mass:.3g} kg" if magnet.mass >= 0.1 else f"{1e3 * magnet.mass:.3g} g"


def properties(magnet: Magnet) -> list[str]:
    """Lines on size, strength and mass of a magnet."""
    sizes = []
    for f in fields(magnet):
        if f.metadata.get("unit") == "mm":
            values = np.atleast_1d(getattr(magnet, f.name)) / MM
            sizes.append(f"{f.name} {' x '.join(f'{value:.4g}' for value in values)} mm")
    direction = getattr(magnet, "magnetization", "along z" if magnet.kind == "block" else "")
    magnetized = f", magnetized {direction}" if direction else ""
    far = dipole_distance(magnet)
    return [
        f"Magnet: {magnet.kind}, {', '.join(sizes)}{magnetized}.",
        f"Remanence: {magnet.remanence:.4g} T. Moment: {magnet.moment:.4g} A·m². "
        f"Mass: {mass_of(magnet)}, as NdFeB.",
        f"A dipole approximates its field within 5 % beyond {far / CM:.3g} cm from its center.",
    ]


def pull(
    magnet: Magnet, inside: tuple[InternalMagnet, ...], gaps: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Force towards the magnet [N] and flux density [T] on its axis.

    Args:
        magnet: The magnet at the origin, its moment along z.
        inside: Magnets of the capsule, turned so that the sum of their moments is along z.
        gaps: Distances from the magnet's bounding cylinder to the capsule's center [m].
    """
    from vrcaps.core.geometry import invert
    from vrcaps.magnet.field import SourceSet
    from vrcaps.magnet.sources import magnet_pose

    moment = np.sum([m.moment_capsule for m in inside], axis=0)
    poses = np.tile(invert(magnet_pose(np.zeros(3), moment)), (len(gaps), 1, 1))
    poses[:, 2, 3] = 0.5 * magnet.bounds[1] + gaps
    sources = SourceSet([magnet])
    force, _ = sources.wrench(inside, poses)
    return -force[:, 2], np.linalg.norm(sources.field(poses[:, :3, 3])[0], axis=1)


def draw_field(axes: matplotlib.axes.Axes, magnet: Magnet) -> None:
    """Draw the flux density in the plane y = 0 of the magnet, and its outline."""
    from matplotlib.colors import LogNorm

    from vrcaps.magnet.field import field

    half = 2.0 * max(magnet.bounds)
    line = np.linspace(-half, half, _CELLS) + 1e-6 * half  # off faces and edges
    x, z = np.meshgrid(line, line)
    points = np.stack([x, np.full_like(x, 1e-7 * half), z], axis=-1).reshape(-1, 3)
    flux = field([magnet], points)[0].reshape(_CELLS, _CELLS, 3)
    strength = np.linalg.norm(flux, axis=-1) * 1e3
    shown = axes.pcolormesh(
        x / CM, z / CM, strength, norm=LogNorm(*np.percentile(strength, (2, 99.5))), cmap="viridis"
    )
    axes.streamplot(
        line / CM, line / CM, flux[..., 0], flux[..., 2], color="white", linewidth=0.5, density=1.2
    )
    for lines in _outline(magnet):
        axes.plot(lines[:, 0] / CM, lines[:, 1] / CM, color="black", linewidth=1.5)
    axes.set(xlabel="x [cm]", ylabel="z, along the moment [cm]", aspect="equal")
    axes.figure.colorbar(shown, ax=axes, label="flux density [mT]")


def _outline(magnet: Magnet) -> list[np.ndarray]:
    """Closed lines of the magnet's section with the plane y = 0 [m], columns x and z."""
    from vrcaps.magnet.magnets import magnet_mesh

    mesh = magnet_mesh(magnet)
    section = mesh.section(plane_normal=(0.0, 1.0, 0.0), plane_origin=(0.0, 1e-7, 0.0))
    return [] if section is None else [line[:, [0, 2]] for line in section.discrete]
