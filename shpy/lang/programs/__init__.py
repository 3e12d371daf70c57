"""Programs: control flow and methods, the recording of a whole function as a module, and calls of such modules."""
