"""An import goes down a floor, never up; stages share files, not code."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
    "importlinter"
]["contracts"]


def test_all_contracts_are_kept(monkeypatch, capsys):
    linter = pytest.importorskip("importlinter.cli")
    monkeypatch.chdir(ROOT)
    code = linter.lint_imports(config_filename="pyproject.toml", no_cache=True)
    assert code == linter.EXIT_STATUS_SUCCESS, capsys.readouterr().out


def test_every_part_of_the_library_has_its_floor():
    (layers,) = (contract["layers"] for contract in CONTRACTS if contract["type"] == "layers")
    placed = {name.strip() for layer in layers for name in layer.split("|")}
    there = {
        f"workbench.{path.stem}"
        for path in (ROOT / "workbench").iterdir()
        if (path.is_dir() and (path / "__init__.py").exists())
        or (path.suffix == ".py" and path.stem != "__init__")
    }
    assert there <= placed, "name them in [tool.importlinter] of pyproject.toml"
    assert "stages" in placed


def test_the_library_never_names_a_stage_module():
    importing = [
        str(path.relative_to(ROOT))
        for path in (ROOT / "workbench").rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if line.strip().startswith(("import stages", "from stages"))
    ]
    assert importing == []
