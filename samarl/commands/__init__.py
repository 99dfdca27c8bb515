"""The entry points, each short; nothing imports them."""
