import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from tests.support.shapes import DIRECT
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import look_along, transform_from
from vrcaps.core.units import MM
from vrcaps.lesion import (
    LESIONS,
    Angioectasia,
    Bleeding,
    Colitis,
    Diverticulum,
    Location,
    Polyp,
    Stricture,
    add_lesions,
    sites,
)
from vrcaps.lesion.focal import FocalForm
from vrcaps.mesh.mesh import Mesh, find_edges, signed_volume
from vrcaps.mesh.patch import ThinTrianglesError
from vrcaps.organ.surface import face_label
from vrcaps.render.renderer import Renderer
from vrcaps.world.model import Model, State

pytestmark = pytest.mark.slow

RADIUS = 18.0 * MM
MIDDLE = Location(arc_length=80.0 * MM, theta=0.3)
ONE_OF_EACH = [
    *(Polyp(shape=shape, location=MIDDLE) for shape in ("Ip", "Is", "IIa", "IIb", "IIc")),
    *(Bleeding(severity=level, location=MIDDLE) for level in (1, 4)),
    *(Colitis(mayo=mayo, spread=50.0 * MM, location=MIDDLE) for mayo in (1, 3)),
    *(
        cls(location=MIDDLE)
        for kind, cls in LESIONS.items()
        if kind not in ("polyp", "bleeding", "colitis")
    ),
]


def named(lesion):
    return f"{lesion.kind} {lesion.grade}".strip()


@pytest.mark.parametrize("lesion", ONE_OF_EACH, ids=named)
def test_every_kind(tube, lesion):
    bare = replace(tube, appearance=None)
    patient = add_lesions(bare, [lesion], np.random.default_rng(5))
    organ, clean = patient.organ, patient.clean
    assert np.isfinite(organ.vertices).all()
    assert np.array_equal(organ.faces, clean.faces)
    counts = find_edges(organ.faces).counts
    assert counts.max() == 2
    assert (counts == 1).sum() == 2 * 72
    inside = organ.instance == 1
    assert inside.any()
    assert not clean.instance.any()
    assert np.array_equal(organ.vertices[~inside], clean.vertices[~inside])
    assert np.array_equal(clean.vertices[: len(tube.vertices)], tube.vertices)
    (record,) = json.loads(json.dumps(organ.metadata["lesions"]))
    assert (record["instance"], record["kind"]) == (1, lesion.kind)
    assert record["arc_length_m"] == pytest.approx(80.0 * MM, abs=3.0 * MM)
    assert record["segment"] in ("upper", "lower")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "size"),
    [("Ip", 6 * MM), ("Is", 8 * MM), ("IIa", 12 * MM), ("IIc", 10 * MM)],
)
def test_a_polyps_largest_diameter_is_its_size(tube, shape, size):
    """Across the axis, as against an open forceps; of Ip that of the head, above the stalk."""
    bare = replace(tube, appearance=None)
    axis = -np.array([np.cos(0.3), np.sin(0.3), 0.0])
    polyp = Polyp(shape=shape, size=size, location=MIDDLE)
    organ = add_lesions(bare, [polyp], np.random.default_rng(0)).organ
    own = organ.vertices[organ.instance == 1]
    height = own @ axis + RADIUS
    head = own[height > (0.5 * height.max() if shape == "Ip" else -np.inf)]
    assert pdist(head - (head @ axis)[:, None] * axis).max() == pytest.approx(size, rel=0.03)
    if shape in ("Ip", "Is"):
        assert height.max() == pytest.approx(polyp.protrusion, rel=0.15)


def test_a_polyp_takes_volume_from_the_lumen_and_a_pouch_adds_some(tube):
    bare = replace(tube, appearance=None)

    def change(lesion):
        patient = add_lesions(bare, [lesion], np.random.default_rng(0))
        volumes = [
            abs(signed_volume(Mesh(organ.vertices, organ.faces)))
            for organ in (patient.organ, patient.clean)
        ]
        return volumes[0] - volumes[1]

    ball = np.pi / 6 * (10 * MM) ** 3
    assert -1.6 * ball < change(Polyp(shape="Is", size=10 * MM, location=MIDDLE)) < -0.5 * ball
    assert change(Diverticulum(size=6 * MM, location=MIDDLE)) > 0.5 * np.pi / 6 * (6 * MM) ** 3


