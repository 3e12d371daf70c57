"""numpy: whole arrays at once, tile by tile; always there, and the slowest only where there is another."""

from shpy.backend.numpy.device.run import backend

__all__ = ["backend"]
