"""All that was ever a finding, read again in a process of its own: ``python -m tests.fuzz.replay``.

Prints one JSON object: what is wrong, and how much was read.
"""

from __future__ import annotations

import json
import logging
import sys
import tempfile
import time
import warnings
from pathlib import Path

from tests.fuzz.execution import read_once
from tests.fuzz.table import TARGETS, corpus_of
from tests.fuzz.worker import Worker, limit_memory


def main(damaged_each: int) -> None:
    """Read the corpus and some damaged files of every reader."""
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    wrong: list[str] = []
    read: dict[str, int] = {}
    seconds: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        workers = []
        for name, target in TARGETS.items():
            start = time.perf_counter()
            place = Path(folder) / name
            place.mkdir()
            workers.append(Worker(target, place, 1, "own"))
            seconds[name] = time.perf_counter() - start
        # Kernels are compiled and libraries loaded by now.
        limit_memory()
        for worker in workers:
            target, name = worker.target, worker.target.name
            start = time.perf_counter()
            known = corpus_of(name)
            tries = [(content, turn) for content in known for turn in range(worker.turns)]
            tries += [(worker.damaged(worker.seeds[0]), k) for k in range(damaged_each)]
            for content, turn in tries:
                # Said first: where native code ends the process, this is the reader.
                print(f"{name} {len(content)}", file=sys.stderr, flush=True)
                outcome = read_once(target, worker.inputs, content, turn)
                if outcome.is_finding:
                    wrong.append(f"{name}: {outcome.kind} {outcome.where}\n{outcome.told[-1500:]}")
            read[name] = len(tries)
            seconds[name] += time.perf_counter() - start
    print(json.dumps({"wrong": wrong, "read": read, "seconds": seconds}))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60)
