"""The learned macro level: which robot enters a passage now, and which ones queue."""
