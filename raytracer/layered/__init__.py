"""Layered depth cubes: scenes as three layered depth images, an accelerator whose accuracy is a choice."""
