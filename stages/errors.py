"""The errors of the job, in three tiers.

A ``FrameError`` is a verdict on one file and never stops the job. A
``SensorgateError`` is meant for the person at the screen: it ends the command
with its ``exit_code`` and its message says the way out. Anything else is a
fault of ours: it is logged and recorded, and the command says so.
"""

from __future__ import annotations


class FrameError(Exception):
    """One file cannot be used; the job goes on without it.

    ``code`` is a finding code, ``message`` one sentence for the report.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message


class SensorgateError(Exception):
    """Ends the command; the message says what to do about it."""

    exit_code = 1


class UsageError(SensorgateError):
    """A wrong argument, an unknown name, an output folder that cannot be used."""

    exit_code = 2


class BlockedError(SensorgateError):
    """Nothing can be done with this input: no usable frame, nothing readable."""

    exit_code = 3


class MissingDependency(SensorgateError):
    """A library or program that this step needs is not installed."""

    exit_code = 4

    def __init__(self, what: str, needed_for: str, command: str) -> None:
        super().__init__(f"{what} is needed for {needed_for} and is not installed. Install it with: {command}")
        self.what = what
        self.command = command


class Cancelled(SensorgateError):
    """The user interrupted the work; what was finished stays for ``--resume``."""

    exit_code = 130


class InconsistentProfiles(SensorgateError, AssertionError):
    """Raised by ``assert_profiles_consistent``; an ``AssertionError`` that ``python -O`` does not silence."""

    exit_code = 1
