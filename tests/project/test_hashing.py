from __future__ import annotations

import hashlib
import json
import os
import time

import pytest

from workbench.errors import InputError
from workbench.project import hashing
from workbench.project.hashing import FileHashes, hash_of_value


@pytest.fixture
def memory(tmp_path):
    (tmp_path / "work").mkdir()
    return tmp_path / "work" / "hashes.json"


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"0123")
    return path


def settle() -> None:
    time.sleep(hashing._TICK_NS / 1e9 * 1.5)


@pytest.fixture
def reads(monkeypatch):
    """The files read for hashing, as they are read."""
    seen = []
    real = hashlib.file_digest
    monkeypatch.setattr(
        hashing.hashlib, "file_digest", lambda f, kind: seen.append(f.name) or real(f, kind)
    )
    return seen


def test_the_hash_is_blake2b_of_the_content(file, memory, tmp_path):
    expected = hashlib.blake2b(b"0123", digest_size=20).hexdigest()
    assert FileHashes(memory, tmp_path).of_file(file) == f"blake2b:{expected}"


def test_a_settled_file_is_read_once_by_all(file, memory, tmp_path, reads):
    settle()
    first = FileHashes(memory, tmp_path)
    known = first.of_file(file)
    assert first.of_file(file) == known
    first.save()
    assert FileHashes(memory, tmp_path).of_file(file) == known
    assert len(reads) == 1


def test_an_edit_right_after_hashing_cannot_hide(file, memory, tmp_path):
    """Within one tick of the clock a file system gives two edits the same times."""
    hashes = FileHashes(memory, tmp_path)
    for number in range(200):
        content = f"{number:04d}".encode()
        with open(file, "r+b") as stream:
            stream.write(content)
        expected = hashlib.blake2b(content, digest_size=20).hexdigest()
        assert hashes.of_file(file) == f"blake2b:{expected}"


def test_an_edit_cannot_hide_behind_an_old_date(file, memory, tmp_path):
    settle()
    hashes = FileHashes(memory, tmp_path)
    status, before = file.stat(), hashes.of_file(file)
    with open(file, "r+b") as stream:
        stream.write(b"9")
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert hashes.of_file(file) != before


def test_a_link_that_leads_elsewhere_is_read_again(file, memory, tmp_path):
    other, link = tmp_path / "b.bin", tmp_path / "link"
    other.write_bytes(b"4567")
    link.symlink_to(file)
    settle()
    hashes = FileHashes(memory, tmp_path)
    before = hashes.of_file(link)
    link.unlink()
    link.symlink_to(other)
    assert hashes.of_file(link) == hashes.of_file(other) != before


def test_the_memory_moves_with_the_folder(tmp_path, reads):
    old = tmp_path / "old"
    (old / "work").mkdir(parents=True)
    (old / "a").write_bytes(b"a")
    settle()
    hashes = FileHashes(old / "work" / "h.json", old)
    known = hashes.of_file(old / "a")
    hashes.save()
    old.rename(tmp_path / "new")
    new = tmp_path / "new"
    assert FileHashes(new / "work" / "h.json", new).of_file(new / "a") == known
    assert len(reads) == 1


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "3", '{"a.bin": 3}', '{"a.bin": [1]}', '{"a.bin": [1,2,3,4,5]}']
)
def test_a_broken_memory_costs_only_time(file, memory, tmp_path, text):
    memory.write_text(text)
    expected = hashlib.blake2b(b"0123", digest_size=20).hexdigest()
    assert FileHashes(memory, tmp_path).of_file(file) == f"blake2b:{expected}"


def test_what_is_gone_is_forgotten(file, memory, tmp_path):
    other = tmp_path / "b"
    other.write_bytes(b"b")
    settle()
    hashes = FileHashes(memory, tmp_path)
    hashes.of_files([file, other])
    other.unlink()
    hashes.save()
    assert list(json.loads(memory.read_text())) == ["a.bin"]


def test_a_memory_that_cannot_be_written_is_no_error(file, memory, tmp_path, monkeypatch):
    settle()
    hashes = FileHashes(memory, tmp_path)
    hashes.of_file(file)

    def refused(*_):
        raise PermissionError

    monkeypatch.setattr(os, "replace", refused)
    hashes.save()
    assert not memory.exists()


def test_names_and_order_count_for_several_files(file, memory, tmp_path):
    twin = tmp_path / "twin"
    twin.write_bytes(b"0123")
    hashes = FileHashes(memory, tmp_path)
    both = hashes.of_files([file, twin])
    assert both != hashes.of_files([twin, file])
    assert hashes.of_files([file]) != hashes.of_files([twin])
    with pytest.raises(InputError, match="cannot be read") as caught:
        hashes.of_file(tmp_path / "none")
    assert caught.value.file == str(tmp_path / "none")


def test_values_are_hashed_by_content_not_by_order_of_keys():
    assert hash_of_value({"a": 1, "b": [1, 2]}) == hash_of_value({"b": [1, 2], "a": 1})
    different = [1, 1.5, "1", True, None, [1], {"a": 1}, [2, 1], [1, 2], float("nan")]
    assert len({hash_of_value(value) for value in different}) == len(different)
