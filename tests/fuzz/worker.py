"""A process that reads damaged files until it is done or dies; `tests.fuzz.run` starts it.

Every line it prints is one JSON object: how far it is, or a finding. The files being read lie
packed in ``current`` of its folder, so that they are there when native code ends the process.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import logging
import os
import random
import resource
import sys
import time
import warnings
from pathlib import Path
from typing import Any

from tests.fuzz.execution import Outcome, read_once
from tests.fuzz.mutation import Mutator
from tests.fuzz.table import TARGETS, corpus_of
from tests.fuzz.target import SEPARATOR, Target, packed

_ADDRESS_SPACE = 1 << 30
_REPAIRED = 0.75
_MOST_SEEDS, _MOST_OF_A_KIND = 400, 3
_SECONDS_BETWEEN = 2.0
_MOST_HELD, _BETWEEN_LOOKS = 1 << 28, 128


class Worker:
    """Damages, reads, judges and tells."""

    def __init__(self, target: Target, folder: Path, seed: int, engine: str) -> None:
        self.target, self.folder, self.engine = target, folder, engine
        self.inputs, self.current = folder / "inputs", folder / "current"
        self.inputs.mkdir(exist_ok=True)
        made = folder / "made"
        made.mkdir(exist_ok=True)
        self.seeds = [packed(parts) for parts in target.seeds(made)]
        self.chance = random.Random(seed)
        self.done, self.values = 0, 0
        self.worst = {"grown": 0, "multiple": 0.0, "seconds": 0.0}
        self._seen: set[str] = set()
        self._told: dict[str, int] = {}
        self._last = time.monotonic()
        # Good files first: libraries are loaded and kernels compiled before limits are set.
        self.turns = len(target.readers)
        for seed in self.seeds:
            self._warm_up(seed)
        self.seeds += corpus_of(target.name)
        self.mutator = Mutator(
            [part for seed in self.seeds for part in seed.split(SEPARATOR)], self.chance
        )

    def _warm_up(self, seed: bytes) -> None:
        outcomes = [
            read_once(self.target, self.inputs, seed, turn) for turn in 2 * [*range(self.turns)]
        ]
        if not any(outcome.kind == "value" for outcome in outcomes):
            raise ValueError(f"no reader of {self.target.name} takes a good file: {outcomes[0]}")

    def damaged(self, content: bytes) -> bytes:
        """One file of some packed ones damaged, and its check sums perhaps put right."""
        parts = content.split(SEPARATOR)
        k = self.chance.randrange(len(parts))
        parts[k] = self.mutator.damaged(parts[k])
        repair = self.target.repair
        if repair is not None and k == 0 and self.chance.random() < _REPAIRED:
            parts[0] = repair(parts[0])
        return SEPARATOR.join(parts)

    def read(self, content: bytes) -> None:
        """Read some packed files, and tell what is wrong with that."""
        self.current.write_bytes(content)
        outcome = read_once(self.target, self.inputs, content, self.done)
        self.done += 1
        self.values += outcome.kind == "value"
        self._keep(content, outcome)
        self.worst["seconds"] = max(self.worst["seconds"], outcome.seconds)
        self.worst["grown"] = max(self.worst["grown"], outcome.grown)
        above = outcome.grown - self.target.memory_bytes
        self.worst["multiple"] = max(self.worst["multiple"], above / max(outcome.size, 1))
        if outcome.is_finding:
            self._tell_finding(content, outcome)
        if time.monotonic() > self._last + _SECONDS_BETWEEN:
            self.tell_progress()

    def _keep(self, content: bytes, outcome: Outcome) -> None:
        """What ends at a line where nothing ended before leads further: it is a seed too."""
        if outcome.where and outcome.where not in self._seen and self.engine == "own":
            self._seen.add(outcome.where)
            if len(self.seeds) < _MOST_SEEDS:
                self.seeds.append(content)

    def _tell_finding(self, content: bytes, outcome: Outcome) -> None:
        key = f"{outcome.kind} {outcome.where}"
        self._told[key] = self._told.get(key, 0) + 1
        if self._told[key] > _MOST_OF_A_KIND:
            return
        name = hashlib.sha256(content).hexdigest()[:12]
        (self.folder / name).write_bytes(content)
        _say({"finding": {"key": key, "told": outcome.told[-3000:], "input": name}})

    def tell_progress(self) -> None:
        """How far it is."""
        self._last = time.monotonic()
        _say({"done": self.done, "values": self.values, "lines": len(self._seen), **self.worst})

    def run(self, executions: int) -> None:
        """Read so many damaged files, or fewer: another process goes on where much is held.

        libE57 never frees the two mebibytes of some files that it gives up. That is told of one
        file by what it grew; of a million it would end the process.
        """
        most = _held() + _MOST_HELD
        while self.done < executions and (self.done % _BETWEEN_LOOKS or _held() < most):
            # Half of the time from good files, else from what led somewhere new.
            pool = self.seeds if self.chance.random() < 0.5 else self.seeds[-60:]
            self.read(self.damaged(self.chance.choice(pool)))

    def run_guided(self, executions: int) -> None:
        """The same with what to damage chosen by the lines of Python it covers."""
        import atheris

        corpus = self.folder / "corpus"
        corpus.mkdir(exist_ok=True)
        for k, seed in enumerate(self.seeds):
            (corpus / f"seed-{k}").write_bytes(seed)

        def mutate(content: bytes, most: int, number: int) -> bytes:
            self.chance.seed(number)
            if self.chance.random() < 0.2:
                return bytes(atheris.Mutate(content, most))
            return self.damaged(content)[:most]

        def one(content: bytes) -> None:
            self.read(content)
            if self.done >= executions:
                self.tell_progress()
                os._exit(0)

        options = ["fuzz", f"-seed={self.chance.randrange(1, 2**31)}", "-max_len=65536"]
        options += ["-rss_limit_mb=0", "-timeout=0", "-verbosity=0", str(corpus)]
        atheris.Setup(options, one, custom_mutator=mutate, internal_libfuzzer=True)
        atheris.Fuzz()


def _say(told: dict[str, Any]) -> None:
    sys.__stdout__.write(json.dumps(told) + "\n")  # type: ignore[union-attr]
    sys.__stdout__.flush()  # type: ignore[union-attr]


def _held(column: int = 1) -> int:
    """Bytes of memory of this process, of address space with ``column`` 0."""
    pages = int(Path("/proc/self/statm").read_text().split()[column])
    return pages * resource.getpagesize()


def limit_memory() -> None:
    """Let this process take a gibibyte more than it has; no core is dumped."""
    most = _held(0) + _ADDRESS_SPACE
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main() -> None:
    """Fuzz one reader."""
    parser = argparse.ArgumentParser()
    parser.add_argument("reader", choices=TARGETS)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--executions", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engine", choices=("own", "atheris"), default="own")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    worker = Worker(TARGETS[given.reader], given.folder, given.seed, given.engine)
    limit_memory()
    if given.engine == "atheris":
        worker.run_guided(given.executions)
    else:
        worker.run(given.executions)
    worker.tell_progress()


if __name__ == "__main__":
    main()
