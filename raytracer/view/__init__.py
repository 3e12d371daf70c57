"""A scene in a browser, live: `raytracer view SCENE`.

Stage: the command line. The server and the loop of the worker are those of `shpy.view`; the page and the sessions are
here.

- `command` reads the words of the command line and serves.
- `opening` opens the scene that the words name, in the worker.
- `session` holds the state of the view, and gives its frames.
- `renderers` makes the renderer of each backend and integrator; `refining` makes pictures with one, a coarse one first.
- `editing` gives materials and lights other numbers; `asking` answers questions about the picture and the camera.
"""
