"""OpenCL: kernels in OpenCL C 1.2 for GPUs and, by PoCL, for CPUs."""
