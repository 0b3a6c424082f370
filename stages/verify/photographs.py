"""What is to be said of the photographs themselves."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.verification.report_content import Section

_TRUTHS_SHOWN = 2


def photographs_chapter(
    products: Products, records: list[dict[str, Any]]
) -> tuple[tuple[Section, ...], list[str]]:
    """The section on the photographs, where there are any, and warnings."""
    from workbench.verification.photo_sections import PhotoTruth, evenly_chosen, photographs_section

    paths = products.input_paths("photo_files")
    if not paths:
        return (), []
    names = {path.name for path in paths}
    used_by = [
        record["stage"]
        for record in records
        if any(Path(entry["path"]).name in names for entry in record.get("inputs", ()))
    ]
    masked = set(products.items("truth_object"))
    truths = [
        PhotoTruth(
            photo,
            products.load_if_there("truth_albedo", photo.stem),
            *(
                products.load(name, photo.stem)
                for name in ("truth_object", "truth_support", "truth_shadow")
            ),
        )
        for photo in evenly_chosen([path for path in paths if path.stem in masked], _TRUTHS_SHOWN)
    ]
    section, warnings = photographs_section(paths, used_by, truths)
    return (section,), warnings
