"""Readers of captures and of other tools' logs; `open_capture` finds the right one."""

from syncline_analyzer.readers.detect import open_capture as open_capture

__all__ = ["open_capture"]
