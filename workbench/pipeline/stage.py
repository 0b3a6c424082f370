"""What a stage is: a declaration the planner can read and one function that does the work."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from workbench.errors import InputError
from workbench.metrics import Metric
from workbench.pipeline.knobs import ErrorMeasure, Knob
from workbench.pipeline.progress import Progress
from workbench.pipeline.tasks import Tasks
from workbench.project.artefacts import ARTEFACTS
from workbench.project.project import Project, Scene
from workbench.project.settings import StageOptions

#: What Python and all libraries take in a process, measured on whole runs.
LIBRARY_BYTES = 2**29

OptionsT = TypeVar("OptionsT", bound=StageOptions)


@dataclass(frozen=True)
class Need:
    """Whether a scene needs a stage, and why, in words for people.

    ``without`` names artefacts the stage declares that it reads and that this scene has no
    place for: they are absent to it, and it waits for none of them.
    """

    needed: bool
    reason: str
    without: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Estimate:
    """What a stage will take at most, foretold from the scene.

    Attributes
    ----------
    memory_bytes : with one worker, beside what the libraries take.
    disk_bytes : of all its products.
    item_bytes : of the memory, what one item takes: each further worker holds one. 0 where the
        stage has no items for workers.
    """

    memory_bytes: int
    disk_bytes: int
    item_bytes: int = 0

    def announced(self, workers: int) -> int:
        """All memory with so many processes at work, libraries included."""
        return self.memory_bytes + LIBRARY_BYTES + (workers - 1) * self.worker_bytes

    def workers_within(self, free_bytes: int, most: int) -> int:
        """How many processes may be at work in so much memory, 1 at least and ``most`` at most.

        The libraries of this process are held already.
        """
        if not self.item_bytes:
            return most
        return min(most, 1 + max(0, free_bytes - self.memory_bytes) // self.worker_bytes)

    @property
    def worker_bytes(self) -> int:
        """Memory of a worker that is at work on one item; 0 where there are none."""
        return self.item_bytes + LIBRARY_BYTES if self.item_bytes else 0


@dataclass(frozen=True)
class StageResult:
    """What a stage has to say beside its products.

    Attributes
    ----------
    metrics, warnings : for the record and the report.
    passing : per-item products that only helped to make the others; they go once the record is
        written, for until then a killed run needs them.
    """

    metrics: tuple[Metric, ...] = ()
    warnings: tuple[str, ...] = ()
    passing: tuple[str, ...] = ()


class Products:
    """The artefacts a stage declared, and no others.

    Parameters
    ----------
    project : the project at work.
    reads, writes : artefact names the stage declared.
    absent : artefacts of stages this scene leaves out; what an earlier scene left there of
        them does not count.
    """

    def __init__(
        self,
        project: Project,
        reads: tuple[str, ...],
        writes: tuple[str, ...],
        absent: frozenset[str] = frozenset(),
    ) -> None:
        self._project = project
        self._absent = absent
        self._reads = frozenset(reads) | frozenset(writes)
        self._writes = frozenset(writes)
        self._written: set[str] = set()

    def load(self, name: str, item: str | None = None, only: Sequence[str] | None = None) -> Any:
        """The value of a declared artefact; of arrays ``only`` those named."""
        return self._project.store.load(self._there(name), item, only)

    def load_if_there(self, name: str, item: str | None = None) -> Any | None:
        """The value of a declared artefact, None where it was left out."""
        return self._project.store.load(name, item) if self.is_there(name, item) else None

    def is_there(self, name: str, item: str | None = None) -> bool:
        """Whether a declared artefact was made, and not left out."""
        there = self._readable(name) not in self._absent
        return there and self._project.store.exists(name, item)

    def path(self, name: str, item: str | None = None) -> Path:
        """The file of a declared artefact, for who reads it later."""
        return self._project.store.path(self._there(name), item)

    def items(self, name: str) -> tuple[str, ...]:
        """The items that exist of a declared artefact."""
        there = self._readable(name) not in self._absent
        return self._project.store.items(name) if there else ()

    def input_paths(self, name: str) -> tuple[Path, ...]:
        """The user's files behind a declared input."""
        return self._project.input_paths(self._readable(name))

    def input_hash(self, path: Path) -> str:
        """Content hash of one of the user's files."""
        return self._project.hashes.of_file(path)

    def content_hash(self, name: str, item: str | None = None) -> str:
        """Content hash of a declared artefact, or of one item of it."""
        return self._project.hashes.of_file(self._project.store.path(self._there(name), item))

    def save(self, name: str, value: Any, item: str | None = None) -> Path:
        """Store a declared product whole."""
        self._written.add(name)
        return self._project.store.save(self._writable(name), value, item)

    def writing(self, name: str, item: str | None = None) -> AbstractContextManager[Path]:
        """A temporary path that becomes the declared product when the block ends well."""
        self._written.add(name)
        return self._project.store.writing(self._writable(name), item)

    def remove_items_except(self, name: str, keep: set[str]) -> None:
        """Delete items of a product that belong to inputs no longer there."""
        for item in self._project.store.items(self._writable(name)):
            if item not in keep:
                self._project.store.path(name, item).unlink()

    def remove_what_was_not_written(self) -> None:
        """Delete single products of an earlier run that this one, now done, did not make."""
        for name in self._writes - self._written:
            if not ARTEFACTS[name].per_item:
                self._project.store.path(name).unlink(missing_ok=True)

    @property
    def project_name(self) -> str:
        """What the project is called."""
        return self._project.name

    def _there(self, name: str) -> str:
        if self._readable(name) in self._absent:
            raise InputError(
                f"{ARTEFACTS[name].description}: left out for this scene",
                fix="workbench plan tells why",
            )
        return name

    def _readable(self, name: str) -> str:
        if name not in self._reads:
            raise PermissionError(f"the stage does not declare that it reads {name!r}")
        return name

    def _writable(self, name: str) -> str:
        if name not in self._writes:
            raise PermissionError(f"the stage does not declare that it writes {name!r}")
        return name


