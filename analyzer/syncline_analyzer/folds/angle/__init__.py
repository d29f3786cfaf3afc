"""Angle traces and what is odd about them."""
