from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

import lmdb
import numpy as np
import pytest

from tests.cloud.cloud_fixtures import MEMORY, SCHEMA, arrays_of, build, check_whole
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.schema import Attribute
from workbench.errors import InputError, ProjectLockedError, SettingsError, WorkbenchError
from workbench.geometry.regions import EVERYWHERE, Box, Frustum, Sphere
from workbench.geometry.transforms import from_twist

RNG = np.random.default_rng(33)
N = 20_000
UTM = np.array([5e5, 5.2e6, 100.0])


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    """A noisy plane and a cluster a hundred times denser, at UTM coordinates."""
    plane = np.column_stack([RNG.random((N - 5000, 2)), 0.01 * RNG.normal(size=N - 5000)])
    return np.vstack([plane, 0.05 * RNG.normal(size=(5000, 3)) + 0.5]) + UTM


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory, points: np.ndarray) -> Path:
    path = tmp_path_factory.mktemp("cloud") / "cloud.lmdb"
    build(path, points)
    return path


@pytest.fixture
def copied(built: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(built, tmp_path / "cloud.lmdb"))


def some_regions() -> list:
    found = [EVERYWHERE, Box(UTM - 9, UTM - 8), Sphere(UTM + 0.5, 0.0)]
    for _ in range(6):
        a, b = RNG.random((2, 3)) + UTM
        found.append(Box(np.minimum(a, b) - [0, 0, 1], np.maximum(a, b)))
        found.append(Sphere(a - [0, 0, 0.5], RNG.uniform(0.05, 0.8)))
        pose = from_twist(np.r_[RNG.normal(size=3), a])
        found.append(Frustum(pose, *RNG.uniform(0.2, 1.5, 2), 0.01, RNG.uniform(0.2, 1.5)))
    return found


@pytest.mark.parametrize("region", some_regions(), ids=lambda r: type(r).__name__)
@pytest.mark.parametrize("read_ahead", [True, False])
def test_queries_agree_with_looking_at_every_sample(built, points, region, read_ahead):
    expected = np.flatnonzero(region.contains(points))
    arrays = arrays_of(points)
    with LayeredCloud(built, read_ahead=read_ahead, cache_bytes=1 << 16) as cloud:
        found = cloud.query(region)
        order = np.argsort(found.arrays["number"])
        assert found.complete
        assert np.array_equal(found.arrays["number"][order], expected)
        assert found.points[order].tobytes() == points[expected].tobytes()
        assert np.array_equal(found.arrays["color"][order], arrays["color"][expected])
        # To a level: all of that level's chunks and of those above, and nothing else.
        upto = np.concatenate(
            [cloud.read(c)["number"] for c in cloud.chunks() if cloud.tree.nodes["level"][c] <= 3]
        )
        found = cloud.query(region, level=3, names=["number"])
        assert set(found.arrays) == {"points", "number"}
        assert set(found.arrays["number"]) == set(upto) & set(expected)


def test_facts_about_a_cloud(built, points):
    with LayeredCloud(built) as cloud:
        assert len(cloud) == N
        assert cloud.schema == SCHEMA
        assert np.array_equal(cloud.bounds[0], points.min(axis=0))
        assert np.array_equal(cloud.bounds[1], points.max(axis=0))
        levels = cloud.tree.nodes["level"][cloud.chunks("coarse_first")]
        assert (np.diff(levels) >= 0).all()
        assert cloud.levels == levels[-1] + 1
        place = {int(c): k for k, c in enumerate(cloud.chunks("bottom_up"))}
        parents = cloud.tree.nodes["parent"]
        assert all(place[c] < place[int(parents[c])] for c in place if parents[c] >= 0)
        assert sorted(place) == sorted(cloud.chunks()) == list(range(len(cloud.tree)))
        leaves = cloud.leaves()
        assert set(leaves) == set(range(len(cloud.tree))) - set(parents.tolist())
        assert [c for c, _ in cloud.blocks(["number"])] == cloud.chunks().tolist()


