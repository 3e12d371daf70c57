"""Data that a program reads or keeps: uniforms, tables, textures, local arrays, and what host data they take."""
