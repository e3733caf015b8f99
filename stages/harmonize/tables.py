"""Colour tables from histograms (pure)."""

from __future__ import annotations

from typing import Tuple

import numpy as np
import numpy.typing as npt

Histogram = npt.NDArray[np.float64]

# Quantiles in steps of 2 %; the outermost hundredth on either side is glare, shadow and noise.
_LEVELS = np.linspace(0.01, 0.99, 50)


def mean_dn(histogram: Histogram) -> float:
    """Mean of a histogram over 0..255."""
    return float(np.dot(histogram, np.arange(256)) / histogram.sum())


def match_table(source: Histogram, reference: Histogram, max_slope: float) -> Tuple[int, ...]:
    """Return the 256 entries that give ``source`` the tones of ``reference``: histogram specification.

    Monotone; no entry rises by more than ``max_slope`` (rounded up) over the
    one before; black and white stay ends where the slope allows it. Between
    the quantiles that were seen the table is piecewise linear, outside of them
    it runs straight to black and to white, so that unseen tones stay in order.
    Both histograms hold 256 counts, not all zero.
    """
    x, y = _quantiles(source), _quantiles(reference)
    keep = np.concatenate(([True], np.diff(x) > 1e-9))
    # Of quantiles that share one tone the middle stands for all of them.
    starts = np.flatnonzero(keep)
    ends = np.append(starts[1:], len(x))
    x = x[starts]
    y = np.asarray([np.mean(y[a:b]) for a, b in zip(starts, ends)])
    if x[0] > 0:
        x, y = np.insert(x, 0, 0.0), np.insert(y, 0, 0.0)
    if x[-1] < 255:
        x, y = np.append(x, 255.0), np.append(y, 255.0)
    table = np.interp(np.arange(256), x, np.maximum.accumulate(y))
    middle = int(np.clip(np.rint(_at(source, 0.5)), 0, 255))
    for i in range(middle + 1, 256):
        table[i] = min(table[i], table[i - 1] + max_slope)
    for i in range(middle - 1, -1, -1):
        table[i] = max(table[i], table[i + 1] - max_slope)
    return tuple(int(v) for v in np.floor(np.clip(table, 0.0, 255.0) + 0.5))


def _quantiles(histogram: Histogram) -> Histogram:
    return np.asarray([_at(histogram, level) for level in _LEVELS])


def _at(histogram: Histogram, level: float) -> float:
    """Tone below which the share ``level`` lies; a count is spread evenly over its tone's unit width."""
    share = np.cumsum(histogram) / histogram.sum()
    index = int(np.searchsorted(share, level))
    index = min(index, 255)
    before = float(share[index - 1]) if index else 0.0
    inside = float(share[index]) - before
    return float(np.clip(index - 0.5 + ((level - before) / inside if inside > 0 else 0.5), 0.0, 255.0))
