"""The bus itself: error frames, clock, LSS, TIME."""
