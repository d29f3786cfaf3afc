"""Getting frames onto disk: sources, clocks, batching, writing, recovery, live status."""
