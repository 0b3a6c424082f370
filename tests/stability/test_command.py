"""The command ``stability``: its table, its exit status, and the table in a project's report."""

from __future__ import annotations

import json

import pytest
import trimesh

from stages.main import PIPELINE
from workbench.cli import run_cli
from workbench.stability import table
from workbench.stability.case import Bound, Case, Measured

KEYS = {
    "name", "method", "stiff", "outcome", "passed", "value", "unit", "bound", "source", "reason",
    "seconds",
}  # fmt: skip


@pytest.fixture
def cli(capsys):
    """Run a command; returns (exit code, the one JSON object)."""

    def call(*arguments):
        code = run_cli(PIPELINE, [*map(str, arguments), "--json"])
        out, _ = capsys.readouterr()
        assert out.count("\n") == 1, "one line on standard output"
        return code, json.loads(out)

    return call


@pytest.fixture
def wrong_case(monkeypatch) -> Case:
    """The one case of the table: its value is twice its bound."""
    bound = Bound(1.0, "m", "a metre, as everyone knows")
    case = Case("masks/too far", "guessing", "It is stiff.", lambda: Measured(2.0), bound)
    monkeypatch.setattr(table, "ALL_CASES", (case,))
    return case


def test_cases_that_pass_are_told_one_by_one(cli, tmp_path):
    code, told = cli("stability", "--quick", "--only", "masks/", "--out", tmp_path)
    assert code == 0
    assert told["wrong"] == 0
    assert told["quick"] is True
    assert told["right"] + told["refused"] == len(told["cases"]) > 5
    assert all(set(case) == KEYS for case in told["cases"])
    assert json.loads((tmp_path / "stability.json").read_text()) == told


def test_a_wrong_answer_is_the_exit_status(cli, wrong_case):
    code, told = cli("stability")
    assert code == 1
    assert told["wrong"] == 1
    (case,) = told["cases"]
    assert (case["outcome"], case["value"], case["bound"]) == ("WRONG", 2.0, 1.0)


def test_people_see_a_table(capsys, wrong_case):
    assert run_cli((), ["stability"]) == 1
    out, _ = capsys.readouterr()
    assert "too far" in out
    assert "WRONG" in out
    assert "1 wrong" in " ".join(out.split())


@pytest.mark.parametrize(
    "arguments",
    [("--only", "nothing like it"), ("--out", "/nowhere/at/all"), ("/nowhere/at/all",)],
)
def test_what_is_not_there_is_said_before_anything_runs(cli, arguments, monkeypatch):
    monkeypatch.setattr(table, "tried", None)
    code, answer = cli("stability", *arguments)
    assert code == 2
    assert answer["error"]["fix"]


def test_a_projects_report_has_the_table(cli, tmp_path):
    ball, project = tmp_path / "ball.ply", tmp_path / "project"
    trimesh.creation.icosphere(2).export(ball)
    cli("new", project, "--geometry", ball)
    code, told = cli("stability", project, "--only", "masks/N*")
    assert code == 0
    kept = json.loads((project / "work" / "stability" / "table.json").read_text())
    assert kept == told
    code, answer = cli("verify", project)
    assert code == 0
    assert {"stability_right", "stability_refused", "stability_wrong"} <= {
        metric["name"] for metric in answer["metrics"]
    }
    report = json.loads((project / "report" / "report.json").read_text())
    (chapter,) = [s for s in report["sections"] if s["title"] == "Stability"]
    assert "evidence cannot be cut by" in json.dumps(chapter)
    # Another table makes the report stale, and nothing else.
    cli("stability", project, "--only", "masks/i*")
    stages = {stage["name"]: stage for stage in cli("plan", project)[1]["stages"]}
    assert stages["export"]["action"] == "fresh"
    assert "stiff and extreme cases" in stages["verify"]["reason"]
