"""What was freed is given back to the system."""

from __future__ import annotations

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
