"""Triggers: what happened on the buses, told while it is recorded."""
