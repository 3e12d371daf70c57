"""The recording under way: the user's line, function, names and text, and the statements that they append to the IR."""
