"""Who may reach a face over TCP: one policy, its token, and what the kernel knows of a connection.

A client loads this package when it connects on this computer: only the standard library is needed.
"""
