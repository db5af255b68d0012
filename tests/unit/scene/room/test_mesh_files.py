import math

import numpy as np
import pytest
import trimesh
from scenes import DATA

from clsim.errors import InputError
from clsim.scene.room.mesh_files import read_mesh

MESHES = DATA / "meshes"
L_SHAPE = [(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)]  # area 6


def real(name):
    path = MESHES / name
    if not path.exists():
        pytest.skip(f"no real data: {path} is missing")
    return path


def write(tmp_path, text, name="mesh.obj"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def obj(*polygons):
    """One face per polygon, each with vertices of its own."""
    lines, count = [], 0
    for polygon in polygons:
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(polygon, float).tolist()]
        lines.append("f " + " ".join(str(count + i + 1) for i in range(len(polygon))))
        count += len(polygon)
    return "\n".join(lines) + "\n"


def flat(points):
    return np.column_stack([np.asarray(points, float), np.zeros(len(points))])


def turned(points, rng):
    """Return points of the plane z = 0 in a random plane, far from the origin."""
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return flat(points) @ rotation.T + 100.0 * rng.normal(size=3)


def normals(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


def area(mesh):
    return float(np.sum(np.linalg.norm(normals(mesh), axis=1)))


def refused(path, **more):
    with pytest.raises(InputError) as caught:
        read_mesh(path, **more)
    return caught.value


def refused_obj(tmp_path, text):
    path = write(tmp_path, text)
    error = refused(path)
    assert error.field == str(path)
    return error.problem


# Polygons


def comb(teeth):
    """Return a comb of teeth 1 wide and 5 high on a bar 1 high, and its area."""
    top = []
    for i in reversed(range(teeth)):
        top += [(2 * i + 1, 6), (2 * i, 6)] if i == 0 else [(2 * i + 1, 6), (2 * i, 6), (2 * i, 1), (2 * i - 1, 1)]
    return [(0, 0), (2 * teeth - 1, 0), *top], 5 * teeth + 2 * teeth - 1


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize(("shape", "wanted"), [(L_SHAPE, 6), comb(2), comb(9)], ids=["L", "comb 2", "comb 9"])
def test_concave_polygons_keep_their_area_and_their_side(tmp_path, rng, shape, wanted, backwards):
    for first in range(len(shape)):
        points = turned(np.roll(shape[::-1] if backwards else shape, first, axis=0), rng)
        mesh = read_mesh(write(tmp_path, obj(points)))
        assert len(mesh.triangles) == len(shape) - 2
        assert area(mesh) == pytest.approx(wanted, rel=1e-11)
        # No triangle is turned over: the sum of the vectors is as long as the sum of their lengths.
        newell = 0.5 * np.sum(np.cross(points - points[0], np.roll(points, -1, axis=0) - points[0]), axis=0)
        np.testing.assert_allclose(np.sum(normals(mesh), axis=0), newell, rtol=0, atol=1e-10 * wanted)
        assert mesh.notes == ("1 concave polygon was ear-clipped.",)


def test_convex_polygons_are_cut_without_a_note(tmp_path):
    mesh = read_mesh(write(tmp_path, obj(flat([(0, 0), (2, 0), (3, 1), (2, 2), (0, 2)]))))
    assert len(mesh.triangles) == 3
    assert area(mesh) == pytest.approx(5, rel=1e-12)
    assert mesh.notes == ()


def test_corners_on_a_straight_side_are_kept(tmp_path):
    """Else the neighbour that ends there would no longer share its sides."""
    shape = [(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
    mesh = read_mesh(write(tmp_path, obj(flat(shape))))
    assert len(mesh.triangles) == 6
    assert set(mesh.triangles.ravel()) == set(range(8))
    assert area(mesh) == pytest.approx(4, rel=1e-12)


def test_a_hole_on_a_seam(tmp_path):
    """Writers give a polygon with a hole as one ring that runs along a seam twice."""
    ring = [1, 2, 3, 4, 1, 5, 8, 7, 6, 5]
    points = [(0, 0, 0), (3, 0, 0), (3, 3, 0), (0, 3, 0), (1, 1, 0), (2, 1, 0), (2, 2, 0), (1, 2, 0)]
    text = "\n".join(f"v {x} {y} {z}" for x, y, z in points) + "\nf " + " ".join(map(str, ring))
    assert area(read_mesh(write(tmp_path, text))) == pytest.approx(8, rel=1e-12)


def test_polygons_that_are_not_planar_are_cut_with_a_note(tmp_path):
    bent = [(0, 0, 0), (1, 0, 0), (1, 1, 0.1), (0, 1, 0)]
    straight = [(0, 0, 0), (1, 0, 0), (1, 1, 1e-4), (0, 1, 0)]
    mesh = read_mesh(write(tmp_path, obj(bent, straight, bent)))
    assert len(mesh.triangles) == 6
    assert mesh.notes == ("2 polygons were not planar (by more than 0.001 of the size) and cut into triangles.",)


def test_polygons_without_area_are_left_out_with_a_note(tmp_path):
    line = [(0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 3, 3)]
    mesh = read_mesh(write(tmp_path, obj(line, flat(L_SHAPE))))
    assert len(mesh.triangles) == 4
    assert "1 polygon was without an area and left out." in mesh.notes
    assert refused_obj(tmp_path, obj(line)) == "must hold faces with an area, but all 1 have none"


def test_polygons_that_cross_themselves_are_refused(tmp_path):
    good, bow = flat(L_SHAPE), flat([(0, 0), (2, 2), (2, 0), (0, 1)])
    assert refused_obj(tmp_path, obj(good, bow)).startswith("line 12: face 2 must not cross itself: its area is")
    even = flat([(0, 0), (1, 1), (1, 0), (0, 1)])
    assert refused_obj(tmp_path, obj(even)).endswith("face 1 must not cross itself, but the parts of its area cancel")


def test_bedroom():
    """Its polygons' areas are summed here by Stokes, in the file's own lines."""
    path, points, wanted = real("bedroom.obj"), [], 0.0
    for line in path.read_text().splitlines():
        key, *cells = line.split() or [""]
        if key == "v":
            points.append([float(cell) for cell in cells])
        elif key == "f":
            ring = [points[int(cell.split("/")[0]) - 1] for cell in cells]
            pairs = zip(ring, ring[1:] + ring[:1], strict=True)
            wanted += math.hypot(*np.sum([np.cross(a, b) for a, b in pairs], axis=0)) / 2
    mesh = read_mesh(path, up="y")
    assert len(mesh.triangles) == 88
    assert area(mesh) == pytest.approx(wanted, rel=1e-9)
    assert mesh.groups == ("smooth_concrete", "thin_carpet", "plywood_panels", "pile_carpet", "glass_window")
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [4, 6.32, 3.5], rtol=1e-12)
    assert mesh.notes == ("3 concave polygons were ear-clipped.",)
    sides = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert set(np.unique(sides, axis=0, return_counts=True)[1]) == {2}


@pytest.mark.parametrize(("name", "count"), [("basic.obj", 172), ("concert.obj", 322), ("box__box.ply", 12)])
def test_other_real_files(name, count):
    assert len(read_mesh(real(name)).triangles) == count


# OBJ


def test_obj_as_many_programs_write_it(tmp_path):
    text = (
        b"\xef\xbb\xbf# head\r\nmtllib missing file.mtl\r\nv 0 0 0 1.0\r\nv\t1 0 0 0.5 0.5 0.5\r\nv 1 1 0\r\nv 0 1 0\r\n"
        b"vt 0 0\r\nvn 0 0 1\r\ns off\r\nl 1 2\r\nf 1 2 3 # a comment\r\nf 1/1 3/1 4/1\r\nf 1//1 \\\r\n 2//1 3//1\r\n"
        b"f 1/1/1 3/1/1 \\\r\n4/1/1\r\nf -4 -3 -2\r\n"
    )
    mesh = read_mesh(write(tmp_path, text, "MESH.OBJ"))
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert mesh.groups == ("",)
    assert mesh.group.tolist() == [0] * 5
    assert mesh.notes == ()


def test_negative_indices_count_from_where_they_stand(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 5 0 0\nf -1 -2 -3\n"
    assert read_mesh(write(tmp_path, text)).triangles.tolist() == [[0, 1, 2], [3, 2, 1]]


CORNERS = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def test_groups_are_materials(tmp_path):
    text = (
        CORNERS
        + "f 1 2 3\ng wall\nusemtl wood oak#1\nf 1 2 3 4\nusemtl glass # comment\nf 1 2 3\nusemtl wood oak#1\nf 2 3 4\n"
    )
    mesh = read_mesh(write(tmp_path, text))
    assert mesh.groups == ("", "wood oak#1", "glass")
    assert mesh.group.tolist() == [0, 1, 1, 2, 1]


def test_groups_are_parts_where_no_material_is_named(tmp_path):
    mesh = read_mesh(write(tmp_path, CORNERS + "o floor\nf 1 2 3\ng left  wall\nf 2 3 4\ng unused\no floor\nf 1 2 4\n"))
    assert mesh.groups == ("floor", "left wall")
    assert mesh.group.tolist() == [0, 1, 0]


def test_names_in_an_old_code_page(tmp_path):
    mesh = read_mesh(write(tmp_path, (CORNERS + "usemtl Stoff grün\nf 1 2 3\n").encode("latin-1")))
    assert mesh.groups == ("Stoff grün",)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "must hold faces, but has no line that begins with f"),
        (CORNERS, "must hold faces, but has no line that begins with f"),
        (CORNERS + "f 1 2 3\nf 1 2 5\n", "line 6: face 2 must use vertices from 1 to 4, but uses 5"),
        (CORNERS + "f 1 2 0\n", "line 5: face 1 must use vertices from 1 (or -4) on, but uses 0"),
        (CORNERS + "f 1 2 -5\n", "line 5: face 1 must use vertices from 1 (or -4) on, but uses -5"),
        (CORNERS + "f 1 2\n", "line 5: face 1 must have at least 3 corners, but has 2"),
        (CORNERS + "\nf 1 \\\n2\n", "line 6: face 1 must have at least 3 corners, but has 2"),
        (CORNERS + "f 1 2 x/1\n", "line 5: face 1 must have whole numbers as corners, but has 'x/1'"),
        ("v 1 2\n", "line 1: a vertex must be three numbers, but is '1 2'"),
        ("v 1 2 z\n", "line 1: a vertex must be three numbers, but is '1 2 z'"),
        (CORNERS + "v 0 nan 0\nf 1 2 5\n", "line 6: face 1 must have finite corners, but vertex 5 is [ 0. nan  0.]"),
        (CORNERS + "v inf 0 0\nf 1 2 5 4\n", "line 6: face 1 must have finite corners, but vertex 5 is [inf  0.  0.]"),
        (CORNERS + "v inf 0 0\nf 1 2 3\n", "vertices must be finite, but vertex 5 (of no face) is [inf  0.  0.]"),
        ("v 0\0", "must be an OBJ file, which is text, but holds a zero byte"),
    ],
)
def test_broken_obj(tmp_path, text, problem):
    assert refused_obj(tmp_path, text) == problem


