"""Killed runs, runs under way, and two runs at once: each in a process of its own."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from fake_pipeline import PIPELINE, fake_project

from workbench.errors import ProjectLockedError
from workbench.pipeline.planner import make_plan
from workbench.pipeline.records import RecordFolder
from workbench.project.lock import project_lock
from workbench.project.project import Project

# A shell's background jobs are deaf to Ctrl-C, and so would be what they start.
SCRIPT = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.path.insert(0, {folder!r})
from fake_pipeline import PIPELINE
from workbench.cli import run_cli
sys.exit(run_cli(PIPELINE, sys.argv[1:]))
"""


# So many that items are left whenever another process has started, on a loaded machine, too.
SCANS = 90


def start(arguments: list[str], **environment: str) -> subprocess.Popen:
    script = SCRIPT.format(folder=str(Path(__file__).parent))
    return subprocess.Popen(
        [sys.executable, "-c", script, *arguments],
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_until(condition, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


def lines(path: Path) -> list[str]:
    return path.read_text().split() if path.exists() else []


def states(project: Project) -> dict[str, tuple[str, str]]:
    plan = make_plan(PIPELINE, Project(project.root))
    return {p.stage.name: (p.state.state, p.state.reason) for p in plan if p.state}


def products(project: Project) -> dict[str, bytes]:
    return {
        str(path.relative_to(project.root)): path.read_bytes()
        for path in sorted(project.root.glob("work/*/**/*"))
        if path.is_file() and path.name != "record.json"
    }


@pytest.fixture
def under_way(tmp_path):
    """A project of many scans, the run that is in the middle of its items, and their log."""
    project, log = fake_project(tmp_path / "a", scans=SCANS), tmp_path / "log"
    process = start(
        ["run", str(project.root), "--workers", "1"],
        FAKE_ITEM_SECONDS="0.3",
        FAKE_ITEM_LOG=str(log),
    )
    wait_until(lambda: len(lines(log)) >= 8)
    yield project, process, log
    process.kill()
    process.communicate()


def test_a_killed_run_costs_the_item_under_way_and_no_more(under_way, tmp_path, run, monkeypatch):
    project, process, log = under_way
    running = states(project)["fuse"]
    assert running[0] == "running"
    assert f"process {process.pid} on {socket.gethostname()}" in running[1]
    process.send_signal(signal.SIGKILL)
    wait_until(lambda: psutil.Process(process.pid).status() == psutil.STATUS_ZOMBIE)
    # Dead, though nobody has buried it yet.
    state, reason = states(project)["fuse"]
    assert state == "interrupted"
    assert "did not end" in reason
    process.communicate()
    assert states(project)["fuse"][0] == "interrupted"
    finished = len(list((project.root / "work/fuse/items").rglob("*.json")))
    before = lines(log)
    assert 7 <= finished < SCANS
    assert not project.store.exists("samples")

    monkeypatch.setenv("FAKE_ITEM_LOG", str(log))
    outcomes = run(project)
    assert outcomes["ingest"]["action"] == "fresh"
    assert outcomes["fuse"]["reason"].startswith("interrupted: ")
    again = lines(log)[len(before) :]
    assert len(again) == SCANS - finished
    assert len(set(again) & set(before)) <= 1
    assert states(project)["fuse"][0] == "fresh"

    undisturbed = fake_project(tmp_path / "b", scans=SCANS)
    run(undisturbed)
    ours, theirs = products(project), products(undisturbed)
    assert {k: v for k, v in ours.items() if ".partial" not in k and "hashes" not in k} == {
        k: v for k, v in theirs.items() if "hashes" not in k
    }


def test_a_second_run_is_refused_and_told_who_holds_the_project(under_way):
    project, process, _ = under_way
    second = start(["run", str(project.root), "--json"])
    out, err = second.communicate(timeout=30)
    assert second.returncode == 2
    assert f"process {process.pid} on {socket.gethostname()}" in err
    assert json.loads(out)["error"]["found"].startswith(f"process {process.pid} on ")
    # Looking is allowed all the while.
    look = start(["status", str(project.root), "--json"])
    out, _ = look.communicate(timeout=30)
    assert look.returncode == 0
    assert {s["name"]: s["state"] for s in json.loads(out)["stages"]}["fuse"] == "running"
    process.kill()
    process.communicate()
    with project_lock(project.root):
        pass


def test_ctrl_c_ends_with_130_and_leaves_an_interrupted_stage(under_way):
    project, process, _ = under_way
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "Interrupted" in err
    assert "Traceback" not in err
    assert states(project)["fuse"][0] == "interrupted"


def test_the_lock_is_one_per_project_and_leaves_nothing(tmp_path):
    one, other = fake_project(tmp_path / "a"), fake_project(tmp_path / "b")
    with project_lock(one.root), project_lock(other.root):
        with pytest.raises(ProjectLockedError) as caught, project_lock(one.root):
            pass
        assert f"process {os.getpid()} on" in caught.value.found
        assert caught.value.exit_code == 2
    assert not (one.root / "work" / "lock.json").exists()
    with project_lock(one.root):
        pass


def note(project: Project, **changes) -> Path:
    folder = RecordFolder(project, "ingest")
    folder.start()
    path = project.root / "work" / "ingest" / "running.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    return path


def test_a_note_counts_while_its_own_process_lives(project):
    path = note(project)
    assert states(project)["ingest"][0] == "running"
    # The number lives on, but it is another process that has it now.
    note(project, process_started=time.time() - psutil.boot_time() - 3600)
    assert states(project)["ingest"][0] == "interrupted"
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    note(project, pid=ended.pid)
    assert states(project)["ingest"][0] == "interrupted"
    path.write_text("{")
    assert states(project)["ingest"][0] == "interrupted"
    note(project, host="another-machine")
    state, reason = states(project)["ingest"]
    assert state == "running"
    assert "cannot be seen from here" in reason


def test_a_run_killed_between_its_record_and_its_note_is_done(project, run):
    run(project)
    record = project.store.load("records", "ingest")
    note(project)
    project.store.save("records", record, "ingest")
    assert states(project)["ingest"][0] == "running"
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    # The note of another run than that of the record.
    note(project, pid=ended.pid)
    project.store.save("records", record, "ingest")
    assert states(project)["ingest"][0] == "interrupted"
    note(project, pid=ended.pid, run=record["run"])
    project.store.save("records", record, "ingest")
    assert states(project)["ingest"][0] == "fresh"


def test_a_clock_that_is_set_ends_no_run(project, monkeypatch):
    note(project)
    assert states(project)["ingest"][0] == "running"
    booted, begun = psutil.boot_time, psutil.Process.create_time
    monkeypatch.setattr(psutil, "boot_time", lambda: booted() + 7200.0)
    monkeypatch.setattr(psutil.Process, "create_time", lambda self: begun(self) + 7200.0)
    assert states(project)["ingest"][0] == "running"
