"""What a program needs to speak through a face: `lipservo.connect` and `lipservo.connect_async`.

Nothing here loads the rest of lipservo: a client needs websockets alone, and numpy only where it
writes arrays. The protocol is docs/agents.md.
"""
