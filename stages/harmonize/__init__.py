"""Frames made matchable: one ground resolution, one tone, one focal tag; originals never touched."""

from .model import FlightAction, HarmonizedFrame, HarmonizePlan, Lut
from .plan import plan

__all__ = ["FlightAction", "HarmonizePlan", "HarmonizedFrame", "Lut", "plan"]
