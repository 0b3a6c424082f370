"""Small DNG files with known digital numbers."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.formats.dng import DngMetadata, write_dng

BLACK, WHITE = 500, 12500
METADATA = DngMetadata(
    make="Maker",
    model="Maker Camera One",
    lens_model="A 35 mm lens",
    serial_number="1",
    software="test",
    taken_at=datetime(2024, 3, 2, 10, 11, 12),
    cfa="RGGB",
    black_level=BLACK,
    white_level=WHITE,
    color_matrix_a=np.array([[0.9, -0.2, -0.1], [-0.4, 1.2, 0.2], [-0.1, 0.2, 0.7]]),
    color_matrix_d65=np.array([[0.8, -0.2, -0.1], [-0.4, 1.2, 0.3], [-0.1, 0.2, 0.8]]),
    as_shot_neutral=(0.5, 1.0, 0.8),
    noise_profile=None,
    exposure_time_s=1 / 125,
    f_number=8.0,
    iso=400,
    focal_length_mm=35.0,
    pixel_pitch_mm=0.02,
    focal_length_35mm=52,
    flash_fired=True,
)

WriteDng = Callable[..., Path]


@pytest.fixture
def dng(tmp_path: Path) -> WriteDng:
    """A function from a mosaic (rows, cols) to a DNG; keywords change what its tags say."""

    def write(
        mosaic: NDArray[Any], name: str = "shot", orientation: int = 1, **changes: Any
    ) -> Path:
        path = tmp_path / f"{name}.dng"
        write_dng(path, np.asarray(mosaic, np.uint16), replace(METADATA, **changes))
        if orientation != 1:
            data = path.read_bytes()
            upright, turned = (struct.pack("<HHIH", 274, 3, 1, k) for k in (1, orientation))
            assert data.count(upright) == 1
            path.write_bytes(data.replace(upright, turned))
        return path

    return write


@pytest.fixture
def gradient() -> NDArray[np.uint16]:
    """A mosaic (48, 64) whose numbers differ everywhere and leave room above and below."""
    rng = np.random.default_rng(4)
    down, right = np.mgrid[0:48, 0:64]
    return (BLACK + 1500 + 60 * right + 40 * down + rng.integers(0, 50, (48, 64))).astype(np.uint16)
