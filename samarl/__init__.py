"""SAMARL: a benchmark suite for multi-robot socially-aware navigation."""

from importlib.metadata import version

__version__ = version("samarl")
