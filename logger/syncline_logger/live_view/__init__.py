"""What is being recorded, in a Rerun viewer: a process of its own that nothing waits for."""
