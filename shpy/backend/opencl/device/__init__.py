"""OpenCL devices: the driver, memory, runs, and collective operations."""
