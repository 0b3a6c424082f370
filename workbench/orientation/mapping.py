"""Cameras and points from verified pairs, by pycolmap's mappers, and one last adjustment.

Source: Schönberger and Frahm 2016 (incremental); Pan et al. 2024 (global, GLOMAP).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from workbench.orientation.features import PhotoFeatures
from workbench.orientation.two_views import TwoViews

# What COLMAP takes for unknown focal lengths, times the longer side.
DEFAULT_FOCAL = 1.2
# COLMAP's model, and whether the principal point is sought, from the plainest lens up.
_LENSES = (("SIMPLE_RADIAL", False), ("SIMPLE_RADIAL", True), ("OPENCV", True))
# Beyond this an observation counts less and less; features are found to a third of a pixel.
_OUTLIER_PX = 0.5


@dataclass(frozen=True)
class MappingSettings:
    """How cameras are found from pairs.

    Attributes
    ----------
    mapper : incremental is the more robust, global the quicker for hundreds of photographs.
    lens : simple has one focal length and one radial term, full two focal lengths, the
        principal point and two radial and two tangential terms (COLMAP's SIMPLE_RADIAL and
        OPENCV). auto takes of these, and of simple with a principal point, the plainest that
        explains the photographs.
    photos_for_full_lens : cameras with fewer placed photographs stay simple.
    worthwhile : a fuller lens must take this share off the cost of the adjustment. Less, and
        what it fits is the scatter, and its parameters pull the cameras along.
    growth : all cameras are adjusted whenever their number or that of the points has grown by
        this factor.
    min_photos : fewer placed photographs are no result.
    """

    mapper: Literal["incremental", "global"] = "incremental"
    lens: Literal["auto", "simple", "full"] = "auto"
    photos_for_full_lens: int = 10
    worthwhile: float = 0.005
    growth: float = 1.4
    min_photos: int = 2


def start_camera(camera_id: int, width: int, height: int, focal_px: float | None) -> Any:
    """A camera of pycolmap's as it is before more than its focal length in pixels is known."""
    import pycolmap

    focal = DEFAULT_FOCAL * max(width, height) if focal_px is None else focal_px
    camera = pycolmap.Camera(
        model="SIMPLE_RADIAL",
        width=width,
        height=height,
        params=[focal, width / 2.0, height / 2.0, 0.0],
        camera_id=camera_id,
    )
    camera.has_prior_focal_length = focal_px is not None
    return camera


@contextmanager
def quiet_pycolmap() -> Iterator[None]:
    """Let pycolmap tell of errors alone inside the block."""
    import pycolmap

    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


def placed(
    names: Sequence[str],
    features: Sequence[PhotoFeatures],
    camera_of: Sequence[int],
    cameras: Mapping[int, Any],
    pairs: Sequence[TwoViews],
    settings: MappingSettings,
    seed: int,
    on_photo: Callable[[], None],
) -> Any | None:
    """The largest set of photographs that hang together, as pycolmap's ``Reconstruction``.

    Parameters
    ----------
    names, features, camera_of : per photograph; ``camera_of`` are keys of ``cameras``.
    cameras : pycolmap's, by identifier.
    pairs : the verified pairs.
    settings, seed : how; the same seed gives the same result.
    on_photo : called whenever the incremental mapper has placed one more photograph; what it
        raises ends the mapping.

    Returns
    -------
    The reconstruction, photograph i as image i + 1; None where no set of ``min_photos`` is.
    """
    import pycolmap

    with pycolmap.Database.open(":memory:") as database:
        _fill(database, names, features, camera_of, cameras, pairs)
        manager = pycolmap.ReconstructionManager()
        if settings.mapper == "incremental":
            _map_incrementally(database, manager, settings, seed, on_photo)
        else:
            _map_globally(database, manager, settings, seed)
        found = [manager.get(number) for number in range(manager.size())]
        found = [one for one in found if one.num_reg_images() >= settings.min_photos]
        if not found:
            return None
        best = max(found, key=lambda one: (one.num_reg_images(), one.num_points3D()))
        # The manager's own would go with it.
        return pycolmap.Reconstruction(best)


