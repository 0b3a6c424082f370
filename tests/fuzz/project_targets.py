"""Readers of project folders: settings, products, and what stages noted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from stages.main import PIPELINE
from tests.fuzz.checksums import repaired_zip
from tests.fuzz.target import MIB, Reader, Target
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.rangemap import RangeMap
from workbench.pipeline.records import RecordFolder
from workbench.project.hashing import FileHashes
from workbench.project.mask_subjects import mask_subjects, subject_picture
from workbench.project.project import Project
from workbench.project.settings import check_stage_names, options_for
from workbench.project.store import ProductStore

_PROJECT = b"""schema = 1
name = "vase"
preset = "default"
[inputs]
scans = ["scans"]
photos = []
geometry = "scans/a.ply"
[stages.infill]
depth = 9
[stages.export]
clouds = ["copc", "potree"]
voxel_resolution = 512
"""
_PLAIN_PROJECT = b'schema = 1\nname = "vase"\n[inputs]\nscans = ["scans"]\n'
_PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
    b"property float z\nend_header\n0 0 0\n"
)
_INVENTORY = {
    "scans": [
        {"name": "a", "file": "a.ply", "grid": [3, 4], "reflectance_populations": 2},
        {"name": "b", "file": "b.ply", "grid": None, "reflectance_populations": None},
    ]
}
_NOTE = {"pid": 1, "process_started": 1.5, "host": "here", "started": "2026-01-02T03:04:05+00:00"}
_RECORD = {"stage": "ingest", "fingerprint": "blake2b:00", "metrics": [["a", 1.0, "m", "b"]]}
_HASHES = {"scans/a.ply": [1, 2, 3, 4, "blake2b:00"]}
_PRODUCTS = ("work/ingest/scans.json", "work/ingest/record.json", "work/ingest/running.json")


def _folder_of_project(folder: Path) -> None:
    """What stands around the files that are damaged."""
    if not (folder / "scans").is_dir():
        (folder / "scans").mkdir()
        (folder / "scans" / "a.ply").write_bytes(_PLY)
    if not (folder / "project.toml").exists():
        (folder / "project.toml").write_bytes(_PLAIN_PROJECT)


def _project_whole(folder: Path) -> object:
    project = Project(folder)
    settings = project.settings({})
    check_stage_names(settings, [stage.name for stage in PIPELINE])
    options = [options_for(stage.name, stage.options, settings) for stage in PIPELINE]
    return project.scene(), options


def _noted(folder: Path) -> object:
    project = Project(folder)
    records = RecordFolder(project, "ingest")
    hashes = FileHashes(folder / "work" / "hashes.json", folder)
    read = records.read(), records.interrupted(), records.running()
    return read, hashes.of_file(folder / "scans" / "a.ply"), project.scene()


def _subjects(folder: Path) -> object:
    project = Project(folder)
    subjects = mask_subjects(project)
    return [subject_picture(project, subject) for subject in subjects if subject.name == "c"]


def _json_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    parts = (_INVENTORY, _RECORD, _NOTE, _HASHES)
    return [tuple(json.dumps(part).encode() for part in parts)]


def _arrays_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    store = ProductStore(folder)
    rows, columns = np.mgrid[0:3, 0:4]
    points = np.stack([columns, rows, rows + 2.0], axis=-1).reshape(-1, 3).astype(float)
    scan = RangeMap(
        "a",
        points,
        np.arange(12, dtype=np.int32).reshape(3, 4),
        np.zeros(3),
        np.ones(12, np.float32),
        np.zeros((12, 3), np.uint8),
        np.eye(4),
    )
    mesh = TriangleMesh(points, np.array([[0, 1, 4], [1, 5, 4]], np.int32))
    mesh = mesh.with_attributes(provenance=np.zeros(12, np.uint8))
    seeds = []
    for name, value, item in (
        ("range_maps", scan, "a"),
        ("surface", mesh, None),
        ("registration", {"covariance": np.eye(6), "names": np.array(["a", "b"])}, None),
    ):
        seeds.append((store.save(name, value, item).read_bytes(),))
    return seeds


def _loaded(name: str, item: str | None = None) -> Reader:
    """A product of the store, whose file is the one that is damaged."""

    def load(folder: Path) -> Any:
        store = ProductStore(folder)
        path = store.path(name, item)
        if not path.is_symlink():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.symlink_to(folder / "input.npz")
        return store.load(name, item)

    return load


PROJECT_TARGETS = (
    Target(
        "project-toml",
        ("project.toml",),
        lambda _: [(_PROJECT,), (_PLAIN_PROJECT,)],
        (_project_whole,),
        names_elsewhere=True,
        before=_folder_of_project,
    ),
    Target(
        "work-json",
        (*_PRODUCTS, "work/hashes.json"),
        _json_seeds,
        (_noted, _subjects),
        before=_folder_of_project,
    ),
    Target(
        "work-arrays",
        ("input.npz",),
        _arrays_seeds,
        (_loaded("range_maps", "a"), _loaded("surface"), _loaded("registration")),
        repaired_zip,
        memory_bytes=32 * MIB,
    ),
)
