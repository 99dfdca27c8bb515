"""Planners without learned components."""
