"""SAMARL: a benchmark suite for multi-robot socially-aware navigation."""

import os
import sys
from importlib.metadata import version

# Before torch is loaded: how its threads wait, see `mrsan.threads`. A network is thousands of small
# pieces of work, between which its threads must not fall asleep: training is 2.5 times as fast.
if "torch" not in sys.modules:
    os.environ.setdefault("GOMP_SPINCOUNT", "20000")

__version__ = version("samarl")