def test_a_stricture_narrows_the_lumen_as_stated(tube):
    bare = replace(tube, appearance=None)
    stricture = Stricture(narrowing=0.6, location=MIDDLE)
    organ = add_lesions(bare, [stricture], np.random.default_rng(0)).organ
    calibre = np.hypot(*organ.vertices[:, :2].T)
    at_middle = np.abs(organ.vertices[:, 2] - 80.0 * MM) < 2.0 * MM
    assert calibre[at_middle].mean() == pytest.approx(0.4 * RADIUS, rel=0.12)


def test_blood_runs_down_and_its_pool_is_level(tube):
    down = np.array([0.0, 1.0, 0.0])
    bare = replace(tube, appearance=None)
    source = Location(arc_length=80 * MM, theta=0.0)
    patient = add_lesions(
        bare, [Bleeding(severity=3, location=source)], np.random.default_rng(0), down=down
    )
    organ = patient.organ
    own = organ.instance == 1
    theta = organ.theta[own]
    assert theta.max() > 0.45 * np.pi  # from the side it reaches the bottom, θ = π/2
    assert theta.min() > -0.45
    rise = (organ.vertices - patient.clean.vertices)[own] @ -down
    deep = rise > 1.5 * MM
    assert deep.any()
    level = np.percentile(organ.vertices[own][deep] @ down, [25, 75])
    assert level == pytest.approx(RADIUS - 2.5 * MM, abs=0.15 * MM)


def test_a_pool_leaves_room_for_a_capsule(tube):
    """In an upright tube the pool's level lies across the lumen, which it must not block."""
    bleed = Bleeding(severity=4, location=Location(arc_length=110 * MM, theta=0.0))
    bare = replace(tube, appearance=None)
    organ = add_lesions(bare, [bleed], np.random.default_rng(0), down=(0.0, 0.0, 1.0)).organ
    calibre = np.hypot(*organ.vertices[organ.instance == 1, :2].T)
    assert 6.0 * MM < calibre.min() < 12.0 * MM


def test_instances_follow_the_order_given_and_spots_keep_apart(tube):
    lesions = [Polyp(size=6 * MM), Colitis(mayo=2, spread=60 * MM), *[Polyp(size=5 * MM)] * 2]
    bare = replace(tube, appearance=None)
    organ = add_lesions(bare, lesions, np.random.default_rng(3)).organ
    records = organ.metadata["lesions"]
    assert [record["kind"] for record in records] == [lesion.kind for lesion in lesions]
    assert set(np.unique(face_label(organ.instance, organ.faces))) == {0, 1, 2, 3, 4}
    centers = np.array([r["center_m"] for r in records if r["kind"] == "polyp"])
    apart = np.linalg.norm(centers[:, None] - centers, axis=2) + np.eye(len(centers))
    assert apart.min() > 5 * MM


def test_same_seed_same_bytes(tube):
    lesions = [Polyp(), Bleeding(severity=2)]
    bare = replace(tube, appearance=None)
    one, two, other = (
        add_lesions(organ, lesions, np.random.default_rng(seed)).organ
        for organ, seed in ((tube, 7), (tube, 7), (bare, 8))
    )
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.appearance is not None
    assert two.appearance is not None
    assert one.appearance.albedo.tobytes() == two.appearance.albedo.tobytes()
    assert one.vertices.shape != other.vertices.shape


def test_too_many(tube):
    with pytest.raises(InputError, match="Allowed: up to 65535"):
        add_lesions(tube, [Polyp()] * 65_536, np.random.default_rng(0))


