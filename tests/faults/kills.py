"""SIGKILL at random moments: what was finished stays, what is called fresh is right.

A stage is killed at a moment drawn over all the time it takes, or as it is about to open,
rename or remove a file or a thousandth of a second later; alone, or with the workers it has.
It is run again and killed again, and in the end left to finish.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import psutil

from stages.main import PIPELINE
from tests.faults.one_core import all_cores
from tests.faults.snapshot import (
    NOT_REPEATED,
    PASSING,
    Stamps,
    finished_items,
    product_hashes,
    records,
    stamps,
    states,
    stray_files,
    without_stages,
)
from tests.faults.warm import Run, start

# The scene has scans, and so no depth maps of its photographs.
NAMES = tuple(stage.name for stage in PIPELINE if stage.name != "densify")
#: Stages whose items go to workers.
WITH_WORKERS = ("ingest", "develop", "mask", "fuse", "infill", "color", "texture")
_KILLS_IN_A_CHAIN = 4
_CLUSTER_S = 9.0
_EVENTS = frozenset(("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir"))


@dataclass
class Tally:
    """What came of the kills of one stage."""

    stage: str
    moments: int = 0
    writes: int = 0
    workers: int = 0
    resumed: int = 0
    lost: int = 0
    wrong: int = 0
    found_as: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)

    @property
    def kills(self) -> int:
        """All that met a run that had not ended."""
        return self.moments + self.writes + self.workers

    def blame(self, kind: str, text: str) -> None:
        """Count something lost or wrong, and keep the first few in words."""
        setattr(self, kind, getattr(self, kind) + 1)
        if len(self.problems) < 8:
            self.problems.append(f"{kind}: {text}")


@dataclass(frozen=True)
class Reference:
    """A finished project, how long each stage takes and how often it touches files."""

    root: Path
    products: dict[str, dict[str, str]]
    seconds: dict[str, float]
    events: dict[str, int]


def reference_of(root: Path, scratch: Path, stages: Iterable[str]) -> Reference:
    """Time some stages of a finished project in a forked process that counts their events."""
    seconds, events = {}, {}
    for name in stages:
        project = before_stage(root, name, scratch / "timed")
        counted = scratch / "events"
        begun = time.monotonic()
        run = start(_command(project, name), scratch / "log", partial(_count, project, counted))
        if run.wait() != 0:
            raise RuntimeError(f"{name} did not run: {run.told}")
        seconds[name] = time.monotonic() - begun
        events[name] = counted.stat().st_size
    return Reference(root, {name: product_hashes(root, [name]) for name in NAMES}, seconds, events)


def kill_stage(
    reference: Reference, tally: Tally, scratch: Path, rng: random.Random, *, workers: bool
) -> None:
    """One chain: kill a stage a few times over, then let it finish and compare."""
    name = tally.stage
    project = before_stage(reference.root, name, scratch / "killed")
    others = {path: stamp for path, stamp in records(project).items() if f"/{name}/" not in path}
    kept: Stamps = {}
    for _ in range(1 if workers else _KILLS_IN_A_CHAIN):
        run, way, ended = _killed(reference, name, project, scratch, rng, workers)
        if ended is not None and way != "worker":
            if ended != 0:
                tally.blame("wrong", f"a run ended with {ended}: {run.told[-800:]}")
            if states(project)[name][0] == "fresh":
                break
            continue
        setattr(tally, way + "s", getattr(tally, way + "s") + 1)
        if (
            way == "worker"
            and ended not in (0, -signal.SIGKILL)
            and "fix: run it again" not in run.told
        ):
            tally.blame("wrong", f"one worker was killed: {run.told[-800:]}")
        _look(reference, tally, project, kept, others)
        kept = finished_items(project, name)
    _finish(reference, tally, project, kept, scratch)
    if workers and not run.ends(20.0):
        tally.blame("wrong", "workers of a killed run live on")
        run.kill()


def _killed(
    reference: Reference, name: str, project: Path, scratch: Path, rng: random.Random, workers: bool
) -> tuple[Run, str, int | None]:
    """A run that was killed, how, and its exit code where it ended by itself."""
    if workers:
        run = start(_command(project, name, 2), scratch / "log", _impatient)
        time.sleep(rng.uniform(0.0, _CLUSTER_S + reference.seconds[name]))
        victim = rng.choice(("group", "parent", "worker"))
        if victim == "worker" and run.workers():
            with suppress(IndexError, psutil.Error):
                rng.choice(run.workers()).kill()
            return run, "worker", run.wait()
        run.kill(group=victim == "group")
        code = run.wait()
        return run, "worker", code
    if rng.random() < 0.5:
        at, late = rng.randrange(reference.events[name]), rng.choice((0.0, rng.uniform(0.0, 2e-3)))
        before: Callable[[], None] = partial(_die_at, project, at, late)
        run = start(_command(project, name), scratch / "log", before)
        code = run.wait()
        return run, "write", None if code in (-signal.SIGKILL, -signal.SIGALRM) else code
    run = start(_command(project, name), scratch / "log")
    code = run.wait(rng.uniform(0.0, reference.seconds[name]))
    if code is None:
        run.kill()
        run.wait()
    return run, "moment", code


def _look(reference: Reference, tally: Tally, project: Path, kept: Stamps, others: Stamps) -> None:
    """After a kill: no stage is fresh that is not right, and nothing finished is gone."""
    name, now = tally.stage, states(project)
    tally.found_as[now[name][0]] += 1
    if now[name][0] not in ("missing", "interrupted", "failed", "fresh"):
        tally.blame("wrong", f"a killed {name} is called {now[name]}")
    _compare(
        reference, tally, project, [stage for stage, told in now.items() if told[0] == "fresh"]
    )
    _not_done_again(tally, kept)
    for path, stamp in others.items():
        if records(project).get(path) != stamp:
            tally.blame("lost", f"the record {path}")


def _finish(reference: Reference, tally: Tally, project: Path, kept: Stamps, scratch: Path) -> None:
    name, done = tally.stage, states(project)[tally.stage][0] == "fresh"
    before = records(project).get(str(project / "work" / name / "record.json"))
    run = start(_command(project, name), scratch / "log")
    if run.wait() != 0:
        tally.blame("wrong", f"it cannot go on: {run.told[-800:]}")
        return
    tally.resumed += 1
    if done and records(project)[str(project / "work" / name / "record.json")] != before:
        tally.blame("lost", f"{name} was finished and is done again")
    _not_done_again(tally, kept)
    if states(project)[name][0] != "fresh":
        tally.blame("wrong", f"{name} is finished and called {states(project)[name]}")
    _compare(reference, tally, project, NAMES[: NAMES.index(name) + 1])
    strays = [p for p in stray_files(project, reference.root) if _of(p, name)]
    if strays:
        tally.blame("wrong", f"files left over or gone: {', '.join(strays[:5])}")


def _compare(reference: Reference, tally: Tally, project: Path, stages: Iterable[str]) -> None:
    for stage in stages:
        told, now = reference.products[stage], product_hashes(project, [stage])
        if stage in NOT_REPEATED:
            told, now = dict.fromkeys(told, ""), dict.fromkeys(now, "")
        wrong = sorted(p for p in {*told, *now} if told.get(p) != now.get(p))
        if wrong:
            tally.blame("wrong", f"{stage} is fresh, but other bytes in {', '.join(wrong[:5])}")


def _not_done_again(tally: Tally, kept: Stamps) -> None:
    there = [path for path in map(Path, kept) if path.exists()]
    now = stamps(there)
    # What only helped the stage to make its other products goes when it is done.
    passed = {path for path in kept if Path(path).parent.name in PASSING}
    again = [
        path for path in kept if path not in passed - now.keys() and now.get(path) != kept[path]
    ]
    if again:
        tally.blame("lost", f"finished and done again: {', '.join(again[:4])}")


def before_stage(finished: Path, name: str, place: Path) -> Path:
    """A copy of a finished project as it was before a stage."""
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(finished, place)
    without_stages(place, NAMES[NAMES.index(name) :])
    return place


def _command(project: Path, name: str, workers: int = 1) -> list[str]:
    return ["run", str(project), "--only", name, "--workers", str(workers)]


def _of(path: str, name: str) -> bool:
    return path.startswith(f"work/{name}/") or (name == "export" and path.startswith("exports/"))


def _impatient() -> None:
    from workbench.pipeline import tasks

    tasks._CLUSTER_START_SECONDS = 0.0
    all_cores()


def _touched(project: Path, event: str, arguments: tuple[object, ...]) -> bool:
    """Whether an audited event is about to change a file of the project."""
    if event not in _EVENTS or not isinstance(arguments[0], str | os.PathLike):
        return False
    if event == "open":
        flags = arguments[2]
        if not (isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR)):
            return False
    return os.fspath(arguments[0]).startswith(str(project))


def _count(project: Path, counted: Path) -> None:
    counted.write_bytes(b"")
    descriptor = os.open(counted, os.O_WRONLY | os.O_APPEND)

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if _touched(project, event, arguments):
            os.write(descriptor, b".")

    sys.addaudithook(hook)


def _die_at(project: Path, at: int, late_s: float) -> None:
    """Have this process killed at an event, or so much later by a signal nobody handles."""
    left = [at]

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if not _touched(project, event, arguments):
            return
        left[0] -= 1
        if left[0] < 0 and late_s:
            signal.setitimer(signal.ITIMER_REAL, late_s)
        elif left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)
