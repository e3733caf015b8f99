"""Pairs that a job wants to be found by likeness, for either engine (pure)."""

from __future__ import annotations

from typing import List, Sequence, Set, Tuple

import numpy as np
import numpy.typing as npt

from .matching import alike_pairs, signatures
from .solution import Job

Pair = Tuple[int, int]


def retrieved(job: Job, descriptors: Sequence[npt.NDArray[np.uint8]]) -> List[Pair]:
    """Return the pairs of ``job.retrieval``, sorted: the most alike that are neither in the job nor of one capture.

    ``descriptors`` are each frame's, rows of 128 bytes.
    """
    if not job.retrieval:
        return []
    vectors = signatures(descriptors)
    taken: Set[Pair] = set(job.pairs)
    taken |= {(min(a, b), max(a, b)) for group in job.apart for a in group for b in group}
    found: Set[Pair] = set()
    for wish in job.retrieval:
        found |= set(alike_pairs(vectors, wish.left, wish.right, wish.count, wish.per_frame, taken))
    return sorted(found)
