"""Announced memory against the measured peak of every stage, on simulated scenes.

    python -m tests.benchmarks.bench_memory OUT --size small

simulates and runs a statue with photographs (small 24 of a megapixel, medium 68 of six, large 400
of 24; `--photos` takes fewer) and prints what every stage announced before it ran, what it took,
and how much of the announcement that was. `--project` measures one that was run already. Peaks
are of all processes together; pages that they share count for each.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from stages.main import PIPELINE
from workbench.project.project import Project


@dataclass(frozen=True)
class Row:
    """One stage of one project, bytes and seconds."""

    stage: str
    announced: int
    peak: int
    seconds: float

    @property
    def share(self) -> float:
        """The peak as a share of what was announced; above 1 the announcement was too low."""
        return self.peak / self.announced


def measured(project: Project) -> list[Row]:
    """What the records of a project's last runs tell."""
    found = []
    for stage in PIPELINE:
        if not project.store.exists("records", stage.name):
            continue
        record = project.store.load("records", stage.name)
        if "announced_memory_bytes" in record:
            numbers = record["announced_memory_bytes"], record["peak_rss_bytes"], record["seconds"]
            found.append(Row(stage.name, *numbers))
    return found


def simulated(out: Path, size: str, photos: int, workers: int | None) -> Project:
    """A statue of that size that every stage has run on.

    Its simulation is a process of its own: what that leaves held would count for every stage.
    """
    shared = [] if workers is None else ["--workers", str(workers)]
    what = ["--scene", "statue", "--seed", "7", "--size", size, "--photos", str(photos)]
    _workbench("simulate", str(out), *what, *shared)
    drawn = out / "masks" / "training"
    drawn.mkdir(parents=True)
    shutil.copy(out / "truth" / "masks" / "scan_00.png", drawn)
    shutil.copy(out / "truth" / "photos" / "object" / "photo_000.png", drawn)
    _workbench("run", str(out), "--set", "export.voxels=voxels", *shared)
    return Project(out)


def _workbench(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "stages.main", *words], check=True)


def main() -> int:
    """Print the table; 1 where an announcement was too low."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="an empty folder, and where memory.json goes")
    parser.add_argument("--size", choices=("small", "medium", "large"), default="small")
    parser.add_argument("--photos", type=int)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--project", type=Path, help="one that was run, instead of a simulation")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    photos = given.photos or {"small": 24, "medium": 68, "large": 400}[given.size]
    project = (
        Project(given.project)
        if given.project
        else simulated(given.out / given.size, given.size, photos, given.workers)
    )
    rows = measured(project)
    print(f"{'stage':<10}{'announced GiB':>15}{'peak GiB':>10}{'share':>8}{'s':>9}")
    for row in rows:
        print(
            f"{row.stage:<10}{row.announced / 2**30:>15.2f}{row.peak / 2**30:>10.2f}"
            f"{row.share:>8.2f}{row.seconds:>9.1f}"
        )
    told = [{**row.__dict__, "share": row.share} for row in rows]
    (given.out / "memory.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    return int(any(row.share > 1.0 for row in rows))


if __name__ == "__main__":
    sys.exit(main())
