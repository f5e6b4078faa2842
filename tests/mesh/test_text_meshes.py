"""STL, OBJ and PLY as exporters and people write them: one tetrahedron of 1/6 in each form."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.mesh.mesh import Mesh, signed_volume, triangulate_strips
from vrcaps.mesh.read_mesh import read_mesh

POINTS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]


def read(path: Path) -> Mesh:
    return read_mesh(path, unit="m")


def check(mesh: Mesh) -> None:
    assert len(mesh.faces) == 4
    assert signed_volume(mesh) == pytest.approx(1 / 6)


def stl(end: str = "endsolid thing\n") -> str:
    rows = ["solid thing\n"]
    for face in FACES:
        corners = "".join("vertex {} {} {}\n".format(*POINTS[k]) for k in face)
        rows.append(f" facet normal 0 0 0\n  outer loop\n{corners}  endloop\n endfacet\n")
    return "".join(rows) + end


def binary_stl(head: bytes = b"made by hand", after: bytes = b"") -> bytes:
    facets = np.zeros(4, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = np.array(POINTS, float)[np.array(FACES)]
    return head.ljust(80) + struct.pack("<I", 4) + facets.tobytes() + after


@pytest.mark.parametrize(
    "text",
    [
        stl(),
        stl().upper(),
        stl(end=""),
        stl(end="end solid thing\n"),
        stl().replace("\n", "\r\n"),
        stl().replace("\n", "\r"),
        "\n\n  " + stl(),
        stl().replace("vertex 1 0 0", "vertex 1.0E+00\t0 -0.0"),
        stl().replace("solid thing", "solid vertex 1 2 3"),
        stl() + "\n\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_text_stl_with_the_liberties_of_exporters(tmp_path: Path, text: str, encoding: str) -> None:
    (tmp_path / "a.STL").write_bytes(text.encode(encoding))
    check(read(tmp_path / "a.STL"))


def test_text_stl_of_several_solids_and_with_polygons(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_text(stl() + stl())
    assert len(read(tmp_path / "a.stl").faces) == 8
    square = "".join(f"vertex {x} {y} 0\n" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
    (tmp_path / "a.stl").write_text(f"solid\nfacet\nouter loop\n{square}endloop\nendfacet\n")
    assert read(tmp_path / "a.stl").faces.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("end", ["vertex 0 0 0\n", "vertex 0 0 0\n  endl", "vertex 0 0"])
def test_text_stl_that_is_cut_in_a_facet(tmp_path: Path, end: str) -> None:
    (tmp_path / "a.stl").write_text(stl(end=" facet normal 0 0 0\n  outer loop\n" + end))
    with pytest.raises(InputError, match=r"truncated: the last facet has no end|out of range"):
        read(tmp_path / "a.stl")


@pytest.mark.parametrize(
    "data",
    [
        binary_stl(),
        binary_stl(b"solid but binary"),
        binary_stl(b"solid facet"),
        binary_stl(after=b"\n\n"),
        binary_stl(after=bytes(49)),
    ],
)
def test_binary_stl(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.stl").write_bytes(data)
    check(read(tmp_path / "a.stl"))


@pytest.mark.parametrize("data", [binary_stl()[:-1], binary_stl(after=bytes(50))])
def test_binary_stl_whose_count_is_wrong(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.stl").write_bytes(data)
    with pytest.raises(InputError, match="neither ASCII nor binary STL, or truncated"):
        read(tmp_path / "a.stl")


V = "".join("v {} {} {}\n".format(*point) for point in POINTS)


def faces(form: str) -> str:
    return "".join(
        "f " + " ".join(form.format(k + 1, k - 4) for k in face) + "\n" for face in FACES
    )


@pytest.mark.parametrize(
    "text",
    [
        V + faces("{0}"),
        V + faces("{1}"),
        V + "vn 0 0 1\n" + faces("{0}//1"),
        V + "vn 0 0 1\nvt 0 0\n" + faces("{0}/1/1"),
        V + faces("{0}").replace("\n", " # side\n"),
        "# head\r\n" + (V + faces("{0}")).replace("\n", "\r\n"),
        (V + faces("{0}")).replace("\n", "\r"),
        V + faces("{0}").replace("f 1 3 2", "f 1 \\\n 3 2").replace("f 1 2 4", "f 1 \\ \r\n 2 4"),
        V.replace("\n", " 1.0\n") + faces("{0}"),
        V.replace("\n", " 0.5 0.5 0.5\n") + faces("{0}"),
        "mtllib a.mtl\no one\ng two\ns off\nusemtl red\n" + V + "l 1 2\np 1\n" + faces("{0}"),
        (V + faces("{0}")).upper(),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be"])
def test_obj_with_the_liberties_of_exporters(tmp_path: Path, text: str, encoding: str) -> None:
    mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
    (tmp_path / "a.obj").write_bytes(mark + text.encode(encoding))
    check(read(tmp_path / "a.obj"))


def test_obj_with_a_short_vertex(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(V + "v 1 2\n" + faces("{0}"))
    with pytest.raises(InputError, match=r"Cannot read .* as OBJ: "):
        read(tmp_path / "a.obj")


def ply(
    *,
    properties: str = "property float x\nproperty float y\nproperty float z\n",
    point: Callable[[int], str] = lambda k: "{} {} {}".format(*POINTS[k]),
    face_properties: str = "property list uchar int vertex_indices\n",
    face: Callable[[int], str] = lambda k: "3 {} {} {}".format(*FACES[k]),
    first: str = "",
    after: str = "",
) -> str:
    head = f"ply\n{first}format ascii 1.0\ncomment by end_header hand\nobj_info x\n"
    head += f"element vertex 4\n{properties}element face 4\n{face_properties}end_header\n"
    rows = [point(k) for k in range(4)] + [face(k) for k in range(4)]
    return head + "\n".join(rows) + "\n" + after


@pytest.mark.parametrize(
    "text",
    [
        ply(),
        ply(first="comment first\n"),
        ply().replace("\n", "\r\n"),
        ply().replace("\n", "\r"),
        ply(after="\n\n"),
        ply(
            properties="property double z\nproperty uchar red\nproperty double x\n"
            "property double y\n",
            point=lambda k: "{} 255 {} {}".format(*np.roll(POINTS[k], 1)),
        ),
        ply(
            face_properties="property float w\nproperty list uint8 uint32 vertex_index\n",
            face=lambda k: "0.5 3 {} {} {}".format(*FACES[k]),
        ),
    ],
)
def test_text_ply_with_the_liberties_of_exporters(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.ply").write_bytes(text.encode())
    check(read(tmp_path / "a.ply"))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_binary_ply_whose_body_begins_like_a_line_end(
    tmp_path: Path, order: str, line_end: str
) -> None:
    name = "binary_little_endian" if order == "<" else "binary_big_endian"
    head = ply().rpartition("end_header")[0].replace("ascii", name).replace("float", "short")
    body = (np.array(POINTS) + 0x0A0A).astype(order + "i2").tobytes()
    for face in FACES:
        body += bytes([3]) + np.array(face, order + "i4").tobytes()
    text = (head + "end_header\n").replace("\n", line_end)
    (tmp_path / "a.ply").write_bytes(text.encode() + body + b"after")
    check(read(tmp_path / "a.ply"))


def test_ply_strips(tmp_path: Path) -> None:
    text = ply(
        face_properties="property list int int vertex_indices\n",
        face=lambda k: ["6 0 1 3 2 -1 0", "2 2 1", "4 1 2 3 -1", "0"][k],
    )
    (tmp_path / "a.ply").write_text(text.replace("element face", "element tristrips"))
    assert read(tmp_path / "a.ply").faces.tolist() == [[0, 1, 3], [1, 2, 3], [1, 2, 3]]


def test_strips_turn_every_second_triangle() -> None:
    assert triangulate_strips(np.array([4, 2, 3])).tolist() == [[0, 1, 2], [1, 3, 2], [6, 7, 8]]


def test_ply_labels_of_faces_become_labels_of_vertices(tmp_path: Path) -> None:
    """Vertices 0 and 1 lie in two faces of label 5 and one of 2, the others in two of 2."""
    text = ply(
        face_properties="property list uchar int vertex_indices\nproperty uchar label\n",
        face=lambda k: "3 {} {} {} {}".format(*FACES[k], (5, 5, 2, 2)[k]),
    )
    (tmp_path / "a.ply").write_text(text)
    mesh = read(tmp_path / "a.ply")
    assert mesh.label is not None
    assert mesh.label.tolist() == [5, 5, 2, 2]


@pytest.mark.parametrize("label", ["300", "-1", "1.6", "nan"])
@pytest.mark.parametrize("of", ["vertex", "face"])
def test_ply_labels_are_whole_and_in_range(tmp_path: Path, label: str, of: str) -> None:
    base = "property float x\nproperty float y\nproperty float z\n"
    text = (
        ply(
            properties=base + "property float label\n",
            point=lambda k: "{} {} {} {}".format(*POINTS[k], label),
        )
        if of == "vertex"
        else ply(
            face_properties="property list uchar int vertex_indices\nproperty float label\n",
            face=lambda k: "3 {} {} {} {}".format(*FACES[k], label),
        )
    )
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(InputError, match=rf"4 of the labels .* first is {label}.*0 to 255\.$"):
        read(tmp_path / "a.ply")


def test_ply_labels_of_faces_out_of_range_of_the_vertices(tmp_path: Path) -> None:
    text = ply(
        face_properties="property list uchar int vertex_indices\nproperty uchar label\n",
        face=lambda k: "3 0 1 9 1",
    )
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(InputError, match="4 faces with vertex indices out of range"):
        read(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("row", "match"),
    [
        ("-1 0 1 2", "a list declares -1 values"),
        ("2.5 0 1 2", "a list declares 2.5 values"),
        ("nan 0 1 2", "a list declares nan values"),
        ("3 0 1.5 2", "face indices are not allowed, the first is 1.5"),
        ("1e9 0 1 2", "Cannot read"),
    ],
)
def test_ply_lists_that_cannot_be(tmp_path: Path, row: str, match: str) -> None:
    (tmp_path / "a.ply").write_text(ply(face=lambda k: row))
    with pytest.raises(InputError, match=match):
        read(tmp_path / "a.ply")


@pytest.mark.parametrize("text", ["ply\nformat", "plyx\nformat ascii 1.0\nend_header\n", "ply\n"])
def test_ply_without_a_header(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(InputError, match="the PLY header is missing"):
        read(tmp_path / "a.ply")


def test_coordinates_too_far_from_the_origin_for_32_bits(tmp_path: Path) -> None:
    """At 5,100 km a 32-bit number has steps of 0.5 m."""
    far = np.array([4.5e5, 5.1e6, 300.0])
    shown = (np.array(POINTS) + far).astype("f4").astype(float)
    (tmp_path / "a.ply").write_text(ply(point=lambda k: "{} {} {}".format(*shown[k])))
    with pytest.raises(
        InputError,
        match=r"lies 5\.1e\+06 units from the origin and is 1 units wide: its 32-bit coordinates "
        r"have steps of 0\.61 units.* Move the mesh to the origin",
    ):
        read(tmp_path / "a.ply")
    exact = np.array(POINTS) + far + 0.1  # more digits than 32 bits hold
    (tmp_path / "a.ply").write_text(
        ply(point=lambda k: "{} {} {}".format(*exact[k])).replace("float", "double")
    )
    check(read(tmp_path / "a.ply"))
