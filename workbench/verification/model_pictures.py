"""Pictures of a model from four sides, for reports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.geometry.framing import main_vertices
from workbench.geometry.mesh import TriangleMesh
from workbench.render import palette, shading
from workbench.render.camera import Camera, UpAxis, orbit_camera, orbit_cameras
from workbench.render.palette import ColorScale
from workbench.render.raycast import RayScene
from workbench.render.shading import View
from workbench.verification.figures import color_bar_figure
from workbench.verification.quantities import length_unit, round_up_125, shown_percent
from workbench.verification.report_content import LegendEntry, Picture, PictureRow

SIDES = {"front": 0.0, "right": 90.0, "back": 180.0, "left": 270.0}
_ELEVATION_DEG = 12.0
_AMBIENT_RAYS = 12


@dataclass(frozen=True)
class FourSides:
    """A mesh seen from front, right, back and left at one scale.

    Attributes
    ----------
    scene : the mesh.
    views : side → view.
    cover_camera : where the three-quarter view is taken from.
    left_out : share of the vertices, in small pieces far off, that nothing was framed for.
    """

    scene: RayScene
    views: dict[str, View]
    cover_camera: Camera
    left_out: float

    @classmethod
    def of(
        cls, mesh: TriangleMesh, up: UpAxis, width_px: int = 460, front_deg: float = 0.0
    ) -> FourSides:
        """Frame the mesh; pictures are ``width_px`` wide and as tall as its shape asks for.

        ``front_deg`` is the azimuth the front is seen from. A small piece that lies far off, as a
        wall behind the object, makes it no smaller.
        """
        used = np.unique(mesh.triangles)
        framed = main_vertices(mesh)[used]
        vertices = mesh.vertices[used[framed]]
        # A few thousand points frame as well as millions.
        vertices = vertices[:: max(1, len(vertices) // 20_000)]
        extent = vertices.max(axis=0) - vertices.min(axis=0)
        vertical = {"x": 0, "y": 1, "z": 2}[up]
        across = float(np.delete(extent, vertical).max()) or 1.0
        ratio = float(np.clip((extent[vertical] + 0.25 * across) / across, 0.6, 1.7))
        cameras = orbit_cameras(
            vertices,
            [front_deg + side for side in SIDES.values()],
            _ELEVATION_DEG,
            width_px,
            round(width_px * ratio),
            up=up,
        )
        cover_width = round(1.5 * width_px)
        cover = orbit_camera(
            vertices, front_deg + 30.0, 18.0, cover_width, round(cover_width * ratio), up=up
        )
        scene = RayScene.of(mesh)
        views = (View.of(scene, camera, ambient_rays=_AMBIENT_RAYS) for camera in cameras)
        return cls(scene, dict(zip(SIDES, views, strict=True)), cover, 1.0 - float(framed.mean()))

    def cover(self) -> Picture:
        """A larger three-quarter view of the shape."""
        view = View.of(self.scene, self.cover_camera, ambient_rays=_AMBIENT_RAYS)
        return Picture(shading.lit(view), "", "The model in a three-quarter view")

    def lit(self) -> PictureRow:
        """The shape alone."""
        told = "The shape, evenly coloured, from four sides at one scale."
        if self.left_out > 0.0:
            told += (
                f" Small pieces far off, {shown_percent(self.left_out)} of the vertices, may be "
                "beyond the pictures."
            )
        return PictureRow(self._pictures(shading.lit, "shape"), told)

    def colored(self) -> PictureRow:
        """The colours of the vertices; the mesh needs a ``color`` attribute."""
        return PictureRow(
            self._pictures(shading.vertex_colored, "colours"),
            "The colours of the surface, from four sides at one scale.",
        )

    def provenance(self, of_vertices: NDArray[np.uint8]) -> PictureRow:
        """What was measured and what was filled, by vertex (n,), as in the palette."""
        kinds = {palette.MEASURED: "measured", palette.INFILLED: "infilled"}
        told = "Where the surface was measured and where it was closed by computation. "
        if (of_vertices == palette.BY_PHOTOGRAPHS).any():
            kinds = {
                palette.MEASURED: "measured by scans",
                palette.BY_PHOTOGRAPHS: "by photographs",
                palette.INFILLED: "infilled",
            }
            told += "Blue parts no scan saw: photographs agree on them. "
        return PictureRow(
            self._pictures(
                lambda view: shading.provenance(view, of_vertices), "measured and infilled surface"
            ),
            told + "Orange parts are plausible, not observed.",
            legend=tuple(
                LegendEntry(palette.PROVENANCE_COLORS[kind], name) for kind, name in kinds.items()
            ),
        )

    def lengths(
        self, name: str, values_m: ArrayLike, quantity: str, caption: str, unknown: str
    ) -> PictureRow:
        """One length per vertex as colour: diverging when some are negative.

        Parameters
        ----------
        name
            unique in the page; letters, digits, ``-``.
        values_m
            (n,) metres; NaN where there is none.
        quantity
            what is shown, for the legend, e.g. ``Deviation``.
        caption
            sentence below the pictures.
        unknown
            what NaN means, for the legend.
        """
        values = np.asarray(values_m, float)
        scale, scaled = length_scale(values, quantity)
        legend = (LegendEntry(palette.UNKNOWN_COLOR, unknown),) if np.isnan(values).any() else ()
        return PictureRow(
            self._pictures(lambda view: shading.scalar(view, scaled, scale), quantity.lower()),
            caption,
            legend=legend,
            color_bar=color_bar_figure(name, scale, f"Colour scale: {scale.label}"),
        )

    def _pictures(
        self, paint: Callable[[View], NDArray[np.uint8]], what: str
    ) -> tuple[Picture, ...]:
        return tuple(
            Picture(paint(view), side.capitalize(), f"The {side} of the model: {what}")
            for side, view in self.views.items()
        )


def length_scale(
    values_m: NDArray[np.float64], quantity: str
) -> tuple[ColorScale, NDArray[np.float64]]:
    """A scale that holds 98 % of the lengths, and the lengths in its unit."""
    known = values_m[np.isfinite(values_m)]
    reach = float(np.percentile(np.abs(known), 98)) if len(known) else 0.0
    limit_m = round_up_125(reach) if reach > 0 else 1e-3
    unit = length_unit(limit_m)
    label = f"{quantity} ({unit.symbol})"
    limit = float(f"{limit_m * unit.per_metre:.9g}")
    signed = bool(len(known)) and float(known.min()) < 0
    scale = ColorScale.diverging(limit, label) if signed else ColorScale.sequential(limit, label)
    return scale, values_m * unit.per_metre
