"""File names that stay unique when payloads share a folder, and that ODM and its nodes take.

ODM finds images, masks, ground control and bands by name alone; NodeODM
renames what clashes, at random. Names keep their spelling where they can.
"""

from __future__ import annotations

import re
from collections import defaultdict
from typing import Dict, List, Mapping, Sequence, Set, Tuple

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
_MASK = re.compile(r"_mask$", re.IGNORECASE)
# Names that a Windows node or share cannot hold.
_RESERVED = frozenset(["con", "prn", "aux", "nul", *(f"{n}{i}" for n in ("com", "lpt") for i in range(1, 10))])
_MAX_STEM = 120


def safe(text: str) -> str:
    """``text`` in letters, digits, dot, hyphen and underscore; never empty, never hidden, never a reserved name."""
    clean = _UNSAFE.sub("_", text).strip("._-")[:_MAX_STEM].rstrip("._-") or "image"
    return f"{clean}_1" if clean.lower() in _RESERVED else clean


def _split(name: str) -> Tuple[str, str]:
    stem, dot, extension = name.rpartition(".")
    return (stem, f".{_UNSAFE.sub('', extension)}") if dot and stem else (name, "")


def _avoid_mask(stem: str) -> str:
    """ODM takes every file ending in ``_mask`` for a mask, in any case of its extension, and never for an image."""
    return _MASK.sub("_masked", stem)


def output_names(frames: Mapping[str, str]) -> Dict[str, str]:
    """Path of a frame -> its name in the projects; ``frames`` maps paths to payload ids.

    A name that is unique (case left out of account) among all frames stays,
    cleaned. Where several frames share one, each gets its payload in front
    and, if that does not part them, a number; all bands of a capture change
    alike, and what stands behind the last hyphen or underscore stays, so that
    ODM still finds bands by name. The result does not depend on the order.
    """
    stems: Dict[str, Tuple[str, str]] = {}
    shared: Dict[str, List[str]] = defaultdict(list)
    for path in sorted(frames):
        stem, extension = _split(path.replace("\\", "/").rsplit("/", 1)[-1])
        stems[path] = (_avoid_mask(safe(stem)), extension)
        shared["".join(stems[path]).lower()].append(path)
    clashing = _payload_groups(frames, stems, shared)
    result = {path: "".join(stems[path]) for path in frames if path not in clashing}
    taken = {name.lower() for name in result.values()}
    groups: Dict[Tuple[str, str, str], List[str]] = defaultdict(list)
    for path in sorted(clashing):
        folder = path.replace("\\", "/").rpartition("/")[0]
        groups[frames[path], folder, _base(stems[path][0])].append(path)
    for key in sorted(groups):
        _name_group(safe(key[0]), [(p, *stems[p]) for p in groups[key]], taken, result)
    return result


def _name_group(payload: str, members: Sequence[Tuple[str, str, str]], taken: Set[str], result: Dict[str, str]) -> None:
    """One number for all bands of a capture; a number of its own where cleaning made two of them alike."""
    count = 0
    while members:
        count += 1
        front = payload if count == 1 else f"{payload}-{count}"
        names = [f"{front}_{stem}{extension}" for _, stem, extension in members]
        if any(n.lower() in taken for n in names):
            continue
        left: List[Tuple[str, str, str]] = []
        for member, name in zip(members, names):
            if name.lower() in taken:
                left.append(member)
                continue
            taken.add(name.lower())
            result[member[0]] = name
        members = left


def _payload_groups(
    frames: Mapping[str, str], stems: Mapping[str, Tuple[str, str]], shared: Mapping[str, Sequence[str]]
) -> Set[str]:
    """Frames to be prefixed: those that clash, and the other bands of their captures (same name up to the band)."""
    clashing = {path for paths in shared.values() if len(paths) > 1 for path in paths}
    captures = {(frames[p], _base(stems[p][0])) for p in clashing}
    return {p for p in frames if (frames[p], _base(stems[p][0])) in captures}


def _base(stem: str) -> str:
    """The part of a name that ODM's band rule keeps: everything before the last hyphen or underscore and its word."""
    found = re.match(r"^(.+)[-_]\w+$", stem)
    return (found.group(1) if found else stem).lower()


def mask_name(image: str, mask: str) -> str:
    """The name of an image's mask: ODM wants ``<stem>_mask`` with the mask's own extension."""
    return f"{_split(image)[0]}_mask{_split(mask)[1]}"
