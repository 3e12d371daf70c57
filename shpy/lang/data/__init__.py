"""Data that a program reads: uniforms, tables, textures, and the host data that they accept."""
