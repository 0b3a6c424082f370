import zlib

import numpy as np
import pytest

from workbench.errors import InputError, SettingsError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.point_set import PointSet
from workbench.surfels.spacing import Spacing
from workbench.surfels.surfel_bytes import (
    direction_of,
    octahedral,
    surfel_record,
)
from workbench.surfels.surfel_export import export_surfels
from workbench.surfels.surfel_file import (
    SurfelFile,
    SurfelNode,
    SurfelWriter,
    surfel_points,
)
from workbench.surfels.surfel_layout import HEADER, NODE, coarse_counts
from workbench.surfels.surfel_options import SurfelOptions


def directions(n, seed=0):
    found = np.random.default_rng(seed).normal(size=(n, 3))
    return (found / np.linalg.norm(found, axis=1, keepdims=True)).astype(np.float32)


def test_octahedral_normals_come_back():
    normals = np.concatenate([directions(5000), np.eye(3), -np.eye(3)]).astype(np.float32)

    for most, degrees in ((127, 1.0), (32767, 0.005)):
        places = np.rint(octahedral(normals) * most) / most
        assert np.abs(places).max() <= 1.0
        apart = np.linalg.norm(direction_of(places) - normals, axis=1)
        assert np.degrees(apart.max()) < degrees
    np.testing.assert_allclose(direction_of(octahedral(np.eye(3) * -1.0)), -np.eye(3), atol=1e-7)


