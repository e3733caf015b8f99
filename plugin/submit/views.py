"""What a node says of itself and of a task, read from answers that may hold anything."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, Dict, Optional, Tuple

QUEUED, RUNNING, FAILED, COMPLETED, CANCELED = "queued", "running", "failed", "completed", "canceled"
_STATUS = {10: QUEUED, 20: RUNNING, 30: FAILED, 40: COMPLETED, 50: CANCELED}
ENDED = frozenset((FAILED, COMPLETED, CANCELED))


@dataclass(frozen=True)
class NodeView:
    """What a node says of itself; ``None`` where it does not."""

    version: str
    engine: str
    engine_version: str
    max_images: Optional[int]
    slots: Optional[int]
    queued: Optional[int]
    available_memory_bytes: Optional[int]
    cluster: bool


@dataclass(frozen=True)
class TaskView:
    """What a node says of a task.

    ``settled`` is false while the node still moves the uploads into place:
    until then the count of images is an estimate that counts other files too.
    """

    uuid: str
    status: str
    images: Optional[int]
    options: Tuple[Tuple[str, Any], ...]
    progress: float
    settled: bool
    message: str


def count(value: Any) -> Optional[int]:
    """A number of things, or ``None`` where the value is none."""
    if isinstance(value, bool) or value is None:
        return None
    try:
        number = int(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if 0 <= number < 1 << 62 else None


def task_view(uuid: str, told: Dict[str, Any], hide: Callable[[Any], str]) -> TaskView:
    """A task out of the answer to ``/task/UUID/info``; ``hide`` takes secrets out of its message."""
    raw = told.get("status")
    status = raw if isinstance(raw, dict) else {}
    state = _STATUS.get(count(status.get("code")) or 0, RUNNING)
    progress = told.get("progress")
    figure = float(progress) if isinstance(progress, (int, float)) and not isinstance(progress, bool) else 0.0
    # A cluster that still forwards the files reports no progress; a node that still sorts them no processing time.
    started = told.get("processingTime")
    waiting = state == RUNNING and (
        "progress" not in told or not isinstance(started, (int, float)) or (started < 0 and figure <= 0)
    )
    given = told.get("options")
    listed = given if isinstance(given, list) else []
    return TaskView(
        uuid=uuid,
        status=state,
        images=count(told.get("imagesCount")),
        options=tuple(sorted((str(o["name"]), o.get("value")) for o in listed if isinstance(o, dict) and "name" in o)),
        progress=min(100.0, max(0.0, figure)),
        settled=not waiting,
        message=hide(status.get("errorMessage") or ""),
    )
