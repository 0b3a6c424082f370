"""Speed, memory, size and query latency of the layered cloud, next to a Morton sort.

    python -m tests.benchmarks.bench_cloud OUT [--points 1000000 10000000 100000000]

Every measurement runs in a process of its own. Two kinds of samples: *surface* (a bumpy body
with scanner noise, brought into place by a rigid pose, so that coordinates have full
mantissas) and *random* (the worst case: no attribute can be predicted). Writes
``cloud_build.png``, ``cloud_tradeoff.png`` and ``results.json`` to OUT.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from workbench.cloud.building import build_cloud
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.schema import Attribute, Schema
from workbench.geometry.regions import Box
from workbench.geometry.transforms import apply, from_twist, rotate
from workbench.kernels.chunk_planes import morton_codes

SCHEMA = Schema(
    (
        Attribute("normal", "float32", 3),
        Attribute("radius", "float32"),
        Attribute("color", "uint8", 3),
        Attribute("weight", "float32"),
    )
)
BLOCK = 1_000_000
WORLD_FROM_SCAN = from_twist([0.3, -1.1, 0.7, 12.34, -5.67, 3.21])


def radius_of(directions: np.ndarray) -> np.ndarray:
    """(n,) metres: a body of about 1 m with bumps of several sizes."""
    x, y, z = directions.T
    return (
        1.0
        + 0.2 * np.sin(3 * x + 1) * np.cos(2 * y)
        + 0.02 * np.sin(17 * x) * np.sin(19 * y) * np.sin(23 * z)
    )


def surface_block(rng: np.random.Generator, n: int, spacing_m: float) -> dict[str, np.ndarray]:
    """Samples of the body with noise of a fifth of their spacing."""
    d = rng.normal(size=(n, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    r = radius_of(d)
    slope = np.stack([(radius_of(d + e) - r) / 1e-4 for e in 1e-4 * np.eye(3)], axis=1)
    slope -= d * np.einsum("ni,ni->n", slope, d)[:, None]
    normal = d - slope / r[:, None]
    normal += rng.normal(scale=0.03, size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    points = d * (r + rng.normal(scale=0.2 * spacing_m, size=n))[:, None]
    shade = 0.5 + 0.3 * np.sin(4 * d[:, :1]) * np.array([1.0, 0.9, 0.7])
    color = np.clip(255 * shade + rng.normal(scale=2.0, size=(n, 3)), 0, 255)
    facing = np.abs(normal[:, 2]) + 0.05
    return {
        "points": apply(WORLD_FROM_SCAN, points),
        "normal": rotate(WORLD_FROM_SCAN, normal).astype(np.float32),
        "radius": (spacing_m / np.sqrt(facing)).astype(np.float32),
        "color": color.astype(np.uint8),
        "weight": facing.astype(np.float32),
    }


def random_block(rng: np.random.Generator, n: int, _: float) -> dict[str, np.ndarray]:
    normal = rng.normal(size=(n, 3))
    return {
        "points": rng.random((n, 3)),
        "normal": (normal / np.linalg.norm(normal, axis=1)[:, None]).astype(np.float32),
        "radius": rng.random(n, dtype=np.float32),
        "color": rng.integers(0, 256, (n, 3), dtype=np.uint8),
        "weight": rng.random(n, dtype=np.float32),
    }


def write_input(folder: Path, kind: str, count: int) -> None:
    """One raw file per attribute, so that reading costs next to nothing."""
    folder.mkdir(parents=True, exist_ok=True)
    make = surface_block if kind == "surface" else random_block
    spacing = np.sqrt(4 * np.pi / count)
    rng = np.random.default_rng(1)
    with ExitStack() as stack:
        files = {a.name: stack.enter_context(open(folder / a.name, "wb")) for a in SCHEMA.all}
        for start in range(0, count, BLOCK):
            for name, array in make(rng, min(BLOCK, count - start), spacing).items():
                array.tofile(files[name])


class Blocks:
    """The input of a folder, read a block at a time."""

    def __init__(self, folder: Path, count: int) -> None:
        self.folder, self.count = folder, count

    def __iter__(self) -> Iterator[dict[str, np.ndarray]]:
        for start in range(0, self.count, BLOCK):
            n = min(BLOCK, self.count - start)
            yield {
                a.name: np.fromfile(
                    self.folder / a.name,
                    a.dtype,
                    n * a.components,
                    offset=start * a.bytes_per_sample,
                ).reshape(a.shape(n))
                for a in SCHEMA.all
            }


class PeakAnonymous(threading.Thread):
    """Largest RssAnon of this process, MiB, looked at every 20 ms."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.mib = 0.0

    def run(self) -> None:
        while True:
            for line in Path("/proc/self/status").read_text().splitlines():
                if line.startswith("RssAnon"):
                    self.mib = max(self.mib, int(line.split()[1]) / 1024)
            time.sleep(0.02)


