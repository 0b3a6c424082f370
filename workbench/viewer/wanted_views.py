"""From where, how large and in what light a picture is asked for on the command line."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from workbench.errors import SettingsError
from workbench.geometry.photo_camera import PhotoCamera
from workbench.project.settings import suggestion
from workbench.viewer.link_views import LinkView
from workbench.viewer.page_light import Light
from workbench.voxels.graph_pictures import camera_around
from workbench.voxels.voxel_set import VoxelGrid

WantedLight = Literal["camera", "even", "lamp"]
LIGHTS = get_args(WantedLight)
_MOST_PIXELS = 1 << 26


@dataclass(frozen=True)
class WantedView:
    """What ``--camera`` and ``--size`` ask for.

    Attributes
    ----------
    photo : the name of a photograph whose place is meant, or None.
    link : a view of the page, or None.
    light : how it falls, or None as the mode has it.
    azimuth, elevation, up : otherwise where the camera stands around the object, degrees, and
        the object's upward axis, where it is told.
    width, height : of the picture, pixels.
    """

    photo: str | None
    link: LinkView | None
    light: WantedLight | None
    azimuth: float
    elevation: float
    up: str | None
    width: int
    height: int

    @classmethod
    def of_texts(cls, camera: str, size: str, light: str | None = None) -> WantedView:
        """What the texts say.

        Raises
        ------
        SettingsError
            They say nothing that is understood.
        """
        sides = re.fullmatch(r"(\d{1,6})[x×](\d{1,6})", size)
        width, height = (int(side) for side in sides.groups()) if sides else (0, 0)
        if not 0 < width * height <= _MOST_PIXELS:
            raise SettingsError(
                f"--size {size!r} is not understood",
                expected=f"WxH, at most {_MOST_PIXELS:,} pixels",
                fix="such as --size 1280x720",
            )
        if light is not None and light not in LIGHTS:
            raise SettingsError(
                f"There is no light {light!r}",
                expected=", ".join(LIGHTS),
                fix=suggestion(light, LIGHTS) or "choose one of the expected names",
            )
        lamp = cast("WantedLight | None", light)
        kind, _, name = camera.partition(":")
        if kind == "photo" and name:
            return cls(name, None, lamp, 0.0, 0.0, None, width, height)
        if "=" in camera:
            return cls(None, LinkView.of_text(camera), lamp, 0.0, 0.0, None, width, height)
        number = r"\s*([+-]?\d+(?:\.\d*)?)\s*"
        found = re.fullmatch(rf"{number},{number}(?:,\s*([yz])\s*)?", camera)
        if not found or abs(float(found[2])) >= 90.0:
            raise SettingsError(
                f"--camera {camera!r} is not understood",
                expected="AZ,EL[,y or z] in degrees, EL between -90 and 90; eye=…;to=…;fov=…; "
                "or photo:NAME",
                fix="such as --camera 30,15",
            )
        return cls(None, None, lamp, float(found[1]), float(found[2]), found[3], width, height)

    def page_light(self, mode: str, usual: Light = "camera") -> Light:
        """The light of a mode whose models throw no shadows.

        Raises
        ------
        SettingsError
            A lamp is asked for.
        """
        if self.light == "lamp":
            raise SettingsError(
                f"--mode {mode} has no lamp that throws shadows",
                expected="camera or even",
                fix="--mode voxels or graph has one",
            )
        return self.light or usual

    def camera(self, grid: VoxelGrid, up: str, origin: NDArray[np.float64]) -> PhotoCamera:
        """The camera of a model in a cube, whose local coordinates begin at ``origin``."""
        if self.link is not None:
            return self.link.camera(origin, self.width, self.height)
        return camera_around(
            grid,
            self.width,
            self.height,
            azimuth=self.azimuth,
            elevation=self.elevation,
            up=self.up or up,
        )

    def view(self, camera: PhotoCamera, origin: NDArray[np.float64]) -> LinkView:
        """The view of a camera that was chosen so."""
        return self.link or LinkView.of_camera(camera, origin)