def views(center, count=10):
    """Poses that look at a place on the wall from around it."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        eye = np.array([*rng.uniform(-0.5, 0.5, 2) * RADIUS, center[2] + rng.uniform(-18, 18) * MM])
        yield transform_from(look_along(center - eye, np.array([0.1, 0.2, 1.0])), eye)


def test_masks_equal_the_geodesic_footprint(tube, monkeypatch):
    """The mask against rays cast on the true cylinder, its footprint unrolled: IoU ≥ 0.98."""
    forms: list[FocalForm] = []
    make = Angioectasia.form
    monkeypatch.setattr(
        Angioectasia, "form", lambda self, *a: forms.append(make(self, *a)) or forms[-1]
    )
    lesion = Angioectasia(size=8 * MM, location=MIDDLE)
    organ = add_lesions(tube, [lesion], np.random.default_rng(0)).organ
    (form,) = forms
    camera = read_device("mirocam").cameras[0]
    model = Model(organ, read_device("mirocam"), np.eye(4))
    renderer = Renderer(model, DIRECT)
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    overlaps = []
    for pose in views(form.site.center):
        T_world_capsule = pose @ np.linalg.inv(camera.T_capsule_camera)
        image = renderer.render(State(0.0, T_world_capsule), camera, channels=("instance",))
        rays = camera.lens.unproject(pixels.astype(float)) @ pose[:3, :3].T
        seen = np.asarray(image.instance) == 1
        expected = footprint(form, pose[:3, 3], rays)
        overlaps.append((seen & expected).sum() / (seen | expected).sum())
        assert expected.sum() > 300
    assert min(overlaps) >= 0.98


def footprint(form, eye, rays):
    """Return whether rays meet the cylinder inside the form's outline."""
    a = (rays[..., :2] ** 2).sum(axis=-1)
    b = rays[..., :2] @ eye[:2]
    c = eye[:2] @ eye[:2] - RADIUS**2
    t = (-b + np.sqrt(b * b - a * c)) / a
    hit = eye + t[..., None] * rays
    center = form.site.center
    turn = np.arctan2(hit[..., 1], hit[..., 0]) - np.arctan2(center[1], center[0])
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    tangent = np.array([-center[1], center[0], 0.0]) / np.hypot(*center[:2])
    flat = RADIUS * turn[..., None] * tangent + (hit[..., 2:] - center[2]) * [0.0, 0.0, 1.0]
    xy = flat @ form.site.axes[:, :2]
    angle = np.arctan2(xy[..., 1], xy[..., 0])
    outline = form.radius * (1.0 + form._waviness * form._outline(angle))
    return np.linalg.norm(xy, axis=-1) < outline


@pytest.mark.parametrize(
    "lesion",
    [Angioectasia(size=8 * MM, location=MIDDLE), Polyp(size=8 * MM, location=MIDDLE)],
    ids=named,
)
def test_clean_twin_differs_only_inside_the_masks(tube, lesion):
    patient = add_lesions(tube, [lesion], np.random.default_rng(0))
    device = read_device("mirocam")
    camera = device.cameras[0]
    lesioned, clean = (
        Renderer(Model(organ, device, np.eye(4)), DIRECT)
        for organ in (patient.organ, patient.clean)
    )
    center = np.array(patient.organ.metadata["lesions"][0]["center_m"])
    for pose in views(center, 3):
        state = State(0.0, pose @ np.linalg.inv(camera.T_capsule_camera))
        one = lesioned.render(state, camera, channels=("rgb", "instance"))
        two = clean.render(state, camera, channels=("rgb",))
        apart = np.abs(np.asarray(one.rgb, int) - np.asarray(two.rgb, int)).max(axis=-1)
        outside = np.asarray(one.instance) == 0
        assert (apart[outside] > 4).mean() < 0.01
        assert (apart[~outside] > 4).mean() > 0.3


def test_clean_twin_looks_like_the_organ_itself(tube):
    lesions = [Polyp(location=MIDDLE), Colitis(mayo=3, spread=60 * MM, location=MIDDLE)]
    clean = add_lesions(tube, lesions, np.random.default_rng(0)).clean
    device = read_device("mirocam")
    state = State(0.0, next(views(np.array([RADIUS, 0.0, 80 * MM]))))
    one, two = (
        np.asarray(
            Renderer(Model(organ, device, np.eye(4)), DIRECT)
            .render(state, device.cameras[0], channels=("rgb",))
            .rgb,
            int,
        )
        for organ in (tube, clean)
    )
    assert np.abs(one - two).mean() < 1.0


def test_another_location_is_drawn_where_triangles_are_too_thin(tube, monkeypatch):
    whole, calls = sites.log_map, []

    def thin_at_first(*args, **settings):
        calls.append(args)
        if len(calls) == 1:
            raise ThinTrianglesError("thin")
        return whole(*args, **settings)

    monkeypatch.setattr(sites, "log_map", thin_at_first)
    pair = add_lesions(tube, [Polyp(size=6 * MM)], np.random.default_rng(3))
    assert len(calls) == 2
    assert pair.organ.instance.max() == 1


def test_thin_triangles_at_a_stated_location_are_one_line(tube, monkeypatch):
    def thin(*args, **settings):
        raise ThinTrianglesError("the wall there has triangles that are too thin for a lesion")

    monkeypatch.setattr(sites, "log_map", thin)
    with pytest.raises(InputError, match=r"No location for polyp Is .*too thin.*Choose another"):
        add_lesions(tube, [Polyp(size=6 * MM)], np.random.default_rng(3))
