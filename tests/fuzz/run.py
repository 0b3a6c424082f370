"""``make fuzz``: readers against damaged files, in processes of their own.

    python -m tests.fuzz.run --executions 1000000 --reader ply --reader ptx

prints a table and writes it with all findings as JSON; files that were findings lie beside.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tests.fuzz.table import TARGETS

_MOST_DEATHS = 12
_SILENT_S = 300.0


@dataclass
class Row:
    """What came of one reader."""

    reader: str
    executions: int = 0
    seconds: float = 0.0
    values: int = 0
    lines: int = 0
    worst_mib: float = 0.0
    worst_multiple: float = 0.0
    allowed_multiple: float = 0.0
    allowed_mib: float = 0.0
    slowest_s: float = 0.0
    findings: dict[str, dict[str, Any]] = field(default_factory=dict)


def fuzzed(reader: str, executions: int, seed: int, engine: str, out: Path) -> Row:
    """Fuzz one reader with as many processes, one after another, as it takes."""
    target = TARGETS[reader]
    row = Row(reader, allowed_multiple=target.memory_multiple)
    row.allowed_mib = target.memory_bytes / 2**20
    deaths, start = 0, time.monotonic()
    while row.executions < executions and deaths < _MOST_DEATHS:
        before = row.executions
        code = _one_process(row, executions - before, seed + before + deaths, engine, out)
        if code and not row.executions:
            break  # it did not even begin
        deaths += bool(code)
        row.seconds = time.monotonic() - start
    return row


def _one_process(row: Row, executions: int, seed: int, engine: str, out: Path) -> int:
    # Memory, not a disk: files are written a thousand times a second.
    place = "/dev/shm" if os.path.isdir("/dev/shm") else None
    with tempfile.TemporaryDirectory(dir=place, prefix="fuzz-") as folder:
        module = {"own": "worker", "atheris": "guided"}[engine]
        command = [sys.executable, "-m", f"tests.fuzz.{module}", row.reader, folder]
        command += ["--executions", str(executions), "--seed", str(seed), "--engine", engine]
        environment = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
        with (
            open(Path(folder) / "said", "wb") as said,
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=said, text=True, env=environment
            ) as process,
        ):
            before = row.executions, row.values
            for line in process.stdout or ():
                if line.startswith("{"):
                    _take(row, json.loads(line), before, Path(folder), out)
            code = process.wait()
        current = Path(folder) / "current"
        if code:
            last = (Path(folder) / "said").read_text(errors="replace")[-3000:]
            name = signal.Signals(-code).name if code < 0 else f"exit {code}"
            kept = _kept(current, row.reader, out) if current.exists() else ""
            row.executions += current.exists()
            row.findings.setdefault(f"{name} {last[-80:].strip()}", {"told": last, "input": kept})
        return code


def _take(row: Row, told: dict[str, Any], before: tuple[int, int], folder: Path, out: Path) -> None:
    if "finding" in told:
        finding = told["finding"]
        if finding["key"] not in row.findings:
            finding["input"] = _kept(folder / finding["input"], row.reader, out)
            row.findings[finding.pop("key")] = finding
        return
    row.executions, row.values = before[0] + told["done"], before[1] + told["values"]
    row.lines = max(row.lines, told["lines"])
    row.worst_mib = max(row.worst_mib, told["grown"] / 2**20)
    row.worst_multiple = max(row.worst_multiple, told["multiple"])
    row.slowest_s = max(row.slowest_s, told["seconds"])


def _kept(file: Path, reader: str, out: Path) -> str:
    folder = out / reader
    folder.mkdir(parents=True, exist_ok=True)
    name = file.name if file.name != "current" else f"died-{time.time_ns()}"
    shutil.copyfile(file, folder / name)
    return str(folder / name)


def _line(row: Row) -> str:
    rate = row.executions / row.seconds if row.seconds else 0.0
    return (
        f"{row.reader:<18}{row.executions:>10,}{rate:>9,.0f}{len(row.findings):>10}"
        f"{row.worst_mib:>9.1f}{row.worst_multiple:>11.1f}{row.allowed_multiple:>9.0f}"
        f"{row.allowed_mib:>8.0f}{row.slowest_s:>8.2f}{row.lines:>7}"
    )


def main() -> None:
    """Fuzz readers and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reader", action="append", choices=TARGETS, help="all by default")
    parser.add_argument("--executions", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--engine", choices=("own", "atheris"), default="own")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    print(
        f"{'reader':<18}{'executions':>10}{'per s':>9}{'findings':>10}{'MiB':>9}"
        f"{'× above':>11}{'× all.':>9}{'MiB all.':>9}{'s':>7}{'lines':>7}",
        flush=True,
    )
    rows = []
    for reader in given.reader or TARGETS:
        rows.append(fuzzed(reader, given.executions, given.seed, given.engine, given.out))
        print(_line(rows[-1]), flush=True)
        for key, finding in rows[-1].findings.items():
            print(f"    {key}\n        {finding['input']}", flush=True)
        (given.out / "fuzz.json").write_text(
            json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8"
        )
    sys.exit(any(row.findings for row in rows))


if __name__ == "__main__":
    main()
