"""Rules on EMCY."""
