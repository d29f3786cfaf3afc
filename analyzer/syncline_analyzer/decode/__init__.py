"""Frames in words, one by one: what `syncline decode` shows."""
