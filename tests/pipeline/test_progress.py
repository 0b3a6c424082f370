from __future__ import annotations

import io
import re

import numpy as np
import pytest
from fake_pipeline import fake_project, normals_of

from workbench.pipeline import progress as progress_module
from workbench.pipeline.meter import Meter
from workbench.pipeline.progress import Progress, Step, format_seconds
from workbench.pipeline.tasks import Tasks
from workbench.project.hashing import FileHashes


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    def __init__(self, monkeypatch) -> None:
        self.now = 100.0
        monkeypatch.setattr(progress_module.time, "monotonic", lambda: self.now)


@pytest.fixture
def clock(monkeypatch) -> Clock:
    return Clock(monkeypatch)


def test_no_time_to_go_is_told_before_it_can_be_known(clock):
    step = Step(Progress(io.StringIO()), "scans", 10)
    assert step.eta_seconds(clock.now) is None
    clock.now += 5
    step.advance(2)
    assert step.eta_seconds(clock.now) is None  # two items are no pace
    step.advance()
    assert step.eta_seconds(clock.now) == pytest.approx(7 * 5 / 3)
    assert step.text(clock.now) == "scans 3/10, about 12 s to go"
    early = Step(Progress(io.StringIO()), "scans", 10)
    clock.now += 1
    early.advance(5)
    assert early.eta_seconds(clock.now) is None  # one second is none either
    unknown = Step(Progress(io.StringIO()), "scans", None)
    clock.now += 60
    unknown.advance(50)
    assert unknown.text(clock.now) == "scans 50"


def test_what_was_kept_does_not_make_the_rest_look_quick(clock):
    step = Step(Progress(io.StringIO()), "scans", 1000)
    step.advance(900, reused=True)
    clock.now += 30
    step.advance(2)
    assert step.eta_seconds(clock.now) is None
    step.advance(1)
    # Three items took 30 s, so 97 more take 970 s, however many were there before.
    assert step.eta_seconds(clock.now) == pytest.approx(970)
    assert step.text(clock.now) == "scans 903/1000, about 16 min 10 s to go"
    step.advance(97)
    assert "to go" not in step.text(clock.now)


def test_a_file_gets_plain_lines_and_not_too_many(clock):
    stream = io.StringIO()
    progress = Progress(stream)
    with progress.step("scans", 100) as step:
        for _ in range(100):
            clock.now += 0.1
            step.advance()
    text = stream.getvalue()
    assert "\r" not in text
    assert "\x1b" not in text
    lines = text.splitlines()
    assert lines[0] == "  scans …"
    assert 4 <= len(lines) <= 6
    assert all(re.fullmatch(r"  scans \d+/100, about [\d.]+ s to go", line) for line in lines[1:])


def test_a_terminal_gets_one_line_that_changes_and_is_gone_at_the_end(clock):
    stream = Terminal()
    progress = Progress(stream)
    progress.line("ingest: first")
    with progress.step("scans", 3) as step:
        clock.now += 3
        step.advance()
    print("error: something", file=stream)
    assert stream.getvalue() == (
        "ingest: first\n  scans …\r\x1b[2K  scans 1/3\r\x1b[2Kerror: something\n"
    )


def test_warnings_are_written_even_when_quiet():
    stream = io.StringIO()
    progress = Progress(stream, quiet=True)
    progress.line("nothing")
    progress.warning("something")
    progress.line("nothing")
    assert stream.getvalue() == "warning: something\n"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.04, "0.0 s"),
        (9.94, "9.9 s"),
        (9.97, "10 s"),
        (59.6, "1 min 00 s"),
        (200, "3 min 20 s"),
        (3599.7, "1 h 00 min"),
        (7500, "2 h 05 min"),
    ],
)
def test_durations_are_written_for_people(seconds, text):
    assert format_seconds(seconds) == text


def test_items_that_are_kept_are_counted_as_such(tmp_path, clock):
    project = fake_project(tmp_path)
    items = {name: {"name": name, "lines": [name]} for name in "abcde"}
    steps = []

    class Watched(Progress):
        def step(self, label, total=None):
            manager = super().step(label, total)
            steps.append(manager)
            return manager

    def mapped(items) -> str:
        stream = io.StringIO()
        Tasks(
            root=project.root, stage="fuse", fingerprint="f", progress=Watched(stream),
            hashes=FileHashes(tmp_path / "h", project.root), writes=("oriented_scans",),
        ).map_items("items", normals_of, items)  # fmt: skip
        return stream.getvalue()

    mapped(items)
    clock.now += 100
    assert "to go" not in mapped(items | {"f": {"name": "f", "lines": ["f"]}})


def test_the_meter_sees_time_and_memory():
    with Meter() as idle:
        pass
    with Meter() as meter:
        block = np.ones(30_000_000)
        block.sum()
        for _ in range(20):
            block.sort()
    assert idle.peak_rss_bytes > 10_000_000
    assert meter.peak_rss_bytes > idle.peak_rss_bytes + 200_000_000
    assert meter.seconds > idle.seconds >= 0
    assert meter.cpu_seconds > 0


def test_the_meter_counts_children():
    import subprocess
    import sys

    script = "import time; block = bytearray(300_000_000); time.sleep(1.2)"
    with Meter() as meter:
        subprocess.run([sys.executable, "-c", script], check=True)
    with Meter() as alone:
        pass
    assert meter.peak_rss_bytes > alone.peak_rss_bytes + 250_000_000


def test_work_that_tells_its_shares_becomes_steps(clock):
    written = io.StringIO()
    with Progress(written).shares() as told:
        for share in (0.0, 0.25, 0.5):
            told("features", share)
            clock.now += 10
        told("pairs", 0.0)
        clock.now += 10
        told("pairs", 1.0)
    lines = written.getvalue().splitlines()
    assert lines[0] == "  features …"
    assert "  features 50/100, about 20 s to go" in lines
    assert lines[-2:] == ["  pairs …", "  pairs 100/100"]
