"""SDO: channels, transfers of every kind, rows."""
