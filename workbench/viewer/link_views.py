"""Where to look from, as links to the page say it."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import SettingsError
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import inverse, looking_at

_SEPARATOR = re.compile(r"[;&]")
_FIRST_FOV, _LEAST_FOV, _MOST_FOV = 35.0, 1.0, 150.0
_STEEPEST = 0.9999


@dataclass(frozen=True)
class LinkView:
    """A view of a model.

    Attributes
    ----------
    eye, to : where the camera stands and what it looks at, in local coordinates: the user's
        minus the origin of the model's site.
    fov : degrees over the height of the picture.
    """

    eye: tuple[float, float, float]
    to: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fov: float = _FIRST_FOV

    @classmethod
    def of_text(cls, text: str) -> LinkView:
        """From ``eye=x,y,z;to=x,y,z;fov=degrees``; all but the eye may be missing.

        Raises
        ------
        SettingsError
            The text says something else.
        """
        told = dict(part.partition("=")[::2] for part in _SEPARATOR.split(text) if part)
        try:
            if not set(told) <= {"eye", "to", "fov"}:
                raise ValueError
            view = cls(_place(told["eye"]), _place(told.get("to", "0,0,0")))
            view = cls(view.eye, view.to, float(told.get("fov", _FIRST_FOV)))
            ahead = np.subtract(view.to, view.eye)
            steep = abs(ahead[2]) >= _STEEPEST * float(np.linalg.norm(ahead))
            if steep or not _LEAST_FOV < view.fov < _MOST_FOV:
                raise ValueError
        except (KeyError, ValueError):
            raise SettingsError(
                f"--camera {text!r} is not understood",
                expected="eye=x,y,z;to=x,y,z;fov=degrees: two places that are not one above the "
                f"other, and {_LEAST_FOV:g} to {_MOST_FOV:g} degrees",
                fix="such as --camera 'eye=1,-4,1;to=0,0,0;fov=35', from the page's address",
            ) from None
        return view

    @classmethod
    def of_camera(cls, camera: PhotoCamera, origin: NDArray[np.float64]) -> LinkView:
        """What comes nearest to a camera: ``to`` is before it, as far away as the origin."""
        eye = camera.center - origin
        ahead = camera.camera_from_world[2, :3]
        to = eye + ahead * max(float(-eye @ ahead), 1e-3 * float(np.linalg.norm(eye)))
        # Of every lens model the first or the second number is the focal length of the rows.
        focal = camera.params[1] if camera.model in ("PINHOLE", "OPENCV", "FULL_OPENCV") else None
        half = np.arctan(0.5 * camera.height / (focal or camera.params[0]))
        return cls(
            tuple(map(float, eye)),  # type: ignore[arg-type]
            tuple(map(float, to)),  # type: ignore[arg-type]
            float(np.degrees(2.0 * half)),
        )

    def camera(self, origin: NDArray[np.float64], width: int, height: int) -> PhotoCamera:
        """The camera of a model whose local coordinates begin at ``origin`` (3,); z is up."""
        world_from_camera = looking_at(self.eye, self.to)
        world_from_camera[:3, 3] += origin
        focal = 0.5 * height / np.tan(np.radians(0.5 * self.fov))
        lens = (focal, focal, 0.5 * width, 0.5 * height)
        return PhotoCamera("PINHOLE", width, height, lens, inverse(world_from_camera))


def _place(text: str) -> tuple[float, float, float]:
    x, y, z = (float(word) for word in text.split(","))
    if not np.isfinite([x, y, z]).all():
        raise ValueError
    return x, y, z
