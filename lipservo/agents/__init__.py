"""Voice agents: programs that send speech and commands to a running face by WebSocket.

`agent_server.py` is the entry: one thread with an event loop. It never calls the live loop, which
moves servos: it appends requests to the loop's playout (the queue of speech to play), reads the
playout's events, and queries the face's own control socket.
The protocol is docs/agents.md.
"""
