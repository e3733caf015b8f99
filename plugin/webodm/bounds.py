"""What a browser may send, in one place: nothing that comes in is read without a bound."""

from __future__ import annotations

HEAD_BYTES = 64 * 1024
FILE_BYTES = 1024 * 1024  # of one file's header, decoded
BATCH_BYTES = 4 * 1024 * 1024  # characters of one request's body; WebODM's own bound is 10 MB
BATCH_FILES = 64
SESSION_FILES = 20_000
SESSION_BYTES = 512 * 1024 * 1024  # what one session keeps on disk
CONTROL_BYTES = 4 * 1024 * 1024
SHEET_BYTES = 4 * 1024 * 1024
PATH_CHARACTERS = 1024
MOST_RANGES = 256
# 1,000 frames send about 60 MB at most; a user who sends more than this in ten minutes waits.
USER_BYTES = 1024 * 1024 * 1024
USER_WINDOW_S = 600
SESSIONS_PER_WINDOW = 60
MOST_LISTED = 200


def shown() -> "dict[str, int]":
    """The bounds that the panel has to keep, as the API says them."""
    return {
        "head_bytes": HEAD_BYTES,
        "file_bytes": FILE_BYTES,
        "batch_bytes": BATCH_BYTES,
        "batch_files": BATCH_FILES,
        "files": SESSION_FILES,
        "control_bytes": CONTROL_BYTES,
    }
