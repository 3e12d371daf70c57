"""From a scene to a picture: the integrators' hosts, which compile kernels and run them over bands of pixels."""
