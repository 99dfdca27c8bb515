"""SAMARL: a benchmark suite for multi-robot socially-aware navigation."""

import os
import sys
from importlib.metadata import version

# Set before torch is loaded: how its threads wait, see `mrsan.threads`. Networks consist of many
# small operations, between which threads should not sleep: training is then 2.5 times as fast.
if "torch" not in sys.modules:
    os.environ.setdefault("GOMP_SPINCOUNT", "20000")

__version__ = version("samarl")
