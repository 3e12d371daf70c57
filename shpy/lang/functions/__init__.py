"""The parts of one function of the IR: blocks and loops, local arrays, results, and calls of other functions."""
