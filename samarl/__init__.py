"""SAMARL: a benchmark suite for multi-robot socially-aware navigation."""

import os
import sys
from importlib.metadata import version

if "torch" not in sys.modules:  # before it is loaded: how its threads wait, see `mrsan.threads`
    os.environ.setdefault("GOMP_SPINCOUNT", "1000")

__version__ = version("samarl")
