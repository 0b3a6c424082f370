"""The masks of a project as an editor needs them: what stands, and safe ways to change it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from filelock import FileLock
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.project.project import Project
from workbench.project.store import require_inside
from workbench.project.user_masks import (
    Role,
    Subject,
    mask_path,
    masks_by_subject,
    read_mask,
    write_mask,
)

# In the order in which they are believed.
ROLES: tuple[Role, ...] = ("corrected", "training")
Standing = Role | Literal["automatic", "none"]


class MaskChangedError(InputError):
    """The mask is not the one the change was made to; ``state`` is what is there now."""

    def __init__(self, path: Path, state: MaskState) -> None:
        super().__init__(
            "The mask was changed elsewhere meanwhile", file=path, fix="choose which of them stays"
        )
        self.state = state


@dataclass(frozen=True)
class MaskState:
    """What there is of one subject's masks.

    Attributes
    ----------
    standing : where the mask that is shown comes from.
    automatic : whether there is an automatic mask to go back to.
    both : whether the user has a corrected and a training mask.
    version : changes whenever one of the user's files changes.
    """

    standing: Standing
    automatic: bool
    both: bool
    version: str

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


class MaskFiles:
    """The masks of a project's subjects.

    Parameters
    ----------
    project : the project.
    subjects : what can have a mask in it.
    """

    def __init__(self, project: Project, subjects: Sequence[Subject]) -> None:
        self._project = project
        self.subjects = tuple(subjects)

    def standings(self) -> dict[Subject, Standing]:
        """Where each subject's mask comes from, by which files are there."""
        found: dict[Subject, Standing] = {
            s: "automatic" if self._automatic_path(s).exists() else "none" for s in self.subjects
        }
        for role in reversed(ROLES):
            found |= dict.fromkeys(self._user_masks(role)[0], role)
        return found

    def problems(self) -> list[InputError]:
        """The files among the user's masks that belong to nothing, or to too much."""
        return [problem for role in ROLES for problem in self._user_masks(role)[1]]

    def state(self, subject: Subject) -> MaskState:
        """What there is of one subject's masks now.

        Raises
        ------
        InputError
            When a file cannot be read.
        """
        found, digest = [], hashlib.sha256()
        for role in ROLES:
            path = self._user_mask(subject, role)
            if path is not None:
                found.append(role)
                digest.update(role.encode() + hashlib.sha256(_bytes(path)).digest())
        automatic = self._automatic_path(subject).exists()
        standing: Standing = found[0] if found else "automatic" if automatic else "none"
        return MaskState(standing, automatic, len(found) == 2, digest.hexdigest()[:32])

    def mask(self, subject: Subject, standing: Standing) -> NDArray[np.uint8]:
        """The mask that stands, (h, w) uint8 of 0 and 255; empty where there is none.

        Raises
        ------
        InputError
            When the file is damaged, of another size, or gone.
        """
        size = _size(subject)
        if standing == "none":
            return np.zeros(size[::-1], np.uint8)
        if standing == "automatic":
            return read_mask(self._automatic_path(subject), size)
        path = self._user_mask(subject, standing)
        return read_mask(path or self._new_path(subject, standing), size)

    def save(
        self, subject: Subject, mask: NDArray[np.uint8], role: Role, version: str
    ) -> MaskState:
        """Write a mask where it is still ``version``; in another role it moves there.

        Where the user has a mask in both roles, only that of ``role`` is written.

        Parameters
        ----------
        mask : (h, w) uint8, 255 = keep, of the subject's size.

        Raises
        ------
        MaskChangedError
            When another mask is there by now; nothing is written then.
        InputError
            When the folder cannot be written, or a link leads out of the project.
        """
        path = self._user_mask(subject, role) or self._new_path(subject, role)
        with self._changing(subject, version, path) as before:
            write_mask(path, mask)
            if before.standing in ROLES and before.standing != role and not before.both:
                self._remove(subject, before.standing)
        return self.state(subject)

    def remove(self, subject: Subject, version: str) -> MaskState:
        """Remove the user's mask that stands, where it is still ``version``.

        Raises
        ------
        MaskChangedError, InputError
            As for `save`.
        """
        with self._changing(subject, version, self._new_path(subject, "corrected")) as before:
            if before.standing in ROLES:
                self._remove(subject, before.standing)
        return self.state(subject)

    @contextmanager
    def _changing(self, subject: Subject, version: str, path: Path) -> Iterator[MaskState]:
        """Hold the masks against other editors, and see that this one is as expected."""
        folder = self._project.root / "masks"
        require_inside(self._project.root, path.parent)
        try:
            folder.mkdir(exist_ok=True)
            with FileLock(folder / ".lock"):
                state = self.state(subject)
                if state.version != version:
                    raise MaskChangedError(path, state)
                yield state
        except OSError as error:
            raise InputError(
                "The mask cannot be saved",
                file=path,
                found=error.strerror or str(error),
                fix="make room on the disk, or check the permissions of the folder",
            ) from error

    def _remove(self, subject: Subject, role: Role) -> None:
        path = self._user_mask(subject, role)
        if path is not None:
            path.unlink()

    def _new_path(self, subject: Subject, role: Role) -> Path:
        return mask_path(self._project.root, role, subject, self.subjects)

    def _automatic_path(self, subject: Subject) -> Path:
        return self._project.store.path(f"automatic_{subject.kind}_masks", subject.name)

    def _user_mask(self, subject: Subject, role: Role) -> Path | None:
        return self._user_masks(role, {subject.name, subject.file})[0].get(subject)

    def _user_masks(
        self, role: Role, stems: set[str] | None = None
    ) -> tuple[dict[Subject, Path], list[InputError]]:
        """The user's masks by subject, and what is wrong with the other files.

        File by file, so that one stray file does not hide the others; the first of two wins.
        """
        found: dict[Subject, Path] = {}
        problems: list[InputError] = []
        for path in self._project.input_paths(f"{role}_masks"):
            if stems is not None and path.name.removesuffix(path.suffix) not in stems:
                continue
            try:
                (subject,) = masks_by_subject([path], self.subjects)
                if subject in found:
                    masks_by_subject([found[subject], path], self.subjects)
                found[subject] = path
            except InputError as problem:
                problems.append(problem)
        return found, problems


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            "The mask cannot be read",
            file=path,
            found=error.strerror,
            fix="check its permissions",
        ) from error


def _size(subject: Subject) -> tuple[int, int]:
    if subject.size is None:
        raise InputError(
            "The scan has no grid, so it can have no mask",
            file=subject.file,
            fix="export the scan with the scanner's own grid",
        )
    return subject.size
