"""Simulated devices, written from the makers' manuals (sheets), not from the product's decoder."""

from syncline_samples.devices.haomiao import Haomiao38 as Haomiao38
from syncline_samples.devices.io_module import IoModule as IoModule
from syncline_samples.devices.jn2100 import Jn2100 as Jn2100
from syncline_samples.devices.lir import Lir as Lir

__all__ = ["Haomiao38", "IoModule", "Jn2100", "Lir"]
