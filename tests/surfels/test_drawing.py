import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.gltf import srgb_from_linear
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.point_set import PointSet
from workbench.geometry.surface_rays import SurfaceRays
from workbench.kernels.surfel_discs import NO_DISC, draw_discs, draw_discs_parallel
from workbench.surfels.candidates import surface_candidates
from workbench.surfels.drawing import (
    disc_picture,
    disc_view,
    lit,
    pixel_size,
    surfel_radius,
)
from workbench.surfels.node_surfels import Candidates, chosen_surfels
from workbench.surfels.painted_surface import PaintedSurface
from workbench.surfels.surfel_file import SurfelNode
from workbench.surfels.surfel_options import SurfelOptions
from workbench.verification.image_quality import ssim

LENS = (100.0, 120.0, 40.0, 30.0)


def plain_discs(centers, normals, radii, lens, height, width):
    """Every disc against every pixel."""
    fx, fy, cx, cy = lens
    x = (np.arange(width) + 0.5 - cx) / fx
    y = (np.arange(height) + 0.5 - cy) / fy
    rays = np.stack([*np.meshgrid(x, y), np.ones((height, width))], axis=-1)
    depth, number = np.full((height, width), np.inf), np.full((height, width), NO_DISC)
    for i, (center, normal, radius) in enumerate(zip(centers, normals, radii, strict=True)):
        with np.errstate(divide="ignore"):
            t = (center @ normal) / (rays @ normal)
        met = np.linalg.norm(rays * t[..., None] - center, axis=-1) <= radius
        nearer = met & (t > 0) & (t < depth)
        depth[nearer], number[nearer] = t[nearer], i
    return depth, number


def drawn(centers, normals, radii, lens=LENS, height=60, width=80):
    depth = np.full((height, width), np.inf)
    number = np.full((height, width), NO_DISC, np.int32)
    draw_discs(centers, normals, radii, lens, 0, depth, number)
    return depth, number


def test_discs_are_drawn_as_the_definition_says():
    random = np.random.default_rng(0)
    centers = random.normal(size=(300, 3)) * [1, 1, 2] + [0, 0, 2.5]
    normals = random.normal(size=(300, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    radii = random.uniform(0.02, 0.4, 300)

    depth, number = drawn(centers, normals, radii)

    expected_depth, expected = plain_discs(centers, normals, radii, LENS, 60, 80)
    np.testing.assert_array_equal(number, expected)
    np.testing.assert_allclose(depth, expected_depth, rtol=1e-12)
    assert (number != NO_DISC).mean() > 0.5
    assert (centers[:, 2] < radii).any()


def test_parallel_rays_see_what_a_far_camera_sees():
    random = np.random.default_rng(1)
    centers = random.uniform(0, 1, (200, 3))
    normals = random.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    radii = np.full(200, 0.05)
    depth, number = np.full((64, 64), np.inf), np.full((64, 64), NO_DISC, np.int32)

    draw_discs_parallel(centers, normals, radii, 1 / 64, depth, number)

    away = 1e7
    far = (64 * away, 64 * away, 0.0, 0.0)
    _, expected = plain_discs(centers + np.array([0, 0, away]), normals, radii, far, 64, 64)
    assert (number != expected).mean() < 1e-3
    assert (number != NO_DISC).mean() > 0.5


def test_a_tilted_disc_covers_the_area_of_its_ellipse():
    tilt = np.radians(60)
    normal = np.array([[np.sin(tilt), 0, np.cos(tilt)]])

    _, number = drawn(
        np.array([[0, 0, 100.0]]), normal, np.array([2.0]), (1000, 1000, 40, 30), 60, 80
    )

    assert (number == 0).sum() == pytest.approx(np.pi * 20**2 * np.cos(tilt), rel=0.02)


def camera_at(middle, size, distance, px=160, azimuth=0.6, elevation=0.3) -> PhotoCamera:
    """A camera that sees a ball of diameter ``size`` from ``distance`` radii; y is up."""
    back = np.array(
        [
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ]
    )
    right = np.cross([0, 1, 0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, -np.cross(back, right), -back])
    pose[:3, 3] = -pose[:3, :3] @ (middle + 0.5 * size * distance * back)
    focal = 0.475 * px * np.sqrt(distance**2 - 1)
    return PhotoCamera("PINHOLE", px, px, (focal, focal, px / 2, px / 2), pose)


def surfels_of(mesh: TriangleMesh, count: int, resolution: int) -> SurfelNode:
    surface = PaintedSurface.of(mesh)
    points, gap = surface_candidates(surface, resolution, views=14)
    size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    candidates = Candidates(points, gap, len(mesh.triangles), 0.1 * size)
    return chosen_surfels(candidates, SurfelOptions(count=count), 0)


def bounds_of(mesh):
    return np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])


