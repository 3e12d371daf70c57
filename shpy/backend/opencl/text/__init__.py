"""OpenCL C, one element a work item, from the output tree."""
