"""Voice agents: programs that send speech and commands to a running face by WebSocket.

`agent_server.py` is the entry: one thread with an event loop. It never touches the live loop: it
appends to the playout's requests, reads its events, and queries the face's own control socket.
The protocol is docs/agents.md.
"""
