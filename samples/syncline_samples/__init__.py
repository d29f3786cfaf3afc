"""Simulated CANopen buses with scripted faults, small captures, and the demo."""
