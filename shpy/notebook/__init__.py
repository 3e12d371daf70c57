"""Programs in a notebook: pictures of them, and a widget with sliders.

Stage: above all others but the command line. A program of pixels and a stream of colours show themselves (`pictures`);
`sh.widget(program)` adds the sliders of `shpy view` (`live`), whose frames this process computes.
"""
