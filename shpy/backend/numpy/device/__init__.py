"""The host as a device: memory, runs over tiles, and collective operations."""
