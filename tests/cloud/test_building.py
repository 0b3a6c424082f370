from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare, ks_2samp

from tests.cloud.cloud_fixtures import CHUNK, MEMORY, SCHEMA, arrays_of, build, check_whole, cut
from workbench.cloud.building import build_cloud, building_folder
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.schema import Attribute, Schema
from workbench.cloud.tree_building import inner_count
from workbench.errors import InputError, ProjectLockedError, SettingsError

RNG = np.random.default_rng(21)


def distribution(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    points = rng.normal(size=(n, 3))
    if kind == "equal":
        points[:] = [5e5, 5.2e6, -0.0]
    elif kind == "axis":
        points[:, 1:] = 0.0
    elif kind == "contrast":
        points[: n - n // 50] *= 1e-6
    elif kind == "duplicates":
        points = points[rng.integers(0, max(1, n // 10), n)]
    elif kind == "one outlier":
        points[:-1] = 0.5
    elif kind == "utm":
        points = 30 * points + [5e5, 5.2e6, 100.0]
    elif kind == "powers":
        points = np.sign(points) * 2.0 ** rng.uniform(-400, 400, (n, 3))
    elif kind == "sorted":
        points = points[np.argsort(points[:, 0])]
    return points


KINDS = ["normal", "equal", "axis", "contrast", "duplicates", "one outlier", "utm", "powers",
         "sorted"]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_lost_or_doubled_through_files(tmp_path: Path, kind: str):
    points = distribution(kind, 5000, RNG)
    report = build(tmp_path / "c", points)
    assert report.samples == 5000
    check_whole(tmp_path / "c", points)
    assert not building_folder(tmp_path / "c").exists()
    assert not list(tmp_path.glob(".*"))


@given(
    st.sampled_from(KINDS),
    st.sampled_from([1, 2, 3, CHUNK - 1, CHUNK, CHUNK + 1, 3 * CHUNK, 1000]),
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 7, 10**6]),
)
@settings(max_examples=40, deadline=None)
def test_any_distribution_of_any_size(kind: str, n: int, seed: int, block: int):
    points = distribution(kind, n, np.random.default_rng(seed))
    with tempfile.TemporaryDirectory() as folder:
        build(Path(folder) / "c", points, block=block if n < 300 else 10**6)
        check_whole(Path(folder) / "c", points)


def test_the_file_does_not_depend_on_blocks_or_workers(tmp_path: Path):
    points = RNG.normal(size=(20_000, 3))
    ways = [(10**6, 1), (10**6, 2), (777, 4), (64, 2)]
    for k, (block, workers) in enumerate(ways):
        build(tmp_path / str(k), points, block=block, workers=workers)
    files = [(tmp_path / str(k)).read_bytes() for k in range(len(ways))]
    assert all(f == files[0] for f in files)


def test_an_iterator_is_read_once_and_makes_the_same_file(tmp_path: Path):
    blocks = cut(arrays_of(RNG.normal(size=(5000, 3))), 900)
    options = {"points_per_chunk": CHUNK, "memory_bytes": MEMORY}
    build_cloud(tmp_path / "a", blocks, SCHEMA, **options)
    build_cloud(tmp_path / "b", iter(blocks), SCHEMA, **options)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_memory_decides_the_way_not_what_is_found(tmp_path: Path):
    points = RNG.normal(size=(5000, 3))
    build(tmp_path / "files", points)
    build(tmp_path / "memory", points, memory_bytes=1 << 26)
    counts = []
    for name in ("files", "memory"):
        check_whole(tmp_path / name, points)
        with LayeredCloud(tmp_path / name) as cloud:
            counts.append(cloud.tree.nodes["count"][cloud.tree.nodes["axis"] >= 0])
    assert set(counts[0]) == set(counts[1]) == {inner_count(5000, CHUNK)}


@pytest.mark.parametrize("n", [1, CHUNK, CHUNK + 1, 3 * CHUNK, 4096, 100_000])
def test_all_chunks_are_alike(n: int):
    inner = inner_count(n, CHUNK)
    levels = 0
    while inner * (2**levels - 1) < n and levels < 40:
        levels += 1
    if n > CHUNK:
        assert 0.4 * CHUNK < inner <= 0.9 * CHUNK or n < 3 * 0.9 * CHUNK
        assert abs(inner * (2**levels - 1) - n) < 2**levels


def test_chunks_of_a_regular_cloud_have_one_size(tmp_path: Path):
    build(tmp_path / "c", RNG.random((30_000, 3)), memory_bytes=1 << 26)
    with LayeredCloud(tmp_path / "c") as cloud:
        counts = cloud.tree.nodes["count"]
        assert counts.max() - counts.min() <= 8
        assert cloud.levels == 10
        assert cloud.tree.total == counts.sum() == 30_000


@pytest.mark.parametrize("memory", [MEMORY, 1 << 26])
def test_every_level_is_a_uniform_subsample(tmp_path: Path, memory: int):
    n = 40_000
    points = RNG.random((n, 3)) ** [1.0, 2.0, 0.5]
    build(tmp_path / "c", points, memory_bytes=memory)
    with LayeredCloud(tmp_path / "c") as cloud:
        for level in range(2, cloud.levels - 1):
            numbers = cloud.query(level=level).arrays["number"]
            # In space against all samples, and in the order they came in.
            for axis in range(3):
                assert ks_2samp(points[numbers, axis], points[:, axis]).pvalue > 1e-4
            assert chisquare(np.histogram(numbers, 16, (0, n))[0]).pvalue > 1e-4


def test_a_region_split_off_with_many_chunks_shares_the_levels(tmp_path: Path):
    """Density contrast: the levels follow the samples, not the space."""
    points = RNG.random((20_000, 3))
    points[:18_000] *= 1e-3
    build(tmp_path / "c", points)
    with LayeredCloud(tmp_path / "c") as cloud:
        numbers = cloud.query(level=3).arrays["number"]
        assert np.mean(numbers < 18_000) == pytest.approx(0.9, abs=0.03)


def bad(name: str, change) -> dict[str, np.ndarray]:
    block = arrays_of(RNG.random((10, 3)))
    block[name] = change(block[name])
    return block


def with_value(value: float):
    def change(points: np.ndarray) -> np.ndarray:
        points = points.copy()
        points[3, 1] = value
        return points

    return change


@pytest.mark.parametrize(
    ("block", "words"),
    [
        (bad("points", with_value(np.nan)), "sample 3"),
        (bad("points", with_value(np.inf)), "sample 3"),
        (bad("points", with_value(-1e200)), "sample 3"),
        (bad("points", lambda p: p.astype(np.float32)), "float64"),
        (bad("points", lambda p: p[:, :2]), "shape"),
        (bad("points", lambda p: p[0, 0]), "length"),
        (bad("number", lambda a: a[:-1]), "length"),
        (bad("number", lambda a: a.astype(np.int32)), "astype('int64')"),
        (bad("color", lambda a: a[:, 0]), "shape"),
        ({"points": RNG.random((10, 3))}, "schema"),
        ({**arrays_of(RNG.random((10, 3))), "more": np.zeros(10)}, "schema"),
    ],
)
def test_bad_blocks_are_named(tmp_path: Path, block: dict, words: str):
    good = arrays_of(RNG.random((10, 3)))
    with pytest.raises(InputError) as caught:
        build_cloud(tmp_path / "c", [good, block], SCHEMA)
    assert "block 1" in str(caught.value)
    assert words in str(caught.value)
    assert not (tmp_path / "c").exists()
    assert not building_folder(tmp_path / "c").exists()


@pytest.mark.parametrize("blocks", [[], [arrays_of(np.zeros((0, 3)))]])
def test_nothing_makes_no_cloud(tmp_path: Path, blocks: list):
    with pytest.raises(InputError, match="no samples") as caught:
        build_cloud(tmp_path / "c", blocks, SCHEMA)
    assert caught.value.fix
    assert not (tmp_path / "c").exists()


def test_blocks_that_change_between_passes_are_found(tmp_path: Path):
    blocks = cut(arrays_of(RNG.random((4000, 3))), 1000)

    class Shrinking:
        reads = 0

        def __iter__(self):
            self.reads += 1
            return iter(blocks[self.reads - 1 :])

    with pytest.raises(InputError, match="read again"):
        build_cloud(
            tmp_path / "c", Shrinking(), SCHEMA, points_per_chunk=CHUNK, memory_bytes=MEMORY
        )


@pytest.mark.parametrize(
    "options",
    [{"points_per_chunk": 0}, {"compression_level": 40}, {"memory_bytes": 1000}],
)
def test_options_out_of_bounds_are_refused(tmp_path: Path, options: dict):
    with pytest.raises(SettingsError) as caught:
        build(tmp_path / "c", RNG.random((10, 3)), **options)
    assert caught.value.expected


@pytest.mark.parametrize(
    "make",
    [
        lambda: Attribute("a b", "float32"),
        lambda: Attribute("a", "complex64"),
        lambda: Attribute("a", "object"),
        lambda: Attribute("a", "no such type"),
        lambda: Attribute("a", ">f4"),
        lambda: Attribute("a", "float32", 0),
        lambda: Schema((Attribute("a", "float32"), Attribute("a", "uint8"))),
        lambda: Schema((Attribute("points", "float32", 3),)),
    ],
)
def test_schemas_that_cannot_be_stored_are_refused(make):
    with pytest.raises(InputError):
        make()


def test_a_failed_build_leaves_the_old_cloud(tmp_path: Path):
    points = RNG.random((500, 3))
    build(tmp_path / "c", points)
    with pytest.raises(InputError):
        build_cloud(tmp_path / "c", [bad("points", with_value(np.nan))], SCHEMA)
    check_whole(tmp_path / "c", points)


def test_a_rebuild_replaces_a_cloud_while_it_is_read(tmp_path: Path):
    old, new = RNG.random((3000, 3)), RNG.random((4000, 3))
    build(tmp_path / "c", old)
    with LayeredCloud(tmp_path / "c", read_ahead=False, cache_bytes=0) as reader:
        build(tmp_path / "c", new)
        assert len(reader.query()) == 3000
        with pytest.raises(InputError, match="already open"):
            LayeredCloud(tmp_path / "c")
    check_whole(tmp_path / "c", new)


def test_a_cloud_that_is_written_is_not_rebuilt(tmp_path: Path):
    build(tmp_path / "c", RNG.random((500, 3)))
    with LayeredCloud(tmp_path / "c", writable=True), pytest.raises(ProjectLockedError):
        build(tmp_path / "c", RNG.random((500, 3)))


def test_the_file_grows_beyond_its_first_map(tmp_path: Path):
    points = RNG.random((900_000, 3))
    report = build(tmp_path / "c", points, points_per_chunk=32_768, memory_bytes=1 << 28)
    assert report.file_bytes > 1 << 24
    with LayeredCloud(tmp_path / "c") as cloud:
        assert len(cloud.query(level=0)) == cloud.tree.nodes["count"][0]


FULL_DISK = """
import resource, sys
from pathlib import Path
import numpy as np
from tests.cloud.cloud_fixtures import build
from workbench.errors import InputError
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
points = np.random.default_rng(0).random((20_000, 3))
try:
    build(Path(sys.argv[1]), points)
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize("limit", [20_000, 400_000])
def test_a_full_disk_is_told(tmp_path: Path, limit: int):
    """Buckets fail under the smaller limit, the store under the larger one."""
    root = Path(__file__).parents[2]
    out = subprocess.run(
        [sys.executable, "-c", FULL_DISK, tmp_path / "c", str(limit)],
        cwd=root, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert "disk space" in out
    assert str(tmp_path / "c") in out or str(tmp_path / ".c") in out
    assert not (tmp_path / "c").exists()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["random", "equal", "one outlier"])
def test_memory_stays_within_its_bound(tmp_path: Path, kind: str):
    """Eight million samples (320 MB of rows) in 128 MiB, on top of what a small build needs."""
    code = (
        "import resource, sys, numpy as np\n"
        "from pathlib import Path\n"
        "from tests.cloud.test_building import Stream, build_cloud, SCHEMA\n"
        "small = Stream('random', 200_000)\n"
        "path = Path(sys.argv[1])\n"
        "build_cloud(path, small, SCHEMA, memory_bytes=1 << 25)\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "build_cloud(path, Stream(sys.argv[2], 8_000_000), SCHEMA, memory_bytes=1 << 27)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)\n"
    )
    out = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "c", kind],
        cwd=Path(__file__).parents[2], capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert int(out) / 1024 < 128


class Stream:
    """Samples made as they are asked for."""

    def __init__(self, kind: str, count: int) -> None:
        self.kind, self.count = kind, count

    def __iter__(self):
        rng = np.random.default_rng(2)
        for start in range(0, self.count, 100_000):
            points = rng.random((100_000, 3))
            if self.kind != "random":
                points[:] = 0.25
            if self.kind == "one outlier" and start == 500_000:
                points[5] = 7.0
            yield arrays_of(points)
