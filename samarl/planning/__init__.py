"""Planning shared by the planners, the safety shield and the policies."""
