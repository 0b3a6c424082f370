"""What was tried already: one small file for every setting of every stage."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from workbench.formats.atomic import replacing
from workbench.sweeping.measuring import Outcome
from workbench.sweeping.recommendation import relative_spread


@dataclass
class Tried:
    """The outcomes of one setting, the first with its error."""

    outcomes: list[Outcome] = field(default_factory=list)

    @property
    def first(self) -> Outcome:
        """The outcome that tells the error, or why there is none."""
        return self.outcomes[0]

    @property
    def failed(self) -> bool:
        """Whether the stage refused the setting."""
        return any(outcome.failed for outcome in self.outcomes)

    def median(self, name: str) -> float:
        """Of ``wall_s``, ``cpu_s`` or ``peak_rss_bytes``."""
        return float(np.median([getattr(outcome, name) for outcome in self.outcomes]))

    def spread(self, name: str) -> float:
        """Of the same, relative."""
        return relative_spread([getattr(outcome, name) for outcome in self.outcomes])


class TriedPoints:
    """A folder of them, by key; whatever cannot be read counts as not tried."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def read(self, key: str) -> Tried:
        """The outcomes stored under a key, none where there are none."""
        try:
            plain = json.loads(self._path(key).read_text(encoding="utf-8"))
            return Tried([_outcome(one) for one in plain["outcomes"]])
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return Tried()

    def write(self, key: str, tried: Tried) -> None:
        """Keep the outcomes under a key."""
        plain = {"outcomes": [asdict(outcome) for outcome in tried.outcomes]}
        with replacing(self._path(key)) as partial:
            partial.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")

    def forget_except(self, keys: Sequence[str]) -> None:
        """Delete what belongs to inputs or code no longer there."""
        kept = {self._path(key).name for key in keys}
        for path in self._folder.glob("*.json"):
            if path.name not in kept:
                path.unlink()

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}.json"


def _outcome(plain: Any) -> Outcome:
    return Outcome(**plain)
