"""Accuracy of organs from CT: a synthetic scan of a known organ.

Claim: mean distance between estimated and true wall ≤ 0.35 mm, 95 % ≤ 0.8 mm, centerline
length within 2 %, every polyp of 6 mm or more present.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import DATA, options, table, write_section
from tests.support.phantom import Polyp, Scanner, scan_of, with_polyps, write_dicom
from vrcaps._core import Wall as Surface
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh, wall_distance
from vrcaps.mesh.read_mesh import read_mesh
from vrcaps.mesh.repair import repair
from vrcaps.organ.centerline import compute_centerline
from vrcaps.organ.surface import OrganSurface
from vrcaps.tools.ct.from_ct import WallOptions, find_lumens, organ_from_gas
from vrcaps.tools.ct.lumen import choose_gas
from vrcaps.tools.ct.scan_files import read_volume

POLYPS = (6 * MM, 6 * MM, 7 * MM, 8 * MM, 10 * MM, 14 * MM)
PRESENT = 0.75  # of a polyp's height that the wall found must show
SAMPLES = 20_000
MEAN, P95, LENGTH = 0.35 * MM, 0.8 * MM, 0.02
HEAD = ("phantom", "voxels", "mean", "95 %", "largest", "length", "polyps", "claimed")


def walls(seed: int) -> list[tuple[str, Mesh]]:
    """The generated colon, and a colon from a patient where the optional data is present."""
    organ = generate_organ("colon", seed=seed)
    found = [("generated colon", Mesh(organ.vertices, organ.faces))]
    path = DATA / "colon_GI1_mm.ply"
    if path.exists():
        mesh, _ = repair(replace(read_mesh(path, unit="mm"), uv=None))
        found.append(("colon from a patient", mesh))
    return found


def surface_distances(found: Mesh, truth: Mesh, rng: np.random.Generator) -> np.ndarray:
    """Distances [m] from random vertices of each wall to the other, both ways."""
    distances = []
    for one, other in ((found, truth), (truth, found)):
        some = rng.choice(len(one.vertices), min(SAMPLES, len(one.vertices)), replace=False)
        distances.append(wall_distance(one.vertices[some], other.vertices, other.faces))
    return np.concatenate(distances)


def polyp_shares(organ: OrganSurface, truth: Mesh, polyps: list[Polyp]) -> np.ndarray:
    """Height of each polyp in the estimated wall over its true height, along its axis.

    Both heights are over the same base: the polyp's foot in the true wall.
    """
    shares = []
    surfaces = [Surface(m.vertices, m.faces.astype(np.int64)) for m in (organ, truth)]
    for polyp in polyps:
        # From just above the apex down onto the wall.
        origin = polyp.foot + (polyp.diameter / 2.0 + 2.0 * MM) * polyp.axis
        away = [s.cast(origin[None], -polyp.axis[None].copy())[0][0] for s in surfaces]
        height = [polyp.diameter / 2.0 + 2.0 * MM - float(distance) for distance in away]
        shares.append(height[0] / height[1])
    return np.array(shares)


@dataclass(frozen=True)
class Truth:
    """Wall with polyps, and the length of its centerline [m]."""

    name: str
    wall: Mesh
    polyps: list[Polyp]
    length: float


def known(name: str, wall: Mesh) -> Truth:
    """Wall with raised polyps."""
    wall, polyps = with_polyps(wall, POLYPS, np.random.default_rng(0))
    return Truth(name, wall, polyps, compute_centerline(wall).length)


def compare(truth: Truth, scanner: Scanner, folder: Path) -> tuple[str, ...]:
    """One row of the table."""
    rng = np.random.default_rng(1)
    write_dicom(folder, scan_of(truth.wall, scanner, rng))
    scan = read_volume(folder)
    gas = find_lumens(scan)
    tagged = "supine" if scanner.fluid_depth else None
    piece = choose_gas(gas, scan)[0]
    organ = organ_from_gas(
        scan, gas, piece, wall=WallOptions(), name="phantom", tagged_fluid=tagged
    )
    distances = surface_distances(Mesh(organ.vertices, organ.faces), truth.wall, rng)
    length = organ.centerline.length / truth.length - 1.0
    shares = polyp_shares(organ, truth.wall, truth.polyps)
    mean, high = float(distances.mean()), float(np.quantile(distances, 0.95))
    good = mean <= MEAN and high <= P95 and abs(length) <= LENGTH and shares.min() >= PRESENT
    return (
        f"{truth.name}, tagged fluid" if scanner.fluid_depth else truth.name,
        " × ".join(map(str, scan.values.shape[::-1])),
        f"{mean / MM:.3f} mm",
        f"{high / MM:.3f} mm",
        f"{distances.max() / MM:.1f} mm",
        f"{length:+.2%}",
        f"{np.count_nonzero(shares >= PRESENT)} of {len(shares)}, least {shares.min():.0%} high",
        "yes" if good else "NO",
    )


def main() -> None:
    """Compare, write the table after each row."""
    given = options(__doc__ or "", size=1)
    rows = []
    for seed in range(given.size):
        for name, wall in walls(seed):
            truth = known(name, wall)
            for fluid in (0.0, 45 * MM):
                with tempfile.TemporaryDirectory() as folder:
                    rows.append(compare(truth, Scanner(fluid_depth=fluid), Path(folder)))
                write_section(given.out, Path(__file__), section(rows))


def section(rows: list[tuple[str, ...]]) -> str:
    """Section of the page."""
    return (
        "## CT\n\n`python -m benchmarks.validation.ct`: organs scanned at 0.7 × 0.7 × 1.0 mm, "
        "oblique, with partial\nvolume, blur (0.5 mm) and noise (25 HU), in a body with fat, "
        "muscle, bone and lungs,\non a table, written as DICOM, read and made into an organ.\n\n"
        + table(HEAD, rows)
        + "\n\nDistances: from 20,000 vertices of each wall to the other, both ways. Claimed: mean "
        f"≤ {MEAN / MM:g} mm,\n95 % ≤ {P95 / MM:g} mm, centerline length from end to end "
        f"within {LENGTH:.0%}, each "
        f"of the polyps (6 to 14 mm across,\nhalf as high) with {PRESENT:.0%} of its height or "
        "more."
    )


if __name__ == "__main__":
    main()
