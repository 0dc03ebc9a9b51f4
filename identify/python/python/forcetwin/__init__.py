"""Identified twins of doors and drawers: their effort over NumPy arrays, recordings, the identification."""
from . import attach
from ._forcetwin import Identified, Samples, Twin, identify, read

__all__ = ["Identified", "Samples", "Twin", "attach", "identify", "read"]
