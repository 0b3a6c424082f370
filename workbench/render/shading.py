"""Pictures of meshes: lit, in their colours, by category, by value.

Every function returns sRGB-encoded (height, width, 3) uint8. Shading happens in linear
light at 2 × 2 samples per pixel.
"""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from workbench.geometry.mesh import TriangleMesh
from workbench.render import palette
from workbench.render.camera import Camera
from workbench.render.palette import ColorScale
from workbench.render.raycast import (
    RayScene,
    RenderBuffers,
    open_sky,
    ray_directions,
    render_buffers,
)

_SUPERSAMPLING = 2
# Surfaces fold more sharply than this (degrees) at edges that should look like edges.
_CREASE_DEG = 40.0
# From over the left shoulder, as drawings of finds are lit by convention.
_KEY_LIGHT_IN_CAMERA = np.array([-0.55, -0.62, -0.56], np.float32)
_HEADLIGHT_IN_CAMERA = np.array([0.0, 0.0, -1.0], np.float32)
_KEY, _HEAD, _AMBIENT = np.float32(0.70), np.float32(0.24), np.float32(0.30)
_INSIDE_DIMMING = np.float32(0.45)
# Full shading would change the colours that a scale explains.
_SCALAR_RELIEF = 0.45
# Share of the bounding-box diagonal beyond which an obstacle no longer darkens.
_OCCLUSION_REACH = 0.25


@dataclass(frozen=True)
class Hits:
    """The k subpixels that show surface, as lists: arithmetic on background is wasted.

    Attributes
    ----------
    rows, columns : (k,) where, in subpixels.
    corners : (k, 3) int32 vertices of the triangle seen.
    weights : (k, 3) float32 barycentric weights of those.
    face_normals : (k, 3) float32, as the winding says.
    directions : (k, 3) float32 of the viewing rays.
    positions : (k, 3) float32 on the surface, relative to the scene's centre.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    corners: NDArray[np.int32]
    weights: NDArray[np.float32]
    face_normals: NDArray[np.float32]
    directions: NDArray[np.float32]
    positions: NDArray[np.float32]

    @classmethod
    def of(cls, scene: RayScene, camera: Camera, buffers: RenderBuffers) -> Hits:
        """Collect the hits of supersampled buffers."""
        rows, columns = np.nonzero(buffers.hit)
        origin, directions = ray_directions(scene, camera, rows, columns, _SUPERSAMPLING)
        return cls(
            rows,
            columns,
            scene.mesh.triangles[buffers.face[rows, columns]],
            buffers.barycentric[rows, columns],
            buffers.normal[rows, columns],
            directions,
            origin + directions * buffers.depth[rows, columns, None],
        )


@dataclass(frozen=True)
class View:
    """A mesh seen and lit from one camera, ready to be painted in several ways.

    Attributes
    ----------
    mesh, camera : what is seen and where from.
    hits : the subpixels that show surface.
    light : (k,) float32 light on each of them, 1 for a surface lit from the front.
    """

    mesh: TriangleMesh
    camera: Camera
    hits: Hits
    light: NDArray[np.float32]

    @classmethod
    def of(cls, surface: TriangleMesh | RayScene, camera: Camera, *, ambient_rays: int = 0) -> View:
        """Cast the rays and compute the light: a key light from the upper left, a headlight.

        Parameters
        ----------
        surface
            a mesh, or a `RayScene` when there are several cameras.
        camera
            where from.
        ambient_rays
            rays per shading point for the darkening of hollows; 8 to 16 give a
            soft, even result, 0 leaves it out.
        """
        scene = RayScene.of(surface) if isinstance(surface, TriangleMesh) else surface
        buffers = render_buffers(scene, camera, _SUPERSAMPLING)
        hits = Hits.of(scene, camera, buffers)
        normals, inside = _shading_normals(scene, hits)
        openness: NDArray[np.float32] | np.float32 = np.float32(1)
        if ambient_rays > 0:
            openness = _openness(scene, buffers, hits, normals, ambient_rays)
        light = _light(camera, normals, openness)
        light[inside] *= _INSIDE_DIMMING
        return cls(scene.mesh, camera, hits, light)


def lit(view: View, albedo: tuple[int, int, int] = palette.STONE) -> NDArray[np.uint8]:
    """The shape alone, in one sRGB colour."""
    n = len(view.mesh.vertices)
    return _picture(view, np.broadcast_to(np.array(albedo, np.uint8), (n, 3)), nearest=True)


def vertex_colored(view: View, colors: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
    """The surface in its own colours, gently lit.

    Parameters
    ----------
    view
        what is seen.
    colors
        (n, 3) uint8 sRGB per vertex; by default the mesh's ``color`` attribute.
    """
    if colors is None:
        colors = np.asarray(view.mesh.vertex_attributes["color"], np.uint8)
    return _picture(view, colors, nearest=False)


def provenance(view: View, of_vertices: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
    """Measured surface in light stone grey, infilled surface in orange, with crisp borders.

    A point of a triangle belongs to its nearest corner.

    Parameters
    ----------
    view
        what is seen.
    of_vertices
        (n,) as in the palette; by default the mesh's ``provenance`` attribute.
    """
    if of_vertices is None:
        of_vertices = np.asarray(view.mesh.vertex_attributes["provenance"], np.uint8)
    colors = palette.provenance_colors(of_vertices)
    return _picture(view, colors, nearest=True)


def scalar(view: View, values: NDArray[np.floating], scale: ColorScale) -> NDArray[np.uint8]:
    """One number per vertex as colour, on faintly shaded relief.

    Parameters
    ----------
    view
        what is seen.
    values
        (n,) in the unit of the scale; NaN is drawn in `palette.UNKNOWN_COLOR`.
    scale
        limits and colours; `color_bar` draws its legend.
    """
    return _picture(view, scale.colors(values), nearest=False, relief=_SCALAR_RELIEF)


def color_bar(scale: ColorScale, width: int, height: int = 64) -> NDArray[np.uint8]:
    """A horizontal legend of a colour scale on white; ``width`` × ``height`` pixels."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    dpi = 100
    figure = Figure(figsize=(width / dpi, height / dpi), dpi=dpi, facecolor="white")
    axes = figure.add_axes((0.08, 0.68, 0.84, 0.24))
    mappable = ScalarMappable(Normalize(scale.low, scale.high), scale.colormap)
    bar = figure.colorbar(mappable, cax=axes, orientation="horizontal", extend="neither")
    bar.set_label(scale.label, fontsize=9)
    bar.ax.tick_params(labelsize=8)
    figure.savefig(buffer := io.BytesIO(), format="rgba", dpi=dpi)
    return np.frombuffer(buffer.getvalue(), np.uint8).reshape(height, width, 4)[..., :3].copy()


