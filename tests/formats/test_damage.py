"""Whatever happens to a file: it is read, or refused as bad input, and soon."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.formats.e57 import read_e57
from workbench.formats.pcd import read_pcd
from workbench.formats.ply import read_ply
from workbench.formats.poses import read_aln, read_conf, read_scan_poses_json
from workbench.formats.ptx import read_ptx
from workbench.formats.range_ply import read_range_ply
from workbench.formats.surface_files import read_surface, write_surface_glb
from workbench.formats.xyz import read_xyz
from workbench.geometry.mesh import TriangleMesh

READERS: dict[str, list[Callable[[Path], object]]] = {
    "text.ply": [read_ply, read_range_ply],
    "little.ply": [read_ply, read_range_ply, read_surface],
    "big.ply": [read_ply, read_surface],
    "one.ptx": [read_ptx],
    "two.ptx": [read_ptx],
    "text.pcd": [read_pcd],
    "binary.pcd": [read_pcd],
    "packed.pcd": [read_pcd],
    "plain.xyz": [read_xyz],
    "count.pts": [read_xyz],
    "scan.e57": [read_e57],
    "poses.conf": [read_conf],
    "poses.aln": [read_aln],
    "scan_poses.json": [read_scan_poses_json],
    "triangle.obj": [read_surface],
    "triangle.stl": [read_surface],
    "triangle.glb": [read_surface],
}
MOST_SECONDS = 2.0


@pytest.fixture(scope="module")
def contents(valid_files, tmp_path_factory) -> dict[str, bytes]:
    path = tmp_path_factory.mktemp("glb") / "a.glb"
    triangle = TriangleMesh(np.eye(3), np.array([[0, 1, 2]], np.int32))
    write_surface_glb(path, triangle.with_attributes(color=np.full((3, 3), 9, np.uint8)))
    return {**valid_files, "triangle.glb": path.read_bytes()}


def accepted(reader: Callable[[Path], object], path: Path) -> bool:
    """Whether the file was read; anything but InputError comes through as it is."""
    # Processor time: what else the machine does is no fault of a reader.
    start = time.process_time()
    refusal = None
    try:
        reader(path)
    except InputError as error:
        refusal = error
    assert time.process_time() - start < MOST_SECONDS
    if refusal is not None:
        assert refusal.file == str(path)
        assert refusal.fix
    return refusal is None


@pytest.fixture(params=list(READERS))
def name(request) -> str:
    return request.param


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_truncated(name, contents, tmp_path):
    path, data = tmp_path / name, contents[name]
    for reader in READERS[name]:
        path.write_bytes(data)
        reader(path)  # kernels compile at the first reading
        assert accepted(reader, path)
        for length in sorted({*range(0, len(data), max(1, len(data) // 60)), len(data) - 1}):
            path.write_bytes(data[:length])
            good = accepted(reader, path)
            assert not (good and length < 4)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_flipped_bytes(name, contents, tmp_path):
    path, data = tmp_path / name, contents[name]
    rng = np.random.default_rng(11)
    read = []
    for k in range(120):
        damaged = bytearray(data)
        for _ in range(1 + k % 3):
            place = int(rng.integers(len(data)))
            # Digits become other digits now and then, which is what makes counts absurd.
            damaged[place] = (
                rng.choice(list(b"0987654321- .en\n\0\xff")) if k % 2 else rng.integers(256)
            )
        path.write_bytes(damaged)
        read += [accepted(reader, path) for reader in READERS[name]]
    assert not all(read)


def test_absent_empty_foreign_and_folder(name, tmp_path):
    path = tmp_path / name
    for reader in READERS[name]:
        assert not accepted(reader, path)
    for data in (
        b"",
        b"\0" * 3000,
        b"\x89PNG\r\n\x1a\n" * 40,
        b"\xff\xfe" + "ply\n".encode("utf-16-le"),
    ):
        path.write_bytes(data)
        for reader in READERS[name]:
            assert not accepted(reader, path)
    path.unlink()
    path.mkdir()
    for reader in READERS[name]:
        assert not accepted(reader, path)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", ["text.ply", "one.ptx", "text.pcd", "plain.xyz", "count.pts"])
@pytest.mark.parametrize("word", [b"nan", b"inf", b"1e999", b"-1", b"99999999999999999999"])
def test_every_number_replaced(name, contents, tmp_path, word):
    words = contents[name].split(b" ")
    path = tmp_path / name
    read = []
    for k in range(len(words)):
        changed = [*words[:k], word, *words[k + 1 :]]
        path.write_bytes(b" ".join(changed))
        read += [accepted(reader, path) for reader in READERS[name]]
    # Comments and names may say anything; some number of every file may not.
    assert 0 < sum(read) < len(read)
