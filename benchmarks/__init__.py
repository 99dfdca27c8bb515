"""Benchmarks of speed and robustness; run them from the repository root."""

import samarl as _samarl  # noqa: F401 (before torch: it configures how threads wait)
