"""Scans of known organs: voxelized with partial volume into a body, noise added, as DICOM."""

from __future__ import annotations

import locale
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from scipy import ndimage
from scipy.spatial.transform import Rotation

from vrcaps.mesh.mesh import Mesh, vertex_normals
from vrcaps.organ.lumen_grid import grid_crossings
from vrcaps.tools.ct.volume import Volume, index_to_patient

GAS, LUNG, FAT, WALL, BONE, FLUID = -1000.0, -860.0, -95.0, 40.0, 650.0, 480.0
WALL_THICKNESS = 3e-3
RIM = 18e-3  # subcutaneous fat
FIELD, TABLE = 36e-3, 16e-3  # how far the scan reaches beside the organ, and more under it


@dataclass(frozen=True)
class Scanner:
    """Spacing along k, j, i [m], blur [m], noise [HU], obliqueness and what is in the gut."""

    spacing: tuple[float, float, float] = (1.0e-3, 0.7e-3, 0.7e-3)
    blur: float = 0.5e-3
    noise: float = 25.0
    turn_deg: tuple[float, float, float] = (9.0, -6.0, 4.0)
    fluid_depth: float = 0.0  # of the tagged fluid's level above the lumen's lowest place [m]
    lungs: float = 25e-3  # extent of the scan above the organ
    orientation: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        turn = Rotation.from_euler("xyz", self.turn_deg, degrees=True).as_matrix()
        object.__setattr__(self, "orientation", turn @ np.eye(3)[:, ::-1])


def scan_of(mesh: Mesh, scanner: Scanner, rng: np.random.Generator) -> Volume:
    """A scan of a closed lumen in a body with fat, spine, lungs and a table under it."""
    transform, shape = _grid(mesh, scanner)
    lumen = coverage(mesh, transform, shape)
    wall_voxels = np.ceil(WALL_THICKNESS / np.array(scanner.spacing)).astype(int)
    gut = ndimage.maximum_filter(lumen, (2 * wall_voxels + 1).tolist()) > 0.05
    level = mesh.vertices[:, 1].max() - scanner.fluid_depth  # posterior is down: y grows downwards
    half = _half_axes(mesh)
    values = np.empty(shape, np.float32)
    rows, columns = np.ogrid[: shape[1], : shape[2]]
    for k in range(shape[0]):
        if k % 2 == 0:  # the body needs no finer grid
            coarse = np.array(
                np.meshgrid(k, *(np.arange(0, n, 2) for n in shape[1:]), indexing="ij")
            )
            points = index_to_patient(transform, coarse.reshape(3, -1).T)
            body = _body(points, mesh, half).reshape(coarse.shape[2:]).repeat(2, 0).repeat(2, 1)
            body = body[: shape[1], : shape[2]]
        y = transform[1] @ [k, 0, 0, 1] + transform[1, 1] * rows + transform[1, 2] * columns
        wet = np.clip(0.5 + (y - level) / scanner.spacing[1], 0.0, 1.0)
        content = GAS + (FLUID - GAS) * wet
        tissue = np.where(gut[k], WALL, body)
        values[k] = tissue + lumen[k] * (content - tissue)
    values = ndimage.gaussian_filter(values, scanner.blur / np.array(scanner.spacing), truncate=3)
    for k in range(shape[0]):
        grain = ndimage.gaussian_filter(rng.standard_normal(shape[1:], np.float32), 0.6)
        values[k] += scanner.noise * grain / grain.std()
    return Volume(np.rint(values).clip(-1024, 3071).astype(np.int16), transform, "phantom")