def written(path, count=700, colored=True, exact=False):
    """A file of one node; what it was made from."""
    random = np.random.default_rng(3)
    points = random.uniform([5e6, -2, 0], [5e6 + 10, 3, 0.1], (count, 3))
    color = random.integers(0, 256, (count, 3), dtype=np.uint8) if colored else None
    coarse = [color[:k] // 2 for k in coarse_counts(count)] if color is not None else []
    surfels = PointSet(points, directions(count), color, None)
    node = SurfelNode(surfels, coarse, Spacing(min(count, 500), 0.25), 0.125, 42)
    with open(path, "wb") as file:
        writer = SurfelWriter(file, colored=colored, exact=exact)
        nodes = np.array([writer.add(node)], NODE)
        writer.close(nodes)
    return node


@pytest.mark.parametrize("colored", [True, False])
@pytest.mark.parametrize("exact", [True, False])
def test_a_file_gives_back_its_surfels(tmp_path, colored, exact):
    given = written(tmp_path / "a.surfels", colored=colored, exact=exact)

    file = SurfelFile(tmp_path / "a.surfels")
    node = file.node(0)

    size = np.ptp(given.surfels.points, axis=0)
    error = np.abs(node.surfels.points - given.surfels.points).max(axis=0)
    # Half a step of 16 bits, or float32 from the corner of the box.
    assert (error <= (size * 2.0**-24 if exact else 0.5 * size / 65535) + 1e-9).all()
    apart = np.linalg.norm(node.surfels.normals - given.surfels.normals, axis=1)
    assert np.degrees(apart.max()) < (0.005 if exact else 1.0)
    assert (node.spacing, node.radius, node.items) == (given.spacing, given.radius, given.items)
    assert file.colored == colored
    if colored:
        np.testing.assert_array_equal(node.surfels.color, given.surfels.color)
        for mine, theirs in zip(node.coarse_colors, given.coarse_colors, strict=True):
            np.testing.assert_array_equal(mine, theirs)
    else:
        assert node.surfels.color is None
    bytes_each = {(0, 0): 8, (0, 1): 12, (1, 0): 16, (1, 1): 20}[exact, colored]
    assert surfel_record(exact, colored).itemsize == bytes_each
    assert file.nodes["bytes"][0] == 700 * bytes_each + colored * 3 * (175 + 44)


def test_a_prefix_has_its_own_radius_and_coarser_colors(tmp_path):
    given = written(tmp_path / "a.surfels")

    whole = surfel_points(tmp_path / "a.surfels")
    for prefix, color in (
        (700, given.surfels.color),
        (176, given.surfels.color),
        (175, given.coarse_colors[0]),
        (10, given.coarse_colors[1]),
    ):
        part = surfel_points(tmp_path / "a.surfels", prefix)
        np.testing.assert_array_equal(part.points, whole.points[:prefix])
        np.testing.assert_array_equal(part.color, color[:prefix])
        np.testing.assert_allclose(part.radius, 0.25 * np.sqrt(500 / prefix), rtol=1e-6)

    for prefix in (0, 701):
        with pytest.raises(SettingsError, match="no such prefix"):
            surfel_points(tmp_path / "a.surfels", prefix)


def test_a_prefix_is_one_range_of_bytes(tmp_path):
    written(tmp_path / "a.surfels")
    file = SurfelFile(tmp_path / "a.surfels")
    data = (tmp_path / "a.surfels").read_bytes()

    offset = int(file.nodes["offset"][0])
    some = np.frombuffer(data[offset : offset + 12 * 50], surfel_record(False, True))

    box, node = file.nodes[0], file.node(0)
    local = some["position"] * (box["size"] / 65535.0)
    np.testing.assert_allclose(box["lower"] + local, node.surfels.points[:50], rtol=1e-15)
    np.testing.assert_array_equal(some["color"], node.surfels.color[:50])


@pytest.fixture(scope="module")
def tree_file(tmp_path_factory, sphere):
    """A small file of several nodes, with colours."""
    path = tmp_path_factory.mktemp("surfels") / "tree.surfels"
    mesh = sphere(1.0, subdivisions=4)
    color = np.rint(127 + 127 * mesh.vertices).astype(np.uint8)
    options = SurfelOptions(count=80, candidates_resolution=24, split_above=1000)
    figures = export_surfels(mesh.with_attributes(color=color), path, options)
    assert figures["levels"] > 1
    return path


def read_all(path):
    file = SurfelFile(path)
    for row in range(len(file.nodes)):
        file.node(row)
        list(file.children(row))
        file.spacing(row).prefix_for(0.1)
    surfel_points(path)


def test_every_cut_is_refused(tmp_path, tree_file):
    data = tree_file.read_bytes()
    read_all(tree_file)
    for length in [*range(400), *range(400, len(data), 97), len(data) - 1]:
        (tmp_path / "cut.surfels").write_bytes(data[:length])
        with pytest.raises(InputError, match=r"cut\.surfels"):
            read_all(tmp_path / "cut.surfels")


def test_every_flipped_byte_is_refused(tmp_path, tree_file):
    data = tree_file.read_bytes()
    random = np.random.default_rng(5)
    places = np.concatenate(
        [np.arange(HEADER.itemsize), random.integers(HEADER.itemsize, len(data), 400)]
    )
    for place in places:
        broken = bytearray(data)
        broken[place] ^= int(random.integers(1, 256))
        (tmp_path / "flip.surfels").write_bytes(broken)
        with pytest.raises(InputError):
            read_all(tmp_path / "flip.surfels")


def test_lies_with_right_checksums_are_refused(tmp_path, tree_file):
    data = tree_file.read_bytes()
    start = int(np.frombuffer(data, HEADER, 1)["index_offset"][0])
    random = np.random.default_rng(6)
    refused = 0
    for _ in range(600):
        index = np.frombuffer(data[start:], NODE).copy()
        name = NODE.names[random.integers(len(NODE.names))]
        field = index[name].reshape(len(index), -1)
        place = (random.integers(len(index)), random.integers(field.shape[1]))
        if field.dtype.kind == "f":
            field[place] = random.choice([np.nan, np.inf, -1e300, 1e300])
        else:
            field[place] = random.integers(np.iinfo(field.dtype).max, dtype=np.uint64)
        index[name] = field.reshape(index[name].shape)
        header = np.frombuffer(data, HEADER, 1).copy()
        header["index_crc"] = zlib.crc32(index.tobytes())
        header["header_crc"] = zlib.crc32(header.tobytes()[:-4])
        lie = header.tobytes() + data[HEADER.itemsize : start] + index.tobytes()
        (tmp_path / "lie.surfels").write_bytes(lie)
        try:
            read_all(tmp_path / "lie.surfels")
        except InputError:
            refused += 1
    # What is left are numbers that could be true, such as another spacing.
    assert refused > 250


def test_other_files_are_refused_plainly(tmp_path):
    (tmp_path / "a.surfels").write_bytes(b"ply\nformat ascii 1.0\n" * 10)
    with pytest.raises(InputError, match="no surfels"):
        SurfelFile(tmp_path / "a.surfels")
    with pytest.raises(InputError, match="cannot be read"):
        SurfelFile(tmp_path / "missing.surfels")
    written(tmp_path / "b.surfels")
    data = bytearray((tmp_path / "b.surfels").read_bytes())
    data[8] = 9
    header = np.frombuffer(bytes(data[: HEADER.itemsize]), HEADER).copy()
    header["header_crc"] = zlib.crc32(header.tobytes()[:-4])
    (tmp_path / "b.surfels").write_bytes(header.tobytes() + data[HEADER.itemsize :])
    with pytest.raises(InputError, match="another version"):
        SurfelFile(tmp_path / "b.surfels")


def test_a_node_must_have_what_the_file_has(tmp_path):
    bare = SurfelNode(
        PointSet(np.zeros((100, 3)), directions(100), None, None), [], Spacing(1, 1.0), 1.0, 1
    )
    with open(tmp_path / "a", "wb") as file, pytest.raises(ValueError, match="colours"):
        SurfelWriter(file, colored=True, exact=False).add(bare)


def test_a_failed_export_leaves_the_old_file(tmp_path):
    (tmp_path / "a.surfels").write_bytes(b"old")
    nothing = TriangleMesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))
    with pytest.raises(InputError):
        export_surfels(nothing, tmp_path / "a.surfels")
    assert [path.name for path in tmp_path.iterdir()] == ["a.surfels"]
    assert (tmp_path / "a.surfels").read_bytes() == b"old"
