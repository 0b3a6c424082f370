"""Colours of voxels from pictures, against texels counted one by one."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from workbench.errors import InputError
from workbench.formats.surface_files import write_surface_obj, write_surface_ply
from workbench.formats.textured_gltf import write_textured_glb
from workbench.formats.textured_obj import write_textured_obj
from workbench.formats.textured_surface import read_textured_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.surface_texture import SurfaceTexture
from workbench.geometry.textured_mesh import TexturedMesh
from workbench.voxels.voxel_set import VoxelGrid
from workbench.voxels.voxelisation import VoxelisationOptions, voxel_parts, voxelise

GRID = VoxelGrid(np.zeros(3), 1.0, 3)
# A square in the middle of a layer of voxels, cut by its diagonal.
SQUARE = TriangleMesh(
    np.array([[0, 0, 0.55], [1, 0, 0.55], [1, 1, 0.55], [0, 1, 0.55]]) * 0.999 + 0.0005,
    np.array([[0, 1, 2], [0, 2, 3]], np.int32),
)
PLACES = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def linear(encoded: np.ndarray) -> np.ndarray:
    share = encoded / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def encoded(value: np.ndarray) -> np.ndarray:
    return 255 * np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)


def textured(picture: np.ndarray, places: np.ndarray = PLACES) -> SurfaceTexture:
    return SurfaceTexture(places, np.zeros(2, np.int32), (picture,))


def colors_of(texture: SurfaceTexture | None, mesh: TriangleMesh = SQUARE) -> np.ndarray:
    """(8, 8, 3) colours of the layer, rows along y."""
    (part,) = voxel_parts(mesh, GRID, texture=texture)
    image = np.zeros((8, 8, 3), int)
    image[part.cells[:, 1], part.cells[:, 0]] = part.color
    assert len(part) == 64
    return image


def noise(side: int) -> np.ndarray:
    return np.random.default_rng(side).integers(0, 256, (side, side, 3)).astype(np.uint8)


def test_a_texel_for_each_voxel_is_its_colour():
    picture = noise(8).repeat(16, axis=0).repeat(16, axis=1)
    found = colors_of(textured(picture))
    # 1/16 of a voxel's side along each border is mixed with the neighbour.
    assert np.abs(found - picture[8::16, 8::16]).mean() < 6
    smooth = np.zeros((128, 128, 3), np.uint8)
    smooth[...] = np.arange(0, 256, 2)[:, None, None]
    expected = encoded(linear(smooth.astype(float)).reshape(8, 16, 8, 16, 3).mean(axis=(1, 3)))
    assert np.abs(colors_of(textured(smooth)) - expected).max() < 1.5


@pytest.mark.parametrize("side", [64, 128])
def test_many_texels_of_a_voxel_are_averaged_in_linear_light(side):
    picture = noise(side)
    n = side // 8
    expected = encoded(linear(picture.astype(float)).reshape(8, n, 8, n, 3).mean(axis=(1, 3)))
    found = colors_of(textured(picture))
    # Noise of 8-bit texels has a spread of 0.3 in linear light; the middle of each voxel alone
    # would be off by some 60 bytes.
    assert np.abs(found - expected).mean() < 30 / n
    middle = picture[n // 2 :: n, n // 2 :: n]
    assert np.abs(middle - expected).mean() > 50


@pytest.mark.parametrize(("side", "most", "mean"), [(5, 10, 1.5), (24, 3, 0.6), (96, 2, 0.5)])
def test_colours_are_those_of_a_dense_sampling(side, most, mean):
    """Against bilinear samples, 64² a voxel, whether texels are larger than it or smaller."""
    coarse = noise(max(side // 4, 3))
    picture = cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC)
    steps = (np.arange(512) + 0.5) / 512
    columns, rows = np.meshgrid(*2 * [(steps * side - 0.5).astype(np.float32)])
    samples = cv2.remap(
        linear(picture.astype(float)), columns, rows, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    expected = encoded(samples.reshape(8, 64, 8, 64, 3).mean(axis=(1, 3)))
    error = np.abs(colors_of(textured(picture)) - expected)
    # The middle of a piece stands for it while it is smaller than a texel, the more roughly the
    # more texels differ; rounding alone makes up a mean of 0.25.
    assert error.max() < most
    assert error.mean() < mean


def test_the_vertices_alone_would_not_tell():
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[16:48, 16:48] = 255
    texture = textured(picture)
    mesh = SQUARE.with_attributes(color=texture.vertex_colors(SQUARE.triangles))
    assert (colors_of(None, mesh) == 0).all()
    found = colors_of(texture, mesh)
    assert (found[3:5, 3:5] == 255).all()
    assert (found[[0, -1]] == 0).all()


def test_pictures_repeat_outside_and_end_inside():
    picture = np.zeros((4, 4, 3), np.uint8)
    picture[:, :2] = 255
    twice = colors_of(textured(picture, PLACES * [2.0, 1.0] + [1.0, 0.0]))
    assert (twice[:, [0, 4]].astype(int) - twice[:, [3, 7]] > 100).all()
    assert np.abs(twice[:, 1:3] - twice[:, 5:7]).max() <= 1
    once = colors_of(textured(picture))
    assert (once[:, 0] == 255).all()
    assert (once[:, 7] == 0).all()


def test_threads_change_nothing(sphere):
    mesh = sphere(subdivisions=4)
    places = 0.5 + 0.4 * mesh.vertices[:, :2]
    texture = SurfaceTexture(places, np.zeros(len(mesh.triangles), np.int32), (noise(256),))
    grid = VoxelGrid(np.full(3, -1.1), 2.2, 8)
    found = [
        np.concatenate([p.color for p in voxel_parts(mesh, grid, options, texture=texture)])
        for options in (VoxelisationOptions(workers=1), VoxelisationOptions(workers=3))
    ]
    np.testing.assert_array_equal(*found)


def test_colours_of_vertices_are_as_before(sphere):
    """A texture of one colour a triangle says the same as vertices do."""
    mesh = sphere(subdivisions=2)
    grid = VoxelGrid(np.full(3, -1.1), 2.2, 5)
    color = np.full((len(mesh.vertices), 3), [200, 100, 50], np.uint8)
    by_vertices = voxelise(mesh.with_attributes(color=color), grid)
    picture = np.full((3, 3, 3), [200, 100, 50], np.uint8)
    texture = SurfaceTexture(
        np.full((len(mesh.vertices), 2), 0.4), np.zeros(len(mesh.triangles), np.int32), (picture,)
    )
    (by_texture,) = voxel_parts(mesh, grid, texture=texture)
    np.testing.assert_array_equal(by_texture.codes, by_vertices.codes)
    np.testing.assert_array_equal(by_texture.color, by_vertices.color)


def two_pages() -> TexturedMesh:
    """Two squares, one above the other, each on a picture of its own."""
    vertices = np.concatenate([SQUARE.vertices, SQUARE.vertices + np.array([0, 0, 0.3])])
    triangles = np.concatenate([SQUARE.triangles, SQUARE.triangles + 4]).astype(np.int32)
    left, right = np.zeros((2, 16, 16, 3), np.uint8)
    left[:8], right[:, :8] = [255, 0, 0], [0, 0, 255]
    return TexturedMesh(
        TriangleMesh(vertices, triangles),
        np.concatenate([PLACES, PLACES]),
        np.array([0, 0, 1, 1], np.int32),
        (left, right),
    )


@pytest.mark.parametrize("suffix", [".glb", ".obj"])
def test_our_own_textured_files_come_back_with_their_pictures(tmp_path, suffix):
    given = two_pages()
    path = tmp_path / f"textured{suffix}"
    if suffix == ".glb":
        write_textured_glb(path, given, pictures="png")
    else:
        write_textured_obj(path, given)
    mesh, texture = read_textured_surface(path)
    assert texture is not None
    (found,) = voxel_parts(mesh, GRID, texture=texture)
    written = SurfaceTexture(given.texture_places, given.pages, given.pictures)
    (expected,) = voxel_parts(given.mesh, GRID, texture=written)
    order = np.argsort(found.codes)
    np.testing.assert_array_equal(found.codes[order], expected.codes)
    assert np.abs(found.color.astype(int) - expected.color.astype(int)).max() <= 2
    layer = found.cells[:, 2] == 4
    upper = layer & (found.cells[:, 1] < 3)
    assert (found.color[upper] == [255, 0, 0]).all()
    assert set(map(tuple, mesh.vertex_attributes["color"])) == {
        (255, 0, 0), (0, 0, 0), (0, 0, 255)
    }  # fmt: skip


def test_files_without_pictures_have_colours_of_vertices(tmp_path):
    color = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 9, 9]], np.uint8)
    mesh = SQUARE.with_attributes(color=color)
    write_surface_ply(tmp_path / "a.ply", mesh)
    write_surface_obj(tmp_path / "a.obj", mesh)
    for name in ("a.ply", "a.obj"):
        found, texture = read_textured_surface(tmp_path / name)
        assert texture is None
        np.testing.assert_array_equal(found.vertex_attributes["color"], color)


def test_an_obj_whose_picture_is_missing_has_no_texture(tmp_path):
    files = write_textured_obj(tmp_path / "textured.obj", two_pages())
    for file in files:
        if file.suffix == ".png":
            file.unlink()
    mesh, texture = read_textured_surface(tmp_path / "textured.obj")
    assert texture is None
    assert len(mesh.triangles) == 4


def test_broken_textures_are_refused(tmp_path):
    (tmp_path / "a.glb").write_bytes(b"glTF and nothing more")
    with pytest.raises(InputError, match="cannot be read"):
        read_textured_surface(tmp_path / "a.glb")
    with pytest.raises(InputError, match="does not exist"):
        read_textured_surface(tmp_path / "none.gltf")
    with pytest.raises(InputError, match="not finite"):
        textured(noise(4), np.full((4, 2), np.nan))
    with pytest.raises(InputError, match="not there"):
        SurfaceTexture(PLACES, np.full(2, 1, np.int32), (noise(4),))


def test_a_real_textured_mask_is_coloured_by_its_picture(shared_data):
    mesh, texture = read_textured_surface(shared_data("meshes", "bali-mask", "mask.gltf"))
    assert texture is not None
    assert texture.pictures[0].shape == (4096, 4096, 3)
    grid = VoxelGrid(mesh.vertices.min(axis=0) - 1e-4, 0.24, 6)
    (by_texture,) = voxel_parts(mesh, grid, texture=texture)
    (by_vertices,) = voxel_parts(mesh, grid)
    # Vertices are samples of the same picture: alike over the whole, not voxel by voxel.
    ours, theirs = (linear(v.color.astype(float)) for v in (by_texture, by_vertices))
    assert np.abs(ours.mean(axis=0) - theirs.mean(axis=0)).max() < 0.02
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.9