def camera_for(mesh, node, prefix, size_px, distance=3.0) -> PhotoCamera:
    """The camera before which p(r) is the prefix for surfels of that size."""
    bounds = bounds_of(mesh)
    size = float(np.linalg.norm(bounds[1] - bounds[0]))
    trial = camera_at(bounds.mean(axis=0), size, distance, 1000)
    now = surfel_radius(bounds, trial, size_px)
    px = int(1000 * now / node.spacing.radius_for(prefix))
    return camera_at(bounds.mean(axis=0), size, distance, px)


def holes(mesh: TriangleMesh, node: SurfelNode, camera: PhotoCamera, size_px: float):
    """Pixels well inside the object that no disc covers, or through which its back shows."""
    radius = surfel_radius(bounds_of(mesh), camera, size_px)
    prefix = min(node.spacing.prefix_for(radius), len(node.surfels))
    radius = max(radius, node.spacing.radius_for(prefix))
    view = disc_view(node.surfels.chosen(slice(0, prefix)), radius, camera)
    depth, found = ray_depth(mesh, camera)
    window = np.ones((3, 3), np.uint8)
    inner = cv2.erode(found.astype(np.uint8), window, borderValue=0).astype(bool)
    step = cv2.dilate(np.where(found, depth, -1e9), window)
    step -= cv2.erode(np.where(found, depth, 1e9), window)
    through = inner & view.covered & (step < 4 * radius)
    through[through] &= view.depth[through] - depth[through] > 4 * radius
    return int((inner & ~view.covered).sum()), int(through.sum()), int(inner.sum())


def ray_depth(mesh, camera) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    seen = SurfaceRays(mesh).seen_by(camera)
    depth = (seen.points - camera.center) @ camera.camera_from_world[2, :3]
    shape = (camera.height, camera.width)
    return depth.reshape(shape), seen.found.reshape(shape)


def mesh_picture(mesh: TriangleMesh, camera: PhotoCamera) -> NDArray[np.uint8]:
    """The mesh itself, ray cast and lit alike."""
    surface = PaintedSurface.of(mesh)
    seen = SurfaceRays(mesh).seen_by(camera)
    found = seen.found
    corners = mesh.vertices[mesh.triangles[seen.triangles[found]]]
    sides = corners[:, 1:] - corners[:, :1]
    gram = np.einsum("nik,njk->nij", sides, sides)
    right = np.einsum("nik,nk->ni", sides, seen.points[found] - corners[:, 0])
    share = np.linalg.solve(
        gram + 1e-12 * np.trace(gram, axis1=1, axis2=2).max() * np.eye(2), right[..., None]
    )[..., 0]
    weights = np.clip(np.column_stack([1 - share.sum(axis=1), share]), 0, 1)
    weights /= weights.sum(axis=1, keepdims=True)
    normals = np.einsum("ij,ijk->ik", weights, surface.corner_normals[seen.triangles[found]])
    normals *= np.sign(np.einsum("ij,ij->i", normals, seen.normals[found]))[:, None]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    color = surface.colors_at(seen.triangles[found], weights)
    if color is None:
        color = np.broadcast_to(np.array([206, 200, 190], np.uint8), (len(normals), 3))
    image = np.full((camera.height * camera.width, 3), 255, np.uint8)
    image[found] = srgb_from_linear(lit(color, normals, camera))
    return image.reshape(camera.height, camera.width, 3)


@pytest.fixture(scope="module")
def dented_ball(sphere):
    mesh = sphere(1.0, subdivisions=5)
    x, y, z = mesh.vertices.T
    dents = 1 + 0.15 * np.sin(6 * x) * np.cos(5 * y) * np.sin(4 * z + 1)
    stripes = np.where(np.sin(9 * x + 4 * z) > 0, 220, 90)
    color = np.stack([stripes, 255 - stripes, np.full_like(stripes, 120)], axis=1)
    dented = TriangleMesh(mesh.vertices * dents[:, None], mesh.triangles)
    return dented.with_attributes(color=color.astype(np.uint8))


@pytest.fixture(scope="module")
def ball_surfels(dented_ball):
    return surfels_of(dented_ball, 10_000, 256)


@pytest.mark.parametrize("distance", [1.5, 3.0, 6.0, 20.0])
def test_a_prefix_for_its_radius_has_no_holes(dented_ball, ball_surfels, distance):
    for share in (1.0, 0.2):
        prefix = int(share * len(ball_surfels.surfels))
        camera = camera_for(dented_ball, ball_surfels, prefix, 4.0, distance)

        missing, through, inside = holes(dented_ball, ball_surfels, camera, 4.0)

        assert inside > 100
        assert (missing, through) == (0, 0)


def test_a_shorter_prefix_has_holes(dented_ball, ball_surfels):
    camera = camera_for(dented_ball, ball_surfels, 8000, 2.0)
    radius = surfel_radius(bounds_of(dented_ball), camera, 2.0)
    _, found = ray_depth(dented_ball, camera)

    view = disc_view(ball_surfels.surfels.chosen(slice(0, 800)), radius, camera)

    assert (found & ~view.covered).sum() > 0.2 * found.sum()


