"""Running: a program compiled for a target, the arrays that it takes, and the uniforms that follow Params."""
