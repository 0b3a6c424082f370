"""What is to be said of the masks, gathered from the project."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from workbench.formats.mask_png import read_mask_png
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.metrics import Metric
from workbench.pipeline.stage import Products
from workbench.project.mask_subjects import photos_by_name, subjects_of
from workbench.project.user_masks import masks_by_subject
from workbench.verification.photo_sections import evenly_chosen

if TYPE_CHECKING:
    from workbench.verification.mask_errors import CheckedMasks, MaskedSamples
    from workbench.verification.mask_sections import MaskedKind, ShownMask
    from workbench.verification.photo_coverage import MaskedPhoto
    from workbench.verification.report_content import Section

_MASKS_SHOWN = 6


def masks_chapter(
    products: Products, truth_known: bool
) -> tuple[tuple[Section, ...], list[Metric]]:
    """The section on masks, where there are any, and how wrong they are as far as is known."""
    from workbench.verification.mask_sections import masks_section

    kinds = [
        kind
        for kind in (_masked_scans(products, truth_known), _masked_photos(products))
        if kind is not None
    ]
    metrics = [m for k in kinds if k.checked is not None for m in k.checked.metrics(k.plural)]
    return ((masks_section(kinds),) if kinds else ()), metrics


def _masked_scans(products: Products, truth_known: bool) -> MaskedKind | None:
    from workbench.masking.range_map_signal import range_map_picture
    from workbench.verification.mask_errors import checked_scan_masks
    from workbench.verification.mask_sections import ShownMask

    names = products.items("scan_masks")
    if not names:
        return None
    known = set(products.items("truth_scan_masks"))
    shown = [
        ShownMask(
            name,
            range_map_picture(products.load("range_maps", name)),
            products.load("scan_masks", name),
            products.load("truth_scan_masks", name) if name in known else None,
        )
        for name in evenly_chosen(names, _MASKS_SHOWN)
    ]
    checked, truth = against_corrections(products, "scan")
    if truth_known:
        # A sample as near as its neighbours tells of the same place.
        radius = max(1e-3, products.load("simulation")["nominal_sample_spacing_m"])
        samples = [masked_samples(products, name) for name in names if name in known]
        checked, truth = checked_scan_masks(samples, radius), "the simulated truth"
    return _told(products, "scans", shown, checked, truth)


def masked_samples(products: Products, name: str) -> MaskedSamples:
    """One scan's samples, what is true of them and what its masks say."""
    from workbench.verification.mask_errors import MaskedSamples

    arrays, used = products.load("truth_samples", name), products.load("scan_masks", name)
    found = _automatic(products, "scan", name, used)
    # A beam across an edge, or of a speck of dust, is neither the object nor its support.
    sound = ~(arrays["is_mixed"] | arrays["is_stray"])
    return MaskedSamples(
        arrays["true_points_in_local"],
        sound & (arrays["material"] == 0),
        sound & (arrays["material"] != 0),
        found.flat[arrays["pixel"]] > 127,
        used.flat[arrays["pixel"]] > 127,
    )


def _masked_photos(products: Products) -> MaskedKind | None:
    from workbench.formats.photo_reading import read_photo
    from workbench.verification.mask_sections import ShownMask

    paths = photos_by_name(products.input_paths("photo_files"))
    names = [name for name in products.items("photo_masks") if name in paths]
    if not names:
        return None
    known = set(products.items("truth_object"))
    shown = [
        ShownMask(
            name,
            read_photo(paths[name]),
            products.load("photo_masks", name),
            read_mask_png(products.load("truth_object", name)) if name in known else None,
        )
        for name in evenly_chosen([n for n in names if n in known] or names, _MASKS_SHOWN)
    ]
    checked, truth = against_corrections(products, "photo")
    if known:
        checked, truth = photo_errors(products, names), "the simulated truth"
    return _told(products, "photographs", shown, checked, truth)


def photo_errors(products: Products, names: list[str]) -> CheckedMasks:
    """Errors of photographs' masks against a simulation's truth."""
    from workbench.formats.colmap import read_colmap_text
    from workbench.verification.photo_coverage import checked_photo_masks

    cameras = read_colmap_text(products.load("truth_cameras").parent).photo_cameras()
    kept = {name: camera for name, camera in cameras.items() if name in names}
    arrays = products.load("truth_surface")
    surface = TriangleMesh(arrays["vertices"], arrays["triangles"])
    return checked_photo_masks(_MaskedPhotos(products, kept), surface)


@dataclass(frozen=True)
class _MaskedPhotos:
    """Photographs whose masks are read when it is their turn: all together would take gibibytes."""

    products: Products
    cameras: Mapping[str, PhotoCamera]

    def __iter__(self) -> Iterator[MaskedPhoto]:
        from workbench.verification.photo_coverage import MaskedPhoto

        products = self.products
        for name, camera in self.cameras.items():
            used = products.load("photo_masks", name)
            yield MaskedPhoto(
                camera,
                read_mask_png(products.load("truth_object", name)),
                read_mask_png(products.load("truth_support", name)) > 127,
                _automatic(products, "photo", name, used),
                used,
            )


def _automatic(
    products: Products, kind: str, name: str, used: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """The mask as found; where nothing was learned, the one that was drawn."""
    found = products.load_if_there(f"automatic_{kind}_masks", name)
    return used if found is None else cast("NDArray[np.uint8]", found)


def against_corrections(products: Products, kind: str) -> tuple[CheckedMasks | None, str]:
    """The masks as found against those the user corrected."""
    from workbench.masking.evaluation import joined_errors, masking_errors
    from workbench.verification.mask_errors import CheckedMasks

    files, there = products.input_paths("corrected_masks"), set()
    if files:
        known = products.load_if_there("scan_inventory") or {}
        subjects = subjects_of(known, products.input_paths("photo_files"))
        there = {s.name for s in masks_by_subject(files, subjects) if s.kind == kind}
    both = there & set(products.items(f"automatic_{kind}_masks"))
    if not both:
        return None, ""
    used = {name: products.load(f"{kind}_masks", name) for name in sorted(both)}
    found = joined_errors(
        masking_errors(products.load(f"automatic_{kind}_masks", name), mask)
        for name, mask in used.items()
    )
    right = joined_errors(masking_errors(mask, mask) for mask in used.values())
    return CheckedMasks(found, right), f"the {len(both)} corrected by hand"


def _told(
    products: Products,
    plural: str,
    shown: list[ShownMask],
    checked: CheckedMasks | None,
    truth: str,
) -> MaskedKind:
    from workbench.verification.mask_sections import MaskedKind

    record = products.load("records", "mask")
    said = {metric["name"]: metric["value"] for metric in record["metrics"]}
    return MaskedKind(
        plural,
        masked=said[f"{plural}_masked"],
        of=said[plural],
        by_hand=said[f"{plural}_masked_by_hand"],
        seconds=said[f"{plural}_mask_seconds"],
        shown=shown,
        checked=checked,
        truth=truth,
    )
