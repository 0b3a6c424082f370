"""The unknowns of a bundle adjustment, what they predict, and how that changes with them.

Lenses are COLMAP's own, whatever their model: pixels come from its code, and their derivatives
from central differences of it, which 53 bits leave exact to some nine digits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.formats.colmap import NO_POINT, ColmapImage, ColmapModel, ColmapPoint
from workbench.geometry.similarity import Similarity
from workbench.geometry.transforms import from_twist
from workbench.orientation.lens_belief import LensBelief
from workbench.orientation.normal_equations import POSE, Dependence, Linearised, Matrices

# Cauchy's weight function, 95 % efficient on Gaussian residuals.
_CAUCHY = 2.3849
_STEP = 1e-6
# Information of one observation against the typical one's, at most.
_MOST_SURE = 16.0
# Derivatives of one take some kilobyte.
OBSERVATIONS_AT_ONCE = 1 << 18


@dataclass(frozen=True)
class Bundle:
    """Cameras, points and observations as arrays.

    Attributes
    ----------
    source : the model they came from.
    image_ids, camera_ids : of the rows of ``poses`` and of ``params``.
    poses : (n, 4, 4) camera_from_world.
    params : one array per lens, in COLMAP's order.
    beliefs : what is believed of each lens's parameters before.
    camera_of_image : (n,) row of the lens.
    point_ids, points : (p,) and (p, 3).
    seen_image, seen_point : (m,) rows of image and point of each observation.
    pixels : (m, 2) observed.
    whitening : (m, 2, 2) what residuals in pixels are multiplied by, so that all are equally
        sure; the identity is an observation as good as the typical one.
    depends : of all observations, also where the bundle has some of them.
    """

    source: ColmapModel
    image_ids: tuple[int, ...]
    camera_ids: tuple[int, ...]
    poses: Matrices
    params: tuple[Matrices, ...]
    beliefs: tuple[LensBelief, ...]
    camera_of_image: NDArray[np.intp]
    point_ids: NDArray[np.int64]
    points: Matrices
    seen_image: NDArray[np.intp]
    seen_point: NDArray[np.intp]
    pixels: Matrices
    whitening: Matrices
    depends: Dependence

    @classmethod
    def of(
        cls,
        model: ColmapModel,
        most_points: int,
        information: Mapping[int, Matrices] | None = None,
    ) -> Bundle:
        """The unknowns of a model; of many points those with the longest tracks.

        Parameters
        ----------
        information : image id → (k, 3), of each of its observations the inverse covariance up
            to a common factor, xx, xy and yy; without it all count alike.
        """
        image_ids = tuple(sorted(model.images))
        camera_ids = tuple(sorted({model.images[n].camera_id for n in image_ids}))
        row_of_image = {number: row for row, number in enumerate(image_ids)}
        row_of_camera = {number: row for row, number in enumerate(camera_ids)}
        longest = sorted(model.points, key=lambda n: (-len(model.points[n].track), n))
        point_ids = np.array(sorted(longest[:most_points]), np.int64)
        row_of_point = {int(number): row for row, number in enumerate(point_ids)}
        images, seen, pixels, sure = [], [], [], [np.zeros((0, 3))]
        for number in image_ids:
            image = model.images[number]
            rows = np.array(
                [row_of_point.get(int(p), NO_POINT) for p in image.point3d_ids], np.intp
            )
            known = rows != NO_POINT
            images.append(np.full(int(known.sum()), row_of_image[number], np.intp))
            seen.append(rows[known])
            pixels.append(image.points2d[known])
            if information is not None:
                sure.append(information[number][known])
        seen_image = np.concatenate(images) if images else np.zeros(0, np.intp)
        seen_point = np.concatenate(seen) if seen else np.zeros(0, np.intp)
        camera_of_image = np.array(
            [row_of_camera[model.images[n].camera_id] for n in image_ids], np.intp
        )
        params = tuple(np.array(model.cameras[n].params, float) for n in camera_ids)
        return cls(
            model,
            image_ids,
            camera_ids,
            np.array([model.images[n].camera_from_world for n in image_ids]),
            params,
            tuple(LensBelief.of(model.cameras[n]) for n in camera_ids),
            camera_of_image,
            point_ids,
            np.array([model.points[int(n)].xyz for n in point_ids], float).reshape(-1, 3),
            seen_image,
            seen_point,
            np.concatenate(pixels) if pixels else np.zeros((0, 2)),
            np.tile(np.eye(2), (len(seen_point), 1, 1))
            if information is None
            else _whitening(np.concatenate(sure)),
            Dependence.of(
                *(seen_image, seen_point, camera_of_image),
                tuple(len(values) for values in params),
                len(point_ids),
            ),
        )

    @property
    def problem(self) -> str:
        """Why nothing can be adjusted; empty where something can."""
        views = np.bincount(self.seen_point, minlength=len(self.points))
        if (views >= 2).sum() < 12:
            return "fewer than a dozen points are seen by two photographs or more"
        alone = np.bincount(self.seen_image, minlength=len(self.image_ids)) < 4
        if alone.any():
            names = [self.source.images[self.image_ids[n]].name for n in np.flatnonzero(alone)]
            return f"fewer than four points are seen by {', '.join(names)}"
        return ""

    def projected(self) -> Matrices:
        """Pixels (m, 2) where the observations should be; NaN behind the camera."""
        return self._imaged(self._in_cameras(), self.params)

    def residuals(self) -> Matrices:
        """(k, 2) predicted minus observed, whitened, of observations before their camera."""
        apart = self._white(self.projected() - self.pixels)
        return np.asarray(apart[np.isfinite(apart).all(axis=1)])

    def cost(self, sigma_px: float, weights: Matrices) -> float:
        """Weighted squares of all reprojections, and of what is believed of the lenses."""
        apart = self._white(np.nan_to_num(self.projected() - self.pixels, nan=1e3))
        total = float((weights[:, None] * apart**2).sum()) / sigma_px**2
        for now, belief in zip(self.params, self.beliefs, strict=True):
            total += float((belief.residuals(now) ** 2).sum())
        return total

    def linearised(self, sigma_px: float) -> Linearised:
        """Normal equations about the present unknowns, in units of the residuals' sigma."""
        system = Linearised.empty(self.depends)
        for start in range(0, len(self.pixels), OBSERVATIONS_AT_ONCE):
            part = slice(start, start + OBSERVATIONS_AT_ONCE)
            self._part(part)._add_observations(system, part, sigma_px)
        system.mirror()
        self._add_beliefs(system.camera_hessian, system.camera_gradient)
        return system

    def _part(self, part: slice) -> Bundle:
        """The same unknowns with some of the observations: derivatives take room."""
        return replace(
            self,
            seen_image=self.seen_image[part],
            seen_point=self.seen_point[part],
            pixels=self.pixels[part],
            whitening=self.whitening[part],
        )

    def _add_observations(self, system: Linearised, part: slice, sigma_px: float) -> None:
        local = self._in_cameras()
        apart = self._white(self._imaged(local, self.params) - self.pixels)
        good: NDArray[np.bool_] = np.asarray(np.isfinite(apart).all(axis=1))
        apart = np.where(good[:, None], apart, 0.0)
        length = np.linalg.norm(apart, axis=1)
        weights = np.where(good, 1.0 / (1.0 + (length / (_CAUCHY * sigma_px)) ** 2), 0.0)
        by_place = self.whitening @ np.nan_to_num(self._by_place(local))
        by_point = by_place @ self.poses[self.seen_image, :3, :3]
        turned = np.cross(np.eye(3)[None], local[:, None, :])
        # Turning by w moves a place P by w × P = Σ wᵢ (eᵢ × P).
        by_turn = by_place @ turned.transpose(0, 2, 1)
        by_lens = self.whitening @ self._by_lens(local)
        by_camera = np.concatenate([by_turn, by_place, by_lens], axis=2)
        system.add(part, self.seen_point, by_camera, by_point, apart, weights, sigma_px)

    def moved(self, cameras: Matrices, points: Matrices) -> Bundle:
        """The unknowns after a step of the normal equations."""
        count = len(self.image_ids)
        twists = cameras[: POSE * count].reshape(count, POSE)
        poses = np.array([from_twist(t) @ pose for t, pose in zip(twists, self.poses, strict=True)])
        params = tuple(
            now + cameras[where]
            for now, where in zip(self.params, self._lens_slices(), strict=True)
        )
        return replace(self, poses=poses, params=params, points=self.points + points)

    def transformed(self, to: Similarity) -> Bundle:
        """All in another frame and scale; no image changes."""
        poses = np.array([to.camera_from_b(pose) for pose in self.poses])
        return replace(self, poses=poses, points=to.apply(self.points))

    def uncertainty(
        self, covariance: Matrices
    ) -> tuple[dict[int, NDArray[np.float64]], dict[int, float]]:
        """Standard deviations per image id: of the centre (3,), and of the worst turn, degrees."""
        centers, turns = {}, {}
        for row, number in enumerate(self.image_ids):
            block = covariance[POSE * row : POSE * (row + 1), POSE * row : POSE * (row + 1)]
            # A shift by v in the camera moves its centre by −Rᵀv.
            rotation = self.poses[row, :3, :3]
            center = rotation.T @ block[3:, 3:] @ rotation
            centers[number] = np.sqrt(np.maximum(np.diag(center), 0.0))
            worst = float(np.linalg.eigvalsh(block[:3, :3])[-1])
            turns[number] = float(np.degrees(np.sqrt(max(worst, 0.0))))
        return centers, turns

    def model(self) -> ColmapModel:
        """The adjusted cameras and points; observations of points that took no part are loose."""
        row_of_point = {int(number): row for row, number in enumerate(self.point_ids)}
        cameras = {
            number: replace(self.source.cameras[number], params=tuple(map(float, params)))
            for number, params in zip(self.camera_ids, self.params, strict=True)
        }
        images: dict[int, ColmapImage] = {}
        for row, number in enumerate(self.image_ids):
            image = self.source.images[number]
            kept = np.array([int(p) in row_of_point for p in image.point3d_ids], bool)
            images[number] = replace(
                image,
                camera_from_world=self.poses[row],
                point3d_ids=np.where(kept, image.point3d_ids, NO_POINT),
            )
        length = np.linalg.norm(np.nan_to_num(self.projected() - self.pixels), axis=1)
        views = np.bincount(self.seen_point, minlength=len(self.points))
        error = np.bincount(self.seen_point, length, len(self.points)) / np.maximum(views, 1)
        points: dict[int, ColmapPoint] = {
            number: replace(
                self.source.points[number], xyz=self.points[row], error=float(error[row])
            )
            for number, row in row_of_point.items()
        }
        return ColmapModel(cameras, images, points)

    def _white(self, apart: Matrices) -> Matrices:
        return np.asarray(np.einsum("mij,mj->mi", self.whitening, apart))

    def _in_cameras(self) -> Matrices:
        rotation = self.poses[self.seen_image, :3, :3]
        shift = self.poses[self.seen_image, :3, 3]
        return np.asarray(np.einsum("mij,mj->mi", rotation, self.points[self.seen_point]) + shift)

    def _imaged(self, local: Matrices, params: tuple[Matrices, ...]) -> Matrices:
        """Pixels (m, 2) of places (m, 3) before their cameras; NaN of those behind."""
        pixels = np.full((len(local), 2), np.nan)
        for row, mine in self._by_lenses(local):
            pixels[mine] = self._lens(row, params[row]).img_from_cam(local[mine])
        return pixels

    def _by_lenses(self, local: Matrices) -> Iterator[tuple[int, NDArray[np.bool_] | slice]]:
        """Lenses, and which of the places (m, 3) lie before cameras with them."""
        before = local[:, 2] > 0.0
        lens_of = self.camera_of_image[self.seen_image]
        for row in range(len(self.params)):
            mine = before & (lens_of == row)
            # Copying all would take longer than imaging them.
            if mine.any():
                yield row, slice(None) if mine.all() else mine

    def _lens(self, row: int, params: Matrices) -> Any:
        import pycolmap

        camera = self.source.cameras[self.camera_ids[row]]
        return pycolmap.Camera(
            model=camera.model, width=camera.width, height=camera.height, params=params.tolist()
        )

    def _by_place(self, local: Matrices) -> Matrices:
        """(m, 2, 3) derivatives of pixels by places in the camera."""
        found = np.empty((len(local), 2, 3))
        for axis in range(3):
            step = _STEP * np.maximum(np.abs(local[:, 2:]), 1e-12) * np.eye(3)[axis]
            ahead, behind = (self._imaged(local + sign * step, self.params) for sign in (1, -1))
            found[:, :, axis] = (ahead - behind) / (2.0 * step[:, axis : axis + 1])
        return found

    def _by_lens(self, local: Matrices) -> Matrices:
        """(m, 2, k) derivatives of pixels by their lens's parameters; k of the longest."""
        found = np.zeros((len(local), 2, max(len(values) for values in self.params)))
        for row, mine in self._by_lenses(local):
            values, places = self.params[row], local[mine]
            for k, value in enumerate(values):
                step = _STEP * max(1.0, abs(float(value)))
                change = step * np.eye(len(values))[k]
                ahead, behind = (
                    self._lens(row, values + sign * change).img_from_cam(places) for sign in (1, -1)
                )
                found[mine, :, k] = np.nan_to_num((ahead - behind) / (2.0 * step))
        return found

    def _lens_slices(self) -> list[slice]:
        first, found = POSE * len(self.image_ids), []
        for params in self.params:
            found.append(slice(first, first + len(params)))
            first += len(params)
        return found

    def _add_beliefs(self, hessian: Matrices, gradient: Matrices) -> None:
        for now, belief, where in zip(self.params, self.beliefs, self._lens_slices(), strict=True):
            hessian[where, where] += belief.rows.T @ belief.rows
            gradient[where] += belief.rows.T @ belief.residuals(now)


def _whitening(information: Matrices) -> Matrices:
    """Square roots (m, 2, 2) of inverse covariances (m, 3), the typical one's made 1."""
    xx, xy, yy = information.T
    size = np.sqrt(np.maximum(xx * yy - xy * xy, 0.0))
    typical = float(np.median(size)) if len(size) else 1.0
    # None counts for many others, however still its patch was.
    scale = 1.0 / np.maximum(typical, np.maximum(xx, yy) / _MOST_SURE)
    xx, xy, yy = scale * xx, scale * xy, scale * yy
    root = np.zeros((len(information), 2, 2))
    root[:, 0, 0] = np.sqrt(xx)
    root[:, 0, 1] = xy / root[:, 0, 0]
    root[:, 1, 1] = np.sqrt(np.maximum(yy - root[:, 0, 1] ** 2, 0.0))
    return root
