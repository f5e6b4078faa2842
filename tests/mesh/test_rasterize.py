import numpy as np
import pytest

from vrcaps.mesh.rasterize import covered_texels, sample


def test_triangle():
    """Texels of a right triangle with legs of n texels: those with x + y ≤ n, within a margin."""
    texels = covered_texels(np.array([[[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]]]), margin=0.01)
    assert len(texels) == 66
    assert (texels.column + texels.row).max() == 10
    place = texels.weights @ np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    assert place == pytest.approx(np.stack([texels.column, texels.row], axis=1), abs=1e-5)


def test_every_texel_once_and_no_gap():
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0)), axis=-1) * 7.0
    grid[1:-1, 1:-1] += rng.uniform(-2, 2, (7, 7, 2))
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    faces = np.concatenate(
        [
            np.stack([a, b, c], axis=2).reshape(-1, 3, 2),
            np.stack([a, c, d], axis=2).reshape(-1, 3, 2),
        ]
    )
    texels = covered_texels(faces, margin=0.5)
    places = set(zip(texels.column.tolist(), texels.row.tolist(), strict=True))
    assert len(places) == len(texels) == 57 * 57
    assert texels.weights.min() >= 0.0
    assert texels.weights.sum(axis=1) == pytest.approx(1.0)


def texels_by_numpy(corners, margin):
    """The texels of each face in turn: column, row, face, weights, in the kernel's order."""
    deepest = {}
    for number, face in enumerate(corners):
        low = np.floor(face.min(axis=0) - margin).astype(int)
        high = np.ceil(face.max(axis=0) + margin).astype(int) + 1
        texels = np.stack(np.meshgrid(*map(np.arange, low, high)), axis=-1).reshape(-1, 2)
        following, last = np.roll(face, -1, axis=0), np.roll(face, -2, axis=0)
        areas = cross(following - texels[:, None], last - texels[:, None])
        doubled = cross(face[1] - face[0], face[2] - face[0])
        side = np.maximum(np.hypot(*(last - following).T), 1e-12)
        depth = (areas * np.sign(doubled) / side).min(axis=1)
        for k in np.flatnonzero((depth > -margin) & (doubled != 0.0)):
            weights = np.maximum(areas[k] / doubled, 0.0)
            found = np.float32(min(depth[k], 0.0)), number, weights / weights.sum()
            place = (texels[k, 1], texels[k, 0])
            if place not in deepest or found[0] > deepest[place][0]:
                deepest[place] = found
    rows, columns = np.array(sorted(deepest)).T
    _, faces, weights = zip(*(deepest[place] for place in sorted(deepest)), strict=True)
    return columns, rows, np.array(faces), np.array(weights).astype(np.float32)


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


@pytest.mark.parametrize("margin", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("is_whole", [False, True])
def test_the_kernel_is_as_its_numpy_twin(margin, is_whole):
    """Faces of all sizes that overlap, share edges or have no area."""
    rng = np.random.default_rng(3)
    corners = rng.uniform(-30.0, 60.0, (60, 1, 2)) + rng.normal(0.0, 1.0, (60, 3, 2)) * rng.choice(
        [0.2, 2.0, 12.0], (60, 1, 1)
    )
    corners[7, 2] = corners[7, 0]
    corners = np.round(corners) if is_whole else corners
    texels = covered_texels(corners, margin=margin)
    found = (texels.column, texels.row, texels.face, texels.weights)
    for one, other in zip(found, texels_by_numpy(corners, margin), strict=True):
        assert np.array_equal(one, other)


def test_no_faces_cover_nothing():
    assert len(covered_texels(np.zeros((0, 3, 2)))) == 0


@pytest.mark.parametrize(
    ("corners", "margin", "told"),
    [
        (np.zeros((1, 4, 2)), 1.0, r"must be \[m 3 2\]"),
        (np.full((1, 3, 2), np.nan), 1.0, "at most a million"),
        (np.full((1, 3, 2), 2e6), 1.0, "at most a million"),
        (np.zeros((1, 3, 2)), -1.0, "at most a million"),
    ],
)
def test_what_are_no_faces_on_a_texture_is_refused(corners, margin, told):
    with pytest.raises(ValueError, match=told):
        covered_texels(corners, margin=margin)


def test_sample_is_bilinear_and_wraps():
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 256, (6, 8, 3)).astype(np.uint8)
    centers = np.stack(np.meshgrid((np.arange(8) + 0.5) / 8, 1 - (np.arange(6) + 0.5) / 6), axis=-1)
    found = sample(texture, centers.reshape(-1, 2), np.arange(256.0)).reshape(6, 8, 3)
    assert found == pytest.approx(texture.astype(float))
    shifted = sample(texture, centers.reshape(-1, 2) + np.array([3.0, -2.0]), np.arange(256.0))
    assert shifted.reshape(6, 8, 3) == pytest.approx(texture.astype(float))
    between = sample(texture, np.array([[1.0, 1 - 0.5 / 6]]), np.arange(256.0))
    assert between[0] == pytest.approx(0.5 * (texture[0, 0].astype(float) + texture[0, -1]))
