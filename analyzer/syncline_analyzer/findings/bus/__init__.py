"""Rules on the bus and the recording."""
