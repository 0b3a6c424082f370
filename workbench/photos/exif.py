"""What a photograph's file tells of how it was taken (Exif 2.32, CIPA DC-008)."""

from __future__ import annotations

import io
import logging
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from workbench.formats.photo_reading import PLAIN_SUFFIXES, opened_raw, readable

_FIRED = 1
# Canon's CRW files keep their EXIF in a small picture beside them.
_SIDECAR_SUFFIXES = (".THM", ".thm", ".Thm")
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0}
_FULL_FRAME_MM = 36.0
# A camera's file takes some hundreds, hardly one of them behind its end.
_MOST_READS, _READS_BEHIND_THE_END = 20_000, 200


@dataclass(frozen=True)
class PhotoFacts:
    """How a photograph was taken; None for what its file does not tell.

    Attributes
    ----------
    camera, lens : maker and model.
    focal_length_mm : as engraved.
    focal_length_35mm : equivalent for a frame 36 mm wide.
    pixel_pitch_mm : distance between photosites.
    exposure_time_s, f_number, iso : the exposure.
    flash_fired : whether the flash lit it.
    subject_distance_m : as the focus tells.
    taken_at : local time, ``YYYY:MM:DD hh:mm:ss``.
    """

    camera: str | None = None
    lens: str | None = None
    focal_length_mm: float | None = None
    focal_length_35mm: float | None = None
    pixel_pitch_mm: float | None = None
    exposure_time_s: float | None = None
    f_number: float | None = None
    iso: float | None = None
    flash_fired: bool | None = None
    subject_distance_m: float | None = None
    taken_at: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)

    def focal_length_px(self, longer_side_px: int) -> float | None:
        """Focal length in pixels of a picture with that longer side, where it can be told."""
        if self.focal_length_35mm:
            return self.focal_length_35mm / _FULL_FRAME_MM * longer_side_px
        if self.focal_length_mm and self.pixel_pitch_mm:
            return self.focal_length_mm / self.pixel_pitch_mm
        return None


def photo_facts(path: Path) -> PhotoFacts:
    """Camera, lens and exposure of a photograph, from its EXIF, a ``.THM`` beside it or LibRaw.

    Raises
    ------
    InputError
        When a RAW file without EXIF cannot be read.
    """
    tags = _tags(path) or _tags(_sidecar(path))
    facts = _facts(tags)
    if path.suffix.lower() in PLAIN_SUFFIXES or _complete(facts):
        return facts
    return _completed(facts, path)


def sidecar_files(path: Path) -> tuple[Path, ...]:
    """The files beside a photograph that its facts come from."""
    beside = _sidecar(path)
    return () if beside is None else (beside,)


def _sidecar(path: Path) -> Path | None:
    if path.suffix.lower() != ".crw":
        return None
    return next((p for s in _SIDECAR_SUFFIXES if (p := path.with_suffix(s)).is_file()), None)


def _tags(path: Path | None) -> dict[str, Any]:
    if path is None:
        return {}
    import exifread

    logging.getLogger("exifread").setLevel(logging.CRITICAL)
    try:
        with _BoundedReads(io.FileIO(path)) as file:
            return dict(exifread.process_file(file, details=False))
    except Exception:  # EXIF is a help and no condition; the pixels' own reader has the last word
        return {}


class _BoundedReads(io.BufferedReader):
    """A file that is asked so often at most: damaged counts ask for millions of tags."""

    left = _MOST_READS

    def read(self, size: int | None = -1, /) -> bytes:
        content = super().read(size)
        self.left -= 1 if content else _READS_BEHIND_THE_END
        if self.left < 0:
            raise OSError("more tags than any camera writes")
        return content


def _facts(tags: dict[str, Any]) -> PhotoFacts:
    flash, unit = _number(tags, "Flash"), _number(tags, "FocalPlaneResolutionUnit")
    per_unit = _number(tags, "FocalPlaneXResolution")
    pitch = _MM_PER_UNIT.get(int(unit or 2), 25.4) / per_unit if per_unit else None
    make, model = _text(tags, "Make"), _text(tags, "Model")
    # A maker of blanks has no first word.
    brand = (make or "").split()[:1]
    camera = model if brand and model and model.startswith(brand[0]) else None
    return PhotoFacts(
        camera=camera or " ".join(part for part in (make, model) if part) or None,
        lens=_text(tags, "LensModel"),
        focal_length_mm=_number(tags, "FocalLength"),
        focal_length_35mm=_number(tags, "FocalLengthIn35mmFilm"),
        pixel_pitch_mm=pitch,
        exposure_time_s=_number(tags, "ExposureTime"),
        f_number=_number(tags, "FNumber"),
        iso=_number(tags, "ISOSpeedRatings") or _number(tags, "PhotographicSensitivity"),
        # 0 is an answer: no flash.
        flash_fired=None if flash is None else bool(int(flash) & _FIRED),
        subject_distance_m=_number(tags, "SubjectDistance") or None,
        taken_at=_text(tags, "DateTimeOriginal") or _text(tags, "DateTime"),
    )


def _find(tags: dict[str, Any], name: str) -> Any:
    return tags.get(f"EXIF {name}") or tags.get(f"Image {name}")


def _text(tags: dict[str, Any], name: str) -> str | None:
    found = _find(tags, name)
    return (str(found).strip("\0 ") or None) if found is not None else None


def _number(tags: dict[str, Any], name: str) -> float | None:
    found = _find(tags, name)
    if found is None:
        return None
    try:
        value = float(found.values[0])
    except (TypeError, ValueError, IndexError, ZeroDivisionError):
        return None
    return value if value >= 0.0 else None


def _complete(facts: PhotoFacts) -> bool:
    return None not in (facts.exposure_time_s, facts.f_number, facts.iso, facts.camera)


def _completed(facts: PhotoFacts, path: Path) -> PhotoFacts:
    """With what LibRaw finds in makers' own notes, where EXIF does not tell."""
    with readable(path), opened_raw(path) as raw:
        other, lens = raw.other, raw.lens
        return replace(
            facts,
            lens=facts.lens or lens.model or None,
            focal_length_mm=facts.focal_length_mm or other.focal_length or None,
            exposure_time_s=facts.exposure_time_s or other.shutter_speed or None,
            f_number=facts.f_number or other.aperture or None,
            iso=facts.iso or other.iso_speed or None,
        )
