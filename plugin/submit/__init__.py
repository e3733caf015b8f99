"""Sub-projects onto NodeODM, NodeODX or ClusterODM: whole, once, watched, brought home, judged."""

from __future__ import annotations

from .run import DEFAULT_SETTINGS, Settings, Submission, submit
from .table import lines, record

__all__ = ["DEFAULT_SETTINGS", "Settings", "Submission", "lines", "record", "submit"]
