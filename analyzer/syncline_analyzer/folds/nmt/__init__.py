"""NMT: error control, state timelines, guarding."""
