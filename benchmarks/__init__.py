"""How fast the simulator is and whether it holds out; run from the source folder."""
