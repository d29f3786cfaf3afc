"""The capture file: MCAP layout, columnar packing of frames, writing and scanning."""
