"""From what a robot knows to the features its actors and critics read."""
