"""Live pictures in a browser: `shpy view shader.py`.

Stage: above all others but the command line. Three parts know each other by messages alone:

    page (HTML, CSS, JavaScript)  ──WebSocket──  server (this process)  ──socket──  worker (a child process)

- The *page* draws frames and sends what the user does. It needs nothing but what the server sends.
- The *server* keeps the state of the view, hands it to whoever joins, and watches the files. It runs no code of the
  user's: `hub` distributes messages, `workers` starts and ends child processes, `server` speaks HTTP and checks Host
  and Origin.
- A *worker* records one version of the file, and computes frames until the next version has its first picture. So an
  error leaves the last good picture alive, and an endless loop ends with its process. `child` is its loop, `session`
  its contents; another package can bring a session of its own.

A message is a header in JSON with bytes behind it, on both ways (`wire`).
"""
