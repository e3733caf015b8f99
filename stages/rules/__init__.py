"""The gate's rules, by what they look at: each a pure generator of findings over a survey."""

from __future__ import annotations

from typing import Callable, Iterator

from ..finding import Finding
from ..survey import Survey
from ..thresholds import Thresholds

Rule = Callable[[Survey, Thresholds], Iterator[Finding]]
