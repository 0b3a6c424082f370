"""A handful of kills, and other faults of a few stages: `make faults` does many of all."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from workbench.verification.fault_sections import fault_metrics, fault_section
from workbench.verification.report_content import Table, TextList

KILLED = ("ingest", "fuse", "texture")


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """The table of a quick run; a process of its own, for it keeps to one core."""
    out = tmp_path_factory.mktemp("faults")
    command = [sys.executable, "-m", "tests.faults.run", "--quick", "--out", str(out)]
    command += ["--kills", "9", "--worker-kills", "0"]
    command += [word for stage in KILLED for word in ("--stage", stage)]
    done = subprocess.run(
        command,
        cwd=Path(__file__).resolve().parents[2],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert (out / "faults.json").is_file(), done.stderr[-3000:]
    return json.loads((out / "faults.json").read_text("utf-8")), out / "project"


def test_kills_lose_nothing_and_leave_nothing_wrong(found):
    table, _ = found
    assert table["kills"] >= 9
    assert {row["stage"] for row in table["stages"]} == set(KILLED)
    assert [problem for row in table["stages"] for problem in row["problems"]] == []
    assert (table["lost"], table["wrong"]) == (0, 0)
    # Every chain was run to its end.
    assert all(row["resumed"] for row in table["stages"])


def test_other_faults_are_told_with_what_to_do_or_mended(found):
    table, _ = found
    assert {row["fault"] for row in table["faults"]} == {
        "disk full", "read-only folder", "unreadable input", "vanishing input", "clock steps",
        "corrupted product", "damaged record", "two runs at once", "moved project", "older schema",
    }  # fmt: skip
    assert [(row["done"], row["problem"]) for row in table["faults"] if not row["passed"]] == []


def test_the_report_of_the_project_has_the_table(found):
    _, project = found
    report = json.loads((project / "report" / "report.json").read_text("utf-8"))
    assert "Faults" in [section["title"] for section in report["sections"]]


ROW = {
    "stage": "fuse", "moments": 3, "writes": 2, "workers": 1, "resumed": 2,
    "found_as": {"fresh": 1, "interrupted": 5}, "lost": 0, "wrong": 1,
    "problems": ["wrong: other bytes"],
}  # fmt: skip
FAULT = {
    "fault": "disk full", "done": "no room", "expected": "refused", "told": "make room",
    "passed": False, "problem": "it does not name a file",
}  # fmt: skip
TOLD = {
    "seconds": 9.0, "kills": 6, "lost": 0, "wrong": 1, "failed": 1, "stages": [ROW],
    "faults": [FAULT],
}  # fmt: skip


def test_what_is_wrong_comes_first_and_breaks_its_bound():
    section = fault_section(TOLD)
    listed = section.blocks[1]
    assert isinstance(listed, TextList)
    assert listed.items == (
        "fuse: wrong: other bytes", "disk full, no room: it does not name a file",
    )  # fmt: skip
    tables = [block for block in section.blocks if isinstance(block, Table)]
    assert tables[0].rows == (("fuse", 3, 2, 1, "1 fresh, 5 interrupted", 0, 1),)
    assert tables[1].rows[0][1:] == ("NOT as it should be", "make room")
    kills, lost, wrong, failed = fault_metrics(TOLD)
    assert kills.value == 6
    assert (lost.passed, wrong.passed, failed.passed) == (True, False, False)
    assert not any(
        isinstance(block, TextList)
        for block in fault_section({**TOLD, "stages": [], "faults": []}).blocks
    )
