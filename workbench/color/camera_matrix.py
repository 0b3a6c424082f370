"""Colour without a chart: the camera's white balance and its maker's matrix."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.color.calibration import ColorMatrix
from workbench.color.spaces import WorkingSpace, xyz_d65_from_d50


def camera_color(
    space: WorkingSpace,
    white_balance: NDArray[np.float64] | None,
    camera_from_xyz: NDArray[np.float64] | None,
) -> tuple[ColorMatrix, str]:
    """A matrix as raw converters make it, and in words what it rests on.

    Parameters
    ----------
    space : the working space.
    white_balance : (3,) the camera's multipliers, green 1; None where it tells none.
    camera_from_xyz : (3, 3) its colour matrix relative to D65; None where none is known.

    Notes
    -----
    Rows of the matrix from the working space to the camera are scaled so that white stays
    white (Coffin's dcraw). 1 is where the sensor's green is full.
    """
    balance = np.ones(3) if white_balance is None else np.asarray(white_balance, float)
    told = "no white balance" if white_balance is None else "the camera's white balance"
    if camera_from_xyz is None:
        return ColorMatrix(balance, "linear", np.eye(3)), f"{told}, no colour matrix"
    camera_from_rgb = camera_from_xyz @ xyz_d65_from_d50() @ space.xyz_d50_from_rgb
    camera_from_rgb /= camera_from_rgb.sum(axis=1, keepdims=True)
    matrix = np.asarray(np.linalg.inv(camera_from_rgb), np.float64)
    return ColorMatrix(balance, "linear", matrix), f"{told} and its maker's colour matrix"


def profile_color(space: WorkingSpace, xyz_d50_from_rgb: NDArray[np.float64]) -> ColorMatrix:
    """The matrix of a picture that was linearised from its profile."""
    return ColorMatrix(np.ones(3), "linear", space.rgb_from_xyz_d50 @ xyz_d50_from_rgb)
