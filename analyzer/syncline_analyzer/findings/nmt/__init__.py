"""Rules on NMT."""
