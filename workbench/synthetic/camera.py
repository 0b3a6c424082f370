"""Where the camera stands for each photograph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry import transforms
from workbench.geometry.transforms import looking_at
from workbench.synthetic.building import round_the_walls
from workbench.synthetic.photo_options import PathOptions

# A walk-round alternates between these shares of its swing: neighbours differ in height but
# never by the whole swing at once.
_SWING = (-1.0, 0.0, 1.0, 0.0)


# Height of the camera and of what it is aimed at, round by round along walls: on foot, by drone.
_HEIGHTS_M = ((1.7, 4.2), (12.0, 6.0))
# Way along walls that is spent on turning round each corner: where the path turned at once,
# neighbouring photographs would show nothing in common.
_CORNER_M = 50.0 / 3.0


def local_from_camera(
    focus: NDArray[np.float64],
    options: PathOptions,
    photos: int,
    index: int,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """True 4×4 pose of one photograph; camera x right, y down, z forward.

    Parameters
    ----------
    focus : (3,) local point that the path turns about.
    options : the path.
    photos : how many photographs there are; they are shared evenly among the turns.
    index : which one, in [0, photos).
    rng : the hand's unsteadiness; a tripod ignores it.
    """
    along = index * options.turns / photos
    turn = min(int(along), options.turns - 1)
    elevation_deg = options.elevations_deg[turn % len(options.elevations_deg)]
    azimuth = 2 * np.pi * (along - turn) + 0.5 * np.pi
    shake = rng.standard_normal(7)
    aim, shift, roll_deg = np.array(focus, float), np.zeros(3), 0.0
    if options.kind == "along walls":
        foot, outward = round_the_walls(along - turn, _CORNER_M)
        eye, target = _HEIGHTS_M[turn % len(_HEIGHTS_M)]
        place = [*(foot + options.distance_m * outward), eye]
        level = looking_at(
            place + options.position_sigma_m * shake[3:6],
            np.array([*foot, target]) + options.aim_sigma_m * shake[:3],
        )
        return _rolled(level, options.roll_sigma_deg * shake[6])
    if options.kind == "walk-round":
        elevation_deg += options.elevation_swing_deg * _SWING[index % len(_SWING)]
        aim += options.aim_sigma_m * shake[:3]
        shift = options.position_sigma_m * shake[3:6]
        roll_deg = options.roll_sigma_deg * shake[6]
    elevation = np.radians(np.clip(elevation_deg, -80.0, 80.0))
    way = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    return _rolled(looking_at(focus + options.distance_m * way + shift, aim), roll_deg)


def _rolled(pose: NDArray[np.float64], roll_deg: float) -> NDArray[np.float64]:
    """A pose turned about its own view axis."""
    roll = transforms.from_twist([0.0, 0.0, np.radians(roll_deg), 0.0, 0.0, 0.0])
    turned: NDArray[np.float64] = pose @ roll
    return turned
