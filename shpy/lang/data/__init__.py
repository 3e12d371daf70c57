"""Data that a program reads: uniforms, tables, textures, and what host data they take."""
