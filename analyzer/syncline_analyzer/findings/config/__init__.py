"""Rules on what nodes are set to."""
