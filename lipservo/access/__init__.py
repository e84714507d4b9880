"""Access control for clients that connect to a face over TCP: one policy, and its token."""