# Other formats


@pytest.mark.parametrize("name", ["a.stl", "a.stl_ascii", "a.ply", "a.off", "a.glb", "a.gltf", "a.obj", "A.STL"])
def test_formats_round_trip(tmp_path, name):
    made = trimesh.creation.annulus(r_min=1.0, r_max=2.0, height=0.5, sections=24)
    made.apply_translation([3, -2, 1])
    path = tmp_path / name
    data = made.export(file_type=path.suffix[1:].lower())
    if isinstance(data, dict):  # glTF is several files
        for other, content in data.items():
            (tmp_path / other).write_bytes(content)
        path = next(tmp_path.glob("*.gltf"))
    else:
        write(tmp_path, data, name)
    mesh = read_mesh(path)
    assert len(mesh.triangles) == len(made.faces)
    # The binary formats hold float32.
    assert area(mesh) == pytest.approx(made.area, rel=1e-6)
    np.testing.assert_allclose([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], made.bounds, rtol=1e-6)
    np.testing.assert_allclose(np.sum(normals(mesh), axis=0), 0, atol=1e-5)
    assert mesh.vertices.dtype == np.float64
    assert mesh.triangles.dtype == mesh.group.dtype == np.int64
    assert not mesh.vertices.flags.writeable
    assert not mesh.triangles.flags.writeable
    if path.suffix.lower() in (".stl", ".ply", ".off"):
        assert mesh.groups == ("",)
    assert mesh.notes == ()


