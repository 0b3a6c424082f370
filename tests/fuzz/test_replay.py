"""What was once a finding is none any more, and a little fuzzing finds nothing."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.fuzz.checksums import repaired_e57, repaired_png, repaired_zip
from tests.fuzz.execution import read_once
from tests.fuzz.mutation import Mutator
from tests.fuzz.table import CORPUS, TARGETS, corpus_of
from tests.fuzz.target import MIB, Target
from workbench.errors import InputError


def test_the_corpus_is_read_or_refused_with_help():
    command = [sys.executable, "-m", "tests.fuzz.replay", "60"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
    # What was being read when native code ended the process is the last thing it said.
    assert done.returncode == 0, done.stderr[-300:]
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["wrong"] == []
    assert set(told["read"]) == set(TARGETS)
    assert min(told["read"].values()) >= 60


def test_the_corpus_is_of_known_readers_and_small():
    assert {folder.name for folder in CORPUS.iterdir()} <= set(TARGETS)
    files = [path for path in CORPUS.rglob("*") if path.is_file()]
    assert max(path.stat().st_size for path in files) < 8 << 10
    assert sum(path.stat().st_size for path in files) < 1 << 20
    assert sum(len(corpus_of(name)) for name in TARGETS) == len(files)


def target_of(reader) -> Target:
    return Target("x", ("a",), lambda _: [(b"",)], (reader,), memory_bytes=16 * MIB, seconds=0.25)


def refuse(**told):
    def reader(folder):
        raise InputError("no", **told)

    return reader


def busy(folder):
    start = time.process_time()
    while time.process_time() < start + 0.3:
        pass


def huge(folder):
    return bytearray(64 * MIB)


@pytest.mark.parametrize(
    ("reader", "kind"),
    [
        (lambda folder: 1, "value"),
        (lambda folder: 1 / 0, "exception"),
        (lambda folder: refuse(file=folder / "a", fix="copy it")(folder), "refused"),
        (lambda folder: refuse(file=folder / "a")(folder), "unhelpful"),
        (refuse(fix="copy it"), "unhelpful"),
        (refuse(file="/etc/passwd", fix="copy it"), "unhelpful"),
        (huge, "memory"),
        (busy, "slow"),
    ],
)
def test_outcomes_are_told_apart(tmp_path: Path, reader, kind):
    folder = tmp_path / "inputs"
    folder.mkdir()
    target = target_of(reader)
    assert read_once(target, folder, b"some bytes", 0).kind == kind


def test_a_swallowed_lack_of_memory_is_a_finding(tmp_path: Path):
    def reader(folder):
        try:
            raise MemoryError
        except MemoryError as error:
            raise InputError("no", file=folder / "a", fix="copy it") from error

    assert read_once(target_of(reader), tmp_path, b"", 0).kind == "memory"


def test_the_same_seed_gives_the_same_damage_and_never_none_for_long():
    content = b"element vertex 4\nproperty float x\n1.5 2 3\n" * 20
    damaged = [
        [mutator.damaged(content) for _ in range(300)]
        for mutator in (Mutator([content], random.Random(9)) for _ in range(2))
    ]
    assert damaged[0] == damaged[1]
    assert sum(one != content for one in damaged[0]) > 280
    assert any(b"9223372036854775808" in one for one in damaged[0])
    assert any(b"etc/passwd" in one for one in damaged[0])


@pytest.mark.parametrize(
    ("name", "repair"),
    [("png", repaired_png), ("e57", repaired_e57), ("work-arrays", repaired_zip)],
)
def test_check_sums_are_put_right(tmp_path: Path, name, repair):
    content = TARGETS[name].seeds(tmp_path)[0][0]
    assert repair(content) == content
    # In the pixels, a page, an array: past what is read of the head.
    at = len(content) // 2
    broken = content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]
    assert repair(broken) not in (broken, content)


@pytest.mark.parametrize("name", ["voxel-lod", "voxel-graph", "surfels", "point-cubes"])
def test_files_with_their_sums_put_right_are_read_further(tmp_path: Path, name):
    target = TARGETS[name]
    made, inputs = tmp_path / "made", tmp_path / "inputs"
    made.mkdir()
    inputs.mkdir()
    content = target.seeds(made)[-1][0]
    assert target.repair is not None
    assert read_once(target, inputs, target.repair(content), 0).kind == "value"
    lines = [set(), set()]
    chance = random.Random(4)
    mutator = Mutator([content], chance)
    for _ in range(400):
        damaged = mutator.damaged(content)
        for k, tried in enumerate((damaged, target.repair(damaged))):
            lines[k].add(read_once(target, inputs, tried, 0).where)
    assert len(lines[1]) > len(lines[0])
