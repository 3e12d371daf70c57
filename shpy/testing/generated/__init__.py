"""Generated programs: their syntax, their text, the hypothesis strategy that makes them, and inputs for them."""
