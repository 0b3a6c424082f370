"""A skull photographed from all round, its flash as it was: depth meshes of real data."""

import cv2
import numpy as np
import pytest

from workbench.formats.colmap import read_colmap_text
from workbench.formats.surface_files import read_surface
from workbench.geometry.surface_rays import SurfaceRays
from workbench.texturing.cost_options import CostOptions, far_of_scene
from workbench.texturing.depth_map import depth_map_of_surface, small_camera, usable_pixels
from workbench.texturing.depth_mesh import depth_mesh
from workbench.texturing.multi_mesh import labelled_depth_mesh, which_see


@pytest.mark.slow
def test_a_painted_skull(shared_data):
    folder = shared_data("skull-flash")
    rays = SurfaceRays(read_surface(folder / "geometry.ply"))
    cameras = read_colmap_text(folder / "cameras").photo_cameras()
    names = sorted(cameras)[::4]
    pictures, maps = {}, {}
    for number, name in enumerate(names):
        image = cv2.imread(str(folder / "photos" / f"{name}.jpg"))[..., ::-1]
        pictures[number] = np.dstack([image, np.full(image.shape[:2], 255, np.uint8)])
        small = small_camera(cameras[name], 128)
        usable = usable_pixels(pictures[number][..., 3], small)
        maps[number] = depth_map_of_surface(rays, small, usable, closed=True)
    numbered = dict(enumerate(cameras[name] for name in names))
    options = CostOptions(far_of_scene(maps.values()))
    seen_by = which_see(maps)
    foreground, triangles = 0, 0
    for number in list(maps)[::3]:
        few = {k: maps[k] for k in seen_by[number]}
        made = labelled_depth_mesh(
            number, few, numbered, pictures.__getitem__, options, 10, bound_sweeps=10
        )
        labelling, labelled = made.labelling, made.labelled
        # The flash changes from photograph to photograph: seams are what costs, and most of them
        # are moved away; the labels found are proven to be near the best.
        assert labelling.converged
        assert labelling.energy.smoothness < 0.35 * labelling.before.smoothness
        assert labelling.energy.total < labelling.before.total
        assert labelling.gap < 0.1
        assert (labelled.labels >= 0).mean() > 0.99
        assert not labelled.foreground[depth_mesh(maps[number]).outer].any()
        middles = labelled.mesh.vertices[labelled.mesh.triangles].mean(axis=1)
        away = np.linalg.norm(rays.nearest(middles).points - middles, axis=1)
        assert np.quantile(away, 0.99) < 0.01
        foreground += int(labelled.foreground.sum())
        triangles += len(labelled.labels)
    assert 0.05 < foreground / triangles < 0.8
