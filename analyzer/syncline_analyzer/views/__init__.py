"""What people look at: text, JSON, tables on disk, Rerun, HTML."""