def test_a_spacing_is_reached_and_not_much_passed(built, points):
    """On the plane alone: nearest neighbours of n samples per area lie 1 / (2 √n) apart."""
    plane = Box(UTM - np.array([0, 0, 0.2]), UTM + np.array([0.3, 0.3, 0.2]))
    with LayeredCloud(built) as cloud:
        last = 0
        for spacing in (0.04, 0.02, 0.01):
            found = cloud.query(plane, spacing_m=spacing)
            density = len(found) / 0.09
            assert 0.5 / np.sqrt(density) <= 1.15 * spacing
            assert 0.5 / np.sqrt(density) >= 0.3 * spacing
            assert len(found) > last
            last = len(found)
        assert len(cloud.query(plane, spacing_m=0.0)) == plane.contains(points).sum()


def test_cells_share_out_every_sample_once(built, points):
    with LayeredCloud(built) as cloud:
        for most in (N, 3000, 700, 1):
            times = np.zeros(N, int)
            cells = cloud.cells(most)
            for low, high in cells:
                inside = Box(low, high).contains(points)
                times += inside
                if most >= 700:
                    assert inside.sum() <= 1.1 * most
            assert (times == 1).all()
        assert len(cloud.cells(N)) == 1
        assert len(cloud.cells(700)) < 4 * N / 700


def test_byte_budgets_give_whole_coarse_levels(built):
    with LayeredCloud(built) as cloud:
        counts = np.bincount(cloud.tree.nodes["level"], cloud.tree.nodes["count"])
        per_sample = 24 + 8
        for level in range(cloud.levels):
            budget = int(counts[: level + 1].sum()) * per_sample
            for spare in (0, -1):
                found = cloud.query(budget_bytes=budget + spare, names=["number"])
                reached = max(0, level + (spare if level else 0))
                assert found.level == reached
                assert len(found) == counts[: reached + 1].sum()
                assert found.complete == (reached == cloud.levels - 1)
        assert len(cloud.query(budget_bytes=0)) == counts[0]


def test_time_budgets_are_kept_and_refined_by_asking_again(built, monkeypatch):
    with LayeredCloud(built, cache_bytes=1 << 26) as cloud:
        load = cloud._cache._load

        def slow(chunk, names):
            time.sleep(0.002)
            return load(chunk, names)

        monkeypatch.setattr(cloud._cache, "_load", slow)
        start = time.perf_counter()
        first = cloud.query(budget_ms=60)
        assert time.perf_counter() - start < 0.4
        assert not first.complete
        assert first.level < cloud.levels - 1
        whole = cloud.tree.nodes["count"][cloud.tree.nodes["level"] <= first.level].sum()
        assert len(first) == whole
        cloud._cache.wait_idle()
        again = cloud.query(budget_ms=10_000)
        assert again.complete
        assert len(again) == N
        assert cloud.query(budget_ms=0).level == 0


def column(x: float) -> Box:
    """A tall box over the plane."""
    return Box(UTM + np.array([x, 0.2, -1.0]), UTM + np.array([x + 0.1, 0.3, 1.0]))


def test_what_is_asked_for_next_is_already_there(built, monkeypatch):
    """Boxes in a row: the thread has loaded the third before it is asked for."""
    with LayeredCloud(built, cache_bytes=1 << 26) as cloud:
        for k in range(2):
            cloud.query(column(0.05 + 0.1 * k))
        cloud._cache.wait_idle()
        cloud._cache.misses = 0
        assert len(cloud.query(column(0.25)))
        assert cloud._cache.misses == 0
    with LayeredCloud(built, cache_bytes=1 << 26) as cloud:
        cloud.query(level=2)
        cloud._cache.wait_idle()
        cloud._cache.misses = 0
        cloud.query(level=3)
        assert cloud._cache.misses == 0
        cloud.prefetch(EVERYWHERE, level=5)
        cloud._cache.wait_idle()
        cloud.query(level=5)
        assert cloud._cache.misses == 0


