"""A simulator of mixed drone surveys: real files with real metadata, and the truth about them.

``render(story, out_dir, seed)`` writes ``images/``, ``gcp_list.txt`` and
``truth.json``; ``stories.STORIES`` names what can be rendered; ``lies`` and
``filelies`` say what can be wrong with it.
"""

from __future__ import annotations

from . import catalogue, lies, stories
from .flight import RTK, Plan, Receiver, fly
from .run import render
from .survey import Scene, Survey
from .truth import Truth

__all__ = ["RTK", "Plan", "Receiver", "Scene", "Survey", "Truth", "catalogue", "fly", "lies", "render", "stories"]
