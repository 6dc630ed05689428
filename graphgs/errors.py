"""Errors for people: what went wrong, where, what to do next, and the exit code that goes with it.

Exit codes: 0 ok, 1 bug, 2 usage, 3 the data cannot work, 4 memory, 5 disk, 130 interrupted, 141 the
reader of the output went away.
"""


class GraphGSError(Exception):
    """Base of every error a user can meet. `hint` says what to do next, `command` what tells more."""

    exit_code = 1

    def __init__(self, message: str, *, hint: str = ""):
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.command = ""


class UsageError(GraphGSError):
    """A wrong option, a missing folder, an output that cannot be written."""

    exit_code = 2


class DataError(GraphGSError):
    """The photos cannot work: too few, unreadable, no matches, not connected."""

    exit_code = 3


class PartialError(DataError):
    """Only part of the photos could be placed and `--allow-partial` was not given."""


class OutOfMemoryError(GraphGSError):
    """The work does not fit into memory."""

    exit_code = 4


class DiskError(GraphGSError):
    """The disk is full or a file could not be written."""

    exit_code = 5
