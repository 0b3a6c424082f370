"""All readers that are fuzzed, and the corpus of what was once a finding."""

from __future__ import annotations

from pathlib import Path

from tests.fuzz.lod_targets import LOD_TARGETS
from tests.fuzz.orientation_targets import ORIENTATION_TARGETS
from tests.fuzz.photo_targets import PHOTO_TARGETS
from tests.fuzz.project_targets import PROJECT_TARGETS
from tests.fuzz.scan_targets import SCAN_TARGETS
from tests.fuzz.target import Target

CORPUS = Path(__file__).parent / "corpus"

_ALL = (
    *SCAN_TARGETS,
    *ORIENTATION_TARGETS,
    *PHOTO_TARGETS,
    *LOD_TARGETS,
    *PROJECT_TARGETS,
)
TARGETS: dict[str, Target] = {target.name: target for target in _ALL}


def corpus_of(reader: str) -> list[bytes]:
    """Packed files that once were findings of a reader."""
    folder = CORPUS / reader
    if not folder.is_dir():
        return []
    return [path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()]
