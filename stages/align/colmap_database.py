"""What COLMAP's program keeps in its database, read by frame rows."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np
import numpy.typing as npt

from .solution import Job

Pair = Tuple[int, int]

_PAIR_BASE = 2147483647


def name_of(job: Job, index: int) -> str:
    """File name that carries the camera and the frame's row."""
    return f"{job.frames[index].camera:03d}-{index:06d}.png"


def row_of(name: str) -> int:
    """The frame's row out of its file name."""
    return int(name.split("-")[1].split(".")[0])


def image_ids(database: Path) -> Tuple[Dict[int, int], Dict[int, int]]:
    """Return row -> image id and row -> number of features."""
    if not database.exists():
        return {}, {}
    link = sqlite3.connect(str(database))
    try:
        ids = {row_of(name): int(key) for key, name in link.execute("SELECT image_id, name FROM images")}
        counts = {int(key): int(rows) for key, rows in link.execute("SELECT image_id, rows FROM keypoints")}
    finally:
        link.close()
    return ids, {row: counts.get(key, 0) for row, key in ids.items()}


def descriptors_of(database: Path, ids: Dict[int, int], count: int) -> List[npt.NDArray[np.uint8]]:
    """Each row's descriptors, (N, 128); empty where it has none."""
    found: List[npt.NDArray[np.uint8]] = [np.zeros((0, 128), dtype=np.uint8) for _ in range(count)]
    if not database.exists():
        return found
    rows = {key: row for row, key in ids.items()}
    link = sqlite3.connect(str(database))
    try:
        for key, number, width, data in link.execute("SELECT image_id, rows, cols, data FROM descriptors"):
            if number and int(key) in rows:
                found[rows[int(key)]] = np.frombuffer(data, dtype=np.uint8).reshape(number, width)
    finally:
        link.close()
    return found


def inliers_of(database: Path, ids: Dict[int, int]) -> Dict[Pair, int]:
    """Verified matches per pair of rows."""
    rows = {key: row for row, key in ids.items()}
    link = sqlite3.connect(str(database))
    try:
        found = list(link.execute("SELECT pair_id, rows FROM two_view_geometries"))
    finally:
        link.close()
    result = {}
    for pair_id, count in found:
        second = pair_id % _PAIR_BASE
        a, b = rows.get((pair_id - second) // _PAIR_BASE), rows.get(second)
        if a is not None and b is not None and count:
            result[(min(a, b), max(a, b))] = int(count)
    return result