def two_boxes(tmp_path, transform, material=None):
    """Return a GLB of a box of sides 1, 2, 3 and one of side 1 that stands transformed."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box([1, 2, 3]), geom_name="room", node_name="room")
    small = trimesh.creation.box([1, 1, 1])
    if material:
        made = trimesh.visual.material.PBRMaterial(name=material)
        small.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=made)
    scene.add_geometry(small, geom_name="desk", node_name="desk", transform=transform)
    return write(tmp_path, scene.export(file_type="glb"), "scene.glb")


def test_geometries_are_joined_where_their_transforms_put_them(tmp_path):
    transform = np.diag([2.0, 2.0, 2.0, 1.0])
    transform[:3, 3] = [10, 0, 0]
    mesh = read_mesh(two_boxes(tmp_path, transform))
    assert mesh.groups == ("room", "desk")
    assert np.bincount(mesh.group).tolist() == [12, 12]
    desk = mesh.vertices[np.unique(mesh.triangles[mesh.group == 1])]
    np.testing.assert_allclose([desk.min(axis=0), desk.max(axis=0)], [[9, -1, -1], [11, 1, 1]])
    assert area(mesh) == pytest.approx(2 * (2 + 3 + 6) + 6 * 4, rel=1e-6)


def test_a_mirror_in_a_transform_leaves_the_outside_outside(tmp_path):
    transform = np.diag([-2.0, 1.0, 1.0, 1.0])
    transform[:3, 3] = [10, 0, 0]
    mesh = read_mesh(two_boxes(tmp_path, transform))
    middle = mesh.vertices[mesh.triangles].mean(axis=1) - np.where(mesh.group == 1, 10, 0)[:, None] * [1, 0, 0]
    assert np.all(np.sum(normals(mesh) * middle, axis=1) > 0)


def test_groups_are_materials_where_a_geometry_has_one(tmp_path):
    assert read_mesh(two_boxes(tmp_path, np.eye(4), material="oak")).groups == ("room", "oak")


def test_parts_without_faces_are_left_out_with_a_note(tmp_path):
    scene = trimesh.Scene([trimesh.creation.box(), trimesh.PointCloud(np.eye(3))])
    mesh = read_mesh(write(tmp_path, scene.export(file_type="glb"), "scene.glb"))
    assert len(mesh.triangles) == 12
    assert mesh.notes == ("1 part without faces (points or lines) left out.",)


# Scale and axes


@pytest.mark.parametrize(("up", "turned"), [("z", [1, 2, 3]), ("y", [1, -3, 2]), ("x", [2, 3, 1])])
def test_up(tmp_path, up, turned):
    mesh = read_mesh(write(tmp_path, "v 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n"), up=up, scale=2.0)
    assert mesh.vertices[0].tolist() == [2 * x for x in turned]
    assert np.linalg.det(mesh.vertices[2:5] / 2) == pytest.approx(1, rel=1e-12)  # right-handed
    assert mesh.vertices[2:5][["x", "y", "z"].index(up)].tolist() == [0, 0, 2]


# Refusals


@pytest.mark.parametrize(
    ("more", "field", "part"),
    [
        ({"scale": 0.0}, "scale", "at least 1e-09"), ({"scale": math.nan}, "scale", "finite"),
        ({"scale": "1"}, "scale", "a number"), ({"up": "w"}, "up", 'one of "x", "y", "z"'),
    ],
)  # fmt: skip
def test_arguments(tmp_path, more, field, part):
    error = refused(write(tmp_path, obj(flat(L_SHAPE))), **more)
    assert error.field == field
    assert part in error.problem


@pytest.mark.parametrize("name", ["none.obj", "none.stl", "nowhere/none.glb", "no\0ne.stl"])
def test_missing_files(tmp_path, name):
    path = f"{tmp_path}/{name}"
    error = refused(path)
    assert error.field == path
    assert error.problem.startswith("cannot be read: ")


def test_folders_and_what_is_no_path_cannot_be_read(tmp_path):
    assert refused(5).field == "path"
    (tmp_path / "a.obj").mkdir()
    assert refused(tmp_path / "a.obj").problem == "cannot be read: Is a directory"


@pytest.mark.parametrize("name", ["a.wav", "a", "a.step", "a.zip", "a.bz2"])
def test_unknown_formats(tmp_path, name):
    problem = refused(write(tmp_path, "hello", name)).problem
    assert problem.startswith("must be of a known format (OBJ, STL, PLY, GLB, GLTF, OFF, 3MF), but ends with")


@pytest.mark.parametrize("name", ["a.stl", "a.ply", "a.off", "a.glb", "a.gltf", "a.dxf"])
@pytest.mark.parametrize("text", [b"", b"hello", bytes(range(256)) * 9], ids=["empty", "text", "bytes"])
def test_files_that_are_no_mesh(tmp_path, name, text):
    path = write(tmp_path, text, name)
    error = refused(path)
    assert error.field == str(path)
    assert error.problem.startswith(("must be a ", "must hold faces"))


def test_points_and_lines_alone_are_refused(tmp_path):
    path = write(tmp_path, trimesh.PointCloud(np.eye(3)).export(file_type="ply"), "a.ply")
    assert refused(path).problem == "must hold faces, but holds only points or lines"
    square = trimesh.load_path(np.array([[0, 0], [1, 0], [1, 1], [0, 0]], float))
    path = write(tmp_path, square.export(file_type="dxf"), "a.dxf")
    assert refused(path).problem == "must hold faces, but holds only points or lines"


PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n{}\n3 0 1 2\n3 {}\n"
)


def test_broken_faces_of_other_formats(tmp_path):
    assert len(read_mesh(write(tmp_path, PLY.format("0 1 0", "0 1 3"), "a.ply")).triangles) == 2
    problem = refused(write(tmp_path, PLY.format("0 1 0", "0 1 4"), "a.ply")).problem
    assert problem == "face 2 must use vertices from 0 to 3, but uses 4"
    problem = refused(write(tmp_path, PLY.format("0 nan 0", "0 1 3"), "a.ply")).problem
    assert problem == "face 2 must have finite corners, but vertex 3 is [ 0. nan  0.]"
    problem = refused(write(tmp_path, PLY.format("0 inf 0", "0 1 2"), "a.ply")).problem
    assert problem == "vertices must be finite, but vertex 3 (of no face) is [ 0. inf  0.]"