def coverage(
    mesh: Mesh, transform: np.ndarray, shape: tuple[int, int, int], *, rays: int = 3
) -> np.ndarray:
    """Fraction of each voxel inside a closed mesh: exact along k, by rays × rays lines across."""
    index = index_to_patient(np.linalg.inv(transform), mesh.vertices)
    lines = np.column_stack([(index[:, 1:] + 0.5) * rays - 0.5, index[:, 0]])
    columns, _, height = grid_crossings(
        lines, mesh.faces, np.array([shape[1] * rays, shape[2] * rays, shape[0]])
    )
    order = np.lexsort((height, columns[:, 1], columns[:, 0]))
    columns, height = columns[order], height[order]
    sign = np.where(np.arange(len(height)) % 2 == 0, 1.0, -1.0)  # every line goes in and out
    assert (columns[::2] == columns[1::2]).all()
    k = np.floor(height + 0.5).astype(int)
    first = (k + 0.5 - height) * sign / rays**2
    fraction = np.zeros((shape[0] + 1, *shape[1:]), np.float32)
    j, i = columns.T // rays
    np.add.at(fraction, (k, j, i), first.astype(np.float32))
    np.add.at(fraction, (k + 1, j, i), (sign / rays**2 - first).astype(np.float32))
    return np.cumsum(fraction[:-1], axis=0).clip(0.0, 1.0)


def _grid(mesh: Mesh, scanner: Scanner) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Oblique grid around the organ, with most of the body's skin and the table in it."""
    along = mesh.vertices @ scanner.orientation
    low = along.min(axis=0) - np.array([5e-3, FIELD, FIELD])
    high = along.max(axis=0) + np.array([scanner.lungs, FIELD + TABLE, FIELD])
    spacing = np.array(scanner.spacing)
    transform = np.eye(4)
    transform[:3, :3] = scanner.orientation * spacing
    transform[:3, 3] = scanner.orientation @ low
    shape = np.ceil((high - low) / spacing).astype(int) + 1
    return transform, tuple(shape.tolist())


def _half_axes(mesh: Mesh) -> np.ndarray:
    """Half axes of the body's section, a superellipse around the gut [m]."""
    low, high = mesh.vertices.min(axis=0)[:2], mesh.vertices.max(axis=0)[:2]
    half = 0.5 * (high - low)
    reach = _superradius((mesh.vertices[:, :2] - 0.5 * (low + high)) / half).max()
    return reach * half + RIM + 12e-3


def _superradius(points: np.ndarray) -> np.ndarray:
    """1 on a rounded square."""
    return (points**4).sum(axis=1) ** 0.25


