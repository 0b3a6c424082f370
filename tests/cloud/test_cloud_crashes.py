"""Processes killed at random moments, and full disks: what is there is the last commit, whole."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.cloud.cloud_fixtures import build, check_whole
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.errors import InputError

ROOT = Path(__file__).parents[2]
POINTS = np.random.default_rng(6).random((25_000, 3))

BUILD = """
import sys
from pathlib import Path
from tests.cloud.test_cloud_crashes import POINTS, build
build(Path(sys.argv[1]) / "warm", POINTS[:1000])
print("go", flush=True)
build(Path(sys.argv[1]) / "cloud", POINTS)
print("done", flush=True)
"""

# Every round writes its number to all samples; only some rounds are committed.
UPDATE = """
import sys
from pathlib import Path
import numpy as np
from workbench.cloud.layered_cloud import LayeredCloud
with LayeredCloud(Path(sys.argv[1]), writable=True, cache_bytes=100_000) as cloud:
    print("go", flush=True)
    for k in range(1, 200):
        for chunk in cloud.chunks():
            count = int(cloud.tree.nodes["count"][chunk])
            cloud.write(int(chunk), {"color": np.full((count, 3), k % 250, np.uint8)})
        cloud.commit()
        print(k, flush=True)
"""


def killed(code: str, argument: Path, after_s: float) -> str:
    """Start, wait for the word, then ``kill -9`` some time later; what it printed."""
    process = subprocess.Popen(
        [sys.executable, "-c", code, argument], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "go\n"
    time.sleep(after_s)
    process.kill()
    out, _ = process.communicate()
    return out


@pytest.fixture(scope="module")
def timed(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, float]:
    """The file of an undisturbed build and how long it took."""
    path = tmp_path_factory.mktemp("timed") / "cloud"
    build(path, POINTS[:1000])
    start = time.perf_counter()
    build(path, POINTS)
    return path.read_bytes(), time.perf_counter() - start


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.9])
def test_a_killed_build_leaves_nothing_or_all_and_can_be_repeated(
    tmp_path: Path, timed: tuple[bytes, float], share: float
):
    content, seconds = timed
    out = killed(BUILD, tmp_path, share * seconds)
    cloud = tmp_path / "cloud"
    if "done" not in out and not cloud.exists():
        with pytest.raises(InputError, match=r"interrupted|no such"):
            LayeredCloud(cloud)
        build(cloud, POINTS)
    check_whole(cloud, POINTS)
    assert cloud.read_bytes() == content

    def litter() -> list[Path]:
        return [p for p in tmp_path.glob(".cloud*") if not p.name.endswith("-writer")]

    if litter():
        # Killed after the whole file took its place, before the working folder went.
        build(cloud, POINTS)
        assert cloud.read_bytes() == content
    assert not litter()


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("crash") / "cloud"
    build(path, POINTS[:8000])
    return path


@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.13, 0.3, 0.55, 0.9])
def test_a_killed_update_leaves_the_last_commit(built: Path, tmp_path: Path, after_s: float):
    path = Path(shutil.copy(built, tmp_path / "cloud"))
    out = killed(UPDATE, path, after_s).split()
    last = int(out[-1]) if out else 0
    with LayeredCloud(path) as cloud:
        color = cloud.query(names=["color", "number"]).arrays["color"]
    assert len(color) == 8000
    if last or len(np.unique(color)) == 1:
        # The commit may have landed after the last word was printed.
        assert np.unique(color).tolist() in ([last], [last + 1])
    else:
        check_whole(path, POINTS[:8000])
    # A new writer clears up and goes on.
    with LayeredCloud(path, writable=True) as cloud:
        for chunk in cloud.chunks():
            count = int(cloud.tree.nodes["count"][chunk])
            cloud.write(int(chunk), {"color": np.full((count, 3), 251, np.uint8)})
        cloud.commit()
    with LayeredCloud(path) as cloud:
        assert (cloud.query(names=["color"]).arrays["color"] == 251).all()


FULL_DISK = """
import resource, sys
from pathlib import Path
import numpy as np
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.errors import InputError
path = Path(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 50_000,) * 2)
with LayeredCloud(path, writable=True, cache_bytes=50_000) as cloud:
    try:
        for chunk in cloud.chunks():
            cloud.write(int(chunk), {"color": 255 - cloud.read(int(chunk))["color"]})
        cloud.commit()
    except InputError as error:
        print(error)
"""


def test_a_disk_that_fills_during_an_update_is_told_and_nothing_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "cloud"
    build(path, POINTS)
    out = subprocess.run(
        [sys.executable, "-c", FULL_DISK, path],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert "disk space" in out
    assert str(path) in out
    check_whole(path, POINTS)
