"""OpenCL C, a packet of elements a work item, from the output tree."""
