"""The promises of the command line, kept with a small pipeline."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from fake_pipeline import PIPELINE, fake_project, with_stage

from workbench import doctor
from workbench.cli import run_cli
from workbench.errors import MissingPartError
from workbench.metrics import Metric
from workbench.pipeline.stage import StageResult


@pytest.fixture
def cli(capsys, project):
    """Run a command on the fake project; returns (exit code, the one JSON object)."""

    def call(*arguments, pipeline=PIPELINE):
        code = run_cli(pipeline, [*map(str, arguments), "--json"])
        out, err = capsys.readouterr()
        call.err = err
        assert out.count("\n") == 1, "one line on standard output"
        return code, json.loads(out)

    return call


def failure(cli, *arguments, code=2, **more):
    found, answer = cli(*arguments, **more)
    assert found == code
    assert list(answer) == ["error"]
    assert f"error: {answer['error']['message']}" in cli.err
    if code in (2, 3):
        assert cli.err.strip().endswith(answer["error"]["fix"]), "what can be done comes last"
    return answer["error"]


def test_every_command_of_a_project_gives_its_keys(cli, project):
    root = project.root
    code, plan = cli("plan", root)
    assert code == 0
    assert [set(stage) for stage in plan["stages"]] == [{"name", "action", "reason"}] * 5
    assert {stage["action"] for stage in plan["stages"]} == {"run", "left out"}

    code, ran = cli("run", root, "--workers", "1")
    assert code == 0
    for stage in ran["stages"]:
        assert {"name", "action", "seconds", "peak_rss_bytes", "metrics"} <= set(stage)
        record = root / "work" / stage["name"] / "record.json"
        if stage["action"] == "left out":
            assert not record.exists()
        else:
            kept = json.loads(record.read_text())
            assert {key: kept[key] for key in stage} == stage
            assert {"inputs", "outputs", "output_hashes"} <= set(kept)
    assert "ingest: always needed" in cli.err
    assert "warning: ingest: all is well" in cli.err

    code, status = cli("status", root)
    assert code == 0
    assert [set(stage) for stage in status["stages"]] == [{"name", "state", "reason"}] * 5
    assert {s["name"]: s["state"] for s in status["stages"]} == {
        "ingest": "fresh",
        "register": "left out",
        "fuse": "fresh",
        "export": "fresh",
        "verify": "fresh",
    }

    code, stage = cli("fuse", root, "--set", "fuse.thinning=1")
    assert code == 0
    actions = {s["name"]: s["action"] for s in stage["stages"]}
    assert actions == {"ingest": "fresh", "register": "left out", "fuse": "run"}

    code, verified = cli("verify", root)
    assert code == 0
    assert Path(verified["report"]).is_file()
    assert {"stage", "name", "value", "unit", "description"} == set(verified["metrics"][0])
    assert [m["stage"] for m in verified["metrics"]] == ["ingest", "fuse"]


def test_options_are_listed_for_one_stage_or_all(cli):
    code, answer = cli("options", "fuse")
    assert code == 0
    assert answer["options"][0] == {
        "name": "fuse.thinning",
        "default": "0.5",
        "allowed": "number ≥ 0.0 and ≤ 10.0",
        "meaning": "Thinning | or none.",
    }
    assert len(cli("options")[1]["options"]) == 9
    assert failure(cli, "options", "fusse")["fix"] == "did you mean 'fuse'?"


def test_the_readme_is_rewritten_once(cli, tmp_path):
    readme = tmp_path / "README.md"
    readme.write_text("a\n<!-- begin: stages -->\n<!-- end: stages -->\nb\n")
    assert cli("options", "--readme", readme)[0] == 0
    once = readme.read_text()
    assert "| `fuse` |" in once
    assert cli("options", "--readme", readme)[0] == 0
    assert readme.read_text() == once
    assert "cannot be read" in failure(cli, "options", "--readme", tmp_path / "no.md")["message"]


def test_new_takes_several_values(cli, tmp_path, project):
    scans = project.root.parent / "scans"
    (tmp_path / "x y.jpg").write_bytes(b"")
    (tmp_path / "z.JPG").write_bytes(b"")
    code, made = cli(
        "new", tmp_path / "p", "--scans", scans / "s0.xyz", scans / "s1.xyz",
        "--photos", tmp_path / "x y.jpg", tmp_path / "z.JPG", "--preset", "draft",
    )  # fmt: skip
    assert code == 0
    assert made == {"project": str(tmp_path / "p"), "scans": 2, "photos": 2}
    code, made = cli("new", tmp_path / "q", f"--scans={scans / 's0.xyz'}", scans / "s1.xyz")
    assert made["scans"] == 2
    assert failure(cli, "new", tmp_path / "q", "--scans", scans)["message"].startswith("There is")


def test_new_that_fails_leaves_no_folder(cli, tmp_path):
    for arguments in (
        ("--scans", tmp_path / "nowhere"),
        ("--photos", tmp_path / "nowhere.jpg"),
        ("--scans", tmp_path / "scans", "--geometry", tmp_path / "no.ply"),
        ("--scans", tmp_path / "scans", "--preset", "baroque"),
        (),
    ):
        failure(cli, "new", tmp_path / "made", *arguments)
        assert not (tmp_path / "made").exists()
    (tmp_path / "file").write_text("")
    failure(cli, "new", tmp_path / "file", "--scans", tmp_path / "scans")


def test_bad_input_ends_with_2_and_says_what_to_do(cli, project, tmp_path):
    root = project.root
    error = failure(cli, "plan", tmp_path / "nowhere")
    assert error["fix"].startswith("workbench new")
    assert failure(cli, "run", root, "--set", "fuse.thining=2")["fix"] == (
        "did you mean 'thinning'?"
    )
    assert failure(cli, "run", root, "--set", "fuze.thinning=2")["fix"] == "did you mean 'fuse'?"
    assert (
        "fuse.window.rows" in failure(cli, "run", root, "--set", "fuse.window.rows=99")["message"]
    )
    assert failure(cli, "run", root, "--set", "thinning=2")["expected"] == "stage.option=value"
    for value in ("much", "true", '"1"', "11", "nan", "[1]", ""):
        error = failure(cli, "run", root, "--set", f"fuse.thinning={value}")
        assert "fuse.thinning" in error["message"]
        assert error["expected"]
    assert "or" in failure(cli, "run", root, "--set", "fuse.depth=deep")["expected"]
    assert failure(cli, "run", root, "--from", "fusse")["fix"] == "did you mean 'fuse'?"
    failure(cli, "run", root, "--to", "nothing")
    failure(cli, "run", root, "--only", "fuse")
    assert not (root / "work" / "ingest").exists()
    error = failure(cli, "run", root, "--cluster", "nonsense")
    assert "does not answer" in error["message"]


def test_mistakes_of_the_command_line_itself_are_told_the_same_way(cli, project):
    assert "--frm" in failure(cli, "run", project.root, "--frm", "fuse")["message"]
    assert "rnu" in failure(cli, "rnu", project.root)["message"]
    assert "project" in failure(cli, "run")["message"].lower()
    failure(cli, "run", project.root, "--workers", "0")
    failure(cli)


def test_a_project_file_that_is_wrong_is_refused_with_the_place(cli, project):
    toml = project.root / "project.toml"
    good = toml.read_text()

    def told(text: str) -> dict:
        toml.write_text(text)
        return failure(cli, "status", project.root)

    assert "line 1" in told("schema = \n")["found"]
    assert told(good.replace("preset", "prset"))["fix"] == "did you mean 'preset'?"
    assert told(good.replace("[inputs]", "[inputs]\nscan = []"))["fix"] == "did you mean 'scans'?"
    error = told(good.replace("schema = 1", "schema = 2\nflavour = 'new'"))
    assert (error["expected"], error["found"]) == ("schema 1", "schema 2")
    assert told(good.replace('"default"', '"defualt"'))["fix"] == "did you mean 'default'?"
    assert told(good + "\n[stages]\nfuse = 3\n")["fix"] == "write [stages.register]"
    assert told(good + "\n[stages.fuze]\n")["fix"] == "did you mean 'fuse'?"
    assert "s9.xyz" in told(good.replace("../scans", "../scans/s9.xyz"))["file"]
    toml.write_bytes(b"\xff\xfe")
    failure(cli, "status", project.root)


def test_our_own_fault_ends_with_1_and_a_traceback(cli, project):
    def faulty(job):
        raise ZeroDivisionError("by nothing")

    error = failure(cli, "run", project.root, pipeline=with_stage("export", run=faulty), code=1)
    assert error["message"] == "ZeroDivisionError: by nothing"
    assert "Traceback" in cli.err
    assert "fake_pipeline" not in error["message"]


def test_the_end_of_a_file_in_a_stage_is_no_interruption(cli, project):
    def short(job):
        raise EOFError("no more")

    error = failure(cli, "run", project.root, pipeline=with_stage("export", run=short), code=1)
    assert error["message"] == "EOFError: no more"


@pytest.mark.parametrize(
    ("trouble", "fix"),
    [
        (OSError("libGL.so.1: cannot open shared object file: No such file"), "libgl1"),
        (ImportError("libusb-1.0.so.0: cannot open shared object file"), "libusb-1.0-0"),
        (ModuleNotFoundError("No module named 'pye57'", name="pye57"), "pip install"),
        (MissingPartError("no viewer", fix="sudo apt-get install viewer"), "install viewer"),
    ],
)
def test_a_missing_part_ends_with_3_and_its_install_line(cli, project, trouble, fix):
    def lacking(job):
        raise trouble

    error = failure(cli, "run", project.root, pipeline=with_stage("fuse", run=lacking), code=3)
    assert fix in error["fix"]


def test_a_module_of_ours_that_is_missing_is_our_own_fault(cli, project):
    def lacking(job):
        raise ModuleNotFoundError("No module named 'workbench.x'", name="workbench.x")

    error = failure(cli, "run", project.root, pipeline=with_stage("fuse", run=lacking), code=1)
    assert "workbench.x" in str(error)


def test_a_full_disk_is_not_our_fault(cli, project):
    def full(job):
        raise OSError(28, "No space left on device", "/data/x")

    error = failure(cli, "run", project.root, pipeline=with_stage("fuse", run=full))
    assert error["message"] == "No space left on device"
    assert "Traceback" not in cli.err


def test_what_libraries_print_does_not_reach_standard_output(project):
    """In a process of its own, for what C prints passes by Python."""
    script = f"""
