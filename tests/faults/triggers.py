"""What is done in a forked process before its run begins."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

_NOBODY = 65534


def nobody() -> None:
    """Become a user to whom permissions apply."""
    if os.geteuid() == 0:
        os.setgroups([])
        os.setgid(_NOBODY)
        os.setuid(_NOBODY)


def with_room() -> None:
    """Have the disk look empty when it is asked, as one that fills up later is."""

    def plenty(path: Any) -> Any:
        return shutil._ntuple_diskusage(1 << 50, 0, 1 << 50)  # type: ignore[attr-defined]

    shutil.disk_usage = plenty


def at_open_of(file: Path, act: Callable[[], Any], times: int) -> None:
    """Call ``act`` as a file is about to be opened for the ``times``-th time."""
    left = [times]

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and arguments[0] is not None and str(arguments[0]) == str(file):
            left[0] -= 1
            if left[0] == 0:
                act()

    sys.addaudithook(hook)
