"""Faults other than kills: disks, permissions, inputs, clocks, damage, two runs, other versions."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from tests.faults.fault import (
    Fault,
    Place,
    differences,
    outcome,
    refused,
    wrongly_fresh,
)
from tests.faults.kills import NAMES, before_stage
from tests.faults.snapshot import states
from tests.faults.triggers import at_open_of, nobody, with_room
from tests.faults.warm import start
from workbench.project.hashing import sealed
from workbench.project.project import Project

_TMPFS = "96m"
# What a stage of the small project writes is more than this, but for what it keeps in memory.
_LITTLE_ROOM = (0, 2_000, 20_000)
_DAY_S = 86_400
_QUICK = ("fuse", "texture", "export")


@contextmanager
def _small_disk(place: Place) -> Iterator[Path | None]:
    """A disk of its own in memory; None where none may be mounted."""
    folder = place.scratch / "disk"
    folder.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={_TMPFS},mode=755", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        yield None
        return
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def disk_full(place: Place) -> Iterator[Fault]:
    """The disk fills up while a stage is at work."""
    with _small_disk(place) as disk:
        for number, name in enumerate(_QUICK if place.quick else NAMES):
            done = f"no room is left while {name} is at work"
            expected = "refused with what to do; with room again it goes on to the same bytes"
            if disk is None:
                yield Fault("disk full", done, expected, "not tried: no disk may be mounted here")
                continue
            project = before_stage(place.reference.root, name, disk / "project")
            room = _LITTLE_ROOM[number % len(_LITTLE_ROOM)]
            filler = disk / "filler"
            status = os.statvfs(disk)
            with open(filler, "wb") as file:
                os.posix_fallocate(file.fileno(), 0, status.f_bavail * status.f_frsize - room)
            only = ["run", str(project), "--only", name, "--workers", "1"]
            told, problem = refused(place, only, with_room)
            if not problem and "file: " not in told:
                problem = "it does not name a file"
            problem = problem or wrongly_fresh(place, project)
            filler.unlink()
            code, said = outcome(place, only, with_room)
            if code != 0:
                problem = problem or f"it does not go on: {said[-600:]}"
            problem = problem or differences(place, project, NAMES[: NAMES.index(name) + 1])
            shutil.rmtree(project)
            yield Fault("disk full", done, expected, told, problem)


def disk_too_small(place: Place) -> Iterator[Fault]:
    """There is no room to begin with."""
    with _small_disk(place) as disk:
        done, expected = "a disk with 1 MB left", "refused before any work"
        if disk is None:
            yield Fault("disk full", done, expected, "not tried: no disk may be mounted here")
            return
        project = before_stage(place.reference.root, "ingest", disk / "project")
        status = os.statvfs(disk)
        with open(disk / "filler", "wb") as file:
            os.posix_fallocate(file.fileno(), 0, status.f_bavail * status.f_frsize - 1_000_000)
        told, problem = refused(place, ["run", str(project)])
        yield Fault("disk full", done, expected, told, problem)


def read_only(place: Place) -> Iterator[Fault]:
    """Folders that may not be written."""
    for folder, name in (("work", "ingest"), ("work/fuse/scans", "fuse"), ("exports", "export")):
        project = before_stage(place.reference.root, name, place.scratch / "broken")
        (project / folder).mkdir(parents=True, exist_ok=True)
        _open_to_all(project)
        (project / folder).chmod(0o555)
        only = ["run", str(project), "--only", name, "--workers", "1"]
        told, problem = refused(place, only, nobody)
        yield Fault("read-only folder", f"{folder}/ may not be written", "refused", told, problem)
    project = _copy(place)
    for path in [project, *project.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    code, told = outcome(place, ["status", str(project)], nobody)
    problem = "" if code == 0 and told.count('"fresh"') >= len(NAMES) else told[-600:]
    yield Fault(
        "read-only folder", "status of a project that may only be read", "told", "told", problem
    )


def unreadable_inputs(place: Place) -> Iterator[Fault]:
    """Inputs that may not be read."""
    for pattern, name in (
        ("inputs/scans/**/scan_02.ply", "ingest"),
        ("inputs/photos/**/photo_003.dng", "develop"),
        ("masks/training/scan_00.png", "mask"),
        ("inputs/cameras/**/images.txt", "orient"),
        ("project.toml", "ingest"),
        ("work/ingest/scans.json", "register"),
    ):
        project = before_stage(place.reference.root, name, place.scratch / "broken")
        _open_to_all(project)
        file = next(project.glob(pattern))
        file.chmod(0)
        told, problem = refused(place, ["run", str(project), "--to", name], nobody)
        if not problem and file.name not in told:
            problem = f"it does not name {file.name}"
        yield Fault("unreadable input", f"{file.name} may not be read", "refused", told, problem)


def vanishing_inputs(place: Place) -> Iterator[Fault]:
    """Inputs that go away, before a run and while it is at work."""
    for pattern, name in (
        ("inputs/scans/**/scan_02.ply", "ingest"),
        ("inputs/photos/**/photo_003.dng", "develop"),
        ("work/ingest/range_maps/scan_01.npz", "fuse"),
        ("work/develop/photos/photo_001.tif", "color"),
    ):
        project = before_stage(place.reference.root, name, place.scratch / "broken")
        file = next(project.glob(pattern))
        before = partial(at_open_of, file, file.unlink, 2)
        only = ["run", str(project), "--only", name, "--workers", "1"]
        told, problem = refused(place, only, before)
        if not problem and file.name not in told:
            problem = f"it does not name {file.name}"
        problem = problem or wrongly_fresh(place, project)
        yield Fault(
            "vanishing input", f"{file.name} goes while {name} is at work", "refused", told, problem
        )
    project = _copy(place)
    shutil.rmtree(project / "inputs" / "photos")
    told, problem = refused(place, ["run", str(project)])
    yield Fault("vanishing input", "the folder of photographs is gone", "refused", told, problem)
    project = _copy(place)
    next(project.glob("inputs/photos/**/photo_003.dng")).unlink()
    state, reason = states(project)["develop"]
    problem = "" if state == "stale" and "photo_003.dng is gone" in reason else f"{state}: {reason}"
    yield Fault("vanishing input", "a photograph is gone", "stale, and says so", reason, problem)


def clock_steps(place: Place) -> Iterator[Fault]:
    """Files from the future and the past, and changes that keep their time."""
    for days, word in ((-20_000, "past"), (20_000, "future")):
        project = _copy(place)
        at = max(0.0, time.time() + days * _DAY_S)
        for path in project.rglob("*"):
            os.utime(path, (at, at))
        wrong = [name for name, (state, _) in states(project).items() if state != "fresh"]
        problem = f"no longer fresh: {', '.join(wrong)}" if wrong else ""
        yield Fault("clock steps", f"all files are of the {word}", "all fresh", "fresh", problem)
        file = next(project.glob("inputs/scans/**/scan_02.ply"))
        _flip(file, keep_times=True)
        state, reason = states(project)["ingest"]
        problem = "" if state == "stale" and file.name in reason else f"{state}: {reason}"
        yield Fault(
            "clock steps", f"a scan of the {word} changes and keeps its times", "stale", reason,
            problem,
        )  # fmt: skip


def corrupted_products(place: Place) -> Iterator[Fault]:
    """A bit flipped in each product in turn; size and times stay as they were."""
    project = _copy(place)
    store = Project(project).store
    for name in NAMES:
        files = [path for artefact in _writes(name) for path in store.paths(artefact)]
        problems = []
        for file in files:
            whole = file.read_bytes()
            _flip(file, keep_times=True)
            if states(project)[name][0] != "stale":
                problems.append(file.name)
            file.write_bytes(whole)
        for file in files:
            _flip(file, keep_times=True)
        reason = states(project)[name][1]
        if place.quick and name not in _QUICK:
            project = _copy(place)
            continue
        code, told = outcome(place, ["run", str(project), "--only", name, "--workers", "1"])
        problem = f"not seen: {', '.join(problems)}" if problems else ""
        problem = problem or ("" if code == 0 else f"it is not mended: {told[-600:]}")
        problem = problem or differences(place, project, [name])
        done = f"a bit flipped in each of {len(files)} files of {name}, then in all"
        yield Fault("corrupted product", done, "stale, and mended by a run", reason, problem)


def corrupted_records(place: Place) -> Iterator[Fault]:
    """Records and notes that are damaged, cut off or of another form."""
    forms: dict[str, Callable[[bytes], bytes]] = {
        "a digit changed": lambda text: text.replace(b'"value": 1', b'"value": 7', 1),
        "a bit flipped": _bit_flipped,
        "cut off": lambda text: text[: len(text) // 2],
        "empty": lambda text: b"",
        "a list": lambda text: b"[]",
        "without hashes": lambda text: b'{"state": "done"}',
        "of nothing": lambda text: b'{"state": "failed", "output_hashes": null, "reason": ""}',
    }
    for done, form in forms.items():
        project = _copy(place)
        record = project / "work" / "ingest" / "record.json"
        record.write_bytes(form(record.read_bytes()))
        problem = ""
        try:
            state, reason = states(project)["ingest"]
            if state == "fresh":
                problem = "called fresh"
        except Exception as error:
            reason, problem = "", f"{type(error).__name__}: {error}"
        yield Fault("damaged record", f"ingest's record: {done}", "not fresh", reason, problem)
    project = before_stage(place.reference.root, "ingest", place.scratch / "broken")
    only = ["run", str(project), "--only", "ingest", "--workers", "1"]
    outcome(place, only)
    note = project / "work/ingest/items/read_scan_file/scan_01.json"
    note.write_bytes(note.read_bytes().replace(b'"samples": 1', b'"samples": 2', 1))
    (project / "work/ingest/record.json").unlink()
    code, told = outcome(place, only)
    problem = differences(place, project, ["ingest"]) or ("" if code == 0 else told[-600:])
    yield Fault("damaged record", "a digit of an item's note", "done again", "done again", problem)


def two_runs(place: Place) -> Iterator[Fault]:
    """Two runs of one project at once."""
    project = before_stage(place.reference.root, "develop", place.scratch / "broken")
    only = ["run", str(project), "--only", "develop", "--workers", "1"]
    first = start(only, place.scratch / "first")
    lock = project / "work" / "lock.json"
    while not lock.exists() and first.wait(0.0) is None:
        time.sleep(0.002)
    told, problem = refused(place, only)
    if not problem and str(first.pid) not in told:
        problem = f"it does not name process {first.pid}"
    code = first.wait()
    problem = problem or ("" if code == 0 else f"the first run ended with {code}")
    problem = problem or differences(place, project, ["develop"])
    yield Fault("two runs at once", "a second run of develop", "refused", told, problem)
    project = before_stage(place.reference.root, "fuse", place.scratch / "broken")
    only = ["run", str(project), "--only", "fuse", "--workers", "1"]
    runs = [start(only, place.scratch / f"run{number}") for number in range(4)]
    codes = sorted(code for code in (run.wait() for run in runs) if code is not None)
    problem = differences(place, project, ["fuse"])
    problem = problem or ("" if codes[0] == 0 and set(codes) <= {0, 2} else f"exit codes {codes}")
    told = f"{codes.count(0)} ran, {codes.count(2)} were refused"
    yield Fault("two runs at once", "four runs begin at once", "one result", told, problem)


def moved_project(place: Place) -> Iterator[Fault]:
    """A project that was moved, with its inputs and without."""
    project = _copy(place)
    moved = place.scratch / "elsewhere" / "moved"
    moved.parent.mkdir(exist_ok=True)
    shutil.move(project, moved)
    wrong = [name for name, (state, _) in states(moved).items() if state != "fresh"]
    problem = f"no longer fresh: {', '.join(wrong)}" if wrong else ""
    yield Fault("moved project", "moved with its inputs", "all fresh", "fresh", problem)
    shutil.move(moved / "inputs", place.scratch / "elsewhere" / "inputs")
    told, problem = refused(place, ["run", str(moved)])
    yield Fault("moved project", "moved without its inputs", "refused", told, problem)
    shutil.rmtree(place.scratch / "elsewhere")


def older_versions(place: Place) -> Iterator[Fault]:
    """A project, and stages, of an older version."""
    project = _copy(place)
    file = project / "project.toml"
    file.write_text(file.read_text("utf-8").replace("schema = 1", "schema = 0"), "utf-8")
    told, problem = refused(place, ["run", str(project)])
    yield Fault("older schema", "project.toml of schema 0", "refused", told, problem)
    for done, key, value in (
        ("another form of a product", "schemas", {"scan_inventory": 0}),
        ("an older version of the stage", "version", 0),
        ("another library", "libraries", {"numpy": "1.0"}),
    ):
        project = _copy(place)
        path = project / "work" / "ingest" / "record.json"
        record = json.loads(path.read_text("utf-8"))
        record["fingerprint"][key] = value
        del record["seal"]
        Project(project).store.save("records", sealed(record), "ingest")
        state, reason = states(project)["ingest"]
        problem = "" if state == "stale" else f"{state}: {reason}"
        code, said = outcome(place, ["run", str(project), "--only", "ingest"])
        problem = problem or ("" if code == 0 else said[-600:])
        problem = problem or differences(place, project, ["ingest"])
        yield Fault("older schema", f"{done} in a record", "stale, and mended", reason, problem)


CASES: dict[str, Callable[[Place], Iterator[Fault]]] = {
    case.__name__: case
    for case in (
        disk_full,
        disk_too_small,
        read_only,
        unreadable_inputs,
        vanishing_inputs,
        clock_steps,
        corrupted_products,
        corrupted_records,
        two_runs,
        moved_project,
        older_versions,
    )
}


def _copy(place: Place) -> Path:
    """A copy of the finished project, to break."""
    target = place.scratch / "broken"
    if target.exists():
        shutil.rmtree(target)
    shutil.copytree(place.reference.root, target)
    return target


def _open_to_all(project: Path) -> None:
    for path in [project, *project.rglob("*")]:
        path.chmod(0o777 if path.is_dir() else 0o666)


def _writes(name: str) -> tuple[str, ...]:
    from tests.faults.snapshot import stage_named

    return tuple(stage_named(name).writes)


def _flip(file: Path, *, keep_times: bool) -> None:
    status = file.stat()
    file.write_bytes(_bit_flipped(file.read_bytes()))
    if keep_times:
        os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))


def _bit_flipped(content: bytes) -> bytes:
    changed = bytearray(content)
    if changed:
        changed[len(changed) // 2] ^= 1
    return bytes(changed)