import ctypes, os, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from fake_pipeline import export, with_stage
from workbench.cli import run_cli
def noisy(job):
    print("python")
    ctypes.CDLL(None).printf(b"stdio\\n")
    os.write(1, b"descriptor\\n")
    os.system("echo child")
    return export(job)
sys.exit(run_cli(with_stage("export", run=noisy), sys.argv[1:]))
"""
    done = subprocess.run(
        [sys.executable, "-c", script, "run", str(project.root), "--json", "--workers", "1"],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    assert len(json.loads(done.stdout)["stages"]) == 5
    for word in ("python", "stdio", "descriptor", "child"):
        assert word in done.stderr.split()


def test_a_reader_who_has_seen_enough_is_no_error(project):
    script = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from fake_pipeline import PIPELINE
from workbench.cli import run_cli
sys.stdin.read()
sys.exit(run_cli(PIPELINE, ["plan", sys.argv[1], "--json"]))
"""
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(project.root)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    process.stdout.close()
    process.stdin.close()
    assert process.wait(timeout=60) == 0
    assert process.stderr.read() == b""
    process.stderr.close()


@pytest.mark.parametrize("name", ["a b", "it's", 'say "x"', "Größe 雕像", "[bold]b", "a\\b"])
def test_names_may_be_what_people_call_things(cli, tmp_path, name, capsys):
    project = fake_project(tmp_path / name)
    root = project.root.with_name(name)
    code, _ = cli("new", root, "--scans", tmp_path / name / "scans")
    assert code == 0
    code, ran = cli("run", root, "--workers", "1")
    assert code == 0
    assert [stage["action"] for stage in ran["stages"]].count("run") == 4
    assert (
        run_cli(PIPELINE, ["new", str(root) + "2", "--scans", str(tmp_path / name / "scans")]) == 0
    )
    assert name in capsys.readouterr().out


