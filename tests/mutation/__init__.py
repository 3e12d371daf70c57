"""Put small faults into backends, passes and kernels, and see whether the tests find them."""
