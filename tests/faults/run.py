"""``make faults``: kills and other faults, and a table of what came of them.

    python -m tests.faults.run --kills 1000 --worker-kills 100 --out out/faults

makes a small project in ``--out``, and a table that the project's own report shows; with
``--project`` the report of that project, too.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import tests.faults.one_core  # noqa: F401  before any library is loaded
from stages.main import PIPELINE
from tests.faults.cases import CASES, Fault, Place
from tests.faults.kills import NAMES, WITH_WORKERS, Tally, kill_stage, reference_of
from tests.faults.scene import make_scene
from tests.faults.table import document, shown_fault, shown_tally
from tests.faults.warm import require_one_thread
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.project import Project


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """A folder in memory where there is one: files are written and copied all the time."""
    place = "/dev/shm" if Path("/dev/shm").is_dir() else None
    with tempfile.TemporaryDirectory(dir=place, prefix="faults-") as folder:
        Path(folder).chmod(0o755)  # runs that may write nothing are another user's
        yield Path(folder)


def run_all(project: Path) -> None:
    """Run every stage in this process, which then has all loaded that they need."""
    run_pipeline(PIPELINE, Project(project), RunRequest(workers=1), Progress(quiet=True))


def main() -> int:
    """Make the project, kill and break it, tell and keep what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=60, help="over all stages")
    parser.add_argument("--worker-kills", type=int, default=6, help="of runs that have workers")
    parser.add_argument("--stage", action="append", choices=NAMES, help="all by default")
    parser.add_argument("--case", action="append", choices=[*CASES, "none"], help="all by default")
    parser.add_argument("--quick", action="store_true", help="faults of a few stages alone")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/faults"))
    parser.add_argument("--project", type=Path, help="whose report shall have the table, too")
    given = parser.parse_args()
    also = [Project(given.project)] if given.project else []
    given.out.mkdir(parents=True, exist_ok=True)
    begun = time.monotonic()
    with scratch_folder() as scratch:
        project = make_scene(scratch / "made")
        run_all(project)
        require_one_thread()
        print("a small project is made and run; every stage is timed", flush=True)
        reference = reference_of(project, scratch, given.stage or NAMES)
        tallies = [Tally(name) for name in given.stage or NAMES]
        rng = random.Random(given.seed)
        for kills, workers in ((given.kills, False), (given.worker_kills, True)):
            killed = [t for t in tallies if not workers or t.stage in WITH_WORKERS]
            # Quick stages more often: an hour of kills meets more of their moments.
            weights = {t.stage: reference.seconds[t.stage] ** -0.5 for t in killed}
            for tally in killed:
                share = math.ceil(kills * weights[tally.stage] / sum(weights.values()))
                wanted = tally.kills + share
                while tally.kills < wanted:
                    kill_stage(reference, tally, scratch, rng, workers=workers)
                print(shown_tally(tally), flush=True)
        place = Place(reference, scratch, given.quick)
        faults: list[Fault] = []
        for name in given.case or CASES:
            if name == "none":
                continue
            for fault in CASES[name](place):
                faults.append(fault)
                print(shown_fault(fault), flush=True)
        table = document(tallies, faults, time.monotonic() - begun)
        kept = given.out / "project"
        shutil.rmtree(kept, ignore_errors=True)
        shutil.copytree(project, kept)
    (given.out / "faults.json").write_text(json.dumps(table, indent=1) + "\n", "utf-8")
    for opened in (Project(kept), *also):
        opened.store.save("fault_table", table)
    run_all(kept)
    print(f"{table['kills']} kills: {table['lost']} lost, {table['wrong']} wrong; "
          f"{len(faults)} other faults, {table['failed']} not as they should be")  # fmt: skip
    print(f"The report is in {kept / 'report' / 'report.html'}")
    return int(bool(table["lost"] or table["wrong"] or table["failed"]))


if __name__ == "__main__":
    sys.exit(main())
