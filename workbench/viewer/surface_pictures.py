"""Pictures of surfaces by rays, lit as the page lights them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.formats.gltf import encoded_from_linear
from workbench.geometry.mesh import TriangleMesh, vertex_normals
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.surface_texture import SurfaceTexture
from workbench.kernels.barycentric import shares_of_corners
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE
from workbench.viewer.page_light import PLAIN, Light, lit

# Rays along each side of a pixel.
_SIDE = 2
_ROWS_AT_ONCE = 128
# Surfaces that are seen flatter than that take no coarser texels than these.
_FLATTEST = 1.0 / 16.0


def surface_picture(
    mesh: TriangleMesh,
    texture: SurfaceTexture | None,
    camera: PhotoCamera,
    light: Light = "camera",
) -> NDArray[np.uint8]:
    """What a camera sees of a surface, (h, w, 4) uint8 sRGB; alpha is the share it covers.

    Parameters
    ----------
    mesh
        In any frame; its attributes ``color`` (uint8 sRGB) and ``normal`` are used where they
        are there.
    texture
        Goes before ``color``.
    camera
        In the frame of the mesh.
    light
        See `page_light.lit`.
    """
    shading = _Shading(mesh, texture, camera, light)
    picture = np.zeros((camera.height, camera.width, 4), np.uint8)
    columns = (np.arange(_SIDE * camera.width) + 0.5) / _SIDE
    for top in range(0, camera.height, _ROWS_AT_ONCE):
        last = min(top + _ROWS_AT_ONCE, camera.height)
        rows = top + (np.arange(_SIDE * (last - top)) + 0.5) / _SIDE
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        linear, met = shading.at(camera.directions(pixels))
        values = np.concatenate([encoded_from_linear(linear) * met[:, None], met[:, None]], axis=1)
        sums = values.reshape(last - top, _SIDE, camera.width, _SIDE, 4).sum(axis=(1, 3))
        colors = sums[..., :3] / np.maximum(sums[..., 3:], 1.0)
        picture[top:last, :, :3] = np.rint(255.0 * colors)
        picture[top:last, :, 3] = np.rint(255.0 * sums[..., 3] / _SIDE**2)
    return picture


class _Shading:
    """A surface made ready for rays."""

    def __init__(
        self, mesh: TriangleMesh, texture: SurfaceTexture | None, camera: PhotoCamera, light: Light
    ) -> None:
        self.mesh, self.light, self.eye = mesh, light, camera.center
        self.rays = SurfaceRays(mesh)
        self.local = mesh.vertices - self.rays.middle
        self.texels = None if texture is None else _Texels(self.local, mesh, texture)
        self.pixel = 1.0 / camera.params[0]
        own = mesh.vertex_attributes.get("normal")
        self.normals = vertex_normals(mesh) if own is None else np.asarray(own, np.float64)

    def at(self, directions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Linear light (n, 3) that rays (n, 3) bring, and whether they meet anything (n,)."""
        places = self.rays.first_met(self.eye, directions)
        met = places.found
        light = np.zeros(directions.shape)
        if not met.any():
            return light, met
        triangles, ways = places.triangles[met], directions[met]
        corners = self.mesh.triangles[triangles]
        shares = shares_of_corners(places.points[met] - self.rays.middle, self.local, corners)
        normals = (self.normals[corners] * shares[..., None]).sum(axis=1)
        # The side of the triangle decides which side of the normal is seen.
        behind = (places.normals[met] * ways).sum(axis=1) > 0.0
        normals[behind] *= -1.0
        away = (normals * ways).sum(axis=1) > 0.0
        normals[away] -= (normals[away] * ways[away]).sum(axis=1)[:, None] * ways[away]
        distance = np.linalg.norm(places.points[met] - self.eye, axis=1)
        slant = np.abs((places.normals[met] * ways).sum(axis=1))
        albedo = self._albedo(triangles, corners, shares, self.pixel * distance, slant)
        light[met] = lit(albedo, normals, ways, self.light)
        return light, met

    def _albedo(
        self,
        triangles: NDArray[np.int64],
        corners: NDArray[np.int32],
        shares: NDArray[np.float64],
        footprint: NDArray[np.float64],
        slant: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        if self.texels is not None:
            return self.texels.at(
                triangles, corners, shares, footprint / np.maximum(slant, _FLATTEST)
            )
        colors = self.mesh.vertex_attributes.get("color")
        if colors is None:
            return np.full((len(corners), 3), PLAIN)
        return np.asarray((LINEAR_OF_BYTE[colors[corners]] * shares[..., None]).sum(axis=1))


class _Texels:
    """The pictures of a texture, each in ever coarser copies of half the size."""

    def __init__(
        self, vertices: NDArray[np.float64], mesh: TriangleMesh, texture: SurfaceTexture
    ) -> None:
        self.texture = texture
        self.copies = [_halved(LINEAR_OF_BYTE[picture]) for picture in texture.pictures]
        corners = mesh.triangles
        sizes = np.array([picture.shape[1::-1] for picture in texture.pictures], float)
        flat = texture.places[corners] * sizes[texture.pages][:, None]
        sides = [(values[:, 1] - values[:, 0], values[:, 2] - values[:, 0])
                 for values in (vertices[corners], flat)]  # fmt: skip
        area = np.linalg.norm(np.cross(*sides[0]), axis=1)
        (u, v) = sides[1]
        texels = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        self.per_length = np.sqrt(texels / np.maximum(area, 1e-300))

    def at(
        self,
        triangles: NDArray[np.int64],
        corners: NDArray[np.int32],
        shares: NDArray[np.float64],
        footprint: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Linear colours (n, 3) of places whose pixels cover lengths ``footprint`` (n,)."""
        places = (self.texture.places[corners] * shares[..., None]).sum(axis=1)
        level = np.log2(np.maximum(self.per_length[triangles] * footprint, 1.0))
        colors = np.empty((len(places), 3))
        for page in np.unique(self.texture.pages[triangles]):
            on = np.flatnonzero(self.texture.pages[triangles] == page)
            copies = self.copies[page]
            between = np.minimum(level[on], len(copies) - 1.0)
            finer = between.astype(np.int64)
            for number in np.unique(finer):
                chosen = on[finer == number]
                share = (between[finer == number] - number)[:, None]
                coarser = copies[min(number + 1, len(copies) - 1)]
                colors[chosen] = (1.0 - share) * _bilinear(copies[number], places[chosen])
                colors[chosen] += share * _bilinear(coarser, places[chosen])
        return colors


def _halved(picture: NDArray[np.float64]) -> list[NDArray[np.float32]]:
    copies = [picture.astype(np.float32)]
    while max(copies[-1].shape[:2]) > 1:
        size = tuple(max(1, side // 2) for side in copies[-1].shape[1::-1])
        copies.append(np.asarray(cv2.resize(copies[-1], size, interpolation=cv2.INTER_AREA)))
    return copies


def _bilinear(picture: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours (n, 3) at places (n, 2) as shares of the sides; the border goes on outside."""
    size = np.array(picture.shape[1::-1])
    place = np.clip(places * size - 0.5, 0.0, size - 1.0)
    low = np.minimum(place.astype(np.int64), size - 1)
    high = np.minimum(low + 1, size - 1)
    x, y = (place - low).T[..., None]
    upper = (1.0 - x) * picture[low[:, 1], low[:, 0]] + x * picture[low[:, 1], high[:, 0]]
    lower = (1.0 - x) * picture[high[:, 1], low[:, 0]] + x * picture[high[:, 1], high[:, 0]]
    return np.asarray((1.0 - y) * upper + y * lower)
