"""Tests of `syncline fleet`."""
