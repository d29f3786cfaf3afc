"""Layouts with which other people's viewers show the decoded channels of our captures."""
