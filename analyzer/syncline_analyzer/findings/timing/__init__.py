"""Rules on SYNC and PDOs."""
