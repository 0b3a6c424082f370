"""Which way is up for photographs alone: nobody scanned, so nothing but the cameras tells.

People hold cameras level: the horizontal axes of pictures lie in one plane, whose normal is the
vertical (Brown and Lowe 2007, section 5, for panoramas). Where all cameras look the same way
these axes are one line, and the mean of what is up in the pictures is taken.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.formats.colmap import ColmapModel
from workbench.geometry.similarity import Similarity

# Shares of the axes' squared lengths: above the first they span a plane, whose normal they
# stand within the second of.
_SPANS, _LEVEL = 0.05, 0.02
# Looking down tells what is up as well, only less: cameras look at ceilings, too.
_OF_LOOKING_DOWN = 0.5
# Mean length of unit vectors that still have a direction together.
_TOGETHER = 0.3


def standing(model: ColmapModel) -> Similarity:
    """What turns and moves a model so that it stands: z is up, and its middle is the origin.

    Its front, seen along +y, is where the cameras stand; if they stand all around, where the
    first one by name does. The scale stays.

    Parameters
    ----------
    model : of cameras that are in a frame of their own, with points; unit of length free.
    """
    cameras = model.photo_cameras()
    rotations = np.array([cameras[name].camera_from_world[:3, :3] for name in sorted(cameras)])
    centers = np.array([cameras[name].center for name in sorted(cameras)])
    points = np.array([point.xyz for point in model.points.values()]).reshape(-1, 3)
    middle = np.median(points if len(points) else centers, axis=0)
    up = _up(rotations)
    outward = centers - middle
    outward -= np.outer(outward @ up, up)
    lengths = np.linalg.norm(outward, axis=1, keepdims=True)
    outward /= np.where(lengths > 0.0, lengths, 1.0)
    # A first camera straight above looks ahead, or its picture's lower border is the front.
    candidates = (outward.mean(axis=0), outward[0], -rotations[0][2], rotations[0][1])
    level = (one - (one @ up) * up for one in candidates)
    front = next(one for one in level if np.linalg.norm(one) > _TOGETHER)
    front /= np.linalg.norm(front)
    turn = np.stack([np.cross(up, front), -front, up])
    return Similarity(1.0, turn, -turn @ middle)


def _up(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vector (3,) in world of (n, 3, 3) camera from world rotations: x right, y down."""
    ups = -rotations[:, 1].mean(axis=0)
    hint = ups - _OF_LOOKING_DOWN * rotations[:, 2].mean(axis=0)
    rights = rotations[:, 0]
    shares, axes = np.linalg.eigh(rights.T @ rights / len(rights))
    if shares[1] > _SPANS and shares[0] < _LEVEL:
        found = axes[:, 0]
        return found if found @ hint >= 0.0 else -found
    direction = ups if np.linalg.norm(ups) > _TOGETHER else hint
    length = float(np.linalg.norm(direction))
    return direction / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
