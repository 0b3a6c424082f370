"""The pictures masks are drawn on, ready for a browser."""

from __future__ import annotations

from collections import OrderedDict

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.photo_preview import read_preview
from workbench.project.mask_subjects import photos_by_name, subject_picture
from workbench.project.project import Project
from workbench.project.user_masks import Subject

# Browsers on small machines show no larger picture; masks keep the full size all the same.
LONGEST_SIDE_PX = 6144
_THUMBNAIL_PX = 160
_JPEG_QUALITY = 92
# One to draw on, and the next.
_KEPT = 2


class MaskPictures:
    """Pictures of a project's subjects; the last two stay in memory."""

    def __init__(self, project: Project) -> None:
        self._project = project
        self._kept: OrderedDict[Subject, NDArray[np.uint8]] = OrderedDict()

    def picture(self, subject: Subject) -> NDArray[np.uint8]:
        """The picture (h, w, 3) uint8 sRGB at the subject's size.

        Raises
        ------
        InputError
            When there is none, or it cannot be read.
        """
        if subject.size is None:
            raise InputError(
                "The scan has no grid, so there is no picture of it", file=subject.file
            )
        if subject not in self._kept:
            self._kept[subject] = subject_picture(self._project, subject)
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(subject)
        return self._kept[subject]

    def jpeg(self, subject: Subject) -> bytes:
        """The picture as a JPEG file, reduced to `LONGEST_SIDE_PX` where it is larger."""
        return _jpeg(_reduced(self.picture(subject), LONGEST_SIDE_PX))

    def thumbnail(self, subject: Subject) -> bytes:
        """A small JPEG file for a list."""
        if subject.kind == "photo":
            path = photos_by_name(self._project.photo_files)[subject.name]
            return _jpeg(read_preview(path, _THUMBNAIL_PX))
        return _jpeg(_reduced(subject_picture(self._project, subject), _THUMBNAIL_PX))


def _reduced(picture: NDArray[np.uint8], side_px: int) -> NDArray[np.uint8]:
    height, width = picture.shape[:2]
    share = side_px / max(height, width)
    if share >= 1:
        return picture
    size = (max(1, round(width * share)), max(1, round(height * share)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _jpeg(picture: NDArray[np.uint8]) -> bytes:
    bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return encoded.tobytes()
