"""A mesh with fewer triangles, by quadric error metrics (Garland and Heckbert 1997; Open3D's)."""

from __future__ import annotations

import numpy as np

from workbench.geometry.mesh import TriangleMesh


def simplified(mesh: TriangleMesh, triangles: int) -> TriangleMesh:
    """At most so many triangles, as near to the mesh as they can be.

    Parameters
    ----------
    mesh : its attribute ``color`` (n, 3) uint8 goes along; others do not.
    triangles : a mesh that has no more is returned as it is.
    """
    if len(mesh.triangles) <= triangles:
        return mesh
    import open3d as o3d

    # About its own middle: coordinates of a survey would leave no digits for the quadrics.
    middle = mesh.vertices.mean(axis=0)
    whole = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices - middle),
        o3d.utility.Vector3iVector(mesh.triangles),
    )
    color = mesh.vertex_attributes.get("color")
    if color is not None:
        whole.vertex_colors = o3d.utility.Vector3dVector(color / 255.0)
    fewer = whole.simplify_quadric_decimation(triangles)
    attributes = {}
    if color is not None:
        attributes["color"] = np.round(255.0 * np.asarray(fewer.vertex_colors)).astype(np.uint8)
    return TriangleMesh(
        np.asarray(fewer.vertices) + middle,
        np.asarray(fewer.triangles).astype(np.int32),
        attributes,
    )
