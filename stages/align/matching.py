"""Descriptors to matches, in numpy: exact nearest neighbours, mutual, with Lowe's ratio.

Exhaustive and free of random trees, so the same features give the same
matches on every run. Descriptors are root-normalised SIFT of unit length;
distances are angles, as COLMAP measures them.
"""

from __future__ import annotations

from typing import AbstractSet, List, Sequence, Set, Tuple

import numpy as np
import numpy.typing as npt

Descriptors = npt.NDArray[np.float32]
Matches = npt.NDArray[np.uint32]

_BLOCK = 2048
_MAX_ANGLE = 0.7
_WORDS = 64


def unit(descriptors: npt.NDArray[np.uint8]) -> Descriptors:
    """Return rows of unit length, float32, shape (N, 128)."""
    rows = descriptors.astype(np.float32)
    length = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    return np.asarray(rows / np.maximum(length, 1e-6)[:, None], dtype=np.float32)


def match(left: Descriptors, right: Descriptors, max_ratio: float) -> Matches:
    """Return index pairs (M, 2) that are each other's nearest and pass the ratio test from the left.

    The left side is taken in blocks, so memory stays below 2048 x N floats.
    """
    if len(left) == 0 or len(right) < 2:
        return np.zeros((0, 2), dtype=np.uint32)
    best = np.full(len(right), -2.0, dtype=np.float32)
    first = np.empty(len(left), dtype=np.float32)
    second = np.empty(len(left), dtype=np.float32)
    nearest = np.empty(len(left), dtype=np.int64)
    for start in range(0, len(left), _BLOCK):
        likeness = left[start : start + _BLOCK] @ right.T
        rows = np.arange(len(likeness))
        stop = start + len(rows)
        np.maximum(best, likeness.max(axis=0), out=best)
        top = likeness.argmax(axis=1)
        nearest[start:stop] = top
        first[start:stop] = likeness[rows, top]
        likeness[rows, top] = -2.0
        second[start:stop] = likeness.max(axis=1)
    angle = np.arccos(np.clip(first, -1.0, 1.0))
    distinct = angle < max_ratio * np.arccos(np.clip(second, -1.0, 1.0))
    # A row that reaches its partner's best likeness is that partner's nearest: no second search is needed.
    keep = np.nonzero(distinct & (angle < _MAX_ANGLE) & (first >= best[nearest]))[0]
    return np.stack([keep, nearest[keep]], axis=1).astype(np.uint32)


def signatures(descriptors: Sequence[npt.NDArray[np.uint8]]) -> Descriptors:
    """Return one unit vector per frame that is alike for frames of the same ground, in any rotation.

    Residuals of the descriptors against a small vocabulary, summed per word
    (VLAD). The vocabulary is a few rounds of k-means from evenly spaced
    descriptors, without randomness. Shape (N, 64 * 128).
    """
    sample = [unit(d[:: max(1, len(d) // 200)]) for d in descriptors if len(d)]
    if not sample:
        return np.zeros((len(descriptors), _WORDS * 128), dtype=np.float32)
    pool = np.concatenate(sample)
    words = pool[np.linspace(0, len(pool) - 1, min(_WORDS, len(pool))).astype(int)]
    for _ in range(8):
        nearest = (pool @ words.T).argmax(axis=1)
        for word in range(len(words)):
            members = pool[nearest == word]
            if len(members):
                mean = members.mean(axis=0)
                words[word] = mean / max(float(np.linalg.norm(mean)), 1e-6)
    result = np.zeros((len(descriptors), _WORDS, 128), dtype=np.float32)
    for row, raw in enumerate(descriptors):
        if not len(raw):
            continue
        rows = unit(raw)
        nearest = (rows @ words.T).argmax(axis=1)
        for word in range(len(words)):
            members = rows[nearest == word]
            if len(members):
                result[row, word] = (members - words[word]).sum(axis=0)
        norms = np.linalg.norm(result[row], axis=1, keepdims=True)
        result[row] /= np.maximum(norms, 1e-6)
    flat = result.reshape(len(descriptors), -1)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6), dtype=np.float32)


def alike_pairs(
    vectors: Descriptors,
    left: Sequence[int],
    right: Sequence[int],
    count: int,
    per_frame: int,
    without: AbstractSet[Tuple[int, int]] = frozenset(),
) -> List[Tuple[int, int]]:
    """Return the most alike pairs (a < b, sorted): ``count`` in all, or ``per_frame`` for each of ``left``.

    Pairs ``without`` are passed over before any is counted.
    """
    likeness = np.round(vectors[list(left)] @ vectors[list(right)].T, 6)
    wanted: List[Tuple[float, int, int]] = []
    for row, a in enumerate(left):
        fresh = [(col, b) for col, b in enumerate(right) if a != b and (min(a, b), max(a, b)) not in without]
        ranked = sorted((-float(likeness[row, col]), a, b) for col, b in fresh)
        wanted.extend(ranked[:per_frame] if per_frame else ranked)
    if not per_frame:
        wanted = _distinct(sorted(wanted), count)
    return sorted({(min(a, b), max(a, b)) for _, a, b in wanted})


def _distinct(ranked: List[Tuple[float, int, int]], count: int) -> List[Tuple[float, int, int]]:
    seen: Set[Tuple[int, int]] = set()
    kept: List[Tuple[float, int, int]] = []
    for item in ranked:
        key = (min(item[1], item[2]), max(item[1], item[2]))
        if key not in seen and len(kept) < count:
            seen.add(key)
            kept.append(item)
    return kept
