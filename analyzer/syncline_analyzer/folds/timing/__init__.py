"""SYNC and PDO timing, bus load, silences."""
