"""Evaluation of agents on fixed cases: metrics, table rows and tables."""
