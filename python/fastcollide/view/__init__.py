"""The live page: spheres in a web browser, as they are simulated or as a finished run has written them.

program: the command; server: HTTP and WebSocket; access: who may connect; messages: what goes over the WebSocket;
player: the thread that simulates and plays; live, finished: the two kinds of run; moments: a run's past;
page: what the browser loads.
"""

HOST = "127.0.0.1"
PORT = 8321
