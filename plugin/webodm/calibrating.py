"""How a calibration reaches a node through WebODM: as files in the task's folder, all of which WebODM sends.

An option with JSON in it is destroyed by some releases of NodeODM, so none is
sent. A node with our adapter takes the calibration from among the images; any
other unpacks ``seed.zip`` over the project, where its ODM finds its own file of
overrides. Which node a task goes to is often open until it goes, so both lie
there.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping, Optional, Sequence, Tuple

from ...stages.record import dumps, write_text
from ..odm.wire import CALIBRATION_INPUT
from ..submit.negotiate import LOCK
from ..submit.transfer import SEED, write_seed
from .proposal import Proposed

FILES = (CALIBRATION_INPUT, SEED)
# With one of these the user says what the cameras are.
_OWN = ("cameras", "camera-lens")


@dataclass(frozen=True)
class Load:
    """What a new task takes along: its creator's options and ours, a calibration to write, files to link."""

    own: Tuple[Mapping[str, Any], ...]
    ours: Tuple[Mapping[str, Any], ...]
    calibration: Optional[Mapping[str, Any]] = None
    linked: Tuple[str, ...] = ()

    @property
    def harmonized(self) -> bool:
        """Whether a node has nothing to harmonize any more."""
        return self.calibration is not None or bool(self.linked)


def load_of(folder: Path, part: Proposed, own: Sequence[Mapping[str, Any]], resized: bool) -> Load:
    """Settle what goes with a part of the task in ``folder``.

    ODM's lock freezes at zero what no calibration gives, so without one ours
    is left out. The user's own cameras come first. A calibration's keys hold
    the picture size: a task that is to be resized takes none.
    """
    mine = tuple(own)
    if part.calibration is not None:
        if part.calibration and not resized and not any(o.get("name") in _OWN for o in mine):
            return Load(mine, part.options, part.calibration)
        return Load(mine, _unlocked(part.options), {})
    if not lies_in(folder):
        return Load(mine, part.options)
    if resized:
        return Load(_unlocked(mine), part.options)
    return Load(mine, part.options, linked=FILES)


def _unlocked(options: Sequence[Mapping[str, Any]]) -> Tuple[Mapping[str, Any], ...]:
    return tuple(o for o in options if o.get("name") != LOCK)


def put(folder: Path, calibration: Mapping[str, Any]) -> None:
    """Lay the calibration into a task's folder; an empty one says only that the frames are harmonized."""
    write_text(folder / CALIBRATION_INPUT, dumps(dict(calibration)))
    if calibration:
        write_seed(folder / SEED, (), dict(calibration))


def lies_in(folder: Path) -> bool:
    """Whether a task brings a calibration along."""
    return (folder / CALIBRATION_INPUT).is_file() and (folder / SEED).is_file()
