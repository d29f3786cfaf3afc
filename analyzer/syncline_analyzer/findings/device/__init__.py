"""Rules on what known devices do."""
