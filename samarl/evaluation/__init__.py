"""Agents over fixed cases: episode records, summaries with intervals, tables."""
