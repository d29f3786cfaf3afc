"""Rules on SDO."""
