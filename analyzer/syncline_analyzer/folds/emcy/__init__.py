"""EMCY: episodes, context, history."""