def png_bytes(picture: NDArray[np.uint8]) -> bytes:
    """A picture (h, w, 3) uint8 as a PNG file, without time stamp: same picture, same bytes."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG", compress_level=6)
    return buffer.getvalue()


def jpeg_bytes(picture: NDArray[np.uint8]) -> bytes:
    """A photograph (h, w, 3) uint8 sRGB as a JPEG file without metadata."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "JPEG", quality=88, subsampling=0)
    return buffer.getvalue()


def _picture(
    view: View, vertex_colors: NDArray[np.uint8], *, nearest: bool, relief: float = 1.0
) -> NDArray[np.uint8]:
    """Paint, average the subpixels in linear light, encode; ``relief`` scales the shading."""
    camera, hits, s = view.camera, view.hits, _SUPERSAMPLING
    picture = np.array(palette.background(camera.height, camera.width))
    light = (1 + np.float32(relief) * (view.light - 1)) / np.float32(s * s)
    shaded = _colors_at_hits(hits, vertex_colors, nearest)
    shaded *= light[:, None]
    pixel = (hits.rows // s) * camera.width + hits.columns // s
    pixels = camera.width * camera.height
    cover = np.bincount(pixel, minlength=pixels) / np.float32(s * s)
    picture *= (1 - cover).astype(np.float32).reshape(camera.height, camera.width, 1)
    for k in range(3):
        channel = np.bincount(pixel, shaded[:, k], pixels)
        picture[..., k] += channel.reshape(camera.height, camera.width)
    return palette.srgb_from_linear(picture)


def _colors_at_hits(
    hits: Hits, vertex_colors: NDArray[np.uint8], nearest: bool
) -> NDArray[np.float32]:
    """Linear colours (k, 3), of the nearest corner or blended over the triangle."""
    if nearest:
        own = hits.corners[np.arange(len(hits.corners)), hits.weights.argmax(axis=1)]
        return palette.linear_from_srgb(vertex_colors[own])
    blended = np.zeros((len(hits.corners), 3), np.float32)
    for k in range(3):
        corner_colors = palette.linear_from_srgb(vertex_colors[hits.corners[:, k]])
        blended += hits.weights[:, k : k + 1] * corner_colors
    return blended


def _shading_normals(scene: RayScene, hits: Hits) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Smooth normals (k, 3) towards the viewer and which hits (k,) see a face's back.

    A corner whose vertex normal leans far from its face keeps the face's own normal: sharp
    edges stay sharp, curved surfaces stay smooth.
    """
    smooth = np.zeros_like(hits.face_normals)
    limit = np.float32(np.cos(np.radians(_CREASE_DEG)))
    for k in range(3):
        normal = scene.normals[hits.corners[:, k]]
        leaning = np.flatnonzero(np.einsum("ij,ij->i", normal, hits.face_normals) < limit)
        normal[leaning] = hits.face_normals[leaning]
        normal *= hits.weights[:, k : k + 1]
        smooth += normal
    length = np.sqrt(np.einsum("ij,ij->i", smooth, smooth))
    smooth /= np.maximum(length, np.float32(1e-12))[:, None]
    inside = np.einsum("ij,ij->i", hits.face_normals, hits.directions) > 0
    smooth[inside] *= -1
    return smooth, inside


def _light(
    camera: Camera,
    normals: NDArray[np.float32],
    openness: NDArray[np.float32] | np.float32,
) -> NDArray[np.float32]:
    """Light (hits,) that falls on the surface: key light, headlight and ambient light."""
    world_from_camera = camera.camera_from_world[:3, :3].T.astype(np.float32)
    key = world_from_camera @ (_KEY_LIGHT_IN_CAMERA / np.linalg.norm(_KEY_LIGHT_IN_CAMERA))
    head = world_from_camera @ _HEADLIGHT_IN_CAMERA
    # Hollows also lose part of the direct light: it stands for shadows, which are not cast.
    direct = _KEY * np.maximum(normals @ key, 0) + _HEAD * np.maximum(normals @ head, 0)
    return np.asarray(direct * (0.35 + 0.65 * openness) + _AMBIENT * openness, np.float32)


def _openness(
    scene: RayScene,
    buffers: RenderBuffers,
    hits: Hits,
    normals: NDArray[np.float32],
    rays_each: int,
) -> NDArray[np.float32]:
    """Ambient light (k,) in [0, 1] at every hit.

    Taken at every fourth subpixel, with another set of directions at each cell of a 4 × 4
    tile; a mean over the tile, kept within one surface, then has the noise of 16 times the
    rays and no pattern.
    """
    stride, tile = 2 * _SUPERSAMPLING, 4
    offset = stride // 2
    chosen = np.flatnonzero((hits.rows % stride == offset) & (hits.columns % stride == offset))
    if not len(chosen):
        return np.ones(len(hits.rows), np.float32)
    hit = buffers.hit[offset::stride, offset::stride]
    depth = buffers.depth[offset::stride, offset::stride]
    rows, columns = hits.rows[chosen] // stride, hits.columns[chosen] // stride
    sky = np.zeros(hit.shape, np.float32)
    sky[rows, columns] = open_sky(
        scene,
        hits.positions[chosen],
        normals[chosen],
        _cosine_directions(tile * tile, rays_each),
        (rows % tile) * tile + columns % tile,
        reach=_OCCLUSION_REACH * scene.size,
    )
    grid_normals = np.zeros((*hit.shape, 3), np.float32)
    grid_normals[rows, columns] = normals[chosen]
    near = np.float32(0.01 * scene.size)
    total, weight = np.zeros_like(sky), np.zeros_like(sky)
    for down, across in np.ndindex(tile, tile):
        # What wraps round the picture's border differs in depth or is background.
        shift = (down - tile // 2, across - tile // 2)
        other_normals = np.roll(grid_normals, shift, (0, 1))
        with np.errstate(invalid="ignore"):
            apart = np.abs(depth - np.roll(depth, shift, (0, 1)))
        same = hit & np.roll(hit, shift, (0, 1)) & (apart < near)
        alike = np.clip(np.einsum("ijk,ijk->ij", grid_normals, other_normals), 0, 1) ** 4 * same
        total += alike * np.roll(sky, shift, (0, 1))
        weight += alike
    smooth = total / np.maximum(weight, np.float32(1e-6))
    # Weighted by the hits, so that the background does not bleed into the silhouette.
    inside = _at_hits(hit.astype(np.float32), stride, hits)
    light = _at_hits(np.asarray(smooth * hit, np.float32), stride, hits)
    return np.where(inside > 1e-3, light / np.maximum(inside, np.float32(1e-3)), np.float32(1))


def _at_hits(image: NDArray[np.float32], stride: int, hits: Hits) -> NDArray[np.float32]:
    """Bilinear interpolation (k,) of a coarse image with a sample per ``stride`` subpixels."""
    corners = []
    for positions, size in ((hits.rows, image.shape[0]), (hits.columns, image.shape[1])):
        at = np.clip((positions - stride // 2) / np.float32(stride), 0, size - 1)
        low = np.minimum(at.astype(np.intp), max(size - 2, 0))
        corners.append((low, np.minimum(low + 1, size - 1), (at - low).astype(np.float32)))
    (top, bottom, down), (left, right, across) = corners
    upper = image[top, left] * (1 - across) + image[top, right] * across
    lower = image[bottom, left] * (1 - across) + image[bottom, right] * across
    return np.asarray(upper * (1 - down) + lower * down, np.float32)


def _cosine_directions(sets: int, rays_each: int) -> NDArray[np.float32]:
    """(sets, rays_each, 3) unit directions about +z from one low-discrepancy sequence."""
    halton = qmc.Halton(2, scramble=False).random(sets * rays_each)
    radius, angle = np.sqrt(halton[:, 0]), 2 * np.pi * halton[:, 1]
    z = np.sqrt(np.maximum(0, 1 - halton[:, 0]))
    flat = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    # Interleaved, so that each set spreads over the whole hemisphere on its own.
    return flat.reshape(rays_each, sets, 3).swapaxes(0, 1).astype(np.float32)
