"""The kernels, written in the language: intersections of rays, and the colours that rays bring back."""
