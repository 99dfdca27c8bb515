"""Planners that need no learning."""