def test_the_cache_keeps_to_its_size_and_drops_the_oldest(built):
    with LayeredCloud(built, cache_bytes=40_000) as cloud:
        for _, arrays in cloud.blocks():
            assert cloud._cache._bytes <= 40_000 + sum(a.nbytes for a in arrays.values())
        cloud._cache.wait_idle()
        assert cloud._cache._bytes == sum(a.nbytes for a in cloud._cache._entries.values())
    with LayeredCloud(built, cache_bytes=10_000, read_ahead=False) as cloud:
        for chunk in (0, 1, 0, 2, 3):
            cloud.read(chunk, ["points"])
        assert [c for c, _ in cloud._cache._entries][-2:] == [2, 3]


def test_arrays_from_the_cache_cannot_be_spoiled(built):
    with LayeredCloud(built) as cloud, pytest.raises(ValueError, match="read-only"):
        cloud.read(0)["points"][0] = 0.0


def test_attributes_last_from_the_commit_on(copied, points):
    weight = Attribute("weight", "float32", 1, 0.5)
    with LayeredCloud(copied, writable=True, cache_bytes=20_000) as cloud:
        cloud.add_attribute(weight)
        assert (cloud.query(names=["weight"]).arrays["weight"] == 0.5).all()
        for chunk in cloud.chunks("bottom_up")[::2]:
            arrays = cloud.read(int(chunk))
            value = arrays["number"].astype(np.float32)
            cloud.write(int(chunk), {"weight": value, "color": 255 - arrays["color"]})
            assert np.array_equal(cloud.read(int(chunk))["weight"], value)
        written = set(cloud.chunks("bottom_up")[::2].tolist())
        seen = cloud.query(names=["weight"]).arrays["weight"]
        cloud.commit()
        for chunk in range(0, len(cloud.tree), 3):
            cloud.write(chunk, {"weight": np.zeros(cloud.tree.nodes["count"][chunk], np.float32)})
    with LayeredCloud(copied) as cloud:
        assert cloud.schema == SCHEMA.with_attribute(weight)
        color = arrays_of(points)["color"]
        for chunk, arrays in cloud.blocks():
            plain = color[arrays["number"]]
            if chunk in written:
                assert np.array_equal(arrays["weight"], arrays["number"].astype(np.float32))
                assert np.array_equal(arrays["color"], 255 - plain)
            else:
                assert (arrays["weight"] == 0.5).all()
                assert np.array_equal(arrays["color"], plain)
        assert np.array_equal(cloud.query(names=["weight"]).arrays["weight"], seen)


def test_uncommitted_leftovers_are_swept(copied, points):
    sizes = []
    for _ in range(5):
        with LayeredCloud(copied, writable=True, cache_bytes=30_000) as cloud:
            for chunk, arrays in cloud.blocks(["color"]):
                cloud.write(chunk, {"color": RNG.permuted(arrays["color"])})
        sizes.append(copied.stat().st_size)
    assert sizes[-1] <= 1.05 * sizes[1]
    check_whole(copied, points)


def test_repeated_updates_reuse_their_space(copied):
    with LayeredCloud(copied, writable=True) as cloud:
        sizes = []
        for k in range(8):
            for chunk in cloud.chunks():
                color = np.full((int(cloud.tree.nodes["count"][chunk]), 3), k, np.uint8)
                cloud.write(int(chunk), {"color": color})
            cloud.commit()
            sizes.append(copied.stat().st_size)
        assert sizes[-1] == sizes[3]


READER = """
import sys
from pathlib import Path
from workbench.cloud.layered_cloud import LayeredCloud
with LayeredCloud(Path(sys.argv[1]), cache_bytes=0, read_ahead=False) as cloud:
    cloud.read(0, ["points"])
    print("open", flush=True)
    sys.stdin.readline()
    print(*(int(cloud.read(c, ["color"])["color"].max()) for c in cloud.chunks()), flush=True)
"""


