"""The depth meshes of a project and their photographs, as the stitching renderer draws them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.labelled_mesh import LabelledMesh
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.pipeline.photo_surface import told_camera
from workbench.pipeline.stage import Products

_LARGEST = np.float32(1e6)


@dataclass(frozen=True)
class DepthScene:
    """Labelled depth meshes and their photographs, by one numbering.

    Attributes
    ----------
    names : of the photographs.
    cameras : of their texture pictures' sizes.
    meshes : of the photographs that have one, in the same order.
    """

    products: Products
    names: tuple[str, ...]
    cameras: tuple[PhotoCamera, ...]
    meshes: tuple[LabelledMesh, ...]

    def picture(self, number: int) -> NDArray[np.uint8]:
        """The texture picture (h, w, 4) of a photograph."""
        return np.asarray(self.products.load("texture_photos", self.names[number]))

    @property
    def foreground(self) -> int:
        """Triangles of all meshes that their own photographs texture."""
        return sum(int(mesh.foreground.sum()) for mesh in self.meshes)


def depth_scene(products: Products, colored: TriangleMesh) -> DepthScene:
    """What the stage ``texture`` left of its depth meshes.

    Parameters
    ----------
    colored : the model with the attribute ``color`` (n, 3) uint8, seen where no photograph is.
    """
    from workbench.texturing.depth_map import DepthMap
    from workbench.texturing.multi_mesh import labelled_again

    told, poses = products.load("texturing"), products.load("photo_poses")["photos"]
    names = tuple(told["photographs"])
    cameras = tuple(told_camera(poses[name], told["image_px"]) for name in names)
    meshes = []
    for name, camera in zip(names, cameras, strict=True):
        stored = products.load("depth_meshes", name)
        own = [str(other) for other in stored["photos"]]
        depth_map = DepthMap.from_arrays(camera, products.load("depth_maps", name))
        mesh = labelled_again(own.index(name), depth_map, stored)
        meshes.append(_completed(_numbered(mesh, own, names), colored))
    return DepthScene(products, names, cameras, tuple(meshes))


def _numbered(mesh: LabelledMesh, own: list[str], names: tuple[str, ...]) -> LabelledMesh:
    """The mesh with labels that count through ``names`` instead of ``own``."""
    number = {name: k for k, name in enumerate(names)}
    table = np.array([number[name] for name in own] + [-1], np.int32)
    # What no photograph shows loses against whatever one does.
    penalties = np.minimum(mesh.penalties, _LARGEST)
    return replace(mesh, labels=table[mesh.labels], penalties=penalties)


def _completed(labelled: LabelledMesh, colored: TriangleMesh) -> LabelledMesh:
    """The mesh with the model's own colours at vertices that no photograph shows."""
    from scipy.spatial import cKDTree

    mesh = labelled.mesh
    shown = np.zeros(len(mesh.vertices), bool)
    shown[mesh.triangles[labelled.labels >= 0]] = True
    if shown.all() or not len(colored.vertices):
        return labelled
    own = np.array(mesh.vertex_attributes["color"])
    nearest = cKDTree(colored.vertices).query(mesh.vertices[~shown])[1]
    own[~shown] = colored.vertex_attributes["color"][nearest]
    return replace(labelled, mesh=mesh.with_attributes(color=own))
