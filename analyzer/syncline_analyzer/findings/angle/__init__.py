"""Rules on angles."""
