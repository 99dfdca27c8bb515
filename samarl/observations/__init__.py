"""What a robot makes of what it sees."""
