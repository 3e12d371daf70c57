"""A scene in a browser, live: `raytracer view SCENE`.

Stage: the command line. The server and the loop of the worker are those of `shpy.view`; the page and the sessions are
here.

- `command` reads the words of the command line and serves.
- `opening` opens the scene that the words name, in the worker.
- `session` holds the state of the view, gives its frames, and explains pixels.
- `refining` makes the renderer of each backend and integrator, and pictures with one, a coarse one first.
- `editing` gives materials and lights other numbers.
"""
