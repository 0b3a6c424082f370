"""What was freed is given back to the system."""

from __future__ import annotations

import subprocess
import sys

import psutil
import pytest

from workbench.pipeline.memory import give_back

MIB = 1 << 20


@pytest.mark.skipif(sys.platform != "linux", reason="other systems give back by themselves")
def test_what_was_freed_in_pieces_is_given_back() -> None:
    process = psutil.Process()
    give_back()
    before = process.memory_info().rss
    pieces = [bytes(1000) for _ in range(300_000)]
    kept = pieces[::1000]  # so that the heap cannot shrink from its end alone
    del pieces
    held = process.memory_info().rss - before
    give_back()
    assert held > 100 * MIB
    assert process.memory_info().rss - before < 30 * MIB
    assert len(kept) == 300


LEFT_BEHIND = """
import sys, numpy as np, psutil
from workbench.pipeline.memory import keep_little
if sys.argv[1] == "little":
    keep_little()
np.ones(30 << 17)  # once freed, glibc places what is smaller among small pieces
before = psutil.Process().memory_info().rss
pictures, kept = [], []
for _ in range(40):
    pictures.append(np.ones(6 << 17))
    kept.append(bytes(200_000))  # which the heap cannot shrink below
del pictures
print(psutil.Process().memory_info().rss - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems give back by themselves")
def test_pictures_one_after_another_leave_nothing_behind() -> None:
    def left(how: str) -> int:
        command = [sys.executable, "-c", LEFT_BEHIND, how]
        return int(subprocess.run(command, capture_output=True, check=True, text=True).stdout)

    assert left("little") < 30 * MIB
    assert left("as it comes") > 150 * MIB