def adjusted(reconstruction: Any, settings: MappingSettings) -> Any:
    """One last adjustment of all, robustly, with the lens that the photographs bear.

    Mapping leaves outliers of up to four pixels, which pull at squared distances.

    Returns
    -------
    Another reconstruction.
    """
    import pycolmap

    uses = dict.fromkeys(reconstruction.cameras, 0)
    for number in reconstruction.reg_image_ids():
        uses[reconstruction.images[number].camera_id] += 1
    many = {number for number, count in uses.items() if count >= settings.photos_for_full_lens}
    best, cost = pycolmap.Reconstruction(reconstruction), np.inf
    for model, principal_point in _LENSES:
        if (model, principal_point) != _LENSES[0] and (settings.lens == "simple" or not many):
            break
        attempt = pycolmap.Reconstruction(best)
        for number in many:
            _give_lens(attempt.cameras[number], model)
        fixed = set(uses) - many if principal_point else set()
        new_cost = _bundle_adjustment(attempt, principal_point, fixed)
        if settings.lens == "full" or new_cost < (1.0 - settings.worthwhile) * cost:
            best, cost = attempt, new_cost
    best.update_point_3d_errors()
    return best


def _bundle_adjustment(reconstruction: Any, principal_point: bool, fixed: set[int]) -> float:
    """Adjust in place, with the lenses of the cameras ``fixed`` as they are; the final cost."""
    import pycolmap

    config = pycolmap.BundleAdjustmentConfig()
    for number in sorted(reconstruction.reg_image_ids()):
        config.add_image(number)
    for number in fixed:
        config.set_constant_cam_intrinsics(number)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = principal_point
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    options.ceres.loss_function_scale = _OUTLIER_PX
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.function_tolerance = 1e-6
    # pycolmap's own bundle_adjustment() would turn its log on for good.
    summary: Any = pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()
    return float(summary.ceres_summary.final_cost)


def _give_lens(camera: Any, model: str) -> None:
    """Turn a camera into the same one of a model that is at least as rich."""
    import pycolmap

    if model == "OPENCV" and camera.model == pycolmap.CameraModelId.SIMPLE_RADIAL:
        focal, x, y, k = camera.params
        camera.model = pycolmap.CameraModelId.OPENCV
        camera.params = [focal, focal, x, y, k, 0.0, 0.0, 0.0]


def _fill(
    database: Any,
    names: Sequence[str],
    features: Sequence[PhotoFeatures],
    camera_of: Sequence[int],
    cameras: Mapping[int, Any],
    pairs: Sequence[TwoViews],
) -> None:
    """Write all into an empty database, photograph i as image i + 1."""
    import pycolmap

    for number, camera in cameras.items():
        database.write_camera(camera, use_camera_id=True)
        rig = pycolmap.Rig(rig_id=number)
        rig.add_ref_sensor(camera.sensor_id)
        database.write_rig(rig, use_rig_id=True)
    for index, (name, seen) in enumerate(zip(names, features, strict=True)):
        image = pycolmap.Image(
            name=name, camera_id=camera_of[index], image_id=index + 1, keypoints=np.zeros((0, 2))
        )
        database.write_image(image, use_image_id=True)
        frame = pycolmap.Frame(frame_id=index + 1, rig_id=camera_of[index])
        frame.add_data_id(image.data_id)
        database.write_frame(frame, use_frame_id=True)
        database.write_keypoints(index + 1, _keypoints(seen.points))
    for pair in pairs:
        database.write_two_view_geometry(pair.first + 1, pair.second + 1, pair.geometry)


def _keypoints(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows of place, scale and direction, as the database wants them."""
    return np.column_stack([points, np.ones(len(points)), np.zeros(len(points))]).astype(np.float32)


def _map_incrementally(
    database: Any,
    manager: Any,
    settings: MappingSettings,
    seed: int,
    on_photo: Callable[[], None],
) -> None:
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    # More threads add in another order.
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = seed
    options.extract_colors = False
    options.min_model_size = settings.min_photos
    options.ba_global_frames_ratio = settings.growth
    options.ba_global_points_ratio = settings.growth
    options.ba_global_max_refinements = 2
    options.ba_local_max_refinements = 1
    pipeline = pycolmap.IncrementalPipeline(options, database, manager)
    pipeline.add_callback(
        pycolmap.IncrementalPipelineCallback.NEXT_IMAGE_REG_CALLBACK.value, on_photo
    )
    pipeline.run()


def _map_globally(database: Any, manager: Any, settings: MappingSettings, seed: int) -> None:
    import pycolmap

    options = pycolmap.GlobalPipelineOptions()
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = seed
    options.min_model_size = settings.min_photos
    pycolmap.GlobalPipeline(options, database, manager).run()
