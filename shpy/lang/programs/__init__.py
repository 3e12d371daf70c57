"""Programs: control flow, returns, subroutines and methods, and the recording of a whole function as a module."""
