"""What can go wrong, said so that the reader knows what to do next.

Library code raises; only the command line prints and exits with ``exit_code``.
An *expected* failure of an estimate (too little overlap, an unconstrained
direction) is not an error: it is a typed result that tells its reason.
"""

from __future__ import annotations

from pathlib import Path


class WorkbenchError(Exception):
    """Base of all errors the workbench raises on purpose.

    Parameters
    ----------
    message : what went wrong, one sentence.
    stage : the stage that was at work, where one was.
    file : the file that is to blame, where there is one.
    where : the element, line or byte offset inside ``file``.
    expected, found : what was asked for and what was there instead.
    fix : what the user can do about it.
    """

    exit_code = 1

    def __init__(
        self,
        message: str,
        *,
        stage: str | None = None,
        file: Path | str | None = None,
        where: str | None = None,
        expected: str | None = None,
        found: str | None = None,
        fix: str | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.stage = stage
        self.file = str(file) if file is not None else None
        self.where = where
        self.expected = expected
        self.found = found
        self.fix = fix

    def __str__(self) -> str:
        lines = [self.message]
        for label in ("stage", "file", "where", "expected", "found", "fix"):
            value = getattr(self, label)
            if value is not None:
                lines.append(f"  {label}: {value}")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, str]:
        """The same facts for ``--json``: only the keys that are known."""
        fields = ("message", "stage", "file", "where", "expected", "found", "fix")
        return {name: getattr(self, name) for name in fields if getattr(self, name) is not None}


class InputError(WorkbenchError):
    """A file or a folder the user gave cannot be used."""

    exit_code = 2


class SettingsError(InputError):
    """An option is unknown, mistyped or out of its bounds."""


class ProjectLockedError(InputError):
    """Another run is writing this project."""


class MissingPartError(WorkbenchError):
    """A library or system part is not installed; ``fix`` is the line that installs it."""

    exit_code = 3
