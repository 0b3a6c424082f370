from __future__ import annotations

import numpy as np
import pytest

from workbench.metrics import Metric


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20250304)


def record(stage: str, minute: int, inputs: list[dict], outputs: list[dict], **more) -> dict:
    """A stage record as the pipeline writes it."""
    return {
        "stage": stage,
        "version": 1,
        "state": "done",
        "started": f"2025-03-04T10:{minute:02d}:00+00:00",
        "ended": f"2025-03-04T10:{minute:02d}:30+00:00",
        "seconds": 30.25 + minute,
        "cpu_seconds": 55.5,
        "peak_rss_bytes": 512_000_000,
        "options": {"voxel_size_m": 0.0005, "solver": {"depth": 9}},
        "libraries": {"scan-workbench": "0.1.0", "open3d": "0.20.0", "gdal": "not installed"},
        "inputs": inputs,
        "outputs": outputs,
        "metrics": [],
        "warnings": [],
        "reason": "never ran",
        "host": {"system": "Linux x86_64", "cores": 2, "memory_bytes": 8_000_000_000},
    } | more


def file(artefact: str, path: str, digit: str) -> dict:
    return {
        "artefact": artefact,
        "path": path,
        "hash": f"blake2b:{digit * 32}",
        "bytes": 1_234_567,
    }


@pytest.fixture(scope="session")
def records() -> list[dict]:
    """Three stages that ran and one that was left out."""
    scans = [file("scan", "input/a b.ply", "1"), file("scan", "input/b.ply", "2")]
    stored = [file("scans", "work/ingest/scans.npz", "3")]
    poses = [file("poses", "work/register/scan_poses.json", "4")]
    surface = [file("surface", "exports/surface.ply", "5")]
    rms = Metric("residual_rms", 8.125e-5, "m", "Distance between scans.", ("<=", 2e-4))
    closed = Metric("watertight", True, "", "Every edge joins two triangles.", ("==", 1))
    return [
        record("ingest", 0, scans, stored),
        record("register", 1, stored, poses, metrics=[rms.as_dict()], warnings=["few <samples>"]),
        {"stage": "mask", "state": "left out", "reason": "no photographs"},
        record("infill", 2, stored + poses, surface, metrics=[closed.as_dict()]),
    ]
