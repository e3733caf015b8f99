"""Frames made matchable: one ground resolution, one tone, one focal tag; originals never touched."""

from .apply import apply
from .files import OutputError
from .model import FlightAction, HarmonizedFrame, HarmonizePlan, Lut
from .plan import plan
from .radiometry import learn_luts

__all__ = ["FlightAction", "HarmonizePlan", "HarmonizedFrame", "Lut", "OutputError", "apply", "learn_luts", "plan"]
