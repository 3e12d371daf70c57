"""EMIT, COMPILE, RUN: the targets."""
