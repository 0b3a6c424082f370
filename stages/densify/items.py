"""What is done photograph by photograph."""

from __future__ import annotations

from pathlib import Path
from time import thread_time
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.pipeline.photo_surface import told_camera
from workbench.pipeline.tasks import ItemProducts, Payload

if TYPE_CHECKING:
    from workbench.stereo.matching import DepthEstimate
    from workbench.stereo.views import StereoView


def make_view(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """One photograph without distortion; tells how much of it shows the object."""
    from workbench.formats.photo_reading import read_photo
    from workbench.stereo.views import stereo_view

    name = payload["name"]
    camera = told_camera(payload["camera"], payload["image_px"])
    mask = products.load("photo_masks", name) if payload["mask"] else None
    view = stereo_view(read_photo(Path(payload["path"])), mask, camera)
    products.save("stereo_views", view.arrays(), name)
    rows, columns = np.flatnonzero(view.usable.any(axis=1)), np.flatnonzero(view.usable.any(axis=0))
    across = max((np.ptp(rows), np.ptp(columns))) if len(rows) else 0
    return {"usable": int(view.usable.sum()), "share": float(across / min(view.usable.shape))}


def estimate_depth(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """One photograph's depth map from what its neighbours show."""
    from workbench.stereo.matching import MatchingSettings, matched

    start = thread_time()
    view, *others = _views(products, payload)
    settings = MatchingSettings(**payload["settings"])
    given = (tuple(payload["span"]), settings, payload["seed"])
    found = matched(view, others, *given, last=payload["last"])
    return _kept(products, "depth_estimates", found, view, payload["name"], thread_time() - start)


def better_estimate(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """One photograph's depth map, bettered by those of its neighbours."""
    from workbench.stereo.matching import MatchingSettings, agreed

    start = thread_time()
    view, *others = _views(products, payload)
    own, *known = _estimates(products, payload, [view, *others])
    settings = MatchingSettings(**payload["settings"])
    nearness = [one.nearness for one in known]
    found = agreed(view, others, own, nearness, tuple(payload["span"]), settings, payload["seed"])
    return _kept(products, "better_estimates", found, view, payload["name"], thread_time() - start)


def make_range_map(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """What of one photograph's depth map the others agree with, as a range map."""
    from workbench.stereo.agreement import AgreementSettings, agreed_range_map

    name = payload["name"]
    view, *others = _views(products, payload)
    own, *known = _estimates(products, payload, [view, *others])
    found = agreed_range_map(
        name, view, others, own, known, AgreementSettings(**payload["settings"])
    )
    scan = found.range_map
    products.save("photo_range_maps", scan, name)
    assert scan.world_from_scan is not None
    assert scan.sigma_m is not None
    agreeing = found.views[found.views >= min(payload["settings"]["least_views"], len(others))]
    kept = len(scan) > 0
    return {
        "name": name,
        "samples": len(scan),
        "color": False,
        "scan_shift_m": [0.0, 0.0, 0.0],
        "world_from_scan": scan.world_from_scan.tolist(),
        "grid": list(view.grey.shape),
        "mean_views": float(agreeing.mean()) if kept else 0.0,
        "sigma_m": float(np.median(scan.sigma_m)) if kept else 0.0,
    }


def _views(products: ItemProducts, payload: Payload) -> list[StereoView]:
    from workbench.stereo.views import StereoView

    names = (payload["name"], *payload["others"])
    return [StereoView.from_arrays(products.load("stereo_views", name)) for name in names]


def _estimates(
    products: ItemProducts, payload: Payload, views: list[StereoView]
) -> list[DepthEstimate]:
    from workbench.stereo.matching import DepthEstimate

    names = (payload["name"], *payload["others"])
    return [
        DepthEstimate.from_arrays(products.load(payload["from"], name), view.usable)
        for name, view in zip(names, views, strict=True)
    ]


def _kept(
    products: ItemProducts,
    artefact: str,
    found: DepthEstimate,
    view: StereoView,
    name: str,
    seconds: float,
) -> dict[str, Any]:
    products.save(artefact, found.arrays(view.usable), name)
    return {"seconds": seconds}