def measure_build(folder: Path, count: int, cloud: Path, chunk: int, level: int, memory: int):
    # Compiled kernels are loaded first: a build of any size needs them once.
    few = {a.name: a.filled(5000) for a in SCHEMA.all}
    few["points"] = np.random.default_rng(0).random((5000, 3))
    build_cloud(cloud, [few], SCHEMA, points_per_chunk=64, memory_bytes=1 << 18)
    peak = PeakAnonymous()
    peak.start()
    start, cpu = time.perf_counter(), time.process_time()
    report = build_cloud(
        cloud,
        Blocks(folder, count),
        SCHEMA,
        points_per_chunk=chunk,
        compression_level=level,
        memory_bytes=memory,
    )
    return {
        "seconds": time.perf_counter() - start,
        "cpu_seconds": time.process_time() - cpu,
        "rss_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "anonymous_mib": peak.mib,
        "bytes_per_sample": report.file_bytes / count,
        "chunks": report.chunks,
    }


def measure_sort(folder: Path, count: int) -> dict[str, float]:
    """All arrays in memory, put in Morton order: code, argsort, gather."""
    block = {
        a.name: np.fromfile(folder / a.name, a.dtype).reshape(a.shape(count)) for a in SCHEMA.all
    }
    start, cpu = time.perf_counter(), time.process_time()
    low = block["points"].min(axis=0)
    scale = (2**21 - 1) / (block["points"].max(axis=0) - low)
    codes = np.empty(count, np.uint64)
    for s in range(0, count, BLOCK):
        cells = ((block["points"][s : s + BLOCK] - low) * scale).astype(np.uint64)
        codes[s : s + BLOCK] = morton_codes(cells, np.zeros(3, np.int64))
    order = np.argsort(codes)
    for name in block:
        block[name] = block[name][order]
    return {
        "seconds": time.perf_counter() - start,
        "cpu_seconds": time.process_time() - cpu,
        "rss_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def measure_queries(cloud_path: Path) -> dict[str, float]:
    """Milliseconds of boxes of about 100,000 samples.

    Cold: a cloud just opened, none of its file in memory. Warm: asked for a second time.
    """
    with LayeredCloud(cloud_path) as cloud:
        root = cloud.read(0, ["points"])["points"]
        edge = (cloud.bounds[1] - cloud.bounds[0]).max() * (1e5 / len(cloud)) ** 0.5
        leaf_spacing = float(np.median(cloud.tree.nodes["spacing_m"][cloud.leaves()]))
    centres = root[np.random.default_rng(4).choice(len(root), 30, replace=False)]
    found: dict[str, float] = {}
    for kind, limit in (("to the leaves", None), ("to 4 × the leaf spacing", 4 * leaf_spacing)):
        times: dict[str, list[float]] = {"cold": [], "warm": []}
        for centre in centres:
            with open(cloud_path, "rb") as file:
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            with LayeredCloud(cloud_path) as cloud:
                for state in times:
                    start = time.perf_counter()
                    cloud.query(Box(centre - edge / 2, centre + edge / 2), spacing_m=limit)
                    times[state].append(1e3 * (time.perf_counter() - start))
        for state, taken in times.items():
            for name, q in (("median", 50), ("p95", 95)):
                found[f"{kind}, {state}, {name} ms"] = float(np.percentile(taken, q))
    return found


def fresh(*arguments: object) -> dict[str, float]:
    """Run one measurement in a process of its own."""
    command = [sys.executable, "-m", "tests.benchmarks.bench_cloud", "--measure"]
    out = subprocess.run([*command, *map(str, arguments)], check=True, capture_output=True)
    return json.loads(out.stdout.splitlines()[-1] or b"{}")


def measure(name: str, *rest: str) -> dict[str, float]:
    if name == "input":
        write_input(Path(rest[0]), rest[1], int(rest[2]))
        return {}
    if name == "build":
        return measure_build(Path(rest[0]), int(rest[1]), Path(rest[2]), *map(int, rest[3:]))
    if name == "sort":
        return measure_sort(Path(rest[0]), int(rest[1]))
    return measure_queries(Path(rest[0]))


def builds(work: Path, counts: list[int], memory: int) -> list[dict]:
    print("kind     samples    M/s  CPU s  sort s  ratio  CPU ratio  RSS MiB  anon  bytes/sample")
    rows = []
    for kind in ("surface", "random"):
        for count in counts:
            folder, cloud = work / "input", work / "cloud.lmdb"
            fresh("input", folder, kind, count)
            sort = fresh("sort", folder, count)
            build = fresh("build", folder, count, cloud, 32768, 1, memory)
            ratio = build["seconds"] / sort["seconds"]
            cpu = build["cpu_seconds"] / sort["cpu_seconds"]
            row = {"kind": kind, "count": count, "sort": sort, **build, "ratio": ratio}
            print(
                f"{kind:8}{count:9d}{count / build['seconds'] / 1e6:7.2f}"
                f"{build['cpu_seconds']:7.1f}{sort['seconds']:8.1f}{ratio:7.2f}{cpu:11.2f}"
                f"{build['rss_mib']:9.0f}{build['anonymous_mib']:6.0f}"
                f"{build['bytes_per_sample']:14.2f}",
                flush=True,
            )
            row["queries"] = fresh("queries", cloud)
            for name, value in row["queries"].items():
                print(f"    {name}: {value:.1f}", flush=True)
            rows.append(row)
    return rows


def tradeoff(work: Path, count: int) -> list[dict]:
    """Bytes and speed for chunk size and compression level, surface samples."""
    print("chunk  level    M/s  CPU µs/sample  bytes/sample  box ms cold")
    folder, cloud = work / "input", work / "cloud.lmdb"
    fresh("input", folder, "surface", count)
    rows = []
    for chunk in (4096, 16384, 32768, 131072):
        for level in (1, 3, 9):
            found = fresh("build", folder, count, cloud, chunk, level, 1 << 30)
            queries = fresh("queries", cloud)
            row = {"chunk": chunk, "level": level, "count": count, **found, "queries": queries}
            print(
                f"{chunk:6d}{level:6d}{count / found['seconds'] / 1e6:8.2f}"
                f"{1e6 * found['cpu_seconds'] / count:13.2f}{found['bytes_per_sample']:15.2f}"
                f"{queries['to the leaves, cold, median ms']:13.1f}",
                flush=True,
            )
            rows.append(row)
    return rows


def plot(rows: list[dict], trade: list[dict], out: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure((9, 4), layout="constrained")
    speed, memory = figure.subplots(1, 2)
    for kind in ("surface", "random"):
        mine = [r for r in rows if r["kind"] == kind]
        counts = [r["count"] for r in mine]
        speed.plot(counts, [r["count"] / r["seconds"] / 1e6 for r in mine], "o-", label=kind)
        speed.plot(
            counts, [r["count"] / r["sort"]["seconds"] / 1e6 for r in mine], "--",
            label=f"{kind}: Morton sort in memory",
        )  # fmt: skip
        memory.plot(counts, [r["rss_mib"] for r in mine], "o-", label=kind)
        memory.plot(
            counts, [r["sort"]["rss_mib"] for r in mine], "--", label=f"{kind}: Morton sort"
        )
    for axes, label in ((speed, "million samples per second"), (memory, "peak RSS (MiB)")):
        axes.set(xscale="log", yscale="log", xlabel="samples", ylabel=label)
        axes.legend()
    figure.savefig(out / "cloud_build.png", dpi=150)
    figure = Figure((5, 4), layout="constrained")
    axes = figure.subplots()
    for chunk in sorted({r["chunk"] for r in trade}):
        mine = [r for r in trade if r["chunk"] == chunk]
        x = [1e6 * r["cpu_seconds"] / r["count"] for r in mine]
        axes.plot(x, [r["bytes_per_sample"] for r in mine], "o-", label=f"{chunk} per chunk")
    axes.set(xlabel="CPU µs per sample (zstd 1, 3, 9)", ylabel="bytes per sample")
    axes.legend()
    figure.savefig(out / "cloud_tradeoff.png", dpi=150)


def main() -> None:
    if sys.argv[1] == "--measure":
        print(json.dumps(measure(*sys.argv[2:])))
        return
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--points", type=int, nargs="+", default=[10**6, 10**7, 10**8])
    parser.add_argument("--tradeoff", type=int, default=4_000_000)
    parser.add_argument("--memory", type=int, default=1 << 30)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    work = options.out / "work"
    work.mkdir(exist_ok=True)
    rows = builds(work, options.points, options.memory)
    trade = tradeoff(work, options.tradeoff)
    (options.out / "results.json").write_text(json.dumps({"builds": rows, "tradeoff": trade}))
    plot(rows, trade, options.out)


if __name__ == "__main__":
    main()
