"""SAMARL: a benchmark suite for multi-robot socially-aware navigation."""

from importlib.metadata import version

import mrsan  # noqa: F401 (first: it sets how threads wait)

__version__ = version("samarl")
