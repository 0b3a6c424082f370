"""What the command line says: one answer on standard output, all else on standard error."""

from __future__ import annotations

import ctypes
import errno
import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from workbench import doctor
from workbench.errors import InputError, WorkbenchError

if TYPE_CHECKING:
    from rich.table import Table

# Trouble of the machine or its owner, not of the program.
_USER_ERRNO = frozenset(
    (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
)


class _InterruptedError(WorkbenchError):
    exit_code = 130  # as shells have it: 128 and the number of the signal


INTERRUPTED = _InterruptedError("Interrupted", fix="run it again: what is finished stays")


@dataclass(frozen=True)
class Answer:
    """What a command has to say.

    Attributes
    ----------
    value : for programs.
    text : the same for people.
    exit_code : 0; 3 when something is missing; 1 when what was to be shown is wrong.
    afterwards : what goes on once the answer is given, until the user stops it: a page's server.
    """

    value: dict[str, Any]
    text: str | Table
    exit_code: int = 0
    afterwards: Callable[[], None] | None = None

    def give(self, as_json: bool) -> int:
        """Print the answer; returns the exit code."""
        if as_json:
            _print(json.dumps(self.value, allow_nan=False))
        elif isinstance(self.text, str):
            _print(self.text)
        else:
            from rich.console import Console

            Console(highlight=False, markup=False).print(self.text)
        if self.afterwards is not None:
            self.afterwards()
        return self.exit_code


def table(columns: Sequence[str], rows: Sequence[dict[str, Any]]) -> Table:
    """A table for people."""
    from rich.table import Table
    from rich.text import Text

    made = Table(box=None, pad_edge=False, header_style="bold")
    for column in columns:
        made.add_column(column, overflow="fold")
    for row in rows:
        # As text, for names and reasons may hold what would pass for markup.
        made.add_row(*(Text(str(value)) for value in row.values()))
    return made


@contextmanager
def answer_alone_on_stdout(as_json: bool) -> Iterator[None]:
    """Inside the block, what libraries print, in Python or in C, goes to standard error."""
    if not as_json:
        yield
        return
    sys.stdout.flush()
    try:
        out, err = sys.stdout.fileno(), sys.stderr.fileno()
    except (OSError, ValueError):
        with redirect_stdout(sys.stderr):  # captured: there is no descriptor to turn away
            yield
        return
    kept = os.dup(out)
    os.dup2(err, out)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        if os.name == "posix":
            ctypes.CDLL(None).fflush(None)  # what C still holds back belongs to the block
        os.dup2(kept, out)
        os.close(kept)


def told(error: Exception) -> WorkbenchError:
    """Any exception as an error with an exit code; one of ours is shown with its traceback."""
    if isinstance(error, WorkbenchError):
        return error
    # The parser's own errors, whose class has moved from one version of typer to the next.
    message = getattr(error, "format_message", None)
    if message is not None:
        return InputError(message(), fix="workbench --help")
    if isinstance(error, ImportError | OSError):
        missing = doctor.missing_part(error)
        if missing is not None:
            return missing
    if isinstance(error, OSError) and error.errno in _USER_ERRNO:
        return InputError(
            error.strerror or "The file cannot be used",
            file=error.filename,
            fix="make room, or choose a place that may be written; what is finished stays",
        )
    traceback.print_exception(error)
    return WorkbenchError(
        f"{type(error).__name__}: {error}",
        fix="this is a fault of the workbench; please report it with the lines above",
    )


def give_failure(error: WorkbenchError, as_json: bool) -> int:
    """Print the error where it belongs; returns the exit code."""
    print(f"error: {error}", file=sys.stderr)
    if as_json:
        _print(json.dumps({"error": error.as_dict()}))
    return error.exit_code


def _print(text: str) -> None:
    # A file name may hold bytes that are no text at all; they are shown escaped.
    encoding = sys.stdout.encoding or "utf-8"
    try:
        print(text.encode(encoding, "backslashreplace").decode(encoding), flush=True)
    except BrokenPipeError:
        # The reader, `head` for one, has seen enough. What Python would flush at its end
        # must have somewhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
