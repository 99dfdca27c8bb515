"""How fast the simulator is and whether it holds out; run from the source folder."""

import samarl as _samarl  # noqa: F401 (before torch: it says how threads wait)