def test_a_reader_elsewhere_sees_the_last_commit(copied):
    reader = subprocess.Popen(
        [sys.executable, "-c", READER, copied],
        cwd=Path(__file__).parents[2], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert reader.stdout is not None
    assert reader.stdout.readline() == "open\n"
    with LayeredCloud(copied, writable=True) as cloud:
        for chunk in cloud.chunks():
            count = int(cloud.tree.nodes["count"][chunk])
            cloud.write(int(chunk), {"color": np.full((count, 3), 7, np.uint8)})
        cloud.commit()
        for chunk in cloud.chunks():
            count = int(cloud.tree.nodes["count"][chunk])
            cloud.write(int(chunk), {"color": np.full((count, 3), 9, np.uint8)})
        out, _ = reader.communicate("go\n")
    assert set(out.split()) == {"7"}


def test_only_one_process_writes(copied):
    with LayeredCloud(copied, writable=True):
        code = READER.replace("cache_bytes=0", "writable=True")
        out = subprocess.run(
            [sys.executable, "-c", code, copied],
            cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False,
        )  # fmt: skip
    assert ProjectLockedError.__name__ in out.stderr


def test_what_cannot_be_written_is_refused(copied):
    with LayeredCloud(copied) as cloud:
        with pytest.raises(WorkbenchError, match="reading only"):
            cloud.write(0, {"color": cloud.read(0)["color"]})
        with pytest.raises(WorkbenchError, match="reading only"):
            cloud.add_attribute(Attribute("weight", "float32"))
        with pytest.raises(WorkbenchError, match="reading only"):
            cloud.commit()
    with LayeredCloud(copied, writable=True) as cloud:
        arrays = cloud.read(0)
        for bad, words in [
            ({"points": arrays["points"]}, "positions"),
            ({"color": arrays["color"][:-1]}, "shape"),
            ({"color": arrays["color"].astype(float)}, "type"),
            ({"colour": arrays["color"]}, "no attribute"),
        ]:
            with pytest.raises(InputError, match=words):
                cloud.write(0, bad)
        with pytest.raises(InputError, match="no such chunk"):
            cloud.write(len(cloud.tree), {})
        with pytest.raises(InputError, match="twice"):
            cloud.add_attribute(Attribute("color", "float32"))


@pytest.mark.parametrize(
    "limits", [{"level": -1}, {"spacing_m": np.nan}, {"budget_bytes": -5}, {"budget_ms": -1.0}]
)
def test_limits_out_of_bounds_are_refused(built, limits):
    with LayeredCloud(built) as cloud, pytest.raises(SettingsError):
        cloud.query(**limits)


def test_unknown_names_are_refused(built):
    with LayeredCloud(built) as cloud:
        for ask in (cloud.query, lambda names: cloud.read(0, names)):
            with pytest.raises(InputError, match="no attribute 'weight'"):
                ask(names=["weight"])


def test_missing_and_foreign_files_are_told(tmp_path: Path):
    path = tmp_path / "cloud.lmdb"
    with pytest.raises(InputError, match="no such point cloud"):
        LayeredCloud(path)
    (tmp_path / ".cloud.lmdb.building").mkdir()
    with pytest.raises(InputError, match="interrupted"):
        LayeredCloud(path)
    for content in (b"", b"ply\nformat ascii 1.0\n", RNG.bytes(100_000)):
        path.write_bytes(content)
        with pytest.raises(InputError, match="not a point cloud") as caught:
            LayeredCloud(path)
        assert caught.value.file == str(path)
        assert caught.value.fix
    path.unlink()
    with lmdb.open(str(path), subdir=False) as other, other.begin(write=True) as txn:
        txn.put(b"cat", b"dog")
    with pytest.raises(InputError, match="not a point cloud"):
        LayeredCloud(path)


@pytest.mark.parametrize("keep", [0.02, 0.3, 0.99])
def test_a_cut_file_is_told(copied: Path, keep: float):
    data = copied.read_bytes()
    copied.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(InputError, match="cut short") as caught:
        LayeredCloud(copied)
    assert caught.value.file == str(copied)


def test_a_damaged_chunk_is_told_by_name(copied: Path):
    with LayeredCloud(copied) as cloud:
        value = cloud._store.get([(5, 0)])[0]
    data = copied.read_bytes()
    place = data.index(value) + len(value) // 2
    copied.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
    with LayeredCloud(copied) as cloud:
        with pytest.raises(InputError, match="damaged") as caught:
            cloud.query()
        assert "chunk 5, points" in str(caught.value.file)
        assert len(cloud.read(4)["points"])


def test_memory_of_the_fixture_goes_through_files(points):
    assert points.nbytes > 4 * MEMORY