@dataclass(frozen=True)
class Job(Generic[OptionsT]):
    """All a stage's function is given; ``left_out`` is stage → reason for this scene."""

    products: Products
    options: OptionsT
    scene: Scene
    progress: Progress
    tasks: Tasks
    left_out: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Stage(Generic[OptionsT]):
    """One step of the pipeline.

    Attributes
    ----------
    name : the command that runs it.
    version : raised when the same inputs and options give another result.
    summary : one line for the table of stages.
    options : the model of its options.
    reads, writes : artefact names; an artefact read that was left out is simply absent.
    libraries : distributions whose version can change the result.
    needed : decides from the scene and the options, and says why.
    run : does the work.
    estimate : foretells memory and disk; None where both are small.
    suggest : names what the user could bring for the stage to do better, the most useful
        first: dicts of ``kind``, ``name`` and ``file``, as many of each kind as wanted.
    reads_truth : set for verification alone; any other stage that names a ``truth`` artefact
        cannot be built.
    knobs : options that trade error for time, with the values a sweep tries.
    errors : for verification alone: by name, how wrong the products of stages are.
    """

    name: str
    version: int
    summary: str
    options: type[OptionsT]
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    needed: Callable[[Scene, OptionsT], Need]
    run: Callable[[Job[OptionsT]], StageResult]
    libraries: tuple[str, ...] = ()
    estimate: Callable[[Scene, OptionsT], Estimate] | None = None
    reads_truth: bool = field(default=False)
    suggest: Callable[[Project, int], list[dict[str, str]]] | None = None
    knobs: tuple[Knob, ...] = ()
    errors: Mapping[str, ErrorMeasure] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.reads + self.writes:
            if name not in ARTEFACTS:
                raise ValueError(f"stage {self.name}: {name!r} is not in the artefact table")
            if ARTEFACTS[name].truth and not (self.reads_truth and name in self.reads):
                raise ValueError(f"stage {self.name} may not touch the simulated truth ({name})")
        for name in self.writes:
            if ARTEFACTS[name].format == "input" or name == "records" or name in self.reads:
                raise ValueError(f"stage {self.name} may not write {name!r}")
        for knob in self.knobs:
            knob.check(self.name, self.options)
