"""numpy: whole arrays at once, tile by tile; always there, and the slowest only where there is another."""
