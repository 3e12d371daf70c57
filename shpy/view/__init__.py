"""Live pictures in a browser: `shpy view shader.py`.

Stage: above all others but the command line. Three parts know each other by messages alone:

    page (HTML, CSS, JavaScript)  ──WebSocket──  server (this process)  ──socket──  worker (a child process)

- The *page* draws frames and sends the user's actions. It depends on the server alone.
- The *server* keeps the state of the view, sends it to each new page, and watches the files. It runs no code of the
  user's: `hub` distributes messages, `workers` starts and ends child processes, `server` speaks HTTP and checks Host
  and Origin.
- A *worker* records one version of the file, and computes frames until the next version has its first picture. So the
  last good picture survives an error, and an endless loop ends with its process. `child` is the loop of a worker,
  `session` its contents; another package can provide a session of its own, derived from `Live`.

In both directions a message is a header in JSON, followed by bytes (`wire`).

Another package builds a view of its own with `sh.view.View`, `serve`, `add_serving` for its command line, the
folder `PAGE` of the page's files, and for its sessions `Live`, `Background`, `explain`, `noted`, `files_read`,
`available`, `preferred`, `warm`, `counts`, `marked` and `png_of`.
"""

from shpy.run.background import Background as Background
from shpy.view.command import add_serving as add_serving
from shpy.view.drawing import draw as draw
from shpy.view.kernels import available as available, preferred as preferred, warm as warm
from shpy.view.live import Live as Live
from shpy.view.oddities import counts as counts, marked as marked
from shpy.view.questions import png_of as png_of
from shpy.view.reading import files_read as files_read, noted as noted
from shpy.view.server import PAGE as PAGE, View as View, serve as serve
from shpy.view.source import explain as explain