def test_people_get_tables_and_sentences(project, capsys):
    assert run_cli(PIPELINE, ["plan", str(project.root)]) == 0
    out = capsys.readouterr().out
    assert "left out" in out
    assert "no poses" in out
    assert run_cli(PIPELINE, ["run", str(project.root), "--workers", "1"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("4 of 5 stages run in ")
    assert "report.html" in out
    assert "fuse: done in" in err
    assert run_cli(PIPELINE, ["run", str(project.root)]) == 0
    assert capsys.readouterr().out.startswith("nothing to do: ")
    assert run_cli(PIPELINE, ["status", str(project.root / "nowhere")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: This folder is not a project")


def test_help_lists_the_stages(capsys):
    assert run_cli(PIPELINE, ["--help"]) == 0
    out = capsys.readouterr().out
    for name in ("new", "plan", "run", "status", "simulate", "doctor", "options", "fuse", "verify"):
        assert f" {name} " in out
    assert run_cli(PIPELINE, ["fuse", "--help"]) == 0


def test_the_doctor_names_what_is_missing_and_the_line_that_installs_it(cli, monkeypatch):
    monkeypatch.setattr(doctor, "_MODULES", (("json", "numpy", "x"),))
    code, answer = cli("doctor")
    assert code == 0
    assert answer["ok"] is True
    assert {"name", "ok", "version", "fix", "needed_for"} == set(answer["parts"][0])
    for module, distribution in (("no_such_module_x", "no-such-part-x"), ("antigravitas", "numpy")):
        monkeypatch.setattr(doctor, "_MODULES", ((module, distribution, "testing"),))
        code, answer = cli("doctor")
        assert code == 3
        assert answer["ok"] is False
        (part,) = (p for p in answer["parts"] if p["name"] == distribution)
        assert part["ok"] is False
        assert part["fix"].startswith("python -m pip install")


def test_the_doctor_names_the_package_of_a_missing_library(monkeypatch, tmp_path):
    (tmp_path / "broken_part.py").write_text(
        "raise ImportError('libEGL.so.1: cannot open shared object file: No such file')"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(doctor, "_MODULES", (("broken_part", "numpy", "testing"),))
    report = doctor.report()
    assert report["ok"] is False
    assert report["parts"][1]["fix"] == "sudo apt-get install -y libegl1"
    assert doctor.system_fix("libstrange.so.3: cannot open shared object file") == doctor.APT_LINE
    assert doctor.system_fix("another trouble") is None


def test_a_metric_without_a_value_is_still_json(cli, project):
    def unmeasured(job):
        return StageResult((Metric("m", float("nan"), "", "No number."),))

    pipeline = with_stage("fuse", run=unmeasured, writes=())
    code, ran = cli("run", project.root, "--to", "fuse", pipeline=pipeline)
    assert code == 0
    assert ran["stages"][-1]["metrics"][0]["value"] is None