def _body(points: np.ndarray, mesh: Mesh, half: np.ndarray) -> np.ndarray:
    """Hounsfield units of body and table without the gut, at points [m]."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = 0.5 * (low + high)
    x, y, z = (points - middle).T
    radius = _superradius(np.stack([x, y], axis=1) / half)
    value = np.full(len(points), GAS)
    value[radius < 1.0] = FAT
    rim = 1.0 - RIM / half.max()
    value[(radius < rim) & (radius > rim - 6e-3 / half.max())] = 55.0  # muscle
    spine = np.hypot(x, y - 0.75 * half[1])
    value[spine < 0.018] = BONE
    value[spine < 0.013] = 250.0
    top = high[2] - middle[2]
    for side in (-1.0, 1.0):
        at = np.stack([x - side * 0.45 * half[0], y, z - top - 0.045], axis=1)
        value[(np.linalg.norm(at / [0.35 * half[0], 0.5 * half[1], 0.035], axis=1) < 1.0)] = LUNG
        hip = np.stack([x - side * 0.7 * half[0], y - 0.3 * half[1], z + top], axis=1)
        value[(np.linalg.norm(hip, axis=1) < 0.02) & (radius < 0.9)] = BONE
    table = (y > half[1] + 6e-3) & (y < half[1] + 16e-3)
    value[table] = -880.0
    value[table & ((y < half[1] + 8e-3) | (y > half[1] + 14e-3))] = -150.0
    return value


@dataclass(frozen=True)
class Polyp:
    """A sessile polyp: its foot on the wall, the axis into the lumen, diameter [m]."""

    foot: np.ndarray
    axis: np.ndarray
    diameter: float


def with_polyps(
    mesh: Mesh, diameters: tuple[float, ...], rng: np.random.Generator, *, apart: float = 0.04
) -> tuple[Mesh, list[Polyp]]:
    """The wall, its triangles made finer, with hemispheres raised on it at random places.

    Args:
        mesh: Faces counter-clockwise seen from the lumen.
        diameters: Of the polyps [m].
        rng: Chooses the places.
        apart: Least distance between two [m].
    """
    vertices, faces = mesh.vertices, mesh.faces
    while np.linalg.norm(np.diff(vertices[faces[:, :2]], axis=1), axis=2).mean() > 1.1e-3:
        vertices, faces = quartered(vertices, faces)
    normals = vertex_normals(vertices, faces)
    polyps: list[Polyp] = []
    while len(polyps) < len(diameters):
        at = int(rng.integers(len(vertices)))
        diameter = diameters[len(polyps)]
        near = np.linalg.norm(vertices - vertices[at], axis=1) < 0.8 * diameter
        flat = (normals[near] @ normals[at]).min() > 0.5
        if flat and all(np.linalg.norm(p.foot - vertices[at]) > apart for p in polyps):
            polyps.append(Polyp(vertices[at], normals[at], diameter))
    raised = vertices.copy()
    for polyp in polyps:
        offset = vertices - polyp.foot
        up = offset @ polyp.axis
        across = np.linalg.norm(offset - up[:, None] * polyp.axis, axis=1)
        radius = polyp.diameter / 2.0
        on = (across < radius) & (np.linalg.norm(offset, axis=1) < 1.2 * polyp.diameter)
        on &= normals @ polyp.axis > 0.0
        height = np.sqrt(np.maximum(radius**2 - across[on] ** 2, 0.0))
        raised[on] += height[:, None] * polyp.axis
    return Mesh(raised, faces), polyps


def quartered(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each triangle cut in four at its edges' middles."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, number = np.unique(edges, axis=0, return_inverse=True)
    middle = len(vertices) + number.reshape(-1, 3)
    a, b, c = faces.T
    ab, bc, ca = middle.T
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    faces = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return np.concatenate([vertices, vertices[edges].mean(axis=1)]), faces


def write_dicom(
    folder: Path,
    scan: Volume,
    *,
    series: str = "1",
    modality: str = "CT",
    compressor: str | None = None,
    first: int = 0,
) -> list[Path]:
    """Write each axial slice of a scan as a DICOM file, in a shuffled order of names."""
    before = locale.setlocale(locale.LC_ALL)
    folder.mkdir(parents=True, exist_ok=True)
    transform = scan.T_patient_index
    spacing = scan.spacing * 1e3
    rows, columns = transform[:3, 1] / scan.spacing[1], transform[:3, 2] / scan.spacing[2]
    uid = f"1.2.826.0.1.3680043.9999.{series}"
    paths = []
    for k in range(len(scan.values)):
        image = sitk.GetImageFromArray(scan.values[k : k + 1])
        position = (transform[:3, 3] + k * transform[:3, 0]) * 1e3
        normal = np.cross(columns, rows)
        image.SetSpacing((spacing[2], spacing[1], spacing[0]))
        image.SetOrigin(position.tolist())
        image.SetDirection(np.column_stack([columns, rows, normal]).ravel().tolist())
        tags = {
            "0008|0060": modality,
            "0008|0016": "1.2.840.10008.5.1.4.1.1.2",
            "0008|0018": f"{uid}.{k + 1}",
            "0008|103e": f"series {series}",
            "0020|000d": "1.2.826.0.1.3680043.9999.0",
            "0020|000e": uid,
            "0020|0013": str(k + 1),
            "0020|0032": "\\".join(f"{x:.6f}" for x in position),
            "0020|0037": "\\".join(f"{x:.8f}" for x in [*columns, *rows]),
            "0028|1052": "-1024",
            "0028|1053": "1",
        }
        for tag, text in tags.items():
            image.SetMetaData(tag, text)
        writer = sitk.ImageFileWriter()
        writer.SetImageIO("GDCMImageIO")
        writer.KeepOriginalImageUIDOn()
        if compressor is not None:
            writer.SetUseCompression(True)
            writer.SetCompressor(compressor)
        path = folder / f"IM{(first + k) * 7919 % 100_003:06d}"
        writer.SetFileName(str(path) + ".dcm")
        writer.Execute(image)
        paths.append(path.with_suffix(".dcm"))
    locale.setlocale(locale.LC_ALL, before)  # GDCM's writer sets it to C
    return paths