def test_at_the_intended_size_surfels_look_like_the_mesh(dented_ball, ball_surfels):
    count = len(ball_surfels.surfels)
    camera = camera_for(dented_ball, ball_surfels, count, 2.0)
    radius = ball_surfels.spacing.radius_for(count)

    picture = disc_picture(ball_surfels.surfels, radius, camera)
    plain = disc_picture(ball_surfels.surfels, radius, camera, blended=False)

    truth = mesh_picture(dented_ball, camera) / 255
    everywhere = np.ones(truth.shape[:2], bool)
    alike = ssim(picture[..., :3] / 255, truth, everywhere)
    assert alike > 0.95
    assert ssim(plain[..., :3] / 255, truth, everywhere) < alike
    assert (picture[..., 3] > 0).sum() == pytest.approx((truth < 1).any(axis=2).sum(), rel=0.06)


REAL = [
    ("stanford-bunny", "reference", "bun_zipper.ply"),
    ("meshes", "igea.ply"),
    ("meshes", "nefertiti.obj"),
    ("meshes", "laurana.ply"),
    ("meshes", "gargoyle.ply"),
]


def test_a_real_mesh_has_no_holes_and_looks_like_itself(shared_data):
    mesh = read_surface(shared_data("meshes", "gargoyle.ply"))
    node = surfels_of(mesh, 10_000, 256)

    for distance in (1.5, 3.0, 6.0, 20.0):
        camera = camera_for(mesh, node, 10_000, 3.0, distance)
        missing, through, inside = holes(mesh, node, camera, 3.0)
        assert inside > 500
        assert (missing, through) == (0, 0)

    camera = camera_for(mesh, node, 10_000, 2.0)
    picture = disc_picture(node.surfels, node.spacing.radius_for(10_000), camera)
    truth = mesh_picture(mesh, camera) / 255
    assert ssim(picture[..., :3] / 255, truth, np.ones(truth.shape[:2], bool)) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("parts", REAL, ids=lambda parts: parts[-1])
def test_real_meshes_have_no_holes_and_look_like_themselves(shared_data, parts):
    mesh = read_surface(shared_data(*parts))
    node = surfels_of(mesh, 100_000, 1024)

    for distance in (1.5, 3.0, 6.0, 20.0):
        camera = camera_for(mesh, node, 100_000, 2.0, distance)
        missing, through, inside = holes(mesh, node, camera, 2.0)
        assert missing == 0
        # The deepest hollows show themselves to no corner, face or edge of the bounds.
        assert through <= 2e-4 * inside

    camera = camera_for(mesh, node, 100_000, 2.0)
    picture = disc_picture(node.surfels, node.spacing.radius_for(100_000), camera)
    truth = mesh_picture(mesh, camera) / 255
    assert ssim(picture[..., :3] / 255, truth, np.ones(truth.shape[:2], bool)) > 0.95


def test_the_nearest_disc_wins_and_blending_mixes_what_lies_on_it_alone():
    points = PointSet(
        np.array([[0, 0, 10.0], [0.1, 0, 10.0], [0, 0, 20.0]]),
        np.tile(np.array([0, 0, -1], np.float32), (3, 1)),
        np.array([[255, 0, 0], [0, 0, 255], [0, 255, 0]], np.uint8),
        None,
    )
    camera = PhotoCamera("SIMPLE_PINHOLE", 40, 40, (100.0, 20.0, 20.0), np.eye(4))

    view = disc_view(points, np.array([1.0, 1.0, 3.0]), camera)
    mixed = disc_picture(points, 1.0, camera)

    assert view.number[20, 20] == 0
    assert view.depth[20, 20] == pytest.approx(10)
    assert view.number[20, 34] == 2
    red, green, blue, alpha = mixed[20, 20].astype(int)
    assert min(red, blue) > 60
    assert green == 0
    assert alpha == 255
    assert mixed[0, 0, 3] == 0


def test_a_pixel_is_measured_where_a_box_is_nearest():
    bounds = np.array([[-1, -1, 4.0], [1, 1, 6.0]])
    camera = PhotoCamera("PINHOLE", 100, 80, (200.0, 200.0, 50.0, 40.0), np.eye(4))

    assert pixel_size(bounds, camera) == pytest.approx(4 / 200)
    assert surfel_radius(bounds, camera, 3.0) == pytest.approx(1.5 * 4 / 200)
    assert pixel_size(np.array([[-1, -1, -1.0], [1, 1, 1]]), camera) == 0.0


def test_what_cannot_be_drawn_is_refused():
    points = PointSet(np.zeros((2, 3)), None, None, None)
    camera = PhotoCamera("PINHOLE", 8, 8, (8.0, 8.0, 4.0, 4.0), np.eye(4))
    with pytest.raises(InputError, match="without normals"):
        disc_view(points, 1.0, camera)
    radial = PhotoCamera("SIMPLE_RADIAL", 8, 8, (8.0, 4.0, 4.0, 0.1), np.eye(4))
    with pytest.raises(InputError, match="pinhole"):
        pixel_size(np.zeros((2, 3)), radial)
