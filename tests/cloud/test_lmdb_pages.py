"""Pages of clouds that were damaged are refused before LMDB follows them out of its map."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.cloud.cloud_fixtures import build, check_whole
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.lmdb_pages import check_pages
from workbench.errors import InputError

PAGE = 4096
_READ = """
import sys
from pathlib import Path
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.errors import InputError
refused = 0
for path in sorted(Path(sys.argv[1]).glob("*.cloud")):
    try:
        with LayeredCloud(path, read_ahead=False) as cloud:
            for chunk in cloud.chunks():
                cloud.read(int(chunk))
    except InputError as error:
        assert error.file and error.fix, str(error)
        refused += 1
print(refused)
"""


@pytest.fixture(scope="module")
def cloud(tmp_path_factory) -> tuple[Path, np.ndarray]:
    # Small, so that what lies outside a page soon lies outside the file.
    path = tmp_path_factory.mktemp("pages") / "a.cloud"
    points = np.random.default_rng(3).uniform(-1, 1, (100, 3))
    build(path, points)
    return path, points


def key_pages(data: bytes) -> list[int]:
    """Numbers of branch and leaf pages that say who they are."""
    found = []
    for number in range(2, len(data) // PAGE):
        told, _, flags = struct.unpack_from("<QHH", data, number * PAGE)
        if told == number and flags & 3:
            found.append(number)
    return found


def test_a_whole_cloud_passes(cloud):
    path, points = cloud
    with open(path, "rb") as file:
        check_pages(file, writable=True)
    check_whole(path, points)


@pytest.mark.parametrize(
    ("at", "layout", "value"),
    [
        (16 + 24 + 48 + 40, "<Q", 2**40),  # the first page of keys
        (16 + 24 + 48 + 6, "<H", 9),  # levels of the tree
        (16 + 24 + 96, "<Q", 2**40),  # the last page
        (16 + 24, "<I", 3),  # bytes of a page
        (16 + 24 + 4, "<H", 1),  # a map at a fixed address
    ],
)
def test_a_damaged_head_is_refused(cloud, tmp_path, at, layout, value):
    data = bytearray(cloud[0].read_bytes())
    for meta in (0, PAGE):
        struct.pack_into(layout, data, meta + at, value)
    broken = tmp_path / "a.cloud"
    broken.write_bytes(data)
    with pytest.raises(InputError) as caught:
        LayeredCloud(broken)
    assert caught.value.file == str(broken)
    assert caught.value.fix


@pytest.mark.parametrize(("meta", "transaction"), [(0, 2**61 + 1), (1, 2**61), (0, 2**63)])
def test_a_transaction_that_leads_lmdb_to_the_other_head_is_refused(
    cloud, tmp_path, meta, transaction
):
    """It takes the head by the parity of the newest; the older one's pages have other use."""
    data = bytearray(cloud[0].read_bytes())
    struct.pack_into("<Q", data, meta * PAGE + 16 + 24 + 104, transaction)
    broken = tmp_path / "a.cloud"
    broken.write_bytes(data)
    with pytest.raises(InputError) as caught:
        LayeredCloud(broken)
    assert f"transaction {transaction}" in str(caught.value)


def test_no_damage_to_pages_of_keys_ends_the_process(cloud, tmp_path):
    data = cloud[0].read_bytes()
    pages = key_pages(data)
    assert pages
    rng = np.random.default_rng(5)
    tries = 300
    for k in range(tries):
        broken = bytearray(data)
        for _ in range(3):
            at = PAGE * int(rng.choice(pages)) + 2 * int(rng.integers(0, PAGE // 2))
            struct.pack_into("<H", broken, at, int(rng.choice([0, 1, 4095, 4096, 32768, 65535])))
        (tmp_path / f"{k}.cloud").write_bytes(broken)
    done = subprocess.run(
        [sys.executable, "-c", _READ, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-500:]
    assert int(done.stdout) > tries / 5
