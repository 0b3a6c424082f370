"""Mask away what is not the object: in range maps and in photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from workbench.metrics import Metric
from workbench.pipeline.knobs import Knob
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.pipeline.tasks import ItemProducts, Payload
from workbench.project.mask_subjects import photos_by_name, scan_subjects, subjects_of
from workbench.project.project import Project, Scene
from workbench.project.settings import StageOptions
from workbench.project.user_masks import Kind, Subject, masks_by_subject, read_mask

if TYPE_CHECKING:
    from workbench.geometry.rangemap import RangeMap
    from workbench.masking.classifier import ClassifierOptions
    from workbench.masking.range_maps import RangeMapMaskingOptions
    from workbench.masking.segmentation import SegmentationOptions

_SUGGESTION_PX = 400


class MaskOptions(StageOptions):
    """Options of ``mask``."""

    training: Literal["object", "clutter"] = Field(
        "object",
        description="What the training masks tell: everything, or black on some of the clutter "
        "and white on what they leave open.",
    )
    bins: int = Field(
        32,
        ge=2,
        le=256,
        description="Levels of reflectance, of hue and of saturation (Jaspe 2018, 3.4.3: 32).",
    )
    trees: int = Field(
        30,
        ge=0,
        le=1000,
        description="Trees of the forest that looks at photographs; 0 goes by the histogram of "
        "hue and saturation alone (Jaspe 2018, 3.4.3).",
    )
    cut: Literal["evidence", "grabcut"] = Field(
        "evidence",
        description="How a photograph is cut: by what was learned, or by its own colours from "
        "there on (Jaspe 2018, 3.4.3).",
    )
    smoothness: float = Field(
        32.0, ge=0.0, le=1e3, description="What a boundary costs in photographs, log-odds a pixel."
    )
    median_px: int = Field(
        5,
        ge=0,
        le=31,
        description="Side of the median filter on photographs' masks (Jaspe 2018, 3.4.3: 5).",
    )
    erosion_px: int | None = Field(
        None,
        ge=0,
        le=64,
        description="How far an octagon eats into photographs' masks; a thousandth of their longer "
        "side where nothing is said, which makes the 4 of ten megapixels in Jaspe 2018, 3.4.3.",
    )
    scan_keep_odds: float = Field(
        2.0,
        gt=0.0,
        le=1e6,
        description="A sample is kept where the object is so many times likelier than clutter.",
    )
    scan_smoothness: float = Field(
        1.0, ge=0.0, le=1e3, description="What a border costs within a scan's surface, log-odds."
    )
    scan_median_px: int = Field(
        0, ge=0, le=31, description="Side of the median filter on scans' masks; odd."
    )
    scan_erosion_px: int = Field(
        0,
        ge=0,
        le=64,
        description="How far an octagon eats into scans' masks, from clutter and from steps.",
    )
    flash_shadows: bool = Field(
        True, description="Mask the support's sharp flash shadows too (Jaspe 2018, 3.4.2)."
    )


def needed(scene: Scene, options: MaskOptions) -> Need:
    if not (scene.scans or scene.photos):
        return Need(False, "neither scans nor photographs")
    if scene.training_masks or scene.corrected_masks:
        drawn = [(scene.training_masks, "to learn from"), (scene.corrected_masks, "corrected")]
        told = [f"{count} mask{'s' * (count > 1)} {what}" for count, what in drawn if count]
        return Need(True, " and ".join(told))
    if scene.reflectance_populations == 2:
        return Need(
            False,
            "no training masks, though the reflectance shows two kinds of surface: "
            "workbench mask --suggest names the scans to draw one for, if one kind is clutter",
        )
    one = " and the reflectance is of one kind" if scene.reflectance_populations == 1 else ""
    return Need(False, f"no training masks{one}")


def estimate(scene: Scene, options: MaskOptions) -> Estimate:
    # A photograph of 50 million pixels takes some 2 GiB; one per worker is open.
    one = 2**31 if scene.photos else 6 * scene.scan_bytes // max(scene.scans, 1)
    return Estimate(one if scene.photos else 6 * scene.scan_bytes + 2**28, 2**24, item_bytes=one)


def run(job: Job[MaskOptions]) -> StageResult:
    products = job.products
    photos = photos_by_name(products.input_paths("photo_files"))
    inventory = products.load_if_there("scan_inventory") or {}
    subjects = subjects_of(inventory, products.input_paths("photo_files"))
    training = masks_by_subject(products.input_paths("training_masks"), subjects)
    corrected = masks_by_subject(products.input_paths("corrected_masks"), subjects)
    for drawn in (training, corrected):
        for subject, path in drawn.items():
            read_mask(path, _size(subject))  # every mistake is told before any work
    kinds: tuple[Kind, ...] = ("scan", "photo")
    done = [_masked(job, kind, subjects, training, corrected, photos) for kind in kinds]
    warnings = [text for result in done for text in result.warnings]
    without = [s.name for s in subjects if s.size is None]
    if without and training:
        warnings.append(f"not masked, for they have no grid: {', '.join(without)}")
    metrics = tuple(metric for result in done for metric in result.metrics)
    return StageResult(metrics, tuple(warnings))


def _masked(
    job: Job[MaskOptions],
    kind: Kind,
    subjects: Sequence[Subject],
    training: Mapping[Subject, Path],
    corrected: Mapping[Subject, Path],
    photos: Mapping[str, Path],
) -> StageResult:
    """All range maps, or all photographs."""
    products, options = job.products, job.options
    members = [s for s in subjects if s.kind == kind and s.size is not None]
    taught = {s: path for s, path in training.items() if s.kind == kind}
    warnings: list[str] = []
    if taught:
        warnings += (
            _learn_scans(job, taught) if kind == "scan" else _learn_photos(job, taught, photos)
        )
    # A training mask that tells everything is as good as a correction.
    whole = taught if options.training == "object" else {}
    drawn = {s: path for s, path in (whole | dict(corrected)).items() if s.kind == kind}
    chosen = [s for s in members if taught or s in drawn]
    common: dict[str, Any] = {
        "masker": products.content_hash(f"{kind}_masker") if taught else None,
        "options": options.model_dump(),
    }
    items = {}
    for subject in chosen:
        path = drawn.get(subject)
        items[subject.name] = common | {
            "name": subject.name,
            "size": list(_size(subject)),
            "content": products.input_hash(photos[subject.name])
            if kind == "photo"
            else products.content_hash("range_maps", subject.name),
            "path": str(photos[subject.name]) if kind == "photo" else None,
            "drawn": None if path is None else [str(path), products.input_hash(path)],
        }
    function = mask_scan if kind == "scan" else mask_photo
    plural = "scans" if kind == "scan" else "photographs"
    found = job.tasks.map_items(f"masking {plural}", function, items) if items else {}
    products.remove_items_except(f"{kind}_masks", set(items))
    products.remove_items_except(f"automatic_{kind}_masks", set(items) if taught else set())
    return StageResult(
        _metrics(kind, plural, found, len(members), len(drawn)), (*warnings, *_odd(found))
    )


def _learn_scans(job: Job[MaskOptions], taught: Mapping[Subject, Path]) -> list[str]:
    from workbench.masking.range_maps import learned_range_maps

    examples = [
        (job.products.load("range_maps", subject.name), read_mask(path, _size(subject)))
        for subject, path in taught.items()
    ]
    masker = learned_range_maps(
        examples, _range_map_options(job.options), clutter_only=job.options.training == "clutter"
    )
    job.products.save("scan_masker", masker.arrays())
    told = masker.separability
    return [] if told else [f"scans: {told.reason}; correct their masks by hand"]


def _learn_photos(
    job: Job[MaskOptions], taught: Mapping[Subject, Path], photos: Mapping[str, Path]
) -> list[str]:
    from workbench.formats.photo_reading import read_photo
    from workbench.masking.classifier import trained
    from workbench.masking.histograms import Example, learned, learned_from_clutter, separability

    examples = [
        Example(read_photo(photos[subject.name]), read_mask(path, _size(subject)))
        for subject, path in taught.items()
    ]
    learn = learned if job.options.training == "object" else learned_from_clutter
    masker = trained(examples, _classifier_options(job.options), learn)
    job.products.save("photo_masker", masker.arrays())
    told = separability(masker.appearance)
    return [] if told else [f"photographs: {told.reason}; correct their masks by hand"]


def mask_scan(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """One range map's mask, as found and with the user's word over it."""
    from workbench.masking.range_maps import RangeMapClassifier, mask_of_range_map

    name, start = payload["name"], perf_counter()
    scan = products.load("range_maps", name)
    automatic = None
    if payload["masker"]:
        masker = RangeMapClassifier.from_arrays(products.load("scan_masker"))
        options = MaskOptions(**payload["options"])
        automatic = mask_of_range_map(scan, masker, _range_map_options(options))
    assert scan.grid is not None
    seconds = perf_counter() - start
    return _saved(products, "scan", payload, automatic, scan.grid >= 0, seconds)


def mask_photo(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """One photograph's mask, as found and with the user's word over it."""
    from workbench.formats.photo_reading import read_photo
    from workbench.masking.classifier import Classifier
    from workbench.masking.flash_shadow import flash_shadows_by_value
    from workbench.masking.segmentation import segmented

    start, automatic = perf_counter(), None
    if payload["masker"]:
        options = MaskOptions(**payload["options"])
        photo = read_photo(Path(payload["path"]))
        masker = Classifier.from_arrays(products.load("photo_masker"))
        automatic = segmented(
            photo, masker.probability(photo), _segmentation_options(options, max(photo.shape))
        )
        if options.flash_shadows:
            automatic[flash_shadows_by_value(photo, automatic)] = 0
    width, height = payload["size"]
    counted = np.ones((height, width), bool)
    return _saved(products, "photo", payload, automatic, counted, perf_counter() - start)


def _saved(
    products: ItemProducts,
    kind: Kind,
    payload: Payload,
    automatic: NDArray[np.uint8] | None,
    counted: NDArray[np.bool_],
    seconds: float,
) -> dict[str, Any]:
    name, mask = payload["name"], automatic
    if automatic is not None:
        products.save(f"automatic_{kind}_masks", automatic, name)
    if payload["drawn"]:
        width, height = payload["size"]
        mask = read_mask(Path(payload["drawn"][0]), (width, height))
    products.save(f"{kind}_masks", mask, name)
    kept = int(((mask > 127) & counted).sum()) if mask is not None else 0
    return {"seconds": seconds, "kept": kept, "of": int(counted.sum())}


def _metrics(
    kind: Kind, plural: str, found: Mapping[str, Mapping[str, Any]], members: int, drawn: int
) -> tuple[Metric, ...]:
    if not found:
        return ()
    what = "samples of masked scans" if kind == "scan" else "pixels of masked photographs"
    kept, total = (sum(item[key] for item in found.values()) for key in ("kept", "of"))
    return (
        Metric(plural, members, "", f"All {plural} that can have a mask."),
        Metric(f"{plural}_masked", len(found), "", f"How many {plural} have a mask."),
        Metric(f"{plural}_masked_by_hand", drawn, "", f"Masks of {plural} as the user drew them."),
        Metric(f"{plural}_kept", 100.0 * kept / max(total, 1), "%", f"Of the {what}, kept."),
        Metric(
            f"{plural}_mask_seconds",
            float(np.median([item["seconds"] for item in found.values()])),
            "s",
            f"Time per mask of {plural}, median.",
        ),
    )


def _odd(found: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    odd = [(name, item) for name, item in found.items() if item["kept"] in (0, item["of"])]
    return tuple(
        f"{name}: the mask keeps {'everything' if item['kept'] else 'nothing'}"
        for name, item in odd
    )


def _size(subject: Subject) -> tuple[int, int]:
    assert subject.size is not None
    return subject.size


def _classifier_options(options: MaskOptions) -> ClassifierOptions:
    from workbench.masking.classifier import PAPER, ClassifierOptions

    chosen = ClassifierOptions(trees=options.trees) if options.trees else PAPER
    return replace(chosen, bins=options.bins)


def _range_map_options(options: MaskOptions) -> RangeMapMaskingOptions:
    from workbench.masking.range_maps import RangeMapMaskingOptions

    return RangeMapMaskingOptions(
        bins=options.bins,
        keep_odds=options.scan_keep_odds,
        smoothness=options.scan_smoothness,
        median_px=options.scan_median_px,
        erosion_px=options.scan_erosion_px,
    )


def _segmentation_options(options: MaskOptions, longer_side_px: int) -> SegmentationOptions:
    from workbench.masking.segmentation import SegmentationOptions

    return SegmentationOptions(
        method=options.cut,
        smoothness=options.smoothness,
        median_px=options.median_px,
        erosion_px=longer_side_px // 1000 if options.erosion_px is None else options.erosion_px,
    )


def suggest(project: Project, wanted: int) -> list[dict[str, str]]:
    """The scans and photographs whose masks would teach most, the most useful first.

    Parameters
    ----------
    wanted : how many scans, and how many photographs.
    """
    from workbench.formats.photo_preview import read_preview
    from workbench.masking.range_map_signal import range_map_picture
    from workbench.masking.suggestion import suggested

    def seen(scan: RangeMap) -> NDArray[np.float32]:
        """What a scan shows, in [0, 1]; NaN where it has no sample."""
        grey = range_map_picture(scan)[..., 1].astype(np.float32) / np.float32(255.0)
        assert scan.grid is not None
        return np.where(scan.grid >= 0, grey, np.float32(np.nan))

    store, found = project.store, []
    known = store.load("scan_inventory") if store.exists("scan_inventory") else {}
    scans = [subject for subject in scan_subjects(known) if subject.size]
    photos = photos_by_name(project.photo_files)
    if scans:
        maps = (seen(store.load("range_maps", subject.name)) for subject in scans)
        found += [
            {"kind": "scan", "name": scans[k].name, "file": scans[k].file}
            for k in suggested(maps, wanted)
        ]
    if photos:
        names = list(photos)
        previews = (read_preview(path, _SUGGESTION_PX) for path in photos.values())
        found += [
            {"kind": "photo", "name": names[k], "file": photos[names[k]].name}
            for k in suggested(previews, wanted)
        ]
    return found


MASK = Stage(
    name="mask",
    version=2,
    summary="Masks clutter away in scans and photographs, learned from a few drawn masks.",
    options=MaskOptions,
    reads=("scan_inventory", "range_maps", "photo_files", "training_masks", "corrected_masks"),
    writes=(
        "scan_masker",
        "photo_masker",
        "automatic_scan_masks",
        "automatic_photo_masks",
        "scan_masks",
        "photo_masks",
    ),
    needed=needed,
    run=run,
    libraries=("numpy", "opencv-contrib-python-headless", "rawpy", "PyMaxflow", "scikit-learn"),
    estimate=estimate,
    knobs=(Knob("trees", (0, 5, 10, 30, 60), quick=(0,)),),
    suggest=suggest,
)
