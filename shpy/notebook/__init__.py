"""Widgets of programs in a notebook.

Stage: above all others but the command line. Programs of pixels and streams of colours show themselves
(`png`); `sh.widget(program)` adds the sliders of `shpy view` (`live`), whose frames this process computes.
"""
